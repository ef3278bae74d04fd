"""The picker without its page: clicks, pairs, flows and files."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pick_cases import ASSETS, told
from PIL import Image

from renderer import Camera, orbit
from splatmorph.errors import OptionError, ReadError, SplatmorphError
from splatmorph.io import read, write
from splatmorph.landmarks import Landmarks
from splatmorph.registration.masks import Loop, Mask, without_masked
from splatmorph.view.pick import Desk, hints, open_desk, start
from splatmorph.view.pick.book import Book, Place, Ray, Row
from splatmorph.view.pick.guide import Guide
from splatmorph.view.pick.sights import crossing, ray_of, stand_apart

SIZE = 480
MARKS = ["nose_tip", "glabella", "forehead", "cheek_left", "cheek_right", "mouth_corner_left"]
"""Marks that the skin shows from the front on both of the pair, not under hair or lashes."""


@pytest.fixture(scope="module")
def truth() -> tuple[Landmarks, Landmarks]:
    return Landmarks.read(ASSETS / "ines.landmarks.json"), Landmarks.read(
        ASSETS / "otto.landmarks.json"
    )


@pytest.fixture
def pair(tmp_path: Path) -> list[Path]:
    """The sample pair without its landmarks."""
    return [Path(shutil.copy(ASSETS / f"{name}.ply", tmp_path)) for name in ("ines", "otto")]


@pytest.fixture
def desk(pair: list[Path]) -> Desk:
    return open_desk(pair)


def camera_of(desk: Desk, side: int, azimuth: float = 0.0) -> Camera:
    return orbit(desk.sides[side].bounds, [azimuth], width=SIZE, height=SIZE)[0]


def pixel(camera: Camera, point: torch.Tensor) -> tuple[float, float]:
    x, y, z = camera.viewmat[:3, :3] @ point.numpy() + camera.viewmat[:3, 3]
    return camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]


def click(desk: Desk, side: int, point: torch.Tensor, row: int | None = None, azimuth=0.0) -> dict:
    cameras = [camera_of(desk, end, azimuth) for end in (0, 1)]
    x, y = pixel(cameras[side], point)
    asked = {"leg": 0, "side": side, "row": row, "x": x, "y": y, "cameras": [*map(told, cameras)]}
    return desk.answer("pick", asked)


def pick_pair(desk: Desk, truth: tuple[Landmarks, Landmarks], name: str) -> int:
    source, target = (side.points[side.names.index(name)] for side in truth)
    row = click(desk, 0, source)["selected"]
    click(desk, 1, target, row)
    return row


def off(desk: Desk, row: int, side: int, point: torch.Tensor) -> float:
    place = desk.book.row(row).places[side]
    return float(np.linalg.norm(np.array(place.point) - point.numpy()))


class TestBook:
    @given(steps=st.lists(st.integers(0, 3), max_size=12))
    def test_every_step_is_undone_and_done_again(self, steps):
        book = Book(2)
        states = [book.rows]
        for step in steps:
            if step == 0 or not book.rows:
                book.put(book.new().with_place(0, Place((0.0, 0.0, float(step)))))
            elif step == 1:
                book.change(book.rows[1:])
            else:
                book.put(replace(book.rows[-1], on=not book.rows[-1].on))
            states.append(book.rows)
        for state in states[-2::-1]:
            assert book.undo()
            assert book.rows == state
        assert not book.undo()
        for state in states[1:]:
            assert book.redo()
            assert book.rows == state
        assert not book.redo()

    def test_what_is_written_is_read(self):
        ray = Ray((0.0, 1.0, 2.0), (0.0, 0.0, 1.0))
        row = Row(3, "chin", (Place((1.0, 2.0, 3.0), True, (ray,)), None), on=False)
        book = Book(2)
        book.change([row])
        assert Book.rows_from(json.loads(json.dumps(book.to_json())), 2, 3) == (row,)

    @pytest.mark.parametrize(
        "stored", [None, 3, [{}], [{"id": 1, "name": "a", "places": [], "on": 1, "auto": 0}]]
    )
    def test_what_is_no_book_is_refused(self, stored):
        with pytest.raises((ValueError, TypeError, KeyError)):
            Book.rows_from(stored, 2, 3)

    def test_a_name_means_one_feature(self):
        book = Book(2)
        book.put(book.new())
        book.put(book.new())
        with pytest.raises(OptionError, match="another"):
            book.rename(book.rows[0], "p2")
        for name in ("", "  ", "a\nb", "x" * 500):
            with pytest.raises(OptionError, match="name"):
                book.rename(book.rows[0], name)


class TestSights:
    def test_rays_through_a_point_cross_there(self):
        point = np.array([0.1, -0.2, 0.3])
        origins = np.array([[1.0, 0, 0], [0, 1, 0.5], [2, 2, 2]])
        rays = [Ray(tuple(o), tuple((point - o) / np.linalg.norm(point - o))) for o in origins]
        found, missed = crossing(rays)
        assert np.allclose(found, point)
        assert missed < 1e-12
        assert stand_apart(rays[0], rays[1:2])
        assert not stand_apart(rays[0], rays[:1])

    def test_a_ray_meets_its_pixel(self, desk):
        camera = camera_of(desk, 0, 30.0)
        ray = ray_of(camera, 100.0, 320.0)
        point = torch.tensor(np.array(ray.origin) + 2 * np.array(ray.direction))
        assert pixel(camera, point) == pytest.approx((100.0, 320.0))

    def test_a_click_on_skin_is_where_it_should_be(self, desk, truth):
        for name in MARKS:
            for side in (0, 1):
                point = truth[side].points[truth[side].names.index(name)]
                row = click(desk, side, point)["selected"]
                assert off(desk, row, side, point) < 2e-3, name

    def test_beside_the_object_nothing_is_hit(self, desk):
        camera = told(camera_of(desk, 0))
        asked = {"leg": 0, "side": 0, "row": None, "x": 3, "y": 3, "cameras": [camera, camera]}
        assert "nothing" in desk.answer("pick", asked)["said"]
        assert desk.book.rows == ()

    def test_a_second_click_from_aside_triangulates(self, desk, truth):
        """The eye's corner lies behind lashes, through which the surface is 8 mm too near."""
        point = truth[0].points[truth[0].names.index("eye_inner_left")]
        row = click(desk, 0, point)["selected"]
        before = off(desk, row, 0, point)
        answer = click(desk, 0, point, row, azimuth=25.0)
        assert "2 views" in answer["said"]
        assert off(desk, row, 0, point) < 1e-4 < before


