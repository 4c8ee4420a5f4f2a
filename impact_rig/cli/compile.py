"""`impact-rig compile`: make all compiled code now, instead of when it is first needed."""

from __future__ import annotations

import argparse

from impact_rig.cli import command, compiling
from impact_rig.cli.terminal import Console


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "compile", "compile the kernels now; otherwise the first start does, once",
        [("compile", "in an image, so that its containers start at once")],
    )  # fmt: skip
    parser.set_defaults(run=_run)


def _run(_arguments: argparse.Namespace) -> int:
    made = compiling.ready()
    Console().print("compiled" if made else "nothing to do: everything is compiled")
    return 0
