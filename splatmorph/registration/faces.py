"""A face on a splat, wherever it is and however it is turned, as points in space.

Search all round, look from the front until the view settles, then from fifteen sides; the rays of
all views through one landmark are triangulated. The rendered depth is not trusted with more than
a rough start: where a splat is see-through it is what is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from renderer.cameras import UPRIGHT
from splatmorph.gaussians import UPS, Gaussians
from splatmorph.registration.face_network import (
    IRIS,
    LEFT_EYE,
    POINTS,
    RIGHT_EYE,
    Box,
    FaceNetwork,
    turned,
)
from splatmorph.registration.views import Array, Cameras, looking, photograph, spiral
from splatmorph.rendering import bounds_of, renderer_arrays

WHITE = (1.0, 1.0, 1.0)

DIRECTIONS = 48
"""On the sphere, 30 degrees apart."""
ROLLS = range(0, 360, 45)
SEARCH_SIDE, SEARCH_FOV = 256, 30.0
TILES = 4
"""Where no face is found, pictures this many times as large are searched in overlapping tiles."""
DETECTED = 0.5
LOOKED_AT, JUDGED = 8, 3
"""Candidates that get landmarks, and that are looked at from the front."""

SIDE, CLOSE_FOV = 512, 20.0
CLEAR = 0.65
"""The score from which a face tells what is up: upright heads have 0.75 and more."""
LEANS = math.radians(45)
"""A face that leans less stands upright."""
FRONT_ROUNDS, FRONT_DETECTED = 3, 0.3
FRONT_ROOM, VIEW_ROOM = 1.68, 1.575
"""Radius of the ball in view, in sizes of the face (outer eye corners to chin)."""
YAWS, PITCHES = (-40, -20, 0, 20, 40), (-20, 0, 20)

FACING = 0.35
"""A view says nothing of a point whose normal looks farther away (70 degrees)."""
FEWEST_VIEWS = 3
CAUCHY = 0.01
"""Of the face's size: rays that miss by more are outliers."""
MOST_RESIDUAL = 0.025
"""Root mean square distance of the rays from their point, of the face's size."""
MOST_OFF_SURFACE = 0.10
"""Of the face's size: such a point hangs in the air or lies deep inside."""
FRONT_OF_FACE = 3.0
"""Sizes before the face where drawing begins: floaters nearer don't count."""

MIDDLE = (1, 4, 5, 6, 9, 50, 280, 151, 199)
"""On nose, cheeks and chin, where depth means most."""
RIGHT_SIDE, LEFT_SIDE = (33, 234, 61), (263, 454, 291)
EYES, LOWER = (33, 263, 133, 362), (152, 61, 291)
CHIN = 152
SKIN = IRIS.start
"""Points 0 to 467 lie on the skin."""


@dataclass(frozen=True)
class FoundFace:
    """A face in space."""

    points: Array
    """(478, 3) in the splat's units; nan where the views disagree or the surface is elsewhere."""
    confidence: Array
    """(478,) in [0, 1], 0 where there is no point."""
    value: float
    """0 to 1: how much it looks like a face, from the front."""


@dataclass(frozen=True)
class _Axes:
    """Of a face: unit vectors, middle, and the distance of the outer eye corners from the chin."""

    right: Array
    """Of the picture: the person's left."""
    up: Array
    front: Array
    center: Array
    size: float

    @staticmethod
    def of(points: Array) -> _Axes:
        def middle(which: tuple[int, ...]) -> Array:
            return np.asarray(np.nanmean(points[list(which)], 0))

        right = _unit(middle(LEFT_SIDE) - middle(RIGHT_SIDE))
        up = middle(EYES) - middle(LOWER)
        up = _unit(up - up @ right * right)
        size = float(np.linalg.norm(middle((RIGHT_EYE, LEFT_EYE)) - points[CHIN]))
        return _Axes(right, up, np.cross(right, up), np.nanmean(points[:SKIN], 0), size)

    def camera(self, yaw: float, pitch: float, room: float) -> Cameras:
        """One camera that looks at the face from yaw and pitch in degrees."""
        a, b = math.radians(yaw), math.radians(pitch)
        level = math.cos(a) * self.front + math.sin(a) * self.right
        direction = math.cos(b) * level + math.sin(b) * self.up
        return looking(
            self.center, direction[None], self.up[None], room * self.size, SIDE, CLOSE_FOV
        )


