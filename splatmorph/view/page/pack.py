"""The page's payload: splats at rest, their moves and shapes at the knots, opacity tables."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.morph.agreement.fade import DENSEST_STACK
from splatmorph.morph.covariance import polar_rotation
from splatmorph.morph.ramps import RAMPS
from splatmorph.morph.transport import Drift
from splatmorph.rendering import orbit
from splatmorph.view.knots import FINEST, fewest_knots, knot_times, knot_weights
from splatmorph.view.subject import Subject

PICTURE_HEIGHT = 1080
"""Pixels of the picture in which the error of a move is counted."""
TOLERANCE = 0.5
"""Pixels a path between its knots may be off, before rounding."""
LOG_SCALE_SPAN = 12.0
"""Natural log of the largest scale over the smallest that is told from nothing."""
RAMP_STEPS = 65
GROWTH_STEP = 2.0**-13
"""Of the natural log of the factor by which a ramp scales a splat: ±4 in 16 bits."""
SAMPLE = 4096

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Packed:
    """What the page is told, beside its texts."""

    arrays: Mapping[str, NDArray[np.generic]]
    facts: Mapping[str, object]
    """JSON beside the arrays: knots, ranges, the first camera."""
    knots: int
    error_px: float
    """The largest distance between a stored path and the flow's, in a 1080-pixel picture."""


def pack(subject: Subject, kept: tuple[torch.Tensor, torch.Tensor], up: str) -> Packed:
    """Pack those splats of source and target that are ``kept``, and all that moves them."""
    morph = subject.morph
    sides = (morph.source.select(kept[0]), morph.target.select(kept[1]))
    agreements = [one.select(index) for one, index in zip(morph.agreement(), kept, strict=True)]
    height = PICTURE_HEIGHT
    camera = orbit(subject.bounds(), [0.0], up=up, width=height, height=height)[0]
    center = subject.bounds().center
    distance = float(np.linalg.norm(camera.position - center))
    pixel = distance / float(camera.K[1, 1])
    right, down, forward = camera.viewmat[:3, :3]

    drifts = [one.drift for one in agreements]
    motion = _Motion(subject, sides, drifts, TOLERANCE * pixel)
    moves, move_scale = _rounded(motion.moves())
    deforms, deform_scale = _rounded_shapes(motion.deforms())
    still, ranges = _at_rest(Gaussians.union(*sides), torch.cat([one.sh for one in drifts]))
    lead = torch.cat([one.lead for one in agreements]).double().numpy(force=True)
    still["others"] |= np.rint(256 * lead).astype(np.uint32) << 24
    density = torch.cat([one.density for one in agreements]).double().numpy(force=True)
    still["densities"] = np.rint(255 * np.sqrt(density / DENSEST_STACK)).astype(np.uint8)
    ends = {
        "source": motion.landmarks(subject.source_points, 0),
        "target": motion.landmarks(subject.target_points, 1),
    }
    arrays = {**still, "moves": moves, "deforms": deforms, **_ramp_tables()}
    facts = {
        **ranges,
        "knots": motion.times.tolist(),
        "moveScale": move_scale.tolist(),
        "deformScale": deform_scale,
        "rampNames": list(RAMPS),
        "rampSteps": RAMP_STEPS,
        "growthStep": GROWTH_STEP,
        "densest": DENSEST_STACK,
        "landmarks": {"names": list(subject.landmark_names), **ends},
        "camera": {
            "center": center.tolist(),
            "right": right.tolist(),
            "up": (-down).tolist(),
            "back": (-forward).tolist(),
            "distance": distance,
            "azimuth": 0.0,
            "elevation": 0.0,
            "fov": 2 * math.atan(height / 2 / float(camera.K[1, 1])),
            "near": min(0.01, 0.01 * distance),
        },
    }
    error = motion.error(moves * move_scale) / pixel
    return Packed(arrays, facts, len(motion.times), error)


