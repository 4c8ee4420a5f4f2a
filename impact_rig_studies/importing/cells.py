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
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from impact_rig.simtime import NS_PER_S
from impact_rig_studies.importing.signals import Real

_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][+-]?\d{1,4})?", re.ASCII)
_NOT_A_NUMBER = frozenset({
    "", "nan", "+nan", "-nan", "qnan", "snan", "n/a", "na", "<na>", "nat", "null", "nil", "none", "missing",
    "#n/a", "#nv", "#value!", "#div/0!", "#num!", "#wert!", "#ref!", "#bezug!", "#name?",
    "-", "--", "---", ".", "?",
    "ol", "ovl", "ovld", "ovfl", "over", "overload", "overflow", "overrange", "underflow", "under",
})  # fmt: skip
"""Cells for a missing number, in lower case: empty ones, and the output of C libraries and spreadsheets."""
_INFINITE = {
    "inf": math.inf, "+inf": math.inf, "-inf": -math.inf, "infinity": math.inf, "-infinity": -math.inf,
    "∞": math.inf, "-∞": -math.inf,
}  # fmt: skip
_MICROSOFT = re.compile(r"([+-]?)1\.(?:#(inf|[a-z]+)\d*|\$)", re.ASCII)
"""What is no number as the C library of Microsoft prints it; few digits cut the word: `1.#QO`, `1.#J`, `1.$`."""
_OTHER_NAN = re.compile(r"[+-]?nan\(\w*\)|\*+", re.ASCII)  # with a payload; a number too wide for its column
SCPI_NAN, SCPI_INFINITY = 9.91e37, 9.9e37  # of instruments (SCPI 1999.0, section 7.2.1.4 and 7.2.1.5)
_GROUPED = re.compile(r"[+-]?\d{1,3}(?:[ '.,\u00a0\u202f\u2019]\d{3})+(?:[.,]\d*)?", re.ASCII)
_SPACES = str.maketrans("", "", " '\u00a0\u202f\u2019")
LONGEST_CELL = 64


def number(cell: str, decimal: str = ".") -> float | None:
    """Return the number in a cell, NaN for a missing one, or None if the cell is not a number."""
    text = cell.strip().replace("\u2212", "-")
    if len(text) > LONGEST_CELL:
        return None
    if decimal == ",":
        if _GROUPED.fullmatch(text):
            text = text.replace(".", "")
        text = text.replace(",", ".")
    elif "," in text and _GROUPED.fullmatch(text):
        text = text.replace(",", "")
    if _NUMBER.fullmatch(text):
        value = float(text.replace("d", "e").replace("D", "e"))
        return value if abs(value) not in (SCPI_NAN, SCPI_INFINITY) else float(without_markers(np.array(value)))
    if _GROUPED.fullmatch(text):
        text = text.translate(_SPACES)
        return float(text) if _NUMBER.fullmatch(text) else None
    lower = text.lower()
    if match := _MICROSOFT.fullmatch(lower):
        return float(f"{match[1]}inf") if match[2] == "inf" else math.nan
    return math.nan if lower in _NOT_A_NUMBER or _OTHER_NAN.fullmatch(lower) else _INFINITE.get(lower)


def without_markers(values: Real) -> Real:
    """Return numbers with those that instruments print instead of none, or of one out of range, as what they mean."""
    size = np.abs(values)
    return np.where(size == SCPI_NAN, np.nan, np.where(size == SCPI_INFINITY, np.copysign(np.inf, values), values))


def half_digit(cell: str) -> float:
    """Return half of the last digit of a written number, the possible error of its rounding."""
    mantissa, _, exponent = cell.strip().lower().replace("d", "e").partition("e")
    decimals = len(mantissa) - 1 - max(mantissa.rfind("."), mantissa.rfind(",")) if re.search("[.,]", mantissa) else 0
    return float(0.5 * 10.0 ** (int(exponent or 0) - decimals))


def decimal_sign(cells: Sequence[str], delimiter: str | None) -> str:
    """Return the decimal sign of some cells: a comma if one is possible and no cell contradicts it."""
    if delimiter == "," and not any("," in cell for cell in cells):
        return "."
    for cell in cells:
        comma, point = cell.rfind(","), cell.rfind(".")
        if comma >= 0 and point >= 0 and number(cell, "," if comma > point else ".") is not None:
            return "," if comma > point else "."
    commas = any("," in cell and number(cell, ",") is not None for cell in cells)
    points = any("." in cell and _NUMBER.fullmatch(cell.strip()) for cell in cells)
    return "," if commas and not points else "."


_CLOCK = r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,:](\d{1,12}))?)?\s*(?:([AaPp])\.?[Mm]\.?)?\s*(Z|[+-]\d{2}:?\d{2})?"
_MINUTES = re.compile(r"(\d{1,3}):(\d{2})[.,](\d{1,9})", re.ASCII)
_ONLY_CLOCK = re.compile(_CLOCK, re.ASCII)
_YEAR_FIRST = re.compile(rf"(\d{{4}})[-/.](\d{{1,2}})[-/.](\d{{1,2}})(?:[T ,;]\s*{_CLOCK})?", re.ASCII)
_YEAR_LAST = re.compile(rf"(\d{{1,2}})([-/.])(\d{{1,2}})[-/.](\d{{4}}|\d{{2}})(?:[T ,;]\s*{_CLOCK})?", re.ASCII)
_DAYS_OFF = re.compile(r"(\d{1,6}) days?,? \+?(.*)", re.ASCII)  # as pandas prints a duration
_COMPACT = re.compile(r"(\d{4})(\d\d)(\d\d)[T_ -](\d\d)(\d\d)(\d\d)(.*)", re.ASCII)
_DAY_NAMED_MONTH = re.compile(r"(\d{1,2})[-./ ]{1,2}([A-Za-zä]{3,9})[-./, ]{1,2}(\d{4}|\d\d)\b(.*)")
_NAMED_MONTH_DAY = re.compile(r"([A-Za-zä]{3,9})[. ]{1,2}(\d{1,2}),? (\d{4})\b(.*)")
_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "mrz": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8,
    "sep": 9, "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