class TestGuide:
    def test_the_first_guess_is_by_bounds_and_later_ones_by_the_flow(self, desk, truth):
        first = click(desk, 0, truth[0].points[truth[0].names.index("nose_tip")])["selected"]
        guess = desk.book.row(first).places[1]
        assert guess.guess
        assert off(desk, first, 1, truth[1].points[truth[1].names.index("nose_tip")]) < 0.03
        click(desk, 1, truth[1].points[truth[1].names.index("nose_tip")], first)
        assert desk.book.row(first).joins(0)
        for name in MARKS[1:5]:
            pick_pair(desk, truth, name)
        state = desk.answer("settle", {})
        assert state["legs"][0]["ready"]
        name = "mouth_corner_left"
        row = click(desk, 0, truth[0].points[truth[0].names.index(name)])["selected"]
        assert off(desk, row, 1, truth[1].points[truth[1].names.index(name)]) < 0.02

    def test_it_goes_both_ways(self, truth):
        names = [*MARKS, "chin", "ear_lobe_left", "hair_back"]
        p, q = (side.points[[side.names.index(name) for name in names]] for side in truth)
        guide = Guide.of(p, q, (np.zeros(3), np.zeros(3)), (0.2, 0.2))
        for a, b in zip(p.numpy(), q.numpy(), strict=True):
            assert np.allclose(guide.predict(a, 0, np.eye(3)), b, atol=1e-3)
            assert np.allclose(guide.predict(b, 1, np.eye(3)), a, atol=1e-3)

    def test_swapped_pairs_stand_out_and_others_dont(self, truth):
        names = [*MARKS, "chin", "ear_lobe_left", "ear_lobe_right", "eye_outer_left", "hair_back"]
        p, q = (side.points[[side.names.index(name) for name in names]] for side in truth)
        ends = (np.zeros(3), np.zeros(3)), (0.2, 0.2)
        assert not Guide.of(p, q, *ends).doubtful
        left, right = names.index("ear_lobe_left"), names.index("ear_lobe_right")
        swapped = q.clone()
        swapped[[left, right]] = q[[right, left]]
        assert Guide.of(p, swapped, *ends).doubtful == {left, right}

    def test_pairs_that_mirror_are_told_and_not_raised(self):
        p = torch.rand(6, 3, generator=torch.Generator().manual_seed(0)).double()
        guide = Guide.of(p, p * torch.tensor([-1.0, 1, 1]), (np.zeros(3),) * 2, (1.0, 1.0))
        assert guide.flow is None
        assert "mirror" in guide.trouble


