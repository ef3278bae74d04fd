"""One splat into another, and what lies half-way: ``python 00_two_splats.py a.ply b.ply``."""

import sys

import splatmorph as sm

run = sm.fit_run(*sys.argv[1:3], out="a-b.run", overwrite=True)
print(run.legs[0].report["status"])
sm.write("half.ply", run.morph().at(0.5))
