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
"""Reader of text tables of any locale, which detects separator, decimal sign, code page, headings, units and times."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import RecordingError
from impact_rig_studies.importing import cells, headings
from impact_rig_studies.importing.columns import signals_of
from impact_rig_studies.importing.encodings import decode, split_lines
from impact_rig_studies.importing.limits import check_column_count, check_value_count
from impact_rig_studies.importing.readers import labview
from impact_rig_studies.importing.signals import ImportedSignals, UniqueNames

HEADER_LINES = 200  # largest number of lines before the first row of numbers
TRAILING_LINES = 20  # largest number of lines after the last row of numbers
SAMPLED_LINES = 40
MOST_LINES = 100_000  # largest number of lines that are searched for a decimal sign
DELIMITERS = ("\t", ";", ",", "|", None)  # None: blanks
CHUNK_CELLS = 200_000
COMMENTS = ("#", "%", "//", "!")
WHOLE = 2**53  # up to which integers are exact in a double
LONGEST_QUOTED = 100_000  # longest line, in characters, in which quotes have a meaning
SHOWN = 40  # characters of a cell shown in a message
_BEFORE_UNIT = re.compile(r"\s+(?=[\[(])")
_WIDE = re.compile(r"\t|\s{2,}")
_QUOTED = re.compile(r'"[^"]*"|\S+')


@attrs.frozen
class Layout:
    """Structure of a text table as detected in its lines; lines and columns count from 0."""

    delimiter: str | None  # None: blanks
    decimal: str  # `.` or `,`
    width: int  # number of cells in a row
    first: int  # line of the first row of numbers
    words: frozenset[int] = frozenset()  # columns of words
    # columns that are empty in the lines used for detection: of remarks, or after a separator at the end of each row
    empty: frozenset[int] = frozenset()


def read(path: Path, content: bytes) -> ImportedSignals:
    """Read the columns of a text table as signals.

    A LabVIEW measurement file is recognised by its content and read as such.

    Raises:
        RecordingError: more than `HEADER_LINES` lines are before the first row of numbers, there is no such row, or a
            later row does not fit the first one.
        BudgetError: the table has more values than a file of this size may contain, or too many columns.
    """
    text, encoding = decode(content)
    lines = split_lines(text)
    if labview.is_labview(lines):
        return labview.read_lines(path, lines)
    layout = find_layout(lines)
    if layout is None:
        raise RecordingError(
            f"{path}: none of its first {min(len(lines), HEADER_LINES + 1)} lines is a row of numbers"
            f"{_seen_instead(lines)}; export a table of numbers"
            f"{' with less text before it' if len(lines) > HEADER_LINES + 1 else ''}"
        )
    names, units, others = _headings(lines[: layout.first], layout)
    end = _end(lines, layout)
    trailing = [line for line in lines[end:] if line.strip()]
    check_value_count(float(end - layout.first) * layout.width, len(content))
    columns, skipped = read_rows(path, lines, layout, layout.first, end)
    named = {}
    for name, column in zip(names, columns, strict=True):
        is_empty = column.dtype.kind == "f" and bool(np.all(np.isnan(column)))
        if not (is_empty and name.startswith("column_")):  # a separator at the end of each row
            named[name] = column
    left_out = {f"line {end + 1} and after": f"no row of numbers: {trailing[0].strip()[:SHOWN]!r}"} if trailing else {}
    left_out |= {f"line {number + 1}": "a comment" for number in skipped[:TRAILING_LINES]}
    early = [number for number, line in enumerate(lines[: layout.first]) if _is_other_row(line, layout)]
    if early:
        left_out[f"line {early[0] + 1} to {early[-1] + 1}"] = f"numbers, but not in {layout.width} cells as the table"
    remarks = () if encoding.startswith("utf") else (f"the text was read as code page {encoding}",)
    stated = headings.stated_rate([*others, *trailing], layout.decimal, layout.delimiter)
    return signals_of(path, "text table", named, units, stated.hz, remarks, left_out, stated.note)


def find_layout(lines: Sequence[str]) -> Layout | None:
    """Return the structure that the lines of a text table most likely have.

    The result is None if no row of numbers is found after at most `HEADER_LINES` other lines.
    """
    sample = _sample(lines)
    best: tuple[int, int, int] = (0, 0, 0)
    layout: Layout | None = None
    for preference, delimiter in enumerate(DELIMITERS):
        if delimiter is None and layout is not None and layout.width > 1:
            break  # blanks separate only if nothing else does: times contain them, too
        rows = [split(line, delimiter) for line in sample]
        if not rows:
            return None
        width, _ = Counter(map(len, rows)).most_common(1)[0]
        fitting = [row for row in rows if len(row) == width]
        numeric = [sum(_is_value(cell) for cell in column) for column in zip(*fitting, strict=True)]
        filled = [sum(bool(cell.strip()) for cell in column) for column in zip(*fitting, strict=True)]
        words = frozenset(j for j in range(width) if filled[j] and numeric[j] <= 0.5 * len(fitting))
        if len(words) == width or not any(numeric[j] and filled[j] for j in range(width) if j not in words):
            continue
        rank = (len(fitting) * (width - len(words)) if width > 1 else 1, -len(words), -preference)
        if rank > best:
            empty = frozenset(j for j in range(width) if not filled[j])
            best, layout = rank, Layout(delimiter, ".", width, 0, words, empty)
    if layout is None:
        return None
    for some in (sample, lines[:: max(1, len(lines) // MOST_LINES)]):  # few numbers may have groups of digits
        rows = [split(line, layout.delimiter) for line in some if not line.startswith(COMMENTS)]
        fitting = [row for row in rows if len(row) == layout.width]
        decimal, is_proven = cells.decimal_sign(list(zip(*fitting, strict=True)), layout.delimiter)
        layout = attrs.evolve(layout, decimal=decimal)
        if is_proven:
            break
    for number, line in enumerate(lines[: HEADER_LINES + 1]):
        if is_row(line, layout):
            return attrs.evolve(layout, first=number)
    return None


def _seen_instead(lines: Sequence[str]) -> str:
    """Return the end of the message that no row of numbers was found: it quotes a line of the file's second half.

    If this line is a row of numbers, the message also states that the first lines do not have its form.
    """
    sample = _sample(lines)
    if len(lines) <= 1 or not sample:
        return ""
    text = sample[len(sample) // 2]
    place = f"line {lines.index(text) + 1}"
    is_row = any(len(row := split(text, one)) > 1 and all(map(_is_value, row)) for one in DELIMITERS)
    return f"{f' that has the form of its {place}' if is_row else f'; {place} is'}: {text.strip()[:SHOWN]!r}"


def _sample(lines: Sequence[str]) -> list[str]:
    """Return up to `SAMPLED_LINES` lines spread over a file's second half, where headings are unlikely.

    Empty lines and comments are not returned.
    """
    usable = [number for number in range(len(lines) // 2, len(lines)) if lines[number].strip()]
    usable = usable[: max(1, len(usable) - len(usable) // 20)]
    picked = usable[:: max(1, len(usable) // SAMPLED_LINES)][:SAMPLED_LINES]
    return [lines[number] for number in picked if not lines[number].startswith(COMMENTS)]


def split(line: str, delimiter: str | None) -> list[str]:
    """Return the cells of a line, without blanks and double quotes around them.

    A `delimiter` of None means blanks. Delimiters within double quotes do not separate cells, except in lines of more
    than `LONGEST_QUOTED` characters.
    """
    if '"' in line and len(line) <= LONGEST_QUOTED:
        if delimiter is None:
            return [cell.strip('"') for cell in _QUOTED.findall(line)]
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [])]
    return [cell.strip() for cell in line.split(delimiter)]


def _is_value(cell: str) -> bool:
    """Return whether a cell is a number in any notation, a missing number, a time, or empty."""
    return cells.number(cell) is not None or cells.number(cell, ",") is not None or cells.is_time(cell)


def is_row(line: str, layout: Layout) -> bool:
    """Return whether a line is a row of numbers of the table.

    A row of numbers has as many cells as the layout. Each cell in a column of numbers is a number, a missing number or
    a time. At least one of them is not missing.
    """
    if not line.strip() or line.startswith(COMMENTS):
        return False
    row = split(line, layout.delimiter)
    if len(row) != layout.width:
        return False
    shown = [row[j] for j in range(layout.width) if j not in layout.words | layout.empty]
    numbers = [cells.number(cell, layout.decimal) for cell in shown]
    if any(one is None and not cells.is_time(cell) for one, cell in zip(numbers, shown, strict=True)):
        return False
    return any(one is None or not math.isnan(one) for one in numbers)


def _is_other_row(line: str, layout: Layout) -> bool:
    """Return whether a line is a row of numbers with another number of cells than the layout.

    It must have at least two cells, and each of them must contain a value.
    """
    row = [] if line.startswith(COMMENTS) else split(line, layout.delimiter)
    return 1 < len(row) != layout.width and all(cell and _is_value(cell) for cell in row)


def _end(lines: Sequence[str], layout: Layout) -> int:
    """Return the index of the line after the last row of numbers.

    At most `TRAILING_LINES` filled lines at the end of the file are skipped. Further lines remain in the table, where
    `read_rows` checks them.
    """
    end = len(lines)
    for _ in range(TRAILING_LINES):
        while end > layout.first and not lines[end - 1].strip():
            end -= 1
        if end <= layout.first + 1 or is_row(lines[end - 1], layout):
            break
        end -= 1
    return end


def _headings(lines: Sequence[str], layout: Layout) -> tuple[list[str], dict[str, str], list[str]]:
    """Interpret the `lines` before the first row of numbers as headings.

    Returns:
        A unique name for each column, the units (from a row of units) by name, and all lines without names or units. A
        unit within a heading stays part of the name. A column without a heading is named `column_` and its position
        from 0. The position is also appended to a repeated name.
    """
    width = layout.width
    usable: list[tuple[int, list[str]]] = []
    for number, line in enumerate(lines):
        if not line.strip():
            continue
        row = _heading_cells(line.lstrip("#%!/").strip("\r"), layout)
        if len(row) == width and "".join(row).strip("-:=|+ "):  # a line of dashes separates
            usable.append((number, row))
    rows = usable[-3:]
    used: set[int] = set()
    names, units = [""] * width, [""] * width
    if rows:
        at = len(rows) - 1
        above = rows[at - 1][1] if at > 0 else ()
        if headings.is_units_row(rows[at][1], [name for j, name in enumerate(above) if j not in layout.empty]) and (
            at > 0 or width > 1
        ):
            units = headings.unit_cells(rows[at][1])
            used.add(rows[at][0])
            at -= 1
        if at >= 0:
            names = rows[at][1]
            used.add(rows[at][0])
            if not any(units) and at > 0 and headings.is_units_row(rows[at - 1][1]):
                units = headings.unit_cells(rows[at - 1][1])
                used.add(rows[at - 1][0])
    check_column_count(width)
    reserved = tuple({name for name in names if name})
    given: set[str] = set()
    later = UniqueNames(reserved)
    unique = []
    for j, name in enumerate(names):
        if name and name not in given:
            given.add(name)
            unique.append(name)
        else:
            unique.append(later.unique(f"{name or 'column'}_{j}"))
    others = [line for number, line in enumerate(lines) if number not in used]
    return unique, {name: unit for name, unit in zip(unique, units, strict=True) if unit}, others


def _heading_cells(line: str, layout: Layout) -> list[str]:
    """Return the cells of a line of headings.

    Unlike in rows of numbers, a cell may contain single blanks. Cells of empty columns at the end of the line may be
    missing.
    """
    width = layout.width
    row = split(line, layout.delimiter)
    if layout.delimiter is None and len(row) != width:
        for separator in (_BEFORE_UNIT.sub("", line).split(), _WIDE.split(line.strip())):
            if len(separator) == width:
                row = separator
    if len(row) > width and not any(row[width:]):
        row = row[:width]
    if len(row) < width and all(j in layout.empty for j in range(len(row), width)):
        row += [""] * (width - len(row))
    return row


def read_rows(
    path: Path, lines: Sequence[str], layout: Layout, first: int, end: int
) -> tuple[list[NDArray[np.generic]], list[int]]:
    """Return the columns of the table in the lines first <= line < end, and the indices of lines that are comments.

    Line 0 is the first line of the file. A column contains texts if it has words or times. Otherwise it contains
    floats, NaN for a missing number. Only a complete column of integers that are too large for exact floats, such as
    stamps in nanoseconds, contains integers, if all of them are below 2^63. Empty lines are skipped.

    Raises:
        RecordingError: a row has another number of cells than the first one (surplus empty ones do not count), or a
            cell in a column of numbers is not a number; the message names the line, counted from 1. Or a column has
            numbers in one part of the table, and times in another.
    """
    step = max(1, CHUNK_CELLS // layout.width)
    parts: list[list[NDArray[np.generic]]] = [[] for _ in range(layout.width)]
    skipped: list[int] = []
    for begin in range(first, end, step):
        chunk = list(enumerate(lines[begin : min(begin + step, end)], begin))
        for part, column in zip(parts, _chunk(path, chunk, layout, skipped), strict=True):
            part.append(column)
    columns = []
    for j, part in enumerate(parts):
        if j in layout.empty:
            columns.append(_remarks(part, layout))
            continue
        if {one.dtype.kind for one in part if one.size} > {"U"}:
            raise RecordingError(
                f"{path}: column {j + 1} has numbers in some rows and times in others; write all its cells in one form"
            )
        columns.append(np.concatenate(part) if part else np.zeros(0))
    return columns, skipped


def _remarks(part: list[NDArray[np.generic]], layout: Layout) -> NDArray[np.generic]:
    """Join the parts of a mostly empty column: to numbers if all cells are numbers or empty, otherwise to texts."""
    column = np.concatenate(part).astype(str).tolist() if part else []
    values = [cells.number(cell, layout.decimal) for cell in column]
    return np.array(column if None in values else values, dtype=str if None in values else np.float64)


def _chunk(path: Path, chunk: list[tuple[int, str]], layout: Layout, skipped: list[int]) -> list[NDArray[np.generic]]:
    """Return the columns of some lines of the table.

    `chunk` contains the lines with their indices in the file. The indices of comments are added to `skipped`.

    Raises:
        RecordingError: a line has another number of cells than the layout (surplus empty ones do not count), or a cell
            in a column of numbers is not a number.
    """
    plain = [(number, line) for number, line in chunk if line.strip()]
    if not (layout.words or layout.empty) and not any('"' in line or "_" in line for _, line in plain):
        rows = [line for _, line in plain]
        if layout.decimal == ",":
            rows = [line.replace(",", ".") for line in rows] if not any("." in line for line in rows) else []
        try:
            table = np.loadtxt(rows, np.float64, comments=None, delimiter=layout.delimiter, ndmin=2) if rows else None
        except ValueError:
            table = None
        fits = table is not None and table.shape == (len(plain), layout.width)
        if table is not None and fits and not (np.abs(table) >= WHOLE).any():
            return [cells.without_markers(column) for column in np.ascontiguousarray(table.T)]
    kept: list[list[str]] = []
    numbers: list[int] = []
    for number, line in plain:
        if line.startswith(COMMENTS):
            skipped.append(number)
            continue
        row = split(line, layout.delimiter)
        if len(row) > layout.width and not any(row[layout.width :]):
            row = row[: layout.width]
        if len(row) != layout.width:
            raise RecordingError(
                f"{path}: line {number + 1} has {len(row)} cells, the first row of numbers (line {layout.first + 1}) "
                f"has {layout.width}; correct or delete this line"
            )
        kept.append(row)
        numbers.append(number)
    return [_column(path, [row[j] for row in kept], numbers, j, layout) for j in range(layout.width)]


def _column(path: Path, column: list[str], numbers: list[int], j: int, layout: Layout) -> NDArray[np.generic]:
    """Convert the cells of column j to integers, floats, or texts (for words and times).

    `numbers` contains the line index of each cell, for the message.

    Raises:
        RecordingError: a cell in a column of numbers is not a number.
    """
    if j in layout.words | layout.empty or (
        column and cells.is_time(column[0]) and cells.number(column[0], layout.decimal) is None
    ):
        return np.array(column, dtype=str) if column else np.zeros(0)
    if column and all(cell.isascii() and cell.isdigit() and len(cell) < 20 for cell in column):
        whole = [int(cell) for cell in column]
        if max(whole) >= WHOLE:
            return np.array(whole, np.int64) if max(whole) < 2**63 else np.array(whole, np.float64)
    if layout.decimal == "." and (plain := cells.plain_numbers(column)) is not None:
        return plain
    values = np.empty(len(column))
    for place, cell in enumerate(column):
        value = cells.number(cell, layout.decimal)
        if value is None:
            raise RecordingError(
                f"{path}: line {numbers[place] + 1}, column {j + 1}: {cell[:SHOWN]!r} is not a number: correct "
                "the cell, or write n/a for a missing number"
            )
        values[place] = value
    return values
