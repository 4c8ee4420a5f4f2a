# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig info`: what a run holds and whether it is whole."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli import command
from impact_rig.cli.terminal import Console, TextTable, add_json, tell_json
from impact_rig.runs import RunInfo, info


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "info", "what a run holds and whether it is whole",
        [
            ("info runs/demo/gap_6mm", "verdict, duration, topics"),
            ("info runs/demo/gap_6mm --json", "the same for a script"),
        ],
        "Exit code 0: every checksum fits and nothing is known to be missing; 1: not so.",
    )  # fmt: skip
    add_json(parser)
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    found = info(arguments.path)
    if arguments.json:
        tell_json(_content(found))
        return 0 if found.intact else 1
    console = Console()
    proven = found.intact and found.accounted and found.recovered is None
    style = "green" if proven else "yellow" if found.intact else "red"
    console.print(f"{found.path}: {found.verdict}", style=style)
    size = sum(size for _, size in found.files)
    console.print(f"{found.duration_s:.3f} s of rig time, files: {len(found.files)}, {size / 1e6:.2f} MB")
    if found.recovered is not None:
        console.print(f"recovered from {found.recovered.source}", highlight=False)
    for key, value in found.provenance.items():
        console.print(f"{key}: {value}")
    table = TextTable()
    for heading, side in (
        ("topic", "left"),
        ("type", "left"),
        ("messages", "right"),
        ("per s", "right"),
        ("kB", "right"),
    ):
        table.add_column(heading, justify=side, overflow="fold")
    for topic in found.topics:
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.1f}"
        table.add_row(
            topic.name, topic.type_name.rpartition("/")[2], str(topic.count), rate, f"{topic.bytes / 1e3:.1f}"
        )
    console.print(table)
    if found.attachments:
        console.print("attached: " + ", ".join(f"{name} ({size} bytes)" for name, size in found.attachments.items()))
    return 0 if found.intact else 1


def _content(found: RunInfo) -> dict[str, object]:
    return {
        "path": str(found.path),
        "intact": found.intact,
        "verdict": found.verdict,
        "duration_s": found.duration_s,
        "files": dict(found.files),
        "provenance": dict(found.provenance),
        "recovered_from": None if found.recovered is None else found.recovered.source,
        "lost_messages": dict(found.lost),
        "lost_blocks": None if found.scans is None else found.scans.lost_blocks,
        "topics": [
            {"name": one.name, "type": one.type_name, "messages": one.count, "rate_hz": one.rate_hz, "bytes": one.bytes}
            for one in found.topics
        ],
        "attachments": dict(found.attachments),
    }
