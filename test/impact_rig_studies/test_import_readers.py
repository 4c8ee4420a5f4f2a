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
"""Readers of files of other programs: every notation gives the right signals, or a rejection with its true reason."""

from __future__ import annotations

import contextlib
import datetime as dt
import decimal
import io
import itertools
import os
import struct
import subprocess
import sys
import time
import warnings
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from impact_rig.errors import ImpactRigError
from impact_rig.runs.exports import write_columns
from impact_rig.system import budget
from impact_rig_studies.importing import cells, file_names, headings, readers
from impact_rig_studies.importing.assignment import guess
from impact_rig_studies.importing.cells import half_digit
from impact_rig_studies.importing.columns import signals_of
from impact_rig_studies.importing.conversion import convert
from impact_rig_studies.importing.readers import delimited, hdf5, labview, universal, wav
from impact_rig_studies.importing.signals import AbscissaKind, ImportedSignals, SignalKind
from impact_rig_studies.importing.uniform import likely_rate
from impact_rig_studies.importing.units import Sensitivity, doubt, quantity, unit_factor

pytestmark = pytest.mark.heavy

COUNT, RATE_HZ = 60, 125
TIME_S = np.arange(COUNT) / RATE_HZ
BASE, LASER = 0.1 * np.sin(2 * np.pi * 9.1 * TIME_S), np.sin(2 * np.pi * 9.1 * TIME_S - 0.7)
PATH = Path("own.csv")


def text_table(content: bytes | str) -> ImportedSignals:
    return delimited.read(PATH, content.encode() if isinstance(content, str) else content)


def since_start(found: ImportedSignals) -> Any:
    (first, *_) = found.signals.values()
    assert first.time_s is not None
    return first.time_s


# --- text tables: decimal sign × separator × code page × times

BEGIN = dt.datetime(2024, 5, 13, 23, 59, 59, 900_000)
EPOCH_S = 1_715_594_400  # of the times that count since 1970


def stamps(form: str) -> Callable[[float], str]:
    def show(seconds: float) -> str:
        at = BEGIN + dt.timedelta(microseconds=round(seconds * 1e6))
        return at.strftime(form).replace("%L", f"{at.microsecond // 1000:03d}")

    return show


TIMES: dict[str, tuple[str, Callable[[float], str]]] = {
    "s": ("time [s]", lambda t: f"{t:.3f}"),
    "ms": ("Time (msec)", lambda t: f"{1e3 * t:.0f}"),
    "us": ("t_us", lambda t: f"{1e6 * t:.0f}"),
    "camel": ("timeMs", lambda t: f"{1e3 * t:.0f}"),
    "month by name": ("Time", stamps("%d-%b-%Y %H:%M:%S.%L")),
    "month first by name": ("Time", stamps("%b %d %Y %H:%M:%S.%f")),
    "compact": ("Time", stamps("%Y%m%dT%H%M%S.%f")),
    "UTC": ("Timestamp", stamps("%Y-%m-%d %H:%M:%S.%f UTC")),
    "days": ("Elapsed", lambda t: f"0 days 00:00:{t:09.6f}"),
    "ms since 1970": ("timestamp", lambda t: f"{EPOCH_S * 1000 + round(1e3 * t)}"),
    "us since 1970": ("timestamp", lambda t: f"{EPOCH_S * 10**6 + round(1e6 * t)}"),
    "ns since 1970": ("time_ns", lambda t: f"{EPOCH_S * 10**9 + round(1e9 * t)}"),
    "german": ("Zeit in ms", lambda t: f"{1e3 * t:.1f}"),
    "ISO": ("Timestamp", stamps("%Y-%m-%dT%H:%M:%S.%f")),
    "ISO with zone": ("Timestamp", lambda t: stamps("%Y-%m-%d %H:%M:%S.%f")(t) + "+02:00"),
    "day first": ("Datum", stamps("%d.%m.%Y %H:%M:%S.%L")),
    "month first": ("Date/Time", stamps("%m/%d/%Y %I:%M:%S.%f %p")),
    "month first in UTC": ("Date/Time", stamps("%m/%d/%Y %H:%M:%S.%f UTC")),
    "clock": ("Uhrzeit", stamps("%H:%M:%S.%L")),
    "Excel": ("Date", lambda t: f"{45425 + (86399.9 + t) / 86400:.11f}"),
}
ENCODINGS = ("utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-32")


SIGNS = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."))
LOCALES = [
    # the bytes are decoded before signs and times are read, so one code page for each of their pairs is enough
    pytest.param(*SIGNS[i], encoding, times, marks=() if (i + j + k) % len(ENCODINGS) == 0 else pytest.mark.slow)
    for i, j, k in itertools.product(range(len(SIGNS)), range(len(TIMES)), range(len(ENCODINGS)))
    for encoding, times in [(ENCODINGS[k], list(TIMES)[j])]
]


@pytest.mark.parametrize(("separator", "decimal", "encoding", "times"), LOCALES)
def test_text_tables_of_any_locale_are_read(separator: str, decimal: str, encoding: str, times: str) -> None:
    """600 variants: six pairs of signs, five code pages, twenty notations of time."""
    heading, show = TIMES[times]
    rows = [separator.join((heading, "base [µm]", "laser [mm]"))]
    for t, x_b, x_1 in zip(TIME_S, BASE, LASER, strict=True):
        numbers = [f"{1e3 * x_b:.3f}", f"{x_1:.4f}"]
        stamp = show(t) if ":" in show(t) else show(t).replace(".", decimal)
        rows.append(separator.join((stamp, *(number.replace(".", decimal) for number in numbers))))
    found = text_table("\r\n".join([*rows, ""]).encode(encoding))
    assert list(found.signals) == ["base", "laser"]
    assert [one.unit for one in found.signals.values()] == ["µm", "mm"]
    assert found.signals["base"].values == pytest.approx(1e3 * BASE, abs=6e-4)
    assert found.signals["laser"].values == pytest.approx(LASER, abs=6e-5)
    assert since_start(found) == pytest.approx(TIME_S, abs=6e-4 if times == "Excel" else 1e-9)
    dated = times not in ("s", "ms", "us", "camel", "days", "german", "clock")
    offset_h = 2 if times == "ISO with zone" else 0
    expected = (BEGIN - dt.timedelta(hours=offset_h)).replace(tzinfo=dt.UTC).timestamp()
    expected = EPOCH_S if times.endswith("since 1970") else expected
    assert (found.start_ns is not None) == dated
    if found.start_ns is not None:
        assert found.start_ns / 1e9 == pytest.approx(expected, abs=1e-3)