@dataclass(frozen=True)
class _Sighting:
    """What the detector says of one picture, turned by its roll."""

    direction: int
    roll: int
    """Degrees."""
    box: Box
    picture: NDArray[np.uint8]
    back: Array
    """(2, 3): pixels of the turned picture → of the camera's."""
    camera: Cameras
    depth: NDArray[np.float32]


@dataclass(frozen=True)
class _Shot:
    """One view of the face."""

    camera: Cameras
    pixels: Array
    """(478, 2) of the landmarks."""
    depth: NDArray[np.float32]


def find_face(gaussians: Gaussians, network: FaceNetwork) -> FoundFace | None:
    """The clearest face of a splat, or None; any direction may be up."""
    candidates = _search(gaussians, network, 1) or _search(gaussians, network, TILES)
    best: tuple[float, Array] | None = None
    for world in candidates[:JUDGED]:
        value, points = _settle(gaussians, network, world)
        if best is None or value > best[0]:
            best = value, points
    if best is None or best[0] == 0:
        return None
    value, points = best
    shots = _shoot(gaussians, network, points)
    return _triangulated(shots, points, value)


def upright_face(gaussians: Gaussians, network: FaceNetwork) -> tuple[str, float] | None:
    """Which axis points up where a face stands upright, and the detector's score.

    Quick: only faces that look along an axis are seen. None where there is none.
    """
    means, _, scales, opacities, _ = renderer_arrays(gaussians)
    bounds = bounds_of(means, opacities, scales)
    axes = {name: np.array(axis, float) for name, axis in UPS.items()}
    seen: list[tuple[float, float, str]] = []
    for up, direction in ((u, d) for u in UPRIGHT for d in axes if not axes[u] @ axes[d]):
        camera = looking(
            bounds.center,
            axes[direction][None],
            axes[up][None],
            1.05 * bounds.radius,
            SEARCH_SIDE,
            SEARCH_FOV,
        )
        for box in network.detect(_picture(gaussians, camera)[0], DETECTED)[:1]:
            seen.append((box.score, box.angle, up))
    score, angle, up = max(seen, default=(0.0, 0.0, ""))
    return (up, score) if score > CLEAR and abs(angle) < LEANS else None


def _search(gaussians: Gaussians, network: FaceNetwork, tiles: int) -> list[Array]:
    """Landmarks (478, 3) of what looks like faces from some direction, the likeliest first."""
    means, _, scales, opacities, _ = renderer_arrays(gaussians)
    bounds = bounds_of(means, opacities, scales)
    directions = spiral(DIRECTIONS)
    ups = np.stack([_perpendicular(direction) for direction in directions])
    side = tiles * SEARCH_SIDE
    radius = 1.05 * bounds.radius
    seen: list[_Sighting] = []
    for i in range(DIRECTIONS):
        camera = looking(
            bounds.center, directions[i : i + 1], ups[i : i + 1], radius, side, SEARCH_FOV
        )
        rgb, depth = _picture(gaussians, camera)
        for roll in ROLLS:
            picture, back = turned(network.cv2, rgb, roll)
            boxes = _detect(network, picture, tiles)
            if boxes:
                seen.append(_Sighting(i, roll, boxes[0], picture, back, camera, depth))
    seen.sort(key=lambda one: -one.box.score)
    found: list[tuple[float, Array]] = []
    tried: list[tuple[int, int]] = []
    for one in seen:
        if any(
            one.direction == direction and abs((one.roll - roll + 180) % 360 - 180) < 90
            for direction, roll in tried
        ):
            continue
        tried.append((one.direction, one.roll))
        face = network.face(one.picture, one.box)
        xy = face.points[:, :2] @ one.back[:, :2].T + one.back[:, 2]
        world = _hung(one.camera, np.c_[xy, face.points[:, 2]], one.depth)
        if world is not None:
            found.append((face.value, world))
        if len(tried) == LOOKED_AT:
            break
    return [world for _, world in sorted(found, key=lambda pair: -pair[0])]


