"""How alike pictures look to trained networks: LPIPS and FID, by which the paper judges blends.

Needs the extra ``metrics``, and weights that nobody downloads for you: torchvision's of ImageNet
for LPIPS (its last layers come with the package ``lpips``), pytorch-fid's for FID.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from splatmorph.errors import MissingExtraError, ReadError, SplatmorphError
from splatmorph.io.reading import reading, reason, require_file

TRUNKS = {"alex": "alexnet", "vgg": "vgg16", "squeeze": "squeezenet1_1"}
"""The networks of LPIPS, the usual one first -> how torchvision's files of them begin."""


@dataclass(frozen=True)
class Lpips:
    """Learned perceptual distance (Zhang et al. 2018), version 0.1."""

    network: Any
    trunk: str
    """Of ``TRUNKS``."""

    @staticmethod
    def load(folder: str | Path) -> Lpips:
        """With the weights in a folder: of the first of ``TRUNKS`` that it holds.

        Raises:
            MissingExtraError: the packages are not installed.
            SplatmorphError: torchvision and torch don't fit each other.
            ReadError: it holds none, or they are damaged or of another network.
        """
        trunk, path = _find_trunk(Path(folder))
        stored = _read_weights(path)
        lpips = _package("lpips", "LPIPS")
        with warnings.catch_warnings():
            # Written for the torchvision of its time.
            warnings.simplefilter("ignore")
            network = lpips.LPIPS(net=trunk, pnet_rand=True, verbose=False)
        # Its slices keep the numbers that layers have in torchvision's whole.
        weights = {
            name: stored.get(f"features.{name.partition('.')[2]}")
            for name in network.net.state_dict()
        }
        with reading(path, f"{TRUNKS[trunk]} of torchvision"):
            network.net.load_state_dict(
                {name: weight for name, weight in weights.items() if weight is not None}
            )
        return Lpips(network.eval().requires_grad_(False), trunk)

    def __call__(self, a: Tensor, b: Tensor) -> float:
        """The distance of two pictures (3, h, w) in [0, 1], 64 pixels wide and high or more."""
        with torch.inference_mode():
            return float(self.network(a[None].float(), b[None].float(), normalize=True))


@dataclass(frozen=True)
class Inception:
    """The network whose features FID compares: Inception v3 as TensorFlow trained it in 2015."""

    network: Any

    @staticmethod
    def load(path: str | Path) -> Inception:
        """With pytorch-fid's weights, ``pt_inception-2015-12-05-6726825d.pth``.

        Raises:
            MissingExtraError, SplatmorphError: as for ``Lpips``.
            ReadError: the file is missing, damaged, or of another network.
        """
        path = Path(path)
        stored = _read_weights(path)
        inception = _package("pytorch_fid.inception", "FID")
        download = inception.load_state_dict_from_url
        inception.load_state_dict_from_url = lambda *_, **__: stored
        try:
            with reading(path, "Inception of pytorch-fid"):
                network = inception.InceptionV3()
        finally:
            inception.load_state_dict_from_url = download
        return Inception(network.eval())

    def features(self, pictures: Iterable[Tensor]) -> Tensor:
        """(n, 2048) float64 of n pictures (3, h, w) in [0, 1], of any sizes."""
        with torch.inference_mode():
            found = [self.network(one[None].float())[0].flatten() for one in pictures]
        return torch.stack(found).double()


def frechet_distance(first: Tensor, second: Tensor) -> float:
    """|μ₁ - μ₂|² + tr(Σ₁ + Σ₂ - 2(Σ₁Σ₂)^½) of two sets of features (n, d), (m, d): their FID.

    Of centred features A, B over √(n - 1), √(m - 1), the root's trace is the sum of the singular
    values of ABᵀ: exact for fewer pictures than features, where Σ₁Σ₂ is singular.
    """
    (mean, a), (other_mean, b) = (_centred(features) for features in (first, second))
    apart = (mean - other_mean).square().sum() + a.square().sum() + b.square().sum()
    return max(0.0, float(apart - 2 * torch.linalg.svdvals(a @ b.T).sum()))


def _centred(features: Tensor) -> tuple[Tensor, Tensor]:
    mean = features.mean(0)
    return mean, (features - mean) / max(1, len(features) - 1) ** 0.5


def _find_trunk(folder: Path) -> tuple[str, Path]:
    for trunk, name in TRUNKS.items():
        for path in sorted(folder.glob(f"{name}-*.pth")):
            return trunk, path
    expected = " or ".join(f"{name}-….pth" for name in TRUNKS.values())
    raise ReadError(f"{folder} holds no weights of torchvision's, expected {expected}")


def _read_weights(path: Path) -> dict[str, Tensor]:
    require_file(path)
    with reading(path, "file of weights", remedy="download it again"):
        # Both are published as pickles; only tensors are let through.
        stored = torch.load(path, map_location="cpu", weights_only=True)  # noqa: TID251
    if not (isinstance(stored, dict) and all(isinstance(w, Tensor) for w in stored.values())):
        raise ReadError(f"{path} holds something else than named weights: get the original file")
    return stored


def _package(module: str, purpose: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0].replace("_", "-")
        raise MissingExtraError(package, "metrics", purpose) from error
    except RuntimeError as error:
        raise SplatmorphError(
            f"{purpose} needs the torchvision made for torch {torch.__version__}, and another is "
            f"installed ({reason(error)}): install it from where that torch came from"
        ) from error
