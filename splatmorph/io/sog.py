"""SOG, what SuperSplat publishes: attributes as lossless WebP pictures, a pixel a splat.

``.sog`` is a zip of the pictures and their ``meta.json``; unbundled, that lies beside them.
Positions have 16 bits of their logarithm, quaternions lack their largest component, and scales and
colours are indices into codebooks; harmonics above degree 0 into a palette.
https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/sog
"""

from __future__ import annotations

import contextlib
import io
import json
import math
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from splatmorph._version import __version__
from splatmorph.errors import ReadError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.io.atomic import atomic_write
from splatmorph.io.codebooks import codebook, grouped, nearest
from splatmorph.io.inflate import check_promise
from splatmorph.io.packed import (
    Array,
    Bytes,
    as_bytes,
    drop_largest,
    opacity_bytes,
    read_bytes,
    restore_largest,
    stored_arrays,
    unpacked,
)
from splatmorph.io.reading import LARGEST_TEXT

META = "meta.json"
BYTES_EACH = 20
"""What the pictures have for a splat: five of four bytes."""
LARGEST_SIDE = 16383
"""Of a WebP picture."""
MOST_IN_PALETTE, PALETTE_COLUMNS = 1 << 16, 64
TAG = 252
"""The alpha of a quaternion whose largest component is w; x, y and z follow."""
HIGHEST_DEGREE = 3

Fetch = Callable[[str], bytes]


