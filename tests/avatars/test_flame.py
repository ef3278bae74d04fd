"""FLAME against its NumPy twin, the laws of posing, the teeth, and wrong model files."""

from __future__ import annotations

from pathlib import Path

import flame_twin
import numpy as np
import pytest
import synthetic_flame
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

from splatmorph.avatars.flame import Flame, Pose
from splatmorph.avatars.flame_file import read_flame
from splatmorph.avatars.teeth import LOWER_LIP, UPPER_LIP, teeth_faces
from splatmorph.errors import ReadError

ANGLES = hnp.arrays(np.float64, (5, 3), elements=st.floats(-1.5, 1.5))


def _pose(joints: np.ndarray, expression: np.ndarray | None = None) -> Pose:
    expression = np.zeros(0) if expression is None else expression
    zero = torch.zeros(3, dtype=torch.float64)
    return Pose(torch.from_numpy(expression), torch.from_numpy(joints), zero)


def test_posing_agrees_with_the_twin(flame: Flame) -> None:
    random = np.random.default_rng(3)
    shape, expression = random.normal(size=300) * 0.5, random.normal(size=100) * 0.5
    joints = random.normal(size=(5, 3)) * 0.4
    wanted = flame_twin.posed_vertices(synthetic_flame.model(), shape, expression, joints)
    found = flame(flame.rest(torch.from_numpy(shape)), _pose(joints, expression))
    np.testing.assert_allclose(found[:5023].numpy(), wanted, atol=1e-12)


def test_the_canonical_pose_is_the_person(flame: Flame) -> None:
    rest = flame.rest(torch.ones(300))
    torch.testing.assert_close(flame(rest, Pose.canonical()), rest, rtol=0, atol=1e-15)


@settings(max_examples=5, deadline=None)
@given(root=hnp.arrays(np.float64, 3, elements=st.floats(-3, 3)), joints=ANGLES)
def test_the_root_turns_everything_about_itself(
    flame: Flame, root: np.ndarray, joints: np.ndarray
) -> None:
    rest = flame.rest(torch.zeros(0))
    joints[0] = 0
    still = flame(rest, _pose(joints)).numpy()
    joints[0] = root
    turned = flame(rest, _pose(joints)).numpy()
    pivot = flame.regressor[0].numpy() @ rest.numpy()
    wanted = (still - pivot) @ Rotation.from_rotvec(root).as_matrix().T + pivot
    np.testing.assert_allclose(turned, wanted, atol=1e-12)


def test_a_batch_is_its_frames(flame: Flame) -> None:
    random = np.random.default_rng(4)
    batch = Pose(
        torch.from_numpy(random.normal(size=(3, 50))),
        torch.from_numpy(random.normal(size=(3, 5, 3)) * 0.3),
        torch.from_numpy(random.normal(size=(3, 3))),
        torch.from_numpy(random.normal(size=(3, 5023, 3)) * 1e-3),
    )
    rest = flame.rest(torch.zeros(0))
    together = flame(rest, batch)
    for i in range(3):
        parts = batch.expression[i], batch.joints[i], batch.translation[i], batch.offset[i]
        torch.testing.assert_close(together[i], flame(rest, Pose(*parts)), rtol=0, atol=1e-13)


def test_offsets_move_before_the_joints_do(flame: Flame) -> None:
    random = np.random.default_rng(5)
    offset = random.normal(size=(5023, 3)) * 1e-3
    joints = random.normal(size=(5, 3)) * 0.3
    model = synthetic_flame.model()
    wanted = flame_twin.skinned(model, model["v_template"] + offset, joints)
    given_static = flame(flame.rest(torch.zeros(0), torch.from_numpy(offset)), _pose(joints))
    pose = _pose(joints)
    dynamic = Pose(pose.expression, pose.joints, pose.translation, torch.from_numpy(offset))
    given_dynamic = flame(flame.rest(torch.zeros(0)), dynamic)
    np.testing.assert_allclose(given_static[:5023].numpy(), wanted, atol=1e-12)
    np.testing.assert_allclose(given_dynamic[:5023].numpy(), wanted, atol=1e-12)


def test_coefficients_that_are_not_given_are_zero(flame: Flame) -> None:
    few = torch.ones(10, dtype=torch.float64)
    padded = torch.cat([few, torch.zeros(290, dtype=torch.float64)])
    torch.testing.assert_close(flame.rest(few), flame.rest(padded), rtol=0, atol=1e-15)
    with pytest.raises(ReadError, match="301 shape coefficients"):
        flame.rest(torch.zeros(301))
    with pytest.raises(ReadError, match="offsets of 4000 vertices"):
        flame.rest(few, torch.zeros(4000, 3))


def test_gradients_reach_shape_and_pose(flame: Flame) -> None:
    shape = torch.zeros(5, dtype=torch.float64, requires_grad=True)
    joints = torch.zeros(5, 3, dtype=torch.float64, requires_grad=True)
    pose = Pose(torch.zeros(0), joints, torch.zeros(3))
    flame(flame.rest(shape), pose).square().sum().backward()
    assert shape.grad is not None
    assert joints.grad is not None
    assert torch.isfinite(joints.grad).all()
    assert shape.grad.abs().min() > 0


