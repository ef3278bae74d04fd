# mypy: ignore-errors
# Warp's annotations are values, which a type checker can't read.
"""The rasterizer's kernels in Warp's own language: one source for CUDA and for any CPU."""

from __future__ import annotations

import math

from renderer import reference
from renderer.quietly import wp

wp.set_module_options({"enable_backward": False})

TILE = wp.constant(16)
BLUR = wp.constant(reference.BLUR)
ALPHA_MAX = wp.constant(reference.ALPHA_MAX)
LOG_ALPHA_MIN = wp.constant(math.log(reference.ALPHA_MIN))
TRANSMITTANCE_MIN = wp.constant(reference.TRANSMITTANCE_MIN)
HIDDEN = wp.constant(0x7FFFFFFF)
"""The depth key of a splat that is not drawn: after every other."""


@wp.struct
class View:
    """A camera as the kernels want it."""

    viewmat: wp.mat44
    to_world: wp.mat33
    focal: wp.vec2
    principal: wp.vec2
    slope_min: wp.vec2
    slope_max: wp.vec2
    near: float
    far: float
    width: int
    height: int
    columns: int
    rows: int


@wp.struct
class Splats:
    """Projected splats, in pixels; indexed as the input."""

    center: wp.array(dtype=wp.vec2)
    conic: wp.array(dtype=wp.vec3)
    extent: wp.array(dtype=wp.vec2)
    log_opacity: wp.array(dtype=float)
    color: wp.array(dtype=wp.vec4)  # rgb and depth


@wp.func
def sh_color(sh: wp.array2d(dtype=wp.vec3), i: int, degree: int, d: wp.vec3) -> wp.vec3:
    """Colour of splat i seen along d; the polynomials of ``reference.sh_basis``."""
    x, y, z = d[0], d[1], d[2]
    xx, yy, zz = x * x, y * y, z * z
    c = 0.28209479177387814 * sh[i, 0]
    if degree > 0:
        c += 0.4886025119029199 * (z * sh[i, 2] - y * sh[i, 1] - x * sh[i, 3])
    if degree > 1:
        c += 1.0925484305920792 * (x * y * sh[i, 4] - y * z * sh[i, 5] - x * z * sh[i, 7])
        c += 0.31539156525252005 * (2.0 * zz - xx - yy) * sh[i, 6]
        c += 0.5462742152960396 * (xx - yy) * sh[i, 8]
    if degree > 2:
        c -= 0.5900435899266435 * y * (3.0 * xx - yy) * sh[i, 9]
        c += 2.890611442640554 * x * y * z * sh[i, 10]
        c -= 0.4570457994644658 * y * (4.0 * zz - xx - yy) * sh[i, 11]
        c += 0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh[i, 12]
        c -= 0.4570457994644658 * x * (4.0 * zz - xx - yy) * sh[i, 13]
        c += 1.445305721320277 * z * (xx - yy) * sh[i, 14]
        c -= 0.5900435899266435 * x * (xx - 3.0 * yy) * sh[i, 15]
    if degree > 3:
        c += 2.5033429417967046 * x * y * (xx - yy) * sh[i, 16]
        c -= 1.7701307697799304 * y * z * (3.0 * xx - yy) * sh[i, 17]
        c += 0.9461746957575601 * x * y * (7.0 * zz - 1.0) * sh[i, 18]
        c -= 0.6690465435572892 * y * z * (7.0 * zz - 3.0) * sh[i, 19]
        c += 0.10578554691520431 * (zz * (35.0 * zz - 30.0) + 3.0) * sh[i, 20]
        c -= 0.6690465435572892 * x * z * (7.0 * zz - 3.0) * sh[i, 21]
        c += 0.47308734787878004 * (xx - yy) * (7.0 * zz - 1.0) * sh[i, 22]
        c -= 1.7701307697799304 * x * z * (xx - 3.0 * yy) * sh[i, 23]
        c += 0.6258357354491761 * (xx * (xx - 3.0 * yy) - yy * (3.0 * xx - yy)) * sh[i, 24]
    return wp.max(c + wp.vec3(0.5), wp.vec3(0.0))


