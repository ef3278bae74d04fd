"""``splatmorph view``: Look at a run in the browser, live or as one page to share."""

from __future__ import annotations

import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import (
    Blend,
    Blending,
    ColourOption,
    Covariance,
    Out,
    Overwrite,
    Ramp,
    UpOption,
)
from splatmorph.errors import OptionError
from splatmorph.view.limits import MAX_SPLATS

if TYPE_CHECKING:
    from splatmorph.view.scene import Scene

PAGES = (".html", ".htm")


def view(
    what: Annotated[Path, Parameter(help="A run directory, a splat file or an avatar.")],
    /,
    *,
    out: Out = None,
    ramp: Annotated[Ramp | None, Parameter(help="How opacities fade at first.")] = None,
    blend: Annotated[Blend | None, Parameter(help="How the halves meet.")] = None,
    covariance: Annotated[
        Covariance | None, Parameter(help="What the flow does to shapes.")
    ] = None,
    up: UpOption = None,
    background: ColourOption = None,
    max_splats: Annotated[
        int, Parameter(help="Thin all splats out to this many together.")
    ] = MAX_SPLATS,
    diagnostics: Annotated[
        Path | None,
        Parameter(help="Draw the fit's diagnostics into this .png, .svg or .pdf instead."),
    ] = None,
    host: Annotated[str, Parameter(help="Where the live viewer listens.")] = "127.0.0.1",
    port: Annotated[int, Parameter(help="The first port it tries.")] = 8080,
    open_browser: Annotated[
        bool, Parameter(name="--open", help="Open the browser on the live viewer.")
    ] = True,
    overwrite: Overwrite = False,
) -> None:
    """Look at a run or a splat: with -o x.html as one page that opens offline anywhere, else live.

    The live viewer listens on this machine only, unless --host says otherwise, and runs until
    Ctrl-C. --diagnostics draws loss, landmark errors, volume change and the warped grid.
    """
    from splatmorph.rendering import upright
    from splatmorph.view.scene import open_scene

    if out is not None and out.suffix.lower() not in PAGES:
        raise OptionError(f"{out}: the page is an .html (for pictures, see splatmorph render)")
    written = [console.claim(path, overwrite) for path in (out, diagnostics) if path is not None]
    chosen = Blending(blend, ramp=ramp, covariance=covariance).chosen()
    if diagnostics is not None:
        from splatmorph.view.diagnostics import draw_diagnostics, read_history
        from splatmorph.view.subject import open_subject

        subject, report = open_subject(what, **chosen)
        draw_diagnostics(diagnostics, subject, report.get("errors", {}), read_history(what))
    if out is not None:
        scene = _prepared(open_scene(what, **chosen))
        _write_page(out, scene, up, background, max_splats)
    for path in written:
        console.say(f"wrote {path}")
    if not written:
        from splatmorph.view.live import serve

        paper = (1.0, 1.0, 1.0) if background is None else background
        scene = _prepared(open_scene(what, **chosen))
        above = upright(scene.splats[0], up)
        viewer = serve(
            scene, host=host, port=port, up=above, background=paper, max_splats=max_splats
        )
        console.say(f"look at {viewer.address}, stop with Ctrl-C")
        if open_browser:
            webbrowser.open(viewer.address)
        viewer.run()


def _prepared(scene: Scene) -> Scene:
    for leg in scene.legs:
        console.prepare(leg.morph, [0.5])
    return scene


def _write_page(
    out: Path,
    scene: Scene,
    up: str | None,
    background: tuple[float, float, float] | None,
    max_splats: int,
) -> None:
    from splatmorph.rendering import upright
    from splatmorph.view.page import write_page

    above = upright(scene.splats[0], up)
    page = write_page(out, scene, up=above, background=background, max_splats=max_splats)
    if page.thinned:
        console.warn(
            f"thinned out from {page.visible} to {page.splats} splats: "
            "give --max-splats to keep more"
        )
    truth = f", true to {page.error_px:.2f} pixels" if scene.legs else ""
    console.say(f"{page.splats} splats, {page.size / 1e6:.1f} MB{truth}")
