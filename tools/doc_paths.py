# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Paths of the repository in its documents: which words are one, and whether there is such a file."""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
MADE = {"build", "install", "log", "runs", "failed_runs"}
"""Folders that a checkout may have and the repository has not."""
NO_PATHS = {"impact_rig/topic", "impact_rig/losses", "impact_rig/recovered", "impact_rig/continues"}  # names of records
_PATH = re.compile(r"[\w.-]+(?:/[\w.-]+)*/?")
_ENDINGS = (".py", ".md", ".yaml", ".xml", ".json", ".toml", ".txt", ".rst", ".sh", ".c")


@cache
def files() -> tuple[str, ...]:
    """Return every file of the repository, relative to it."""
    folders = [path for path in ROOT.iterdir() if path.is_dir() and path.name not in MADE and path.name[0] != "."]
    found = [*(path for folder in folders for path in folder.rglob("*")), *ROOT.iterdir()]
    return tuple(path.relative_to(ROOT).as_posix() for path in found if path.is_file())


def is_path(text: str) -> bool:
    """Whether a word claims to be a file or folder of the repository."""
    if text in NO_PATHS or not _PATH.fullmatch(text):
        return False
    top, slash, _ = text.partition("/")
    below = bool(slash) and top not in MADE and any(name.startswith(f"{top}/") for name in files())
    return below or text.endswith((".py", ".md")) or (bool(slash) and top not in MADE and text.endswith(_ENDINGS))


def exists(text: str) -> bool:
    """Whether there is such a file or folder; `nodes/topics.py` may stand for `impact_rig/topics.py`."""
    return (ROOT / text).exists() or any(name.endswith(f"/{text}") for name in files())
