"""The one way of text to the terminal: nothing in it is markup, a picture word or a control character.

Names of files and topics, texts of recordings and campaigns come from anybody. What is coloured here is coloured by
`style`, never inside a text.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any  # what rich's methods take

from rich import console as rich_console
from rich.progress import Task, TextColumn
from rich.table import Table as TextTable
from rich.text import Text

from impact_rig.system.escapes import visible

__all__ = ["Console", "TextTable", "Words", "tell_program"]


class Console(rich_console.Console):
    """A terminal that shows every text as it is."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text as it is drawn, also in tables."""
        return super().render_str(visible(text), **{**options, "markup": False, "emoji": False})


class Words(TextColumn):
    """A column of a progress display: `str.format` with the task."""

    def render(self, task: Task) -> Text:
        """Return the text of a task."""
        return Text(visible(self.text_format.format(task=task)), style=self.style, justify=self.justify)


def tell_program(path: Path) -> None:
    """Print a path as the last line: as it is for a program that reads it, visible for people."""
    print(visible(str(path)) if sys.stdout.isatty() else path)  # noqa: T201  # a command line tool talks
