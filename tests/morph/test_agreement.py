"""Halves that agree: the laws of the union still hold, and the middle is one thing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from morph_cases import affine_flow, same_bits

from renderer import orbit, rasterize
from splatmorph.errors import OptionError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.harmonics import SH0
from splatmorph.images.quality import psnr
from splatmorph.morph import Chain, Morph, average
from splatmorph.morph.agreement import fade, melt
from splatmorph.morph.agreement.neighbours import Neighbours
from splatmorph.rendering import bounds, renderer_arrays


def ball(
    n: int = 1500, radius: float = 1.0, seed: int = 0, degree: int = 0, size: float = 0.06
) -> Gaussians:
    """A solid sphere of flat splats with bands of colour."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    w, half = normals[:, 2:] + 1, normals
    quats = np.concatenate([w, -half[:, 1:2], half[:, :1], 0 * w], 1)  # z onto the normal
    sh = np.zeros((n, (degree + 1) ** 2, 3))
    sh[:, 0] = 0.3 * np.sin(5 * normals[:, 1:2] + np.arange(3)) / SH0
    sh[:, 1:] = 0.05 * rng.normal(size=sh[:, 1:].shape)
    return Gaussians(
        *(
            torch.from_numpy(array).float()
            for array in (
                radius * normals,
                quats,
                np.log([[radius * size, radius * size, radius * size / 5]] * n),
                np.full(n, 3.0),
                sh,
            )
        )
    )


def tinted(gaussians: Gaussians, rgb: tuple[float, float, float]) -> Gaussians:
    sh = gaussians.sh.clone()
    sh[:, 0] = torch.tensor(rgb) / SH0 - 0.5 / SH0
    return replace(gaussians, sh=sh)


def picture(gaussians: Gaussians, around: Gaussians, azimuth: float = 20.0) -> np.ndarray:
    camera = orbit(bounds(around), [azimuth], width=96, height=96)[0]
    return rasterize(*renderer_arrays(gaussians), camera.viewmat, camera.K, 96, 96)[0]


def still() -> object:
    flow = affine_flow()
    flow.augmented.zero_()
    return flow


SOURCE, TARGET = ball(seed=1), ball(1200, seed=2, degree=1)


@pytest.mark.parametrize("covariance", ["fixed", "rotate", "full"])
def test_ends_are_the_inputs_bit_for_bit_and_beyond_them_is_the_union(covariance: str) -> None:
    morphs = [
        Morph(SOURCE, TARGET, affine_flow(), covariance=covariance, blend=blend)
        for blend in ("agree", "union")
    ]
    times = [0.0, 1.0, -0.5, 1.5]
    for t, agreed, union in zip(times, *(morph.sequence(times) for morph in morphs), strict=True):
        assert same_bits(agreed, union), t
    assert same_bits(morphs[0].at(0), SOURCE)


def test_nothing_jumps_at_the_ends() -> None:
    morph = Morph(SOURCE, TARGET, affine_flow(), blend="agree")
    for t, end in ((1e-3, SOURCE), (1 - 1e-3, TARGET)):
        near, there = (torch.from_numpy(picture(g, end)) for g in (morph.at(t), end))
        assert psnr(near, there) > 50


def test_a_splat_morphed_into_itself_takes_on_nothing() -> None:
    morph = Morph(SOURCE, SOURCE, still(), blend="agree")
    middle, alone = (torch.from_numpy(picture(g, SOURCE)) for g in (morph.at(0.5), SOURCE))
    assert psnr(middle, alone) > 40
    for agreement in morph.agreement():
        assert agreement.drift.offset.abs().max() == 0
        assert agreement.drift.sh.abs().max() < 1e-4
        assert (agreement.lead - 0.5).abs().max() < 1e-4
        assert agreement.density.abs().max() == 0


def test_splats_keep_their_count_and_order_inside() -> None:
    frames = list(Morph(SOURCE, TARGET, affine_flow(), blend="agree").sequence([0.1, 0.5, 0.9]))
    assert {len(frame) for frame in frames} == {len(SOURCE) + len(TARGET)}
    stable = Morph(SOURCE, TARGET, affine_flow(), blend="agree", stable_count=True)
    assert {len(f) for f in stable.sequence([0.0, 0.5, 1.0])} == {len(SOURCE) + len(TARGET)}
    split = Morph(SOURCE, TARGET, affine_flow(), blend="agree", split=1.2)
    assert len({len(f) for f in split.sequence([0.2, 0.5, 0.8])}) == 1


def test_in_the_middle_both_halves_show_the_mixture() -> None:
    red, blue = tinted(ball(seed=3), (0.9, 0.2, 0.2)), tinted(ball(seed=4), (0.2, 0.2, 0.9))
    mixed = torch.tensor([0.55, 0.2, 0.55])
    for t, wanted in ((0.5, mixed), (0.25, torch.lerp(torch.tensor([0.9, 0.2, 0.2]), mixed, 0.5))):
        colours = 0.5 + SH0 * Morph(red, blue, still(), blend="agree").at(t).sh[:, 0]
        assert (colours - wanted).abs().quantile(0.95) < 0.02
        kept = 0.5 + SH0 * Morph(red, blue, still(), blend="union").at(t).sh[:, 0]
        assert (kept - wanted).abs().max() > 0.1


