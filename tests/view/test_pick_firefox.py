"""The picker in Firefox: where it has no WebGL, with the rasterizer's pictures."""

from __future__ import annotations

import shutil
import threading
from pathlib import Path

import pytest
from firefox import Firefox, find_firefox

from splatmorph.landmarks import Landmarks
from splatmorph.view.pick import Server, open_desk

ASSETS = Path(__file__).parents[2] / "assets"
NAMES = ("nose_tip", "glabella", "forehead", "cheek_left")
ENTER = "\ue007"


def test_four_pairs_clicked_saved_and_morphed(tmp_path):
    program = find_firefox()
    if program is None:
        pytest.skip("no Firefox here (apt-get install firefox-esr)")
    paths = [Path(shutil.copy(ASSETS / f"{name}.ply", tmp_path)) for name in ("ines", "otto")]
    truth = [Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in ("ines", "otto")]
    server = Server(open_desk(paths), "")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    browser = Firefox(program, 1300, 760)
    try:
        browser.visit(server.address)
        browser.wait("document.documentElement.dataset.ready === 'yes'")
        browser.wait("pane0.dataset.drawn === 'still'")
        for name in NAMES:
            for pane, marks in enumerate(truth):
                point = marks.points[marks.names.index(name)].tolist()
                x, y, _ = browser.evaluate(f"picker.panes[{pane}].project({point})")
                left, top = browser.evaluate(
                    f"(({{ left, top }}) => [left, top])(pane{pane}.getBoundingClientRect())"
                )
                browser.click(left + x, top + y)
                browser.evaluate("picker.busy.then(() => 0)")
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
        true = marks.points[[marks.names.index(name) for name in NAMES]]
        # A click of WebDriver is on a whole pixel, about a millimetre here.
        assert (found.points - true).norm(dim=1).max() < 2e-3