@wp.kernel
def project(
    means: wp.array(dtype=wp.vec3),
    quats: wp.array(dtype=wp.vec4),
    scales: wp.array(dtype=wp.vec3),
    opacities: wp.array(dtype=float),
    sh: wp.array2d(dtype=wp.vec3),
    degree: int,
    view: View,
    splats: Splats,
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
):
    i = wp.tid()
    order[i] = i
    keys[i] = HIDDEN
    p = wp.transform_point(view.viewmat, means[i])
    log_opacity = wp.log(opacities[i])
    reach = 2.0 * (log_opacity - LOG_ALPHA_MIN)
    q = wp.normalize(quats[i])
    drawn = p[2] > view.near and p[2] < view.far and reach >= 0.0 and wp.isfinite(reach)
    if not (drawn and wp.length_sq(q) > 0.5):
        return

    slope = wp.vec2(p[0] / p[2], p[1] / p[2])
    clamped = wp.min(wp.max(slope, view.slope_min), view.slope_max)
    V = view.viewmat
    depth_axis = wp.vec3(V[2, 0], V[2, 1], V[2, 2])
    row_x = (wp.vec3(V[0, 0], V[0, 1], V[0, 2]) - clamped[0] * depth_axis) * (view.focal[0] / p[2])
    row_y = (wp.vec3(V[1, 0], V[1, 1], V[1, 2]) - clamped[1] * depth_axis) * (view.focal[1] / p[2])
    rotation = wp.transpose(wp.quat_to_matrix(wp.quat(q[1], q[2], q[3], q[0])))
    s = scales[i]
    u = wp.cw_mul(rotation * row_x, s)
    v = wp.cw_mul(rotation * row_y, s)
    xx = wp.dot(u, u) + BLUR
    xy = wp.dot(u, v)
    yy = wp.dot(v, v) + BLUR
    # |u×v|² keeps the determinant of a needle, where xx·yy - xy² would cancel.
    det = wp.length_sq(wp.cross(u, v)) + BLUR * (xx + yy - BLUR)
    center = wp.cw_mul(slope, view.focal) + view.principal
    extent = wp.vec2(wp.sqrt(reach * xx), wp.sqrt(reach * yy))
    low = center - extent
    high = center + extent
    # NaN and infinity fail these comparisons too.
    inside = high[0] > 0.0 and high[1] > 0.0 and det > 0.0 and det < 1.0e30
    if not (inside and low[0] < float(view.width) and low[1] < float(view.height)):
        return
    splats.center[i] = center
    splats.conic[i] = wp.vec3(yy / det, -xy / det, xx / det)
    splats.extent[i] = extent
    splats.log_opacity[i] = log_opacity
    rgb = sh_color(sh, i, degree, wp.normalize(view.to_world * p))
    splats.color[i] = wp.vec4(rgb[0], rgb[1], rgb[2], p[2])
    keys[i] = wp.cast(p[2], int)


@wp.func
def tile_box(splats: Splats, view: View, i: int) -> wp.vec4i:
    """First column, first row, last column, last row of the tiles whose pixels it can reach."""
    low = splats.center[i] - splats.extent[i]
    high = splats.center[i] + splats.extent[i]
    size = float(TILE)
    return wp.vec4i(
        int(wp.clamp(wp.floor(low[0] / size), 0.0, float(view.columns - 1))),
        int(wp.clamp(wp.floor(low[1] / size), 0.0, float(view.rows - 1))),
        int(wp.clamp(wp.floor(high[0] / size), 0.0, float(view.columns - 1))),
        int(wp.clamp(wp.floor(high[1] / size), 0.0, float(view.rows - 1))),
    )


@wp.kernel
def count_tiles(
    keys: wp.array(dtype=int),
    order: wp.array(dtype=int),
    view: View,
    splats: Splats,
    counts: wp.array(dtype=wp.int64),
):
    rank = wp.tid()
    counts[rank] = wp.int64(0)
    if keys[rank] != HIDDEN:
        box = tile_box(splats, view, order[rank])
        counts[rank] = wp.int64((box[2] - box[0] + 1) * (box[3] - box[1] + 1))


@wp.kernel
def list_tiles(
    first: int,
    order: wp.array(dtype=int),
    ends: wp.array(dtype=wp.int64),
    view: View,
    splats: Splats,
    tiles: wp.array(dtype=int),
    ids: wp.array(dtype=int),
):
    rank = first + wp.tid()
    done = wp.int64(0)
    before = wp.int64(0)
    if first > 0:
        done = ends[first - 1]
    if rank > 0:
        before = ends[rank - 1]
    if ends[rank] == before:
        return
    at = int(before - done)
    i = order[rank]
    box = tile_box(splats, view, i)
    for row in range(box[1], box[3] + 1):
        for column in range(box[0], box[2] + 1):
            tiles[at] = row * view.columns + column
            ids[at] = i
            at += 1


