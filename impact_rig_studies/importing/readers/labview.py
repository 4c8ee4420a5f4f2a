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
"""Reader of LabVIEW measurement files (LVM): the header states separator, decimal sign, units and time step.

Format: National Instruments, "Specification for the LabVIEW Measurement File (.lvm)".
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import attrs
import numpy as np

from impact_rig.errors import RecordingError
from impact_rig_studies.importing import cells
from impact_rig_studies.importing.encodings import decode, split_lines
from impact_rig_studies.importing.limits import check_column_count, check_value_count
from impact_rig_studies.importing.signals import (
    Abscissa,
    AbscissaKind,
    ImportedSignals,
    Real,
    Signal,
    SignalKind,
    UniqueNames,
)

BEGIN, HEADER_END = "LabVIEW Measurement", "***End_of_Header***"
COMMENT, X_VALUE = "Comment", "X_Value"
CONTINUES = 0.5  # of a step: largest departure of a segment that continues the one before


@attrs.define
class _Segment:
    """Part of a LabVIEW measurement file with its own header, names of columns and rows."""

    header: dict[str, list[str]]  # values by key
    names: list[str]
    rows: list[list[str]]

    def column(self, j: int, decimal: str) -> Real:
        """Return the numbers in column j (from 0), with NaN for a cell that is missing or not a number."""
        texts = (row[j] if j < len(row) else "" for row in self.rows)
        values = (cells.number(text, decimal) for text in texts)
        return np.array([np.nan if value is None else value for value in values])

    def number(self, key: str, channel: int, decimal: str) -> float | None:
        """Return the number that the header states for a channel under a key; None if there is no number.

        Channels count from 0, and `decimal` is the decimal sign, `.` or `,`.
        """
        text = self.text(key, channel)
        return cells.number(text, decimal) if text else None

    def text(self, key: str, channel: int) -> str:
        """Return the text that the header states for a channel under a key; empty if there is none.

        Channels count from 0. Header cells of X columns are skipped.
        """
        values = self.header.get(key, [])
        if any(name.startswith(X_VALUE) for name in self.names[1:]) and not any(one.strip() for one in values[1::2]):
            values = values[::2]
        return values[channel].strip() if channel < len(values) else ""


def is_labview(lines: Sequence[str]) -> bool:
    """Return whether the lines are a LabVIEW measurement file, which the beginning of the first line shows."""
    return bool(lines) and lines[0].startswith(BEGIN)


def read(path: Path, content: bytes) -> ImportedSignals:
    """Read the columns of a LabVIEW measurement file as signals.

    Raises:
        RecordingError: the file has another format, or no rows.
        BudgetError: the file has more values than a file of its size may contain, or too many columns.
    """
    lines = split_lines(decode(content)[0])
    if not is_labview(lines):
        raise RecordingError(
            f"{path} is not a LabVIEW measurement file: its first line does not begin with {BEGIN!r}; if it is another "
            "table of text, rename it to .txt"
        )
    return read_lines(path, lines)


def read_lines(path: Path, lines: Sequence[str]) -> ImportedSignals:
    """Read the columns in the lines of a LabVIEW measurement file as signals.

    Segments that continue the first segment without a gap are joined to it. All segments from the first gap on are left
    out, with the reason for the user.

    Raises:
        RecordingError: the file has no rows.
        BudgetError: the file has more values than a file of its size may contain, or too many columns.
    """
    separator = (
        "," if any(line.startswith("Separator,") or line.lower() == "separator\tcomma" for line in lines[:40]) else "\t"
    )
    general: dict[str, str] = {}
    at = 1
    while at < len(lines) and not lines[at].startswith(HEADER_END):
        key, _, value = lines[at].partition(separator)
        general[key.strip()] = value.strip().strip(separator)
        at += 1
    decimal = "," if general.get("Decimal_Separator", ".").startswith(",") else "."
    segments, left_out = _segments(lines, at + 1, separator)
    if not segments:
        raise RecordingError(f"{path} is a LabVIEW measurement file without rows of numbers; export it again")
    joined = _joined(segments, decimal)
    for number, segment in enumerate(segments[joined:], joined + 1):
        left_out[f"segment {number}"] = f"{len(segment.rows)} rows, which do not continue the first segment"
    head = segments[0]
    has_multiple_x = general.get("X_Columns", "One").lower().startswith("multi")
    width = len(head.names)
    check_column_count(width)
    check_value_count(sum(len(one.rows) for one in segments) * width, sum(map(len, lines)))
    names = UniqueNames()
    signals: dict[str, Signal] = {}
    channel = 0
    for j, name in enumerate(head.names):
        if name == COMMENT or name.startswith(X_VALUE) or (j == 0 and not name):
            continue
        values = np.concatenate([one.column(j, decimal) for one in segments[:joined]])
        x_column = j - 1 if has_multiple_x else 0
        x = np.concatenate([one.column(x_column, decimal) for one in segments[:joined]])
        last = len(values) - int(np.argmax(np.isfinite(values[::-1]))) if np.isfinite(values).any() else 0
        values, x = values[:last], x[:last]
        abscissa = _abscissa(head, channel, x, decimal)
        kind = SignalKind.TIME_RESPONSE if abscissa.kind is not AbscissaKind.FREQUENCY else SignalKind.SPECTRUM
        unit = head.text("Y_Unit_Label", channel)
        signals[names.unique(name or f"channel_{channel}")] = Signal(values, unit, abscissa, kind, f"column {j + 1}")
        channel += 1
    return ImportedSignals(path, "LabVIEW measurement file", signals, left_out=left_out)


def _segments(lines: Sequence[str], at: int, separator: str) -> tuple[list[_Segment], dict[str, str]]:
    """Return the segments in the lines of a file from index `at` on, and the reasons for parts left out, by name.

    Segments without rows are skipped without a reason.
    """
    segments: list[_Segment] = []
    left_out: dict[str, str] = {}
    while at < len(lines):
        header: dict[str, list[str]] = {}
        while at < len(lines) and not lines[at].startswith(HEADER_END):
            key, *values = lines[at].split(separator)
            if key.startswith("***"):  # a special block, up to its own end
                name = key.strip("* ")
                left_out[name] = "a special block"
                at += 1
                while at < len(lines) and not lines[at].startswith("***End_Special***"):
                    at += 1
            elif key.strip():
                header[key.strip()] = values
            at += 1
        if at + 1 >= len(lines):
            break
        names = [cell.strip() for cell in lines[at + 1].split(separator)]
        while len(names) > 1 and not names[-1]:
            names.pop()
        at += 2
        rows = []
        while at < len(lines) and not lines[at].startswith(("Channels", HEADER_END)):
            if lines[at].strip():
                rows.append(lines[at].split(separator))
            at += 1
        if rows:
            segments.append(_Segment(header, names, rows))
    return segments, left_out


def _joined(segments: Sequence[_Segment], decimal: str) -> int:
    """Return how many of the first segments follow each other without a gap.

    These segments have the same columns. By its header, each segment begins where the segment before ends.
    """
    for number, (one, after) in enumerate(itertools.pairwise(segments), 1):
        step = one.number("Delta_X", 0, decimal)
        begin, following = one.number("X0", 0, decimal), after.number("X0", 0, decimal)
        if after.names != one.names or step is None or begin is None or following is None:
            return number
        if not abs(following - begin - len(one.rows) * step) <= CONTINUES * step:  # also if one is NaN
            return number
    return len(segments)


def _abscissa(head: _Segment, channel: int, x: Real, decimal: str) -> Abscissa:
    dimension = head.text("X_Dimension", channel) or "Time"
    kind = {"time": AbscissaKind.TIME, "frequency": AbscissaKind.FREQUENCY}.get(dimension.lower(), AbscissaKind.OTHER)
    unit = {AbscissaKind.TIME: "s", AbscissaKind.FREQUENCY: "Hz"}.get(kind, dimension)
    step, start = head.number("Delta_X", channel, decimal), head.number("X0", channel, decimal)
    listed = x - x[0] if len(x) > 1 and np.isfinite(x).all() else None
    begin = float(x[0]) if listed is not None else start if start is not None and np.isfinite(start) else 0.0
    if step is None or not step > 0.0:
        return Abscissa(kind, unit, begin, None, listed) if listed is not None else Abscissa(AbscissaKind.NONE)
    return Abscissa(kind, unit, begin, step, listed, cells.half_digit(head.text("Delta_X", channel)))