"""Months by their first three letters, English and German."""
_UTC = re.compile(r"\s*(?:UTC|GMT)$")
_DAY_NS = 86_400 * NS_PER_S
_EPOCH_DAY = dt.date(1970, 1, 1).toordinal()


def is_time(cell: str) -> bool:
    """Return whether a cell is a date, a time of day or both."""
    text = cell.strip()
    if len(text) > LONGEST_CELL:
        return False
    _, text = _plain_time(text)
    return any(pattern.fullmatch(text) for pattern in (_YEAR_FIRST, _YEAR_LAST, _ONLY_CLOCK, _MINUTES))


def _plain_time(text: str) -> tuple[int, str]:
    """Return whole days that a cell counts, and the rest with months as numbers."""
    text = _UTC.sub("Z", text)
    if match := _DAYS_OFF.fullmatch(text):
        return int(match[1]), match[2]
    if match := _COMPACT.fullmatch(text):
        return 0, f"{match[1]}-{match[2]}-{match[3]} {match[4]}:{match[5]}:{match[6]}{match[7]}"
    if match := _DAY_NAMED_MONTH.fullmatch(text):
        day, month, year, clock = match.groups()
    elif match := _NAMED_MONTH_DAY.fullmatch(text):
        month, day, year, clock = match.groups()
    else:
        return 0, text
    number = _MONTHS.get(month[:3].lower())
    year = year if len(year) == 4 else f"20{year}"
    return 0, text if number is None else f"{year}-{number}-{day}{clock}"


class Times:
    """Column of dates and times of day."""

    def __init__(self, cells: Sequence[str]) -> None:
        """Read the cells.

        Raises:
            ValueError: a cell is not a time; the message is its text.
        """
        self.has_date = self.has_clock = False
        self._month_first = self._is_month_first(cells)
        days, clocks = np.zeros(len(cells), np.int64), np.zeros(len(cells), np.int64)
        for place, cell in enumerate(cells):
            days[place], clocks[place] = self._parse(cell.strip())
        if not self.has_date:  # a clock without a date continues past midnight
            ns = days * _DAY_NS + clocks
            days += np.cumsum(np.diff(ns, prepend=ns[:1]) < -_DAY_NS // 2)
        self.ns: NDArray[np.int64] = days * _DAY_NS + clocks
        """Time since 1970 in the time zone of the file, or since the midnight before the first one; shape (n,) [ns]."""

    @property
    def note(self) -> str:
        """Assumption about the order of day and month, as text; empty if there was none."""
        return "dates were read as month/day" if self._month_first else ""

    @staticmethod
    def _is_month_first(cells: Sequence[str]) -> bool:
        """Return whether the month precedes the day: a second part above 12 shows that, else the separator decides."""
        slash = False
        for cell in cells:
            match = _YEAR_LAST.fullmatch(cell.strip())
            if match is None:
                return False
            slash |= match[2] == "/"
            if int(match[1]) > 12:
                return False
            if int(match[3]) > 12:
                return True
        return slash

    def _parse(self, text: str) -> tuple[int, int]:
        """Return days since 1970 and nanoseconds since midnight."""
        if len(text) > LONGEST_CELL:
            raise ValueError(text[:LONGEST_CELL])
        offset, text = _plain_time(text)
        days, ns = self._parse_plain(text)
        return days + offset, ns

    def _parse_plain(self, text: str) -> tuple[int, int]:
        if match := _YEAR_FIRST.fullmatch(text):
            year, month, day, clock = int(match[1]), int(match[2]), int(match[3]), match.groups()[3:]
        elif match := _YEAR_LAST.fullmatch(text):
            first, second, year, clock = int(match[1]), int(match[3]), int(match[4]), match.groups()[4:]
            month, day = (first, second) if self._month_first else (second, first)
            year += 2000 if year < 100 else 0
        elif match := _ONLY_CLOCK.fullmatch(text):
            if match := _MINUTES.fullmatch(text):
                pass
            else:
                self.has_clock = True
                return 0, self._clock(_ONLY_CLOCK.fullmatch(text).groups())  # type: ignore[union-attr]  # it matched
        elif not (match := _MINUTES.fullmatch(text)):
            raise ValueError(text)
        if match.re is _MINUTES:
            self.has_clock = True
            return 0, (60 * int(match[1]) + int(match[2])) * NS_PER_S + int(match[3].ljust(9, "0"))
        self.has_date = True
        try:
            days = dt.date(year, month, day).toordinal() - _EPOCH_DAY
        except ValueError:
            raise ValueError(text) from None
        if clock[0] is None:
            return days, 0
        self.has_clock = True
        return days, self._clock(clock)

    @staticmethod
    def _clock(parts: Sequence[str | None]) -> int:
        """Return a time of day in nanoseconds, minus its offset from UTC."""
        hour, minute, second, fraction, half, zone = parts
        hours = int(hour or 0)
        if half:
            hours = hours % 12 + (12 if half in "pP" else 0)
        ns = ((60 * hours + int(minute or 0)) * 60 + int(second or 0)) * NS_PER_S
        ns += int((fraction or "0")[:9].ljust(9, "0"))
        if zone and zone != "Z":
            offset = int(zone[1:3]) * 60 + int(zone[-2:])
            ns -= (-offset if zone[0] == "-" else offset) * 60 * NS_PER_S
        return ns
