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
"""Names from outside as data: what a study, run, channel, note, node or column is called commands nothing.

Such a name comes from a file, the network or another program and may hold anything. Each place that it is written to
has one function here; HTML is escaped by the template engine of `report.page`.

| place | function |
|---|---|
| file name | `file_name`; `FILE_NAME` is the pattern of names that are refused instead |
| identifier in HTML | `identifier` |
| text of a drawing | `plot_text`, applied to every text of a figure by `drawing` |
| cell of a CSV file | `csv_cell` |
| log line, error, diagnostics | `one_line`; a quoted value: `quoted` |
| terminal | `visible`, applied to every text by `cli.terminal` |
"""

from __future__ import annotations

import hashlib
import re

FILE_NAME = r"\w[\w .+=,@()-]{0,150}"
"""Pattern of a name that is one file name everywhere: no separator, no leading point, nothing invisible."""
FILE_NAME_MEANS = "a file name: letters, digits, blanks and . + = , @ ( ) _ -, first a letter, a digit or _"
LONGEST_FILE_NAME = (
    100  # characters: with the suffix of a file, also of a temporary one, far from the limit of 255 bytes
)
LONGEST_LINE = 2000  # characters of a log line or an error
LONGEST_QUOTE = 200  # characters of a value that an error quotes
FIGURE_FORMATS = ("png", "svg", "pdf")  # suffixes of files with figures
LONGEST_TITLE, LONGEST_LABEL = 200, 50  # characters of a text in a drawing, and of one at an axis or in a legend
LARGEST_INTEGER = 10**30  # no configuration holds as large a one, and Python refuses to write out some of them
DIGEST = 8  # hexadecimal digits that tell names apart that became one

_SYMBOLS = re.compile(r"(?:[A-Za-z](?:_[A-Za-z0-9])?|[0-9|/+, ]|\\ )+")
_DOLLAR = re.compile(r"(?<!\\)\$")
_FORMULA = re.compile(r"(?:^|(?<=[;\t\r\n]))(?=\s*[=+\-@\uff1d\uff0b\uff0d\uff20])")


def visible(text: str, *, lines: bool = False) -> str:
    r"""Return a text with everything that would command a terminal written as an escape, ESC as `\x1b`.

    Args:
        text: from anywhere: files, their names, the network.
        lines: leave line ends as they are.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else c.encode("unicode_escape").decode() for c in text)


def one_line(text: str, limit: int = LONGEST_LINE, *, lines: bool = False) -> str:
    """Return a text as a log line: visible characters only, at most about `limit` of them.

    Args:
        text: from anywhere.
        limit: characters that are kept of a longer text, half of them from its end.
        lines: leave line ends as they are.
    """
    if len(text) > limit:
        half = limit // 2
        text = f"{text[:half]} … ({len(text)} characters) … {text[-half:]}"
    return visible(text, lines=lines)


def quoted(value: object) -> str:
    """Return a value as an error quotes it: as Python writes it, numbers of NumPy like any others, shortened."""
    if isinstance(value, int) and abs(value) >= LARGEST_INTEGER:
        return "a number too large to represent"
    shown = repr(_plain(value))
    return shown if len(shown) <= LONGEST_QUOTE else f"{shown[:LONGEST_QUOTE]}..."


def _plain(value: object) -> object:
    """Return what NumPy holds as the value of Python that it stands for."""
    if isinstance(value, (list, tuple)) and type(value) in (list, tuple):
        return type(value)(map(_plain, value))
    convert = getattr(value, "item", None) if getattr(value, "shape", None) == () else None
    return value if convert is None else convert()


def file_name(text: str) -> str:
    """Return a file name for a name; of a name that is changed a digest keeps it apart from others.

    Args:
        text: any name.

    Returns:
        One component of a path: letters, digits and `._+=,-`, neither empty nor hidden.
    """
    plain = re.sub(r"[^\w.+=,-]+", "_", text).lstrip(".-")
    if plain == text and 0 < len(text) <= LONGEST_FILE_NAME and text.isascii():
        return text
    return f"{_ascii(plain)[: LONGEST_FILE_NAME - DIGEST - 1] or 'name'}-{_digest(text)}"


def identifier(text: str) -> str:
    """Return an identifier for HTML and SVG: ASCII letters, digits and `-`, first a letter."""
    plain = re.sub(r"[^A-Za-z0-9]+", "-", text).strip("-")
    if plain.replace("-", "_") == text.replace("-", "_") and plain[:1].isalpha():
        return plain
    return f"n-{plain[:LONGEST_FILE_NAME]}-{_digest(text)}"


def plot_text(text: str, limit: int = LONGEST_TITLE) -> str:
    r"""Return a text for a drawing, in which only the symbols of this project are set as formulas.

    Our own labels hold symbols such as `$x_1$`, which cannot fail. Any other dollar sign is a dollar sign.
    """
    text = visible(text if len(text) <= limit else f"{text[: limit - 1]}…", lines=True)
    parts = _DOLLAR.split(text)
    if len(parts) % 2 and all(_SYMBOLS.fullmatch(part) for part in parts[1::2]):
        return text
    return _DOLLAR.sub(r"\\$", text)


def csv_cell(value: object) -> object:
    """Return a cell for a CSV file that no spreadsheet takes for a formula: an apostrophe is put before such a text.

    Numbers stay what they are, also as texts.
    """
    if not isinstance(value, str):
        return value
    try:
        float(value)
    except ValueError:
        return _FORMULA.sub("'", value) if len(value) > 1 else value
    return value


def _ascii(text: str) -> str:
    return re.sub(r"[^\x20-\x7e]", "_", text)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:DIGEST]
