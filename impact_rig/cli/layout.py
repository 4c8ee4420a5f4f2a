# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig layout`: the layouts for Foxglove, Lichtblick and PlotJuggler, for rigs in any namespace."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli import command
from impact_rig.cli.terminal import Console
from impact_rig.errors import ConfigError
from impact_rig.system.layouts import write_layouts


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "layout", "write layouts for Foxglove, Lichtblick and PlotJuggler",
        [
            ("layout layouts", "for the rig that the launch file starts"),
            ("layout --namespace /cell/two layouts", "for a rig in another namespace"),
        ],
    )  # fmt: skip
    parser.add_argument("directory", type=Path, metavar="DIRECTORY", help="where they are written")
    parser.add_argument("--namespace", default="/rig", help="of the rig's topics; / for runs of the demo (%(default)s)")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    try:
        written = write_layouts(arguments.directory, arguments.namespace)
    except OSError as error:
        raise ConfigError(f"cannot write {error.filename}: {error.strerror}") from error
    console = Console()
    for path in written:
        console.print(str(path), highlight=False, soft_wrap=True)
    return 0
