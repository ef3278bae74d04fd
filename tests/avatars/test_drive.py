"""Driving: a morph of two rigged heads, posed frame by frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from splatmorph.avatars import Drive, load_avatar, track_of
from splatmorph.avatars.avatar import Avatar
from splatmorph.avatars.track import Track
from splatmorph.errors import OptionError
from splatmorph.flows import Flow
from splatmorph.gaussians import Gaussians
from splatmorph.morph import Morph


class Rigid(Flow):
    """Φ(x, t) = x + t·d: the flow between two heads of one shape that stand apart."""

    shift: torch.Tensor

    def __init__(self, shift: torch.Tensor) -> None:
        super().__init__(3)
        self.register_buffer("shift", shift.double())

    def trajectory(self, x: torch.Tensor, times: object) -> torch.Tensor:
        t = torch.as_tensor(times, dtype=x.dtype)
        return x + t[:, None, None] * self.shift.to(x)

    def trajectory_jacobian(
        self, x: torch.Tensor, times: Sequence[float]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        return self.trajectory(x, times), torch.eye(3).to(x).expand(len(times), len(x), 3, 3)


@pytest.fixture(scope="module")
def heads(anna: Path, ben: Path, flame_folder: Path) -> tuple[Avatar, Avatar]:
    """Anna has teeth and Ben hasn't."""
    return load_avatar(anna, flame=flame_folder), load_avatar(ben, flame=flame_folder)


@pytest.fixture(scope="module")
def track(ben: Path) -> Track:
    return track_of(ben)


def _assert_same(found: Gaussians, wanted: Gaussians, tolerance: float = 1e-6) -> None:
    torch.testing.assert_close(found.means, wanted.means, rtol=0, atol=tolerance)
    torch.testing.assert_close(found.log_scales, wanted.log_scales, rtol=0, atol=1e-4)
    cosines = torch.nn.functional.cosine_similarity(found.quats, wanted.quats).abs()
    assert (1 - cosines).max() < 1e-5
    assert torch.equal(found.opacity_logits, wanted.opacity_logits)
    assert set(found.extras) == set(wanted.extras)


def test_the_ends_are_the_heads_posed(
    heads: tuple[Avatar, Avatar], track: Track, anna: Path, ben: Path, flame_folder: Path
) -> None:
    drive = Drive(*heads, Rigid(torch.tensor([0.01, 0.02, 0.0])), track, whole_head=True)
    start, end = drive.sequence([0.0, 1.0], [1, 3])
    _assert_same(start, load_avatar(anna, pose=ben, frame=1, flame=flame_folder).gaussians)
    _assert_same(end, load_avatar(ben, frame=3, flame=flame_folder).gaussians)


def test_the_canonical_frame_is_the_morph(heads: tuple[Avatar, Avatar], track: Track) -> None:
    flow = Rigid(torch.tensor([0.0, 0.01, 0.02]))
    still = replace(
        track,
        expression=torch.zeros_like(track.expression),
        joints=torch.zeros_like(track.joints),
        translation=torch.zeros_like(track.translation),
    )
    drive = Drive(*heads, flow, still, ramp="linear", ease="smooth")
    morph = Morph(heads[0].gaussians, heads[1].gaussians, flow, ramp="linear", ease="smooth")
    times = [-0.2, 0.0, 0.3, 1.0, 1.2]
    for found, wanted in zip(drive.sequence(times), morph.sequence(times), strict=True):
        _assert_same(found, wanted)


def test_a_head_morphed_into_itself_talks_as_itself(
    heads: tuple[Avatar, Avatar], track: Track, anna: Path, ben: Path, flame_folder: Path
) -> None:
    flow = Rigid(torch.zeros(3))
    posed = load_avatar(anna, pose=ben, frame=2, flame=flame_folder).gaussians
    drive = Drive(heads[0], heads[0], flow, track, whole_head=True, ramp="linear")
    (half,) = drive.sequence([0.5], [2])
    n = len(posed)
    for own in (half.select(torch.arange(n)), half.select(torch.arange(n, 2 * n))):
        _assert_same(replace(own, opacity_logits=posed.opacity_logits), posed)


def test_the_whole_head_stays_unless_asked(heads: tuple[Avatar, Avatar], track: Track) -> None:
    flow = Rigid(torch.zeros(3))
    far = replace(track, translation=track.translation + 5.0)
    (stays,) = Drive(*heads, flow, far).sequence([0.0], [0])
    (goes,) = Drive(*heads, flow, far, whole_head=True).sequence([0.0], [0])
    assert stays.means.abs().max() < 1
    assert goes.means.median() > 4


def test_frames_run_through_the_track(heads: tuple[Avatar, Avatar], track: Track) -> None:
    drive = Drive(*heads, Rigid(torch.zeros(3)), track)
    assert drive.frames(4) == [0, 1, 2, 3]
    assert drive.frames(7)[::2] == [0, 1, 2, 3]
    assert drive.frames(2) == [0, 3]
    assert drive.frames(1) == [0]
    assert len(list(drive.sequence([0.0, 0.25, 0.5]))) == 3


def test_offsets_of_the_track_s_person_stay_with_it(
    heads: tuple[Avatar, Avatar], track: Track
) -> None:
    flow = Rigid(torch.zeros(3))
    odd = replace(track, dynamic_offset=torch.full((4, 5023, 3), 0.1, dtype=torch.float64))
    (wanted,) = Drive(*heads, flow, track).sequence([0.0], [1])
    (found,) = Drive(*heads, flow, odd).sequence([0.0], [1])
    _assert_same(found, wanted, 0.0)


def test_what_cannot_be_driven(
    heads: tuple[Avatar, Avatar], track: Track, ben: Path, flame_folder: Path
) -> None:
    flow = Rigid(torch.zeros(3))
    moving = load_avatar(ben, frame=1, flame=flame_folder)
    with pytest.raises(OptionError, match=r"ben .*\(frame 1 of its track\).*without `frame`"):
        Drive(heads[0], moving, flow, track)
    drive = Drive(*heads, flow, track)
    with pytest.raises(OptionError, match="frames 0 to 3, not 4"):
        drive.sequence([0.0], [4])
    with pytest.raises(OptionError, match="2 frames for 1 times"):
        drive.sequence([0.0], [1, 2])
    with pytest.raises(OptionError, match="ramp 'no' is not one of"):
        Drive(*heads, flow, track, ramp="no")
