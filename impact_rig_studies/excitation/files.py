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
"""Inputs of excitation tests: readers of YAML plans, and of time histories in runs, CSV, WAV, npz and other files."""

from __future__ import annotations

import itertools
import math
import sys
from fractions import Fraction
from pathlib import Path
from typing import TypeGuard, TypeVar

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.errors import ConfigError, RecordingError, did_you_mean
from impact_rig.names import yaml_quoted
from impact_rig.recording import open_run
from impact_rig.runs.excerpts import calibration_rows
from impact_rig.system import budget
from impact_rig_studies.campaign.tasks import load_plan
from impact_rig_studies.excitation.random import Spectrum
from impact_rig_studies.excitation.response import Response
from impact_rig_studies.importing import readers
from impact_rig_studies.importing.limits import VALUES
from impact_rig_studies.importing.steps import step_of
from impact_rig_studies.importing.units import unit_factor

P = TypeVar("P", bound=attrs.AttrsInstance)
MOST_RATIO = 1000  # largest value of the smaller of the two integers whose ratio approximates new over old rate


def load(path: Path, kind: type[P]) -> P:
    """Read the plan of an excitation test from a YAML file.

    Args:
        path: path of the file.
        kind: class of the plan, such as `RandomPlan`, whose attributes are the keys of the file.

    Raises:
        ConfigError: the file cannot be read, or a key or value is wrong; the message names key, value and file.
    """
    return load_plan(path, "the plan of the test", lambda document, _: read(document, kind))


def read(document: object, kind: type[P]) -> P:
    """Convert a parsed YAML document, or a nested part of it, to a plan.

    Args:
        document: the document, which must be a mapping.
        kind: class of the plan, whose attributes are the keys; keys that are missing have the default values.

    Raises:
        ConfigError: a key or value is wrong, or a key without default is missing; the message names it.
    """
    fields = {one.name: one for one in attrs.fields(kind)}
    if not isinstance(document, dict):
        shown = yaml_quoted(document)[:60]
        raise ConfigError(f"a mapping is needed, with keys from {', '.join(fields)}; got {shown}")
    values: dict[str, object] = {}
    for key, value in document.items():
        if key not in fields:
            known = f", known: {', '.join(fields)}"
            raise ConfigError(f"unknown key {key}{did_you_mean(str(key), fields, otherwise=known)}")
        values[key] = _value(str(key), value, fields[key].type)
    if missing := [name for name, one in fields.items() if one.default is attrs.NOTHING and name not in values]:
        raise ConfigError(f"missing: {', '.join(missing)}; add a value for each of these keys")
    try:
        return kind(**values)
    except (ValueError, TypeError) as error:
        raise ConfigError(" ".join(str(error.args[0]).split())) from error


def _value(key: str, value: object, kind: object) -> object:
    shown = yaml_quoted(value)[:60]
    if kind == "Spectrum":
        try:
            found = read(value, Spectrum)
        except ConfigError as error:
            raise ConfigError(f"{key}: {error}") from error
        f, densities = found.frequency_hz, found.density
        unordered = next(((one, after) for one, after in itertools.pairwise(f) if not one < after), None)
        if len(f) < 2:
            rule = f"frequency_hz must have at least 2 values, one for each corner, got {len(f)}"
        elif len(f) != len(densities):
            rule = f"density must have as many values as frequency_hz, {len(f)}, got {len(densities)}"
        elif not f[0] > 0.0:
            rule = f"frequency_hz must be > 0 Hz, got {f[0]:g}"
        elif unordered is not None:
            rule = f"frequency_hz must be ascending, got {unordered[1]:g} after {unordered[0]:g}"
        elif not all(one > 0.0 for one in densities):
            wrong = next(one for one in densities if not one > 0.0)
            rule = f"density must be > 0 (in unit of the response² / Hz), got {wrong:g}"
        else:
            return found
        raise ConfigError(f"{key}: {rule}")
    if kind == "tuple[float, ...]":
        if not isinstance(value, list) or not all(_is_number(one) for one in value):
            raise ConfigError(f"{key} must be a list of numbers, got {shown}")
        return tuple(float(one) for one in value)
    if kind in ("Response", "str"):
        if kind == "Response" and value not in [*Response]:
            allowed = ", ".join(Response)
            raise ConfigError(f"{key}, the response that the test controls, must be one of {allowed}, got {shown}")
        return value
    if not _is_number(value) or (kind == "int" and not isinstance(value, int)):
        raise ConfigError(f"{key} must be {'a whole number' if kind == 'int' else 'a number'}, got {shown}")
    return value if kind == "int" else float(value)


