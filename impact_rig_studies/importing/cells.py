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
"""Numbers and times in the cells of a text table, in the notations of any locale."""

from __future__ import annotations

import datetime as dt
import math
import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from impact_rig.simtime import NS_PER_S
from impact_rig_studies.importing.signals import Real

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,4})?", re.ASCII)
_NOT_A_NUMBER = frozenset({
    "", "qnan", "snan", "n/a", "na", "<na>", "nat", "null", "nil", "none", "missing",
    "#n/a", "#nv", "#value!", "#div/0!", "#num!", "#wert!", "#ref!", "#bezug!", "#name?",
    "-", "--", "---", ".", "?",
    "ol", "ovl", "ovld", "ovfl", "over", "overload", "overflow", "overrange", "underflow", "under",
})  # fmt: skip
"""Texts of cells that mean a missing number, in lower case: empty ones, and output of libraries or instruments."""
_INFINITE = re.compile(r"([+-]?)(?:inf(?:inity)?|∞|1\.#inf\d*)", re.ASCII)
_OTHER_NAN = re.compile(r"[+-]?(?:nan(?:\(\w*\))?|1\.(?:#[a-z]+\d*|\$))|\*+", re.ASCII)
"""Pattern of further texts for a missing number: NaN with a payload, `***`, and Microsoft's `1.#QNAN` and `1.$`."""
SCPI_NAN, SCPI_INFINITY = 9.91e37, 9.9e37  # of instruments (SCPI 1999.0, section 7.2.1.4 and 7.2.1.5)
_GROUPED = {
    decimal: re.compile(
        rf"[+-]?[1-9]\d{{0,2}}(?P<sign>[ '\u00a0\u202f\u2019{other}])\d{{3}}(?:(?P=sign)\d{{3}})*"
        rf"(?P<rest>[{decimal}]\d*)?",
        re.ASCII,
    )
    for decimal, other in ((".", ","), (",", "."))
}
"""Pattern of numbers whose digits are in groups of three, such as `1,234.5` or `1 234,5`, by decimal sign."""
_UNCLEAR = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}", re.ASCII)  # 1,234 or 1.234: of either decimal sign
_WHOLE = re.compile(r"[+-]?\d+", re.ASCII)
DIGITS_IN_GROUP = 3
LONGEST_CELL = 64
_PLAIN = re.compile(
    rf"(?:(?=[^\n]{{1,{LONGEST_CELL}}}\n)[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{{1,4}})?\n)+", re.ASCII
)
"""Pattern of lines that each contain a number without groups of digits, which Python's `float` reads."""


def number(cell: str, decimal: str = ".") -> float | None:
    """Return the number in a cell, NaN for a missing number (such as `n/a`), or None for any other content.

    `decimal` is the decimal sign, `.` or `,`. The number may be infinite, and its digits may be in groups of three. A
    cell of more than `LONGEST_CELL` characters gives None.
    """
    text = cell.strip().replace("\u2212", "-")
    if len(text) > LONGEST_CELL:
        return None
    if match := _GROUPED[decimal].fullmatch(text):
        text = text.replace(match["sign"], "")
    if decimal == ",":
        text = text.replace(",", ".")
    if _NUMBER.fullmatch(text):
        value = float(text.replace("d", "e").replace("D", "e"))
        return value if abs(value) not in (SCPI_NAN, SCPI_INFINITY) else float(without_markers(np.array(value)))
    lower = text.lower()
    if match := _INFINITE.fullmatch(lower):
        return float(f"{match[1]}inf")
    return math.nan if lower in _NOT_A_NUMBER or _OTHER_NAN.fullmatch(lower) else None


def plain_numbers(column: Sequence[str]) -> Real | None:
    """Return the numbers in cells at once, or None if `number` must read them one by one.

    The decimal sign is a point. The result is None unless every cell is a finite number without groups of digits.
    """
    lines = "\n".join([*column, ""])
    if lines.count("\n") != len(column) or not _PLAIN.fullmatch(lines):
        return None
    return without_markers(np.array([float(cell) for cell in column]))


def is_unclear(cell: str) -> bool:
    """Return whether the number in a cell depends on the decimal sign, as in `1,234` or `1.234`.

    With a comma as decimal sign, `1,234` is 1.234. With a point as decimal sign, it is 1234.
    """
    return _UNCLEAR.fullmatch(cell.strip()) is not None


def without_markers(values: Real) -> Real:
    """Return a copy of numbers with the SCPI markers replaced: ±9.91e37 by NaN, ±9.9e37 by ±infinity."""
    size = np.abs(values)
    return np.where(size == SCPI_NAN, np.nan, np.where(size == SCPI_INFINITY, np.copysign(np.inf, values), values))


