# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""How a subcommand is registered: with one sentence, and with examples that can be copied."""

from __future__ import annotations

import argparse
import textwrap
from collections.abc import Sequence

WIDTH = 78
"""Of help pages: they are made for a terminal of 80 columns."""


def add(
    commands: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    sentence: str,
    examples: Sequence[tuple[str, str]],
    more: str = "",
) -> argparse.ArgumentParser:
    """Register a subcommand and return its parser.

    Args:
        commands: of the program.
        name: of the subcommand.
        sentence: what it does, for the list of commands and the head of its page.
        examples: command without the program's name, and what it is for.
        more: what else is to be known, below the examples.
    """
    lines = [f"  impact-rig {words}\n      {what}" for words, what in examples]
    head = "example:" if len(lines) == 1 else "examples:"
    epilog = "\n".join([head, *lines, *(["", textwrap.fill(more, WIDTH)] if more else [])])
    return commands.add_parser(
        name,
        help=sentence,
        description=textwrap.fill(f"{sentence[:1].upper()}{sentence[1:]}.", WIDTH),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
