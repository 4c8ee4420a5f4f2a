# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A package's public names, imported when they are first asked for: whoever wants another module pays for none."""

from __future__ import annotations

import importlib
from collections.abc import Callable


def lazily(package: str, **homes: str) -> Callable[[str], object]:
    """Return the `__getattr__` of a package whose public names live elsewhere.

    Args:
        package: its name.
        homes: the module of each name, of this package unless there is a dot in it.
    """

    def find(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        return getattr(importlib.import_module(home if "." in home else f"{package}.{home}"), name)

    return find