class TestHints:
    @pytest.mark.parametrize(
        ("name", "other"),
        [
            ("eye_left", "eye_right"),
            ("left_eye", "right_eye"),
            ("Left ear", "Right ear"),
            ("ear.L", "ear.R"),
            ("cleft", None),
            ("nose", None),
        ],
    )
    def test_names_have_two_sides(self, name, other):
        assert hints.mirrored_name(name) == other
        if other is not None:
            assert hints.mirrored_name(other) == name

    def test_a_mirror_by_pairs_or_by_the_middle(self):
        def row(i, name, x, y, z):
            return Row(i, name, (Place((x, y, z)), Place((x, y, z))))

        pairs = [row(1, "a_left", 1.5, 0, 0), row(2, "a_right", -0.5, 0, 0)]
        pairs += [row(3, "b_left", 1.0, 2, 1), row(4, "b_right", 0.0, 2, 1)]
        mirror = hints.Mirror.of(pairs, 0)
        assert np.allclose(mirror(np.array([2.0, 1, 1])), [-1, 1, 1])
        middle = [row(1, "n", 0.5, 0, 0), row(2, "m", 0.5, 1, 0), row(3, "c", 0.5, 0, 1)]
        assert hints.Mirror.of(middle, 0) is None
        assert np.allclose(
            hints.Mirror.of([*middle, row(4, "e_left", 0.9, 3, 1)], 0)(np.array([1.0, 2, 2])),
            [0, 2, 2],
        )

    def test_a_pair_is_mirrored_as_a_guess_on_both_sides(self, desk, truth):
        for name in ("mouth_corner_left", "mouth_corner_right", "nose_tip", "cheek_left"):
            row = pick_pair(desk, truth, name)
            desk.answer("rename", {"row": row, "name": name})
        with pytest.raises(OptionError, match="two features"):
            desk.answer("mirror", {"leg": 0, "row": row})
        for name in ("nose_wing_left", "nose_wing_right"):
            desk.answer("rename", {"row": pick_pair(desk, truth, name), "name": name})
        made = desk.answer("mirror", {"leg": 0, "row": row})["selected"]
        assert desk.book.row(made).name == "cheek_right"
        for side in (0, 1):
            assert desk.book.row(made).places[side].guess
            assert (
                off(desk, made, side, truth[side].points[truth[side].names.index("cheek_right")])
                < 4e-3
            )
        desk.answer("accept", {"row": made})
        assert desk.book.row(made).joins(0)

    def test_what_is_suggested_is_far_from_all_pairs_and_on_the_object(self, desk, truth):
        camera = camera_of(desk, 0)
        for name in MARKS[:4]:
            pick_pair(desk, truth, name)
        point = np.array(desk.answer("suggest", {"leg": 0, "camera": told(camera)})["point"])
        taken = np.array([row.places[0].point for row in desk.book.rows])
        assert np.linalg.norm(taken - point, axis=1).min() > 0.5 * desk.sides[0].radius
        assert np.linalg.norm(point - desk.sides[0].center) < 1.1 * desk.sides[0].radius

    def test_templates_name_what_comes_next(self, pair, tmp_path, truth):
        known = set(truth[0].names)
        for name in ("face12",):
            assert set(hints.template_names(name)) <= known
        assert len(hints.template_names("face12")) == 12
        (tmp_path / "mine.txt").write_text("# mine\nnose\n\nchin\nnose\n")
        desk = open_desk(pair, template=str(tmp_path / "mine.txt"))
        assert desk.state()["next"] == "nose"
        click(desk, 0, truth[0].points[truth[0].names.index("nose_tip")])
        assert desk.book.rows[0].name == "nose"
        assert desk.state()["next"] == "chin"
        with pytest.raises(OptionError, match="template"):
            hints.template_names("nothing")