def half_digit(cell: str) -> float:
    """Return half of the last digit of a written number, such as 0.005 for `1.25`: its largest possible rounding error.

    The cell must contain a number; this is not checked.
    """
    mantissa, _, exponent = cell.strip().lower().replace("d", "e").partition("e")
    decimals = len(mantissa) - 1 - max(mantissa.rfind("."), mantissa.rfind(",")) if re.search("[.,]", mantissa) else 0
    return float(0.5 * 10.0 ** (int(exponent or 0) - decimals))


def decimal_sign(columns: Sequence[Sequence[str]], delimiter: str | None) -> tuple[str, bool]:
    """Return the decimal sign of a table, `.` or `,`, and whether its cells are evidence of this sign.

    Cells such as `0,5` or `1.234,5` are evidence. A cell such as `1,234` is evidence only if the same column contains
    whole numbers. If a whole number is above 999, digits are not grouped, so the comma is the decimal sign. Otherwise
    the comma separates groups of digits. If commas separate the cells and no cell contains a comma, this is evidence of
    a point. Contradictory evidence also counts as evidence of a point. Without evidence the sign is a comma if numbers
    contain commas and no points, else a point.

    Args:
        columns: cells of each column.
        delimiter: character between cells, None for blanks.
    """
    if delimiter == "," and not any("," in cell for column in columns for cell in column):
        return ".", True
    proofs: set[str] = set()
    guesses: set[str] = set()
    seen: set[str] = set()
    for column in columns:
        unclear: set[str] = set()
        whole: list[int] = []
        for cell in column:
            text = cell.strip()
            seen.update(sign for sign in ".," if sign in text and _is_finite(number(text, sign)))
            if match := _UNCLEAR.fullmatch(text):
                unclear.add(match[1])
            elif _WHOLE.fullmatch(text):
                whole.append(len(text.lstrip("+-")))
            else:
                proofs.update(sign for sign in ".," if _proves(text, sign))
        if len(unclear) == 1 and whole:
            (sign,) = unclear
            guesses.add(sign if max(whole) > DIGITS_IN_GROUP else "." if sign == "," else ",")
    for found in (proofs, guesses):
        if found:
            return ("," if found == {","} else "."), True
    return ("," if seen == {","} else "."), False


def _proves(text: str, decimal: str) -> bool:
    """Return whether a cell is a number with the given decimal sign, and not with the other decimal sign.

    The result is wrong for cells such as `1,234`, which the caller must exclude (`is_unclear`).
    """
    match = _GROUPED[decimal].fullmatch(text)
    if match:
        return bool(match["rest"]) or (match["sign"] in ".," and text.count(match["sign"]) > 1)
    return text.count(decimal) == 1 and _is_finite(number(text, decimal))


def _is_finite(value: float | None) -> bool:
    return value is not None and math.isfinite(value)


_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "mrz": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8,
    "sep": 9, "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
"""Number of a month by the first three letters of its name, in English and German."""
_FRACTION = r"(?:[.,:](?P<fraction>\d{1,12}))?"
_END = r" ?(?:(?P<half>[AaPp])\.?[Mm]\.?)? ?(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2})?"
_CLOCK = rf"(?P<hour>\d{{1,2}}):(?P<minute>\d{{2}})(?::(?P<second>\d{{2}}){_FRACTION})?{_END}"
_LATER = rf"(?:[T ,;] ?{_CLOCK})?"
_DAYS = r"(?:(?P<days>\d{1,6}) days?,? \+?)?"  # as pandas and Python print a duration
_NAME = rf"(?i:(?P<name>{'|'.join(_MONTHS)})[a-zä]{{0,6}})"
_DAY_MONTH_YEAR = re.compile(
    r"(?P<day>\d{1,2})(?P<separator>[-/.])(?P<month>\d{1,2})[-/.](?P<year>\d{4}|\d{2})" + _LATER, re.ASCII
)
_TIMES = (
    re.compile(r"(?P<year>\d{4})[-/.](?P<month>\d{1,2})[-/.](?P<day>\d{1,2})" + _LATER, re.ASCII),
    _DAY_MONTH_YEAR,
    re.compile(_DAYS + _CLOCK, re.ASCII),
    re.compile(_DAYS + r"(?P<minute>\d{1,3}):(?P<second>\d{2})[.,](?P<fraction>\d{1,9})", re.ASCII),
    re.compile(
        r"(?P<year>\d{4})(?P<month>\d\d)(?P<day>\d\d)[T_ -](?P<hour>\d\d)(?P<minute>\d\d)(?P<second>\d\d)"
        + _FRACTION
        + _END,
        re.ASCII,
    ),
    re.compile(r"(?P<day>\d{1,2})[-./ ]{1,2}" + _NAME + r"[-./, ]{1,2}(?P<year>\d{4}|\d{2})" + _LATER, re.ASCII),
    re.compile(_NAME + r"[. ]{1,2}(?P<day>\d{1,2}),? (?P<year>\d{4})" + _LATER, re.ASCII),
)
"""Patterns of the notations of dates, times of day, durations, and dates with a time of day."""
_DAY_NS = 86_400 * NS_PER_S
_EPOCH_DAY = dt.date(1970, 1, 1).toordinal()