class _Motion:
    """The paths of both sides, at the fewest knots that keep them within ``tolerance``."""

    def __init__(
        self,
        subject: Subject,
        sides: tuple[Gaussians, Gaussians],
        drifts: Sequence[Drift],
        tolerance: float,
    ) -> None:
        self.flow = subject.morph.flow
        self.sides, self.drifts = sides, drifts
        self.covariance = subject.morph.covariance
        finest = knot_times(FINEST)
        paths = [
            self.paths(side.means[:: max(1, len(side) // SAMPLE)], i, finest)
            for i, side in enumerate(sides)
        ]
        self.times = knot_times(fewest_knots(np.concatenate(paths, axis=1), tolerance))

    @torch.no_grad()
    def paths(self, points: torch.Tensor, side: int, times: Array) -> Array:
        """(T, m, 3) where points of the source (side 0) or target (1) are at ``times``."""
        moved = self.flow.trajectory(points, (times - side).tolist())
        return np.asarray(moved.double().numpy(force=True))

    def landmarks(self, points: torch.Tensor, side: int) -> list[list[list[float]]]:
        """k landmarks × knots × 3."""
        return [path.tolist() for path in self.paths(points, side, self.times).swapaxes(0, 1)]

    def _ways(self, side: int) -> Array:
        """The knots away from a side's own end."""
        return self.times[1:] if side == 0 else self.times[:-1]

    def moves(self) -> Array:
        """(n, knots - 1, 3) from each splat's own end to the other knots."""
        found = []
        for i, side in enumerate(self.sides):
            paths = self.paths(side.means, i, self._ways(i))
            moved = (paths - side.means.double().numpy(force=True)).swapaxes(0, 1)
            offset = self.drifts[i].offset.double().numpy(force=True)
            found.append(moved + np.abs(self._ways(i) - i)[:, None] * offset[:, None])
        return np.concatenate(found)

    @torch.no_grad()
    def deforms(self) -> Array:
        """(n, knots - 1, 3, 3) what each shape is multiplied by, less the identity; or none."""
        if self.covariance == "fixed":
            return np.empty((0, 3, 3))
        found = []
        for i, side in enumerate(self.sides):
            times = (self._ways(i) - i).tolist()
            flowed = self.flow.trajectory_jacobian(side.means, times)[1]
            ways = flowed.new_tensor(times).abs()[:, None, None, None]
            shapes = (flowed + ways * self.drifts[i].slope.to(flowed)).flatten(0, 1)
            if self.covariance == "rotate":
                shapes = polar_rotation(shapes.permute(1, 2, 0)).permute(2, 0, 1)
            found.append(shapes.unflatten(0, (len(times), -1)).transpose(0, 1))
        return torch.cat(found).double().numpy(force=True) - np.eye(3)

    def error(self, moves: Array) -> float:
        """The largest miss of the stored moves half way between the knots, world units."""
        checks = (self.times[1:] + self.times[:-1]) / 2
        first = len(self.sides[0])
        worst = 0.0
        for i, (side, kept) in enumerate(zip(self.sides, np.split(moves, [first]), strict=True)):
            step = max(1, len(side) // SAMPLE)
            start, kept = side.means[::step], kept[::step]
            truth = self.paths(start, i, checks) - start.double().numpy(force=True)
            offset = self.drifts[i].offset[::step].double().numpy(force=True)
            truth = truth + np.abs(checks - i)[:, None, None] * offset
            for t, moved in zip(checks, truth, strict=True):
                weights = knot_weights(self.times, t)
                weights = weights[1:] if i == 0 else weights[:-1]
                missed = np.einsum("k,nkd->nd", weights, kept) - moved
                worst = max(worst, float(np.linalg.norm(missed, axis=1).max(initial=0)))
        return worst


def _at_rest(
    both: Gaussians, change: torch.Tensor
) -> tuple[dict[str, NDArray[Any]], dict[str, object]]:
    """Splats at their own ends, with the colours that ``change`` (n, k, 3) makes of them."""
    log_scales = both.log_scales.double().numpy(force=True)
    top = float(log_scales.max())
    low = max(float(log_scales.min()), top - LOG_SCALE_SPAN)
    share = np.clip((log_scales - low) / max(top - low, 1e-6), 0, 1)
    steps = np.rint(share * [2047, 2047, 1023]).astype(np.uint32)
    base = both.sh[:, 0].double()
    own, other = (
        np.maximum(0.5 + SH0 * sh.numpy(force=True), 0) for sh in (base, base + change[:, 0])
    )
    brightest = float(max(1.0, np.quantile(own, 0.999), np.quantile(other, 0.999)))
    # Opacities as square roots: most are small, and small ones need the finer steps.
    roots = np.sqrt(both.opacities.double().numpy(force=True))
    bytes_ = np.column_stack([np.minimum(own / brightest, 1), roots])
    others = np.column_stack([np.minimum(other / brightest, 1), 0 * roots])
    arrays = {
        "centers": both.means.float().numpy(force=True),
        "colours": np.rint(255 * bytes_).astype(np.uint8).view("<u4").ravel(),
        "others": np.rint(255 * others).astype(np.uint8).view("<u4").ravel(),
        "rotations": _packed_rotations(both.quats.double().numpy(force=True)),
        "logScales": steps[:, 0] | steps[:, 1] << 11 | steps[:, 2] << 22,
    }
    return arrays, {"logScaleRange": [low, top], "colourScale": brightest}


def _packed_rotations(quats: Array) -> NDArray[np.uint32]:
    """Quaternions as the place of their largest component and the other three in 10 bits each."""
    quats = quats / np.linalg.norm(quats, axis=1, keepdims=True)
    place = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, place] < 0, -1, 1)[:, None]
    others = np.array([[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]])[place]
    small = quats[rows[:, None], others] * math.sqrt(2)
    steps = np.rint(511 * (np.clip(small, -1, 1) + 1)).astype(np.uint32)
    return np.asarray(
        steps[:, 0] | steps[:, 1] << 10 | steps[:, 2] << 20 | place.astype(np.uint32) << 30
    )


def _rounded(values: Array) -> tuple[NDArray[np.int16], Array]:
    """Values (…, 3) in 16 bits, and the (3,) steps that give them back."""
    step = np.maximum(np.abs(values).max(axis=(0, 1), initial=0), 1e-30) / 32767
    return np.rint(values / step).astype(np.int16), step


def _rounded_shapes(deforms: Array) -> tuple[NDArray[np.int8], float]:
    """(…, 3, 3) in bytes, columns first as shaders take them. The wildest 1 ‰ are cut."""
    if not deforms.size:
        return np.empty(0, np.int8), 0.0
    most = max(float(np.quantile(np.abs(deforms).max(axis=(1, 2, 3)), 0.999)), 1e-30)
    columns = deforms.swapaxes(-1, -2) / most * 127
    return np.rint(np.clip(columns, -127, 127)).astype(np.int8), most / 127


def _ramp_tables() -> dict[str, NDArray[np.generic]]:
    """What each ramp makes of the 256 stored opacities at each weight: (ramps, RAMP_STEPS, 256).

    ``fades``: the opacity, in 65535ths; ``growths``: the change of log scale, in GROWTH_STEPs.
    """
    stored = (torch.arange(256, dtype=torch.float64) / 255).square()
    some = Gaussians(
        torch.zeros(256, 3),
        torch.zeros(256, 4),
        torch.zeros(256, 3, dtype=torch.float64),
        stored.clamp(1e-12, 1 - 1e-12).logit(),
        torch.zeros(256, 1, 3),
    )
    fades = np.zeros((len(RAMPS), RAMP_STEPS, 256))
    growths = np.zeros_like(fades)
    for i, ramp in enumerate(RAMPS.values()):
        for k, weight in enumerate(np.linspace(0, 1, RAMP_STEPS)[1:-1], start=1):
            faded = ramp(some, float(weight))
            fades[i, k], growths[i, k] = faded.opacities, faded.log_scales[:, 0]
    growths[:, 0] = growths[:, 1]
    fades[:, -1] = stored
    fades[:, :, 0] = 0
    return {
        "fades": np.rint(65535 * fades).astype(np.uint16),
        "growths": np.rint(growths / GROWTH_STEP).clip(-32767, 32767).astype(np.int16),
    }
