# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Output of text, tables, progress and JSON to the terminal, used by all commands.

No part of a text is interpreted as markup, emoji or control character, because names and recorded texts may contain
anything. Colours are set by `style`, never inside a text. `NO_COLOR` in the environment switches all colours off.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any  # what rich's methods take

from rich import box
from rich import console as rich_console
from rich import table as rich_table
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    Task,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.text import Text

from impact_rig.names import one_line, visible
from impact_rig.system.files import plain

LONGEST_HEADING = 11  # longest heading, in characters, above numbers that stays in one line
LONGEST_WORD = 12  # longest word, in characters, in a cell that is not split
LARGEST_WIDTH = 10_000  # largest width of a table, in characters
LONGEST_TEXT = 20_000  # longest text [characters] of one call of `print`; a longer one loses its middle
LINES = 50  # approximate number of lines of a progress report without a terminal
BYTES = re.compile("[\ud800-\udfff]")  # surrogates, by which Python represents bytes of a file name that are not UTF-8


class Console(rich_console.Console):
    """Terminal output that shows every text without markup, and escapes control characters, including line feeds.

    Args:
        quiet: whether to print nothing, because the command prints its results as JSON.
        stderr: whether to write to stderr, for progress, which must not mix with the results on stdout.
    """

    def __init__(self, *, quiet: bool = False, stderr: bool = False) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, quiet=quiet, stderr=stderr)

    def print(self, *objects: Any, **options: Any) -> None:
        """Print objects as rich does, but never crop a `TextTable`: the terminal wraps lines that are too wide."""
        whole = {"crop": False} if any(isinstance(one, TextTable) for one in objects) else {}
        super().print(*objects, **{**whole, **options})

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a text as rich draws it with `options`, but without markup, and with control characters escaped.

        A text longer than `LONGEST_TEXT` loses its middle. Rich calls this method.
        """
        return super().render_str(one_line(text, LONGEST_TEXT), **{**options, "markup": False, "emoji": False})


class TextTable(rich_table.Table):
    """Table for a terminal of 80 columns, with units below their names.

    Texts may be wrapped, but numbers and units are never truncated. The arguments `left`, `right` and `last` are
    headings of columns, in this order: texts, right-aligned numbers, further texts.
    """

    def __init__(
        self,
        title: str | None = None,
        caption: str | None = None,
        *,
        left: Sequence[str] = (),
        right: Sequence[str] = (),
        last: Sequence[str] = (),
    ) -> None:
        super().__init__(title=title, caption=caption, box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
        self.title_justify = self.caption_justify = "left"
        for headings, side in ((left, "left"), (right, "right"), (last, "left")):
            for heading in headings:
                self.add_column(heading, justify=side)

    def add_column(self, header: Any = "", *arguments: Any, **options: Any) -> None:
        """Add a column; a right-aligned column keeps its width, and any other column is wrapped if the line is full."""
        flush = options.get("justify") == "right"
        lines = [visible(line) for line in str(header).replace(" [", "\n[").split("\n")]
        if flush and max(map(len, lines)) > LONGEST_HEADING:
            lines = [word for line in lines for word in line.split()]
        widest = max((len(word) for line in lines for word in line.split()), default=0)
        keep = {"overflow": "fold", "no_wrap": flush, "min_width": widest}
        super().add_column(Text("\n".join(lines)), *arguments, **{**keep, **options})

    def __rich_console__(
        self, console: rich_console.Console, options: rich_console.ConsoleOptions
    ) -> rich_console.RenderResult:
        """Draw the table at least as wide as its numbers, and its words of up to 12 letters, need.

        On a narrow terminal, the table is then wider than the terminal.
        """
        for column in self.columns:
            if column.no_wrap:  # Rich would cut off the end of a cell that is wider than its column
                longest = max((len(str(cell)) for cell in column.cells), default=0)
            else:
                words = (word for cell in column.cells for word in str(cell).split())
                longest = min(LONGEST_WORD, max(map(len, words), default=0))
            column.min_width = max(column.min_width or 0, longest)
        least = self.__rich_measure__(console, options.update_width(LARGEST_WIDTH)).minimum
        return super().__rich_console__(console, options.update_width(max(options.max_width, least)))


def figure(value: float, spec: str, missing: str = "-") -> str:
    """Format a measured value with `spec`, such as `+.2f`; one that rounds to zero has no sign.

    A value that does not exist (NaN or infinite) becomes the text `missing`.
    """
    if not math.isfinite(value):
        return missing
    text = format(value, spec)
    return text if float(text) else text.lstrip("+-")


class Words(TextColumn):
    """Text column of a progress display: a template such as `{task.description}`, filled in for each task."""

    def render(self, task: Task) -> Text:
        """Return the template filled in for a task, with control characters escaped. Rich calls this method."""
        return Text(visible(self.text_format.format(task=task)), style=self.style, justify=self.justify)


class Steps:
    """Progress of counted items as lines on stderr, for use without a terminal."""

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total, self._shown = what, total, -1

    def show(self, done: int, state: str) -> None:
        """Print a line with the number of finished items and the present state, if the number has increased.

        Of many items, only every n-th gets a line, so that there are at most about 100 lines.
        """
        every = max(1, self._total // LINES)
        if done // every > self._shown // every or done == self._total > self._shown:
            self._shown = done
            text = f"{self._what} {done} of {self._total}: {state}"
            print(visible(text), file=sys.stderr, flush=True)  # noqa: T201  # a command line tool talks


class Counted(Progress):
    """Progress display of counted items: a bar on a terminal, otherwise some lines.

    Call `show` to report the progress.
    """

    def __init__(self, console: Console, what: str, total: int) -> None:
        columns = (
            Words("{task.description}"),
            BarColumn(24),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            Words("left"),
            TimeRemainingColumn(),
            Words("{task.fields[state]}"),
        )
        super().__init__(*columns, console=console, disable=not console.is_terminal)
        self.add_task(what, total=total, state="starting")
        self._steps = Steps(what, total)
        self.end = "done"  # text at the end

    def show(self, done: int, state: str) -> None:
        """Show the number of finished items and the present state."""
        self.update(self.task_ids[0], completed=done, state=state)
        if self.disable:
            self._steps.show(done, state)

    def stop(self) -> None:
        """End the display; on a terminal, the bar remains, with the text `end` as its state."""
        self.update(self.task_ids[0], state=self.end)
        super().stop()


def counted(words: Iterable[bytes]) -> str:
    """Return how often each word occurs, in alphabetical order of the words, such as `2 silence, 1 spikes`."""
    return ", ".join(f"{count} {word.decode()}" for word, count in sorted(Counter(words).items()))


def tell_json(content: object) -> None:
    """Print results as JSON; numbers that do not exist (NaN or infinite) become null."""
    text = json.dumps(plain(content), indent=2, ensure_ascii=False)
    text = BYTES.sub(lambda byte: f"\\u{ord(byte[0]):04x}", text)
    print(text)  # noqa: T201  # a command line tool talks


def tell_results(directory: Path, content: Mapping[str, object], *, as_json: bool) -> None:
    """Print the directory of the results as the last line, or with `as_json` the results and the directory as JSON."""
    if as_json:
        tell_json({"directory": str(directory), **content})
    else:
        tell_program(directory)


def tell_program(path: Path) -> None:
    """Print a path as the last line: unchanged for a program, but with control characters escaped on a terminal."""
    print(visible(str(path)) if sys.stdout.isatty() else path)  # noqa: T201  # a command line tool talks
