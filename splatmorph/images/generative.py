"""Generative blending: between the codes of two aligned pictures instead of their pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from torch import Tensor
from torch.nn.functional import pad

from splatmorph.errors import MissingExtraError, OptionError, ReadError


class Autoencoder(Protocol):
    """Pictures to codes and back."""

    def encode(self, picture: Tensor) -> Tensor:
        """(3, h, w) float32 in [0, 1] -> a code of any shape."""
        ...

    def decode(self, code: Tensor) -> Tensor:
        """A code -> (3, h, w) float32, about [0, 1]."""
        ...


@dataclass(frozen=True)
class LatentBlend:
    """D((1 - t) E(source) + t E(target)), the paper's generative blend.

    Raises:
        OptionError: the pictures aren't RGB.
    """

    autoencoder: Autoencoder

    def __call__(self, source: Tensor, target: Tensor, t: float) -> Tensor:
        """As ``Blend``."""
        if len(source) != 3:
            raise OptionError("the generative blend takes RGB pictures: convert them first")
        codes = (self.autoencoder.encode(source), self.autoencoder.encode(target))
        return self.autoencoder.decode(torch.lerp(*codes, t)).clamp(0, 1)


class DiffusersAutoencoder:
    """The variational autoencoder of a latent diffusion model, by ``diffusers``.

    Codes are the means of the encoder's distribution, so a picture has one code. Pictures are
    extended to the size that the downsampling wants, and cut back.

    Raises:
        MissingExtraError: diffusers is not installed.
        ReadError: ``directory`` holds no autoencoder (``config.json`` and weights).
    """

    def __init__(self, directory: str | Path) -> None:
        directory = Path(directory)
        if not (directory / "config.json").is_file():
            raise ReadError(
                f"{directory} holds no config.json, expected the directory of an AutoencoderKL "
                "(in a Stable Diffusion model: its folder vae)"
            )
        try:
            from diffusers import AutoencoderKL
        except ImportError as error:
            raise MissingExtraError("diffusers", "generative", "the generative blend") from error
        try:
            model = AutoencoderKL.from_pretrained(
                str(directory), local_files_only=True, use_safetensors=True
            )
        except (OSError, ValueError, KeyError) as error:
            reason = str(error).splitlines()[0]
            raise ReadError(f"{directory} holds no readable autoencoder: {reason}") from error
        self._model: Any = model.eval().requires_grad_(False)
        self._multiple = 2 ** (len(model.config.block_out_channels) - 1)
        self._size = (0, 0)

    def encode(self, picture: Tensor) -> Tensor:
        """As ``Autoencoder.encode``."""
        _, height, width = picture.shape
        self._size = (height, width)
        missing = (0, -width % self._multiple, 0, -height % self._multiple)
        whole = pad(picture[None], missing, mode="replicate")
        return self._model.encode(whole * 2 - 1).latent_dist.mode()

    def decode(self, code: Tensor) -> Tensor:
        """As ``Autoencoder.decode``; cut to the size of the picture encoded last."""
        height, width = self._size
        return self._model.decode(code).sample[0, :, :height, :width] / 2 + 0.5