def read_sog(path: str | Path) -> Gaussians:
    """Read ``.sog``, or the ``meta.json`` of an unbundled one with the pictures beside it.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    path = Path(path)
    with contextlib.ExitStack() as stack:
        fetch = _opened(path, stack)
        meta = _meta(fetch, path)
        first = meta.get("version") is None
        n = int(meta["means"]["shape"][0] if first else meta["count"])
        if n < 1:
            raise ReadError(f"{path} holds {n} splats, expected at least one")
        check_promise(n * BYTES_EACH, path if path.name != META else _largest_beside(path, meta))

        def pixels(part: str, number: int = 0) -> Bytes:
            return _picture(fetch(meta[part]["files"][number]), n)

        low, high = pixels("means"), pixels("means", 1)
        colours = pixels("sh0")
        levels = (low[:, :3] + 256.0 * high[:, :3]) / 65535
        quats = pixels("quats")
        dc = _decoded(colours[:, :3], meta["sh0"], slice(0, 3))
        sh = dc[:, None]
        if "shN" in meta:
            labels = _picture(fetch(meta["shN"]["files"][1]), n)
            palette = _palette(fetch(meta["shN"]["files"][0]), meta["shN"], first)
            index = labels[:, 0] + 256 * labels[:, 1].astype(np.int64)
            if index.max() >= len(palette):
                raise ValueError("a splat's harmonics lie beyond their palette")
            sh = np.concatenate([sh, palette[index]], axis=1)
        alphas = colours[:, 3] / 255
        if first:
            logits = _between(colours[:, 3:4] / 255, meta["sh0"], slice(3, 4))[:, 0]
            alphas = 1 / (1 + np.exp(-logits))
        return unpacked(
            path,
            means=_expanded(_between(levels, meta["means"], slice(0, 3))),
            quats=restore_largest(quats[:, 3].clip(TAG) - TAG, _rest(quats[:, :3])),
            log_scales=_decoded(pixels("scales")[:, :3], meta["scales"], slice(0, 3)),
            opacities=alphas,
            sh=sh,
        )


def sog_layout(path: str | Path) -> str:
    """In words, the version of a SOG file.

    Raises:
        ReadError: see :func:`splatmorph.io.read`.
    """
    path = Path(path)
    with contextlib.ExitStack() as stack:
        version = _meta(_opened(path, stack), path).get("version", 1)
    return f"SOG {version} of PlayCanvas, {'unbundled' if path.name == META else 'bundled'}"


def write_sog(path: str | Path, gaussians: Gaussians, comments: Sequence[str] = ()) -> None:
    """Write ``.sog``, or unbundled where ``path`` is a ``meta.json``, in the order given.

    Harmonics go to degree 3 at most; above 65536 splats, those that look alike share theirs.

    Raises:
        WriteError: see :func:`splatmorph.io.write`; or more splats than a picture holds.
    """
    path = Path(path)
    files = _encoded(gaussians.with_sh_degree(min(gaussians.sh_degree, HIGHEST_DEGREE)), path)
    if path.name != META:
        with atomic_write(path) as partial, zipfile.ZipFile(partial, "w") as bundle:
            for name, data in files.items():
                # With a date of its own, the same splat gives the same bytes.
                bundle.writestr(zipfile.ZipInfo(name), data)
        return
    with contextlib.ExitStack() as stack:
        # The last to be entered is the first to take its place: the meta.json comes last.
        for name in reversed(files):
            partial = stack.enter_context(atomic_write(path.with_name(name)))
            partial.write_bytes(files[name])


# Reading ------------------------------------------------------------------------------------


def _opened(path: Path, stack: contextlib.ExitStack) -> Fetch:
    if path.name == META:
        return lambda name: read_bytes(path.with_name(_plain(name)))
    bundle = stack.enter_context(zipfile.ZipFile(io.BytesIO(read_bytes(path))))

    def fetch(name: str) -> bytes:
        described = bundle.getinfo(name)
        check_promise(described.file_size, path)
        with bundle.open(described) as stream:
            return stream.read(described.file_size)

    return fetch


def _plain(name: str) -> str:
    if Path(name).name != name or name in ("", ".."):
        raise ValueError(f"it keeps a picture at {name[:80]!r}, expected one beside it")
    return name


def _meta(fetch: Fetch, path: Path) -> dict[str, Any]:
    text = fetch(META) if path.name != META else read_bytes(path)
    if len(text) > LARGEST_TEXT:
        raise ValueError("its meta.json is too large")
    meta = json.loads(text)
    if not isinstance(meta, dict) or not {"means", "scales", "quats", "sh0"} <= meta.keys():
        raise ReadError(f"{path} is no SOG: expected a meta.json with means, scales, quats and sh0")
    if meta.get("version", 2) != 2:
        raise ReadError(f"{path} is SOG of version {meta['version']}, we read 1 and 2")
    return meta


def _largest_beside(path: Path, meta: dict[str, Any]) -> Path:
    names = [_plain(name) for part in meta.values() if isinstance(part, dict)
             for name in part.get("files", [])]  # fmt: skip
    return max((path.with_name(name) for name in names), key=lambda file: file.stat().st_size)


def _picture(data: bytes, pixels: int) -> Bytes:
    """The first ``pixels`` of a picture, (pixels, 4)."""
    from PIL import Image

    with Image.open(io.BytesIO(data), formats=["WEBP"]) as picture:
        width, height = picture.size
        if width * height < pixels:
            raise ValueError("a picture has fewer pixels than there are splats")
        if width * height > 2 * pixels + PALETTE_COLUMNS**2:
            raise ValueError("a picture has far more pixels than there are splats")
        return np.asarray(picture.convert("RGBA")).reshape(-1, 4)[:pixels]


def _palette(data: bytes, part: dict[str, Any], first: bool) -> Array:
    """(k, coefficients, 3) harmonics: 64 entries a row, a pixel each coefficient."""
    from PIL import Image

    with Image.open(io.BytesIO(data), formats=["WEBP"]) as picture:
        width, height = picture.size
        each = width // PALETTE_COLUMNS
        if width % PALETTE_COLUMNS or each not in (3, 8, 15) or height > MOST_IN_PALETTE // 64:
            raise ValueError(f"a palette of {width}x{height} pixels")
        stored = np.asarray(picture.convert("RGB")).reshape(-1, each, 3)
    return _decoded(stored, part, slice(None)) if not first else _between(stored / 255, part)


def _decoded(stored: Bytes, part: dict[str, Any], channels: slice) -> Array:
    if "codebook" not in part:
        return _between(stored / 255, part, channels)
    book = np.array(part["codebook"], np.float64)
    return np.asarray(book[stored])


def _between(fractions: Array, part: dict[str, Any], channels: slice = slice(None)) -> Array:
    low, high = (np.array(part[end], np.float64) for end in ("mins", "maxs"))
    if low.ndim:
        low, high = low[channels], high[channels]
    return np.asarray(low + (high - low) * fractions)


def _rest(stored: Bytes) -> Array:
    return np.asarray((stored / 255 * 2 - 1) / math.sqrt(2))


def _expanded(logs: Array) -> Array:
    """The inverse of sign(x) log(|x| + 1)."""
    return np.asarray(np.sign(logs) * np.expm1(np.abs(logs)))


# Writing ------------------------------------------------------------------------------------


def _encoded(gaussians: Gaussians, path: Path) -> dict[str, bytes]:
    """The files of a SOG by name, ``meta.json`` last."""
    means, quats, log_scales, sh = stored_arrays(gaussians, path)
    n = len(means)
    width = math.ceil(math.sqrt(n) / 4) * 4
    if width > LARGEST_SIDE:
        raise WriteError(f"{path} can't hold {n:,} splats, expected at most {LARGEST_SIDE**2:,}")
    pictures: dict[str, Bytes] = {}

    def put(name: str, colours: NDArray[Any], alpha: Any = 255) -> list[str]:
        pixels = np.full((width * math.ceil(n / width / 4) * 4, 4), 255, np.uint8)
        pixels[:n, : colours.shape[1]] = colours
        pixels[:n, 3] = alpha
        pictures[f"{name}.webp"] = pixels.reshape(-1, width, 4)
        return [f"{name}.webp"]

    logs = np.sign(means) * np.log1p(np.abs(means))
    low, high = logs.min(axis=0), logs.max(axis=0)
    levels = np.round((logs - low) / np.where(high > low, high - low, 1) * 65535).astype(np.int64)
    index, rest = drop_largest(quats)
    scale_book, dc_book = codebook(log_scales), codebook(sh[:, 0])
    meta: dict[str, Any] = {
        "version": 2,
        "asset": {"generator": f"splatmorph {__version__}"},
        "count": n,
        "means": {
            "mins": low.tolist(),
            "maxs": high.tolist(),
            "files": put("means_l", levels & 255) + put("means_u", levels >> 8),
        },
        "scales": {
            "codebook": scale_book.tolist(),
            "files": put("scales", nearest(log_scales, scale_book)),
        },
        "quats": {"files": put("quats", as_bytes((rest / math.sqrt(2) + 0.5) * 255), TAG + index)},
        "sh0": {
            "codebook": dc_book.tolist(),
            "files": put("sh0", nearest(sh[:, 0], dc_book), opacity_bytes(gaussians)),
        },
    }
    if gaussians.sh_degree:
        rows, labels = grouped(sh[:, 1:].reshape(n, -1), MOST_IN_PALETTE)
        book = codebook(rows)
        palette = nearest(rows, book).reshape(len(rows), -1, 3)
        entries = np.full((-(-len(rows) // 64) * 64, palette.shape[1], 4), 255, np.uint8)
        entries[: len(rows), :, :3] = palette
        pictures["shN_centroids.webp"] = entries.reshape(-1, 64 * palette.shape[1], 4)
        index16 = np.stack([labels & 255, labels >> 8], axis=1)
        meta["shN"] = {
            "count": len(rows),
            "bands": gaussians.sh_degree,
            "codebook": book.tolist(),
            "files": ["shN_centroids.webp", *put("shN_labels", index16)],
        }
    files = {name: _webp(pixels) for name, pixels in pictures.items()}
    return files | {META: json.dumps(meta).encode()}


def _webp(pixels: Bytes) -> bytes:
    from PIL import Image

    stream = io.BytesIO()
    # Exact: the colours of transparent pixels are data too.
    Image.fromarray(pixels).save(stream, "WEBP", lossless=True, exact=True, method=4)
    return stream.getvalue()
