"""``splatmorph view``: Look at a run in the browser, live or as one page to share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Blending, ColourOption, Out, Overwrite, RunPath, UpOption
from splatmorph.errors import OptionError
from splatmorph.rendering import upright
from splatmorph.view.page import MAX_SPLATS, write_page
from splatmorph.view.subject import open_subject

PAGES = (".html", ".htm")


def view(
    run: RunPath,
    /,
    *,
    out: Out = None,
    ramp: Annotated[str | None, Parameter(help="How opacities fade at first.")] = None,
    blend: Annotated[str | None, Parameter(help="How the halves meet.")] = None,
    covariance: Annotated[str | None, Parameter(help="What the flow does to shapes.")] = None,
    up: UpOption = None,
    background: ColourOption = None,
    max_splats: Annotated[
        int, Parameter(help="Thin both splats out to this many together.")
    ] = MAX_SPLATS,
    diagnostics: Annotated[
        Path | None,
        Parameter(help="Draw the fit's diagnostics into this .png, .svg or .pdf instead."),
    ] = None,
    host: Annotated[str, Parameter(help="Where the live viewer listens.")] = "127.0.0.1",
    port: Annotated[int, Parameter(help="The first port it tries.")] = 8080,
    overwrite: Overwrite = False,
) -> None:
    """Look at a run: with -o x.html as one page that opens offline anywhere, else live.

    The live viewer listens on this machine only, unless --host says otherwise, and runs until
    Ctrl-C. --diagnostics draws loss, landmark errors, volume change and the warped grid.
    """
    if out is not None and out.suffix.lower() not in PAGES:
        raise OptionError(f"{out}: the page is an .html (for pictures, see  splatmorph render)")
    written = [console.claim(path, overwrite) for path in (out, diagnostics) if path is not None]
    subject, report = open_subject(run, **Blending(blend, ramp, covariance).chosen())
    above = upright(subject.morph.source, up)
    if diagnostics is not None:
        from splatmorph.view.diagnostics import draw_diagnostics, read_history

        draw_diagnostics(diagnostics, subject, report.get("errors", {}), read_history(run))
    if out is not None:
        page = write_page(out, subject, up=above, background=background, max_splats=max_splats)
        if page.thinned:
            console.warn(
                f"thinned out from {page.visible} to {page.splats} splats: "
                "give --max-splats to keep more"
            )
        console.say(
            f"{page.splats} splats, {page.size / 1e6:.1f} MB, true to {page.error_px:.2f} pixels"
        )
    for path in written:
        console.say(f"wrote {path}")
    if not written:
        from splatmorph.view.live import serve

        paper = (1.0, 1.0, 1.0) if background is None else background
        viewer = serve(
            subject, host=host, port=port, up=above, background=paper, max_splats=max_splats
        )
        console.say(f"look at {viewer.address}, stop with Ctrl-C")
        viewer.run()
