"""What the tests of pages and their benchmark share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from driven import Driven

from renderer import rasterize
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph
from splatmorph.view.scene import Scene
from splatmorph.view.subject import Subject

GROUND = (0.1, 0.1, 0.12)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(np.square(a.astype(float) - b).mean()))


def our_picture(browser: Driven, splats: Gaussians) -> np.ndarray:
    """Our rasterizer's picture from where the page's camera stands."""
    view = browser.evaluate("splatmorph.view()")
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = view["rows"], view["shift"]
    (cx, cy), f = view["middle"], view["focal"]
    rgb, _, _ = rasterize(
        splats.means.numpy(),
        splats.quats.numpy(),
        splats.scales.numpy(),
        splats.opacities.numpy(),
        splats.sh.numpy(),
        viewmat,
        np.array([[f, 0, cx], [0, f, cy], [0, 0, 1]]),
        view["width"],
        view["height"],
        background=GROUND,
    )
    return np.asarray(rgb).clip(0, 1)


class Swirl(Flow):
    """A turn about the z axis by ``angle`` a unit of t, with a drift along it."""

    kind = "swirl"

    def __init__(self, angle: float = 0.8) -> None:
        super().__init__(3)
        self.angle = angle

    def unit_forward(self, u, t):
        return self.unit_trajectory(u, [t], jacobian=False)[0][0]

    def unit_trajectory(self, u, times, *, jacobian):
        turns = torch.zeros(len(times), 3, 3, dtype=u.dtype)
        drifts = torch.zeros(len(times), 3, dtype=u.dtype)
        for turn, drift, t in zip(turns, drifts, times, strict=True):
            c, s = np.cos(self.angle * t), np.sin(self.angle * t)
            turn[:] = torch.tensor([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            drift[2] = 0.1 * t
        moved = u @ turns.transpose(1, 2) + drifts[:, None]
        return moved, turns[:, None].expand(-1, len(u), -1, -1) if jacobian else None


def blob(n: int, seed: int, colour: tuple[float, float, float]) -> Gaussians:
    """n anisotropic splats on a lumpy ball, of about one colour."""
    g = torch.Generator().manual_seed(seed)
    means = torch.nn.functional.normalize(torch.randn(n, 3, generator=g), dim=1)
    means = means * torch.tensor([1.0, 0.7, 0.5]) * (1 + 0.1 * torch.sin(5 * means[:, :1]))
    tint = torch.tensor(colour) + 0.25 * torch.sin(7 * means)
    return Gaussians(
        means,
        torch.randn(n, 4, generator=g),
        torch.log(torch.tensor([0.09, 0.05, 0.01])) + 0.4 * torch.randn(n, 3, generator=g),
        2 * torch.randn(n, generator=g),
        ((tint - 0.5) / 0.28209479)[:, None],
    )


def shaded(splats: Gaussians, degree: int) -> Gaussians:
    """The same with colours that depend on the direction."""
    g = torch.Generator().manual_seed(9)
    more = 0.6 * torch.randn(len(splats), (degree + 1) ** 2 - 1, 3, generator=g)
    return replace(splats, sh=torch.cat([splats.sh, more], 1))


def subject(n: int = 1200, blend: str = "union", **options) -> Subject:
    source, target = blob(n, 1, (0.7, 0.4, 0.2)), blob(n, 2, (0.2, 0.5, 0.7))
    flow = Swirl()
    points = source.means[:5].double()
    return Subject(
        Morph(source, target, flow, blend=blend, **options),
        source_points=points,
        target_points=flow(points, 1.0),
        landmark_names=tuple(f"mark {i}" for i in range(5)),
    )


def scene(n: int = 1200, **options) -> Scene:
    return Scene.of(subject(n, **options))
