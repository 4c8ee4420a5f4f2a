# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig recover`: what was given back and what is missing, file by file."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli import command
from impact_rig.cli.terminal import Console, TextTable, add_json, tell_json
from impact_rig.runs import RecoverReport, recover

INCOMPLETE = 3
"""Exit code when the new run lacks something of the old one."""
LISTED = 20
"""Places that are shown one by one."""


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "recover", "save every whole chunk of a damaged or unfinished run",
        [("recover runs/killed runs/saved", "writes what is whole to a new run, and says what is missing")],
        f"Exit code 0: all that was found is whole; {INCOMPLETE}: something is missing; 1: nothing was saved.",
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    add_json(parser)
    parser.add_argument("out", type=Path, metavar="OUT", help="new run directory")
    parser.add_argument(
        "--accept-unchecked",
        action="store_true",
        help="also take chunks without a checksum, as rosbag2 writes them: nobody can tell whether they are right",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Recover and return the exit code."""
    report = recover(arguments.path, arguments.out, accept_unchecked=arguments.accept_unchecked)
    if arguments.json:
        tell_json(_content(report))
        return 0 if report.complete else INCOMPLETE
    console = Console()
    style = "green" if report.complete else "yellow"
    console.print(f"{report.directory}: {_verdict(report)}", style=style)
    _print_files(console, report)
    for damage in report.damages[:LISTED]:
        console.print(
            f"{damage.file}, byte {damage.offset}, {damage.length} bytes: {damage.reason}",
        )
    if report.damage_count > LISTED:
        console.print(f"and {report.damage_count - LISTED} more places")
    return 0 if report.complete else INCOMPLETE


def _verdict(report: RecoverReport) -> str:
    if not report.complete:
        missing = "an unknown number of" if report.missing_messages is None else str(report.missing_messages)
        return (
            f"{report.messages} messages given back; {missing} messages, {report.lost_bytes} bytes in "
            f"{report.damage_count} places are missing"
        )
    if report.expected_messages is None:
        return f"all {report.messages} messages that were found are given back; the run was never finished"
    return f"all {report.messages} messages are given back"


def _print_files(console: Console, report: RecoverReport) -> None:
    table = TextTable()
    table.add_column("file", overflow="fold")
    for heading in (
        "bytes",
        "messages\nback",
        "seconds\nback",
        "messages\nmissing",
        "seconds\nmissing",
        "bytes\nmissing",
    ):
        table.add_column(heading, justify="right")
    for file in report.files:
        table.add_row(
            file.name,
            str(file.size),
            str(file.messages),
            f"{file.given_s:.3f}",
            "unknown" if file.missing_messages is None else str(file.missing_messages),
            "unknown" if file.missing_s is None else f"{file.missing_s:.3f}",
            str(file.lost_bytes),
        )
    console.print(table)


def _content(report: RecoverReport) -> dict[str, object]:
    return {
        "directory": str(report.directory),
        "complete": report.complete,
        "verdict": _verdict(report),
        "messages": report.messages,
        "missing_messages": report.missing_messages,
        "lost_bytes": report.lost_bytes,
        "files": [
            {
                "name": one.name, "bytes": one.size, "messages": one.messages, "given_s": one.given_s,
                "missing_messages": one.missing_messages, "missing_s": one.missing_s, "lost_bytes": one.lost_bytes,
            }
            for one in report.files
        ],
        "damages": [
            {"file": str(one.file), "offset": one.offset, "length": one.length, "reason": one.reason}
            for one in report.damages
        ],
        "damage_count": report.damage_count,
    }  # fmt: skip
