"""The page in real browsers: size, time to the first picture, frames while turning, likeness.

    python benchmarks/page.py [RUN …] [--splats 40000 75000] [--axe axe.min.js]

Without a run: the sample pair. Browsers draw by software here, so that frames are what the slowest
device gives; on a loaded machine CPU time says more than the wall. Likeness is PSNR against our
rasterizer's picture, from the front and from the side. ``--axe`` takes axe-core's file, which isn't
ours (npm pack axe-core), and lists what it finds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from splatmorph.fitting import fit
from splatmorph.flows import make_flow
from splatmorph.morph import Morph
from splatmorph.samples import sample_pair
from splatmorph.view.page import write_page
from splatmorph.view.scene import Scene, open_scene
from splatmorph.view.subject import Subject

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "view"))
from browser import Browser, find_browser
from driven import Driven
from firefox import Firefox, find_firefox, virtual_display
from page_cases import GROUND, our_picture, psnr
from picking import used_by

SIZE = (800, 600)
TURN = """new Promise((done) => {
  const times = [];
  let [last, angle] = [performance.now(), 0];
  const step = () => {
    const now = performance.now();
    times.push(now - last);
    last = now;
    angle += 2;
    location.replace(`#controls=0&t=0.5&azimuth=${angle}`);
    if (times.length < 30) requestAnimationFrame(step);
    else done(times);
  };
  requestAnimationFrame(step);
})"""
PAINTED = """(() => {
  const [paint] = performance.getEntriesByName("first-contentful-paint");
  return [paint ? paint.startTime : NaN, window.unpacked ?? performance.now()];
})()"""


@contextmanager
def browsers() -> Iterator[dict[str, Driven]]:
    """Those that are here and have WebGL 2."""
    with virtual_display() as display:
        found: dict[str, Browser | Firefox] = {}
        if program := find_browser():
            found["Chromium"] = Browser(program, *SIZE)
        if display and (program := find_firefox()):
            found["Firefox"] = Firefox(program, *SIZE, display)
        try:
            yield dict(found)
        finally:
            for one in found.values():
                one.close()


def sample_scene() -> Scene:
    """The sample pair's morph."""
    (a, marks_a), (b, marks_b) = sample_pair()
    flow = make_flow("node", dim=3)
    fit(flow, marks_a, marks_b)
    return Scene.of(Subject(Morph(a, b, flow)))


def measure(name: str, scene: Scene, most: int, folder: Path, axe: str | None) -> None:
    """Print the figures of one page of at most so many splats."""
    path = folder / f"{most}.html"
    report = write_page(path, scene, background=GROUND, max_splats=most)
    what = f"{name}, {report.splats} splats"
    print(f"{what}: {report.size / 1e6:.2f} MB, true to {report.error_px:.2f} px", flush=True)
    with browsers() as found:
        for kind, browser in found.items():
            browser.visit("about:blank")
            begun = time.perf_counter()
            browser.open(path, "controls=0&t=0.5")
            whole = time.perf_counter() - begun
            first, _ = browser.evaluate(PAINTED)
            print(f"  {kind}: first picture {first:.0f} ms, at rest in full {whole:.2f} s")
            if not report.thinned:
                likeness(kind, browser, path, scene)
            group = browser.process if isinstance(browser, Browser) else browser.process.pid
            used = used_by(group)
            took = browser.evaluate(TURN)
            used = 1e3 * (used_by(group) - used) / len(took)
            print(f"  {kind}: turning, {np.median(took[5:]):.0f} ms a frame ({used:.0f} ms CPU)")
            if axe:
                browser.open(path, "t=0.5")
                browser.evaluate(f"{axe};0" if isinstance(browser, Browser) else f"eval({axe!r}),0")
                faults = browser.evaluate(
                    "axe.run().then((r) => r.violations.map((v) => [v.id, v.impact]))"
                )
                print(f"  {kind}: axe-core finds {faults or 'nothing'}", flush=True)


def likeness(kind: str, browser: Driven, path: Path, scene: Scene) -> None:
    """PSNR against our rasterizer at the ends and in the middle."""
    for t in (0, 0.5, 1):
        seen = []
        for azimuth in (0, 35):
            browser.open(path, f"controls=0&t={t}&azimuth={azimuth}")
            seen.append(
                psnr(browser.screenshot() / 255, our_picture(browser, scene.legs[0].morph.at(t)))
            )
        print(f"  {kind}: t = {t}, {seen[0]:.1f} and {seen[1]:.1f} dB", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="*", type=Path)
    parser.add_argument("--splats", type=int, nargs="+", default=[40_000, 75_000])
    parser.add_argument("--axe", type=Path)
    args = parser.parse_args()
    axe = args.axe.read_text(encoding="utf-8") if args.axe else None
    scenes = {run.name: open_scene(run) for run in args.runs}
    with tempfile.TemporaryDirectory() as folder:
        for name, scene in (scenes or {"sample pair": sample_scene()}).items():
            for most in args.splats:
                measure(name, scene, most, Path(folder), axe)


if __name__ == "__main__":
    main()
