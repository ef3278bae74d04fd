"""The files of the picker: what is saved, opened again, begun with and left out."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pick_cases import ASSETS, MARKS, SIZE, camera_of, click, pick_pair, pixel, told
from PIL import Image

from splatmorph.errors import OptionError, ReadError, SplatmorphError
from splatmorph.io import read, write
from splatmorph.landmarks import Landmarks
from splatmorph.registration.masks import Loop, Mask, without_masked
from splatmorph.view.pick import open_desk, start


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

    def test_a_damaged_autosave_is_set_aside(self, desk, pair):
        for text in ("", "[1]", '{"rows": 3}', '{"rows": [{"id": 1}]}'):
            desk.papers.autosave.write_text(text)
            again = open_desk(pair)
            assert again.book.rows == ()
            assert again.papers.set_aside.read_text() == text

    def test_what_can_not_be_kept_at_the_end_is_said(self, desk, truth):
        assert desk.leave() is None
        pick_pair(desk, truth, "nose_tip")
        assert "kept in" in desk.leave()
        desk.papers.autosave.unlink()
        desk.papers.autosave.mkdir()
        assert "lost" in desk.leave()

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
