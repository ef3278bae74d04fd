"""The pictures of docs/picking.md: ``python docs/picking/pictures.py``; takes a Chromium."""

from __future__ import annotations

import sys
import tempfile
import threading
from pathlib import Path

from PIL import Image

from splatmorph.landmarks import Landmarks
from splatmorph.samples import write_sample_pair
from splatmorph.view.pick import Server, open_desk
from splatmorph.view.pick.book import Place, Row

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parents[1] / "tests" / "view"))
from browser import Browser, find_browser  # noqa: E402

NAMES = [
    "eye_outer_right",
    "eye_outer_left",
    "nasion",
    "nose_tip",
    "mouth_corner_right",
    "mouth_corner_left",
    "chin",
    "ear_lobe_right",
    "ear_lobe_left",
    "forehead",
    "hair_crown",
    "hair_front",
]
WIDTH, HEIGHT = 1240, 700
COLOURS = 256
AT_REST = "pane0.dataset.drawn === 'still' && pane1.dataset.drawn === 'still'"


def main() -> None:
    """Put twelve pairs into the book, and look at the page."""
    program = find_browser()
    if program is None:
        raise SystemExit("no Chromium here")
    with tempfile.TemporaryDirectory() as folder:
        paths = write_sample_pair(folder)
        marks = [Landmarks.read(path.with_suffix(".landmarks.json")) for path in paths]
        for path in paths:
            path.with_suffix(".landmarks.json").unlink()
        desk = open_desk(paths)
        desk.begin(
            Row(i, name, tuple(Place(_point(side, name)) for side in marks))
            for i, name in enumerate(NAMES, start=1)
        )
        server = Server(desk, "splatmorph fit ines.ply otto.ply")
        threading.Thread(target=server.serve_forever, daemon=True).start()
        browser = Browser(program, WIDTH, HEIGHT, offline=False)
        try:
            browser.visit(server.address)
            browser.wait("document.documentElement?.dataset.ready")
            browser.evaluate("picker.settle()")
            browser.wait(AT_REST)
            _keep(browser, "pairs")
            browser.evaluate("picker.setTime(0.5)")
            browser.wait(f"picker.panes[1].between && {AT_REST}")
            _keep(browser, "morph")
        finally:
            browser.close()
            server.shutdown()


def _point(marks: Landmarks, name: str) -> tuple[float, ...]:
    return tuple(marks.points[(marks.names or ()).index(name)].tolist())


def _keep(browser: Browser, name: str) -> None:
    shown = Image.fromarray(browser.screenshot()).quantize(COLOURS)
    shown.save(HERE / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
