# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The machine around the programs: signals, budgets, files, compiled code kept, plain YAML, what computed a result."""

from __future__ import annotations

import importlib
from collections.abc import Callable


def lazily(package: str, **homes: str) -> Callable[[str], object]:
    """Return the `__getattr__` of a package whose public names live elsewhere."""

    def find(name: str) -> object:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        return getattr(importlib.import_module(home if "." in home else f"{package}.{home}"), name)

    return find
