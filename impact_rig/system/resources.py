# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Where the package's files are, beside the code that runs; and its public names, imported when they are asked for.

A checkout has `config/` and `launch/` next to the package; pip, colcon and Debian put them in `share/impact_rig` of the
prefix that holds the package (`<prefix>/lib/python3.x/site-packages/impact_rig`): a checkout and an installed version
never mix, as no environment variable is asked.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

from impact_rig.errors import ImpactRigError

_PACKAGE = Path(__file__).resolve().parents[1]


def share_dir(package: Path = _PACKAGE) -> Path:
    """Return the directory that holds `config/`, `launch/` and `package.xml`.

    Raises:
        ImpactRigError: the package was copied without them.
    """
    candidates = [package.parent, *(parent / "share" / package.name for parent in package.parents)]
    for candidate in candidates:
        if (candidate / "package.xml").is_file() and (candidate / "config").is_dir():
            return candidate
    raise ImpactRigError(f"config/ and package.xml are neither beside {package} nor in share/{package.name} above it")


def config_dir() -> Path:
    """Return the directory of the working configurations."""
    return share_dir() / "config"


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