def test_teeth_follow_their_joints_and_the_lips(flame: Flame) -> None:
    assert len(flame.template) == 5143
    assert len(flame.faces) == 10144
    upper = torch.cat([torch.arange(15) + start for start in (5023, 5053, 5083, 5098)])
    lower = torch.cat([torch.arange(15) + start for start in (5038, 5068, 5113, 5128)])
    assert (flame.weights[upper, 1] == 1).all()
    assert (flame.weights[lower, 2] == 1).all()
    assert (flame.weights[5023:].sum(1) == 1).all()
    assert not flame.poses[5023:].any()
    assert not flame.expressions[5023:].any()
    assert not flame.regressor[:, 5023:].any()
    lips = (flame.shapes[UPPER_LIP] + flame.shapes[LOWER_LIP]) / 2
    torch.testing.assert_close(
        flame.shapes[5023:].unflatten(0, (8, 15)), lips.expand(8, -1, -1, -1)
    )
    # Edge rows lie either side of the lips' line, roots beyond them, all of it behind the lips.
    rows = flame.template[5023:].unflatten(0, (8, 15))
    heights, depths = rows[..., 1].mean(1), rows[..., 2].mean(1)
    assert heights[0] > heights[2] > heights[3] > heights[1]
    assert depths.max() < flame.template[UPPER_LIP, 2].mean()


def test_an_open_jaw_parts_the_teeth(flame: Flame) -> None:
    rest = flame.rest(torch.zeros(0))
    joints = np.zeros((5, 3))
    joints[2, 0] = 0.3
    opened = flame(rest, _pose(joints))
    upper, lower = slice(5053, 5068), slice(5068, 5083)
    torch.testing.assert_close(opened[upper], rest[upper])
    assert (opened[lower, 1] < rest[lower, 1] - 0.01).all()


def test_teeth_are_two_bars_of_three_sides() -> None:
    faces = teeth_faces()
    assert faces.shape == (168, 3)
    assert faces.min() == 5023
    assert faces.max() == 5142
    # GaussianAvatars' first and last faces of each bar.
    for number, corners in (
        (0, (0, 31, 30)),
        (83, (88, 44, 89)),
        (84, (45, 46, 15)),
        (167, (118, 119, 59)),
    ):
        assert tuple(faces[number] - 5023) == corners
    # Three open strips of 28 faces make a bar; no edge is walked twice the same way, so that the
    # normals of neighbours agree.
    edges = [
        (a, b) for face in faces.tolist() for a, b in zip(face, np.roll(face, -1), strict=True)
    ]
    assert len(set(edges)) == len(edges)


def test_chumpy_and_new_files_are_one_model(flame_folder: Path, tmp_path: Path) -> None:
    new = read_flame(flame_folder / "flame2023.pkl")
    old = read_flame(synthetic_flame.write_chumpy(tmp_path / "generic_model.pkl"))
    for name in ("template", "shapes", "expressions", "poses", "regressor", "weights", "faces"):
        np.testing.assert_array_equal(getattr(new, name), getattr(old, name))
    assert new.parents == old.parents == (-1, 0, 1, 1, 1)


NAN_WEIGHTS = np.full((5023, 5), np.nan)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"v_template": np.zeros((6890, 3))}, r"6890 vertices.*SMPL.*expected FLAME"),
        ({"v_template": np.zeros((778, 3)), "kintree_table": np.zeros((2, 16))}, "MANO"),
        ({"kintree_table": np.zeros((2, 24))}, "24 joints"),
        ({"posedirs": None}, "no 'posedirs'"),
        ({"shapedirs": np.zeros((5023, 3, 10))}, r"'shapedirs' of shape \(5023, 3, 10\)"),
        ({"posedirs": np.zeros((5023, 3, 9))}, r"shape \(5023, 3, 9\), expected \(5023, 3, 36\)"),
        ({"weights": NAN_WEIGHTS}, "NaN or infinite values in 'weights'"),
        ({"weights": {"not": "numbers"}}, "no table of numbers"),
        ({"f": np.full((9976, 3), 5023)}, "up to vertex 5023"),
        ({"kintree_table": np.full((2, 5), 4)}, "before their parents"),
    ],
    ids=["smpl", "mano", "joints", "missing", "few", "shape", "nan", "object", "faces", "tree"],
)
def test_another_model_is_refused(tmp_path: Path, changes: dict, words: str) -> None:
    # The large table is read last; without it these files are small.
    changes = {"shapedirs": None} | changes
    path = synthetic_flame.write_new(tmp_path / "model.pkl", **changes)
    with pytest.raises(ReadError, match=words) as caught:
        read_flame(path)
    assert str(caught.value).count("\n") == 0


def test_a_file_of_masks_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "FLAME_masks.pkl"
    synthetic_flame.write_plain(path, {"face": np.arange(5)})
    with pytest.raises(ReadError, match=r"no 'v_template' \(it has face\)"):
        read_flame(path)
    synthetic_flame.write_plain(path, [1, 2])
    with pytest.raises(ReadError, match="holds a list"):
        read_flame(path)
