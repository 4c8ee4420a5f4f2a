"""`impact-rig export`: a table topic of a run as a file."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli import command
from impact_rig.cli.terminal import Console
from impact_rig.recording import open_run
from impact_rig.runs import export


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "export", "write a table topic as .csv, .npz or .parquet",
        [
            ("export runs/demo/gap_6mm transmissibility/table dt.csv", "what was measured"),
            ("export runs/demo/gap_6mm daq/scan scans.npz", "every scan, for NumPy"),
        ],
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    parser.add_argument("topic", help="e.g. transmissibility/table")
    parser.add_argument("target", type=Path, metavar="FILE", help="its suffix chooses the format")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    with open_run(arguments.path) as run:
        Console().print(str(export(run, arguments.topic, arguments.target)))
    return 0
