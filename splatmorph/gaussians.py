"""Gaussians: the one container of a splat."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from splatmorph.geometry.harmonics import rotate_sh
from splatmorph.geometry.quaternions import from_matrices, normalized, product
from splatmorph.geometry.similarity import Similarity
from splatmorph.steady import one_thread

MAX_SH_DEGREE = 4
FAINTEST_DRAWN = 1 / 255
"""Opacity below which no rasterizer draws a splat: leaving it out changes no picture."""

PART = 1 << 15
"""Splats that are moved at a time."""

UPS: Mapping[str, tuple[int, int, int]] = {
    "x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "y": (0, 1, 0),
    "-y": (0, -1, 0),
    "z": (0, 0, 1),
    "-z": (0, 0, -1),
}
"""The axes that may point up."""
STILL_UP = math.cos(math.radians(30))
"""An axis leans less than this and still is what a person would call up."""


@dataclass(frozen=True)
class Gaussians:
    """A set of n anisotropic 3D Gaussians in the stored parametrisation.

    The fields hold what a splat file holds (log scales, opacity logits, quaternions as they
    came), so that reading and writing lose no bit; the properties give what is rendered.

    Raises ``ValueError`` where the shapes don't agree: a programming error, not a data error
    (files are checked by the module that reads them).
    """

    means: Tensor
    """(n, 3) centers, world units."""
    quats: Tensor
    """(n, 4) rotations local → world, wxyz, as stored: may be unnormalised."""
    log_scales: Tensor
    """(n, 3) natural log of the standard deviations along the local axes, world units."""
    opacity_logits: Tensor
    """(n,) logit of the opacity."""
    sh: Tensor
    """(n, (degree + 1)**2, 3) spherical-harmonic colour coefficients, RGB last."""
    extras: Mapping[str, Tensor] = field(default_factory=dict)
    """Properties of the file that we don't know, one (n,) tensor each, kept for writing."""
    up: str | None = None
    """Which axis points up, one of ``UPS``; None where nothing says so."""
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """What to add to the centers for the coordinates of the file: where these are large beside
    the splats (surveys), single precision holds only what is left of them."""

    def __post_init__(self) -> None:
        n = self.means.shape[0]
        shapes = {
            "means": (self.means, (n, 3)),
            "quats": (self.quats, (n, 4)),
            "log_scales": (self.log_scales, (n, 3)),
            "opacity_logits": (self.opacity_logits, (n,)),
            "sh": (self.sh, (n, self.sh.shape[1] if self.sh.ndim == 3 else -1, 3)),
            **{name: (value, (n,)) for name, value in self.extras.items()},
        }
        if self.up is not None and self.up not in UPS:
            raise ValueError(f"up is {self.up!r}, expected one of {', '.join(UPS)}")
        for name, (value, shape) in shapes.items():
            if tuple(value.shape) != shape:
                raise ValueError(f"{name} has shape {tuple(value.shape)}, expected {shape}")
        if (self.sh_degree + 1) ** 2 != self.sh.shape[1] or self.sh_degree > MAX_SH_DEGREE:
            raise ValueError(
                f"sh has {self.sh.shape[1]} coefficients a channel, expected 1, 4, 9, 16 or 25"
            )

    def __len__(self) -> int:
        return int(self.means.shape[0])

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 4."""
        return math.isqrt(self.sh.shape[1]) - 1

    @property
    def scales(self) -> Tensor:
        """(n, 3) standard deviations along the local axes, world units."""
        return self.log_scales.exp()

    @property
    def opacities(self) -> Tensor:
        """(n,) opacities in [0, 1]."""
        return self.opacity_logits.sigmoid()

    @property
    def absolute_means(self) -> Tensor:
        """(n, 3) float64 centers in the coordinates of the file."""
        means = self.means.double()
        return means + means.new_tensor(self.offset)

    @one_thread()
    def moved(self, similarity: Similarity, *, in_place: bool = False) -> Gaussians:
        """The splats at x ↦ s R x + t: centers, Σ' = s² R Σ Rᵀ, and colours that turn with them.

        ``up`` turns too, and is lost where it ends between the axes. What nobody else holds may be
        moved ``in_place``.
        """
        if similarity.is_identity:
            return self
        turn = from_matrices(similarity.rotation).to(self.quats.device)
        made = self
        if not in_place:
            names = ("means", "quats", "log_scales", "sh")
            room: dict[str, Any] = {name: torch.empty_like(getattr(self, name)) for name in names}
            made = replace(self, **room)
        # By parts: double precision takes much memory.
        for begin in range(0, len(self), PART):
            part = slice(begin, begin + PART)
            made.means[part] = similarity(self.means[part])
            made.quats[part] = product(turn, normalized(self.quats[part].double())).to(self.quats)
            made.log_scales[part] = self.log_scales[part] + math.log(similarity.scale)
            made.sh[part] = rotate_sh(self.sh[part], similarity.rotation.to(self.sh.device))
        return replace(made, up=_turned_up(self.up, similarity.rotation))

    def select(self, index: Tensor | slice) -> Gaussians:
        """The splats at ``index``: a (m,) tensor of indices, an (n,) boolean mask or a slice."""
        return replace(
            self,
            means=self.means[index],
            quats=self.quats[index],
            log_scales=self.log_scales[index],
            opacity_logits=self.opacity_logits[index],
            sh=self.sh[index],
            extras={name: value[index] for name, value in self.extras.items()},
        )

    def with_sh_degree(self, degree: int) -> Gaussians:
        """The same splats with the SH cut to, or padded with zeros to, ``degree``."""
        wanted = (degree + 1) ** 2
        have = self.sh.shape[1]
        if have == wanted:
            return self
        kept = self.sh[:, : min(have, wanted)]
        padding = kept.new_zeros(len(self), max(0, wanted - have), 3)
        return replace(self, sh=torch.cat([kept, padding], dim=1))

    @staticmethod
    def union(first: Gaussians, second: Gaussians, room: Gaussians | None = None) -> Gaussians:
        """All splats of both, ``first`` before ``second``: G⁰ ∪ G¹ of the paper's eq. 7.

        The SH degree is the higher one; extras that only one side has are dropped, since they
        would have no value on the other. The offset is the first one's; which axis is up, what
        either says if the other doesn't gainsay it. With ``room``, as many splats of that degree,
        they are put there; what is there already isn't copied.
        """
        degree = max(first.sh_degree, second.sh_degree)
        a, b = first.with_sh_degree(degree), second.with_sh_degree(degree)
        shared = [name for name in a.extras if name in b.extras]
        means = b.means
        if a.offset != b.offset:
            means = (b.absolute_means - b.absolute_means.new_tensor(a.offset)).to(means.dtype)
        fields = {
            "means": (a.means, means),
            "quats": (a.quats, b.quats),
            "log_scales": (a.log_scales, b.log_scales),
            "opacity_logits": (a.opacity_logits, b.opacity_logits),
            "sh": (a.sh, b.sh),
        }
        places = {name: None if room is None else vars(room)[name] for name in fields}
        return Gaussians(
            **{name: _together(*both, places[name]) for name, both in fields.items()},
            extras={name: torch.cat([a.extras[name], b.extras[name]]) for name in shared},
            up=(a.up or b.up) if None in (a.up, b.up) or a.up == b.up else None,
            offset=a.offset,
        )


def _together(first: Tensor, second: Tensor, room: Tensor | None) -> Tensor:
    if room is None:
        return torch.cat([first, second])
    for part, place in ((first, room[: len(first)]), (second, room[len(first) :])):
        if part.data_ptr() != place.data_ptr():
            place.copy_(part)
    return room


def _turned_up(up: str | None, rotation: Tensor) -> str | None:
    if up is None:
        return None
    turned = rotation @ rotation.new_tensor(UPS[up])
    nearest, cosine = max(
        ((name, float(turned @ turned.new_tensor(axis))) for name, axis in UPS.items()),
        key=lambda found: found[1],
    )
    return nearest if cosine > STILL_UP else None
