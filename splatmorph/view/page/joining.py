"""How a page of ours is put together: scripts joined, their hashes, a skeleton filled."""

from __future__ import annotations

import base64
import hashlib
import re
from collections.abc import Iterable, Mapping
from importlib.resources import files


def read_text(package: str, name: str) -> str:
    """A file that lies in a package."""
    return files(package).joinpath(name).read_text(encoding="utf-8")


def joined(parts: Iterable[tuple[str, str]]) -> str:
    """One script of several files, each by package and name."""
    return "\n".join(read_text(package, name) for package, name in parts)


def digest(text: str) -> str:
    """What a Content-Security-Policy calls an inline script or style by."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def filled(skeleton: str, parts: Mapping[str, str]) -> str:
    """``skeleton`` with each ``{{name}}`` replaced, whatever the parts hold."""
    return re.sub(r"\{\{(\w+)\}\}", lambda found: parts[found[1]], skeleton)
