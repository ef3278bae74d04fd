"""``splatmorph demo``: Fit, render and export the sample pair."""

from __future__ import annotations

import time
from pathlib import Path

from splatmorph.app import console
from splatmorph.app.export import export
from splatmorph.app.fit import fit
from splatmorph.app.options import Out, Overwrite
from splatmorph.app.render import render
from splatmorph.app.view import view


def demo(*, out: Out = None, overwrite: Overwrite = False) -> None:
    """Make the sample pair, fit it, render it, export five PLY files, and write a page."""
    from splatmorph.io.atomic import make_folder
    from splatmorph.samples import write_sample_pair

    begun = time.perf_counter()
    folder = out or Path("splatmorph-demo")
    console.claim(folder, overwrite)
    make_folder(folder)
    source, target = write_sample_pair(folder)
    run = folder / f"{source.stem}-{target.stem}.run"
    fit(source, target, out=run, overwrite=overwrite)
    console.say("")
    render(run, out=folder / "morph.mp4", overwrite=overwrite)
    export(run, out=folder / "frames", frames=5, overwrite=overwrite)
    page = folder / "morph.html"
    view(run, out=page, overwrite=overwrite)
    console.say(f"the demo took {time.perf_counter() - begun:.0f} s; watch {folder}/morph.mp4, or")
    console.say(f"open {page.resolve().as_uri()} in a browser and turn it round")
