"""Blends of two aligned pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from scenes import Turn, painted
from scipy.sparse import diags_array, eye_array, kron, vstack
from scipy.sparse.linalg import spsolve
from torch import Tensor

from splatmorph.errors import OptionError, ReadError
from splatmorph.images import FlowWarp, ImageMorph, linear, poisson
from splatmorph.images.blend import solve_screened
from splatmorph.images.faces import detect_face
from splatmorph.images.generative import DiffusersAutoencoder, LatentBlend

BLENDS = [linear, poisson]


def planes(seed: int) -> Tensor:
    return painted(24, 16, seed=seed).planes()


@pytest.mark.parametrize("blend", BLENDS)
def test_a_picture_blended_with_itself_is_itself(blend) -> None:
    assert torch.allclose(blend(planes(0), planes(0), 0.3), planes(0), atol=1e-5)


@pytest.mark.parametrize("blend", BLENDS)
def test_swapping_the_sides_reverses_time(blend) -> None:
    assert torch.allclose(
        blend(planes(0), planes(1), 0.3), blend(planes(1), planes(0), 0.7), atol=1e-4
    )


@pytest.mark.parametrize("blend", BLENDS)
def test_it_begins_at_the_source_and_ends_at_the_target(blend) -> None:
    assert torch.allclose(blend(planes(0), planes(1), 0.0), planes(0), atol=1e-4)
    assert torch.allclose(blend(planes(0), planes(1), 1.0), planes(1), atol=1e-4)


def test_poisson_keeps_the_edge_that_linear_halves() -> None:
    flat, edge = torch.full((1, 128, 128), 0.5), torch.full((1, 128, 128), 0.3)
    edge[..., 64:] = 0.7

    def step(picture: Tensor) -> float:
        return float(picture[0, 64, 64] - picture[0, 64, 63])

    assert step(linear(flat, edge, 0.5)) == pytest.approx(0.2, abs=0.01)
    assert step(poisson(flat, edge, 0.5)) > 0.3


def test_cosines_solve_what_a_sparse_solver_solves() -> None:
    height, width, weight = 7, 9, 0.03
    rng = np.random.default_rng(0)
    values, right, down = rng.standard_normal((3, 2, height, width)).astype(np.float32)

    def differences(count: int):
        return diags_array([-np.ones(count - 1), np.ones(count - 1)], offsets=[0, 1],
                           shape=(count - 1, count))  # fmt: skip

    across = kron(eye_array(height), differences(width))
    along = kron(differences(height), eye_array(width))
    system = vstack([across, along, np.sqrt(weight) * eye_array(height * width)]).tocsc()
    found = solve_screened(*map(torch.from_numpy, (values, right, down)), weight)
    for channel in range(2):
        wanted = np.concatenate(
            [right[channel, :, :-1].ravel(), down[channel, :-1].ravel(),
             np.sqrt(weight) * values[channel].ravel()]
        )  # fmt: skip
        exact = spsolve((system.T @ system).tocsc(), system.T @ wanted)
        assert np.allclose(found[channel].numpy().ravel(), exact, atol=1e-4)


class Halving:
    """An autoencoder that only keeps half the values."""

    def encode(self, picture: Tensor) -> Tensor:
        return picture / 2

    def decode(self, code: Tensor) -> Tensor:
        return code * 2


def test_the_generative_blend_mixes_codes() -> None:
    mixed = LatentBlend(Halving())(planes(0), planes(1), 0.3)
    assert torch.allclose(mixed, linear(planes(0), planes(1), 0.3), atol=1e-6)
    with pytest.raises(OptionError, match="RGB"):
        LatentBlend(Halving())(planes(0)[:1], planes(1)[:1], 0.3)


def test_any_function_of_two_pictures_blends() -> None:
    morph = ImageMorph(painted(), painted(seed=1), FlowWarp(Turn(0.1)), blend=lambda a, b, t: a * 0)
    assert morph.at(0.5).pixels.max() == 0


def test_an_autoencoder_of_diffusers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")
    diffusers = pytest.importorskip("diffusers")
    torch.manual_seed(0)
    diffusers.AutoencoderKL(
        block_out_channels=(8, 8), norm_num_groups=4, latent_channels=2,
        down_block_types=("DownEncoderBlock2D",) * 2, up_block_types=("UpDecoderBlock2D",) * 2,
    ).save_pretrained(tmp_path / "vae")  # fmt: skip
    blend = LatentBlend(DiffusersAutoencoder(tmp_path / "vae"))
    source, target = (painted(23, 17, seed=seed).planes() for seed in (0, 1))
    half = blend(source, target, 0.5)
    assert half.shape == source.shape
    assert torch.equal(half, blend(source, target, 0.5))
    assert not torch.equal(half, blend(source, target, 0.2))


def test_a_directory_without_autoencoder(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match=r"holds no config\.json"):
        DiffusersAutoencoder(tmp_path)
    pytest.importorskip("diffusers")
    (tmp_path / "config.json").write_text("{}")
    with pytest.raises(ReadError, match="holds no readable autoencoder"):
        DiffusersAutoencoder(tmp_path)


def test_a_file_that_is_no_face_model(tmp_path: Path) -> None:
    with pytest.raises(ReadError, match="is not there"):
        detect_face(painted(), tmp_path / "missing.task")
    pytest.importorskip("cv2")
    (tmp_path / "bad.task").write_text("no model")
    with pytest.raises(ReadError, match=r"is no face_landmarker\.task"):
        detect_face(painted(), tmp_path / "bad.task")