def rows_of(head: str, separator: str = ",") -> str:
    lines = (separator.join((f"{t:.3f}", f"{a:.4f}", f"{b:.4f}")) for t, a, b in zip(TIME_S, BASE, LASER, strict=True))
    return "\n".join([*([head] if head else []), *lines]) + "\n"


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("time,base,laser\ns,mm,mm", ["base", "laser"], ["mm", "mm"]),
        ("time,base,laser\n[s],[mm],[g]", ["base", "laser"], ["mm", "g"]),
        ("time,base,laser\n,mm,g", ["base", "laser"], ["mm", "g"]),
        ("Time (s),base,laser\n,[mm],[g]", ["base", "laser"], ["mm", "g"]),
        ("s,mm,m/s2\ntime,base,acc", ["base", "acc"], ["mm", "m/s2"]),
        ("Test 4\nOperator: ab\n\ntime [s],base (mm),acc (m/(s^2))", ["base", "acc"], ["mm", "m/(s^2)"]),
        ("# time,base [mm],laser [mm]", ["base", "laser"], ["mm", "mm"]),
        ("Zeit / s,Weg / mm,Beschl. / g", ["Weg", "Beschl."], ["mm", "g"]),
        ("Zeit in s,Weg in mm,Kraft in N", ["Weg", "Kraft"], ["mm", "N"]),
        ("Channel,base,laser\nUnit,mm,µm\ntime,x,y", ["x", "y"], ["mm", "µm"]),
        ("time_s,x1_mm,xb_um", ["x1_mm", "xb_um"], ["mm", "um"]),
        ('"time [s]","base, raw","laser [mm]"', ["base", "laser"], ["raw", "mm"]),
        ("time,base (raw),laser", ["base", "laser"], ["raw", ""]),
        ("time [s],x/s,a_1", ["x/s", "a_1"], ["", ""]),
        ("time,base,laser\ns,EU,mm p-p", ["base", "laser"], ["EU", "mm p-p"]),
        ("время,x,y\nс,мм,м/с²", ["x", "y"], ["мм", "м/с²"]),
        ("time,x,y\nsec.,in.,M/S2", ["x", "y"], ["in.", "M/S2"]),
        ("time,base,laser\n---,---,---", ["base", "laser"], ["", ""]),
        ("Time  1 - default sample rate [s],x,acc [g]", ["x", "acc"], ["", "g"]),
        ("x-axis,1,2\nsecond,Volt,Volt", ["1", "2"], ["Volt", "Volt"]),
        ("x-axis,1,2\nsecond,rad/s,rpm", ["1", "2"], ["rad/s", "rpm"]),
        ("in s,CH1 in V,CH2 in V", ["CH1", "CH2"], ["V", "V"]),
        ("Time (s) Run #1,base (mm) Run #1,laser (mm) Run #1", ["base Run #1", "laser Run #1"], ["mm", "mm"]),
    ],
)
def test_headings_are_split_into_name_and_unit(head: str, names: list[str], units: list[str]) -> None:
    found = text_table(rows_of(head))
    assert [list(found.signals), [one.unit for one in found.signals.values()]] == [names, units]
    assert since_start(found) == pytest.approx(TIME_S)


@pytest.mark.parametrize(
    "heading", ["time [s] base [mm] laser [mm]", "# time [s] base (mm) laser [mm]", "time  base  laser mm"]
)
def test_headings_of_columns_separated_by_blanks_are_read(heading: str) -> None:
    found = text_table(rows_of("# measured by me\n" + heading, " "))
    assert list(found.signals) == ["base", "laser"]
    assert [one.unit for one in found.signals.values()][1] == "mm"


def test_a_remark_in_the_first_row_is_not_taken_for_a_heading() -> None:
    rows = rows_of("time [s],base [mm],laser [mm],Remark").replace("\n", ",\n").replace("Remark,", "Remark")
    rows = rows.replace("0.000,0.0000,-0.6442,", "0.000,0.0000,-0.6442,begin")
    found = text_table(rows)
    assert len(found.signals["base"].values) == COUNT
    assert found.texts["Remark"][:2] == ["begin", ""]


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_trailing_separator_of_rows_without_one_in_the_heading_is_ignored(separator: str) -> None:
    head = separator.join(("time [s]", "base [mm]", "laser [mm]"))
    found = text_table(head + "\n" + rows_of("", separator).replace("\n", separator + "\n"))
    assert list(found.signals) == ["base", "laser"]


@pytest.mark.parametrize("name", ["stamp_ns", "time_ns", "timestamp"])
def test_stamps_in_nanoseconds_keep_their_digits_behind_an_index(name: str) -> None:
    """A double resolves them to 256 ns only: at 10 kHz the times were uneven, and the rate 10000.0003 Hz."""
    begin_ns = EPOCH_S * 10**9 + 123_456_789
    rows = [f"{k},{begin_ns + 100_000 * k},{k % 3},{k % 5}" for k in range(300)]
    found = text_table("\n".join([f",{name},base [mm],laser [mm]", *rows]))
    assert {"base", "laser"} <= set(found.signals)
    assert (since_start(found) == np.arange(300) * 100_000 / 1e9).all()
    assert found.start_ns == begin_ns


def test_times_of_day_are_not_added_to_stamps_that_contain_them() -> None:
    rows = [f"00:00:{k:02},2026-11-02 00:00:{k:02},{k},{k % 3}" for k in range(30)]
    for head, order in (
        ("time,timestamp,base [mm],laser [mm]", (0, 1)),
        ("timestamp,time,base [mm],laser [mm]", (1, 0)),
    ):
        cells = [row.split(",") for row in rows]
        found = text_table("\n".join([head, *(",".join([row[order[0]], row[order[1]], *row[2:]]) for row in cells)]))
        assert since_start(found) == pytest.approx(np.arange(30.0))


def test_a_column_of_milliseconds_is_added_to_a_clock_of_whole_seconds() -> None:
    at = [BEGIN + dt.timedelta(seconds=float(t)) for t in TIME_S]
    lines = [f"{one:%Y-%m-%d %H:%M:%S},{one.microsecond // 1000},{k}" for k, one in enumerate(at)]
    found = text_table("\n".join(["Time,Millisecond,base [mm]", *lines]))
    assert list(found.signals) == ["base"]
    assert since_start(found) == pytest.approx(TIME_S)


def test_unreadable_times_are_reported_as_the_reason(tmp_path: Path) -> None:
    lines = [f"2024:134:{t:.3f},{a:.4f},{b:.4f}" for t, a, b in zip(TIME_S, BASE, LASER, strict=True)]
    found = text_table("\n".join(["Time,base [mm],laser [mm]", *lines]))
    with pytest.raises(ImpactRigError, match=r"the times of column 'Time' are not understood: '2024:134:0.000'"):
        convert(found, guess(found))


def test_a_table_of_spectra_is_rejected_as_such() -> None:
    found = text_table("\n".join(["Frequency [Hz],base [mm],laser [mm]", *(f"{0.5 * k},{k},1" for k in range(40))]))
    with pytest.raises(ImpactRigError, match=r"holds no time response: base: spectrum, frequency from 0 Hz"):
        convert(found, guess(found))


@pytest.mark.parametrize(
    "cell",
    [
        "1.#QNAN", "-1.#IND", "NaN", "", "#N/A", "#DIV/0!", "n/a", "--", "1.#SNAN", "NULL", "1.#QO", "-1.#IO", "1.#J",
        "-1.$", "1.#QNAN0", "nan(0x7ff8)", "9.91E+37", "-9.91e37", "#REF!", "OVLD", "<NA>", "NaT", "*****", ".",
    ],
)  # fmt: skip
def test_placeholders_for_missing_numbers_are_read_as_nan(cell: str) -> None:
    """A `#` within a cell must not begin a comment: 1.#QNAN is not 1.0."""
    lines = rows_of("time [s],base [mm],laser [mm]").splitlines()
    lines[20] = f"0.152,{cell},0.5"
    found = text_table("\n".join(lines))
    assert np.flatnonzero(np.isnan(found.signals["base"].values)).tolist() == [19]
    assert found.signals["laser"].values[19] == 0.5


@pytest.mark.parametrize("cell", ["1.#INF", "inf", "-Infinity", "-1.#INF", "-1.#INF00", "9.9E+37", "-9.9E37", "1e400"])
def test_infinity_is_not_read_as_a_finite_number(cell: str) -> None:
    lines = rows_of("time [s],base [mm],laser [mm]").splitlines()
    lines[20] = f"0.152,{cell},0.5"
    value = text_table("\n".join(lines)).signals["base"].values[19]
    assert value == (-np.inf if cell.startswith("-") else np.inf)


@pytest.mark.parametrize(
    ("cell", "value"),
    [
        ("1.5D-03", 1.5e-3), ("−2.5", -2.5), ("+.5", 0.5), ("1e3", 1000.0), (' "2.25" ', 2.25),
        ("1'234.5", 1234.5), ("1\u202f234.5", 1234.5),
    ],
)  # fmt: skip
def test_numbers_in_any_notation_are_read(cell: str, value: float) -> None:
    lines = rows_of("time [s];base [mm];laser [mm]", ";").splitlines()
    lines[20] = f"0.152;{cell};0.5"
    assert text_table("\n".join(lines)).signals["base"].values[19] == pytest.approx(value, rel=1e-12)


