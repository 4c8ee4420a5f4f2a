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
"""Uniform time base of imported signals: the scan rate that the file states, or the rate of its listed times.

Times and steps are written with few digits, so the rate is known only within an interval. `likely_rate` selects the
most plausible rate in this interval, such as a whole number.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping as AnyMapping
from pathlib import Path

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.blocks import LONGEST_S, MOST_HZ
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.system import budget
from impact_rig_studies.importing.limits import VALUES
from impact_rig_studies.importing.mapping import Mapping
from impact_rig_studies.importing.signals import Abscissa, AbscissaKind, Real

LEAST_HZ = 1.0
EVEN = 0.02  # of a period: departure from a uniform grid that counts as jitter of the clock
HOLE = 2.5  # in periods: a step this long between two scans is no unevenness; scans are missing there
STATED = 0.5  # of a period: departure of listed times from the rate that the same file states
CLOCKS_HZ = (51_200.0, 102_400.0, 204_800.0, 65_536.0, 131_072.0, 48_000.0, 96_000.0, 44_100.0, 50_000.0, 100_000.0)
"""Rates [Hz] of the clocks of data acquisition boards, which divide them by whole numbers."""
LARGEST_DIVISOR = 4096
EXACT = 1e-9  # relative uncertainty of a rate that is written with all its digits
DECIMALS = 9
RESAMPLED_VALUES, RESAMPLED_PER_VALUE = 500_000, 20
"""Largest number of values after resampling: in total, or per value of the file if that is more."""
MOSTLY = 0.9
REGULAR = 0.5  # relative departure of steps from their median up to which the degree of the spline is 5
FEWEST = 2  # scans that several time bases must have in common
Rate = int | float  # scans per second: int for a whole number


@attrs.frozen(eq=False)
class Grid:
    """Signals at uniform times: the value at position i belongs to the time `index[i] / rate_hz` [s] after scan 0.

    Scan 0 is the first scan of the file. `index` has gaps where scans are missing.
    """

    rate_hz: Rate
    index: NDArray[np.int64]  # number of each scan from the first, shape (n,)
    signals: dict[str, Real]  # values by channel, shape (n,) each
    followed: dict[str, Real]  # frequency and gap where signals give them, shape (n,) each


def aligned(
    path: Path, abscissas: AnyMapping[str, Abscissa], found: AnyMapping[str, Real]
) -> tuple[Abscissa, dict[str, Real]]:
    """Return common times for signals with different times, and the signals interpolated at the common times.

    The common times are those of the signal with the smallest period. They extend from the latest start to the earliest
    end of all signals.

    Raises:
        ConfigError: a signal has neither times nor a rate, misses scans, or has fewer than 2 values. Or its times do
            not increase, a value is not finite, or the signals overlap in time by fewer than two samples.
    """
    times: dict[str, Real] = {}
    for name, one in abscissas.items():
        if one.kind is not AbscissaKind.TIME:
            raise ConfigError(
                f"{path}: {name} cannot be resampled at the times of the other signals, it has {one}: give it times "
                f"or a rate in the file, or leave it out (--channel {name}=)"
            )
        listed = one.values if one.values is not None else np.arange(len(found[name])) * (one.step or 0.0)
        times[name] = np.asarray(one.start + listed)
        steps = np.diff(times[name])
        increase = len(steps) > 0 and float(steps.min()) > 0.0
        if not increase or float(steps.max()) > HOLE * float(np.median(steps)):
            if increase:
                why = f"its times have a hole of {float(steps.max()):.4g} s"
            elif len(steps):
                why = f"its times do not increase at value {int(np.argmin(steps)) + 2} of {len(steps) + 1}"
            else:
                why = "it has fewer than 2 values"
            raise ConfigError(f"{path}: {name} cannot be resampled: {why}; leave it out (--channel {name}=)")
        _require_finite(path, name, found[name])
    densest = min(times.values(), key=lambda one: float(np.median(np.diff(one))))
    begin, end = max(one[0] for one in times.values()), min(one[-1] for one in times.values())
    common = densest[(densest >= begin) & (densest <= end)]
    if len(common) < FEWEST:
        raise ConfigError(
            f"{path}: the signals of {', '.join(times)} hardly overlap in time: between the latest start and the "
            f"earliest end there are fewer than {FEWEST} samples; leave out the signal from "
            "another time (--channel NAME=)"
        )
    there = {name: _spline(times[name], values)(common) for name, values in found.items()}
    return Abscissa(AbscissaKind.TIME, "s", float(common[0]), values=common - common[0]), there


def _require_finite(path: Path, name: str, values: Real) -> None:
    if not np.all(np.isfinite(values)):
        wrong = int(np.argmin(np.isfinite(values)))
        raise ConfigError(
            f"{path}: {name} cannot be resampled: value {wrong + 1} is not a finite number; leave it out "
            f"(--channel {name}=)"
        )


def _spline(times: Real, values: Real) -> scipy.interpolate.BSpline:
    """Return the interpolating spline through values at increasing times.

    Its degree is 5 at nearly uniform times, which is more accurate, and 3 otherwise, because degree 5 would amplify
    noise there. With few values the degree is lower.
    """
    steps = np.diff(times)
    is_regular = bool(np.all(np.abs(steps / np.median(steps) - 1.0) < REGULAR))
    return scipy.interpolate.make_interp_spline(times, values, k=min(5 if is_regular else 3, len(times) - 1))


def likely_rate(measured_hz: float, uncertainty_hz: float) -> Rate:
    """Return the exact rate [Hz] that most likely underlies a measured rate within its uncertainty.

    A whole rate is an int, any other rate a float. The result is the first of these rates that exists within the
    uncertainty:

    1. the only whole number there, or the whole number that equals the measured rate;
    2. a usual clock rate (`CLOCKS_HZ`) divided by a whole number;
    3. the nearest whole number;
    4. the measured rate itself.
    """
    low, high = measured_hz - uncertainty_hz, measured_hz + uncertainty_hz
    whole = round(measured_hz)
    is_whole = whole >= 1 and low <= whole <= high
    if is_whole and (abs(whole - measured_hz) <= EXACT * measured_hz or not (low <= whole - 1 or whole + 1 <= high)):
        return whole
    for clock in CLOCKS_HZ:
        divisor = round(clock / measured_hz)
        if 1 <= divisor <= LARGEST_DIVISOR and low <= clock / divisor <= high:
            rate = clock / divisor
            return round(rate) if rate == round(rate) else rate
    return whole if is_whole else measured_hz


def uniform(
    path: Path, abscissa: Abscissa, mapping: Mapping, found: dict[str, Real], followed: dict[str, Real]
) -> Grid:
    """Return the signals of all channels at uniform times, resampled if the mapping requests it.

    Args:
        path: the file, for messages.
        abscissa: times or rate in the file.
        mapping: mapping of the file; a rate in it takes precedence over the file's times.
        found: values by channel, shape (n,) each.
        followed: signals that give frequency or gap, shape (n,) each.

    Raises:
        ConfigError: neither times nor a rate are known, the times do not increase, span more than `LONGEST_S`, or are
            not uniform (without resampling). Or a rate is out of range, or a value to resample is not finite.
        RecordingError: times and values differ in number, or there are fewer than 2 values.
        BudgetError: resampling would give too many values.
    """
    count = len(next(iter(found.values())))
    if count < 2:
        raise RecordingError(
            f"{path}: a measurement needs at least 2 values of each signal, got {count}; check that the file was "
            "exported completely"
        )
    times, stated = _basis(path, abscissa, mapping, count)
    if times is None:
        assert stated is not None
        rate, index = stated, np.arange(count)
        times = index / float(rate)
    else:
        rate, index = _measured(path, times, resampled=mapping.resample_hz is not None)
    if not float(times[-1]) <= LONGEST_S:
        raise ConfigError(
            f"{path}: its times span {float(times[-1]):.3g} s, more than {LONGEST_S:g} s; correct the unit of the "
            "times in the file, or give the true rate (--scan-rate HZ)"
        )
    if mapping.resample_hz is not None:
        return _resampled(path, times, found, followed, float(rate), mapping.resample_hz)
    if not LEAST_HZ <= rate <= MOST_HZ:
        raise ConfigError(
            f"{path}: the rate must be {LEAST_HZ:g} to {MOST_HZ:g} scans per second, got {rate:.6g}; if the file "
            "states a wrong rate or wrong times, give the true rate (--scan-rate HZ)"
        )
    return Grid(rate, index, found, followed)


def _basis(path: Path, abscissa: Abscissa, mapping: Mapping, count: int) -> tuple[Real | None, Rate | None]:
    """Return the listed times [s] or the rate [Hz] that applies, as (times, None) or (None, rate).

    The rate of the mapping takes precedence, then the rate that the file states, then the listed times. A stated rate
    does not apply if the listed times contradict it.

    Raises:
        ConfigError: neither times nor a rate are known, or the mapping's rate is out of range.
        RecordingError: times and values differ in number.
    """
    if mapping.rate_hz is not None:
        if not 0.0 < mapping.rate_hz <= MOST_HZ:
            raise ConfigError(
                f"the scan rate (--scan-rate, or rate_hz in --mapping) must be > 0 and <= {MOST_HZ:g} Hz, got "
                f"{mapping.rate_hz:g}"
            )
        whole = round(mapping.rate_hz)
        return None, whole if whole == mapping.rate_hz else mapping.rate_hz
    if abscissa.kind is AbscissaKind.NONE:
        raise ConfigError(
            f"{path} has neither times nor a rate that are recognised{_explained(abscissa)}: "
            "give the rate (--scan-rate HZ), in scans per second"
        )
    if abscissa.kind is not AbscissaKind.TIME:
        raise ConfigError(
            f"{path}: its abscissa [{abscissa.unit or 'no unit'}] is not a time{_explained(abscissa)}; "
            "if it is one, give the rate (--scan-rate HZ), in scans per second"
        )
    times = abscissa.values
    if times is not None and len(times) != count:
        raise RecordingError(
            f"{path} has {len(times)} times for {count} values; each value needs one time, or give the rate "
            "(--scan-rate HZ) to ignore the times"
        )
    if abscissa.step is None:
        return times, None
    rate = 1.0 / abscissa.step
    if times is not None and not np.all(np.abs(times * rate - np.arange(count)) < STATED):
        return times, None
    return None, likely_rate(rate, rate * max(EXACT, abscissa.resolution / abscissa.step))


def _explained(abscissa: Abscissa) -> str:
    return f" ({abscissa.note})" if abscissa.note else ""


def _measured(path: Path, times: Real, *, resampled: bool) -> tuple[Rate, NDArray[np.int64]]:
    """Return the scan rate [Hz] of listed times [s after the first], and the number of each scan.

    Missing scans leave gaps in the numbers. If the times are not uniform or scans are missing, but the signals will be
    `resampled`, the rate is that of the median step, and the numbers have no gaps.

    Raises:
        ConfigError: a time is not finite, the times do not increase, or they are not uniform and not `resampled`.
    """
    count = len(times)
    if not np.all(np.isfinite(times)):
        place = int(np.argmin(np.isfinite(times)))
        raise ConfigError(
            f"{path}: time {place + 1} of {count} is not a finite number; give the rate (--scan-rate HZ) to ignore the "
            "times"
        )
    steps = np.diff(times)
    digit = 0.0 if _mostly_equal(steps) else last_digit(times)
    span = float(times[-1])
    if span > 0.0:  # no scans missing, times rounded
        mean = (count - 1) / span
        rate = likely_rate(mean, mean * max(EXACT, digit / span))
        if np.all(np.abs(times - np.arange(count) / rate) <= 1.05 * digit + EVEN / rate) and (
            digit * mean > 0.5 or np.all(steps > 0.0)
        ):
            return rate, np.arange(count)
    if not np.all(steps > 0.0):
        place = int(np.argmin(steps)) + 1
        raise ConfigError(
            f"{path}: times must increase, and do not at value {place + 1} of {count}; give the rate (--scan-rate HZ) "
            "to ignore the times"
        )
    rate = 1.0 / float(np.median(steps))
    if resampled:
        return rate, np.arange(count)
    rate = _without_holes(times, rate, digit)
    index = np.round(times * rate).astype(np.int64)
    if index[-1] > 0:
        rate = likely_rate(index[-1] / span, index[-1] / span * max(EXACT, digit / span))
        index = np.round(times * rate).astype(np.int64)
    off = np.abs(times * rate - index)
    if np.any(np.diff(index) < 1) or float(off.max()) > EVEN + digit * rate:
        scan = int(np.argmax(off))
        raise ConfigError(
            f"{path}: not uniform in time: the time of value {scan + 1} is {off[scan]:.2f} of a period off {rate:.7g} "
            "scans per second; resample the signals (--resample HZ), or give the rate (--scan-rate HZ) if the times "
            "are wrong"
        )
    return rate, index


def _without_holes(times: Real, rate: float, digit: float) -> float:
    """Return the scan rate [Hz] of the longest part of the times [s] without a missing scan.

    `rate` is a first estimate. `digit` is the value of the last digit with which the times are written [s], or 0 if
    most steps are equal.
    """
    holes = np.flatnonzero(np.diff(times) > (1.5 + digit * rate) / rate) + 1
    cuts = [0, *holes.tolist(), len(times)]
    begin, end = max(itertools.pairwise(cuts), key=lambda cut: cut[1] - cut[0])
    seconds = float(times[end - 1] - times[begin])
    if not seconds > 0.0:
        return rate
    measured = (end - 1 - begin) / seconds
    return float(likely_rate(measured, measured * max(EXACT, digit / seconds)))


def _mostly_equal(steps: Real) -> bool:
    """Return whether more than the fraction `MOSTLY` of the steps is equal.

    Different steps are then due to missing scans, not to rounding.
    """
    middle = float(np.median(steps))
    return bool(np.mean(np.abs(steps - middle) <= 1e-6 * abs(middle)) > MOSTLY)


def last_digit(times: Real) -> float:
    """Return the value of the last decimal digit with which times are written [s], such as 0.001.

    Times with more than `DECIMALS` decimals give the spacing of single-precision numbers at the last time.
    """
    for decimals in range(DECIMALS + 1):
        scaled = times * 10.0**decimals
        noise = 8.0 * float(np.spacing(np.abs(scaled).max()))
        if noise < 0.1 and np.all(np.abs(scaled - np.round(scaled)) <= max(noise, 1e-6)):
            return float(10.0**-decimals)
    return float(np.spacing(np.float32(times[-1])))  # times are often kept in single precision


def _resampled(
    path: Path, times: Real, found: dict[str, Real], followed: dict[str, Real], exact: float, rate: int
) -> Grid:
    """Return the signals, interpolated at the requested `rate` [Hz].

    `exact` is the scan rate of the file [Hz]. Nothing is interpolated across missing scans (a step of more than `HOLE`
    periods). A single scan between two such gaps is dropped. The signals in `followed` (frequency and gap) keep their
    value until the next value.

    Raises:
        ConfigError: the requested rate is too high, or lower than that of the file, which would alias. Or a value is
            not finite.
        BudgetError: there would be too many values.
    """
    if not exact * (1.0 - 1e-4) <= rate <= MOST_HZ:
        raise ConfigError(
            f"{path}: the rate for resampling (--resample, or resample_hz in --mapping) must be at least that of the "
            f"file, {exact:.6g} Hz, and at most {MOST_HZ:g} Hz, got {rate} Hz"
        )
    given = sum(map(len, found.values()))
    most = min(VALUES, max(RESAMPLED_VALUES, RESAMPLED_PER_VALUE * given))
    budget.allow("values after resampling", float(times[-1]) * rate * len(found), most)
    for name, values in found.items():
        _require_finite(path, name, values)
    index = np.arange(int(times[-1] * rate) + 1, dtype=np.int64)
    place = np.searchsorted(times, (index + 1e-3) / rate, side="right") - 1  # a time may be rounded up
    cuts = [0, *(np.flatnonzero(np.diff(times) * exact > HOLE) + 1).tolist(), len(times)]
    parts = []
    for begin, end in itertools.pairwise(cuts):
        first, last = np.searchsorted(index / rate, (times[begin], times[end - 1] + 1e-9 / rate))
        if end - begin > 1:
            parts.append((slice(begin, end), index[first:last]))
    splined = {
        name: np.concatenate([_spline(times[part], values[part])(own / rate) for part, own in parts])
        for name, values in found.items()
    }
    index = np.concatenate([own for _, own in parts])
    return Grid(rate, index, splined, {key: values[place[index]] for key, values in followed.items()})