@wp.kernel
def find_ranges(
    count: int,
    tiles: wp.array(dtype=int),
    starts: wp.array(dtype=int),
    stops: wp.array(dtype=int),
):
    at = wp.tid()
    tile = tiles[at]
    if at == 0 or tiles[at - 1] != tile:
        starts[tile] = at
    if at == count - 1 or tiles[at + 1] != tile:
        stops[tile] = at + 1


@wp.func
def alpha_at(splats: Splats, i: int, pixel: wp.vec2) -> float:
    """What a splat covers of a pixel; 0 where it is too little to be drawn."""
    d = pixel - splats.center[i]
    conic = splats.conic[i]
    falloff = 0.5 * (conic[0] * d[0] * d[0] + conic[2] * d[1] * d[1]) + conic[1] * d[0] * d[1]
    power = splats.log_opacity[i] - falloff
    if power < LOG_ALPHA_MIN:
        return 0.0
    return wp.min(wp.exp(power), ALPHA_MAX)


@wp.kernel
def blend(
    view: View,
    splats: Splats,
    starts: wp.array(dtype=int),
    stops: wp.array(dtype=int),
    ids: wp.array(dtype=int),
    sums: wp.array2d(dtype=wp.vec4),
    transmittance: wp.array2d(dtype=float),
):
    y, x = wp.tid()
    T = transmittance[y, x]
    if T < 0.0:
        return
    tile = (y // TILE) * view.columns + x // TILE
    pixel = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    sum = sums[y, x]
    for at in range(starts[tile], stops[tile]):
        i = ids[at]
        alpha = alpha_at(splats, i, pixel)
        if alpha > 0.0:
            remaining = T * (1.0 - alpha)
            if remaining < TRANSMITTANCE_MIN:
                T = -T  # the pixel is finished; the sign says so to the next slab
                break
            sum += (T * alpha) * splats.color[i]
            T = remaining
    sums[y, x] = sum
    transmittance[y, x] = T


@wp.kernel
def search(
    view: View,
    splats: Splats,
    starts: wp.array(dtype=int),
    stops: wp.array(dtype=int),
    ids: wp.array(dtype=int),
    share: float,
    alphas: wp.array2d(dtype=float),
    transmittance: wp.array2d(dtype=float),
    depth: wp.array2d(dtype=float),
):
    y, x = wp.tid()
    T = transmittance[y, x]
    goal = share * alphas[y, x]
    if T < 0.0 or goal <= 0.0:
        return
    tile = (y // TILE) * view.columns + x // TILE
    pixel = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    for at in range(starts[tile], stops[tile]):
        i = ids[at]
        T *= 1.0 - alpha_at(splats, i, pixel)
        if goal <= 1.0 - T:
            depth[y, x] = splats.color[i][3]
            T = -1.0  # found; the sign says so to the next slab
            break
    transmittance[y, x] = T


@wp.kernel
def gather(
    view: View,
    splats: Splats,
    starts: wp.array(dtype=int),
    stops: wp.array(dtype=int),
    ids: wp.array(dtype=int),
    picture: wp.array3d(dtype=float),
    grain: wp.float64,
    gathered: wp.array2d(dtype=wp.int64),
    transmittance: wp.array2d(dtype=float),
):
    """The shares that ``blend`` gives to colours, times the picture's values at the pixel."""
    y, x = wp.tid()
    T = transmittance[y, x]
    if T < 0.0:
        return
    tile = (y // TILE) * view.columns + x // TILE
    pixel = wp.vec2(float(x) + 0.5, float(y) + 0.5)
    for at in range(starts[tile], stops[tile]):
        i = ids[at]
        alpha = alpha_at(splats, i, pixel)
        if alpha > 0.0:
            remaining = T * (1.0 - alpha)
            if remaining < TRANSMITTANCE_MIN:
                T = -T
                break
            for k in range(picture.shape[2]):
                value = wp.float64(T * alpha * picture[y, x, k]) * grain
                wp.atomic_add(gathered, i, k, wp.int64(value))
            T = remaining
    transmittance[y, x] = T


@wp.kernel
def finish(
    sums: wp.array2d(dtype=wp.vec4),
    transmittance: wp.array2d(dtype=float),
    background: wp.vec3,
    rgb: wp.array2d(dtype=wp.vec3),
    alpha: wp.array2d(dtype=float),
    depth: wp.array2d(dtype=float),
):
    y, x = wp.tid()
    T = wp.abs(transmittance[y, x])
    sum = sums[y, x]
    rgb[y, x] = wp.vec3(sum[0], sum[1], sum[2]) + T * background
    alpha[y, x] = 1.0 - T
    depth[y, x] = 0.0
    if T < 1.0:
        depth[y, x] = sum[3] / (1.0 - T)
