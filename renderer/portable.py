"""The rasterizer in Warp's own language, for CUDA and for any CPU.

Splats are projected, sorted by depth, listed for each tile they touch in that order, and
blended by one thread a pixel. Where the lists would outgrow ``LIST_BUDGET`` the picture is
made in slabs of depth, front to back, that keep each pixel's state between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from renderer import kernels
from renderer.errors import ArgumentError
from renderer.views import View

Array = NDArray[Any]

SCENE_TYPES = {
    "means": wp.vec3,
    "quats": wp.vec4,
    "scales": wp.vec3,
    "opacities": float,
    "sh": wp.vec3,
}
SPLAT_TYPES = {
    "center": wp.vec2,
    "conic": wp.vec3,
    "extent": wp.vec2,
    "log_opacity": float,
    "color": wp.vec4,
}
VIEW_TYPES = {
    "viewmat": wp.mat44,
    "to_world": wp.mat33,
    **dict.fromkeys(("focal", "principal", "slope_min", "slope_max"), wp.vec2),
}
LIST_BUDGET = 1 << 25
"""Entries of the tile lists at a time: 16 bytes each with the sort's scratch."""


def check_device(device: str) -> None:
    """Raise ArgumentError where Warp has no such device."""
    try:
        wp.get_device(device)
    except (ValueError, RuntimeError) as error:
        names = ", ".join(repr(known.alias) for known in wp.get_devices())
        raise ArgumentError(f"device is {device!r}, expected one of {names} here") from error


def _warp_view(view: View) -> kernels.View:
    made = kernels.View()
    for name, value in view._asdict().items():
        setattr(made, name, VIEW_TYPES[name](*value) if name in VIEW_TYPES else value)
    made.columns, made.rows = -(-view.width // kernels.TILE), -(-view.height // kernels.TILE)
    return made


def render(
    scene: Mapping[str, Array],
    degree: int,
    views: Sequence[View],
    background: Array,
    share: float,
    device: str,
) -> tuple[Array, Array, Array]:
    """rgb (c, h, w, 3), alpha (c, h, w) and depth (c, h, w) of c views of one size.

    The depth is that at which ``share`` of the alpha is gathered, at 0 the mean.
    """
    arrays = _on_device(scene, device)
    shape = (len(views), views[0].height, views[0].width)
    rgb = wp.empty(shape, dtype=wp.vec3, device=device)
    alpha = wp.empty(shape, dtype=float, device=device)
    depth = wp.empty(shape, dtype=float, device=device)
    for i, view in enumerate(views):
        frame = _Frame(arrays, degree, _warp_view(view), device)
        sums = wp.zeros(shape[1:], dtype=wp.vec4, device=device)
        transmittance = wp.ones(shape[1:], dtype=float, device=device)
        frame.launch(kernels.blend, [sums, transmittance])
        inputs = [sums, transmittance, wp.vec3(*background.tolist()), rgb[i], alpha[i], depth[i]]
        wp.launch(kernels.finish, shape[1:], inputs, device=device)
        if share > 0:
            clear = wp.ones(shape[1:], dtype=float, device=device)
            frame.launch(kernels.search, [share, alpha[i], clear, depth[i]])
    return rgb.numpy(), alpha.numpy(), depth.numpy()


def gather(
    scene: Mapping[str, Array], views: Sequence[View], pictures: Array, grain: float, device: str
) -> Array:
    """What splats add to the pixels of c views, times ``pictures`` (c, h, w, k).

    Returns the sums (n, k) over views and pixels, int64 in 1/grain.
    """
    arrays = _on_device(scene, device)
    sums = wp.zeros((len(arrays[0]), pictures.shape[-1]), dtype=wp.int64, device=device)
    for view, picture in zip(views, pictures, strict=True):
        values: wp.array = wp.array(picture, dtype=float, device=device)
        clear = wp.ones((view.height, view.width), dtype=float, device=device)
        frame = _Frame(arrays, 0, _warp_view(view), device)
        frame.launch(kernels.gather, [values, wp.float64(grain), sums, clear])
    return sums.numpy()


def _on_device(scene: Mapping[str, Array], device: str) -> list[wp.array]:
    return [
        wp.array(scene[name], dtype=dtype, copy=False, device=device)
        for name, dtype in SCENE_TYPES.items()
    ]


class _Frame:
    """The splats of one view, projected and sorted."""

    def __init__(
        self, arrays: Sequence[wp.array], degree: int, view: kernels.View, device: str
    ) -> None:
        self.n, self.view, self.device = len(arrays[0]), view, device
        if not self.n:
            return
        self.splats = kernels.Splats()
        for name, dtype in SPLAT_TYPES.items():
            setattr(self.splats, name, wp.empty(self.n, dtype=dtype, device=device))
        # Twice the length: the second half is the sort's scratch.
        keys = wp.empty(2 * self.n, dtype=int, device=device)
        self.order = wp.empty(2 * self.n, dtype=int, device=device)
        self.ends = wp.empty(self.n, dtype=wp.int64, device=device)
        inputs = [*arrays, degree, view, self.splats, keys, self.order]
        wp.launch(kernels.project, self.n, inputs, device=device)
        wp.utils.radix_sort_pairs(keys, self.order, self.n)
        inputs = [keys, self.order, view, self.splats, self.ends]
        wp.launch(kernels.count_tiles, self.n, inputs, device=device)
        wp.utils.array_scan(self.ends, self.ends, inclusive=True)

    def launch(self, kernel: wp.Kernel, inputs: Sequence[Any]) -> None:
        """Run a kernel over all pixels, for each slab of depth, front to back."""
        if not self.n:
            return
        shape = (self.view.height, self.view.width)
        for slab in _slabs(self.ends):
            ids, starts, stops = _tile_lists(slab, self.order, self.ends, self.view, self.splats)
            lists = [self.view, self.splats, starts, stops, ids]
            wp.launch(kernel, shape, [*lists, *inputs], device=self.device)


def _slabs(ends: wp.array) -> list[tuple[int, int, int]]:
    """Runs of depth ranks whose lists fit the budget: (first, last, entries)."""
    n = len(ends)
    total = int(ends[n - 1 : n].numpy()[0])
    if total <= LIST_BUDGET:
        return [(0, n, total)] if total else []
    sums = ends.numpy()
    slabs, first, done = [], 0, 0
    while done < total:
        last = int(np.searchsorted(sums, done + LIST_BUDGET, side="right"))
        slabs.append((first, last, int(sums[last - 1]) - done))
        first, done = last, int(sums[last - 1])
    return slabs


def _tile_lists(
    slab: tuple[int, int, int],
    order: wp.array,
    ends: wp.array,
    view: kernels.View,
    splats: kernels.Splats,
) -> tuple[wp.array, wp.array, wp.array]:
    """Splats by tile, each tile front to back: ids, and where each tile starts and stops."""
    first, last, count = slab
    device = order.device
    tile_count = view.columns * view.rows
    tiles = wp.empty(2 * count, dtype=int, device=device)
    ids = wp.empty(2 * count, dtype=int, device=device)
    wp.launch(
        kernels.list_tiles,
        last - first,
        [first, order, ends, view, splats, tiles, ids],
        device=device,
    )
    wp.utils.radix_sort_pairs(tiles, ids, count, end_bit=max(1, tile_count.bit_length()))
    starts = wp.zeros(tile_count, dtype=int, device=device)
    stops = wp.zeros(tile_count, dtype=int, device=device)
    wp.launch(kernels.find_ranges, count, [count, tiles, starts, stops], device=device)
    return ids, starts, stops
