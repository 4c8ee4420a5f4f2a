"""`impact-rig verify`: re-simulate a run and compare."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli.terminal import Console
from impact_rig.recording import open_run


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = commands.add_parser("verify", help="re-simulate a run from its journal and compare every scan")
    parser.add_argument("path", type=Path, metavar="RUN")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    with open_run(arguments.path) as run:
        from impact_rig.cli import compiling  # noqa: PLC0415  # heavy: after the run has been opened
        from impact_rig.runs.verification import verify  # noqa: PLC0415

        compiling.ready()
        found = verify(run)
    Console().print(f"{arguments.path}: {found}", style="green" if found.identical else "red")
    return 0 if found.identical else 1
