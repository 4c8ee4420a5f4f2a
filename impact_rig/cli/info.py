"""`impact-rig info`: what a run holds and whether it is whole."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli.terminal import Console, TextTable
from impact_rig.runs import info


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = commands.add_parser("info", help="what a run holds and whether it is whole")
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    console = Console()
    found = info(arguments.path)
    proven = found.intact and found.accounted and found.recovered is None
    style = "green" if proven else "yellow" if found.intact else "red"
    console.print(f"{found.path}: {found.verdict}", style=style)
    size = sum(size for _, size in found.files)
    console.print(f"{found.duration_s:.3f} s of rig time, {len(found.files)} file(s), {size / 1e6:.2f} MB")
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
        table.add_column(heading, justify=side, overflow="fold")  # type: ignore[arg-type]  # rich wants its literals
    for topic in found.topics:
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.1f}"
        table.add_row(
            topic.name, topic.type_name.rpartition("/")[2], str(topic.count), rate, f"{topic.bytes / 1e3:.1f}"
        )
    console.print(table)
    if found.attachments:
        console.print("attached: " + ", ".join(f"{name} ({size} bytes)" for name, size in found.attachments.items()))
    return 0 if found.intact else 1