def _is_number(value: object) -> TypeGuard[int | float]:
    """Return whether a value is a number that a float can represent; true and false are none."""
    if isinstance(value, int) and not isinstance(value, bool):
        return abs(value) <= sys.float_info.max
    return isinstance(value, float)


def history(
    path: Path,
    rate_hz: int,
    wanted: str,
    name: str | None = None,
    channel: str | None = None,
    unit: str = "",
    scale: float = 1.0,
    file_hz: float | None = None,
) -> NDArray[np.float64]:
    """Read a time history from a file or a recorded run, convert it to SI units, and resample it for the rig.

    Args:
        path: a run (a directory, or a file `.mcap`), or another file that `impact-rig import` reads.
        rate_hz: number of samples per second of the result.
        wanted: SI unit of the result, such as m or A.
        name: name of the signal in a file, or of the channel in a run; None means the only signal of a file, or
            `channel` of a run.
        channel: default channel of a run; None means current.
        unit: unit of the file's values, if the file states none or a wrong one; empty means the unit that the file
            states, or else `wanted`. It is an error for a run, which states the units of its channels.
        scale: factor by which the values are multiplied.
        file_hz: number of samples per second of a file that states neither times nor a rate. It is an error for any
            other file, and for a run.

    Returns:
        The samples, shape (n,).

    Raises:
        ConfigError: the signal or its rate is not known, its times are not evenly spaced, `rate_hz` is < 1, or the unit
            cannot be converted to `wanted`.
        RecordingError: the file is damaged, scans or calibration of the run are missing, or the signal is empty or not
            finite.
        BudgetError: the result would have too many samples.
    """
    is_run = path.is_dir() or path.suffix == ".mcap"
    if is_run:
        if unit or file_hz is not None:
            option = "--unit" if unit else "--file-rate"
            raise ConfigError(f"{path}: a run states the units and the rate of its channels: omit {option}")
        values, found_hz, unit = _of_run(path, name or channel or "current")
    else:
        values, found_hz, unit = _of_file(path, name, unit, file_hz)
    if unit:
        to_si = unit_factor(unit, wanted)
        if to_si is None:
            raise ConfigError(
                f"{path}: {unit!r} cannot be converted to {wanted}, which is needed here: choose another "
                f"{'channel with --signal' if is_run else 'signal, or state the unit of its values with --unit'}"
            )
        scale *= to_si
    if rate_hz < 1:
        raise ConfigError(f"the scan rate of the rig (--scan-rate) must be a whole number of Hz above 0, got {rate_hz}")
    if not len(values) or not np.all(np.isfinite(values)):
        count = np.count_nonzero(~np.isfinite(values))
        problem = f"{count} of its {len(values)} values are not finite" if len(values) else "it has no values"
        raise RecordingError(f"{path}: the signal cannot be played: {problem}; choose another signal or file")
    if rate_hz >= found_hz:
        ratio = Fraction(rate_hz / found_hz).limit_denominator(MOST_RATIO)
    else:  # the denominator leaves too few digits of a small number
        ratio = 1 / Fraction(found_hz / rate_hz).limit_denominator(MOST_RATIO)
    budget.allow(f"samples at {rate_hz} Hz of {path}", int(len(values) * ratio), VALUES)
    if ratio == 1:
        return scale * values
    return np.asarray(scale * scipy.signal.resample_poly(values, ratio.numerator, ratio.denominator), np.float64)


