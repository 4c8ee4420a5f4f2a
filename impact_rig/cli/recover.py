"""`impact-rig recover`: what was given back and what is missing, file by file."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli.terminal import Console, TextTable
from impact_rig.runs import RecoverReport, recover

INCOMPLETE = 3
"""Exit code when the new run lacks something of the old one."""
LISTED = 20
"""Places that are shown one by one."""


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = commands.add_parser(
        "recover",
        help="save every whole chunk of a damaged or unfinished run",
        epilog=f"Exit code 0: all that was found is whole; {INCOMPLETE}: something is missing; 1: nothing was saved.",
    )
    parser.add_argument("path", type=Path, metavar="RUN")
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
    console = Console()
    _print_files(console, report)
    for damage in report.damages[:LISTED]:
        console.print(
            f"{damage.file}, byte {damage.offset}, {damage.length} bytes: {damage.reason}",
        )
    if report.damage_count > LISTED:
        console.print(f"and {report.damage_count - LISTED} more places")
    style = "green" if report.complete else "yellow"
    console.print(f"{report.directory}: {_verdict(report)}", style=style)
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