def _detect(network: FaceNetwork, picture: NDArray[np.uint8], tiles: int) -> list[Box]:
    """Faces of a picture, or of its overlapping tiles of the detector's usual size."""
    if tiles == 1:
        return network.detect(picture, DETECTED)
    found = []
    for top in range(0, len(picture) - SEARCH_SIDE + 1, SEARCH_SIDE // 2):
        for left in range(0, len(picture) - SEARCH_SIDE + 1, SEARCH_SIDE // 2):
            tile = picture[top : top + SEARCH_SIDE, left : left + SEARCH_SIDE]
            if tile.min() == 255:
                continue
            for box in network.detect(np.ascontiguousarray(tile), DETECTED)[:1]:
                center = box.center + np.array([left, top])
                found.append(Box(center, box.size, box.angle, box.score))
    return sorted(found, key=lambda box: -box.score)


def _settle(gaussians: Gaussians, network: FaceNetwork, world: Array) -> tuple[float, Array]:
    """Look from the front, upright, and find the face anew, until the view has settled."""
    value = 0.0
    for _ in range(FRONT_ROUNDS):
        camera = _Axes.of(world).camera(0, 0, FRONT_ROOM)
        rgb, depth = _picture(gaussians, camera)
        face = network.find(rgb, FRONT_DETECTED)
        hung = None if face is None else _hung(camera, face.points, depth)
        if face is None or hung is None:
            return 0.0, world
        value, world = face.value, hung
    return value, world


def _shoot(gaussians: Gaussians, network: FaceNetwork, points: Array) -> list[_Shot]:
    """The landmarks as fifteen views show them."""
    axes = _Axes.of(points)
    shots = []
    for pitch in PITCHES:
        for yaw in YAWS:
            camera = axes.camera(yaw, pitch, VIEW_ROOM)
            nearest = float(np.linalg.norm(camera.positions[0] - axes.center))
            rgb, depth = _picture(gaussians, camera, nearest - FRONT_OF_FACE * axes.size)
            pixels = camera.pixels(camera.of_camera(0, points))
            for _ in range(2):
                pixels = network.look_again(rgb, pixels)[:, :2]
            shots.append(_Shot(camera, pixels, depth))
    return shots


def _picture(
    gaussians: Gaussians, camera: Cameras, near: float | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """What one camera sees on white, and the depth of the surface."""
    shown = photograph(gaussians, camera, background=WHITE, near=near)
    rgb = (np.clip(shown.rgb[0], 0, 1) * 255 + 0.5).astype(np.uint8)
    return rgb, np.where(shown.alpha[0] > 0.5, shown.depth[0], np.nan).astype(np.float32)


def _hung(camera: Cameras, points: Array, depth: NDArray[np.float32]) -> Array | None:
    """World points of landmarks (478, 3) by the network's own z, hung at the picture's depth."""
    middle = points[list(MIDDLE)]
    surface = _depth_at(depth, middle[:, :2])
    if not np.isfinite(surface).any():
        return None
    z = np.nanmedian(surface - middle[:, 2] * np.nanmedian(surface) / camera.focal)
    depths = z + points[:, 2] * z / camera.focal
    across = (points[:, :2] - camera.side / 2) / camera.focal * depths[:, None]
    return camera.to_world(0, np.c_[across, depths])


def _depth_at(depth: NDArray[np.float32], pixels: Array) -> Array:
    column, row = np.clip(np.nan_to_num(pixels), 0, len(depth) - 1).astype(int).T
    return depth[row, column].astype(np.float64)


def _triangulated(shots: list[_Shot], start: Array, value: float) -> FoundFace:
    front = _Axes.of(start).front
    size = _Axes.of(start).size
    eyes = np.concatenate([shot.camera.positions for shot in shots])
    rays = np.stack([shot.camera.rays(0, shot.pixels) for shot in shots], 1)
    points = start
    for _ in range(2):
        facing = -np.einsum("kvc,kc->kv", rays, _normals(points, front))
        weights = np.where(facing > FACING, facing, 0.0) ** 2
        weights[(weights > 0).sum(1) < FEWEST_VIEWS] = 0
        points, residual, views = _meet(eyes, rays, weights, CAUCHY * size)
    off = _off_surface(shots, points, facing)
    kept = (residual < MOST_RESIDUAL * size) & (np.abs(off) < MOST_OFF_SURFACE * size)
    kept &= views >= FEWEST_VIEWS
    kept[list(IRIS)] = False
    sure = 1 / (1 + (residual / (MOST_RESIDUAL * size)) ** 2)
    return FoundFace(np.where(kept[:, None], points, np.nan), np.where(kept, sure, 0.0), value)


def _meet(
    eyes: Array, rays: Array, weights: Array, width: float
) -> tuple[Array, Array, NDArray[np.int64]]:
    """The points nearest to all rays (k, v, 3) from eyes (v, 3), by Cauchy's loss.

    -> points (k, 3), root mean square distances of the rays (k,), views that agree (k,).
    """
    across = np.eye(3) - rays[..., :, None] * rays[..., None, :]
    known = weights.sum(1) > 0
    robust = weights.copy()
    points = np.full((len(rays), 3), np.nan)
    distance = np.full(weights.shape, np.nan)
    for _ in range(10):
        normal = np.einsum("kv,kvij->kij", robust[known], across[known])
        right = np.einsum("kv,kvij,vj->ki", robust[known], across[known], eyes)
        points[known] = np.linalg.solve(normal, right[..., None])[..., 0]
        offset = points[:, None] - eyes
        distance = np.linalg.norm(np.einsum("kvij,kvj->kvi", across, offset), axis=2)
        robust = np.where(weights > 0, weights / (1 + (distance / width) ** 2), 0.0)
    total = np.where(known, weights.sum(1), np.nan)
    square = (weights * np.nan_to_num(distance) ** 2).sum(1) / total
    agree = ((robust > 0.2 * weights) & (weights > 0)).sum(1)
    return points, np.sqrt(square), agree


def _off_surface(shots: list[_Shot], points: Array, facing: Array) -> Array:
    """(478,) depth of the surface beyond each point, in the view that faces it best."""
    off = np.full(len(points), np.nan)
    best = np.where(np.isfinite(points[:, 0]), facing.argmax(1), -1)
    for i, shot in enumerate(shots):
        mine = np.flatnonzero(best == i)
        seen = shot.camera.of_camera(0, points[mine])
        off[mine] = _depth_at(shot.depth, shot.camera.pixels(seen)) - seen[:, 2]
    return off


def _normals(points: Array, front: Array) -> Array:
    """Unit normals (478, 3) of the face's points, by their neighbours."""
    skin = points[:SKIN].copy()
    lost = ~np.isfinite(skin).all(1)
    skin[lost] = np.nanmedian(skin, 0)
    near = skin[cKDTree(skin).query(skin, 14)[1]]
    normals = np.linalg.svd(near - near.mean(1, keepdims=True))[2][:, 2]
    normals *= np.where(normals @ front > 0, 1.0, -1.0)[:, None]
    return np.concatenate([normals, np.tile(front, (POINTS - SKIN, 1))])


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _perpendicular(direction: Array) -> Array:
    """An up for a direction: the axis that is least along it."""
    axis = np.eye(3)[np.argmin(np.abs(direction))]
    return _unit(axis - axis @ direction * direction)
