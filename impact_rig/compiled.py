"""Compiled code of another version is thrown away: importing this module does it, before any of it is loaded.

Numba keeps compiled functions next to their sources and compiles one again when its own file has changed, but not when
a function it calls has: after an upgrade or an edit in place, old and new code would run mixed, or fail to load.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from pathlib import Path

ROOT = Path(__file__).parent
STAMP = "compiled.sources"
COMPILED = "*.nb[ic]"


def discard_stale(root: Path = ROOT) -> bool:
    """Delete what was compiled from other sources below `root`; return whether something was stale.

    Where the package cannot be written, Numba keeps its cache elsewhere and nothing is done here.
    """
    sources = _fingerprint(root)
    stamp = root / "__pycache__" / STAMP
    with contextlib.suppress(OSError):
        if stamp.exists() and stamp.read_text() == sources:
            return False
        stale = [found for found in root.rglob(COMPILED) if found.parent.name == "__pycache__"]
        for found in stale:
            found.unlink(missing_ok=True)  # a process that starts beside us may have been faster
        stamp.parent.mkdir(exist_ok=True)
        own = stamp.with_suffix(f".{os.getpid()}")
        own.write_text(sources)
        own.replace(stamp)
        return bool(stale)
    return False


def _fingerprint(root: Path) -> str:
    """Return what tells one state of the sources from another: path, size and time of each file."""
    found = []
    for path in sorted(root.rglob("*.py")):
        status = path.stat()
        found.append(f"{path.relative_to(root)} {status.st_size} {status.st_mtime_ns}")
    return hashlib.sha256("\n".join(found).encode()).hexdigest()


discard_stale()
