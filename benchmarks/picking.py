"""What the picker takes: a click, a prediction, a refit, and a frame of orbiting in a browser.

    python benchmarks/picking.py [--splats 80000 1000000] [--no-browser]

Frames are drawn by software in a headless Chromium, both panes together, and counted in wall time
and in CPU time of the browser's processes, for a loaded machine says little by the wall.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from renderer import orbit
from splatmorph.gaussians import Gaussians
from splatmorph.io import write
from splatmorph.landmarks import Landmarks
from splatmorph.samples import sample_pair
from splatmorph.view.pick import Server, open_desk
from splatmorph.view.pick.between import moving
from splatmorph.view.pick.book import Place, Row

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "view"))
from browser import Browser, find_browser

NAMES = ("nose_tip", "chin", "glabella", "forehead", "ear_lobe_left", "ear_lobe_right", "hair_back")
SIZE = (560, 780)
FRAMES = 40
ORBIT = """new Promise((done) => {
  const times = [];
  let last = performance.now();
  const step = () => {
    const now = performance.now();
    times.push(now - last);
    last = now;
    picker.panes.forEach((pane) => { pane.camera.turn(0.02, 0); pane.changed(); });
    if (times.length < COUNT) requestAnimationFrame(step);
    else done(times);
  };
  requestAnimationFrame(step);
})"""


def enlarged(splats: Gaussians, count: int) -> Gaussians:
    """The same object by ``count`` smaller splats: copies, scattered within their originals."""
    g = torch.Generator().manual_seed(0)
    which = torch.arange(count) % len(splats)
    more = splats.select(which)
    smaller = (len(splats) / count) ** 0.5
    means = more.means + 0.5 * more.scales * torch.randn(count, 3, generator=g)
    scales = more.log_scales + float(np.log(max(smaller, 0.3)))
    return Gaussians(means, more.quats, scales, more.opacity_logits, more.sh)


def timed(act: Callable[[], object], rounds: int = 12) -> tuple[float, float]:
    """Median wall and CPU ms of a call, the first left out."""
    act()
    wall, cpu = [], []
    for _ in range(rounds):
        begun, used = time.perf_counter(), time.process_time()
        act()
        wall.append(1e3 * (time.perf_counter() - begun))
        cpu.append(1e3 * (time.process_time() - used))
    return float(np.median(wall)), float(np.median(cpu))


def measure(count: int, folder: Path, *, browser: bool) -> None:
    """Print the figures of a pair of ``count`` splats each."""
    paths, marks = [], []
    for i, (splats, landmarks) in enumerate(sample_pair()):
        paths.append(folder / f"{count}-{i}.ply")
        write(paths[-1], enlarged(splats, count))
        marks.append(landmarks)
    desk = open_desk(paths)

    def point(landmarks: Landmarks, name: str) -> tuple[float, ...]:
        return tuple(landmarks.points[(landmarks.names or ()).index(name)].tolist())

    desk.begin(
        Row(i, name, tuple(Place(point(side, name)) for side in marks))
        for i, name in enumerate(NAMES, 1)
    )
    side = desk.sides[0]
    camera = orbit(side.bounds, [0.0], width=SIZE[0], height=SIZE[1])[0]
    guide = desk.guide(0)

    def refit() -> None:
        desk.guides.clear()
        desk.guide(0)

    for what, act in (
        ("click to surface point", lambda: side.seen(camera, 280.0, 400.0)),
        ("prediction", lambda: guide.predict(side.center, 0, np.eye(3))),
        ("refit and residuals", refit),
        ("which marks are hidden", lambda: side.hidden([tuple(side.center)] * 20, camera)),
        ("the morph, packed", lambda: moving(desk.sides[0], desk.sides[1], guide)),
    ):
        wall, cpu = timed(act, 3 if "packed" in what else 12)
        print(f"{count:>8} splats  {what:<24} {wall:7.1f} ms  ({cpu:7.1f} ms CPU)")
    if browser:
        frames(desk, count)


def frames(desk: object, count: int) -> None:
    """Orbit both panes in a browser."""
    program = find_browser()
    if program is None:
        print("no Chromium here: no frames")
        return
    server = Server(desk, "")
    threading.Thread(target=server.serve_forever, daemon=True).start()
    seen = Browser(program, 1400, 860, offline=False)
    try:
        begun = time.perf_counter()
        seen.visit(server.address)
        seen.wait("document.documentElement?.dataset.ready && pane1.dataset.drawn === 'still'")
        print(f"{count:>8} splats  page is open after {time.perf_counter() - begun:.1f} s")
        for what in ("slowing down", "in motion"):
            used = used_by(seen.process)
            took = seen.evaluate(ORBIT.replace("COUNT", str(FRAMES)))
            used = 1e3 * (used_by(seen.process) - used) / FRAMES
            state = seen.evaluate("picker.panes.map((p) => [Math.round(p.few), p.coarse])")
            print(
                f"{count:>8} splats  frame, {what:<16} {np.median(took):7.1f} ms  "
                f"({used:7.1f} ms CPU), splats and pixels kept {state}"
            )
    finally:
        seen.close()
        server.shutdown()


def used_by(group: int) -> float:
    """CPU seconds of all processes of a group."""
    total = 0
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[2]) == group:
            total += int(fields[11]) + int(fields[12])
    return total / os.sysconf("SC_CLK_TCK")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--splats", type=int, nargs="+", default=[80_000, 1_000_000])
    parser.add_argument("--no-browser", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        for count in args.splats:
            measure(count, Path(folder), browser=not args.no_browser)


if __name__ == "__main__":
    main()
