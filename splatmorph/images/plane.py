"""A picture as a plane of splats: the way into the whole 3D path."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import interpolate

from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.images.picture import Picture

WIDTH = 0.5
"""Standard deviation of a splat, in distances between them: neighbours melt, details stay."""

THIN = 1e-4
"""The same across the plane, world units."""

OPACITY = 0.99
SH_CONSTANT = 0.5 / math.sqrt(math.pi)
"""The spherical harmonic of degree 0."""


def as_splats(picture: Picture, columns: int | None = None) -> Gaussians:
    """One flat Gaussian a pixel, or ``columns`` of them across, in the plane z = 0, facing +z.

    World units are those of ``Canvas``. Alpha becomes the splat's opacity.
    """
    canvas = picture.canvas
    planes = picture.with_channels(4).planes()
    across = columns or canvas.width
    down = max(1, round(canvas.height * across / canvas.width))
    if across < canvas.width:
        planes = interpolate(planes[None], (down, across), mode="bilinear", antialias=True)[0]
    x, y = (torch.arange(count) + 0.5 for count in (across, down))
    pixels = torch.stack(torch.meshgrid(x, y, indexing="xy"), dim=-1)
    size = torch.tensor([canvas.width / across, canvas.height / down])
    places = canvas.to_world(pixels * size).reshape(-1, 2)
    count = len(places)
    alpha = planes[3].reshape(-1)
    colours = planes[:3].reshape(3, -1).T / alpha.clamp_min(1e-6)[:, None]
    sides = (WIDTH * size * canvas.pixel).expand(count, 2)
    return Gaussians(
        means=torch.cat([places, torch.zeros(count, 1)], dim=1),
        quats=torch.tensor([1.0, 0.0, 0.0, 0.0]).expand(count, 4).clone(),
        log_scales=torch.cat([sides, torch.full((count, 1), THIN)], dim=1).log(),
        opacity_logits=(alpha * OPACITY).clamp_min(1e-6).logit(),
        sh=((colours - 0.5) / SH_CONSTANT)[:, None],
    )


class PlaneFlow(Flow):
    """A flow of the plane as one of space: (x, y, z) goes to (Φ(x, y), z)."""

    kind = "plane"

    def __init__(self, flow: Flow) -> None:
        super().__init__(3)
        self.flow = flow

    def unit_velocity(self, u: Tensor) -> Tensor:
        """(v(x, y), 0)."""
        return torch.cat([self.flow.velocity(u[:, :2]), torch.zeros_like(u[:, 2:])], dim=1)

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """∂v/∂u, zero across the plane."""
        return _embedded(self.flow.velocity_jacobian(u[:, :2]), 0.0)

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """(Φ(x, y, t), z)."""
        return torch.cat([self.flow(u[:, :2], t), u[:, 2:]], dim=1)

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """(Φ(x, y, t), z) for every t."""
        height = u[:, 2:].expand(len(times), -1, 1)
        if not jacobian:
            return torch.cat([self.flow.trajectory(u[:, :2], times), height], dim=2), None
        moved, jacobians = self.flow.trajectory_jacobian(u[:, :2], times)
        return torch.cat([moved, height], dim=2), _embedded(jacobians, 1.0)


def _embedded(matrices: Tensor, corner: float) -> Tensor:
    """(..., 2, 2) -> (..., 3, 3), with ``corner`` for the third axis."""
    space = matrices.new_zeros(*matrices.shape[:-2], 3, 3)
    space[..., :2, :2] = matrices
    space[..., 2, 2] = corner
    return space
