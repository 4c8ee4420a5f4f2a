# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What somebody meant who gave a command something else than it takes: said in one line below the error."""

from __future__ import annotations

import argparse
import difflib
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

LISTED = 8
"""Runs of a directory that are named."""
MOST_ENTRIES = 1000
"""Of a directory that are looked at."""
HEAD_BYTES = 65536
"""Of a file that are looked at."""
RUN, RUNS, CAMPAIGN, CAMPAIGN_FILE, CONFIGURATION = "run", "runs", "campaign", "campaign file", "configuration"
WANTED = {
    "info": RUN, "analyze": RUN, "verify": RUN, "replay": RUN, "recover": RUN, "export": RUN, "lab": RUN,
    "report": CAMPAIGN, "identify": CAMPAIGN, "campaign": CAMPAIGN_FILE, "check": CONFIGURATION,
}  # fmt: skip
"""Command to what it takes."""


def command(word: str, commands: Sequence[str]) -> str:
    """Return what somebody meant by a first word that is no command; empty if it cannot be guessed."""
    close = difflib.get_close_matches(word, commands, n=1)
    if close:
        return f"did you mean `impact-rig {close[0]}`?"
    path = Path(word)
    use = _use(path, kind(path)) if os.path.lexists(path) else ""
    return f"{word} {use}" if use else ""


def meant(chosen: argparse.Namespace) -> str:
    """Return what somebody meant by the path of a command that failed; empty if the path is what the command takes."""
    wanted = WANTED.get(chosen.command)
    given = [value for name in ("path", "directory", "file", "runs") for value in _paths(getattr(chosen, name, None))]
    for path in given if wanted else ():
        if not os.path.lexists(path):
            close = difflib.get_close_matches(path.name, [one.name for one in _entries(path.parent)], n=1, cutoff=0.7)
            return f"did you mean {path.parent / close[0]}?" if close else ""
        found = kind(path)
        if found not in ("", wanted):
            return f"{path} {_use(path, found)}"
    return ""


def kind(path: Path) -> str:
    """Return what lies at a path, empty if it is nothing of ours."""
    if path.is_dir():
        if any(one.suffix == ".mcap" for one in _entries(path)):
            return RUN
        if (path / "campaign.yaml").is_file():
            return CAMPAIGN
        return RUNS if _runs(path) else ""
    if path.suffix == ".mcap":
        return RUN
    if path.suffix in (".yaml", ".yml") and path.is_file():
        keys = {line.split(":")[0] for line in _head(path).splitlines() if line[:1].strip() and ":" in line}
        return CAMPAIGN_FILE if "studies" in keys else CONFIGURATION if keys else ""
    return ""


def _use(path: Path, found: str) -> str:
    """Return what a path is, and the command for it."""
    if found == RUNS:
        names = _runs(path)
        some = ", ".join(names[:LISTED]) + (", …" if len(names) > LISTED else "")
        many = "one run" if len(names) == 1 else f"{len(names)} runs"
        return f"holds {many}: {some}; give one of them, e.g. {path / names[0]}"
    return {
        RUN: f"is a run: `impact-rig info {path}`, `impact-rig analyze {path}`",
        CAMPAIGN: f"is the directory of a campaign: `impact-rig report {path}`",
        CAMPAIGN_FILE: f"is a campaign: `impact-rig campaign {path}`",
        CONFIGURATION: f"is a configuration of the rig: `impact-rig check {path}`",
    }.get(found, "")


def _runs(path: Path) -> list[str]:
    """Return the names of the runs in a directory, sorted."""
    inside = (one for one in _entries(path) if one.is_dir() and not one.is_symlink())
    return sorted(one.name for one in inside if any(file.suffix == ".mcap" for file in _entries(one)))


def _entries(path: Path) -> Iterator[Path]:
    try:
        with os.scandir(path) as found:
            for number, entry in enumerate(found):
                if number == MOST_ENTRIES:
                    return
                yield Path(entry.path)
    except OSError:
        return


def _head(path: Path) -> str:
    try:
        with path.open("rb") as file:
            return file.read(HEAD_BYTES).decode("utf-8", errors="replace")
    except OSError:
        return ""


def _paths(value: object) -> list[Path]:
    return [one for one in (value if isinstance(value, list) else [value]) if isinstance(one, Path)]
