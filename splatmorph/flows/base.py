"""Flow: the one-parameter group of warps that a morph travels along."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, ClassVar, Self

import torch
from torch import Tensor, nn

from splatmorph.errors import OptionError

Times = Sequence[float] | Tensor

KINDS: dict[str, type[Flow]] = {}
"""Every flow that has been defined, by its ``kind``."""


class Flow(nn.Module):
    """Φ(x, t): R^dim × R → R^dim with Φ(x, 0) = x and Φ(Φ(x, s), t) = Φ(x, s + t).

    So the inverse of Φ(·, t) is Φ(·, -t), and a landmark pair (p, q) is met when
    Φ(p, t) = Φ(q, t - 1) for one t, hence for all of them.

    The public methods take and return world units. Inside, the flow lives in its *frame*: one
    similarity, world = center + scale · unit, that ``fit`` chooses so that the landmarks of both
    sides fill [-1, 1]^dim, and that is saved with the weights. Everything is computed in the
    dtype of the points that are asked about. No parameter requires a gradient outside of ``fit``.

    A subclass names its ``kind``, by which :func:`make_flow` finds it, and answers in unit
    coordinates by the methods whose names begin with ``unit_``. It must give ``unit_forward``; all
    others have a default that differentiates it, which a subclass replaces where it knows better.
    ``splatmorph.fitting`` fits it by the paper's objective unless told another way.
    """

    kind: ClassVar[str]
    center: Tensor
    scale: Tensor

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**keywords)
        if "kind" in vars(cls):
            KINDS[cls.kind] = cls

    @classmethod
    def make(cls, dim: int, **options: Any) -> Self:
        """An unfitted flow in R^dim, with the keyword arguments of its constructor.

        Raises:
            OptionError: there is no such option.
        """
        check_options(f"flow '{cls.kind}'", options, options_of(cls))
        return cls(dim, **options)

    def __init__(self, dim: int) -> None:
        super().__init__()
        if dim not in (2, 3):
            raise ValueError(f"dim is {dim}, expected 2 or 3")
        self.dim = dim
        self.register_buffer("center", torch.zeros(dim, dtype=torch.float64))
        self.register_buffer("scale", torch.ones((), dtype=torch.float64))

    def set_frame(self, center: Tensor, scale: float) -> None:
        """Lay the frame: ``center`` (dim,) in world units, ``scale`` world units a unit."""
        self.center.copy_(center)
        self.scale.fill_(scale)

    def to_unit(self, x: Tensor) -> Tensor:
        """World points (m, dim) in the frame."""
        return (x - self.center.to(x)) / self.scale.to(x)

    def _to_world(self, x: Tensor, start: Tensor, moved: Tensor) -> Tensor:
        # As a displacement, so that no rounding moves a point that the flow leaves in place.
        if moved.requires_grad:
            return x + self.scale.to(x) * (moved - start)
        return torch.addcmul(x, moved - start, self.scale.to(x))

    def velocity(self, x: Tensor) -> Tensor:
        """∂Φ/∂t(x, 0): (m, dim) world points -> (m, dim) world units per unit of t."""
        return self.scale.to(x) * self.unit_velocity(self.to_unit(x))

    def velocity_jacobian(self, x: Tensor) -> Tensor:
        """∂v/∂x: (m, dim) world points -> (m, dim, dim), rows the components of v."""
        return self.unit_velocity_jacobian(self.to_unit(x))

    def forward(self, x: Tensor, t: float | Tensor) -> Tensor:
        """Φ(x, t): (m, dim) world points, ``t`` a float or one time a point (m,) -> (m, dim)."""
        unit = self.to_unit(x)
        return self._to_world(x, unit, self.unit_forward(unit, t))

    def trajectory(self, x: Tensor, times: Times) -> Tensor:
        """Φ(x, t) for every t: (m, dim) world points, T times -> (T, m, dim), in one pass.

        The times may come in any order, repeat, and have either sign.
        """
        unit = self.to_unit(x)
        moved, _ = self.unit_trajectory(unit, as_floats(times), jacobian=False)
        return self._to_world(x, unit, moved)

    def trajectory_jacobian(self, x: Tensor, times: Times) -> tuple[Tensor, Tensor]:
        """Φ(x, t) and ∂Φ/∂x(x, t) for every t: -> (T, m, dim) and (T, m, dim, dim)."""
        unit = self.to_unit(x)
        moved, jacobians = self.unit_trajectory(unit, as_floats(times), jacobian=True)
        assert jacobians is not None
        return self._to_world(x, unit, moved), jacobians

    def jacobian(self, x: Tensor, t: float) -> Tensor:
        """∂Φ/∂x(x, t): (m, dim) world points -> (m, dim, dim)."""
        return self.trajectory_jacobian(x, [t])[1][0]

    def config(self) -> dict[str, Any]:
        """What ``flow_from_config`` needs to rebuild this flow before its state is loaded."""
        return {"kind": self.kind, "dim": self.dim}

    def initialise(self, generator: torch.Generator) -> None:
        """Draw the weights anew, for a training: by default those of torch's own layers."""
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(generator.initial_seed())
            for module in self.modules():
                if callable(reset := getattr(module, "reset_parameters", None)):
                    reset()

    def unit_forward(self, u: Tensor, t: float | Tensor) -> Tensor:
        """Φ(u, t) in the frame, (m, dim) -> (m, dim); ``t`` a float or one time a point (m,)."""
        raise NotImplementedError

    def unit_velocity(self, u: Tensor) -> Tensor:
        """v(u) = ∂Φ/∂t(u, 0) in the frame, (m, dim) -> (m, dim)."""
        start = torch.zeros_like(u[:, 0])
        return self._slopes(lambda t: self.unit_forward(u, t), start, u.requires_grad)

    def unit_velocity_jacobian(self, u: Tensor) -> Tensor:
        """∂v/∂u in the frame, (m, dim) -> (m, dim, dim)."""
        return self._slopes(self.unit_velocity, u, u.requires_grad)

    def unit_trajectory(
        self, u: Tensor, times: list[float], *, jacobian: bool
    ) -> tuple[Tensor, Tensor | None]:
        """Φ(u, t) for every t and, where asked, ∂Φ/∂u: (T, m, dim), (T, m, dim, dim)."""
        moved = u.new_empty(len(times), *u.shape)
        slopes = u.new_empty(len(times), *u.shape, self.dim) if jacobian else None
        for i, t in enumerate(times):
            moved[i] = self.unit_forward(u, t)
            if slopes is not None:
                slopes[i] = self._slopes(partial(self.unit_forward, t=t), u, u.requires_grad)
        return moved, slopes

    @torch.enable_grad()
    def _slopes(self, function: Callable[[Tensor], Tensor], x: Tensor, linked: bool) -> Tensor:
        """∂f/∂x of f, (m, …) -> (m, dim), point by point: (m, dim, …).

        ``linked``: whether what f reaches beside x is differentiated too.
        """
        if not x.requires_grad:
            x = x.detach().requires_grad_()
        keep = linked or any(parameter.requires_grad for parameter in self.parameters())
        y = function(x)
        if not y.requires_grad:
            return x.new_zeros(*y.shape, *x.shape[1:])
        rows = [
            torch.autograd.grad(
                y[:, i].sum(), x, retain_graph=True, create_graph=keep, materialize_grads=True
            )[0]
            for i in range(self.dim)
        ]
        return torch.stack(rows, dim=1)


