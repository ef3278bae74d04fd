"""``splatmorph pick``: Click the same features on two splats, or two pictures, in the browser."""

from __future__ import annotations

import shlex
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from splatmorph.app import console
from splatmorph.app.options import Out, UpOption
from splatmorph.view.limits import MAX_SPLATS

if TYPE_CHECKING:
    from splatmorph.view.pick import Desk


def pick(
    source: Annotated[Path, Parameter(help="A splat file, an avatar's directory, or a picture.")],
    target: Annotated[Path, Parameter(help="What it becomes, of the same kind.")],
    /,
    *more: Annotated[Path, Parameter(help="Further ones: a chain, a tab for each pair.")],
    out: Out = None,
    start: Annotated[
        str | None,
        Parameter(help="Begin with what is found: auto or face; or the source's landmark file."),
    ] = None,
    template: Annotated[
        str | None,
        Parameter(help="What to click, by name: face12, head, bust, or a file of names."),
    ] = None,
    up: UpOption = None,
    max_splats: Annotated[int, Parameter(help="Most splats of each that are shown.")] = MAX_SPLATS,
    port: Annotated[int, Parameter(help="The first port it tries.")] = 8123,
    browser: Annotated[bool, Parameter(help="Open the browser on the picker.")] = True,
) -> None:
    """Click the same features on two splats in the browser, and see the morph at once.

    Click a feature on A: where it is on B is predicted, Enter accepts, a click corrects. From the
    fourth pair on the slider plays the morph. Saved as STEM.landmarks.json beside each input, or
    into the folder given by -o; a file that was there is kept as .bak. Stop with Ctrl-C.
    """
    from splatmorph.view.pick import Server, open_desk
    from splatmorph.view.pick import start as begin

    paths = (source, target, *more)
    with console.progress("looking for landmarks") as update:
        if start == "face" and template is None:
            template = "head"
        desk = open_desk(paths, folder=out, template=template, up=up, max_splats=max_splats)
        if desk.papers.set_aside is not None:
            console.warn(f"{desk.papers.autosave} can't be read: kept as {desk.papers.set_aside}")
        if desk.unsaved:
            console.say(f"took up what was not saved last time: {desk.papers.autosave}")
        said = begin(desk, start, update) if start is not None else None
    if said is not None:
        console.say(said)
    command = next_command(desk, paths, out)
    server = Server(desk, command, port)
    console.say(f"pick at {server.address}")
    console.say("stop with Ctrl-C")
    if browser:
        webbrowser.open(server.address)
    try:
        server.serve_forever()
    except KeyboardInterrupt:
        pass
    finally:
        server.server_close()
        left = desk.leave()
    if left is not None:
        console.warn(left)
    if desk.papers.written:
        for path in sorted(desk.papers.written):
            console.say(f"wrote {path}")
        console.say("next:")
        console.say(f"  {command}")


def next_command(desk: Desk, paths: Sequence[Path], out: Path | None) -> str:
    """What makes the morph of what was picked."""
    from splatmorph.view.pick.sides import PictureSide

    verb = "image" if isinstance(desk.sides[0], PictureSide) else "fit"
    parts = ["splatmorph", verb, *map(str, paths)]
    beside = out is None and not any(path.is_dir() for path in paths)
    if not beside and len(paths) == 2:
        parts += ["--source-landmarks", str(desk.papers.path(0))]
        parts += ["--target-landmarks", str(desk.papers.path(1))]
    command = shlex.join(parts)
    if not beside and len(paths) > 2:
        command += f"   # with the landmark files from {out or paths[0].parent} beside the inputs"
    return command
