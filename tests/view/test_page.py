"""The page: packing, the knots, and the picture in a real browser."""

from __future__ import annotations

import base64
import json
import re
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from browser import Browser, find_browser
from hypothesis import given
from hypothesis import strategies as st
from page_cases import GROUND, Swirl, blob, our_picture, psnr, scene, shaded, subject

from splatmorph.errors import OptionError, WriteError
from splatmorph.gaussians import Gaussians
from splatmorph.geometry.similarity import Similarity
from splatmorph.morph import Morph
from splatmorph.morph.chain import Chain
from splatmorph.morph.ramps import RAMPS
from splatmorph.view.knots import FINEST, MOST, fewest_knots, knot_matrix, knot_times, knot_weights
from splatmorph.view.page import write_page
from splatmorph.view.page.coding import Table, along_curve, one_block
from splatmorph.view.scene import Scene
from splatmorph.view.subject import NO_POINTS, Subject, thin

HOSTILE = "</script><script>document.title='owned'</script><img src=x onerror=alert(1)>{{scene}}"


def told(page: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """What a page says, and the tables that it carries."""
    text = page.read_text(encoding="utf-8")
    found = dict(re.findall(r'<script type="[^"]*" id="(\w+)">(.*?)</script>', text, re.DOTALL))
    facts = json.loads(found["scene"])
    return facts, unfolded(facts["tables"], found["payload"])


def unfolded(facts: dict, payload: str) -> dict[str, np.ndarray]:
    """The plain twin of what the page's script does."""
    block, at, tables = zlib.decompress(base64.b64decode(payload)), 0, {}
    for name, (kind, rows, columns, delta, stride, times) in facts.items():
        width = np.dtype(kind).itemsize
        planes = np.frombuffer(block, np.uint8, rows * columns * width, at)
        at += planes.size
        words = np.ascontiguousarray(planes.reshape(columns, width, rows).transpose(2, 0, 1))
        words = words.view(f"<u{width}")[..., 0].copy()
        if delta:
            words = words.cumsum(axis=0, dtype=words.dtype)
        for _ in range(times):
            for column in range(stride, columns):
                words[:, column] += words[:, column - stride]
        tables[name] = np.ascontiguousarray(words).view(kind)
    return tables


class TestKnots:
    @given(count=st.integers(2, MOST), coefficients=st.lists(st.floats(-3, 3), min_size=1))
    def test_polynomials_below_the_count_are_met_exactly(self, count, coefficients):
        curve = np.polynomial.Polynomial(coefficients[:count])
        times, wanted = knot_times(count), np.linspace(0, 1, 11)
        assert np.allclose(knot_matrix(times, wanted) @ curve(times), curve(wanted), atol=1e-10)

    @given(count=st.integers(2, MOST), t=st.floats(0, 1))
    def test_weights_sum_to_one(self, count, t):
        assert knot_weights(knot_times(count), t).sum() == pytest.approx(1, abs=1e-10)

    def test_a_straight_path_needs_two_and_a_wilder_one_more(self):
        times = knot_times(FINEST)[:, None, None]
        straight, bent = times * np.ones((1, 1, 3)), np.sin(4 * times) * np.ones((1, 1, 3))
        assert fewest_knots(straight, 1e-9) == 2
        assert 4 <= fewest_knots(bent, 1e-2) < fewest_knots(bent, 1e-4) <= MOST


class TestCoding:
    @given(
        kind=st.sampled_from(["i1", "u1", "i2", "u2", "u4", "f4"]),
        rows=st.integers(0, 5),
        groups=st.integers(1, 3),
        times=st.integers(0, 2),
        delta=st.booleans(),
        seed=st.integers(0, 99),
    )
    def test_what_is_folded_unfolds_to_the_bit(self, kind, rows, groups, times, delta, seed):
        rng = np.random.default_rng(seed)
        width = np.dtype(kind).itemsize
        values = rng.integers(0, 256, (rows, 3 * groups * width), np.uint8).view(kind)
        facts, payload = one_block({"a": Table(values, delta, 3 if times else 0, times)})
        assert np.array_equal(unfolded(facts, payload)["a"].view(np.uint8), values.view(np.uint8))

    def test_the_curve_visits_all_and_keeps_neighbours_together(self):
        points = np.random.default_rng(0).random((4000, 3))
        order = along_curve(points)
        assert np.array_equal(np.sort(order), np.arange(4000))
        steps = np.linalg.norm(np.diff(points[order], axis=0), axis=1)
        assert np.median(steps) < 0.2 * np.median(np.linalg.norm(np.diff(points, axis=0), axis=1))


class TestFile:
    def test_ends_are_stored_to_the_bit_and_paths_within_the_promise(self, tmp_path):
        shown = subject()
        report = write_page(tmp_path / "morph.html", Scene.of(shown))
        centers = told(tmp_path / "morph.html")[1]["centers"]
        source = shown.morph.source.means[shown.morph.source.opacities >= 1 / 255].numpy()
        carried = centers[: len(source)]
        assert np.array_equal(carried[np.lexsort(carried.T)], source[np.lexsort(source.T)])
        assert report.error_px < 0.6
        assert not report.thinned

    def test_what_can_not_be_seen_is_not_carried(self, tmp_path):
        shown = subject()
        faint = replace(
            shown.morph.source, opacity_logits=torch.full_like(shown.morph.source.means[:, 0], -9)
        )
        faint.opacity_logits[:100] = 0
        report = write_page(
            tmp_path / "a.html", Scene.of(replace(shown, morph=Morph(faint, faint, Swirl())))
        )
        assert report.splats == 200

    def test_too_many_splats_are_thinned_out_and_it_says_so(self, tmp_path):
        report = write_page(tmp_path / "a.html", scene(), max_splats=500)
        assert report.thinned
        assert report.splats <= 500
        assert "thinned out from" in told(tmp_path / "a.html")[0]["facts"]

    def test_thinning_keeps_what_covers_most(self):
        splats = blob(50, 3, (0.5, 0.5, 0.5))
        kept = thin(splats, 10)
        cover = splats.opacities * splats.scales.sort(dim=1).values[:, 1:].prod(dim=1)
        left = torch.ones(50, dtype=torch.bool)
        left[kept] = False
        assert cover[kept].min() >= cover[left].max()

    def test_nothing_a_name_holds_gets_into_the_markup(self, tmp_path):
        shown = replace(subject(50), source_name=HOSTILE, landmark_names=(HOSTILE,) * 5)
        write_page(tmp_path / "a.html", Scene.of(shown))
        text = (tmp_path / "a.html").read_text(encoding="utf-8")
        assert text.count("<script") == text.count("</script>") == 3
        assert text.count("<img") == 1  # the poster, which the page itself holds
        assert told(tmp_path / "a.html")[0]["splats"][0]["name"] == HOSTILE

    def test_it_asks_for_nothing_from_outside(self, tmp_path):
        write_page(tmp_path / "a.html", scene(50))
        text = (tmp_path / "a.html").read_text(encoding="utf-8")
        assert "default-src 'none'" in text
        assert not re.search(r"https?://|@import|url\(", text)

    def test_no_half_written_file(self, tmp_path):
        with pytest.raises(WriteError):
            write_page(tmp_path / "missing" / "a.html", scene(50))
        with pytest.raises(OptionError, match="max_splats"):
            write_page(tmp_path / "a.html", scene(50), max_splats=1)
        assert not list(tmp_path.iterdir())


@pytest.fixture
def browser(browsers: list[Browser]) -> Browser:
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium here (apt-get install chromium, or set SPLATMORPH_TEST_BROWSER)")
    if not browsers:
        browsers.append(Browser(program, 400, 300))
    return browsers[0]


class TestPicture:
    @pytest.mark.parametrize("covariance", ["fixed", "rotate", "full"])
    def test_it_is_the_rasterizers(self, browser, tmp_path, covariance):
        shown = subject(covariance=covariance)
        write_page(tmp_path / "a.html", Scene.of(shown), background=GROUND)
        for t, azimuth in ((0, 0), (0.5, 40), (1, -25)):
            browser.open(tmp_path / "a.html", f"controls=0&t={t}&azimuth={azimuth}&elevation=15")
            ours = our_picture(browser, shown.morph.at(t))
            seen = browser.screenshot() / 255
            assert psnr(seen, ours) > 35, f"t = {t}"
            assert browser.complaints() == []

    def test_every_ramp_is_the_rasterizers(self, browser, tmp_path):
        shown = subject()
        write_page(tmp_path / "a.html", Scene.of(shown), background=GROUND)
        for ramp in RAMPS:
            browser.open(tmp_path / "a.html", f"controls=0&t=0.3&ramp={ramp}")
            morph = Morph(
                shown.morph.source, shown.morph.target, shown.morph.flow, blend="union", ramp=ramp
            )
            assert psnr(browser.screenshot() / 255, our_picture(browser, morph.at(0.3))) > 35

    @pytest.mark.parametrize("ramp", ["linear", "calibrated"])
    def test_halves_that_agree_are_the_rasterizers(self, browser, tmp_path, ramp):
        shown = subject(blend="agree", ramp=ramp)
        # A body that the target lacks, to be faded in proportion.
        extra = blob(300, 5, (0.3, 0.7, 0.3))
        extra = replace(extra, means=0.5 * extra.means - torch.tensor([0.0, 2.5, 0.0]))
        source = Gaussians.union(shown.morph.source, extra)
        morph = Morph(source, shown.morph.target, Swirl(0.4), blend="agree", ramp=ramp)
        shown = replace(shown, morph=morph)
        assert morph.agreement()[0].density.max() > 1
        write_page(tmp_path / "a.html", Scene.of(shown), background=GROUND)
        for t in (0.15, 0.5, 0.8):
            browser.open(tmp_path / "a.html", f"controls=0&t={t}&azimuth=20")
            assert psnr(browser.screenshot() / 255, our_picture(browser, morph.at(t))) > 35, t
        browser.open(tmp_path / "a.html", "controls=0&t=0.4&part=target")
        alone = morph.half(1, 0.4)
        assert psnr(browser.screenshot() / 255, our_picture(browser, alone)) > 35
        assert browser.complaints() == []

    def test_a_part_alone_is_the_one_input_carried_along(self, browser, tmp_path):
        shown = subject(covariance="fixed")
        write_page(tmp_path / "a.html", Scene.of(shown), background=GROUND)
        browser.open(tmp_path / "a.html", "controls=0&t=0.4&part=target")
        target = shown.morph.target
        carried = replace(target, means=shown.morph.flow(target.means, -0.6))
        assert psnr(browser.screenshot() / 255, our_picture(browser, carried)) > 35

    @pytest.mark.parametrize("degree", [1, 3])
    def test_colours_turn_with_the_view_and_with_their_splat(self, browser, tmp_path, degree):
        shown = subject()
        morph = shown.morph
        coloured = replace(
            morph, source=shaded(morph.source, degree), target=shaded(morph.target, degree)
        )
        write_page(tmp_path / "a.html", Scene.of(replace(shown, morph=coloured)), background=GROUND)
        cut = replace(
            coloured,
            source=coloured.source.with_sh_degree(1),
            target=coloured.target.with_sh_degree(1),
        )
        for t, azimuth in ((0, 0), (0.5, 50), (1, -40)):
            browser.open(tmp_path / "a.html", f"controls=0&t={t}&azimuth={azimuth}")
            ours = our_picture(browser, cut.at(t))
            seen = browser.screenshot() / 255
            assert psnr(seen, ours) > 35, f"t = {t}"
            flat = our_picture(
                browser, Morph(morph.source, morph.target, morph.flow, blend="union").at(t)
            )
            assert psnr(seen, ours) > psnr(seen, flat) + 6

    @pytest.mark.parametrize("stay", [False, True])
    def test_a_target_that_stands_elsewhere_is_carried_there(self, browser, tmp_path, stay):
        """Half a turn, thrice the size, somewhere else."""
        shown = subject()
        frame = Similarity(torch.diag(torch.tensor([-1.0, -1, 1])), 3.0, torch.tensor([2.0, 1, 0]))
        morph = replace(
            shown.morph,
            source=shaded(shown.morph.source, 1),
            target=shaded(shown.morph.target, 1).moved(frame),
            frame=frame,
            stay=stay,
        )
        moved = replace(shown, morph=morph, target_points=frame(shown.target_points))
        write_page(tmp_path / "a.html", Scene.of(moved), background=GROUND)
        for t in (0, 0.4, 1):
            browser.open(tmp_path / "a.html", f"controls=0&t={t}&azimuth=20&elevation=10&zoom=2")
            assert psnr(browser.screenshot() / 255, our_picture(browser, morph.at(t))) > 35

    def test_a_chain_that_stays_is_shown_in_the_first_splats_place(self, browser, tmp_path):
        one = subject(400)
        turn = Similarity(torch.diag(torch.tensor([-1.0, -1, 1])), 2.0, torch.tensor([1.0, 2, 0]))
        first = replace(one.morph, target=one.morph.target.moved(turn), frame=turn, stay=True)
        third = blob(400, 5, (0.3, 0.7, 0.3)).moved(turn)
        second = Morph(first.target, third, one.morph.flow, blend="union", stay=True)
        legs = tuple(Subject(morph) for morph in (first, second))
        chain = Scene((first.source, first.target, third), ("a", "b", "c"), legs)
        write_page(tmp_path / "a.html", chain, background=GROUND)
        whole = Chain([first, second])
        for t in (0.5, 1, 1.5, 2):
            browser.open(tmp_path / "a.html", f"controls=0&t={t}&azimuth=20")
            seen = browser.screenshot() / 255
            assert psnr(seen, our_picture(browser, whole.at(t))) > 35, f"t = {t}"

    def test_a_splat_alone_and_a_chain(self, browser, tmp_path):
        one, two = subject(600), subject(600)
        third = blob(600, 5, (0.3, 0.7, 0.3))
        second = Morph(one.morph.target, third, two.morph.flow, blend="union")
        chain = Scene(
            (one.morph.source, one.morph.target, third),
            ("a", "b", "c"),
            (
                one,
                replace(
                    two,
                    morph=second,
                    landmark_names=(),
                    source_points=NO_POINTS,
                    target_points=NO_POINTS,
                ),
            ),
        )
        write_page(tmp_path / "chain.html", chain, background=GROUND)
        for t, splats in ((0.3, one.morph.at(0.3)), (1.6, second.at(0.6)), (2, third)):
            browser.open(tmp_path / "chain.html", f"controls=0&t={t}&landmarks=1&part=morph")
            browser.evaluate("splatmorph.set({ marks: false })")
            browser.rest()
            assert psnr(browser.screenshot() / 255, our_picture(browser, splats)) > 35, f"t = {t}"
        assert browser.complaints() == []
        write_page(tmp_path / "one.html", Scene((third,), ("c",)), background=GROUND)
        browser.open(tmp_path / "one.html", "controls=0&azimuth=30")
        assert psnr(browser.screenshot() / 255, our_picture(browser, third)) > 35
        browser.open(tmp_path / "one.html")
        assert not browser.evaluate("document.getElementById('play').checkVisibility()")
        assert browser.complaints() == []

    def test_names_run_nothing(self, browser, tmp_path):
        shown = replace(
            subject(200), source_name=HOSTILE, target_name="a & <b>", landmark_names=(HOSTILE,) * 5
        )
        write_page(tmp_path / "a.html", Scene.of(shown))
        browser.open(tmp_path / "a.html", "landmarks=1")
        assert browser.evaluate("document.querySelector('h1 .source').textContent") == HOSTILE
        assert browser.evaluate("document.title") == f"{HOSTILE} → a & <b>"
        assert browser.evaluate("document.images.length") == 0
        assert browser.complaints() == []

    def test_without_landmarks_there_is_nothing_to_toggle(self, browser, tmp_path):
        bare = subject(200)
        write_page(tmp_path / "a.html", Scene.of(Subject(bare.morph)))
        browser.open(tmp_path / "a.html", "landmarks=1")
        assert browser.evaluate("document.getElementById('marks').hidden")
        assert browser.complaints() == []


class TestHands:
    def test_slider_keys_and_buttons(self, browser, tmp_path):
        write_page(tmp_path / "a.html", scene(200))
        browser.open(tmp_path / "a.html")
        browser.evaluate(
            "time.value = 0.25, time.dispatchEvent(new Event('input'))".replace(
                "time", "document.getElementById('time')"
            )
        )
        browser.rest()
        assert browser.evaluate("splatmorph.state.t") == 0.25
        for key, expected in ((".", 0.26), ("1", "source"), ("3", "target")):
            browser.call("Input.dispatchKeyEvent", type="keyDown", key=key)
            value = browser.evaluate("[splatmorph.state.t, splatmorph.state.part]")
            assert expected in (round(value[0], 6), value[1])
        browser.evaluate("document.getElementById('play').click()")
        browser.wait("splatmorph.state.t > 0.3")
        browser.evaluate("document.getElementById('play').click()")
        assert not browser.evaluate("splatmorph.state.playing")
        assert browser.complaints() == []

    def test_dragging_turns_and_the_wheel_zooms(self, browser, tmp_path):
        write_page(tmp_path / "a.html", scene(200))
        browser.open(tmp_path / "a.html")
        before = browser.evaluate("splatmorph.view()")
        for kind, x in (("mousePressed", 200), ("mouseMoved", 260), ("mouseReleased", 260)):
            browser.call("Input.dispatchMouseEvent", type=kind, x=x, y=90, button="left", buttons=1)
        turned = browser.evaluate("splatmorph.view()")
        assert not np.allclose(before["rows"], turned["rows"], atol=0.1)
        browser.call(
            "Input.dispatchMouseEvent", type="mouseWheel", x=200, y=90, deltaX=0, deltaY=-50
        )
        browser.wait(f"splatmorph.view().shift[2] < {turned['shift'][2]}")
