"""The command line from a checkout: ``python cli.py fit a.ply b.ply``."""

from splatmorph.app import main

main()
