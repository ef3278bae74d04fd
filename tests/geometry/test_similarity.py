"""Similarities: the laws of a group, of its one-parameter subgroups, and what is found between."""

from __future__ import annotations

import json
import math

import pytest
import torch
from torch import Tensor

from splatmorph.geometry.quaternions import normalized
from splatmorph.geometry.similarity import Similarity

DEGREES = (0, 1e-7, 1, 60, 90, 179.9, 180 - 1e-7, 180)
SCALES = (1e-6, 0.3, 1, 1 + 1e-9, 1e6)
dims = pytest.mark.parametrize("dim", [2, 3])


def rotation(dim: int, degrees: float, seed: int = 0) -> Tensor:
    angle = math.radians(degrees)
    if dim == 2:
        return torch.tensor(
            [[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]],
            dtype=torch.float64,
        )
    axis = torch.randn(3, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)
    x, y, z = (axis / axis.norm()).tolist()
    skew = torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64)
    half = 2 * math.sin(angle / 2) ** 2
    return torch.eye(3).double() + math.sin(angle) * skew + half * skew @ skew


def samples(dim: int) -> list[Similarity]:
    generator = torch.Generator().manual_seed(dim)
    made = []
    for i, degrees in enumerate(DEGREES):
        for scale in SCALES:
            shift = torch.randn(dim, generator=generator, dtype=torch.float64)
            turn = rotation(dim, degrees, i).double()
            made.append(Similarity(turn, scale, shift * max(1, scale)))
    return made


def assert_same(a: Similarity, b: Similarity, tolerance: float = 1e-9) -> None:
    """The same map, as far as points tell that lie where either takes them a unit apart."""
    torch.testing.assert_close(a.rotation, b.rotation, rtol=0, atol=tolerance)
    assert math.isclose(a.scale, b.scale, rel_tol=tolerance)
    size = a.scale + float(a.shift.norm())
    assert float((a.shift - b.shift).norm()) <= tolerance * size


@dims
def test_is_a_group(dim: int) -> None:
    elements = samples(dim)
    unit = Similarity.identity(dim)
    x = torch.randn(7, dim, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    for a, b, c in zip(
        elements, elements[7:] + elements[:7], elements[3:] + elements[:3], strict=True
    ):
        assert_same((a @ b) @ c, a @ (b @ c))
        assert_same(a @ unit, a, 0)
        assert_same(unit @ a, a, 0)
        back = (a.inverse() @ a)(x)
        torch.testing.assert_close(back, x, rtol=0, atol=1e-8)
        size = b.scale * a.scale + a.scale * float(b.shift.norm()) + float(a.shift.norm())
        assert float(((a @ b)(x) - a(b(x))).abs().max()) <= 1e-12 * (1 + size)


@dims
def test_powers_are_a_one_parameter_subgroup(dim: int) -> None:
    for element in samples(dim):
        assert element.power(1) is element
        assert element.power(0).is_identity
        assert_same(Similarity.exp(element.log()), element, 1e-8)
        assert_same(element.power(0.3) @ element.power(0.7), element, 1e-8)
        assert_same(element.power(0.5) @ element.power(0.5), element, 1e-8)
        assert_same(element.power(-1), element.inverse(), 1e-8)
        assert_same(element.power(-0.4) @ element.power(1.4), element, 1e-8)


@dims
def test_power_is_the_matrix_exponential(dim: int) -> None:
    for element in samples(dim):
        # Beyond, matrix_exp is the less exact of the two.
        if 0.1 < element.scale < 10:
            matrix = torch.matrix_exp(0.37 * element.log())
            found = element.power(0.37)
            linear = found.scale * found.rotation
            torch.testing.assert_close(linear, matrix[:dim, :dim], rtol=0, atol=1e-12)
            torch.testing.assert_close(found.shift, matrix[:dim, dim], rtol=0, atol=1e-11)


def test_a_half_turn_goes_half_way_round_its_axis() -> None:
    turn = torch.diag(torch.tensor([-1.0, 1.0, -1.0], dtype=torch.float64))
    element = Similarity(turn, 4.0, torch.tensor([10.0, 0.0, 0.0]))
    assert element.degrees == pytest.approx(180)
    assert element.axis.abs().tolist() == pytest.approx([0, 1, 0])
    half = element.power(0.5)
    assert half.scale == pytest.approx(2)
    assert half.degrees == pytest.approx(90)
    torch.testing.assert_close(half(half(torch.ones(3).double())), element(torch.ones(3).double()))


@dims
def test_the_way_does_not_depend_on_the_coordinates(dim: int) -> None:
    # Conjugation: G S(t) G⁻¹ = (G S G⁻¹)(t), wherever the origin lies and whatever the unit.
    one, other = (
        Similarity(rotation(dim, d, 5), s, torch.ones(dim)) for d, s in ((70, 2), (110, 30))
    )
    assert_same(
        other @ one.power(0.4) @ other.inverse(), (other @ one @ other.inverse()).power(0.4)
    )


@dims
def test_points_keep_their_type(dim: int) -> None:
    element = Similarity(rotation(dim, 30), 2.0, torch.ones(dim))
    x = torch.rand(5, dim)
    assert element(x).dtype == torch.float32
    torch.testing.assert_close(element(x), element(x.double()).float())


@dims
def test_survives_json(dim: int) -> None:
    for element in samples(dim):
        stored = Similarity.from_dict(json.loads(json.dumps(element.to_dict())))
        assert_same(stored, element, 0)


@pytest.mark.parametrize(
    ("turn", "scale", "shift"),
    [
        (torch.eye(3), 0.0, torch.zeros(3)),
        (torch.eye(3), -1.0, torch.zeros(3)),
        (torch.eye(3), math.nan, torch.zeros(3)),
        (torch.eye(3), math.inf, torch.zeros(3)),
        (2 * torch.eye(3), 1.0, torch.zeros(3)),
        (torch.diag(torch.tensor([-1.0, 1.0, 1.0])), 1.0, torch.zeros(3)),
        (torch.eye(3), 1.0, torch.full((3,), math.nan)),
        (torch.eye(3), 1.0, torch.zeros(2)),
        (torch.eye(4), 1.0, torch.zeros(4)),
        (torch.full((3, 3), math.nan), 1.0, torch.zeros(3)),
    ],
)
def test_what_is_no_similarity_is_refused(turn: Tensor, scale: float, shift: Tensor) -> None:
    with pytest.raises(ValueError, match=r"rotation|R is"):
        Similarity(turn, scale, shift)


def test_quaternions_agree_on_the_angle() -> None:
    quat = normalized(torch.tensor([0.6, 0.0, 0.8, 0.0], dtype=torch.float64))
    angle = 2 * math.degrees(math.atan2(0.8, 0.6))
    turn = rotation(3, 0).clone()
    w, _, y, _ = quat.tolist()
    turn[0, 0] = turn[2, 2] = 1 - 2 * y * y
    turn[0, 2], turn[2, 0] = 2 * w * y, -2 * w * y
    element = Similarity(turn, 1.0, torch.zeros(3))
    assert element.degrees == pytest.approx(angle)
    assert element.axis.tolist() == pytest.approx([0, 1, 0])
