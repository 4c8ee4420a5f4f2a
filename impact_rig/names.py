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
"""Conversion of external names to safe text: the name of a study, run, channel, node or column never acts as a command.

Such a name comes from a file, the network or another program and may contain anything. Each kind of output has one
function here; the template engine of `report.page` escapes HTML.

| output | function |
|---|---|
| file name | `file_name`; `FILE_NAME` is the pattern of names that are rejected otherwise |
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
"""Pattern of a name that is a file name on every system: no separator, no leading point, no invisible character."""
FILE_NAME_MEANS = (
    "a file name of at most 151 characters: letters, digits, blanks and . + = , @ ( ) _ -, first a letter, a digit or _"
)
LONGEST_FILE_NAME = 100
"""Maximum number of characters: with the suffix of a file, also a temporary one, far below the limit of 255 bytes."""
LONGEST_LINE = 2000  # maximum number of characters of a log line or an error
LONGEST_QUOTE = 200  # maximum number of characters of a value quoted in an error
RIG_OPTION = "--rig"  # option that selects one of several rigs of a recording
FIGURE_FORMATS = ("png", "svg", "pdf")  # suffixes of files with figures
# maximum number of characters of a text in a drawing, and of one at an axis or in a legend
LONGEST_TITLE, LONGEST_LABEL = 200, 50
TOO_LARGE = "a number too large to represent"
LARGEST_INTEGER = 10**30  # above every number in a configuration; Python refuses to print some larger ones
DIGEST = 8  # hexadecimal digits that distinguish names with the same file name

_SYMBOLS = re.compile(r"(?:[A-Za-z](?:_[A-Za-z0-9])?|[0-9|/+, ]|\\ )+")
_DOLLAR = re.compile(r"(?<!\\)\$")
_DROPPED = r"[\s\x00-\x1f\xad\u200b-\u200f\u2060\ufeff]*"  # at the begin of a cell: it has no width
_FORMULA = re.compile(rf"(?:^|(?<=[;\t\r\n]))(?={_DROPPED}[=+\-@\uff1d\uff0b\uff0d\uff20])")


def visible(text: str, *, lines: bool = False) -> str:
    r"""Return a text that shows every character: one that does not print is escaped, for example ESC as `\x1b`.

    Args:
        text: text of any origin: files, their names, the network.
        lines: whether to keep line feeds; otherwise they are escaped as well.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else c.encode("unicode_escape").decode() for c in text)


def one_line(text: str, limit: int = LONGEST_LINE, *, lines: bool = False) -> str:
    """Return a text as a log line: characters that do not print are escaped, and a long text loses its middle.

    Args:
        text: text of any origin.
        limit: number of characters, before escaping, that are kept of a longer text: half from its start and half from
            its end, with the length of the whole text in between.
        lines: whether to keep line feeds; otherwise they are escaped as well.
    """
    if len(text) > limit:
        half = limit // 2
        text = f"{text[:half]} … ({len(text)} characters) … {text[-half:]}"
    return visible(text, lines=lines)


def quoted(value: object) -> str:
    """Return a value as text for an error message: in Python's notation, cut off after 200 characters.

    NumPy numbers, also in lists or tuples, are written as plain numbers: `0.5` instead of `np.float64(0.5)`. An integer
    of magnitude 10^30 or more gives the text `a number too large to represent`.
    """
    if isinstance(value, int) and abs(value) >= LARGEST_INTEGER:
        return TOO_LARGE
    try:
        shown = repr(_plain(value))
    except ValueError:  # an integer of more digits than Python prints
        return TOO_LARGE
    return shown if len(shown) <= LONGEST_QUOTE else f"{shown[:LONGEST_QUOTE]}..."


def yaml_quoted(value: object) -> str:
    """Return a value of a YAML file as text for an error message: `nothing`, `true` or `false`, else as `quoted`."""
    if value is None:
        return "nothing"
    return str(value).lower() if isinstance(value, bool) else quoted(value)


def _plain(value: object) -> object:
    """Convert NumPy scalars, also in nested lists or tuples, to Python values; return any other value unchanged."""
    if isinstance(value, (list, tuple)) and type(value) in (list, tuple):
        return type(value)(map(_plain, value))
    convert = getattr(value, "item", None) if getattr(value, "shape", None) == () else None
    return value if convert is None else convert()


def file_name(text: str) -> str:
    """Return a safe file name for any name.

    Args:
        text: any name.

    Returns:
        One component of a path: 1 to 100 ASCII letters, digits and `._+=,-`, without a leading point or hyphen. A
        name that already has this form is returned unchanged. In any other, `_` replaces other characters, and a digest
        of `text` is appended, so that different names stay different.
    """
    plain = re.sub(r"[^\w.+=,-]+", "_", text).lstrip(".-")
    if plain == text and 0 < len(text) <= LONGEST_FILE_NAME and text.isascii():
        return text
    plain = re.sub(r"[^\x20-\x7e]", "_", plain)[: LONGEST_FILE_NAME - DIGEST - 1]
    return f"{plain or 'name'}-{_digest(text)}"


def identifier(text: str) -> str:
    """Return an identifier for HTML and SVG, derived from any text: ASCII letters, digits, `_` and `-`, first a letter.

    A text of ASCII letters, digits, `_` and single `-` between them that begins with a letter is returned unchanged.
    Any other text gets the prefix `n-` and a digest at its end, so that different texts stay different.
    """
    plain = re.sub(r"[^A-Za-z0-9_]+", "-", text).strip("-")
    if plain == text and plain[:1].isalpha():
        return plain
    return f"n-{plain[:LONGEST_FILE_NAME]}-{_digest(text)}"


def plot_text(text: str, limit: int = LONGEST_TITLE) -> str:
    r"""Return a text that matplotlib draws literally, except for simple symbols such as `$x_1$`.

    The text is cut to `limit` characters. Its dollar signs are escaped unless all of them enclose simple symbols.
    Characters that do not print, except line feeds, are escaped as well.
    """
    text = visible(text if len(text) <= limit else f"{text[: limit - 1]}…", lines=True)
    parts = _DOLLAR.split(text)
    if len(parts) % 2 and all(_SYMBOLS.fullmatch(part) for part in parts[1::2]):
        return text
    return _DOLLAR.sub(r"\\$", text)


def csv_cell(value: object) -> object:
    """Return the content of a CSV cell, with an apostrophe before a text that a spreadsheet would run as a formula.

    The apostrophe is also inserted into a text after a `;`, tab or line end, if the part that follows begins like a
    formula. Numbers, texts that are numbers, and single characters stay unchanged.
    """
    if not isinstance(value, str):
        return value
    try:
        float(value)
    except ValueError:
        return _FORMULA.sub("'", value) if len(value) > 1 else value
    return value


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:DIGEST]
