"""``python -m splatmorph``."""

from splatmorph.app import main

main()