@given(st.lists(st.from_regex(r"[+-]?[0-9.,' ]{0,4}[eEdD_]?[+-]?[0-9]{0,3}", fullmatch=True), max_size=4))
@example(["9.91e37", "-9.9E+37"])
@example(["1" * 64])
@example(["1" * 65])
@example(["1\n2"])
@example([])
@example([""])
def test_numbers_read_at_once_are_those_read_one_by_one(column: list[str]) -> None:
    found = cells.plain_numbers(column)
    if found is not None:
        assert found.tolist() == pytest.approx([cells.number(cell) for cell in column], rel=0.0, abs=0.0, nan_ok=True)


def test_plain_numbers_are_read_at_once() -> None:
    column = ["1", "-2.5", "+.5", "3.", "1e3", "2.5E-07"]
    found = cells.plain_numbers(column)
    assert found is not None
    assert found.tolist() == [1.0, -2.5, 0.5, 3.0, 1000.0, 2.5e-7]


@pytest.mark.parametrize(
    ("cell", "why"), [("abc", "'abc' is not"), ("1_000", "'1_000' is not a number"), ("0x10", "'0x10' is not a number")]
)
def test_a_word_among_numbers_is_named_with_its_line(cell: str, why: str) -> None:
    lines = rows_of("time [s],base [mm],laser [mm]").splitlines()
    lines[20] = f"0.152,{cell},0.5"
    with pytest.raises(ImpactRigError, match=f"line 21, column 2: {why}"):
        text_table("\n".join(lines))


@pytest.mark.parametrize(
    "last", ["Rate 125, overflows 0", "End of data", "# 3 overflows", "0.480,0.1", "Mean,0.1,0.2,0.3"]
)
def test_lines_after_the_table_are_ignored_and_reported(last: str) -> None:
    found = text_table(rows_of("time [s],base [mm],laser [mm]") + last + "\n\n")
    assert len(found.signals["base"].values) == COUNT
    assert list(found.left_out) == ["line 62 and after"]


def test_the_first_row_of_a_table_without_headings_is_kept() -> None:
    lines = [
        f"{stamps('%Y-%m-%dT%H:%M:%S.%f')(t)},{a:.3f},{b:.3f}" for t, a, b in zip(TIME_S, BASE, LASER, strict=True)
    ]
    found = text_table("\n".join(lines))
    assert list(found.signals) == ["column_1", "column_2"]
    assert len(found.signals["column_1"].values) == COUNT
    assert since_start(found) == pytest.approx(TIME_S)


@pytest.mark.parametrize(
    ("head", "rate_hz"),
    [
        ("Sample rate: 51200 Hz\nbase,laser,x", 51200.0), ("Sampling frequency;12,8 kHz\nbase,laser,x", 12800.0),
        ("fs=1000\nbase,laser,x", 1000.0), ("Delta_X 0.008 s\nbase,laser,x", 125.0), ("dt: 2 ms\nbase,laser,x", 500.0),
        ("Abtastrate 200\nbase,laser,x", 200.0), ("Samples per second: 125\nbase,laser,x", 125.0),
        ("Sample rate (kHz): 2\nbase,laser,x", 2000.0), ("Sampling interval [ms]: 0.5\nbase,laser,x", 2000.0),
        ("Sample rate in kHz: 2\nbase,laser,x", 2000.0), ("Sample interval: 500 us\nbase,laser,x", 2000.0),
        ("Sampling frequency: 2 kilohertz\nbase,laser,x", 2000.0), ("Sample rate: 2 kS/s\nbase,laser,x", 2000.0),
        ("Sample rate: 0.02 s\nbase,laser,x", 50.0), ("feed rate: 5 mm/s; fs: 50 SPS\nbase,laser,x", 50.0),
        ("Sampling rate: 1,000 Hz\nbase,laser,x", 1000.0), ("Sampling rate (Hz): 51,200\nbase,laser,x", 51200.0),
        ("Abtastrate: 1.000,0 Hz\nbase,laser,x", 1000.0), ('"Sample Rate","1,000"\nbase,laser,x', 1000.0),
        ("Sample rate,125,125\nbase,laser,x", 125.0), ("Sample rate,51200,51200\nbase,laser,x", 51200.0),
        ("Sample rate divider: 4\nSample rate: 125 Hz\nbase,laser,x", 125.0), ("Rate: 125\nbase,laser,x", 125.0),
        ("Sampling rate Ch1-2: 125 Hz\nbase,laser,x", 125.0), ("Frame rate: 30\nfs: 125\nbase,laser,x", 125.0),
        ("Sample rate (max 1000 Hz): 125 Hz\nbase,laser,x", 125.0), ("Sampling rate (1/s): 125\nbase,laser,x", 125.0),
        ("Sample rate: 7500 1/min\nbase,laser,x", 125.0), ("Sample rate: 7500 samples/min\nbase,laser,x", 125.0),
        ("Sample rate (samples/min): 7500\nbase,laser,x", 125.0),
        ("Baud rate: 115200\nSample rate: 125 Hz\nbase,laser,x", 125.0),
        ("Sample time: 10:23:11\nSample rate: 125 Hz\nbase,laser,x", 125.0),
        ("Sample rate: 51200 Hz\nSample interval: 1.95e-5 s\nbase,laser,x", 51200.0),
    ],
)  # fmt: skip
def test_a_rate_in_the_lines_above_a_table_is_read(head: str, rate_hz: float) -> None:
    found = text_table(rows_of(head))
    assert found.signals["base"].rate_hz == pytest.approx(rate_hz)


@pytest.mark.parametrize(("stated", "rate_hz"), [("2.000 Hz", 2000.0), ("2.000,5 Hz", 2000.5), ("0,125 kHz", 125.0)])
def test_a_stated_rate_has_the_decimal_sign_of_the_table(stated: str, rate_hz: float) -> None:
    rows = rows_of("base [mm];laser [mm];x", ";").replace(".", ",")
    found = text_table(f"Abtastrate: {stated}\n{rows}")
    assert found.signals["base"].rate_hz == pytest.approx(rate_hz)
    assert bool(found.signals["base"].abscissa.note) == (stated == "2.000 Hz")


@pytest.mark.parametrize(
    ("head", "note"),
    [
        ("Sample rate divider: 4", ""), ("Sampling rate index: 3", ""), ("Baud rate: 115200", ""),
        ("Drop rate: 0.1", ""), ("feed rate: 5 mm/s", ""),
        ("ADC sampling rate: 51200 Hz\nDecimated sampling rate: 125 Hz", "several rates are stated: 51200 Hz, 125 Hz"),
    ],
)  # fmt: skip
def test_unrelated_or_several_rates_above_a_table_are_not_used(head: str, note: str) -> None:
    one = text_table(rows_of(f"{head}\nbase,laser,x")).signals["base"]
    assert (one.rate_hz, one.abscissa.note) == (None, note)


@pytest.mark.parametrize(("separator", "sign"), [("\t", ","), (";", ","), (";", "."), ("\t", "."), (";", " ")])
@pytest.mark.parametrize("seconds", ["{:.3f}", "{:.0f}"])
def test_integers_with_groups_of_digits_are_read(separator: str, sign: str, seconds: str) -> None:
    """The values below 1000 show that `1,234` has groups of digits, even if a single cell has them."""
    values = np.round(1000.4 * BASE / np.abs(BASE).max())
    for whole in (values, 70 * values):
        times = [seconds.format(1e3 * t if seconds == "{:.0f}" else t) for t in TIME_S]
        times = [t.replace(".", ",") if sign == "." else t for t in times]
        unit = "ms" if seconds == "{:.0f}" else "s"
        rows = (
            separator.join((t, f"{v:,.0f}".replace(",", sign), f"{v:.0f}")) for t, v in zip(times, whole, strict=True)
        )
        found = text_table("\n".join([separator.join((f"time [{unit}]", "base [nm]", "x [nm]")), *rows]))
        assert found.signals["base"].values.tolist() == whole.tolist()
        assert found.signals["x"].values.tolist() == whole.tolist()
        assert since_start(found) == pytest.approx(TIME_S)


