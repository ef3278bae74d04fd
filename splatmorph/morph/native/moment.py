"""``moment.h``, compiled once for each degree of the harmonics."""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path as File

import torch
from torch import Tensor

from renderer.cpp import Program
from splatmorph.geometry.harmonics import norm, probes
from splatmorph.morph.paths import TURN, Path

NEAR = 4
"""Knots that a moment lies among, at most."""
MOST_DEGREE = 4


class _Path(ctypes.Structure):
    """The twin of the one in ``moment.h``."""

    _fields_ = tuple((name, ctypes.c_void_p) for name in ("start", "knots"))


class _Arguments(ctypes.Structure):
    """The twin of the one in ``moment.h``."""

    _fields_ = (
        *((name, _Path) for name in ("means", "quats", "log_scales", "turns")),
        *((name, ctypes.c_void_p) for name in ("sh", "drift")),
        *((f"{name}_out", ctypes.c_void_p) for name in ("means", "quats", "log_scales", "sh")),
        *((name, ctypes.c_int64) for name in ("count", "near")),
        ("weights", ctypes.c_float * NEAR),
        ("rest", ctypes.c_float),
        ("way", ctypes.c_float),
    )


@cache
def _program(degree: int) -> Program:
    bands = [probes(order) for order in range(1, degree + 1)]
    directions = torch.cat([direction.flatten() for direction, _ in bands])
    inverses = torch.cat([inverse.flatten() for _, inverse in bands])
    norms = [norm(order, m) if m <= order else 0.0 for order in range(degree + 1) for m in range(5)]
    constants = f"constexpr int DEGREE = {degree}, TURN = {TURN};\n"
    constants += _array("PROBES", directions.tolist())
    constants += _array("INVERSE", inverses.tolist())
    constants += _array("NORMS", norms)
    return Program(File(__file__).parent, ("moment.h",), _Arguments, constants=constants)


def _array(name: str, values: Iterable[float]) -> str:
    return f"constexpr float {name}[] = {{{', '.join(f'{value:.9e}f' for value in values)}}};\n"


def takes(paths: Mapping[str, Path], sh: Tensor, degree: int) -> bool:
    """Whether the moment is for ``moment``: its colours turn, and all of it is of one dtype."""
    starts = [path.start for path in paths.values()]
    return (
        0 < degree <= MOST_DEGREE
        and "turns" in paths
        and all(start.dtype == sh.dtype for start in starts)
        and all(path.knots.is_contiguous() for path in paths.values())
        and _program(degree).takes(sh, *starts)
    )


def moment(
    paths: Mapping[str, Path],
    weights: Tensor,
    sh: Tensor,
    degree: int,
    drift: tuple[Tensor, float] | None,
    room: Mapping[str, Tensor] | None = None,
) -> dict[str, Tensor]:
    """As its plain twin, on all of torch's threads; for what ``takes`` takes.

    It is written into the contiguous tensors of ``room``, if that is given.
    """
    near, count = paths["quats"].knots.shape[:2]
    starts = {name: path.start.contiguous() for name, path in paths.items() if name != "turns"}
    inputs = {"sh": sh.contiguous()}
    if drift is not None:
        inputs["drift"] = drift[0].to(sh).contiguous()
    outputs = {
        name: torch.empty_like(like, memory_format=torch.contiguous_format)
        if room is None
        else room[name]
        for name, like in (*starts.items(), ("sh", sh))
    }
    ways = {
        name: _Path(
            start=starts[name].data_ptr() if name in starts else None,
            knots=path.knots.data_ptr(),
        )
        for name, path in paths.items()
    }
    arguments = _Arguments(
        **ways,
        **{name: tensor.data_ptr() for name, tensor in inputs.items()},
        **{f"{name}_out": tensor.data_ptr() for name, tensor in outputs.items()},
        count=count,
        near=near,
        weights=tuple(weights.tolist()),
        rest=1 - float(weights.sum()),
        way=0.0 if drift is None else drift[1],
    )
    _program(degree).run(arguments, torch.get_num_threads())
    return outputs
