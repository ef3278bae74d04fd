"""The page in Chromium and in Firefox: its picture there, and every button clicked by a mouse."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest
from browser import Browser, find_browser
from driven import Driven
from firefox import Firefox, find_firefox, virtual_display
from page_cases import GROUND, our_picture, psnr, scene

from splatmorph.fitting import fit
from splatmorph.flows import make_flow
from splatmorph.io import read
from splatmorph.landmarks import Landmarks
from splatmorph.morph import Morph
from splatmorph.view.page import write_page
from splatmorph.view.scene import Scene
from splatmorph.view.subject import Subject

ASSETS = Path(__file__).parents[2] / "assets"
PAIR = ("ines", "otto")
EVERY = 12
"""Of the sample pair's splats, one in so many."""
KEEP_DOWNLOADS = """(() => {
  window.kept = [];
  HTMLAnchorElement.prototype.click = function () {
    window.kept.push(this.download);
  };
})()"""


@pytest.fixture(
    scope="module", params=["chromium", pytest.param("firefox", marks=pytest.mark.long)]
)
def driven(request: pytest.FixtureRequest) -> Iterator[Driven]:
    """A browser of either kind that has WebGL 2."""
    with virtual_display() as display:
        if request.param == "chromium":
            program = find_browser()
            if program is None:
                pytest.skip("no Chromium here (apt-get install chromium)")
            browser: Browser | Firefox = Browser(program, 900, 600)
        else:
            program = find_firefox()
            if program is None or display is None:
                pytest.skip("no Firefox with WebGL here (apt-get install firefox-esr xvfb)")
            browser = Firefox(program, 900, 600, display)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("page") / "a.html"
    write_page(made, scene(200))
    return made


@pytest.fixture(scope="module")
def heads(tmp_path_factory: pytest.TempPathFactory) -> dict[str, tuple[Path, Morph]]:
    """The sample pair as it is and without its harmonics, each with its page."""
    a, b = (read(ASSETS / f"{name}.ply").select(slice(None, None, EVERY)) for name in PAIR)
    marks_a, marks_b = (Landmarks.read(ASSETS / f"{name}.landmarks.json") for name in PAIR)
    flow = make_flow("node", dim=3)
    fit(flow, marks_a, marks_b)
    made = {}
    for name, degree in (("shaded", a.sh_degree), ("plain", 0)):
        morph = Morph(a.with_sh_degree(degree), b.with_sh_degree(degree), flow)
        path = tmp_path_factory.mktemp("heads") / f"{name}.html"
        write_page(path, Scene.of(Subject(morph)), background=GROUND)
        made[name] = path, morph
    return made


@pytest.mark.parametrize(("name", "least"), [("shaded", 42), ("plain", 45)])
def test_heads_look_as_by_the_rasterizer(
    driven: Driven, heads: dict[str, tuple[Path, Morph]], name: str, least: float
) -> None:
    path, morph = heads[name]
    for t in (0, 0.5, 1):
        driven.open(path, f"controls=0&t={t}")
        found = psnr(driven.screenshot() / 255, our_picture(driven, morph.at(t)))
        assert found >= least, f"{found:.1f} dB at t = {t}"


@pytest.mark.parametrize(
    ("button", "key"),
    [("#spin", "spin"), ("#marks", "marks"), ("#loop", "loop"), ("#play", "playing")],
)
def test_a_switch_is_on_and_off_again(driven: Driven, page: Path, button: str, key: str) -> None:
    driven.open(page, "t=0.3")
    before = driven.evaluate(f"splatmorph.state.{key}")
    for expected in (not before, before):
        driven.press(button)
        assert driven.evaluate(f"splatmorph.state.{key}") is expected


def test_what_is_shown_is_chosen(driven: Driven, page: Path) -> None:
    driven.open(page, "t=0.4")
    pictures = []
    for part in ("source", "target", "morph"):
        driven.press(f"label:has([value={part}])")
        assert driven.evaluate("splatmorph.state.part") == part
        driven.rest()
        pictures.append(driven.screenshot()[100:400])
    assert all((a != b).any() for a, b in pairwise(pictures))
    for name, key, value in (("ramp", "ramp", 0), ("speed", "speed", 4)):
        driven.evaluate(
            f"({name} => {{ {name}.selectedIndex = {'0' if name == 'ramp' else '4'};"
            f"{name}.dispatchEvent(new Event('change')); }})(document.getElementById('{name}'))"
        )
        assert driven.evaluate(f"splatmorph.state.{key}") == value