def test_a_column_that_appears_later_is_reported_as_the_reason() -> None:
    head, *lines = rows_of("time [s],base [mm],laser [mm]").splitlines()
    later = [f"{line},0.5" for line in lines[9:]]
    assert text_table("\n".join([head, *lines[:9], *later])).left_out == {
        "line 2 to 10": "numbers, but not in 4 cells as the table"
    }
    with pytest.raises(ImpactRigError, match=r"that has the form of its line \d+: '.*,0\.5'"):
        text_table("\n".join([head, *(200 * lines[:1]), *(10 * later)]))


def test_separate_columns_of_date_and_time_are_combined() -> None:
    at = [BEGIN + dt.timedelta(seconds=float(t)) for t in TIME_S]
    lines = ["Date,Time,base [mm]", *(f"{one:%d.%m.%Y},{one:%H:%M:%S.%f},{k}" for k, one in enumerate(at))]
    found = text_table("\n".join(lines))
    assert list(found.signals) == ["base"]
    assert since_start(found) == pytest.approx(TIME_S)


def test_an_unknown_unit_of_time_is_not_taken_for_seconds() -> None:
    found = text_table(rows_of("time [ticks],base [mm],laser [mm]"))
    abscissa = found.signals["base"].abscissa
    assert (abscissa.kind, abscissa.unit) == (AbscissaKind.OTHER, "ticks")


def test_a_table_over_frequency_is_recognised_as_a_spectrum() -> None:
    lines = ["Frequency [Hz],base [mm]", *(f"{0.5 * k},{k}" for k in range(40))]
    one = text_table("\n".join(lines)).signals["base"]
    assert (one.kind, one.abscissa.kind) == (SignalKind.SPECTRUM, AbscissaKind.FREQUENCY)


