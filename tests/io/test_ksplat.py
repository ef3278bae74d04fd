"""``.ksplat``: packed here as its table says, and read back. What its own program wrote is read in
``test_formats.py``."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import torch
from refusals import refused
from splats import random_gaussians

from splatmorph import io
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0

TYPES = {0: ("<f4", "<f4", "<f4"), 1: ("<u2", "<f2", "<f2"), 2: ("<u2", "<f2", "u1")}
BLOCK, STEPS, BUCKET = 2.5, 32767, 16


def section(splats: Gaussians, level: int, room: int) -> tuple[bytes, bytes]:
    """A section's header and its bytes: every bucket is full but the last."""
    degree = splats.sh_degree
    place, number, harmonic = TYPES[level]
    buckets = 0 if level == 0 else -(-len(splats) // BUCKET)
    full = 0 if level == 0 else len(splats) // BUCKET
    partial = [len(splats) - full * BUCKET] * (buckets - full)
    fields = [("means", place, 3), ("scales", number, 3), ("quats", number, 4), ("rgba", "u1", 4)]
    higher = 3 * ((degree + 1) ** 2 - 1)
    rows = np.zeros(room, np.dtype([*fields, ("sh", harmonic, (higher,))]))
    used = rows[: len(splats)]
    centers = 0.1 * np.arange(3 * buckets, dtype="<f4").reshape(-1, 3) / max(1, buckets)
    means = splats.means.numpy()
    if level:
        owner = np.arange(len(splats)) // BUCKET
        means = (means - centers[owner]) / (BLOCK / 2) * STEPS + STEPS
    used["means"] = means.round() if level else means
    used["scales"] = splats.log_scales.exp().numpy()
    used["quats"] = torch.nn.functional.normalize(splats.quats).numpy()
    used["rgba"][:, :3] = ((0.5 + SH0 * splats.sh[:, 0]).clamp(0, 1) * 255).round().numpy()
    used["rgba"][:, 3] = (splats.opacities * 255).round().numpy()
    bands = [splats.sh[:, d * d : (d + 1) ** 2].mT.reshape(len(splats), -1) for d in (1, 2)]
    stored = torch.cat(bands, 1)[:, :higher].numpy()
    used["sh"] = ((stored + 1.5) / 3 * 255).round() if level == 2 else stored
    sizes = (len(splats), room, BUCKET, buckets)
    head = struct.pack("<4IfH2xI4x2IH", *sizes, BLOCK, 12, STEPS, full, len(partial), degree)
    body = np.array(partial, "<u4").tobytes() + centers.tobytes() + rows.tobytes()
    return head.ljust(1024, b"\0"), body


def packed(level: int, *parts: Gaussians, room: int = 0) -> bytes:
    made = [section(part, level, max(room, len(part))) for part in parts]
    count = sum(map(len, parts))
    sizes = (len(parts), len(parts), count, count)
    head = struct.pack("<2B2x4IH2x3f2f", 0, 1, *sizes, level, 0, 0, 0, -1.5, 1.5)
    return head.ljust(4096, b"\0") + b"".join(h for h, _ in made) + b"".join(b for _, b in made)


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
def test_what_was_packed_comes_back_in_its_order(tmp_path: Path, level: int, degree: int) -> None:
    splats = random_gaussians(70, degree)
    path = tmp_path / "x.ksplat"
    path.write_bytes(packed(level, splats, room=80))
    found = io.read(path)
    assert len(found) == 70
    assert found.sh_degree == degree
    assert torch.allclose(found.means, splats.means, atol=BLOCK / STEPS if level else 0)
    assert torch.allclose(found.log_scales, splats.log_scales, atol=1e-3 if level else 1e-5)
    assert torch.allclose(found.opacities, splats.opacities, atol=0.6 / 255)
    step = {0: 0, 1: 2e-3, 2: 0.6 * 3 / 255}[level]
    assert torch.allclose(found.sh[:, 1:], splats.sh[:, 1:].clamp(-1.5, 1.5), atol=step)
    quats = torch.nn.functional.normalize(splats.quats)
    assert torch.allclose(found.quats, quats, atol=1e-3)
    assert f"level {level}" in io.layout(path)


def test_sections_are_joined_to_the_highest_degree(tmp_path: Path) -> None:
    path = tmp_path / "x.ksplat"
    parts = random_gaussians(20, 0), random_gaussians(33, 2, seed=1)
    path.write_bytes(packed(1, *parts))
    found = io.read(path)
    assert len(found) == 53
    assert found.sh_degree == 2
    assert not found.sh[:20, 1:].any()
    assert torch.allclose(found.means[20:], parts[1].means, atol=BLOCK / STEPS)


def test_it_is_only_read(tmp_path: Path) -> None:
    with pytest.raises(OptionError, match=r"we write .*\.ply"):
        io.write(tmp_path / "x.ksplat", random_gaussians(3))
    assert ".ksplat" not in io.written()


@pytest.mark.parametrize("keep", [0, 100, 4096, 5000, 5200, -1])
def test_a_file_cut_off(tmp_path: Path, keep: int) -> None:
    (tmp_path / "x.ksplat").write_bytes(packed(1, random_gaussians(40))[:keep])
    refused(tmp_path / "x.ksplat", "")


@pytest.mark.parametrize(
    ("at", "value"),
    [(0, 9), (4, 2**31), (20, 7), (4096, 1000), (4108, 2**32 - 1), (4116, 0), (4136, 3)],
    ids=["version", "sections", "level", "splats", "buckets", "record", "degree"],
)
def test_a_header_that_promises_what_is_not_there(tmp_path: Path, at: int, value: int) -> None:
    data = bytearray(packed(1, random_gaussians(40)))
    size = 1 if at == 0 else 2 if at in (20, 4116, 4136) else 4
    data[at : at + size] = value.to_bytes(size, "little")
    (tmp_path / "x.ksplat").write_bytes(bytes(data))
    refused(tmp_path / "x.ksplat", "")
