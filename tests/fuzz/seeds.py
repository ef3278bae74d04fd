"""Whole files for every reader, small ones, all made here."""

from __future__ import annotations

import io as streams
import json
import pickle  # noqa: TID251 - to write what the restricted reader reads
import struct
from collections import OrderedDict
from pathlib import Path
from typing import Any

import numpy as np
import scipy.sparse
import torch
import zstandard
from PIL import Image

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.landmarks import Landmarks
from tests.splats import random_gaussians

WRITTEN_ELSEWHERE = Path(__file__).parents[1] / "io" / "formats"


def splats(n: int = 20, degree: int = 1, seed: int = 0) -> Gaussians:
    """A splat of n small ones."""
    return random_gaussians(n, degree, seed)


def splat_files(folder: Path) -> list[Path]:
    """In every format that is written, and in the layouts that only others write."""
    made = []
    for extension in io.FORMATS:
        if io.FORMATS[extension].animated:
            # USD's own library reads those, and doesn't load within the fuzzer's memory.
            continue
        for degree in (0, 1, 3):
            path = folder / f"{degree}{extension}"
            try:
                io.write(path, splats(degree=degree))
            except Exception:  # a format that is only read
                continue
            made.append(path)
    plain = (folder / "0.ply").read_bytes()
    header, _, body = plain.partition(b"end_header\n")
    values = np.frombuffer(body, "<f4").reshape(20, -1)
    text = header.replace(b"binary_little_endian", b"ascii") + b"end_header\n"
    rows = "\n".join(" ".join(f"{value:.6g}" for value in row) for row in values)
    made.append(_put(folder / "text.ply", text + rows.encode() + b"\n"))
    big = header.replace(b"little", b"big") + b"end_header\n" + values.astype(">f4").tobytes()
    made.append(_put(folder / "big.ply", big))
    faces = b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    listed = header + faces + body + b"\x03" + struct.pack("<3i", 0, 1, 2)
    made.append(_put(folder / "faces.ply", listed))
    names = (b"property float opacity\n", b"property float binding_0\nproperty float opacity\n")
    bound = np.insert(values, 9, np.arange(20), axis=1).astype("<f4").tobytes()
    made.append(_put(folder / "bound.ply", header.replace(*names) + b"end_header\n" + bound))
    made.append(_put(folder / "v4.spz", _spz4()))
    return made + [
        _put(folder / f"other-{path.name}", path.read_bytes())
        for path in sorted(WRITTEN_ELSEWHERE.glob("*"))
        if path.is_file() and path.stat().st_size < 1 << 16
    ]


def _spz4() -> bytes:
    rng = np.random.default_rng(4)
    parts = [rng.integers(0, 255, 20 * size, np.uint8).tobytes() for size in (9, 1, 3, 3, 4, 9)]
    frames = [zstandard.compress(part) for part in parts]
    table = b"".join(struct.pack("<QQ", len(f), len(p)) for f, p in zip(frames, parts, strict=True))
    header = struct.pack("<4sIIBBBBI", b"NGSP", 4, 20, 1, 12, 0, len(parts), 20)
    return header + table + b"".join(frames)


def landmark_files(folder: Path) -> list[Path]:
    """Ten points of space in every format of landmarks."""
    points = np.random.default_rng(1).normal(size=(10, 3)).round(3)
    names = [f"point {i}" for i in range(10)]
    Landmarks(torch.from_numpy(points), tuple(names)).write(folder / "named.json")
    _put(folder / "listed.json", json.dumps(points.tolist()))
    _put(
        folder / "sure.json",
        json.dumps({"points": points.tolist(), "confidence": [0.5] * 10}),
    )
    records = [
        {"name": name, "position": row} for name, row in zip(names, points.tolist(), strict=True)
    ]
    _put(folder / "records.json", json.dumps(records))
    np.save(folder / "points.npy", points)
    np.savez(folder / "named.npz", points=points, names=np.array(names))
    np.savez_compressed(folder / "small.npz", points=points)
    rows = [f"{name},{x},{y},{z}" for name, (x, y, z) in zip(names, points, strict=True)]
    _put(folder / "table.csv", "\n".join(["name,x,y,z", *rows]))
    _put(folder / "bare.txt", "\n".join(f"{x} {y} {z}" for x, y, z in points))
    _put(folder / "table.tsv", "\n".join(row.replace(",", "\t") for row in rows))
    _put(folder / "bare.xyz", "10\n" + "\n".join(f"{x} {y} {z}" for x, y, z in points))
    control = [
        {"label": name, "position": row} for name, row in zip(names, points.tolist(), strict=True)
    ]
    _put(folder / "slicer.mrk.json", json.dumps({"markups": [{"controlPoints": control}]}))
    fiducials = "\n".join(f"id{i},{x},{y},{z},1,n{i}" for i, (x, y, z) in enumerate(points))
    _put(folder / "slicer.fcsv", f"# columns = id,x,y,z,vis,label\n{fiducials}\n")
    picked = "".join(
        f'<point x="{x}" y="{y}" z="{z}" name="{name}" active="1"/>\n'
        for name, (x, y, z) in zip(names, points, strict=True)
    )
    _put(folder / "picked.pp", f"<!DOCTYPE PickedPoints>\n<PickedPoints>\n{picked}</PickedPoints>")
    return sorted(folder.iterdir())


