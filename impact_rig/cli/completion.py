# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig completion`: what a shell must run so that Tab completes commands, options and paths."""

from __future__ import annotations

import argparse
import os

from impact_rig.cli import command
from impact_rig.errors import ImpactRigError

SHELLS = ("bash", "zsh", "fish")
ASKED = "_ARGCOMPLETE"
"""Set by a shell that asks what could come next."""


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "completion", "print what lets a shell complete commands and options",
        [
            ('completion bash >> ~/.bashrc', "for every new bash; zsh: ~/.zshrc"),
            ("completion fish > ~/.config/fish/completions/impact-rig.fish", "for every new fish"),
        ],
    )  # fmt: skip
    parser.add_argument("shell", choices=SHELLS, help="which shell")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    try:
        from argcomplete.shell_integration import shellcode  # noqa: PLC0415  # an extra
    except ImportError as error:
        raise ImpactRigError(f"completion needs its extra: pip install 'impact_rig[completion]' ({error})") from error
    print(shellcode(["impact-rig"], True, arguments.shell))  # noqa: T201  # a command line tool talks
    return 0


def complete(parser: argparse.ArgumentParser) -> None:
    """Answer a shell and end the program, where a shell has asked and argcomplete is installed."""
    if ASKED not in os.environ:
        return
    try:
        import argcomplete  # noqa: PLC0415  # an extra
    except ImportError:
        return
    argcomplete.autocomplete(parser)