def options_of(made: Callable[..., Any]) -> dict[str, Any]:
    """The keyword arguments of a flow's or a field's constructor, with their defaults."""
    parameters = inspect.signature(made).parameters.values()
    return {one.name: one.default for one in parameters if one.kind is one.KEYWORD_ONLY}


def check_options(what: str, given: Mapping[str, Any], known: Mapping[str, Any]) -> None:
    """Refuse options that ``what`` doesn't have, and values of another kind than the default's.

    Raises:
        OptionError: names the first of them, and those that there are.
    """
    for name, value in given.items():
        if name not in known:
            there = f"choose of {', '.join(known)}" if known else "it has none"
            raise OptionError(f"{what} has no option '{name}': {there}")
        if not _of_one_kind(value, known[name]):
            raise OptionError(
                f"{what}: option '{name}' is {value!r}, expected one like {known[name]!r}"
            )


def _of_one_kind(value: Any, default: Any) -> bool:
    if default is None or default is inspect.Parameter.empty:
        return True
    if isinstance(default, float):
        return type(value) in (int, float) and math.isfinite(value)
    return type(value) is type(default)


def as_floats(times: Times) -> list[float]:
    """The times as plain floats."""
    return [float(t) for t in times]


def as_column(t: float | Tensor, u: Tensor) -> Tensor:
    """A time or one time a point as a tensor that multiplies points (m, dim)."""
    column = torch.as_tensor(t, dtype=u.dtype, device=u.device)
    return column[:, None] if column.ndim else column
