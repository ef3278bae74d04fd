"""LPIPS and FID: what they are whatever their networks have learnt, and which files they refuse."""

from __future__ import annotations

import importlib
from importlib.util import find_spec
from pathlib import Path

import pytest
import torch
from scenes import painted
from scipy.linalg import sqrtm
from torch import Tensor

from splatmorph.errors import MissingExtraError, ReadError, SplatmorphError
from splatmorph.images.perception import Inception, Lpips, frechet_distance

WIDE = 80
CHANGES = (0.05, 0.4)


@pytest.fixture(scope="module")
def packages() -> torch.library.Library:
    """Those of the extra; of torchvision's compiled part, made for one torch, nothing is used."""
    for package in ("torchvision", "lpips", "pytorch_fid"):
        if find_spec(package) is None:
            pytest.skip(f"{package} is not installed")
    library = torch.library.Library("torchvision", "FRAGMENT")
    try:
        importlib.import_module("torchvision")
    except RuntimeError:
        for name in ("nms", "qnms"):
            library.define(f"{name}(Tensor a, Tensor b, float c) -> Tensor")
        importlib.import_module("torchvision")
    return library


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory, packages: object) -> Path:
    """A folder of networks that have learnt nothing, in files as theirs are published."""
    from torchvision import models

    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(3)
    trunk = models.alexnet().features.state_dict()
    stored = {f"features.{name}": value for name, value in trunk.items()}
    stored["classifier.6.bias"] = torch.zeros(1000)
    torch.save(stored, folder / "alexnet-owt-7be5be79.pth", _use_new_zipfile_serialization=False)
    torch.save(random_inception(), folder / "inception.pth")
    return folder


def random_inception() -> dict[str, Tensor]:
    inception = importlib.import_module("pytorch_fid.inception")
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(inception, "load_state_dict_from_url", lambda *_, **__: {})
        patched.setattr(torch.nn.Module, "load_state_dict", lambda *_: None)
        network = inception.fid_inception_v3()
    stored: dict[str, Tensor] = network.half().state_dict()
    return stored


def pictures(count: int, seed: int = 0) -> list[Tensor]:
    return [painted(WIDE, 64, seed=seed + i).planes() for i in range(count)]


def changed(picture: Tensor, by: float) -> Tensor:
    noise = torch.rand(picture.shape, generator=torch.Generator().manual_seed(9))
    return torch.lerp(picture, noise, by)


def test_lpips_is_a_distance_that_grows_with_the_change(weights: Path) -> None:
    distance = Lpips.load(weights)
    assert distance.trunk == "alex"
    picture, other = pictures(2)
    assert distance(picture, picture) == 0
    assert distance(picture, other) == pytest.approx(distance(other, picture), rel=1e-5) != 0
    found = [distance(picture, changed(picture, by)) for by in CHANGES]
    assert 0 < found[0] < found[1]
    # And it is what the file says: as the package computes it with the same weights in its trunk.
    stored = torch.load(weights / "alexnet-owt-7be5be79.pth", weights_only=True)  # noqa: TID251
    for name, value in distance.network.net.state_dict().items():
        assert torch.equal(value, stored[f"features.{name.partition('.')[2]}"])


def test_fid_tells_sets_apart_by_how_far_they_are(weights: Path) -> None:
    network = Inception.load(weights / "inception.pth")
    given = pictures(3)
    features = network.features(given)
    assert features.shape == (3, 2048)
    assert frechet_distance(features, features.flip(0)) <= 1e-9 * float(features.square().sum())
    found = [
        frechet_distance(features, network.features(changed(one, by) for one in given))
        for by in CHANGES
    ]
    assert 0 < found[0] < found[1]


def test_the_distance_of_features_is_the_published_one() -> None:
    draw = torch.Generator().manual_seed(1)
    sets = [torch.randn(60, 5, generator=draw).double() * (1 + i) + i for i in (0, 1)]
    moments = [
        moment
        for features in sets
        for moment in (features.mean(0).numpy(), features.T.cov().numpy())
    ]
    mean, sigma, other_mean, other_sigma = moments
    root = sqrtm(sigma @ other_sigma).real
    expected = ((mean - other_mean) ** 2).sum() + (sigma + other_sigma - 2 * root).trace()
    assert frechet_distance(*sets) == pytest.approx(expected, rel=1e-9)
    assert frechet_distance(*sets) == pytest.approx(frechet_distance(*sets[::-1]), rel=1e-9)


@pytest.mark.parametrize("name", ["alexnet-owt-7be5be79.pth", "inception.pth"])
def test_files_of_something_else_are_one_line(weights: Path, tmp_path: Path, name: str) -> None:
    def refused(words: str) -> None:
        with pytest.raises(ReadError, match=words) as caught:
            Lpips.load(tmp_path) if "alexnet" in name else Inception.load(tmp_path / name)
        assert str(tmp_path) in str(caught.value)
        assert "\n" not in str(caught.value)

    path = tmp_path / name
    refused("alexnet-….pth" if "alexnet" in name else "No such file")
    path.write_bytes((weights / name).read_bytes()[:100_000])
    refused("no whole file of weights")
    path.write_bytes(b"\x80\x02c__builtin__\neval\n(X\x01\x00\x00\x001tR.")
    refused("no whole file of weights")
    torch.save([1, 2], path)
    refused("something else than named weights")
    torch.save({"features.0.weight": torch.zeros(3)}, path)
    refused("no whole (alexnet|Inception)")


def test_without_the_packages(weights: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def load() -> None:
        Lpips.load(weights)

    for error, expected, words in (
        (ImportError(), MissingExtraError, r"LPIPS .*'lpips'.*pip install 'splatmorph\[metrics\]'"),
        (RuntimeError("no nms"), SplatmorphError, r"torchvision made for torch \d.*no nms"),
    ):

        def failing(name: str, error: Exception = error) -> None:
            raise error

        with monkeypatch.context() as patched:
            patched.setattr("importlib.import_module", failing)
            with pytest.raises(expected, match=words):
                load()
