"""Streamlines, diagnostics, the contact sheet, the live viewer and the commands."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from test_page import Swirl, blob, subject

from renderer import orbit
from splatmorph.app import run as command
from splatmorph.errors import MissingExtraError, OptionError, WriteError
from splatmorph.fitting import fit
from splatmorph.flows import make_flow
from splatmorph.geometry.similarity import Similarity
from splatmorph.geometry.spreading import farthest
from splatmorph.io import write
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.rendering import render
from splatmorph.view import live, streamlines
from splatmorph.view.diagnostics import History, determinants, draw_diagnostics
from splatmorph.view.scene import Scene
from splatmorph.view.sheet import contact_sheet
from splatmorph.view.subject import Subject


class TestStreamlines:
    def test_lines_follow_the_flow_from_the_landmarks_on(self):
        shown = subject(300)
        lines = streamlines.trace(shown, seeds=20)
        points = torch.from_numpy(lines.paths[:, 0])
        assert np.allclose(lines.paths[:, -1], shown.morph.flow(points, 1.0).numpy())
        assert np.allclose(lines.tails[:, -1], lines.paths[:, 0])
        assert np.array_equal(lines.paths[lines.marked][:, 0], shown.source_points.numpy())
        assert lines.marked.sum() == 5
        assert len(lines.paths) == 25

    def test_speed_is_that_of_the_flow(self):
        lines = streamlines.trace(subject(300), seeds=20)
        radius = np.linalg.norm(lines.paths[..., :2], axis=2)
        assert np.allclose(lines.values, np.hypot(0.8 * radius, 0.1), rtol=1e-3)

    def test_a_turn_keeps_volume(self):
        lines = streamlines.trace(subject(300), seeds=20, colouring="det")
        assert np.allclose(lines.values, 0, atol=1e-9)

    def test_seeds_are_on_the_object_and_spread_out(self):
        points = torch.rand(500, 3, dtype=torch.float64)
        chosen = points[farthest(points.numpy(), 8)]
        gaps = torch.cdist(chosen, chosen) + 9 * torch.eye(8)
        assert gaps.min() > 0.5

    def test_nothing_to_draw_is_said(self):
        with pytest.raises(OptionError, match="nothing to draw"):
            streamlines.trace(Subject(subject(50).morph), seeds=0)
        with pytest.raises(OptionError, match="speed, det"):
            streamlines.trace(subject(50), colouring="taste")

    def test_no_window_without_a_display(self, monkeypatch):
        monkeypatch.delenv("DISPLAY", raising=False)
        monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
        monkeypatch.setattr(sys, "platform", "linux")
        with pytest.raises(WriteError, match="no display"):
            streamlines._choose_window(visible=True)
        monkeypatch.setattr(streamlines, "find_library", lambda name: None)
        with pytest.raises(WriteError, match="libegl1"):
            streamlines._choose_window(visible=False)

    def test_the_picture_shows_lines_over_the_object(self):
        shown = subject(300)
        view = orbit(shown.bounds(), [20.0], width=160, height=120)[0]
        try:
            streamlines._choose_window(visible=False)
        except WriteError as missing:
            pytest.skip(str(missing))
        lines = streamlines.trace(shown, seeds=20)
        morph = shown.morph
        still = Subject(Morph(morph.source, morph.target, make_flow("linear")))
        rest = streamlines.trace(still, seeds=20)
        drawn = streamlines.picture([shown, shown, still], [lines, lines, rest], view)
        # Three panels, and beside them the colour bar.
        assert drawn.shape == (120, 3 * 160 + 24, 3)
        bare, _ = streamlines._backdrop(shown, lines, view)
        assert np.abs(drawn[:, :160] / 255 - bare).max() > 0.3
        first, second = (drawn[30:75, x : x + 160].astype(float) for x in (0, 160))
        assert np.abs(first - second).mean() < 2, "linked views, one picture"


class TestDiagnostics:
    def test_a_turn_has_determinant_one(self):
        assert np.allclose(determinants(subject(300)), 1)

    def test_it_is_drawn_whatever_the_names_and_with_nothing_to_show(self, tmp_path):
        shown = subject(100)
        errors = {"$\\frac{</script>": 0.1, "a" * 200: 0.2}
        draw_diagnostics(tmp_path / "a.png", shown, errors, History((1, 2, 3), (1.0, 0.2, 0.3)))
        draw_diagnostics(tmp_path / "b.svg", Subject(shown.morph), {}, History((), ()))
        assert (tmp_path / "a.png").stat().st_size > 10_000
        with pytest.raises(OptionError, match="png"):
            draw_diagnostics(tmp_path / "c.doc", shown, errors, History((), ()))
        assert {path.name for path in tmp_path.iterdir()} == {"a.png", "b.svg"}


class TestSheet:
    def test_cells_are_the_rasterizers_pictures(self):
        shown = subject(200)
        cameras = orbit(shown.bounds(), [0.0, 40.0], width=60, height=50)
        sheet = contact_sheet(shown.morph, [0, 0.5, 1], cameras)
        cell = render(shown.morph.at(0.5), cameras[1])
        found = any(
            np.array_equal(sheet[y : y + 50, x : x + 60], cell)
            for y in range(sheet.shape[0] - 49)
            for x in range(sheet.shape[1] - 59)
        )
        assert found

    def test_parts_add_rows_and_make_the_union(self):
        shown = subject(200)
        cameras = orbit(shown.bounds(), [0.0], width=60, height=50)
        whole = contact_sheet(shown.morph, [0, 0.5, 1], cameras)
        parts = contact_sheet(shown.morph, [0, 0.5, 1], cameras, parts=True)
        assert parts.shape[0] - whole.shape[0] == 2 * (50 + 2)

    def test_bad_input_is_said(self):
        shown = subject(20)
        with pytest.raises(OptionError, match="0 views"):
            contact_sheet(shown.morph, [0], [])
        mixed = [orbit(shown.bounds(), [0.0], width=w)[0] for w in (20, 30)]
        with pytest.raises(OptionError, match="one size"):
            contact_sheet(shown.morph, [0], mixed)


class TestLive:
    def test_a_visitors_camera_is_ours(self):
        ours = orbit(subject(50).bounds(), [25.0], elevation=10, width=200, height=100)[0]
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(ours.viewmat[:3, :3].T).as_quat(scalar_first=True)
        eye = SimpleNamespace(
            wxyz=turn,
            position=ours.position,
            fov=2 * np.arctan(50 / ours.K[1, 1]),
            image_width=200,
            image_height=100,
        )
        found = live.camera_of(eye)
        assert np.allclose(found.viewmat, ours.viewmat)
        assert np.allclose(found.K, ours.K)

    def test_it_says_what_to_install(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "viser", None)
        with pytest.raises(MissingExtraError, match=r"splatmorph\[view\]"):
            live.serve(Scene.of(subject(20)))

    @pytest.mark.filterwarnings("ignore")
    def test_it_listens_on_this_machine_only_and_follows_the_controls(self):
        if importlib.util.find_spec("viser") is None:
            pytest.skip("viser is not installed (pip install 'splatmorph[view]')")
        viewer = live.serve(Scene.of(subject(100)), port=18431)
        try:
            assert viewer.address.startswith("http://127.0.0.1:")
            viewer.step(0.1)
            assert len(viewer.shown) == 100
            viewer.time.value, viewer.marks.value = 0.5, True
            viewer.step(0.1)
            assert len(viewer.shown) == 200
            viewer.part.value = "target"
            viewer.step(0.1)
            assert len(viewer.shown) == 100
            viewer.playing.value = True
            viewer.step(1.0)
            assert viewer.time.value != 0.5
        finally:
            viewer.server.stop()


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> Path:
    """A small run on disk."""
    from splatmorph.runs.inputs import load_input
    from splatmorph.runs.run import Leg, Run, remember, save_run

    folder = tmp_path_factory.mktemp("view")
    source, target = blob(300, 1, (0.7, 0.4, 0.2)), blob(300, 2, (0.2, 0.5, 0.7))
    points = source.means[:12].double()
    marks = Landmarks(points), Landmarks(Swirl()(points, 1.0))
    flow = make_flow("node")
    report = fit(flow, *marks)
    for name, splats in (("a", source), ("b", target)):
        write(folder / f"{name}.ply", splats)
    inputs = tuple(remember(load_input(folder / f"{name}.ply")) for name in "ab")
    names = tuple(f"mark {i}" for i in range(12))
    leg = Leg(
        flow, Similarity.identity(), marks[0].points, marks[1].points, names, report.to_dict()
    )
    return save_run(folder / "ab.run", Run(inputs, (leg,), {}), [report])


class TestCommands:
    def test_view_writes_a_page_and_diagnostics(self, fitted, tmp_path, capsys):
        page, figure = tmp_path / "a.html", tmp_path / "a.png"
        tokens = ["view", str(fitted), "-o", str(page), "--diagnostics", str(figure)]
        assert command(tokens) == 0
        assert page.stat().st_size > 20_000
        assert figure.stat().st_size > 20_000
        assert command(tokens) == 1
        assert "-w" in capsys.readouterr().err
        assert command(["view", str(fitted), "-w", "-o", str(page), "--max-splats", "100"]) == 0
        assert "thinned out" in capsys.readouterr().err

    def test_streamlines_writes_lines(self, fitted, tmp_path):
        assert command(["streamlines", str(fitted), "-o", str(tmp_path / "a.vtp")]) == 0
        assert b"speed" in (tmp_path / "a.vtp").read_bytes()

    @pytest.mark.parametrize("name", ["view", "streamlines"])
    def test_a_run_that_is_none_is_one_line(self, name, fitted, tmp_path, capsys):
        broken = tmp_path / "broken.run"
        broken.mkdir()
        for file in fitted.iterdir():
            (broken / file.name).write_bytes(file.read_bytes())
        weights = broken / "flow.safetensors"
        for content in (b"PK\x03\x04 foreign", weights.read_bytes()[:50], None):
            weights.unlink(missing_ok=True)
            if content is not None:
                weights.write_bytes(content)
            out = tmp_path / ("a.html" if name == "view" else "a.png")
            assert command([name, str(broken), "-o", str(out)]) == 1
            assert capsys.readouterr().err.strip().count("error:") == 1
            assert not out.exists()

    def test_other_extensions_are_refused(self, fitted, tmp_path, capsys):
        assert command(["view", str(fitted), "-o", str(tmp_path / "a.exe")]) == 1
        assert command(["streamlines", str(fitted), "-o", str(tmp_path / "a.exe")]) == 1
        assert "expected" in capsys.readouterr().err


def test_what_draws_nothing_loads_no_drawing():
    heavy = "('pyvista', 'vtk', 'matplotlib', 'viser')"
    code = (
        "import sys, splatmorph, splatmorph.app.view, splatmorph.app.streamlines\n"
        f"print([name for name in {heavy} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