def is_time(cell: str) -> bool:
    """Return whether a cell is a date, a time of day, both, or a duration."""
    return _time(cell) is not None


def _time(cell: str) -> re.Match[str] | None:
    text = " ".join(cell[: LONGEST_CELL + 1].split()) if len(cell.strip()) <= LONGEST_CELL else ""
    return next(filter(None, (notation.fullmatch(text) for notation in _TIMES)), None)


class Times:
    """Column of dates, times of day or durations, converted to nanoseconds (`ns`).

    `has_date` is True if a cell contains a date. `has_clock` is True if a cell contains a time of day or a duration.
    """

    def __init__(self, cells: Sequence[str]) -> None:
        """Convert the cells of a column.

        Raises:
            ValueError: a cell is not a time, or its date does not exist. The message is the text of the cell. For a
                date such as 31/2/2026 it also states the order of day and month in which the column is read.
        """
        self.has_date = self.has_clock = False
        self._month_first = self._is_month_first(cells)
        days, clocks = np.zeros(len(cells), np.int64), np.zeros(len(cells), np.int64)
        for place, cell in enumerate(cells):
            days[place], clocks[place] = self._parse(cell)
        if not self.has_date:  # a clock without a date continues past midnight
            ns = days * _DAY_NS + clocks
            days += np.cumsum(np.diff(ns, prepend=ns[:1]) < -_DAY_NS // 2)
        self.ns: NDArray[np.int64] = days * _DAY_NS + clocks
        """Time of each cell, shape (n,) [ns]: a duration, or the time of day since the midnight before the first cell.

        Dates count from 1970, in UTC if the cells state their offset from it, else in the time zone of the file.
        """

    @property
    def note(self) -> str:
        """Note for the user that dates were read with the month first, as in 3/14/2026; empty if they were not."""
        return "dates were read as month/day/year" if self._month_first else ""

    @staticmethod
    def _is_month_first(cells: Sequence[str]) -> bool:
        """Return whether dates such as 3/4/2026 begin with the month.

        The first date with a number above 12 decides: the month is first if the second number is above 12. A cell in
        another notation before this date means that the month is not first. Without a decision, dates with slashes
        begin with the month, as in the USA.
        """
        slash = False
        for cell in cells:
            match = _time(cell)
            if match is None or match.re is not _DAY_MONTH_YEAR:
                return False
            slash |= match["separator"] == "/"
            if int(match["day"]) > 12:
                return False
            if int(match["month"]) > 12:
                return True
        return slash

    def _parse(self, cell: str) -> tuple[int, int]:
        """Return days and nanoseconds of the time in a cell.

        For a date, days count from 1970, and nanoseconds from midnight. For a duration, the nanoseconds are those
        beyond its whole days. A time of day has 0 days.

        Raises:
            ValueError: the cell is not a time, or its date does not exist.
        """
        match = _time(cell)
        if match is None:
            raise ValueError(cell.strip()[:LONGEST_CELL])
        parts = match.groupdict("")
        self.has_clock |= bool(parts["minute"])
        if "year" not in parts:
            return int(parts.get("days") or 0), self._clock(parts)
        self.has_date = True
        year, day = int(parts["year"]), int(parts["day"])
        month = _MONTHS[parts["name"].lower()] if "name" in parts else int(parts["month"])
        if self._month_first:
            day, month = month, day
        try:
            date = dt.date(year + 2000 if year < 100 else year, month, day)
        except ValueError:
            order = "month/day/year" if self._month_first else "day/month/year"
            text = f"{cell.strip()}, read as {order} like the others" if match.re is _DAY_MONTH_YEAR else cell.strip()
            raise ValueError(text) from None
        return date.toordinal() - _EPOCH_DAY, self._clock(parts)

    @staticmethod
    def _clock(parts: Mapping[str, str]) -> int:
        """Return the time of day in the parts of a cell [ns since midnight], in UTC if the cell states its offset."""
        hours, minutes, seconds = (int(parts.get(unit) or 0) for unit in ("hour", "minute", "second"))
        half, zone = parts.get("half"), parts.get("zone", "").lstrip("ZUTCGM")
        if half:
            hours = hours % 12 + (12 if half in "pP" else 0)
        ns = ((60 * hours + minutes) * 60 + seconds) * NS_PER_S + int(parts["fraction"][:9].ljust(9, "0"))
        if zone:
            offset = int(zone[1:3]) * 60 + int(zone[-2:])
            ns -= (-offset if zone[0] == "-" else offset) * 60 * NS_PER_S
        return ns
