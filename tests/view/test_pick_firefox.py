"""The picker in Firefox: where it has no WebGL, with the rasterizer's pictures."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest
from firefox import Firefox, find_firefox
from pick_cases import ASIDE, ASSETS, STRAIGHT

from splatmorph.landmarks import Landmarks
from splatmorph.runs.request import fit_run
from splatmorph.runs.settings import Finding
from splatmorph.view.pick import Server, open_desk


def test_twelve_features_clicked_saved_and_morphed(tmp_path):
    program = find_firefox()
    if program is None:
        pytest.skip("no Firefox here (apt-get install firefox-esr)")
    paths = [Path(shutil.copy(ASSETS / f"{name}.ply", tmp_path)) for name in ("ines", "otto")]
    truth = [Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in ("ines", "otto")]
    server = Server(open_desk(paths), "")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = Firefox(program, 1300, 760)

    def quiet() -> None:
        browser.evaluate("picker.busy.then(() => 0)")

    def click(pane: int, name: str) -> None:
        point = truth[pane].points[truth[pane].names.index(name)].tolist()
        browser.click(
            *browser.evaluate(
                f"(() => {{ const {{ left, top }} = pane{pane}.getBoundingClientRect();"
                f"const [x, y] = picker.panes[{pane}].project({point});"
                "return [left + x, top + y]; })()"
            )
        )
        quiet()

    def turn(angle: float) -> None:
        browser.evaluate(
            f"picker.panes.forEach((p) => {{ p.camera.azimuth = {angle}; p.changed(); }})"
        )

    try:
        browser.visit(server.address)
        browser.wait("document.documentElement.dataset.ready === 'yes'")
        browser.wait("pane0.dataset.drawn === 'still'")
        for name in STRAIGHT:
            click(0, name)
            click(1, name)
        for name in ASIDE:
            turn(0.0)
            click(0, name)
            click(1, name)
            turn(0.5 if name.endswith("left") else -0.5)
            for pane in (0, 1):
                browser.key("e")
                click(pane, name)
        names = [*STRAIGHT, *ASIDE]
        for row, name in zip(browser.evaluate("picker.rows"), names, strict=True):
            browser.evaluate(f"picker.act('rename', {{ row: {row['id']}, name: '{name}' }})")
        turn(0.0)
        browser.wait("picker.legs[0].ready")
        browser.evaluate("picker.setTime(0.5).then(() => 0)")
        browser.wait("pane1.dataset.drawn === 'still'")
        assert browser.screenshot()[100:600, 520:900].std() > 20
        browser.evaluate("picker.save().then(() => 0)")
    finally:
        browser.close()
        server.shutdown()
        server.server_close()
    for path, marks in zip(paths, truth, strict=True):
        found = Landmarks.read(path.with_suffix(".landmarks.json"))
        assert found.names == tuple(names)
        true = marks.points[[marks.names.index(name) for name in names]]
        assert (found.points - true).norm(dim=1).max() < 2e-3
    run = fit_run(*paths, out=tmp_path / "run", finding=Finding(auto=False))
    assert max(run.legs[0].report["errors"].values()) < 1e-3