class TestPapers:
    def test_saved_pairs_are_read_by_the_fit_and_opened_again(self, desk, pair, truth):
        for name in MARKS:
            row = pick_pair(desk, truth, name)
            desk.answer("rename", {"row": row, "name": name})
        click(desk, 0, truth[0].points[truth[0].names.index("chin")])
        desk.answer("toggle", {"row": row})
        desk.answer("save", {})
        found = [Landmarks.read(path.with_suffix(".landmarks.json")) for path in pair]
        assert found[0].names == found[1].names == tuple(MARKS[:-1])
        for side in (0, 1):
            true = truth[side].points[[truth[side].names.index(name) for name in MARKS[:-1]]]
            assert (found[side].points - true).norm(dim=1).max() < 2e-3
        again = open_desk(pair)
        assert [row.name for row in again.book.rows] == MARKS[:-1]
        assert all(row.joins(0) for row in again.book.rows)

    def test_what_was_there_is_kept_once(self, desk, pair, truth):
        path = pair[0].with_suffix(".landmarks.json")
        path.write_text('{"points": {"old": [0, 0, 0.1]}}')
        desk = open_desk(pair)
        assert [row.name for row in desk.book.rows] == ["old"]
        for name in MARKS[:2]:
            pick_pair(desk, truth, name)
            desk.answer("save", {})
        assert "old" in path.with_name(f"{path.name}.bak").read_text()
        assert "old" not in path.read_text()

    def test_a_crash_loses_nothing(self, desk, pair, truth):
        pick_pair(desk, truth, "nose_tip")
        click(desk, 0, truth[0].points[truth[0].names.index("chin")])
        rows = desk.book.rows
        again = open_desk(pair)
        assert again.book.rows == rows
        assert again.unsaved
        again.answer("save", {})
        assert not again.papers.autosave.exists()
        assert not again.unsaved

    def test_a_damaged_autosave_is_passed_over(self, desk, pair):
        for text in ("", "[1]", '{"rows": 3}', '{"rows": [{"id": 1}]}'):
            desk.papers.autosave.write_text(text)
            assert open_desk(pair).book.rows == ()

    def test_an_offset_is_put_back(self, tmp_path, truth):
        far = np.array([1e6, 2e6, 50.0])
        splat = read(ASSETS / "ines.ply")
        moved = replace(splat, offset=tuple(far.tolist()))
        for name in ("a", "b"):
            write(tmp_path / f"{name}.ply", moved)
        desk = open_desk([tmp_path / "a.ply", tmp_path / "b.ply"])
        assert np.allclose(desk.sides[0].gaussians.offset, far)
        pick_pair(desk, (truth[0], truth[0]), "nose_tip")
        desk.answer("save", {})
        saved = Landmarks.read(tmp_path / "a.landmarks.json").points[0].numpy()
        true = truth[0].points[truth[0].names.index("nose_tip")].numpy() + far
        assert np.linalg.norm(saved - true) < 2e-3
        assert len(open_desk([tmp_path / "a.ply", tmp_path / "b.ply"]).book.rows) == 1

    def test_a_chain_has_the_same_names_throughout(self, pair, tmp_path, truth):
        third = Path(shutil.copy(pair[0], tmp_path / "third.ply"))
        desk = open_desk([*pair, third])
        row = pick_pair(desk, truth, "nose_tip")
        cameras = [told(camera_of(desk, side)) for side in (1, 2)]
        x, y = pixel(camera_of(desk, 2), truth[0].points[truth[0].names.index("nose_tip")])
        asked = {"leg": 1, "side": 1, "row": row, "x": x, "y": y, "cameras": cameras}
        desk.answer("pick", asked)
        assert [leg["pairs"] for leg in desk.state()["legs"]] == [1, 1]
        desk.answer("save", {})
        for path in (*pair, third):
            assert Landmarks.read(path.with_suffix(".landmarks.json")).names == ("p1",)

    def test_inputs_that_can_not_be_picked_on(self, pair, tmp_path):
        Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
        for paths, why in (
            (pair[:1], "two or more"),
            ([pair[0], pair[0]], "twice"),
            ([pair[0], tmp_path / "a.png"], "mixed"),
            ([pair[0], tmp_path / "none.ply"], "does not exist"),
        ):
            with pytest.raises(SplatmorphError, match=why):
                open_desk(paths)

    def test_a_file_begins_with_one_side(self, desk, truth, tmp_path):
        said = start(desk, str(ASSETS / "ines.landmarks.json"))
        assert str(len(truth[0])) in said
        row = desk.book.rows[0]
        assert row.places[1] is None
        assert row.name == truth[0].names[0]
        with pytest.raises(OptionError, match="no file"):
            start(desk, "nowhere.json")


