"""Other programs read what we write, and we read what they write; each skips where it is absent."""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from splatmorph import io
from splatmorph.gaussians import Gaussians
from splatmorph.io.axes import from_frame

MakeGaussians = Callable[..., Gaussians]

LOOSE = {".compressed.ply": 2e-3, ".spz": 2e-4, ".sog": 4e-5}
"""World units that centers may move in a box of 2."""

WRITTEN_BY_OTHERS = Path(__file__).parent / "formats"

VALIDATE = """
const validator = require('gltf-validator');
const bytes = new Uint8Array(require('fs').readFileSync(process.argv[1]));
validator.validateBytes(bytes).then(report => console.log(JSON.stringify(report.issues)));
"""


@pytest.fixture
def transform() -> Callable[[Path, Path], Gaussians]:
    """``transform(source, target)``: splat-transform converts one file; the other is read."""
    program = shutil.which("splat-transform")
    if program is None:
        pytest.skip("npm's @playcanvas/splat-transform is not installed")

    def converted(source: Path, target: Path) -> Gaussians:
        subprocess.run(
            [program, "-q", "-w", "-g", "cpu", source, target], check=True, capture_output=True
        )
        return io.read(target)

    return converted


def near(a: Gaussians, b: Gaussians, center: float = 1e-6) -> None:
    assert len(a) == len(b)
    # Other programs change the order.
    partner = torch.cdist(a.means, b.means).argmin(1)
    assert len(partner.unique()) == len(a)
    b = b.select(partner)
    assert torch.allclose(a.means, b.means, atol=center)
    assert torch.allclose(a.opacities, b.opacities, atol=1.5 / 255)
    # Some drop the colours of what can't be seen.
    seen = a.opacities > 1 / 255
    a, b = a.select(seen), b.select(seen)
    for stored, found in ((a.log_scales, b.log_scales), (a.sh[:, 0], b.sh[:, 0])):
        assert (stored - found).abs().mean() < 0.025
        assert (stored - found).abs().max() < 0.5


def test_the_validator_of_khronos_finds_nothing_but_what_it_does_not_know(
    tmp_path: Path, make_gaussians: MakeGaussians
) -> None:
    node = shutil.which("node")
    known = node and subprocess.run([node, "-e", "require('gltf-validator')"], capture_output=True)
    if not node or not known or known.returncode:
        pytest.skip("npm's gltf-validator is not installed (NODE_PATH)")
    io.write(tmp_path / "x.glb", replace(make_gaussians(99, 3), offset=(1e6, 0.0, 0.0)))
    ran = subprocess.run(
        [node, "-e", VALIDATE, tmp_path / "x.glb"], capture_output=True, check=True
    )
    issues = json.loads(ran.stdout)["messages"]
    # It knows no names of attributes but those of glTF's core.
    unknown = {"UNSUPPORTED_EXTENSION", "MESH_PRIMITIVE_INVALID_ATTRIBUTE"}
    assert [one for one in issues if one["code"] not in unknown] == []
    assert all("KHR_gaussian_splatting" in json.dumps(one) for one in issues)


@pytest.mark.parametrize("extension", [".glb", ".spz", ".sog", ".compressed.ply"])
def test_splat_transform_writes_what_we_read(
    tmp_path: Path,
    make_gaussians: MakeGaussians,
    transform: Callable[[Path, Path], Gaussians],
    extension: str,
) -> None:
    splats = make_gaussians(300, 2)
    io.write(tmp_path / "a.ply", splats)
    found = transform(tmp_path / "a.ply", tmp_path / f"b{extension}")
    # For it y is down in a PLY. In glTF it turns that about z, in SPZ, as Niantic does, about x.
    flips = {".glb": (-1.0, -1.0, 1.0), ".spz": (1.0, -1.0, -1.0)}
    flip = torch.tensor(flips.get(extension, (1.0, 1.0, 1.0)))
    near(found, replace(splats, means=splats.means * flip), LOOSE.get(extension, 1e-6))


def test_splat_transform_reads_our_sog(
    tmp_path: Path,
    make_gaussians: MakeGaussians,
    transform: Callable[[Path, Path], Gaussians],
) -> None:
    splats = make_gaussians(300, 2)
    io.write(tmp_path / "a.sog", splats)
    near(transform(tmp_path / "a.sog", tmp_path / "b.ply"), splats, LOOSE[".sog"])


@pytest.mark.parametrize("level", [0, 1, 2])
def test_splat_transform_reads_the_same_in_a_ksplat(
    tmp_path: Path, transform: Callable[[Path, Path], Gaussians], level: int
) -> None:
    path = WRITTEN_BY_OTHERS / f"gaussian-splats-3d-{level}.ksplat"
    near(transform(path, tmp_path / "x.ply"), io.read(path))


def test_splat_transform_reads_our_spz_and_turns_it(
    tmp_path: Path,
    make_gaussians: MakeGaussians,
    transform: Callable[[Path, Path], Gaussians],
) -> None:
    splats = make_gaussians(300, 1)
    io.write(tmp_path / "a.spz", splats)
    found = transform(tmp_path / "a.spz", tmp_path / "b.ply")
    near(from_frame(found, "RDF"), splats)
    # It honours what the file says of its axes: y down, x to the left is RDF turned about y.
    io.write(tmp_path / "c.spz", replace(splats, up="-y"))
    found = transform(tmp_path / "c.spz", tmp_path / "d.ply")
    assert torch.allclose(found.means, splats.means * torch.tensor([-1.0, 1, -1]), atol=1e-6)


@pytest.mark.parametrize("extension", [".splat", ".spz", ".sog", ".compressed.ply"])
def test_gaussforge_reads_and_writes_as_we_do(
    tmp_path: Path, make_gaussians: MakeGaussians, extension: str
) -> None:
    convert = pytest.importorskip("gaussforge").GaussForge().convert
    splats = make_gaussians(300, 1)
    for name in (f"a{extension}", "a.ply"):
        io.write(tmp_path / name, splats)
    for source, target in ((f"a{extension}", "b.ply"), ("a.ply", f"b{extension}")):
        kinds = (io.extension_of(name)[1:] for name in (source, target))
        made = convert((tmp_path / source).read_bytes(), *kinds)
        (tmp_path / target).write_bytes(made["data"])
        near(io.read(tmp_path / target), splats, LOOSE.get(extension, 2e-4))


@pytest.mark.parametrize("up", [None, "-y"])
def test_gsply_reads_our_spz(tmp_path: Path, make_gaussians: MakeGaussians, up: str | None) -> None:
    gsply = pytest.importorskip("gsply")
    splats = replace(make_gaussians(300, 1), up=up)
    io.write(tmp_path / "a.spz", splats)
    assert np.allclose(gsply.read_spz(str(tmp_path / "a.spz")).means, splats.means, atol=1e-6)
