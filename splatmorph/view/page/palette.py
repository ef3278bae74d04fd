"""Colours as a page carries them: a constant part in bytes, and how it changes with the view."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from splatmorph.geometry.harmonics import SH0

SH1 = 0.4886025119029199
"""The harmonics of degree 1 are SH1 · (-y, z, -x): √(3/4π)."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Palette:
    """One range and one step for all splats of a page. The wildest 1 ‰ are cut.

    Harmonics (n, k, 3) to degree 1 are kept, higher ones left out.
    """

    low: float
    high: float
    """Of the constant part."""
    shade_step: float
    """Of what the colour gains along an axis of the viewing direction; 0 where it never does."""

    @staticmethod
    def of(found: Sequence[Tensor]) -> Palette:
        """The palette that holds the colours of all harmonics that were found."""
        bases = np.concatenate([_base(sh) for sh in found])
        low, high = np.quantile(bases, [0.001, 0.999])
        gradients = [np.abs(_gradient(sh)).ravel() for sh in found if sh.shape[1] > 1]
        if not gradients:
            return Palette(0.0, max(1.0, float(high)), 0.0)
        steepest = float(np.quantile(np.concatenate(gradients), 0.999))
        return Palette(min(0.0, float(low)), max(1.0, float(high)), max(steepest, 1e-6) / 127)

    def colours(self, sh: Tensor) -> NDArray[np.uint8]:
        """(n, 3) bytes of the constant part."""
        share = (_base(sh) - self.low) / (self.high - self.low)
        return np.rint(255 * share.clip(0, 1)).astype(np.uint8)

    def shades(self, sh: Tensor) -> NDArray[np.int8]:
        """(n, 9) gains along x, y and z, red first; none where no colour ever changes."""
        if not self.shade_step:
            return np.empty((0, 9), np.int8)
        if sh.shape[1] == 1:
            return np.zeros((len(sh), 9), np.int8)
        return np.rint((_gradient(sh) / self.shade_step).clip(-127, 127)).astype(np.int8)


def _base(sh: Tensor) -> Array:
    return np.asarray(0.5 + SH0 * sh[:, 0].double().numpy(force=True))


def _gradient(sh: Tensor) -> Array:
    """(n, 9): degree 1 as the gradient that it is."""
    y, z, x = sh[:, 1:4].double().numpy(force=True).swapaxes(0, 1)
    return SH1 * np.stack([-x, -y, z], axis=2).reshape(-1, 9)
