"""Landmarks from code, named so that both sides match: ``python 01_… a.ply b.ply``."""

import sys

import splatmorph as sm

source, target = (sm.load_input(path) for path in sys.argv[1:3])
assert source.landmarks
assert target.landmarks
# Any (n, 3) points with names will do; here every fourth of those beside the files.
few = [
    sm.Landmarks(one.landmarks.points[::4], one.landmarks.names[::4]) for one in (source, target)
]
flow = sm.make_flow("node", dim=3)
report = sm.fit(flow, *few)
print(f"{report.landmarks} landmarks, mean square error {report.mse_world:.1e}")
sm.write("half.ply", sm.Morph(source.gaussians, target.gaussians, flow).at(0.5))