@pytest.mark.parametrize("size", [1_000, 3_000_000])
@pytest.mark.parametrize(
    "text", ["base (", "base [(", "x" * 10 + "((", "sampling rate ", "fs ch 1 ", "fs 1 x ", "1:1:1:", '"', "µ ", "1,1."]
)
def test_a_long_heading_is_read_in_linear_time(text: str, size: int) -> None:
    """A quadratic expression would need hours here, and end at the time limit of the suite."""
    long = (text + "a" * 50) * (size // (len(text) + 50))
    headings.split_unit(long)
    headings.is_time_name(long)
    headings.stated_rate([long])
    try:
        text_table(f"{long}\n1,2\n3,4\n")
    except ImpactRigError:
        return


@pytest.mark.parametrize("text", ["fs ch 1 ", "fs 1 x ", "sample rate (1 "])
def test_many_lines_that_may_contain_a_rate_cost_little_time(text: str) -> None:
    """Looking up each word as a unit would take 6 s for 220 lines."""
    begin = time.process_time()
    headings.stated_rate([text * 40] * 220)
    assert time.process_time() - begin < 3.0


def test_too_many_columns_are_rejected_before_they_are_read(tmp_path: Path) -> None:
    (tmp_path / "wide.csv").write_text("\n".join([",".join(["1.5"] * 200_000)] * 4), encoding="ascii")
    with pytest.raises(ImpactRigError, match="200000 columns in a file, more than 4096"):
        readers.read(tmp_path / "wide.csv")


def test_stamps_with_a_missing_one_are_left_out_with_the_reason() -> None:
    """A missing value makes all stamps floating-point numbers, which have lost their last digits."""
    stamps = 1.7e18 + 1e9 * TIME_S
    stamps[3] = np.nan
    found = signals_of(PATH, "own", {"stamp_ns": stamps, "base": BASE, "laser": LASER})
    assert found.left_out["stamp_ns"] == "times are missing in some rows"
    assert {one.abscissa.kind for one in found.signals.values()} == {AbscissaKind.NONE}


def test_dates_with_a_missing_one_are_left_out_with_the_reason() -> None:
    dates = np.datetime64("2026-11-02T00:00:00", "ns") + (1e9 * TIME_S).astype("timedelta64[ns]")
    dates[3] = np.datetime64("NaT")
    found = signals_of(PATH, "own", {"date": dates, "base": BASE, "laser": LASER})
    assert found.left_out["date"] == "times are missing in some rows"
    assert "times are missing in some rows of column 'date'" in found.signals["base"].abscissa.note


def test_columns_whose_long_headings_begin_alike_are_all_imported() -> None:
    long = "a" * 300
    columns = {"time [s]": TIME_S, f"{long}1": BASE, f"{long}2": LASER}
    found = signals_of(PATH, "own", columns, {f"{long}2": "mm"})
    base, laser = found.signals.values()
    assert np.array_equal(base.values, BASE)
    assert np.array_equal(laser.values, LASER)
    assert (base.unit, laser.unit) == ("", "mm")


# --- LabVIEW


@pytest.mark.parametrize(("separator", "decimal"), [("Tab", "."), ("Tab", ","), ("Comma", ".")])
@pytest.mark.parametrize("x_columns", ["One", "Multi", "No"])
@pytest.mark.parametrize("segments", [1, 2])
@pytest.mark.parametrize("unit", ["mm", "g"])
def test_labview_measurement_files_are_read(
    separator: str, decimal: str, x_columns: str, segments: int, unit: str
) -> None:
    """36 variants of the format."""
    sign = "\t" if separator == "Tab" else ","

    def number(value: float) -> str:
        return f"{value:.6f}".replace(".", decimal)

    lines = [
        "LabVIEW Measurement", f"Writer_Version{sign}2", f"Separator{sign}{separator}",
        f"Decimal_Separator{sign}{decimal}", f"X_Columns{sign}{x_columns}", "***End_of_Header***", "",
    ]  # fmt: skip
    for part in range(segments):
        begin = part * COUNT // segments
        end = (part + 1) * COUNT // segments
        lines += [
            f"Channels{sign}2", f"Samples{sign}{end - begin}{sign}{end - begin}",
            f"Y_Unit_Label{sign}{unit}{sign}{unit}",
            f"X_Dimension{sign}Time{sign}Time", f"X0{sign}{number(begin / RATE_HZ)}{sign}{number(begin / RATE_HZ)}",
            f"Delta_X{sign}{number(1 / RATE_HZ)}{sign}{number(1 / RATE_HZ)}", "***End_of_Header***",
        ]  # fmt: skip
        multi = x_columns == "Multi"
        lines.append(sign.join(["X_Value", "base", *(["X_Value"] if multi else []), "laser", "Comment"]))
        for k in range(begin, end):
            x = "" if x_columns == "No" else number(TIME_S[k])
            lines.append(sign.join([x, number(BASE[k]), *([x] if multi else []), number(LASER[k])]))
    found = labview.read_lines(PATH, lines)
    assert list(found.signals) == ["base", "laser"]
    for one, values in zip(found.signals.values(), (BASE, LASER), strict=True):
        assert one.unit == unit
        assert one.rate_hz == pytest.approx(RATE_HZ)
        assert one.values == pytest.approx(values, abs=1e-6)


@pytest.mark.parametrize(("start", "joined"), [("0.2", True), ("NaN", False), ("0.3", False)])
def test_only_a_labview_segment_that_continues_the_one_before_is_joined(start: str, joined: bool) -> None:
    head = ["LabVIEW Measurement", "Separator\tTab", "X_Columns\tNo", "***End_of_Header***", ""]
    lines = []
    for begin in ("0.0", start):
        lines += ["Channels\t1", f"X0\t{begin}", "Delta_X\t0.1", "***End_of_Header***", "X_Value\tbase"]
        lines += ["\t1.0", "\t2.0"]
    (one,) = labview.read_lines(PATH, head + lines).signals.values()
    assert len(one.values) == (4 if joined else 2)


# --- universal files


def uff(tmp_path: Path, **changes: Any) -> bytes:
    pyuff = pytest.importorskip("pyuff")
    one = {
        "type": 58, "binary": 0, "func_type": 1, "data": BASE, "x": TIME_S, "abscissa_spacing": 1, "id1": "base",
        "id2": "", "rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1, "rsp_ent_name": "base",
        "ref_ent_name": "none", "abscissa_inc": 1 / RATE_HZ, "abscissa_min": 0.0, "abscissa_spec_data_type": 17,
        "abscissa_axis_units_lab": "s", "ordinate_spec_data_type": 8, "ordinate_axis_units_lab": "mm",
        "orddenom_spec_data_type": 0,
    }  # fmt: skip
    (tmp_path / "own.uff").unlink(missing_ok=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pyuff.UFF(str(tmp_path / "own.uff")).write_sets([one | changes], "add")
    return (tmp_path / "own.uff").read_bytes()


def read_uff(tmp_path: Path, content: bytes) -> ImportedSignals:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return universal.read(tmp_path / "own.uff", content, pytest.importorskip("pyuff"))


@pytest.mark.parametrize(("unit", "factor"), [("s", 1.0), ("ms", 1e-3), ("us", 1e-6), ("min", 60.0), ("NONE", 1.0)])
@pytest.mark.parametrize("spacing", [0, 1])
@pytest.mark.parametrize("binary", [0, 1])
def test_abscissas_of_universal_files_are_read(
    tmp_path: Path, unit: str, factor: float, spacing: int, binary: int
) -> None:
    """20 variants."""
    changes = {
        "abscissa_axis_units_lab": unit, "abscissa_spacing": spacing, "binary": binary, "x": TIME_S / factor,
        "abscissa_inc": 1 / RATE_HZ / factor,
    }  # fmt: skip
    one = read_uff(tmp_path, uff(tmp_path, **changes)).signals["base"]
    assert (one.abscissa.step is not None) == bool(spacing)
    rate = one.rate_hz if spacing else 1.0 / np.median(np.diff(one.time_s))
    assert rate == pytest.approx(RATE_HZ, rel=1e-4)


@pytest.mark.parametrize("function", range(29))
@pytest.mark.parametrize(("quantity_code", "unit"), [(17, "s"), (18, "Hz"), (9, "N")])
def test_only_functions_of_time_are_imported_as_time_responses(
    tmp_path: Path, function: int, quantity_code: int, unit: str
) -> None:
    """87 variants: a spectrum over Hz must not be imported as a record over seconds."""
    content = uff(tmp_path, abscissa_spec_data_type=quantity_code, abscissa_axis_units_lab=unit)
    lines = content.split(b"\n")
    lines[7] = f"{function:5d}".encode() + lines[7][5:]  # pyuff writes some types only
    content = b"\n".join(lines)
    if function in (0, 1) and quantity_code == 17:
        assert list(read_uff(tmp_path, content).signals) == ["base"]
    else:
        with pytest.raises(ImpactRigError, match=r"no time response .*: dataset 1 \(base\): (a|no) "):
            read_uff(tmp_path, content)


@pytest.mark.parametrize(
    ("code", "label", "unit"), [(0, "N", "mm"), (1, "NONE", "mm"), (13, "N", "mm/N"), (13, "NONE", "mm/quantity 13")]
)
def test_a_response_per_force_is_not_imported_as_a_motion(tmp_path: Path, code: int, label: str, unit: str) -> None:
    content = uff(tmp_path, orddenom_spec_data_type=code, orddenom_axis_units_lab=label)
    found = read_uff(tmp_path, content)
    assert found.signals["base"].unit == unit
    with pytest.raises(ImpactRigError, match="must be a unit of m") if code == 13 else contextlib.nullcontext():
        convert(found, guess(found))


def test_a_universal_file_without_quantities_is_not_a_time_response(tmp_path: Path) -> None:
    content = uff(tmp_path, abscissa_spec_data_type=0, abscissa_axis_units_lab="NONE", abscissa_axis_lab="NONE")
    assert list(read_uff(tmp_path, content).signals) == ["base"]  # its function type is that of a time response
    lines = content.split(b"\n")
    lines[7] = b"    0" + lines[7][5:]
    with pytest.raises(ImpactRigError, match="neither its function type nor its abscissa states"):
        read_uff(tmp_path, b"\n".join(lines))


def test_a_truncated_universal_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(ImpactRigError, match="the file may be cut off"):
        read_uff(tmp_path, uff(tmp_path)[:700])


# --- rates


@pytest.mark.parametrize("divisor", range(1, 32))
def test_rates_of_divided_clocks_are_exact(divisor: int) -> None:
    """Increments of six digits, as universal files print them."""
    step = float(f"{divisor / 51200:.5e}")
    uncertainty = 0.51e-5 * 10.0 ** np.floor(np.log10(step)) / step**2
    assert likely_rate(1.0 / step, uncertainty) in (51200 / divisor, round(51200 / divisor))


@pytest.mark.parametrize(
    ("step", "rate_hz"),
    [("0.000977", 1024), ("0.000488", 2048), ("0.001", 1000), ("0.008", 125), ("1.953125E-5", 51200),
     ("0,000122", 8192), ("1", 1)],
)  # fmt: skip
def test_a_time_step_of_few_digits_is_completed_to_a_likely_rate(step: str, rate_hz: float) -> None:
    """LabVIEW prints six decimals of Delta_X: a rate of 1024 Hz must not become 1023.54."""
    value = float(step.replace(",", "."))
    assert likely_rate(1.0 / value, half_digit(step) / value**2) == rate_hz


# --- WAV


def wav_file(values: np.ndarray, width: int, *, floating: bool = False, claimed: int | None = None) -> bytes:
    """Return a WAV file of values from -1 to 1, shape (n, channels)."""
    count, channels = values.shape
    if floating:
        data = values.astype(f"<f{width}").tobytes()
    elif width == 1:
        data = np.round(values * 127 + 128).astype(np.uint8).tobytes()
    else:
        whole = np.round(values * (2.0 ** (8 * width - 1) - 2.0 ** max(0, 8 * width - 54))).astype("<i8")
        data = whole.reshape(-1, 1).view(np.uint8).reshape(-1, 8)[:, :width].tobytes()
    block = width * channels
    form = struct.pack("<HHIIHH", 3 if floating else 1, channels, RATE_HZ, RATE_HZ * block, block, 8 * width)
    size = len(data) if claimed is None else claimed * block
    body = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", size) + data
    del count
    return b"RIFF" + struct.pack("<I", len(body)) + body


@pytest.mark.parametrize("channels", [1, 2, 3])
@pytest.mark.parametrize(("width", "floating"), [*((width, False) for width in range(1, 9)), (4, True), (8, True)])
def test_samples_of_every_width_are_scaled_to_full_scale(width: int, floating: bool, channels: int) -> None:
    """30 variants; samples of 36 to 64 bits must not become 1e17."""
    values = np.stack([0.5 * LASER, 0.5 * BASE, 0.9 * LASER][:channels], axis=1)
    found = wav.read(PATH, wav_file(values, width, floating=floating))
    tolerance = (1e-7 if width == 4 else 1e-15) if floating else 2.0 / 2 ** (8 * width - 1) + 1e-15
    for j in range(channels):
        assert found.signals[f"channel_{j}"].values == pytest.approx(values[:, j], abs=tolerance)
        assert found.signals[f"channel_{j}"].rate_hz == RATE_HZ


def test_a_wav_file_shorter_than_its_header_is_reported() -> None:
    found = wav.read(PATH, wav_file(np.stack([BASE, LASER], axis=1), 2, claimed=90))
    assert len(found.signals["channel_0"].values) == COUNT
    assert found.left_out == {
        "end of the file": "the header claims 90 samples per channel, 60 are there: 33% is missing"
    }


# --- TDMS


def tdms_file(channels: dict[str, tuple[np.ndarray, dict[str, Any]]]) -> bytes:
    nptdms = pytest.importorskip("nptdms")
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        writer.write_segment(
            [
                nptdms.ChannelObject("measured", name, values, properties=about)
                for name, (values, about) in channels.items()
            ]
        )
    return file.getvalue()


@pytest.mark.parametrize("unit", ["g", "m/s^2", "mm", "V"])
@pytest.mark.parametrize("key", ["unit_string", "NI_UnitDescription"])
def test_waveforms_of_tdms_files_are_read(tmp_path: Path, unit: str, key: str) -> None:
    about = {"wf_increment": 1 / RATE_HZ, "wf_start_offset": 0.0, key: unit}
    (tmp_path / "own.tdms").write_bytes(tdms_file({"base": (BASE, about), "laser": (LASER, about)}))
    found = readers.read(tmp_path / "own.tdms")
    assert list(found.signals) == ["base", "laser"]
    assert {(one.unit, one.rate_hz, one.kind) for one in found.signals.values()} == {
        (unit, RATE_HZ, SignalKind.TIME_RESPONSE)
    }
    assert found.signals["laser"].values.tolist() == LASER.tolist()


@pytest.mark.parametrize(("late_s", "offset_s"), [(0.5, 0.0), (0.0, 0.5), (2.0, -1.9)])
def test_tdms_channels_that_start_at_different_times_are_not_taken_for_simultaneous(
    tmp_path: Path, late_s: float, offset_s: float
) -> None:
    begin = np.datetime64("2024-05-13T10:00:00", "us")
    about = {"wf_increment": 1 / RATE_HZ, "wf_start_offset": 0.0, "wf_start_time": begin, "unit_string": "mm"}
    later = {**about, "wf_start_time": begin + np.timedelta64(int(1e6 * late_s), "us"), "wf_start_offset": offset_s}
    (tmp_path / "own.tdms").write_bytes(tdms_file({"base": (BASE, about), "laser": (LASER, later)}))
    found = readers.read(tmp_path / "own.tdms")
    assert found.signals["laser"].abscissa.start == pytest.approx(late_s + offset_s)
    with pytest.raises(ImpactRigError, match="has other times than laser"):
        convert(found, guess(found))


@pytest.mark.parametrize(
    ("others", "stated", "rate_hz", "note"),
    [
        ({}, {}, 1.0, "wf_increment is 1 s, as of waveforms without a time step; --scan-rate HZ states another rate"),
        ({}, {"Sample Rate": 125.0}, None, "several rates are stated: 1 Hz (wf_increment), 125 Hz"),
        ({"Time": (TIME_S, {"wf_increment": 1.0, "unit_string": "s"})}, {}, None, ""),
    ],
)
def test_a_tdms_increment_of_1_is_reported_as_a_doubtful_rate(
    tmp_path: Path, others: dict[str, Any], stated: dict[str, Any], rate_hz: float | None, note: str
) -> None:
    """Programs write `wf_increment` 1 for a waveform without a time step."""
    about = {"wf_increment": 1.0, "unit_string": "mm", **stated}
    (tmp_path / "own.tdms").write_bytes(tdms_file({**others, "base": (BASE, about)}))
    one = readers.read(tmp_path / "own.tdms").signals["base"]
    assert (one.rate_hz, one.abscissa.note) == (rate_hz, note)
    assert one.time_s == (pytest.approx(TIME_S) if others else None)


def test_a_tdms_channel_of_times_is_used_as_the_time(tmp_path: Path) -> None:
    (tmp_path / "own.tdms").write_bytes(tdms_file({"Time (ms)": (1e3 * TIME_S, {}), "base": (BASE, {})}))
    found = readers.read(tmp_path / "own.tdms")
    assert list(found.signals) == ["base"]
    assert since_start(found) == pytest.approx(TIME_S)


@pytest.mark.parametrize(
    ("place", "about"),
    [("root", {"Sampling Rate [Hz]": 125.0}), ("group", {"SampleRate": "125"}), ("channel", {"sample_interval_ms": 8})],
)
def test_a_rate_among_the_properties_of_a_tdms_file_is_used(tmp_path: Path, place: str, about: dict[str, Any]) -> None:
    nptdms = pytest.importorskip("nptdms")
    own = {name: about if name == place else {} for name in ("root", "group", "channel")}
    with nptdms.TdmsWriter(str(tmp_path / "own.tdms")) as writer:
        channel = nptdms.ChannelObject("measured", "base", BASE, properties=own["channel"])
        group = nptdms.GroupObject("measured", own["group"])
        writer.write_segment([nptdms.RootObject(own["root"]), group, channel])
    assert readers.read(tmp_path / "own.tdms").signals["base"].rate_hz == pytest.approx(RATE_HZ)


def test_times_in_a_separate_tdms_group_are_used(tmp_path: Path) -> None:
    nptdms = pytest.importorskip("nptdms")
    with nptdms.TdmsWriter(str(tmp_path / "own.tdms")) as writer:
        times = nptdms.ChannelObject("times", "Time", TIME_S, properties={"unit_string": "s"})
        writer.write_segment([times, nptdms.ChannelObject("measured", "base", BASE)])
    found = readers.read(tmp_path / "own.tdms")
    assert list(found.signals) == ["base"]
    assert since_start(found) == pytest.approx(TIME_S)


@pytest.mark.parametrize(
    ("name", "value", "rate_hz"),
    [
        ("fs", 125, 125.0), ("SampleFrequency", 125, 125.0), ("sampling_rate_hz", 125, 125.0), ("rate_kHz", 2, 2000.0),
        ("dt", 0.008, 125.0), ("sample_period", 0.008, 125.0), ("dt_ms", 8, 125.0),
        ("Time Increment [us]", 8000, 125.0),
        ("step", -1.0, None), ("fs", float("nan"), None), ("rate [m]", 1, None), ("steps", 8, None),
        ("offset", 1, None),
    ],
)  # fmt: skip
def test_properties_with_a_rate_or_a_period_are_recognised(name: str, value: float, rate_hz: float | None) -> None:
    found = headings.rate_hz(name, value)
    assert found == (None if rate_hz is None else pytest.approx(rate_hz))


# --- MATLAB


@pytest.mark.parametrize("nested", [False, True])
@pytest.mark.parametrize("time", ["time", "t", "fs", "dt"])
def test_matlab_structs_are_read(tmp_path: Path, time: str, nested: bool) -> None:
    io_ = pytest.importorskip("scipy.io")
    axis = {"fs": RATE_HZ, "dt": 1 / RATE_HZ}.get(time, TIME_S)
    content = {time: axis, "base": BASE, "laser": LASER}
    io_.savemat(tmp_path / "own.mat", {"data": {"part": content}} if nested else {"data": content})
    found = readers.read(tmp_path / "own.mat")
    assert list(found.signals) == ["base", "laser"]
    one = found.signals["base"]
    assert (1.0 / np.median(np.diff(one.time_s)) if one.rate_hz is None else one.rate_hz) == pytest.approx(RATE_HZ)


def test_files_of_matlab_7_3_are_read(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "own.mat", "w", userblock_size=512) as file:
        for name, values in (("time", TIME_S), ("base", BASE), ("laser", LASER)):
            file.create_dataset(f"data/{name}", data=values[None]).attrs["MATLAB_class"] = np.bytes_("double")
        file["data"].attrs["MATLAB_class"] = np.bytes_("struct")
        file.create_dataset("tt", data=np.zeros((1, 6), np.uint32)).attrs["MATLAB_class"] = np.bytes_("timetable")
        file["tt"].attrs["MATLAB_object_decode"] = 3
    with (tmp_path / "own.mat").open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file")
    found = readers.read(tmp_path / "own.mat")
    assert list(found.signals) == ["base", "laser"]
    assert since_start(found) == pytest.approx(TIME_S)
    assert "timetable2table(tt)" in found.left_out["tt"]


# --- hostile files


@pytest.mark.parametrize("suffix", [".mat", ".nc"])
@pytest.mark.parametrize("how", ["external storage", "external link", "virtual", "soft link"])
def test_hdf5_never_opens_another_file(tmp_path: Path, how: str, suffix: str) -> None:
    h5py = pytest.importorskip("h5py")
    np.arange(100.0).tofile(tmp_path / "secret")
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["x"] = np.arange(100.0)
    own = tmp_path / f"own{suffix}"
    with h5py.File(own, "w") as file:
        file.attrs["sample_rate"] = 100.0
        if how == "external storage":
            file.create_dataset("time_data", (100,), "f8", external=[(str(tmp_path / "secret"), 0, 800)])
        elif how == "external link":
            file["time_data"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/x")
        elif how == "soft link":
            file["time_data"] = h5py.SoftLink("/nowhere")
        else:
            layout = h5py.VirtualLayout((100,), "f8")
            layout[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "x", (100,))
            file.create_virtual_dataset("time_data", layout)
    with pytest.raises(ImpactRigError, match=r"not opened|not followed|no variable time_data"):
        readers.read(own)


def test_a_small_archive_is_not_expanded_to_a_large_one(tmp_path: Path) -> None:
    """Less than a megabyte could become 1.6 GB."""
    with zipfile.ZipFile(tmp_path / "own.npz", "w", zipfile.ZIP_DEFLATED) as archive, archive.open("a.npy", "w") as one:
        np.lib.format.write_array_header_1_0(one, {"descr": "<f8", "fortran_order": False, "shape": (20_000_000,)})
        for _ in range(160):
            one.write(bytes(1_000_000))
    with pytest.raises(ImpactRigError, match="bytes of content in a file of"):
        readers.read(tmp_path / "own.npz")


def test_a_small_file_with_a_repeated_value_is_not_expanded_to_a_large_one(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    table = pa.table({"a": pa.array(np.zeros(20_000_000))})
    parquet.write_table(table, tmp_path / "own.parquet", compression="zstd")
    with pytest.raises(ImpactRigError, match="bytes of content in a file of"):
        readers.read(tmp_path / "own.parquet")


READ = """import sys
from pathlib import Path
from impact_rig_studies.importing.readers import read
print(len(read(Path(sys.argv[1])).signals))
"""


@pytest.mark.parametrize("before", ["", "import pyarrow\n"])
def test_a_long_table_is_read_with_any_memory_pool_of_pyarrow(tmp_path: Path, before: str) -> None:
    """Other memory pools than the system's reserve many addresses: 100,000 rows would exceed the reader's limit."""
    pytest.importorskip("pyarrow")
    rows = np.random.default_rng(1).integers(0, 4096, (4, 100_000)) / 4096.0  # a file that is small for its rows
    stamps = np.arange(100_000).astype("datetime64[ns]")
    columns = {"timestamp": stamps, **{f"channel_{k}": one for k, one in enumerate(rows)}}
    path = tmp_path / "own.parquet"
    write_columns(lambda: iter([columns]), path)
    command = [sys.executable, "-c", f"{before}{READ}", path]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout == "4\n", done.stderr


@pytest.mark.parametrize("suffix", sorted(readers.FORMATS))
def test_an_empty_or_irregular_file_is_rejected_at_once(tmp_path: Path, suffix: str) -> None:
    """Reading a pipe would wait forever."""
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"empty{suffix}").touch()
    (tmp_path / f"folder{suffix}").mkdir()
    for name, why in (("pipe", "not a regular file"), ("empty", "is empty"), ("folder", "is a directory")):
        with pytest.raises(ImpactRigError, match=why) as failure:
            readers.read(tmp_path / f"{name}{suffix}")
        assert str(failure.value).count(f"{name}{suffix}") == 1, "the file is named once"


def test_a_reader_that_does_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def endless(path: Path, content: bytes) -> ImportedSignals:
        for _ in itertools.count():
            pass
        raise AssertionError

    monkeypatch.setattr(readers.isolation, "LIMIT_S", 0.0)
    monkeypatch.setitem(readers.FORMATS, ".npz", readers.Format("a file", endless))
    (tmp_path / "own.npz").write_bytes(b"PK")
    with pytest.raises(ImpactRigError, match=r"takes longer to read than \S+ s\b.*, the limit for a file of 2 bytes"):
        readers.read(tmp_path / "own.npz")


@pytest.mark.parametrize("factor", ["1e6", "1e300", "inf"])
def test_a_budget_beyond_the_memory_allows_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, factor: str
) -> None:
    path = tmp_path / "own.csv"
    path.write_text("time,laser\n" + "".join(f"{k / 1000},{k % 7}\n" for k in range(100)))
    monkeypatch.setenv(budget.VARIABLE, factor)
    assert len(readers.read(path).signals["laser"].values) == 100


# --- units

UNITS = {
    "m": {"m": 1.0, "mm": 1e-3, "Millimeter": 1e-3, "millimetres": 1e-3, "MM": 1e-3, "µm": 1e-6, "μm": 1e-6, "um": 1e-6,
          "micron": 1e-6, "cm": 1e-2, "in": 0.0254, "inch": 0.0254, "Inches": 0.0254, "mil": 2.54e-5, "mils": 2.54e-5,
          "thou": 2.54e-5, "[mm]": 1e-3, "meter": 1.0, "nm": 1e-9, "ft": 0.3048, "㎜": 1e-3, "㎛": 1e-6},
    "m/s": {"m/s": 1.0, "mm/s": 1e-3, "mm/sec": 1e-3, "m s^-1": 1.0, "in/s": 0.0254, "ips": 0.0254, "cm/s": 1e-2},
    "m/s^2": {"m/s^2": 1.0, "m/s2": 1.0, "m/s²": 1.0, "m/s**2": 1.0, "m/s/s": 1.0, "m·s⁻²": 1.0, "m s^-2": 1.0,
              "m/sec^2": 1.0, "m/(s^2)": 1.0, "m/(s*s)": 1.0, "mm/s2": 1e-3, "cm/s^2": 1e-2, "g": 9.80665, "G": 9.80665,
              "g's": 9.80665, "gs": 9.80665, "g_n": 9.80665, "mg": 9.80665e-3, "Gal": 1e-2, "in/s^2": 0.0254,
              "㎨": 1.0},
    "A": {"A": 1.0, "mA": 1e-3, "amps": 1.0, "Ampere": 1.0},
    "V": {"V": 1.0, "mV": 1e-3, "Volts": 1.0, "µV": 1e-6},
    "Hz": {"Hz": 1.0, "kHz": 1e3, "1/s": 1.0, "min^-1": 1.0 / 60.0, "rpm": 1.0 / 60.0, "RPM": 1.0 / 60.0,
           "U/min": 1.0 / 60.0, "1/min": 1.0 / 60.0, "rev/s": 1.0, "rad/s": 0.5 / np.pi,
           "rad per sec": 0.5 / np.pi, "deg/s": 1.0 / 360.0, "°/ms": 1e3 / 360.0},
    "s": {"s": 1.0, "sec": 1.0, "ms": 1e-3, "msec": 1e-3, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "S": 1.0},
}  # fmt: skip


@pytest.mark.parametrize(
    ("unit", "si", "factor"), [(unit, si, factor) for si, known in UNITS.items() for unit, factor in known.items()]
)
def test_units_in_the_notation_of_instruments_are_read(
    monkeypatch: pytest.MonkeyPatch, unit: str, si: str, factor: float
) -> None:
    """None of these units needs pint, which the run tier lacks."""
    monkeypatch.setitem(__import__("sys").modules, "pint", None)
    assert quantity(unit) == si
    assert unit_factor(unit, si) == pytest.approx(factor, rel=1e-12)


@pytest.mark.parametrize("unit", ["°", "raw", "N", "kg", "counts", "m/s^3", "", "9**9**9**9", "x" * 300, "m**m", "A/m"])
def test_units_of_other_quantities_are_not_accepted(unit: str) -> None:
    assert quantity(unit) is None
    assert unit_factor(unit, "m") is None


def test_the_interpretation_of_doubtful_units_is_reported() -> None:
    assert [bool(doubt(unit)) for unit in ("G", "gs", "mg", "g", "mm")] == [True, True, True, False, False]


@pytest.mark.parametrize(
    ("text", "volts", "unit"),
    [
        ("500 mV/mm", 500.0, "m"), ("0,5 V/mm", 500.0, "m"), ("100 mV/g", 0.1 / 9.80665, "m/s^2"),
        ("10.2 mV/(m/s^2)", 0.0102, "m/s^2"), ("-2 V/A", -2.0, "A"), ("4 V/(m/s)", 4.0, "m/s"),
        ("10mV/G", 0.01 / 9.80665, "m/s^2"),
    ],
)  # fmt: skip
def test_sensitivities_are_parsed(text: str, volts: float, unit: str) -> None:
    found = Sensitivity.parse(text)
    assert found is not None
    assert found.unit == unit
    assert found.volts == pytest.approx(volts)


@pytest.mark.parametrize(
    "text", ["500", "mV/mm", "500 mm/mV", "0 mV/mm", "5 mV/kg", "1e999 V/m", "a V/m", "5 V/" + "m" * 99]
)
def test_invalid_sensitivities_are_rejected(text: str) -> None:
    assert Sensitivity.parse(text) is None


# --- other containers


def test_a_table_of_records_in_an_archive_is_read(tmp_path: Path) -> None:
    np.savez(tmp_path / "own.npz", table=np.rec.fromarrays([TIME_S, BASE, LASER], names="time,base,laser"))
    found = readers.read(tmp_path / "own.npz")
    assert list(found.signals) == ["base", "laser"]
    assert since_start(found) == pytest.approx(TIME_S)


def test_types_of_parquet_that_numpy_lacks_are_read(tmp_path: Path) -> None:
    """A dictionary must not load pandas in the reader's process, which has a time limit."""
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    decimals = arrow.array([decimal.Decimal(f"{one:.6f}") for one in BASE], arrow.decimal128(12, 6))
    words = arrow.array(["on"] * COUNT).dictionary_encode()
    parquet.write_table(arrow.table({"time": TIME_S, "base": decimals, "state": words}), tmp_path / "own.parquet")
    found = readers.read(tmp_path / "own.parquet")
    assert found.signals["base"].values == pytest.approx(BASE, abs=6e-7)
    assert found.texts["state"][0] == "on"


def test_classic_netcdf_is_rejected_by_name(tmp_path: Path) -> None:
    (tmp_path / "own.nc").write_bytes(b"CDF\1" + bytes(200))
    with pytest.raises(ImpactRigError, match="classic format"):
        readers.read(tmp_path / "own.nc")


def test_an_extensible_wav_file_of_the_other_byte_order_is_read() -> None:
    """The first group of the GUID has the byte order of the file; otherwise, the encoding is read as 0."""
    form = struct.pack(">HHIIHH", 0xFFFE, 1, 125, 500, 4, 32) + struct.pack(">HHII", 22, 32, 0, 3) + bytes(12)
    data = LASER.astype(">f4").tobytes()
    body = b"WAVEfmt " + struct.pack(">I", len(form)) + form + b"data" + struct.pack(">I", len(data)) + data
    found = wav.read(PATH, b"RIFX" + struct.pack(">I", len(body)) + body)
    assert found.signals["channel_0"].values == pytest.approx(LASER, abs=1e-7)


def test_a_channel_with_another_time_base_is_recognised_and_rejected_with_a_remedy(tmp_path: Path) -> None:
    files = {"base": (BASE, {"wf_increment": 0.008, "unit_string": "mm"})}
    files["laser"] = (LASER, {"wf_increment": 0.004, "unit_string": "mm"})
    (tmp_path / "own.tdms").write_bytes(tdms_file(files))
    found = readers.read(tmp_path / "own.tdms")
    with pytest.raises(ImpactRigError, match=r"has other times than .*--resample HZ"):
        convert(found, guess(found))


@pytest.mark.parametrize(("first", "then", "order"), [("3/14", "14/3", "month/day"), ("14/3", "3/14", "day/month")])
def test_dates_that_contradict_each_other_are_left_out_with_the_order_in_which_they_are_read(
    first: str, then: str, order: str
) -> None:
    rows = [f"{day}/2026 1:00:0{k},{k}" for k, day in enumerate((first, first, then))]
    left_out = text_table("\n".join(["Date,laser [mm]", *rows])).left_out
    assert left_out == {
        "Date": f"a time that cannot be read: {then}/2026 1:00:02, read as {order}/year like the others"
    }


@pytest.mark.parametrize(
    ("stem", "hz", "gap_m"),
    [
        ("messung_9,1Hz_gap_0,5mm", 9.1, 0.5e-3), ("run-9p1hz-gap-0p5mm", 9.1, 0.5e-3), ("gap=6mm_f=9.1Hz", 9.1, 6e-3),
        ("Kugel20mm_gap6mm", None, 6e-3), ("20mm_sphere_6mm_gap", None, 6e-3), ("x1_0.1mm_Spalt 8 mm", None, 8e-3),
        ("0.5mm-2mm_sweep", None, None), ("gap500um_9.1Hz", 9.1, 0.5e-3), ("9.1HzGap6mm", 9.1, 6e-3),
        ("fs1000Hz_9.1Hz", 9.1, None), ("8-10Hz_sweep", None, None), ("9.1Hz_9.1Hz", 9.1, None),
        ("8Hz_10Hz", None, None), ("ohne_Kugel_2kHz", 2000.0, 0.0), ("amp3mm", None, 3e-3), ("91 hz", 91.0, None),
        *((stem, None, None) for stem in (
            "Fs1000Hz", "fs_1000Hz", "fs=51200Hz", "sr48000Hz", "rate 1000Hz", "SamplingRate_1kHz", "sampled@30kHz",
            "sampling_10kHz", "sampling freq. 10 kHz", "sine_64kHz_sampling_ref", "Abtastrate5kHz", "x_2kHz_Sampled",
        )),
        *((stem, 9.0, None) for stem in (
            "9Hz_fs1000Hz", "9Hz_fs1000", "9 Hz sampled at 1 kHz", "9Hz_fsweep", "sample_9Hz", "9Hz_sample_3",
            "moderate_9Hz", "9Hz_sampling_freq_1000Hz", "1000Hz_sampling_9Hz", "9Hz_sampling_1kHz", "2kHz_fs_9Hz",
        )),
    ],
)  # fmt: skip
def test_frequency_and_gap_are_read_from_a_file_name(stem: str, hz: float | None, gap_m: float | None) -> None:
    """Numbers that contradict each other give no guess; a gap with its name is read."""
    assert file_names.frequency_hz(stem) == hz
    assert file_names.gap_m(stem) == (None if gap_m is None else pytest.approx(gap_m))


def test_an_attribute_without_a_value_counts_as_missing(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "own.h5", "w") as file:
        file.attrs["sample_rate"], file.attrs["empty"], file.attrs["none"] = 2.0, np.empty(0), h5py.Empty("f8")
        found = [hdf5.attribute(file, name) for name in ("sample_rate", "empty", "none", "absent")]
    assert found == [2.0, None, None, None]


def test_a_recorder_that_writes_a_chunk_for_each_sample_is_read(tmp_path: Path) -> None:
    """Rattlesnake writes such files. HDF5 needs 2 kB for each chunk in one request, which must not exceed the limit."""
    h5py = pytest.importorskip("h5py")
    values = np.arange(2 * 90_000, dtype=float).reshape(2, -1)
    with h5py.File(tmp_path / "own.nc4", "w") as file:
        file.attrs["sample_rate"] = 10_000.0
        data = file.create_dataset("time_data", values.shape, "f8", chunks=(2, 1), maxshape=(2, None))
        for k in range(values.shape[1]):
            data.id.write_direct_chunk((0, k), np.ascontiguousarray(values[:, k]).tobytes())
        about = file.create_group("channels")
        about["comment"], about["unit"] = ["base", "laser"], ["mm", "mm"]
    found = readers.read(tmp_path / "own.nc4")
    assert [one.values.tolist() for one in found.signals.values()] == values.tolist()
