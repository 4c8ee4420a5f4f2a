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
"""Conversion of imported signals to scans, calibration, drive and labels of a run."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as AnyMapping
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.scans import CHANNELS
from impact_rig.analysis.settings import GapLabel
from impact_rig.blocks import DAQ_INFO, Column, row_type
from impact_rig.errors import ConfigError, ImpactRigError, RecordingError, did_you_mean
from impact_rig.simtime import NS_PER_S, stamp_ns
from impact_rig_studies.importing import units
from impact_rig_studies.importing.mapping import CALIBRATION, OTHER_UNIT, Channel, Mapping
from impact_rig_studies.importing.signals import Abscissa, ImportedSignals, Real, Signal, SignalKind, reasons
from impact_rig_studies.importing.steps import step_of
from impact_rig_studies.importing.uniform import Rate, aligned, uniform

POWERS = {"m": 0, "m/s": 1, "m/s^2": 2, "A": 0}  # power of the frequency in a displacement's spectrum
REFERENCES = ("base", "current", "laser", "accelerometer")  # the first that is measured gives the drive's frequency
NAMED_WITHIN = 0.005  # allowed relative difference of a frequency in a file name from that of the data
NEIGHBOURS, OUTSTANDING = 101, 6.0
"""Number of spectral lines whose median is the noise around a line, and the factor by which a clear line exceeds it.