class TestPictures:
    def test_pixels_are_picked_and_saved_as_pixels(self, tmp_path):
        pixels = np.random.default_rng(0).integers(0, 255, (60, 80, 3), np.uint8)
        paths = [tmp_path / "a.png", tmp_path / "b.png"]
        for path in paths:
            Image.fromarray(pixels).save(path)
        desk = open_desk(paths)
        camera = {"rows": np.eye(3).tolist(), "shift": [0, 0, 1], "focal": 40.0}
        camera |= {"middle": [40.0, 30.0], "width": 80, "height": 60}
        places = [(10.5, 10.5), (70.5, 12.5), (40.5, 50.5), (20.5, 40.5)]
        for x, y in places:
            asked = {"leg": 0, "side": 0, "row": None, "x": x, "y": y, "cameras": [camera, camera]}
            row = desk.answer("pick", asked)["selected"]
            desk.answer("accept", {"row": row})
        assert desk.answer("settle", {})["legs"][0]["ready"]
        desk.answer("save", {})
        stored = json.loads((tmp_path / "a.landmarks.json").read_text())
        assert stored["convention"] == "pixels-xy"
        assert np.allclose(list(stored["points"].values()), np.array(places) - 0.5)
        assert len(open_desk(paths).book.rows) == 4
        outside = {"leg": 0, "side": 0, "row": None, "x": 90, "y": 5, "cameras": [camera, camera]}
        assert "nothing" in desk.answer("pick", outside)["said"]


class TestMasks:
    def test_what_lies_in_a_loop_is_left_out_however_deep(self, desk, pair):
        side = desk.sides[0]
        camera = camera_of(desk, 0)
        low = [[0, 300], [SIZE, 300], [SIZE, SIZE], [0, SIZE]]
        asked = {"leg": 0, "side": 0, "polygon": low, "camera": told(camera)}
        assert "left out" in desk.answer("mask", asked)["said"]
        kept = without_masked(side.gaussians, pair[0])
        seen = side.gaussians.means.double().numpy() @ camera.viewmat[:3, :3].T
        seen = seen + camera.viewmat[:3, 3]
        above = camera.K[1, 1] * seen[:, 1] / seen[:, 2] + camera.K[1, 2] < 300
        assert len(kept) == above.sum()
        assert 0 < len(kept) < len(side.gaussians)
        assert len(without_masked(desk.sides[1].gaussians, pair[1])) == len(desk.sides[1].gaussians)
        desk.answer("mask", {"leg": 0, "side": 0})
        assert len(without_masked(side.gaussians, pair[0])) == len(side.gaussians)

    def test_a_mask_that_leaves_nothing_is_not_kept(self, desk, pair):
        all_of_it = [[-999, -999], [9999, -999], [9999, 9999], [-999, 9999]]
        asked = {"leg": 0, "side": 0, "polygon": all_of_it, "camera": told(camera_of(desk, 0))}
        with pytest.raises(OptionError, match="no splat"):
            desk.answer("mask", asked)
        assert not Mask.path_beside(pair[0]).exists()

    def test_files_go_round_and_bad_ones_are_refused(self, tmp_path):
        loop = Loop(np.eye(4), np.array([[0.0, 0], [1, 0], [0, 1]]))
        path = tmp_path / "a.mask.json"
        Mask((loop,)).write(path)
        assert np.array_equal(Mask.read(path).loops[0].polygon, loop.polygon)
        for text in (
            "{}",
            "[]",
            '{"leave_out": [{"viewmat": [], "polygon": []}]}',
            '{"leave_out": [{"viewmat": [[1]], "polygon": [[0, 0]]}]}',
            json.dumps({"leave_out": [{"viewmat": np.eye(4).tolist(), "polygon": [["a", 1]] * 3}]}),
        ):
            path.write_text(text)
            with pytest.raises((ReadError, OptionError)):
                Mask.read(path)