def test_the_ground_changes_and_home_brings_the_first_view_back(driven: Driven, page: Path) -> None:
    driven.open(page)
    first = driven.evaluate("splatmorph.view().rows")
    driven.press("#ground")
    driven.rest()
    assert "ground=" in driven.evaluate("location.hash")
    driven.evaluate("location.hash += '&azimuth=70', 0")
    driven.wait(f"splatmorph.view().rows[0][0] !== {first[0][0]}")
    driven.press("#home")
    assert driven.evaluate("splatmorph.view().rows") == first


def test_a_link_is_copied_that_brings_the_view_back(driven: Driven, page: Path) -> None:
    driven.open(page, "t=0.25&speed=2&loop=0&landmarks=1&azimuth=30")
    driven.press("#copy")
    driven.wait("document.getElementById('toast').textContent.includes('ink')")
    driven.rest()
    link = driven.evaluate("location.hash.slice(1)")
    view = driven.evaluate("splatmorph.view().rows")
    driven.open(page, link)
    state = driven.evaluate("splatmorph.state")
    assert (state["t"], state["speed"], state["marks"], state["loop"]) == (0.25, 2, True, False)
    assert driven.evaluate("splatmorph.view().rows") == view


def test_a_picture_is_saved(driven: Driven, page: Path) -> None:
    driven.open(page, "t=0.5")
    driven.evaluate(KEEP_DOWNLOADS)
    driven.press("#save")
    driven.wait("document.getElementById('toast').textContent === 'Picture saved'")
    assert driven.evaluate("kept") == ["source-target-t0.50.png"]


def test_a_video_is_recorded_and_a_print_lists_the_landmarks(driven: Driven, page: Path) -> None:
    driven.open(page, "speed=4")
    driven.evaluate(KEEP_DOWNLOADS)
    if not driven.evaluate("document.getElementById('record').hidden"):
        driven.press("#record")
        assert driven.evaluate("document.getElementById('record').ariaPressed") == "true"
        driven.wait("document.getElementById('toast').textContent === 'Video saved'")
        assert driven.evaluate("kept[0]").rpartition(".")[2] in ("mp4", "webm")
    driven.evaluate("dispatchEvent(new Event('beforeprint'))")
    assert driven.evaluate("document.querySelectorAll('#paper tr').length") == 6


def test_keys_are_shown_and_the_screen_is_filled(driven: Driven, page: Path) -> None:
    driven.open(page)
    driven.press("#help")
    assert driven.evaluate("document.getElementById('keys').open")
    driven.press("#keys button")
    assert not driven.evaluate("document.getElementById('keys').open")
    if isinstance(driven, Firefox):  # which fills no screen that isn't there
        driven.evaluate(
            "(document.documentElement.requestFullscreen = () => { window.filled = 1; }, 0)"
        )
        driven.press("#fullscreen")
        assert driven.evaluate("filled") == 1
        return
    driven.press("#fullscreen")
    driven.wait("document.fullscreenElement")
    driven.press("#fullscreen")
    driven.wait("!document.fullscreenElement")


def test_no_button_is_forgotten(driven: Driven, page: Path) -> None:
    """Whoever adds a control adds a click here."""
    driven.open(page)
    found = driven.evaluate("[...document.querySelectorAll('button, select')].map((b) => b.id)")
    clicked = "copy save record fullscreen help play ramp speed spin marks loop ground home"
    assert sorted(found) == sorted(["", *clicked.split()])


def test_inside_another_page_there_is_the_picture_and_its_time(driven: Driven, page: Path) -> None:
    driven.open(page, "embed=1&t=0.5")
    shown = driven.evaluate(
        "[...document.querySelectorAll('button, select, header')]"
        ".filter((one) => one.checkVisibility()).map((one) => one.id)"
    )
    assert shown == ["fullscreen", "play"]