def plane_files(folder: Path) -> list[Path]:
    """Five points of a picture of 64 × 64, in every format of those."""
    rows = [[3, 4], [50, 6], [45, 55], [7, 60], [31, 30]]
    lines = "\n".join(f"{x} {y}" for x, y in rows)
    _put(folder / "a.tem", f"5\n{lines}\n1\n0\n2\n0 1\n")
    _put(folder / "a.pts", f"version: 1\nn_points: 5\n{{\n{lines}\n}}\n")
    _put(folder / "a.json", json.dumps({"convention": "pixels-xy", "points": rows}))
    _put(folder / "pair.json", json.dumps({"points_0": [[0, 0.1]] * 3, "points_1": [[0.1, 0]] * 3}))
    _put(folder / "a.csv", "# convention: pixels-xy\nx,y\n" + lines.replace(" ", ","))
    np.savez(folder / "a.npz", points=np.array(rows), convention=np.array("pixels-xy"))
    return sorted(folder.iterdir())


def picture_files(folder: Path) -> list[Path]:
    """A small picture in every format and depth."""
    pixels = np.random.default_rng(2).integers(0, 255, (12, 16, 4), np.uint8)
    colour, alpha = Image.fromarray(pixels[..., :3].copy()), Image.fromarray(pixels)
    grey = Image.fromarray(pixels[..., 0].astype(np.uint16) * 250)
    for name, picture in {
        "a.png": colour,
        "alpha.png": alpha,
        "deep.png": grey,
        "palette.png": colour.convert("P"),
        "a.jpg": colour,
        "a.webp": colour,
        "a.tif": colour,
        "deep.tif": grey,
        "a.bmp": colour,
        "a.ppm": colour,
        "a.gif": colour.convert("P"),
    }.items():
        picture.save(folder / name)
    return sorted(folder.iterdir())


def camera_files(folder: Path) -> list[Path]:
    """Paths as NeRF and nerfstudio write them."""
    matrix = np.eye(4)
    matrix[2, 3] = 3
    frames = [{"file_path": "a.png", "transform_matrix": matrix.tolist()}] * 3
    _put(folder / "nerf.json", json.dumps({"camera_angle_x": 0.7, "frames": frames}))
    lens = {"w": 64, "h": 48, "fl_x": 80.0, "fl_y": 81.0, "cx": 32.0, "cy": 24.0}
    _put(folder / "transforms.json", json.dumps({**lens, "frames": frames}))
    keys = [{"camera_to_world": matrix.ravel().tolist(), "fov": 50, "aspect": 1.3}] * 3
    path = {"camera_path": keys, "render_width": 64, "render_height": 48, "fps": 24, "seconds": 1}
    _put(folder / "path.json", json.dumps(path))
    inria = {"width": 64, "height": 48, "fx": 80.0, "fy": 80.0, "position": [0, 0, -3]}
    _put(folder / "cameras.json", json.dumps([inria | {"rotation": np.eye(3).tolist()}] * 2))
    _put(folder / "cameras.txt", "# lenses\n1 PINHOLE 64 48 80 80 32 24\n")
    poses = "\n".join(f"{i} 1 0 0 0 0 0 3 1 {i}.png\n1.5 2.5 -1" for i in range(3))
    _put(folder / "images.txt", f"# poses\n{poses}\n")
    return [path for path in sorted(folder.iterdir()) if path.name != "cameras.txt"]


