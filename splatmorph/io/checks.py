"""What a stored splat must be for any renderer to show it."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from splatmorph.errors import ReadError, SplatmorphError
from splatmorph.gaussians import Gaussians

# Below this many splats, values that happen to lie in [0, 1] prove nothing.
ENOUGH_TO_JUDGE = 16
# Trained splats are far smaller than the object they draw.
LARGEST_TYPICAL_SPLAT = 0.05


def check_stored(gaussians: Gaussians, path: str | Path) -> None:
    """Refuse values that no renderer can show, and the known mistakes of exporters.

    Raises:
        ReadError: non-finite values, zero quaternions, or opacities and scales that were stored
            already activated. The line says how many and which is the first.
    """
    check_drawable(gaussians, path)
    if len(gaussians) < ENOUGH_TO_JUDGE:
        return
    logits = gaussians.opacity_logits
    if logits.min() >= 0 and logits.max() <= 1 and logits.min() < logits.max():
        raise ReadError(
            f"{path} stores opacities already activated (all within [0, 1]), expected logits, "
            "log(a / (1 - a)): export it again without the sigmoid"
        )
    if scales_look_activated(gaussians):
        raise ReadError(
            f"{path} stores scales already activated (all positive; read as logs the splats would "
            "be as large as the object), expected natural logs: export it again without the exp"
        )


def scales_look_activated(gaussians: Gaussians) -> bool:
    """Whether the scales are standard deviations where their logs should be.

    As logs, such values (small and positive) mean splats of one unit and more each; that this is
    a mistake shows against the size of the object, whatever its unit.
    """
    stored = gaussians.log_scales
    if stored.min() < 0:
        return False
    low, high = torch.quantile(_sample(gaussians.means), torch.tensor([0.02, 0.98]), dim=0)
    extent = (high - low).norm()
    return bool(stored.median().exp() > LARGEST_TYPICAL_SPLAT * extent)


def check_count(splats: int, path: str | Path) -> None:
    """Refuse a file without splats.

    Raises:
        ReadError: there are 0.
    """
    if splats == 0:
        raise ReadError(f"{path} holds 0 splats, expected at least one: export it again")


def check_drawable(
    gaussians: Gaussians, owner: str | Path, error: type[SplatmorphError] = ReadError
) -> None:
    """Refuse values that no renderer can show; ``owner`` begins the line.

    Raises:
        SplatmorphError: as ``error``: non-finite values or zero quaternions. The line says how
            many and which is the first.
    """
    _check_finite(gaussians, owner, error)
    zero = (gaussians.quats == 0).all(dim=1)
    if zero.any():
        raise error(
            f"{owner} has {_count(zero)} with a zero quaternion (rot_0..3), which is no rotation: "
            "expected any length but 0; delete those splats or set them to 1 0 0 0"
        )


def _check_finite(gaussians: Gaussians, owner: str | Path, error: type[SplatmorphError]) -> None:
    fields = {
        "positions (x y z)": gaussians.means,
        "quaternions (rot_0..3)": gaussians.quats,
        "scales (scale_0..2)": gaussians.log_scales,
        "opacities": gaussians.opacity_logits[:, None],
        "colours (f_dc, f_rest)": gaussians.sh.flatten(1),
    }
    for what, values in fields.items():
        # A sum is finite only if every term is, and costs a fraction of a mask.
        if torch.isfinite(values.sum()):
            continue
        bad = ~torch.isfinite(values).all(dim=1)
        if bad.any():
            remedy = (
                "clamp the logits to ±20 or delete those splats"
                if what == "opacities"
                else "delete those splats (SuperSplat does it on import) or export it again"
            )
            raise error(
                f"{owner} has {_count(bad)} with NaN or infinite {what}, expected finite: {remedy}"
            )


def _count(bad: Tensor) -> str:
    n, first = int(bad.sum()), int(bad.nonzero()[0])
    return f"1 splat (number {first})" if n == 1 else f"{n} splats (the first is number {first})"


def _sample(means: Tensor, most: int = 100_000) -> Tensor:
    return means[:: max(1, len(means) // most)]
