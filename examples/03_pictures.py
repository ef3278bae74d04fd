"""Pictures from code: five moments side by side: ``python 03_pictures.py a.ply b.ply``."""

import sys

import numpy as np

import splatmorph as sm
from renderer import orbit, write_image
from splatmorph.rendering import bounds

morph = sm.fit_run(*sys.argv[1:3], out="pictures.run", overwrite=True).morph(stay=True)
times = [0, 0.25, 0.5, 0.75, 1]
(camera,) = orbit(bounds(morph.at(0), morph.at(1)), [20.0], width=96, height=96)
pictures = [sm.render(splat, camera) for splat in morph.sequence(times)]
write_image("row.png", np.concatenate(pictures, axis=1))