def pickle_files(folder: Path) -> list[Path]:
    """What FLAME is made of, small: arrays, matrices of scipy, tensors."""
    rng = np.random.default_rng(3)
    stored = {
        "v_template": rng.normal(size=(5, 3)),
        "f": np.arange(6, dtype=np.uint32).reshape(2, 3),
        "turned": rng.normal(size=(4, 3)).T,
        "J_regressor": scipy.sparse.csc_matrix(np.eye(3, 5)),
        "rows": scipy.sparse.coo_matrix(np.eye(4)),
        "weights": [[0.5, 0.5], [1, 0]],
        "style": "lbs",
        "number": np.float64(2.5),
        "more": OrderedDict(objects=np.array([None, {"a": 1}], dtype=object)),
    }
    for protocol in (0, 2, 4, 5):
        _put(folder / f"{protocol}.pkl", pickle.dumps(stored, protocol))
    tensors = {"weights": torch.arange(6.0).reshape(2, 3).T, "faces": torch.arange(4)}
    _put(folder / "tensors.pkl", pickle.dumps(tensors, 2))
    chumpy = b"ccopy_reg\n_reconstructor\n(cchumpy.ch\nCh\nc__builtin__\nobject\nNtR}(U\x01x"
    inner = pickle.dumps(rng.normal(size=(2, 3)), 2)[2:-1]
    _put(folder / "chumpy.pkl", b"\x80\x02}U\x01a" + chumpy + inner + b"ubs.")
    np.save(folder / "embedding.npy", np.array(tensors, dtype=object), allow_pickle=True)
    return sorted(folder.iterdir())


def track_files(folder: Path) -> list[Path]:
    """Motion of a head in three frames."""
    rng = np.random.default_rng(5)
    widths = {"expr": 10, "rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6}
    stored = {name: rng.normal(size=(3, width)) for name, width in widths.items()}
    stored |= {"translation": np.zeros((3, 3)), "shape": rng.normal(size=30)}
    np.savez(folder / "flame_param.npz", **stored)
    np.savez_compressed(folder / "small.npz", **stored)
    return sorted(folder.iterdir())


def mesh_files(folder: Path) -> list[Path]:
    """A mesh of four vertices; too few for a head, but that shows last."""
    points = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.5]]
    rows = "\n".join(" ".join(map(str, point)) for point in points)
    np.save(folder / "mesh.npy", np.array(points))
    corners = "".join(f"v {' '.join(map(str, point))}\n" for point in points)
    _put(
        folder / "mesh.obj",
        f"mtllib a.mtl\n{corners}vt 0 0\nvn 0 0 1\nf 1/1/1 2/1/1 3/1/1\nf 1 3 4\n",
    )
    head = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(
        f"property float {axis}\n" for axis in "xyz"
    )
    listed = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    _put(folder / "mesh.ply", f"{head}{listed}{rows}\n3 0 1 2\n")
    binary = head.replace("ascii", "binary_little_endian") + listed
    corners_raw = np.array(points, "<f4").tobytes() + b"\x03" + struct.pack("<3i", 0, 1, 2)
    _put(folder / "binary.ply", binary.encode() + corners_raw)
    return sorted(folder.iterdir())


def table_files(folder: Path) -> list[Path]:
    """Pairs for a batch, and held-out correspondences."""
    _put(folder / "pairs.csv", "source,target,name\na.ply,b.ply,one\nb.ply,a.ply,two\n")
    return sorted(folder.iterdir())


def pair_files(folder: Path) -> list[Path]:
    """Correspondences that a run is scored on."""
    rows = np.random.default_rng(6).normal(size=(6, 6)).round(3)
    _put(folder / "held.csv", "\n".join(",".join(map(str, row)) for row in rows))
    np.savez(folder / "held.npz", source=rows[:, :3], target=rows[:, 3:])
    return sorted(folder.iterdir())


def _put(path: Path, content: bytes | str) -> Path:
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def archive(entries: dict[str, Any]) -> bytes:
    """The bytes of a ``.npz``."""
    stream = streams.BytesIO()
    np.savez(stream, **entries)
    return stream.getvalue()