def test_the_halves_agree_in_one_frame_however_it_is_asked_for() -> None:
    morph = Morph(SOURCE, TARGET, affine_flow(), blend="agree")
    several = list(morph.sequence([0.25, 0.5, 0.75]))
    again = Morph(SOURCE, TARGET, affine_flow(), blend="agree").at(0.5)
    for name in ("means", "quats", "log_scales", "opacity_logits", "sh"):
        torch.testing.assert_close(getattr(several[1], name), getattr(again, name))


def test_surfaces_that_the_flow_left_apart_meet_except_at_landmarks() -> None:
    small, large = ball(seed=5, radius=0.9), ball(seed=6)
    pinned = torch.tensor([[0.0, 0.0, 0.9]])
    middle = Morph(small, large, still(), landmarks=pinned, blend="agree").at(0.5)
    distance = middle.means.norm(dim=1)
    place = torch.cat([small.means, large.means])
    free = (place - pinned).norm(dim=1) > 0.5
    inner, outer = distance[: len(small)], distance[len(small) :]
    assert abs(float(inner[free[: len(small)]].median()) - 0.95) < 0.02
    assert abs(float(outer[free[len(small) :]].median()) - 0.95) < 0.02
    nearest = (small.means - pinned).norm(dim=1).argmin()
    assert float((middle.means[nearest] - small.means[nearest]).norm()) < 0.01


def test_offsets_of_equal_surfaces_are_zero() -> None:
    parts = [SOURCE, SOURCE]
    near = [Neighbours(SOURCE)] * 2
    steps, alone = melt.offsets(parts, near, [[0, 1], [1, 0]], 1.0, torch.empty(0, 3))
    assert all(step.abs().max() == 0 for step in steps)
    assert all(lone.max() == 0 for lone in alone)


def test_what_has_no_counterpart_fades_in_proportion() -> None:
    body = ball(800, radius=0.6, seed=7)
    body = replace(body, means=body.means - torch.tensor([0.0, 2.5, 0.0]))
    head = ball(seed=8)
    both = Gaussians.union(head, body)
    cover = {}
    for blend in ("union", "agree"):
        morph = Morph(both, head, still(), blend=blend)
        seen = [
            picture(tinted(frame, (1, 1, 1)), both)[..., 0]
            for frame in morph.sequence([0.0, 0.5, 0.9])
        ]
        where = (seen[0] > 0.98) & (np.arange(96)[:, None] > 66)
        cover[blend] = [float(alpha[where].mean()) for alpha in seen]
    assert cover["union"][1] > 0.8
    assert abs(cover["agree"][1] - 0.5) < 0.1
    assert abs(cover["agree"][2] - 0.1) < 0.1


def test_exponents_fade_a_stack_in_proportion() -> None:
    density = torch.tensor([0.0, 0.1, 1.0, 10.0, 50.0], dtype=torch.float64)
    for weight in (0.1, 0.5, 0.9):
        exponent = fade.exponents(weight, density)
        left = -torch.expm1(-exponent * density)
        torch.testing.assert_close(left, -weight * torch.expm1(-density))
        assert exponent[0] == weight


def test_degrees_of_harmonics_may_differ() -> None:
    third = ball(seed=9, degree=3)
    middle = Morph(SOURCE, third, affine_flow(), blend="agree").at(0.5)
    assert middle.sh_degree == 3
    assert all(getattr(middle, name).isfinite().all() for name in ("means", "quats", "sh"))


def test_chains_and_averages_agree() -> None:
    flows = [affine_flow(), affine_flow()]
    third = tinted(ball(seed=10), (0.2, 0.9, 0.2))
    legs = [
        Morph(a, b, flow, blend="agree")
        for a, b, flow in zip((SOURCE, TARGET), (TARGET, third), flows, strict=True)
    ]
    assert same_bits(Chain(legs).at(1.0), TARGET)
    red, blue = tinted(ball(seed=3), (0.9, 0.2, 0.2)), tinted(ball(seed=4), (0.2, 0.2, 0.9))
    mean = average([red, blue, third], [still()] * 3, blend="agree")
    colours = 0.5 + SH0 * mean.sh[:, 0]
    wanted = torch.tensor([1.3, 1.3, 1.3]) / 3
    assert (colours - wanted).abs().median() < 0.02
    assert same_bits(average([red, blue], [still()] * 2, [1, 0], blend="agree"), red)


def test_few_and_strange_splats() -> None:
    lone = ball(1)
    assert len(Morph(lone, ball(3, seed=2), still(), blend="agree").at(0.5)) == 4
    unseen = replace(ball(50), opacity_logits=torch.full((50,), -20.0))
    assert len(Morph(unseen, SOURCE, still(), blend="agree").at(0.5)) == 50 + len(SOURCE)


def test_the_lead_is_as_strong_as_asked() -> None:
    halves = SOURCE, TARGET
    evenly, usual = (Morph(*halves, affine_flow(), lead=lead).agreement()[0] for lead in (0, 1))
    assert (evenly.lead == 0.5).all()
    assert (usual.lead - 0.5).abs().max() > 0.05
    for lead in (-1.0, float("nan"), 100.0):
        with pytest.raises(OptionError, match=r"lead is .*, expected 0 to 3"):
            Morph(*halves, affine_flow(), lead=lead)


def test_an_unknown_blend_is_refused() -> None:
    with pytest.raises(OptionError, match="blend 'mix' is not one of: agree, union"):
        Morph(SOURCE, TARGET, still(), blend="mix")
