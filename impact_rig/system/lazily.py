"""A package's public names, imported when they are first asked for: whoever wants another module pays for none."""

from __future__ import annotations

import importlib
from collections.abc import Callable


def lazily(package: str, **homes: str) -> Callable[[str], object]:
    """Return the `__getattr__` of a package whose public names live in modules of its own: `homes`, name -> module."""

    def find(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(importlib.import_module(f"{package}.{homes[name]}"), name)

    return find
