"""Two GaussianAvatars that talk while one turns into the other: ``python 02_… anna/ ben/``.

SPLATMORPH_FLAME names the FLAME model, which is yours to obtain.
"""

import sys

import splatmorph as sm
from splatmorph.avatars import Drive, load_avatar, thin, track_of

anna, ben = (load_avatar(path) for path in sys.argv[1:3])
source, target = thin(anna.landmarks, ben.landmarks, 60)
flow = sm.make_flow("node", dim=3)
sm.fit(flow, source, target)
drive = Drive(anna, ben, flow, track_of(sys.argv[1]), landmarks=source.points, stay=True)
for number, splat in enumerate(drive.sequence([0.0, 0.5, 1.0])):
    sm.write(f"talking_{number:04d}.ply", splat)
