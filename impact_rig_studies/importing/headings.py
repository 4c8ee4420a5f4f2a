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
"""Interpretation of the headings of columns: names, units, times and rates, in the notations that programs use."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Sequence
from typing import NamedTuple

from impact_rig_studies.importing.cells import is_unclear, number
from impact_rig_studies.importing.units import is_unit, quantity, unit_factor

STAMP = "stamp_ns"  # column of integers; `time` counts from it
TIME_NAMES = frozenset({
    "time", "times", "t", "zeit", "temps", "tiempo", "tempo", "abscissa", "timedomain", "timestamp", "timestamps",
    "elapsed", "elapsedtime", "reltime", "relativetime", "relativezeit", "messzeit", "xvalue", "datetime", "date",
    "datum", "uhrzeit", "zeitstempel", "seconds", "second", "sekunden", "secs", "sec", "milliseconds", "msec",
    "microseconds", "usec", "millis", "micros", "dateandtime", "timeofday", "timeaxis", "timevector", "tim",
    "datumuhrzeit", "datetimestamp", "tout", "время",
})  # fmt: skip
"""Names of columns that contain times, in lower case, letters only."""
DATE_NAMES = frozenset(
    {"date", "datum", "datetime", "dateandtime", "zeitstempel", "datumuhrzeit", "timestamp", "datetimestamp"}
)
FREQUENCY_NAMES = frozenset({"frequency", "freq", "frequenz", "frequence", "f"})
_UNIT_OF_NAME = {
    "seconds": "s", "second": "s", "sekunden": "s", "secs": "s", "sec": "s", "milliseconds": "ms", "msec": "ms",
    "microseconds": "us", "usec": "us", "millis": "ms", "micros": "us",
}  # fmt: skip
_SIGNAL_SUFFIXES = {
    "mm": "mm", "um": "um", "cm": "cm", "ms2": "m/s^2", "mps2": "m/s^2", "mmps": "mm/s", "mps": "m/s",
}  # fmt: skip
"""Units by suffix after an underscore; other suffixes may be part of a name, such as `base_m`."""
_TIME_SUFFIX = re.compile(r"(.+?)(?:_(?i:(s|ms|us|ns|sec))|(?<=[a-z])(S|Ms|Us|Ns|Sec))")
_UNIT_LABELS = frozenset({"unit", "units", "einheit", "einheiten", "unité", "unidad"})
_RUN = re.compile(r"(.{1,80}?[\])])\s{0,3}((?:run|trial|lauf|set)\s?#?\s?\d{1,3})", re.IGNORECASE)
"""Pattern of headings with the number of a run after the unit, such as `Time (s) Run #1`."""
_NOT_LETTERS = re.compile(r"[\W\d_]+")
_RATE_NAMES = frozenset({
    "fs", "sr", "rate", "samplerate", "samplingrate", "samplefrequency", "samplingfrequency", "samplefreq",
    "samplingfreq", "samplespersecond", "scanrate", "timefs", "timerate", "daqrate", "acquisitionrate", "abtastrate",
    "abtastfrequenz",
})  # fmt: skip
_PERIOD_NAMES = frozenset({
    "dt", "deltat", "deltax", "period", "step", "ts", "tsample", "sampleperiod", "samplingperiod", "sampleinterval",
    "samplinginterval", "sampletime", "timestep", "timeincrement", "timeinterval", "increment", "xincrement",
    "abtastintervall",
})  # fmt: skip
"""Names of single numbers that state a period, in lower case, letters only; `_RATE_NAMES` are those of rates."""
_UNIT_SUFFIX = re.compile(r"(.+?)_?(k?[Hh]z|(?<=_)(?:s|ms|us))")
MILLISECONDS = frozenset({"millisecond", "milliseconds", "millis", "msec", "ms", "millisekunden"})
"""Names of columns that hold the milliseconds within the whole seconds of another column."""


def bare(name: str) -> str:
    """Return only the letters of a name, in lower case, for comparison with known names."""
    return _NOT_LETTERS.sub("", name[:80].lower())


def is_time_name(name: str) -> bool:
    """Return whether a column with this name (without its unit) contains times.

    Text after ` - ` is ignored, as in `Time  1 - default sample rate`.
    """
    word = bare(name[:80].partition(" - ")[0])
    return word in TIME_NAMES or _time_suffix(name) is not None


def _time_suffix(name: str) -> str | None:
    """Return the unit at the end of a name such as `time_ms` or `timeMs`.

    It is None if the name has no unit, or is not a name of times.
    """
    match = _TIME_SUFFIX.fullmatch(name[:80].strip())
    return (match[2] or match[3]).lower() if match and bare(match[1]) in TIME_NAMES else None


def rate_hz(name: str, value: float) -> float | None:
    """Return the sampling rate [Hz] that a single number with a name such as `fs [kHz]` or `dt_ms` states.

    The result is None if the name is not that of a rate or period, its unit does not fit, or the rate or period is not
    finite and above 0.
    """
    plain, unit = split_unit(name)
    match = _UNIT_SUFFIX.fullmatch(plain[:80])
    if match and not unit:
        plain, unit = match[1], match[2]
    word = bare(plain)
    wanted = "Hz" if word in _RATE_NAMES else "s" if word in _PERIOD_NAMES else None
    if wanted is None or (unit and quantity(unit) != wanted):
        return None
    value *= unit_factor(unit, wanted) or 1.0 if unit else 1.0
    if not (math.isfinite(value) and value > 0.0):
        return None
    return value if wanted == "Hz" else 1.0 / value


def time_unit(name: str, unit: str) -> str:
    """Return the unit of a column of times: `unit` if it is not empty, else the unit that the column's name implies.

    A name implies a unit by a suffix (`time_ms`) or as a word (`seconds`). The result is empty if no unit is known.
    """
    suffix = _time_suffix(name)
    return unit or _UNIT_OF_NAME.get(suffix or bare(name), suffix or "")


def split_unit(heading: str) -> tuple[str, str]:
    """Return name and unit of a heading such as `base [mm]`, `acc (m/(s^2))`, `Weg / mm`, `Weg in mm`, `x_mm`.

    The unit is empty if there is none. Units after an underscore count only if they are in `_SIGNAL_SUFFIXES`. They
    also remain part of the name: `x_mm` gives `x_mm` and `mm`.
    """
    text = heading.strip()
    run = _RUN.fullmatch(text[:120])
    name, unit = _bracketed(run[1] if run else text)
    if unit:
        return f"{name} {run[2]}" if run else name, unit
    if text.startswith("in ") and quantity(text[3:]) == "s":  # of oscilloscopes: `in s`, `CH1 in V`
        return text, text[3:].strip()
    for separator in ("/", " in ", ",", " "):
        head, found, tail = text.rpartition(separator)
        short = len(tail.strip()) == 1  # a letter may be part of a name: x/s
        if (
            found
            and head.strip()
            and is_unit(tail)
            and not (short and separator in ("/", " ") and head == head.strip())
        ):
            return head.strip(), tail.strip()
    _, underscore, tail = text.rpartition("_")
    if underscore and tail in _SIGNAL_SUFFIXES:
        return text, _SIGNAL_SUFFIXES[tail]
    return text, ""


def _bracketed(text: str) -> tuple[str, str]:
    """Return name and unit of a heading that ends with a unit in brackets; without brackets the unit is empty."""
    if not text.endswith(("]", ")")):
        return text, ""
    opened, closed = ("[", "]") if text.endswith("]") else ("(", ")")
    depth = 0
    for place in range(len(text) - 1, max(-1, len(text) - 80), -1):
        depth += (text[place] == closed) - (text[place] == opened)
        if depth == 0:
            name, unit = text[:place].strip(), text[place + 1 : -1].strip()
            return (name, unit) if name else (text, "")
    return text, ""


def is_units_row(cells: Sequence[str], above: Sequence[str] = ()) -> bool:
    """Return whether a row of a table's heading contains units.

    A row contains units if its first cell is a label such as `units`, or if every filled cell is a unit. If the row
    `above` is complete and begins with a name of times or frequencies, a filled first cell decides alone: it must be a
    unit of time or frequency.
    """
    filled = [cell for cell in cells if cell.strip()]
    if filled and cells[0].strip().strip(":").lower() in _UNIT_LABELS:
        return True
    is_named = bool(above) and all(cell.strip() for cell in above)
    if is_named and cells[0].strip() and (is_time_name(above[0]) or bare(above[0]) in FREQUENCY_NAMES):
        return quantity(cells[0].strip().strip("()[]")) in ("s", "Hz")
    return bool(filled) and all(is_unit(cell) for cell in filled)


def unit_cells(cells: Sequence[str]) -> list[str]:
    """Return the units in a row of units, without brackets.

    If the first cell is a label such as `units`, it becomes empty.
    """
    units = [cell.strip().strip("[]").strip() for cell in cells]
    units = [unit[1:-1] if unit.startswith("(") and unit.endswith(")") else unit for unit in units]
    return ["", *units[1:]] if units and units[0].strip(":").lower() in _UNIT_LABELS else units


_STATED = re.compile(
    r"(?:(?:sampl\w{0,8}[\s_-]?(?:rate|freq\w{0,8})"
    r"|(?:scan|daq|data|acq\w{0,9}|logg?\w{0,4}|record\w{0,4}|measur\w{0,6})[\s_-]?rate"
    r"|(?:^|(?<=[,;|\t\"]))\W{0,3}rate|\bfs|samples\s?(?:per|/)\s?s\w{0,5}|(?:abtast|mess)(?:rate|frequenz))"
    r"|(?P<step>delta[\s_-]?[xt]|\bdt|sampl\w{0,8}[\s_-]?(?:interval|period|time)|\bincrement|abtastintervall))\b"
    r"(?P<between>[^\d\n]{0,20}?)"
    r"(?:\b(?:ch|chan|channel|kanal|ai)\W{0,2}\d{1,3}(?:\s?[-:]\s?\d{1,3})?(?P<after>[^\d\n]{1,10}?))?"
    r"(?<![^\W\d_])(?P<number>\d[\d.,]{0,20}(?:[eE][+-]?\d{1,3})?)(?![\d.,]*[:/-]\d)"
    r"\s*(?P<unit>1/[a-z]{1,8}|[^\W\d][^\s\d,;:()\[\]]{0,20})?",
    re.IGNORECASE,
)
_SAMPLES = re.compile(r"([kM]?)(?:sps|sa?/s|samples?\s?(?:/|per)\s?s\w{0,5})", re.IGNORECASE)
_SAMPLES_PER_MINUTE = re.compile(r"samples?/min\w*", re.IGNORECASE)
_PER_SECOND = re.compile(r"\b1\s?/\s?s(?:ec)?\b|\bs\^?-1\b")
_REMARK_WITH_NUMBER = re.compile(r"\([^()]{0,40}\d[^()]{0,40}\)(?=\s{0,9}[:=])")
_WORD = re.compile(r"[^\W\d_]+")
_BETWEEN = frozenset({
    "in", "of", "per", "each", "all", "is", "the", "channel", "channels", "kanal", "value", "wert", "actual", "nominal",
    "analog",
})  # fmt: skip
"""Words that may stand between `sample rate` and its number, with units; any other names another quantity."""
MOST_STATED = 100  # largest number of places at which a rate may be stated: pint takes a millisecond for a unit
SAME_RATE = 0.05  # largest relative difference of two statements of one rate, one of which may have few digits


class StatedRate(NamedTuple):
    """Sampling rate that the lines around a table state, if any, with a note for the user."""

    hz: float | None = None  # None if no rate is stated, or several that differ by more than 5 %
    note: str = ""  # assumption about it, or the several rates, for the user; empty if none


def stated_rate(lines: Sequence[str], decimal: str = ".", delimiter: str | None = None) -> StatedRate:
    """Return the sampling rate that lines around a table state, as in `Sample rate: 51200 Hz` or `Delta_X 0.008`.

    The unit of the number, or else its name, decides whether it is a rate or a period. `decimal` and `delimiter` are
    those of the table. If all stated rates agree within 5 %, the first is returned. Otherwise no rate is returned, and
    the note lists the rates.
    """
    texts = (_REMARK_WITH_NUMBER.sub("", _PER_SECOND.sub("Hz", line[:300])) for line in lines)
    matches = itertools.islice((match for text in texts for match in _STATED.finditer(text)), MOST_STATED)
    found = [one for match in matches if (one := _rate_of(match, decimal, delimiter))]
    if not found:
        return StatedRate()
    if any(abs(hz / found[0][0] - 1.0) > SAME_RATE for hz, _ in found):
        rates = ", ".join(dict.fromkeys(f"{hz:.6g} Hz" for hz, _ in found))
        return StatedRate(None, f"several rates are stated: {rates[:100]}")
    return StatedRate(*found[0])


def _in_hz(text: str) -> str:
    """Return a text with units of samples per time replaced by plain units, such as `kS/s` by kHz."""
    return _SAMPLES_PER_MINUTE.sub("1/min", _SAMPLES.sub(r"\1Hz", text))


def _rate_of(match: re.Match[str], decimal: str, delimiter: str | None) -> tuple[float, str] | None:
    """Return the sampling rate [Hz] that a match of `_STATED` states, and a note for the user.

    The result is None if the match is no sampling rate, as in `feed rate: 5 mm/s`. The note is empty if the number is
    unambiguous.
    """
    between, behind = (_in_hz(text) for text in (match["between"] + (match["after"] or ""), match["unit"] or ""))
    if any(word.lower() not in _BETWEEN and quantity(word) not in ("Hz", "s") for word in _WORD.findall(between)):
        return None
    if quantity(behind) is None and ("/" in behind or behind.lower() == "per"):
        return None
    before = _in_hz(match[0][: match.start("number") - match.start()]).rstrip(' \t:=;,"')
    units = (behind, split_unit(before)[1], "s" if match["step"] else "Hz")
    unit, kind = next((text, found) for text in units if (found := quantity(text)))
    text = match["number"]
    if delimiter == "," and between.rstrip().endswith(","):  # `Sample rate,125,125` has two numbers
        text = text.partition(",")[0]
    text = text.rstrip(".,")
    value = next((one for sign in (decimal, ".", ",") if (one := number(text, sign)) is not None), 0.0)
    if kind not in ("Hz", "s") or not value > 0.0:
        return None
    value *= unit_factor(unit, kind) or math.nan
    hz = 1.0 / value if kind == "s" else value
    note = f"the rate was read as {hz:g} Hz from {match[0].strip()!r}" if is_unclear(text) else ""
    return (hz, note) if 0.0 < hz < 1e9 else None