Of 10,000 lines of noise not one is clear.
"""
FREQUENCY_S, FREQUENCY_SCANS = 20, 20_000  # length of the record's end for its frequency: the longer
FREQUENCY_HZ = 10_000  # means of neighbours represent faster scans: a fit of a million takes 150 MB


@attrs.frozen(eq=False)
class ImportedRun:
    """Content of an imported file, converted to what a run contains."""

    source: ImportedSignals  # what was read
    mapping: Mapping  # mapping that was used
    rate_hz: Rate  # scans per second
    start_ns: int  # instant from which `index` counts, in most cases the stamp of the first scan
    index: NDArray[np.int64]  # number of each scan in `rows`, with gaps where scans are missing; shape (n,)
    rows: NDArray[np.void]  # scans, `time` unused, shape (n,)
    info: NDArray[np.void]  # rows of `daq/info`
    drive: tuple[tuple[int, float, float], ...]  # commands: instant [ns], frequency [Hz], amplitude [`amplitude_unit`]
    labels: tuple[str, ...]  # remarks for the topic `notes`, among them the labels of the gap
    estimated: AnyMapping[str, tuple[str, ...]]  # columns of `info` that were estimated from the data, by channel
    doubts: tuple[str, ...] = ()  # assumptions and guesses that the user should confirm, as text
    amplitude_unit: str = "A"  # unit of the amplitudes in `drive`, with the channel they were measured in


def convert(
    source: ImportedSignals,
    mapping: Mapping,
    drive: ImportedSignals | None = None,
    sheet: ImportedSignals | None = None,
) -> ImportedRun:
    """Return the content of a file as scans, calibration, drive commands and gap labels of a run.

    Args:
        source: content of the file.
        mapping: assignment of its signals to channels.
        drive: table of commands with the columns `time` or `stamp_ns`, `frequency` [Hz] and, if known, `current` [A
            peak]. With None, the mapping states the frequency. If the mapping does not state it, the frequency is found
            in the data (0 if they show none). Unknown amplitudes are estimated from the data.
        sheet: table of calibration with columns of `daq/info`, one row per channel. The mapping takes precedence.
            Resolution and skew that neither states are estimated from the data; all other properties are ideal. A rate
            in the table is ignored.

    Raises:
        ConfigError: no channel is mapped, a mapped signal does not exist, a unit is not possible for its channel, times
            are not uniform, or a table has an invalid value.
        RecordingError: the signals have different abscissas and the mapping does not resample them, or have one
            abscissa but different lengths, or have fewer than two values.
        BudgetError: resampling would give too many values.
    """
    if not mapping.channels:
        raise ConfigError(_unassigned(source))
    found: dict[str, Real] = {}
    used: dict[str, Channel] = {}
    si_units: dict[str, str] = {}
    steps: dict[str, float] = {}
    doubts: list[str] = []
    for name in CHANNELS:
        if name not in mapping.channels:
            continue
        one = mapping.channels[name]
        signal = source.signals.get(one.column)
        if signal is None:
            raise _no_signal(source, one.column, name)
        one = used[name] = attrs.evolve(one, unit=one.unit or signal.unit)
        try:
            factor, si_units[name] = one.to_si(name)
        except ImpactRigError as error:
            raise type(error)(f"{source.path}: {error}") from error
        found[name] = one.sign * one.scale * factor * signal.values
        steps[name] = abs(one.scale * factor) * step_of(signal.values)
        if one.offset:
            found[name] += one.offset
        doubts += _unit_doubts(name, one, si_units[name])
    mapping = attrs.evolve(mapping, channels=used)
    signals = {name: source.signals[one.column] for name, one in used.items()}
    doubts = [*source.remarks, *(one.abscissa.note for one in signals.values()), *doubts]
    if mapping.resample_hz is not None and _differ(signals):
        abscissa, found = aligned(source.path, {name: one.abscissa for name, one in signals.items()}, found)
        count, skews = len(next(iter(found.values()))), dict.fromkeys(found, 0.0)
    else:
        abscissa, count, skews = _common(source, signals)
    followed: dict[str, Real] = {}
    for key, column in (("frequency", mapping.frequency), ("gap", mapping.gap)):
        if isinstance(column, str):
            if column not in source.signals:
                raise _no_signal(source, column, key)
            if len(source.signals[column].values) != count:
                raise ConfigError(
                    f"{source.path}: the signal {column!r} for {key} has {len(source.signals[column].values)} values, "
                    f"but the channels have {count}; state a number instead, or a signal of this length"
                )
            followed[key] = _in_unit(source.path, column, source.signals[column], "Hz" if key == "frequency" else "m")
    grid = uniform(source.path, abscissa, mapping, found, followed)
    rate, index, found, followed = grid.rate_hz, grid.index, grid.signals, grid.followed
    info, estimated = _calibration(mapping, si_units, rate, sheet, steps, skews)
    start_ns = source.start_ns or 0
    if sheet and "since_start" in sheet.signals and sheet.start_ns is not None and source.start_ns is not None:
        start_ns = sheet.start_ns - round(float(sheet.signals["since_start"].values[0]) * NS_PER_S)
        index = index + round((source.start_ns - start_ns) * rate / NS_PER_S)
    rows = _scans(found, si_units, info)
    instants = _Instants(index, rate, start_ns)
    measured_hz, is_sine = _frequency_of(found, si_units, float(rate), index)
    mapping, guesses = _confirmed(mapping, measured_hz if is_sine else 0.0, len(index) / rate, float(rate))
    commands = _commands(source, mapping, drive, followed.get("frequency"), instants)
    if not commands:
        commands = ((start_ns, measured_hz, math.nan),)
    is_stated = any(math.isfinite(amplitude) for _, _, amplitude in commands)
    driver = next(name for name in ("current", *REFERENCES) if name in found)
    commands = tuple(_with_amplitude(commands, found[driver], instants))
    labels = list(mapping.notes)
    if "gap" in followed:
        gaps = followed["gap"]
        labels += [GapLabel(float(gaps[scan]), instants.exact(scan)).text() for scan in _changes(gaps)]
    elif isinstance(mapping.gap, float):
        labels.append(GapLabel(mapping.gap, start_ns).text())
    return ImportedRun(
        source,
        mapping,
        rate,
        start_ns,
        index,
        rows,
        info,
        commands,
        tuple(labels),
        estimated,
        tuple(dict.fromkeys(filter(None, doubts + guesses))),
        "A" if is_stated else f"{si_units[driver]} of {driver}",
    )


def _no_signal(source: ImportedSignals, name: str, purpose: str) -> ConfigError:
    """Return the error that a file has no signal `name`.

    `purpose` is `frequency`, `gap` or a channel like `laser`.
    """
    there = f"choose one of {', '.join(source.signals)[:300]}" if source.signals else "the file has no signals"
    hint = did_you_mean(name, source.signals, "did you mean {!r}?", there)
    if name in source.left_out:
        hint = f"the import leaves it out ({source.left_out[name]}); choose another one"
    return ConfigError(f"{source.path} has no signal {name!r} for {purpose}: {hint}")


def _unassigned(source: ImportedSignals) -> str:
    names = (f"{name} [{one.unit}]" if one.unit else name for name, one in source.signals.items())
    rest = f"; left out: {reasons(source.left_out)}" if source.left_out else ""
    if not source.signals:
        return f"{source.path} holds no signal of numbers{rest}; export the measured signals as numbers"
    example = next(iter(source.signals))
    strange = {name: one for name, one in source.signals.items() if one.kind is not SignalKind.TIME_RESPONSE}
    if strange and len(strange) == len(source.signals):
        found = "; ".join(f"{name}: {one.kind}, {one.abscissa}" for name, one in strange.items())
        return f"{source.path} holds no time response: {found[:500]}; export the measured signals over time"
    return (
        f"{source.path}: the names of the signals do not tell which is which channel: {', '.join(names)[:500]}{rest}. "
        f'Assign them: --channel laser="{example}" for the motion of the structure, --channel base=… for its base'
    )


def _unit_doubts(name: str, one: Channel, si_unit: str) -> list[str]:
    """Return the assumption about the missing or ambiguous unit of a channel, as a list with one text for the user.

    The list is empty if the unit is clear.
    """
    said = f'--channel {name}="{one.column} {OTHER_UNIT[si_unit]}" states another'
    if not one.unit and not one.sensitivity:
        return [f"no unit is given for {one.column}: {si_unit} is assumed; {said}"]
    doubt = units.doubt(one.sensitivity.rpartition("/")[2] if one.sensitivity else one.unit)
    return [f"unit {one.sensitivity or one.unit!r} of {one.column} was read as {doubt}"] if doubt else []


def _differ(signals: AnyMapping[str, Signal]) -> bool:
    """Return whether any of the signals has other times than the first signal."""
    one, *others = signals.values()
    return any(other.abscissa is not one.abscissa and not _fits(one, other) for other in others)


def _fits(one: Signal, other: Signal) -> bool:
    """Return whether two signals have the same length and step, and start within half a period of each other."""
    a, b, count = one.abscissa, other.abscissa, len(one.values)
    period = a.step or (float(a.values[1]) if a.values is not None and count > 1 else 0.0)
    return (
        a.kind is b.kind
        and count == len(other.values)
        and abs(b.start - a.start) <= 0.5 * period
        and _same_steps(a, b, period, count)
    )


def _common(source: ImportedSignals, signals: AnyMapping[str, Signal]) -> tuple[Abscissa, int, dict[str, float]]:
    """Return the abscissa of the first channel, its length, and the delay of each channel relative to it [s].

    The delays are given by channel. A delay is negative if the channel starts earlier than the first channel.

    Raises:
        RecordingError: the signals have different lengths, or times that differ by more than half a sampling period.
    """
    (first_name, first), *others = signals.items()
    for name, one in others:
        if one.abscissa is not first.abscissa and not _fits(first, one):
            raise RecordingError(
                f"{source.path}: {name} ({len(one.values)} values, {one.abscissa}) has other times than {first_name} "
                f"({len(first.values)} values, {first.abscissa}); import signals of one time base, or resample them to "
                "one (--resample HZ)"
            )
        if len(one.values) != len(first.values):
            raise RecordingError(
                f"{source.path}: {name} has {len(one.values)} values, but {first_name} {len(first.values)}; all "
                "channels need the same number: assign signals of equal length (--channel), resampling does not help"
            )
    skews = {name: one.abscissa.start - first.abscissa.start for name, one in signals.items()}
    return first.abscissa, len(first.values), skews


def _same_steps(first: Abscissa, other: Abscissa, period: float, count: int) -> bool:
    """Return whether two abscissas of `count` values have the same duration from first to last value.

    A difference up to half a `period` [s] is allowed.
    """
    ends = [
        one.step * (count - 1) if one.step else float(one.values[-1]) if one.values is not None and count else 0.0
        for one in (first, other)
    ]
    return abs(ends[1] - ends[0]) <= 0.5 * period


def _scans(found: AnyMapping[str, Real], si_units: AnyMapping[str, str], info: NDArray[np.void]) -> NDArray[np.void]:
    """Return values in SI units as rows of `daq/scan`, with `time` 0.

    A bit of `status` marks each reading that reaches or exceeds the range of its channel.
    """
    names = tuple(info["name"].astype(str))
    columns = (topics.SCAN.fields[0], *(Column(n, si_units[n], "") for n in names), topics.SCAN.fields[1])
    rows = np.zeros(len(found[names[0]]), row_type(columns))
    for bit, name in enumerate(names):
        rows[name] = found[name]
        with np.errstate(invalid="ignore"):
            beyond = (found[name] <= info["range_low"][bit]) | (found[name] >= info["range_high"][bit])
        rows["status"] |= beyond.astype(np.uint8) << bit
    return rows


@attrs.frozen(eq=False)
class _Instants:
    """Conversion between the position of a scan (0 for the first scan in the file) and its stamp [ns].

    Missing scans have no position. Stamps count from the same zero as `start_ns`.
    """

    index: NDArray[np.int64]
    rate_hz: Rate
    start_ns: int

    def exact(self, scan: int) -> int:
        """Return the stamp [ns] of the scan at a position, rounded down to whole nanoseconds."""
        return stamp_ns(int(self.index[scan]), self.rate_hz, self.start_ns)

    def first_at(self, instant_ns: float) -> int:
        """Return the position of the first scan at or after a stamp; infinity gives the number of scans."""
        if math.isinf(instant_ns):
            return len(self.index)
        return int(np.searchsorted(self.index, (instant_ns - self.start_ns) * self.rate_hz / NS_PER_S - 1e-6))


def _calibration(
    mapping: Mapping,
    si_units: AnyMapping[str, str],
    rate: Rate,
    sheet: ImportedSignals | None,
    steps: AnyMapping[str, float],
    skews: AnyMapping[str, float],
) -> tuple[NDArray[np.void], dict[str, tuple[str, ...]]]:
    """Return rows of `daq/info` for the channels, and the columns that were estimated from the data, by channel.

    The mapping takes precedence over the table of calibration (`sheet`). If neither states them, the resolution is that
    of `steps`, and the skew that of `skews` [s]; both were estimated from the signals, by channel. Any other property
    that neither states is ideal: no error, no delay, an unlimited range. `si_units` are the units of the converted
    channels. The rate counts as estimated unless the mapping states a rate.

    Raises:
        ConfigError: the lower end of a channel's range is not below the upper end.
    """
    given_rate = mapping.rate_hz is not None or mapping.resample_hz is not None
    estimated: dict[str, tuple[str, ...]] = {}
    names = [name for name in CHANNELS if name in mapping.channels]
    rows = np.zeros(len(names), DAQ_INFO)
    rows["name"], rows["unit"] = names, [si_units[name] for name in names]
    rows["range_low"], rows["range_high"], rows["sensitivity"] = -math.inf, math.inf, 1.0
    listed = (sheet.texts.get("name") or []) if sheet is not None else []
    for place, name in enumerate(names):
        rows["resolution"][place], rows["skew"][place] = steps[name], skews[name]
        stated: dict[str, float] = {}
        if sheet is not None and name in listed:
            for key in CALIBRATION:
                if key in sheet.signals and len(sheet.signals[key].values) == len(listed):
                    stated[key] = float(sheet.signals[key].values[listed.index(name)])
        stated |= mapping.channels[name].calibration
        for key, value in stated.items():
            rows[key][place] = value
        found = ("resolution", "skew") if given_rate else ("rate", "resolution", "skew")
        estimated[name] = tuple(key for key in found if key not in stated)
        if not rows["range_low"][place] < rows["range_high"][place]:
            low, high = rows["range_low"][place], rows["range_high"][place]
            raise ConfigError(
                f"range_low of the channel {name} must be < range_high, got {low:g} and {high:g} {si_units[name]}; "
                "correct it in the file of --mapping or --calibration"
            )
    rows["rate"], rows["since_start"] = rate, 0.0  # its stamp in the run is that of scan 0
    return rows, estimated


def _confirmed(mapping: Mapping, measured_hz: float, seconds: float, rate: float) -> tuple[Mapping, list[str]]:
    """Compare the drive frequency guessed from the file name with the data; return the mapping, and texts for the user.

    If the sine in the data has another frequency (`measured_hz`, 0 without a clear sine), this frequency replaces the
    guess. A guess of half the scan rate or more is dropped, because it is often the sampling rate. The texts also state
    a guessed gap. `seconds` is the length of the record, `rate` the scan rate [Hz].
    """
    said = []
    if "frequency" in mapping.guessed and isinstance(mapping.frequency, float):
        named = mapping.frequency
        within = max(NAMED_WITHIN * named, 0.5 / seconds)
        if named >= 0.5 * rate:
            said.append(
                f"the {named:g} Hz in the file name cannot be a drive frequency at {rate:g} scans per second; that of "
                "the data is used; state another with --frequency HZ"
            )
            mapping = attrs.evolve(mapping, frequency=None)
        elif measured_hz > 0.0 and abs(named - measured_hz) > within:
            said.append(
                f"the file name states a drive frequency of {named:g} Hz, but the data show {measured_hz:.5g} Hz, "
                "which is used; state another with --frequency HZ"
            )
            mapping = attrs.evolve(mapping, frequency=measured_hz)
        else:
            shown = f"show {measured_hz:.5g} Hz, which agree within {within:.2g} Hz"
            said.append(
                f"drive frequency {named:g} Hz, guessed from the file name; the data "
                f"{shown if measured_hz > 0.0 else 'have no clear sine'}; state another with --frequency HZ"
            )
    if "gap" in mapping.guessed and isinstance(mapping.gap, float):
        gap = f"{mapping.gap * 1e3:g} mm" if mapping.gap else "none (no sphere)"
        said.append(f"gap {gap}, guessed from the file name; state another with --gap, such as --gap 6mm")
    return mapping, said


def _commands(
    source: ImportedSignals, mapping: Mapping, drive: ImportedSignals | None, followed: Real | None, instants: _Instants
) -> tuple[tuple[int, float, float], ...]:
    """Return the drive commands as (stamp [ns], frequency [Hz], amplitude); empty if no command is known.

    The commands are those of the table `drive`. Its times count from the same instant as the times of `source`, unless
    both contain dates. Without a table, there is a command at each change of the frequency signal `followed`. Without
    such a signal, the single frequency of the mapping is used. Amplitudes are peak values [A, or m for a prescribed
    base], taken from the column `current` of the table, else from the mapping. An unknown amplitude is NaN.

    Raises:
        ConfigError: the table lacks frequencies or times, its columns differ in length, one of its times is not finite,
            or a column has a wrong unit.
    """
    if drive is not None:
        frequency, current = (drive.signals.get(key) for key in ("frequency", "current"))
        times = None if frequency is None else frequency.time_s
        if frequency is None or times is None:
            missing = "`frequency` [Hz]" if frequency is None else "of times, `time` [s] or `stamp_ns`"
            raise ConfigError(f"{drive.path}: a table of drive commands must have a column {missing}: add this column")
        if current is not None and len(current.values) != len(times):
            raise ConfigError(
                f"{drive.path}: `frequency` and `current` must have the same number of values, got {len(times)} and "
                f"{len(current.values)}; give each frequency one current"
            )
        hertz, amplitude = _in_unit(drive.path, "frequency", frequency, "Hz"), np.full(len(times), mapping.amplitude)
        if current is not None:
            amplitude = _in_unit(drive.path, "current", current, "A")
        if not np.all(np.isfinite(times)):
            wrong = int(np.argmin(np.isfinite(times)))
            raise ConfigError(
                f"{drive.path}: time {wrong + 1} of {len(times)} is not a finite number; correct it in the file"
            )
        first = instants.start_ns + round((drive.begins_s - source.begins_s) * NS_PER_S)  # both count from one instant
        if drive.start_ns is not None and source.start_ns is not None:
            first = drive.start_ns
        stamps = [first + round(float(one) * NS_PER_S) for one in times]
        return tuple(zip(stamps, hertz.tolist(), amplitude.tolist(), strict=True))
    if followed is not None:
        return tuple((instants.exact(scan), float(followed[scan]), mapping.amplitude) for scan in _changes(followed))
    if isinstance(mapping.frequency, float):
        return ((instants.start_ns, mapping.frequency, mapping.amplitude),)
    return ()


_PEAK = re.compile(r"[\s_-]+(?:peak|pk|0-p)$", re.IGNORECASE)  # the amplitudes of a run are peak values


def _in_unit(path: Path, name: str, signal: Signal, wanted: str) -> Real:
    """Return the values of a signal, converted to the unit `wanted`.

    Values without a unit are returned unchanged.

    Raises:
        ConfigError: the unit is unknown, or a unit of another quantity.
        RecordingError: the unit needs `pint` (see `units`), which is not installed.
    """
    unit = _PEAK.sub("", signal.unit)
    factor = units.unit_factor(unit, wanted) if unit else 1.0
    if factor is None:
        raise ConfigError(
            f"{path}: {name!r} must have a unit that can be converted to {wanted}, or no unit, got {signal.unit!r}"
        )
    return signal.values if factor == 1.0 else factor * signal.values


def _changes(values: Real) -> list[int]:
    """Return position 0 and all positions at which a value differs from the value before; two NaN count as equal."""
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    return [0, *(np.flatnonzero(~same) + 1).tolist()]


def _with_amplitude(
    commands: Sequence[tuple[int, float, float]], values: Real, instants: _Instants
) -> Iterator[tuple[int, float, float]]:
    """Yield the drive commands, with missing amplitudes estimated from the measured `values` of the drive.

    A command is (stamp [ns], frequency [Hz], peak amplitude in the unit of `values`, NaN if missing). The estimate is
    √2 times the standard deviation of the values from this command to the next command. Without values there, the
    amplitude remains NaN.
    """
    ends = [*(one[0] for one in commands[1:]), math.inf]
    for (instant, frequency, amplitude), end in zip(commands, ends, strict=True):
        part = values[instants.first_at(instant) : instants.first_at(end)]
        known = not math.isnan(amplitude) or not len(part)
        yield instant, frequency, amplitude if known else math.sqrt(2.0) * float(np.std(np.nan_to_num(part)))


def _longest_stretch(values: Real, index: NDArray[np.int64]) -> Real:
    """Return the longest part of values without a missing scan and without NaN or infinity.

    `index` contains the scan numbers of the values, with gaps where scans are missing.
    """
    is_good = np.isfinite(values)
    ends = np.flatnonzero((np.diff(index) != 1) | (is_good[1:] != is_good[:-1])) + 1
    cuts = np.concatenate([[0], ends, [len(values)]])
    lengths = np.where(is_good[cuts[:-1]], np.diff(cuts), 0)
    at = int(np.argmax(lengths))
    return values[cuts[at] : cuts[at] + lengths[at]]


def _frequency_of(
    found: AnyMapping[str, Real], si_units: AnyMapping[str, str], rate: float, index: NDArray[np.int64]
) -> tuple[float, bool]:
    """Return the drive frequency [Hz] that the data show (0 if none), and whether the data are a clear sine.

    The frequency is that of the largest line in the displacement spectrum of the first measured channel in
    `REFERENCES`. Lines clearly above the noise around them take precedence over other lines. Only the end of the
    record's longest part without missing values is used. A clear sine has more power than the rest of the signal.
    """
    from scipy.ndimage import median_filter  # noqa: PLC0415  # heavy

    from impact_rig.analysis.sine import fit_sine_frequency  # noqa: PLC0415  # heavy
    from impact_rig.states import Status  # noqa: PLC0415  # as above

    name = next(name for name in REFERENCES if name in found)
    values = _longest_stretch(found[name], index)
    each = max(1, int(rate / FREQUENCY_HZ))
    most = max(round(FREQUENCY_S * min(rate, FREQUENCY_HZ)), FREQUENCY_SCANS)
    part = values[-min(len(values), each * most) :]
    rate /= each
    with np.errstate(over="ignore", invalid="ignore"):
        if each > 1:
            part = part[len(part) % each :].reshape(-1, each).mean(axis=1)
        span = float(np.ptp(part)) if len(part) else 0.0
        part = (part - part.mean()) / span if 0.0 < span < math.inf else part[:0]
    if len(part) < 4 or not np.all(np.isfinite(part)):
        return 0.0, False
    lines = np.abs(np.fft.rfft(part * np.hanning(len(part))))
    is_outstanding = lines > OUTSTANDING * median_filter(lines, NEIGHBOURS)
    lines[2:] /= np.arange(2, len(lines)) ** float(POWERS[si_units[name]])
    lines[:2] = 0.0  # the mean, as spread by the window
    outstanding = np.where(is_outstanding, lines, 0.0)
    coarse = float(np.argmax(outstanding if outstanding.any() else lines)) * rate / len(part)
    try:
        fit = fit_sine_frequency(part, rate, coarse)
    except (np.linalg.LinAlgError, ValueError, OverflowError):  # at half the rate, or with few values, there is no sine
        return coarse, False
    if fit.status is not Status.OK:
        return coarse, False
    return fit.frequency_hz, bool(fit.amplitude**2 > 2.0 * fit.residual_rms**2)
