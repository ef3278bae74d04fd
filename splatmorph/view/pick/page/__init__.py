"""The picker's page: the drawing of the shared page, and hands that click."""

from __future__ import annotations

import html
import json
from collections.abc import Sequence

from splatmorph._version import __version__
from splatmorph.view import page
from splatmorph.view.page.joining import digest, filled, joined, read_text
from splatmorph.view.pick.papers import Sides

SHARED = ("scene.js", "camera.js", "shaders.js", "splats.js", "hands.js")
"""Of the page that shows a run."""
OWN = (
    "talk.js",
    "panes.js",
    "marks.js",
    "table.js",
    "session.js",
    "pointing.js",
    "keys.js",
    "start.js",
)


def picker_page(sides: Sides, names: Sequence[str], command: str) -> bytes:
    """The page for these inputs; ``command`` is what to type when all is picked."""
    script = joined(
        [*((page.__package__ or "", name) for name in SHARED), *((__package__, one) for one in OWN)]
    )
    style = read_text(__package__, "pick.css")
    facts = {
        "sides": [side.facts() for side in sides],
        "template": list(names),
        "command": command,
    }
    policy = (
        f"default-src 'none'; script-src '{digest(script)}'; style-src '{digest(style)}'; "
        "img-src 'self' blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'"
    )
    parts = {
        "version": __version__,
        "policy": policy,
        "title": html.escape(" and ".join(side.name for side in sides)),
        "style": style,
        "script": script,
        "facts": json.dumps(facts, allow_nan=False).replace("<", "\\u003c"),
    }
    return filled(read_text(__package__, "pick.html"), parts).encode()
