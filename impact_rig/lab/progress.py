"""How far the compiler is, by the files it has written: the first start on a machine takes a minute or two."""

from __future__ import annotations

import re
from pathlib import Path

from impact_rig.system import compiled

PACKAGES = ("arithmetic", "physics", "instruments", "rig")
"""What the rig compiles when it is configured."""
_COMPILED = re.compile(r"^@njit", re.MULTILINE)


def expected(root: Path = compiled.ROOT) -> int:
    """Return how many functions the rig's packages have compiled."""
    paths = (path for package in PACKAGES for path in (root / package).rglob("*.py"))
    return sum(len(_COMPILED.findall(path.read_text(encoding="utf-8"))) for path in paths)


def ready() -> int:
    """Return how many of them are compiled and kept."""
    directory = compiled.Cache(compiled.ROOT).directory
    if directory is None:
        return 0
    return sum(1 for package in PACKAGES for _ in (directory / package).rglob("*.nbi"))
