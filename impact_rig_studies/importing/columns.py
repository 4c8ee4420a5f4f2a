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
"""Conversion of a table's columns to signals, with columns of times, rates or periods as the abscissa."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import MOST_HZ
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.importing import cells, headings, units
from impact_rig_studies.importing.limits import check_column_count
from impact_rig_studies.importing.signals import (
    NO_ABSCISSA,
    Abscissa,
    AbscissaKind,
    ImportedSignals,
    Real,
    Signal,
    SignalKind,
    UniqueNames,
)

Column = NDArray[np.generic]

DAY_S = 86_400.0
EXCEL_DAYS = (36_526.0, 73_050.0)  # serial dates of the years 2000 to 2100
EXCEL_EPOCH_DAYS = 25_569.0  # 1970-01-01
EPOCH_S = (946_684_800.0, 4_102_444_800.0)  # since 1970, of the years 2000 to 2100
FRACTIONS = (("ms", 1e3), ("us", 1e6), ("ns", 1e9))  # in which programs count since 1970, in one second
LONGEST_NAME = 200
MOST_SCALARS = 100


@attrs.define
class _Axis:
    """Abscissa (times or frequencies) that the columns of a table define, before a stated rate is added."""

    kind: AbscissaKind = AbscissaKind.NONE
    name: str = ""
    unit: str = ""
    values: Real | None = None  # times in seconds, shape (n,)
    start_ns: int | None = None  # stamp of the first row
    note: str = ""
    is_clock: bool = False


def _shortened(
    columns: Mapping[str, Column], column_units: Mapping[str, str]
) -> tuple[Mapping[str, Column], Mapping[str, str]]:
    """Return columns and units with headings of at most about `LONGEST_NAME` characters, each of them different.

    A heading of a damaged file may be megabytes long.
    """
    names = UniqueNames(tuple(name for name in columns if len(name) <= LONGEST_NAME))
    short = {name: name if len(name) <= LONGEST_NAME else names.unique(name[:LONGEST_NAME]) for name in columns}
    return (
        {short[name]: column for name, column in columns.items()},
        {short.get(name, name): unit for name, unit in column_units.items()},
    )


def signals_of(
    path: Path,
    file_format: str,
    columns: Mapping[str, Column],
    column_units: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
    remarks: tuple[str, ...] = (),
    left_out: Mapping[str, str] | None = None,
    rate_note: str = "",
) -> ImportedSignals:
    """Return the columns of a table as signals with a common abscissa.

    A two-dimensional column becomes several signals, each of the length of its longer side. Columns that are not
    signals, such as texts or single values next to longer columns, are listed in `left_out` of the result, with the
    reason for the user. If no column is a signal, the result has no signals.

    Args:
        path: the file.
        file_format: name of the format for messages.
        columns: columns by heading, shape (n,) or (n, k). Columns may differ in length. A rate or a period is a single
            value.
        column_units: units by heading, if they are not part of it.
        rate_hz: rate that the file states outside the columns; a column such as `fs` or `dt` takes precedence.
        remarks: assumptions that the reader of the file made, for the user.
        left_out: parts of the file that the reader has left out: name to the reason.
        rate_note: assumption about `rate_hz`, or the reason why it is None, for the user.
    """
    check_column_count(len(columns))
    columns, column_units = _shortened(columns, column_units or {})
    omitted = dict(left_out or {})
    texts: dict[str, list[str]] = {}
    numeric: dict[str, Column] = {}
    clocks: list[tuple[str, cells.Times]] = []
    missing: list[str] = []  # columns of dates or stamps of which some are missing
    stamps: NDArray[np.int64] | None = None
    dates: tuple[str, NDArray[np.int64]] | None = None
    for name, column in columns.items():
        values = np.asarray(column)
        if values.dtype.kind in "SUO" and values.ndim == 1 and values.size:
            words = [one.decode("utf-8", "replace") if isinstance(one, bytes) else str(one) for one in values.tolist()]
            if cells.is_time(words[0]) and (headings.is_time_name(headings.split_unit(name)[0]) or not numeric):
                try:
                    clocks.append((name, cells.Times(words)))
                    continue
                except ValueError as error:
                    omitted[name] = f"a time that cannot be read: {error}"
                    continue
            texts[name] = words
            omitted[name] = "texts"
        elif values.dtype.kind in "Mm" and values.ndim == 1:
            ns = values.astype("datetime64[ns]" if values.dtype.kind == "M" else "timedelta64[ns]").astype(np.int64)
            if np.isnat(values).any():
                missing.append(name)
            elif values.dtype.kind == "M" and dates is None:
                dates = name, ns
            else:
                numeric[f"{name} [s]"] = ns / NS_PER_S
        elif values.dtype.kind == "c":
            omitted[name] = "complex numbers: a spectrum or frequency response"
        elif values.dtype.kind not in "fiub":
            omitted[name] = "no numbers"
        elif values.size == 1 and headings.rate_hz(name, 1.0) is not None:
            one = float(values.reshape(-1)[0])
            stated = headings.rate_hz(name, one)
            rate_hz = stated or rate_hz
            if stated is None:
                omitted[name] = f"no valid rate or period: {one:g}"
        elif name == headings.STAMP and values.ndim == 1:
            if values.dtype.kind == "f" and not np.isfinite(values).all():
                missing.append(name)
            else:
                stamps = values.astype(np.int64)
        else:
            numeric[name] = values
    axis = _axis(numeric, column_units, clocks, stamps, dates, omitted)
    omitted |= dict.fromkeys(missing, "times are missing in some rows")
    if axis.kind is AbscissaKind.NONE:
        strange = next((name for name in texts if headings.is_time_name(headings.split_unit(name)[0])), None)
        if strange is not None:
            axis.note = (
                f"the times of column {strange!r} are not understood: {texts[strange][0][: cells.LONGEST_CELL]!r}"
            )
    if missing and axis.kind is AbscissaKind.NONE:
        axis.note = "; ".join(filter(None, (axis.note, f"times are missing in some rows of column {missing[0]!r}")))
    if axis.kind is AbscissaKind.NONE and rate_note:
        axis.note = "; ".join(filter(None, (axis.note, rate_note)))
    abscissa, kind = _abscissa(axis, rate_hz)
    names = UniqueNames()
    signals: dict[str, Signal] = {}
    scalars = 0
    for place, (heading, values) in enumerate(numeric.items(), 1):
        if values.ndim == 0 or (values.size == 1 and len(numeric) > 1 and any(v.size > 1 for v in numeric.values())):
            scalars += 1
            if scalars <= MOST_SCALARS:
                omitted[heading] = f"one value: {float(values.reshape(-1)[0]):g}"
            continue
        squeezed = np.atleast_1d(np.squeeze(values))
        if squeezed.ndim > 2:
            omitted[heading] = "an array of more than two dimensions"
            continue
        rows = squeezed[None] if squeezed.ndim == 1 else squeezed if len(squeezed) < len(squeezed.T) else squeezed.T
        check_column_count(len(rows) + len(signals))
        plain, unit = headings.split_unit(heading)
        for number, row in enumerate(rows):
            own, full = (plain, heading) if len(rows) == 1 else (f"{plain}_{number}", f"{heading}_{number}")
            own = names.unique(own if own not in signals else full)
            signals[own] = Signal(
                np.ascontiguousarray(row, np.float64),
                column_units.get(heading, "") or unit,
                abscissa,
                kind,
                f"column {place}" if len(rows) == 1 else f"{heading}, row {number}",
            )
    return ImportedSignals(path, file_format, signals, axis.start_ns, texts, omitted, remarks)


def _axis(
    numeric: dict[str, Column],
    column_units: Mapping[str, str],
    clocks: list[tuple[str, cells.Times]],
    stamps: NDArray[np.int64] | None,
    dates: tuple[str, NDArray[np.int64]] | None,
    omitted: dict[str, str],
) -> _Axis:
    """Return the abscissa that the columns of a table define, and remove the columns of the abscissa from `numeric`.

    Columns are preferred in this order: `clocks`, `dates`, `stamps`, numbers that are times, numbers that are
    frequencies. Without any of them, the abscissa has the kind `NONE`. Columns of times that are not used are added to
    `omitted`, with the reason.

    Args:
        numeric: columns of numbers by heading; the used columns are removed.
        column_units: unit by heading, for headings that do not contain their unit.
        clocks: heading and content of each column of dates, times of day or durations.
        stamps: column `stamp_ns` [ns], or None.
        dates: heading and content [ns since 1970] of the column of binary dates, or None.
        omitted: reasons for the user why columns are not signals, by heading.
    """
    timed = next((name for name in numeric if headings.is_time_name(_name(name)) and _is_column(numeric[name])), None)
    if clocks:
        fraction = next((name for name in numeric if headings.bare(_name(name)) in headings.MILLISECONDS), None)
        if fraction is not None and _is_column(numeric[fraction]) and _is_fraction(clocks, _float(numeric[fraction])):
            clock = next(times for _, times in clocks if times.has_clock)
            clock.ns = clock.ns + np.round(_float(numeric.pop(fraction)) * 1e6).astype(np.int64)
            timed = None if timed == fraction else timed
    used = _clock_names(clocks) if clocks else [dates[0]] if dates else []
    if used:
        spare = [name for name, _ in clocks if name not in used]
        if timed is not None:
            del numeric[timed]  # it repeats the dates in seconds
            spare.append(timed)
        spare += [dates[0]] if clocks and dates else []
        spare += [headings.STAMP] if stamps is not None else []
        omitted |= dict.fromkeys(spare, f"the times are those of {' and '.join(used)}")
    if clocks:
        return _clock_axis([one for one in clocks if one[0] in used])
    if dates:
        name, ns = dates  # binary dates, in nanoseconds since 1970
        return _Axis(AbscissaKind.TIME, name, "s", (ns - ns[0]) / NS_PER_S, int(ns[0])) if len(ns) else _Axis()
    if timed is None:
        timed = next(
            (name for name in list(numeric)[:1] if _unit(name, column_units) and _is_column(numeric[name])), None
        )
        if timed is not None and units.quantity(_unit(timed, column_units)) != "s":
            timed = None
    if stamps is not None and len(stamps):
        since = np.zeros(len(stamps)) if timed is None else _float(numeric.pop(timed))
        begin = float(since[0]) if len(since) else 0.0
        # a truncated table begins within a block, so its first sample is later than its first stamp
        start_ns = int(stamps[0]) + (round(begin * NS_PER_S) if math.isfinite(begin) else 0)
        return _Axis(AbscissaKind.TIME, headings.STAMP, "s", since + (stamps - stamps[0]) / NS_PER_S, start_ns)
    if timed is not None:
        column, unit = numeric.pop(timed), headings.time_unit(_name(timed), _unit(timed, column_units))
        return _epoch_axis(timed, unit, column) or _time_axis(timed, unit, _float(column))
    first = next(iter(numeric), None)
    if first is not None and _is_column(numeric[first]) and len(numeric) > 1:
        is_frequency = headings.bare(_name(first)) in headings.FREQUENCY_NAMES
        if (is_frequency or units.quantity(_unit(first, column_units)) == "Hz") and _rises(_float(numeric[first])):
            unit = _unit(first, column_units)
            return _Axis(AbscissaKind.FREQUENCY, first, unit, _float(numeric.pop(first)))
    return _Axis()


def _clock_names(clocks: list[tuple[str, cells.Times]]) -> list[str]:
    """Return the names of the one or two columns in `clocks` that give the times.

    The first column is always used. If it contains only dates, the first column of times of day completes it, and vice
    versa. `clocks` must not be empty.
    """
    name, times = clocks[0]
    completing = (
        other_name
        for other_name, other in clocks[1:]
        if len(other.ns) == len(times.ns)
        and other.has_date != times.has_date
        and not any(one.has_date and one.has_clock for one in (times, other))
    )
    return [name, *list(completing)[:1]]


def _clock_axis(clocks: list[tuple[str, cells.Times]]) -> _Axis:
    """Return the abscissa from a column of dates or times of day, or from a pair of both."""
    name, times = clocks[0]
    ns = times.ns
    has_date = times.has_date
    for _, other in clocks[1:]:
        date, clock = (times, other) if times.has_date else (other, times)
        ns, has_date = date.ns + clock.ns % (86_400 * NS_PER_S), True
    seconds = (ns - ns[0]) / NS_PER_S if len(ns) else np.zeros(0)
    start_ns = int(ns[0]) if has_date and len(ns) else None
    note = next((one.note for _, one in clocks if one.note), "")
    return _Axis(AbscissaKind.TIME, name, "s", seconds, start_ns, note, is_clock=True)


def _is_fraction(clocks: list[tuple[str, cells.Times]], values: Real) -> bool:
    """Return whether a column contains milliseconds that complete the times in `clocks`.

    The times must be whole seconds and include times of day. The values must be at least 0 and below 1000.
    """
    whole = all(bool(np.all(times.ns % NS_PER_S == 0)) for _, times in clocks)
    return whole and any(times.has_clock for _, times in clocks) and bool(np.all((values >= 0.0) & (values < 1e3)))


def _epoch_axis(name: str, unit: str, column: Column) -> _Axis | None:
    """Return the abscissa from a column that counts ms, us or ns since 1970, without rounding of integers.

    It is None for another unit, or if the first value is not in the years 2000 to 2100.
    """
    first = column.reshape(-1)[0].item()
    for fraction, per_s in FRACTIONS:
        if unit in ("", fraction) and EPOCH_S[0] * per_s <= first <= EPOCH_S[1] * per_s:
            since = (column - first).astype(np.float64).reshape(-1) / per_s
            note = "" if unit else f"column {_name(name)!r} was read as {fraction} since 1970"
            return _Axis(AbscissaKind.TIME, name, fraction, since, round(first * (NS_PER_S // int(per_s))), note)
    return None


def _time_axis(name: str, unit: str, values: Real) -> _Axis:
    """Return the abscissa from a column of times, converted to seconds.

    If the unit is not a unit of time, the values are kept, and the kind is frequency or other. Without a unit, seconds
    are assumed. Days of a spreadsheet (since 1900) are recognized by the name of the column and the size and step of
    the values. A column of dates in days then counts from its first row.
    """
    note = ""
    word = headings.bare(_name(name))
    finite = values[np.isfinite(values)]
    if not unit and len(finite) > 1:
        step = float(np.median(np.diff(finite[:1000])))
        in_range = EXCEL_DAYS[0] <= float(finite.min()) and float(finite.max()) <= EXCEL_DAYS[1]
        too_fast = 0.0 < step < 1.0 / MOST_HZ
        if (in_range and (word in headings.DATE_NAMES or too_fast)) or (too_fast and 0.0 <= finite[0] < 1.0):
            unit, note = "d", f"column {_name(name)!r} was read as days of a spreadsheet"
    if unit == "d":
        start_ns = None
        if len(finite) and EXCEL_DAYS[0] <= finite[0] <= EXCEL_DAYS[1]:
            if np.isfinite(values[0]):
                start_ns = round((float(values[0]) - EXCEL_EPOCH_DAYS) * DAY_S * 1e3) * 1_000_000
            values = values - values[0]
        return _Axis(AbscissaKind.TIME, name, "d", values * DAY_S, start_ns, note)
    if not unit:
        return _Axis(
            AbscissaKind.TIME, name, "", values, None, f"no unit is given for column {_name(name)!r}: seconds assumed"
        )
    factor = units.unit_factor(unit, "s") if units.quantity(unit) == "s" else None
    if factor is None:
        kind = AbscissaKind.FREQUENCY if units.quantity(unit) == "Hz" else AbscissaKind.OTHER
        return _Axis(kind, name, unit, values)
    scaled = values * factor if factor >= 1.0 else values / round(1.0 / factor)  # 8 ms is 0.008 s to the last bit
    return _Axis(AbscissaKind.TIME, name, unit, scaled)


def _abscissa(axis: _Axis, rate_hz: float | None) -> tuple[Abscissa, SignalKind]:
    """Return the abscissa of all signals of a table, and the kind of the signals.

    `rate_hz` is the rate that the file states elsewhere, or None. An abscissa of times contains both this rate and the
    listed times.
    """
    values = axis.values
    if axis.kind is AbscissaKind.FREQUENCY:
        return Abscissa(axis.kind, axis.unit, _first(values), None, values), SignalKind.SPECTRUM
    if axis.kind is AbscissaKind.OTHER:
        note = f"the unit {axis.unit!r} of column {_name(axis.name)!r} is not understood"
        return Abscissa(axis.kind, axis.unit, _first(values), None, values, 0.0, note), SignalKind.TIME_RESPONSE
    step = None if rate_hz is None else 1.0 / rate_hz
    if values is None or not len(values):
        if step is None:
            return attrs.evolve(NO_ABSCISSA, note=axis.note), SignalKind.TIME_RESPONSE
        return Abscissa(AbscissaKind.TIME, "s", 0.0, step, note=axis.note), SignalKind.TIME_RESPONSE
    begin = _first(values)
    since = values - values[0]
    start = begin if axis.start_ns is None and not axis.is_clock else 0.0
    return Abscissa(AbscissaKind.TIME, axis.unit, start, step, since, 0.0, axis.note), SignalKind.TIME_RESPONSE


def _first(values: Real | None) -> float:
    return float(values[0]) if values is not None and len(values) and np.isfinite(values[0]) else 0.0


def _name(heading: str) -> str:
    return headings.split_unit(heading)[0]


def _unit(heading: str, column_units: Mapping[str, str]) -> str:
    return column_units.get(heading, "") or headings.split_unit(heading)[1]


def _is_column(values: Column) -> bool:
    return values.size > 1 and values.size == max(values.shape, default=0)


def _float(values: Column) -> Real:
    return np.asarray(values, np.float64).reshape(-1)


def _rises(values: Real) -> bool:
    return len(values) > 2 and bool(np.all(np.diff(values) > 0.0))
