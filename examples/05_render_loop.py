"""A turntable of a morph, frame by frame, as a video: ``python 05_render_loop.py a.ply b.ply``."""

import sys

import splatmorph as sm
from renderer import write_video
from splatmorph.rendering import bounds, there_and_back, turntable

FRAMES = 12
morph = sm.fit_run(*sys.argv[1:3], out="loop.run", overwrite=True).morph(stay=True)
cameras = turntable(bounds(morph.at(0), morph.at(1)), FRAMES, size=(96, 96))
splats = morph.sequence(there_and_back(FRAMES))
frames = (sm.render(splat, camera) for splat, camera in zip(splats, cameras, strict=True))
write_video("loop.mp4", frames, fps=12)
