# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig compile`: make all compiled code now, instead of when it is first needed."""

from __future__ import annotations

import argparse

from impact_rig.cli import command, compiling
from impact_rig.cli.terminal import Console
from impact_rig.errors import ImpactRigError


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "compile", "compile the kernels now; otherwise the first start does, once",
        [("compile", "in an image, so that its containers start at once")],
    )  # fmt: skip
    parser.set_defaults(run=_run)


def _run(_arguments: argparse.Namespace) -> int:
    missing = compiling.ready()
    if missing:
        names = ", ".join(task.run for task in missing)
        raise ImpactRigError(f"not compiled: {names}; the first use of that code will say why")
    Console().print("everything is compiled")
    return 0
