# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Which code a result was measured with: results of other code are shown, but never mixed with new ones."""

from __future__ import annotations

import functools
import hashlib
from pathlib import Path

import impact_rig

DECIDING = ("arithmetic", "physics", "instruments", "rig", "analysis", "operate", "config", "blocks.py", "simtime.py")
"""What decides a measured number; the rest of the package commands, stores and shows."""


@functools.cache
def fingerprint(deciding: tuple[str, ...] = DECIDING) -> str:
    """Return the package's version and 12 hexadecimal digits of the sources in these rooms."""
    root = Path(impact_rig.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        name = path.relative_to(root)
        if name.parts[0] in deciding:
            digest.update(f"{name.as_posix()}\0".encode())
            digest.update(path.read_bytes())
    return f"{impact_rig.__version__}-{digest.hexdigest()[:12]}"
