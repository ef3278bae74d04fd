"""A FLAME-like model and avatars on it, made once for all tests of this folder."""

from __future__ import annotations

from pathlib import Path

import pytest
import synthetic_flame

from splatmorph.avatars.flame import Flame


@pytest.fixture(autouse=True)
def _no_flame_of_the_user(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("SPLATMORPH_FLAME", raising=False)


@pytest.fixture(scope="session")
def flame_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("flame")
    synthetic_flame.write_new(folder / "flame2023.pkl")
    synthetic_flame.write_embedding(folder / "landmark_embedding_with_eyes.npy")
    return folder


@pytest.fixture(scope="session")
def flame(flame_folder: Path) -> Flame:
    return Flame.read(flame_folder / "flame2023.pkl", teeth=True)


@pytest.fixture(scope="session")
def anna(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model directory whose splats reach the teeth."""
    return synthetic_flame.write_avatar(tmp_path_factory.mktemp("models") / "anna", seed=1)


@pytest.fixture(scope="session")
def ben(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another person, without teeth."""
    folder = tmp_path_factory.mktemp("models") / "ben"
    return synthetic_flame.write_avatar(folder, splats=400, seed=2, teeth=False)
