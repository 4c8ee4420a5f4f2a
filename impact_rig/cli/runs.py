"""Subcommands on recorded runs: info, analyze, verify, export."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.table import Table as TextTable

from impact_rig.cli.terminal import Console
from impact_rig.recording import open_run
from impact_rig.runs import export, info

FIGURE_FORMATS = ("png", "svg")  # of campaign.run_figures, which is too heavy for a parser


def add_commands(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommands."""
    parser = commands.add_parser("info", help="what a run holds and whether it is whole")
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    parser.set_defaults(run=_info)
    parser = commands.add_parser("export", help="write a table topic as .csv, .npz or .parquet")
    parser.add_argument("path", type=Path, metavar="RUN")
    parser.add_argument("topic", help="e.g. transmissibility/table")
    parser.add_argument("target", type=Path, metavar="FILE", help="its suffix chooses the format")
    parser.set_defaults(run=_export)
    parser = commands.add_parser("analyze", help="analyse a run again, as the live node did; says if the results agree")
    parser.add_argument("path", type=Path, metavar="RUN")
    parser.add_argument(
        "--figures",
        type=Path,
        metavar="DIR",
        help="also draw its last settled measurement (time traces, phase plane, spectrum) and the curves it holds",
    )
    parser.add_argument("--format", choices=FIGURE_FORMATS, default="png", help="of the figures (default: png)")
    parser.set_defaults(run=_analyze)
    parser = commands.add_parser("verify", help="re-simulate a run from its journal and compare every scan")
    parser.add_argument("path", type=Path, metavar="RUN")
    parser.set_defaults(run=_verify)


def _info(arguments: argparse.Namespace) -> int:
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


def _export(arguments: argparse.Namespace) -> int:
    with open_run(arguments.path) as run:
        Console().print(str(export(run, arguments.topic, arguments.target)))
    return 0


def _analyze(arguments: argparse.Namespace) -> int:
    console = Console()
    with open_run(arguments.path) as run:
        from impact_rig.runs import figures as run_figures  # noqa: PLC0415  # heavy: after the run has been opened
        from impact_rig.runs import live_comparison, reanalysis  # noqa: PLC0415  # as above

        if arguments.figures is not None:
            run_figures.prepare(arguments.figures, arguments.format)
        findings = list(reanalysis.analyze(run))
        found = reanalysis.measurements(iter(findings))
        comparison = live_comparison.compare(run, found)
        _print_measurements(console, reanalysis.rows(found))
        style = {True: "green", False: "red", None: "yellow"}[comparison.same]
        console.print(str(comparison), style=style)
        if arguments.figures is not None:
            stretch, files = run_figures.draw(run, findings, arguments.figures, arguments.format)
            console.print(f"drawn: {stretch}")
            for file in files:
                console.print(f"wrote {file}", soft_wrap=True)
    return 1 if comparison.same is False else 0


def _print_measurements(console: Console, rows: NDArray[np.void]) -> None:
    table = TextTable()
    for heading in ("f [Hz]", "DT", "u(DT)", "phase [deg]", "gap [mm]", "impacts/cycle", "regime", "status"):
        table.add_column(heading, justify="right")
    for row in rows:
        table.add_row(
            f"{row['frequency']:.3f}", f"{row['transmissibility']:.3f}", f"{row['transmissibility_uncertainty']:.3f}",
            f"{math.degrees(row['phase']):.2f}", f"{row['gap'] * 1e3:g}", f"{row['impacts_per_cycle']:.2f}",
            row["regime"].decode(), row["status"].decode(),
        )  # fmt: skip
    console.print(table)


def _verify(arguments: argparse.Namespace) -> int:
    with open_run(arguments.path) as run:
        from impact_rig.runs.verification import verify  # noqa: PLC0415  # as above

        verdict = verify(run)
    Console().print(f"{arguments.path}: {verdict}", style="green" if verdict.identical else "red")
    return 0 if verdict.identical else 1
