"""The picker without its page: clicks, pairs, flows and hints."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from pick_cases import MARKS, camera_of, click, off, pick_pair, pixel, told

from splatmorph.errors import OptionError
from splatmorph.view.pick import hints, open_desk
from splatmorph.view.pick.book import Book, Place, Ray, Row
from splatmorph.view.pick.guide import Guide
from splatmorph.view.pick.sights import crossing, ray_of, stand_apart


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
