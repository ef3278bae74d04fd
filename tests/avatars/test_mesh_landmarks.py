"""The three sets of landmarks, and thinning of matched ones."""

from __future__ import annotations

from pathlib import Path

import flame_twin
import numpy as np
import pytest
import torch

from splatmorph.avatars import load_avatar, thin
from splatmorph.avatars.landmark_sets import paper_vertices
from splatmorph.avatars.stand_ins import as_array
from splatmorph.avatars.unpickle import load_object_array
from splatmorph.errors import LandmarkError, OptionError, ReadError
from splatmorph.landmarks import Landmarks


def test_the_paper_s_vertices() -> None:
    vertices = paper_vertices()
    assert len(vertices) == 250
    assert vertices == sorted(set(vertices))
    assert vertices[0] >= 0
    assert vertices[-1] < 5023


def test_the_paper_s_landmarks_are_vertices_by_name(anna: Path, flame_folder: Path) -> None:
    avatar = load_avatar(anna, frame=1, flame=flame_folder)
    names = avatar.landmarks.names
    assert names is not None
    assert names == tuple(f"flame_{vertex}" for vertex in paper_vertices())
    torch.testing.assert_close(avatar.landmarks.points, avatar.vertices[paper_vertices()])


def test_the_70_agree_with_the_twin(anna: Path, flame_folder: Path) -> None:
    avatar = load_avatar(anna, frame=1, flame=flame_folder, landmarks_set="70")
    stored = load_object_array(flame_folder / "landmark_embedding_with_eyes.npy")
    points = flame_twin.on_faces(
        avatar.vertices.numpy(),
        avatar.rig.faces.numpy(),
        stored["full_lmk_faces_idx"][0],
        as_array(stored["full_lmk_bary_coords"])[0],
    )
    np.testing.assert_allclose(avatar.landmarks.points.numpy(), points, atol=1e-14)
    names = avatar.landmarks.names
    assert names is not None
    assert (len(names), names[0], names[67:]) == (
        70,
        "ibug_0",
        ("ibug_67", "right_eye", "left_eye"),
    )


def test_dense_takes_the_vertices_with_splats_near(anna: Path, flame_folder: Path) -> None:
    avatar = load_avatar(anna, flame=flame_folder, landmarks_set="dense")
    names = avatar.landmarks.names
    assert names is not None
    taken = {int(name.removeprefix("flame_")) for name in names}
    corners = avatar.vertices[avatar.rig.faces].numpy()
    reach = 2 * np.median(np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1))
    visible = avatar.gaussians.means[avatar.gaussians.opacities > 0.1].double().numpy()
    for vertex, point in enumerate(avatar.vertices.numpy()):
        near = np.linalg.norm(visible - point, axis=1).min() <= reach
        assert near == (vertex in taken)


def test_what_is_wrong_with_landmarks(anna: Path, flame_folder: Path, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="'68' is not one of: 70, 254, dense"):
        load_avatar(anna, flame=flame_folder, landmarks_set="68")
    alone = tmp_path / "flame2023.pkl"
    alone.symlink_to(flame_folder / "flame2023.pkl")
    with pytest.raises(ReadError, match="`landmarks_set` 254, which needs no file"):
        load_avatar(anna, flame=alone, landmarks_set="70")
    embedding = tmp_path / "landmark_embedding_with_eyes.npy"
    for stored, words in (
        ({"static_lmk_faces_idx": np.zeros(51)}, "no 'full_lmk_faces_idx'"),
        (
            {"full_lmk_faces_idx": np.zeros((1, 68)), "full_lmk_bary_coords": np.zeros((1, 68, 3))},
            "has 68 points",
        ),
        (
            {
                "full_lmk_faces_idx": np.full((1, 70), 20000),
                "full_lmk_bary_coords": np.zeros((70, 3)),
            },
            "faces up to 20000",
        ),
    ):
        np.save(embedding, np.array(stored, dtype=object), allow_pickle=True)
        with pytest.raises(ReadError, match=words):
            load_avatar(anna, flame=alone, landmarks_set="70")


POINTS = torch.from_numpy(np.random.default_rng(0).normal(size=(200, 3)))
NAMES = tuple(f"p{i}" for i in range(200))


def test_thinning_is_the_same_from_both_sides() -> None:
    source = Landmarks(POINTS, NAMES)
    target = Landmarks(POINTS.flip(0) * 1.1, NAMES[::-1])
    first = thin(source, target, 30)
    second = thin(target, source, 30)
    assert len(first[0]) == 30
    assert first[0].names == first[1].names
    assert set(first[0].names or ()) == set(second[0].names or ())
    everything, _ = thin(source, target, 1000)
    assert everything.names == NAMES


def test_thinning_takes_matched_landmarks_only() -> None:
    source = Landmarks(POINTS, NAMES)
    target = Landmarks(POINTS[:50], NAMES[:50])
    thinned, _ = thin(source, target, 100)
    assert thinned.names == NAMES[:50]
    with pytest.raises(OptionError, match="3 landmarks are too few"):
        thin(source, target, 3)
    with pytest.raises(LandmarkError):
        thin(source, Landmarks(POINTS, tuple(f"q{i}" for i in range(200))), 10)


def test_the_real_heads_name_their_landmarks_alike(shared_data: Path) -> None:
    beside = Landmarks.read(shared_data / "heads" / "james.landmarks.json")
    avatar = load_avatar(shared_data / "avatars" / "james")
    assert set(beside.names or ()) <= set(avatar.landmarks.names or ())
    dense = load_avatar(shared_data / "avatars" / "james", landmarks_set="dense").landmarks
    assert 3000 < len(dense) < 5023
