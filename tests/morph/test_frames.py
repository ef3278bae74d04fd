"""A morph between captures that share no frame: what a similarity does is no deformation."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from morph_cases import AffineFlow, affine_flow, random_gaussians, same_bits, union

from splatmorph.gaussians import Gaussians
from splatmorph.geometry.quaternions import matrices_from_axis_angles
from splatmorph.geometry.similarity import Similarity
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Chain, average, mean_landmarks
from splatmorph.morph.transport import COVARIANCES

A, B, C = (random_gaussians(n, degree=1, seed=n) for n in (30, 20, 25))
TIMES = [0, 0.3, 0.5, 1, 1.4, -0.2]
every_covariance = pytest.mark.parametrize("covariance", COVARIANCES)


def similarity(degrees: float = 150, scale: float = 3.0, shift: float = 2.0) -> Similarity:
    axis = torch.tensor([0.6, 0.64, 0.48], dtype=torch.float64)
    turn = matrices_from_axis_angles(torch.deg2rad(torch.tensor(degrees)) * axis)
    return Similarity(turn, scale, shift * torch.tensor([1.0, -2.0, 3.0]))


FRAMES = [
    similarity(),
    similarity(180, 1000, 1e4),
    similarity(90, 1e-3, 0),
    similarity(0, 1, 5),
    Similarity.identity(),
]
every_frame = pytest.mark.parametrize("frame", FRAMES, ids=["turn", "km", "mm", "shift", "none"])


def assert_close(a: Gaussians, b: Gaussians, tolerance: float = 1e-4) -> None:
    size = float(a.means.abs().max())
    assert float((a.absolute_means - b.absolute_means).abs().max()) < tolerance * size
    torch.testing.assert_close(a.log_scales, b.log_scales, atol=tolerance, rtol=tolerance)
    torch.testing.assert_close(a.opacity_logits, b.opacity_logits, atol=1e-3, rtol=1e-3)
    torch.testing.assert_close(a.sh, b.sh, atol=1e-3, rtol=1e-3)


@every_frame
@every_covariance
@pytest.mark.parametrize("split", [None, 1.5])
def test_ends_are_the_inputs_bit_for_bit(
    frame: Similarity, covariance: str, split: float | None
) -> None:
    morph = union(A, B, affine_flow(), frame=frame, covariance=covariance, split=split)
    assert same_bits(morph.at(0), A)
    assert same_bits(morph.at(1), B)
    stable = replace(morph, stable_count=True)
    assert same_bits(stable.at(0).select(torch.arange(len(A))), replace(A, extras=A.extras))
    count = len(stable.at(0))
    last = stable.at(1)
    assert len(last) == count
    where = (last.means[:, None] == B.means).all(2).any(1)
    assert int(where.sum()) == len(B)


@every_frame
@every_covariance
def test_what_is_played_is_what_stays_moved_by_the_power_of_the_frame(
    frame: Similarity, covariance: str
) -> None:
    target = B.moved(frame)
    morph = union(A, target, affine_flow(), frame=frame, covariance=covariance)
    still = replace(morph, stay=True)
    for t, played, stayed in zip(TIMES, morph.sequence(TIMES), still.sequence(TIMES), strict=True):
        assert_close(played, stayed.moved(frame.power(t)))
    assert same_bits(still.at(0), A)
    assert_close(still.at(1), B)


@every_covariance
def test_a_similarity_of_the_target_changes_nothing_but_the_frame(covariance: str) -> None:
    rest, done = similarity(10, 1.1, 0.1), similarity()
    morph = union(A, B, affine_flow(), frame=rest, covariance=covariance, stay=True)
    away = replace(morph, target=B.moved(done), frame=done @ rest)
    for one, other in zip(morph.sequence(TIMES), away.sequence(TIMES), strict=True):
        assert_close(one, other)


def test_swapping_the_inputs_reverses_the_morph() -> None:
    frame, flow = similarity(), affine_flow()
    there = torch.eye(4, dtype=torch.float64)
    there[:3, :3], there[:3, 3] = frame.scale * frame.rotation, frame.shift
    back = AffineFlow(torch.zeros(3, 3), torch.zeros(3))
    back.augmented.copy_(-there @ flow.augmented @ torch.linalg.inv(there))
    forth = union(A, B, flow, frame=frame).at(0.3)
    reversed_ = union(B, A, back, frame=frame.inverse()).at(0.7)
    index = torch.cat([torch.arange(len(B), len(B) + len(A)), torch.arange(len(B))])
    assert_close(forth, reversed_.select(index))


def test_offsets_and_the_axis_up_go_from_one_end_to_the_other() -> None:
    source = replace(A, up="y", offset=(480_000.0, 5_400_000.0, 100.0))
    target = replace(B, up="z", offset=(0.0, 0.0, 0.0))
    frame = Similarity(torch.tensor([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), 1.0, torch.zeros(3))
    morph = union(source, target, affine_flow(), frame=frame)
    first, middle, last = morph.sequence([0, 0.5, 1])
    assert same_bits(first, source)
    assert (first.up, first.offset) == ("y", source.offset)
    assert (last.up, last.offset) == ("z", (0.0, 0.0, 0.0))
    assert middle.up is None
    assert middle.offset == (240_000.0, 2_700_000.0, 50.0)
    stayed = replace(morph, stay=True).at(1)
    assert (stayed.up, stayed.offset) == ("y", source.offset)


@every_covariance
def test_a_morph_in_place_is_the_one_that_stays(covariance: str) -> None:
    whole = union(A, B, affine_flow(), frame=similarity(), stay=True, covariance=covariance)
    for one, other in zip(whole.sequence(TIMES), whole.in_place().sequence(TIMES), strict=True):
        assert same_bits(one, other)
        assert (one.up, one.offset) == (other.up, other.offset)


def chain(stay: bool = False) -> Chain:
    frames = similarity(), similarity(100, 0.01, -1)
    legs = [(A, B, frames[0]), (B, C, frames[1])]
    return Chain([union(a, b, affine_flow(), frame=frame, stay=stay) for a, b, frame in legs])


def test_a_chain_visits_its_splats_wherever_they_are() -> None:
    for frame, splat in zip(chain().sequence([0, 1, 2]), (A, B, C), strict=True):
        assert same_bits(frame, splat)


def test_a_chain_that_stays_stays_with_the_first() -> None:
    still = chain(stay=True)
    one, two = (morph.frame for morph in still.morphs)
    assert same_bits(still.at(0), A)
    assert_close(still.at(1), B.moved(one.inverse()))
    assert_close(still.at(2), C.moved((two @ one).inverse()))
    assert_close(still.at(1.5), still.morphs[1].at(0.5).moved(one.inverse()))
    with pytest.raises(ValueError, match="all or none"):
        Chain([still.morphs[0], replace(still.morphs[1], stay=False)])


def test_an_average_stands_where_its_common_shape_does() -> None:
    frames = [similarity(), similarity(20, 0.5, 1)]
    mean = average([A, B], [affine_flow()] * 2, frames=frames, blend="union")
    expected = frames[0](affine_flow().trajectory(A.means, [1.0])[0])
    torch.testing.assert_close(mean.means[: len(A)], expected)


def test_mean_landmarks_are_of_shapes_not_of_places() -> None:
    points = torch.rand(12, 3, generator=torch.Generator().manual_seed(0)).double()
    names = tuple("abcdefghijkl")
    for frame in FRAMES:
        mean = mean_landmarks([Landmarks(points, names), Landmarks(frame(points), names)])
        torch.testing.assert_close(mean.points, frame.power(0.5)(points), rtol=1e-6, atol=1e-6)
