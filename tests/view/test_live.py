"""The live viewer in a real browser: what its controls do, and whose picture is seen."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from browser import Browser, find_browser
from page_cases import psnr
from test_page import scene, shaded, subject

from splatmorph.app import run
from splatmorph.view import live
from splatmorph.view.scene import Scene

pytest.importorskip("viser", reason="viser is not installed (pip install 'splatmorph[view]')")
VISERS_OWN = "computeBoundingSphere"
"""viser 1.1 gives the corners of its splats two coordinates, whatever it is sent; three.js remarks
that the third is no number, and draws them."""

STANDS_STILL = """new Promise((done) => {{
  let last;
  const look = () => {{
    const now = JSON.stringify(document.getElementById("{name}").getBoundingClientRect());
    if (now === last) return done(0);
    last = now;
    setTimeout(look, 200);
  }};
  look();
}})"""


class Look:
    """A viewer that goes on, and a browser at it."""

    def __init__(self, browser: Browser, viewer: live.Viewer) -> None:
        self.browser, self.viewer = browser, viewer
        self.ended = threading.Event()
        self.steps = threading.Thread(target=self._go_on)
        self.steps.start()

    def _go_on(self) -> None:
        while not self.ended.is_set():
            self.viewer.step(0.05)
            time.sleep(0.02)

    def press(self, label: str) -> None:
        """Click the control of this label."""
        name = self.browser.evaluate(
            "[...document.querySelectorAll('label')]"
            f".find((one) => one.textContent === {label!r}).htmlFor"
        )
        self.browser.evaluate(STANDS_STILL.format(name=name))
        self.browser.press(f"*:has(> [id='{name}'])")

    def until(self, condition: str) -> None:
        """Wait for an expression over the viewer ``v``."""
        deadline = time.monotonic() + 20
        while not eval(condition, {"v": self.viewer}):
            assert time.monotonic() < deadline, condition
            time.sleep(0.05)

    def likeness(self) -> float:
        """PSNR, where viser puts nothing over it, of what is seen against the rasterizer's."""
        (client,) = self.viewer.server.get_clients().values()
        ours = self.viewer._picture(client.camera)
        seen = self.browser.screenshot()
        clear = slice(200, 420), slice(80, 500)
        return psnr(seen[clear] / 255, ours[clear] / 255)

    def end(self) -> None:
        self.ended.set()
        self.steps.join()
        self.viewer.server.stop()


@pytest.fixture(scope="module")
def look() -> Iterator[Look]:
    program = find_browser()
    if program is None:
        pytest.skip("no Chromium here (apt-get install chromium)")
    # Colours that depend on the direction: viser shows none.
    lit = subject(600)
    lit = replace(lit, morph=replace(lit.morph, source=shaded(lit.morph.source, 1)))
    browser = Browser(program, 900, 500, offline=False)
    made = Look(browser, live.serve(Scene.of(lit), port=18551))
    browser.visit(made.viewer.address)
    browser.wait(
        "[...document.querySelectorAll('label')].some((one) => one.textContent === 'Play')"
    )
    browser.wait("document.querySelector('canvas')")
    made.until("v.server.get_clients()")
    yield made
    made.end()
    browser.close()


def test_the_rasterizers_picture_is_switched_on_and_off(look: Look) -> None:
    look.press("Rasterizer's picture")
    look.until("v.true.value and v.seen")
    deadline = time.monotonic() + 20
    while (found := look.likeness()) < 30:
        assert time.monotonic() < deadline, f"{found:.1f} dB from the rasterizer's picture"
    look.press("Rasterizer's picture")
    look.until("not v.true.value and not v.seen")
    while look.likeness() >= found - 3:
        assert time.monotonic() < deadline, "the rasterizer's picture stays"


def test_it_plays_and_shows_landmarks(look: Look) -> None:
    look.press("Landmarks")
    look.until("all(layer.visible for layer in v.layers) and len(v.layers) == 2")
    look.press("Play")
    look.until("v.time.value > 0.05")
    look.press("Play")
    look.until("not v.playing.value")
    assert all(VISERS_OWN in said for said in look.browser.complaints())


def test_what_is_sent_is_finite(look: Look) -> None:
    for t in (0.0, 0.5, 1.0):
        shown = look.viewer.splats(live._Drawn(t, "morph", "linear"))
        assert all(np.isfinite(x.numpy()).all() for x in (shown.means, shown.scales, shown.quats))


def test_port_and_browser_are_as_asked(tmp_path, monkeypatch, capsys) -> None:
    from splatmorph import io

    io.write(tmp_path / "a.ply", scene(50).splats[0])
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    monkeypatch.setattr(live.Viewer, "run", lambda viewer: viewer.server.stop())
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    words = ["view", str(tmp_path / "a.ply"), "--port", str(port)]
    assert run(words) == 0
    assert opened == [f"http://127.0.0.1:{port}"]
    assert f"look at {opened[0]}" in capsys.readouterr().out
    assert run([*words, "--no-open"]) == 0
    assert len(opened) == 1
