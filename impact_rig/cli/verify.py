# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig verify`: re-simulate a run and compare."""

from __future__ import annotations

import argparse
from pathlib import Path

import attrs

from impact_rig.cli import command
from impact_rig.cli.terminal import Console, add_json, tell_json
from impact_rig.recording import open_run


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "verify", "re-simulate a run from its journal and compare all that the rig published",
        [("verify runs/demo/gap_6mm", "says `identical`, or names the first difference; then topic by topic")],
        "Exit code 0: identical; 1: different, or not verifiable.",
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    add_json(parser)
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    with open_run(arguments.path) as run:
        from impact_rig.cli import compiling  # noqa: PLC0415  # heavy: after the run has been opened
        from impact_rig.runs.verification import verify  # noqa: PLC0415

        compiling.ready()
        found = verify(run)
    if arguments.json:
        content = {"identical": found.identical, "scans": found.scans, "reason": found.reason}
        tell_json({**content, "topics": [attrs.asdict(one) for one in found.topics]})
    else:
        console = Console()
        console.print(f"{arguments.path}: {found}", style="green" if found.identical else "red")
        for one in found.topics:
            console.print(str(one), style="red" if one.difference else None)
    return 0 if found.identical else 1
