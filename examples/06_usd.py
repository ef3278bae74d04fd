"""The whole morph as one USD file that plays: ``python 06_usd.py a.ply b.ply`` (extra ``usd``)."""

import sys

import splatmorph as sm
from splatmorph.runs.export import export_animation
from splatmorph.timeline import Timeline

run = sm.fit_run(*sys.argv[1:3], out="usd.run", overwrite=True)
morph = run.morph(stable_count=True)
export_animation(morph, [0, 0.25, 0.5, 0.75, 1], "morph.usdc", timeline=Timeline(seconds=2))
