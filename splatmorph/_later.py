"""Packages whose names are loaded when first asked for: ``--help`` needs no torch."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping
from typing import Any


def later(
    package: str, homes: Mapping[str, str]
) -> tuple[Callable[[str], Any], Callable[[], list[str]]]:
    """``__getattr__`` and ``__dir__`` of ``package``, each of whose names has a module in it.

    Args:
        package: its ``__name__``.
        homes: the module, within the package, that each name is loaded from.
    """
    known = vars(sys.modules[package])

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        known[name] = getattr(importlib.import_module(f"{package}.{homes[name]}"), name)
        return known[name]

    return load, lambda: sorted({*known, *homes})
