"""What a bug report needs: the versions of us and of what we stand on, and the machine."""

from __future__ import annotations

import importlib.metadata
import os
import platform
import re

from splatmorph._version import __version__
from splatmorph.app import console


def say_versions() -> None:
    """Print a line each: ours, Python's, the system's, and those of all that we may depend on."""
    console.say(f"splatmorph {__version__}")
    console.say(f"Python {platform.python_version()}, {platform.platform()}")
    console.say(f"{os.cpu_count()} CPU cores, {_cuda()}")
    for name in _dependencies():
        console.say(f"{name} {_version_of(name)}")


def _dependencies() -> list[str]:
    try:
        needed = importlib.metadata.requires("splatmorph") or []
    except importlib.metadata.PackageNotFoundError:
        needed = ["torch", "numpy", "scipy", "warp-lang", "plyfile", "cyclopts"]
    names = {re.split(r"[^\w.-]", one)[0] for one in needed}
    return sorted(names - {"splatmorph"}, key=str.lower)


def _version_of(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _cuda() -> str:
    import torch

    return f"CUDA {torch.version.cuda}" if torch.cuda.is_available() else "no CUDA device"
