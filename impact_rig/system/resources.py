# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Where the package's files are: beside the code that runs, so a checkout and an installed version never mix.

A checkout has `config/` and `launch/` next to the package; pip, colcon and Debian put them in `share/impact_rig` of the
prefix that holds the package (`<prefix>/lib/python3.x/site-packages/impact_rig`). No environment variable is asked.
"""

from __future__ import annotations

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