def _of_run(path: Path, name: str) -> tuple[NDArray[np.float64], float, str]:
    with open_run(path) as run:
        tables = list(run.tables(topics.SCAN, recorded_order=True))
        if not tables:
            raise RecordingError(f"{path}: the run contains no scans, so there is no signal to play; use another run")
        units = {row["name"].decode(): row["unit"].decode() for row in calibration_rows(run)}
    channels = [one for one in tables[0].rows.dtype.names or () if one in units]
    if name not in channels:
        raise ConfigError(f"{path} has no channel {name!r}; choose one by --signal NAME: {', '.join(channels)}")
    rows = np.concatenate([table.rows[name] for table in tables]).astype(float)
    seconds = (tables[-1].stamp_ns - tables[0].stamp_ns) * 1e-9 + float(tables[-1].rows["time"][-1])
    if len(rows) < 2:
        raise RecordingError(f"{path}: the run has only one scan, too few to play; record at least two")
    rate_hz = (len(rows) - 1) / seconds if seconds > 0.0 else math.nan
    for table, after in itertools.pairwise(tables):
        if not abs((after.stamp_ns - table.stamp_ns) * 1e-9 * rate_hz - len(table.rows)) <= 0.5:
            raise RecordingError(
                f"{path}: scans of the run are missing or out of order, but a signal to play must have no gap; use "
                "another run"
            )
    return rows, round(rate_hz, 3), units[name]


def _of_file(path: Path, name: str | None, unit: str, file_hz: float | None) -> tuple[NDArray[np.float64], float, str]:
    signals = readers.read(path).signals
    if name is None and len(signals) == 1:
        name = next(iter(signals))
    if name is None or name not in signals:
        problem = "the file has several signals" if name is None else f"the file has no signal {name!r}"
        raise ConfigError(f"{path}: {problem}; choose one by --signal NAME: {', '.join(signals)[:300]}")
    one = signals[name]
    rate = one.rate_hz
    if rate is None and one.time_s is not None and len(one.time_s) > 1:
        rate = _even_rate(path, one.time_s)
    if file_hz is not None and not 0.0 < file_hz < math.inf:
        raise ConfigError(f"--file-rate must be > 0 Hz and finite, got {file_hz:g}")
    if rate is not None and file_hz is not None:
        raise ConfigError(f"{path}: the file states {rate:g} samples per second: omit --file-rate")
    rate = rate or file_hz
    if rate is None or not rate > 0.0:
        raise ConfigError(
            f"{path}: the file states neither a rate nor two times or more, so it cannot be played: add its samples "
            "per second with --file-rate HZ"
        )
    return one.values, rate, unit or one.unit


def _even_rate(path: Path, time_s: NDArray[np.float64]) -> float:
    """Return the rate of evenly spaced times [1/s]; rounding and jitter are allowed.

    ConfigError is raised if the last time is not after the first, or a time is too far from the even grid. Too far
    means more than half a period and more than the resolution of the times (`step_of`).
    """
    period_s = float(time_s[-1] - time_s[0]) / (len(time_s) - 1)
    if not period_s > 0.0:
        raise ConfigError(
            f"{path}: the times do not increase: the last is {float(time_s[-1]):g} s after the first; correct them, or "
            "remove them from the file and state its samples per second with --file-rate HZ"
        )
    off_s = np.abs(time_s - time_s[0] - period_s * np.arange(len(time_s)))
    if not np.all(off_s <= max(0.5 * period_s, step_of(time_s))):
        worst = int(np.argmax(np.where(np.isfinite(off_s), off_s, np.inf)))
        raise ConfigError(
            f"{path}: the times are not evenly spaced: the one of value {worst + 1} is {off_s[worst]:.4g} s off, "
            f"more than half of the mean period of {period_s:.6g} s; resample the signal to even times"
        )
    return 1.0 / period_s
