# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A measurement of somebody's own rig as a run: which signal is which channel, in which unit, how well known.

A `Mapping` says it: guessed from the headings and units of a file, refined by a YAML text and by options. What the file
holds becomes `daq/scan`, `daq/info`, `shaker/applied` and remarks; the analysis then measures as it does live, and its
rows are kept in the run as well. A channel that was not measured is not in the run.

    SI value = sign · scale · value [unit] / sensitivity + offset       delay and lag as in `analysis.calibration`
"""

from __future__ import annotations

import itertools
import json
import math
import re
import time
from collections.abc import Iterator, Sequence
from collections.abc import Mapping as AnyMapping
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

import impact_rig
from impact_rig import codec, topics
from impact_rig.analysis.scans import CHANNELS
from impact_rig.analysis.settings import GapLabel, parse_label
from impact_rig.analysis.tracker import Findings, Tracker
from impact_rig.blocks import APPLIED, DAQ_INFO, DAQ_INFO_COLUMNS, LONGEST_S, MOST_HZ, Column, Table, row_type
from impact_rig.errors import ConfigError, RecordingError, did_you_mean
from impact_rig.recording import Attachment, Provenance, RunWriter, TopicDescription
from impact_rig.recording.description import MEASURED, MODE_KEY
from impact_rig.runs.foreign_files import VALUES, Foreign
from impact_rig.simtime import NS_PER_S, stamp_ns
from impact_rig.system import budget

MAPPING_FILE = "mapping.yaml"  # attachment with the mapping in use
UNITS = {"accelerometer": "m/s^2", "laser": "m", "base": "m", "current": "A"}
HINTS = {
    "accelerometer": ("accelerometer", "acceleration", "accel", "acc", "a_1", "a1"),
    "laser": ("laser", "structure", "superior", "response", "top", "x_1", "x1", "out", "output"),
    "base": ("base", "inferior", "table", "input", "ground", "x_b", "xb", "x_0", "in"),
    "current": ("current", "coil", "strom", "i", "drive", "amp"),
}
"""Words in the headings of other programs, lower case, by channel."""
LIKE = {"accelerometer": "m/s^2", "current": "A"}  # channels that their unit alone gives away
BLOCK_S, BLOCK_SCANS = 0.1, 4000
EVEN = 0.02  # of a period: departure from a uniform grid of times that is called jitter of the clock's last digit
HOLE = 2.5  # in periods: so long a step between two scans is no unevenness, scans are missing there
WHOLE = 1e-4  # relative departure of a rate from a whole number of Hz that times printed with few digits have
ROUNDED = 0.5  # of a period: by how much times may depart from the rate that the same file states
LONGEST_UNIT = 40
FROM_FILE_NAME = {
    "frequency_hz": re.compile(r"(?<![\d.])(\d+(?:[.p]\d+)?)\s*_?hz", re.IGNORECASE),
    "gap_mm": re.compile(r"(?<![\d.])(\d+(?:[.p]\d+)?)\s*_?mm", re.IGNORECASE),
}
NO_SPHERE_NAME = re.compile(r"no[_ -]?(sphere|ball|damper)|without|bare", re.IGNORECASE)
MAPPING_CHARACTERS = 100_000


_Signals = dict[str, NDArray[np.float64]]  # values of the scans by name


@attrs.frozen(kw_only=True)
class Channel:
    """How a signal becomes a channel."""

    column: str  # name of the signal in the file
    unit: str = ""  # of its values; empty: SI
    scale: float = 1.0  # what a value is multiplied by, before its unit
    sensitivity: str = ""  # such as `100 mV/g`, where the unit is that of a voltage; empty: none
    sign: float = 1.0  # -1 for a sensor mounted the other way round
    offset: float = 0.0  # added after all that [SI unit]
    calibration: AnyMapping[str, float] = attrs.field(factory=dict)
    """Columns of `daq/info` by name: range, noise, resolution, lag, skew, uncertainties."""


def _above_zero(_mapping: object, _field: object, value: float | str | None) -> None:
    if isinstance(value, float) and not 0.0 < value < math.inf:
        raise ConfigError(f"frequency must be above 0 Hz, got {value:g}")


def _not_negative(_mapping: object, _field: object, value: float | str | None) -> None:
    if isinstance(value, float) and not 0.0 <= value < math.inf:
        raise ConfigError(f"gap must be 0 (no sphere) or more, got {value * 1e3:g} mm")


@attrs.frozen(kw_only=True)
class Mapping:
    """What the signals of a file are."""

    channels: AnyMapping[str, Channel]  # by name
    rate_hz: float | None = None  # where the file has neither times nor a rate
    resample_hz: int | None = None  # rate to bring scans to that are not uniform in time; None: they are refused
    frequency: float | str | None = attrs.field(default=None, validator=_above_zero)
    """Of the drive [Hz], or name of the signal that holds it; None: measured from the base."""
    amplitude: float = math.nan  # commanded [A], of the base [m] where its motion is prescribed; NaN: as measured
    gap: float | str | None = attrs.field(default=None, validator=_not_negative)
    """Label [m], 0 without sphere, or name of the signal that holds it [m]; None: unknown."""
    notes: tuple[str, ...] = ()  # remarks for the run


@attrs.frozen(eq=False)
class ImportedFile:
    """A file as a run holds it."""

    source: Foreign  # what was read
    mapping: Mapping  # in use
    rate_hz: int  # scans per second
    start_ns: int  # stamp of the first scan
    index: NDArray[np.int64]  # number of each scan, counted from the first; a gap is a loss. Shape (n,)
    rows: NDArray[np.void]  # scans, `time` unused, shape (n,)
    info: NDArray[np.void]  # rows of `daq/info`
    drive: tuple[tuple[int, float, float], ...]  # instants [ns], frequencies [Hz] and amplitudes [A] commanded
    labels: tuple[str, ...]  # remarks


# --- the mapping


def guess(source: Foreign) -> Mapping:
    """Return the mapping that headings, units and the name of a file suggest; what they do not tell is left out.

    Our own names first, then words of other programs, then units that only one channel has.
    """
    free = dict(source.signals)
    chosen: dict[str, Channel] = {}

    def take(channel: str, name: str) -> None:
        chosen[channel] = Channel(column=name, unit=free.pop(name).unit)

    for channel in CHANNELS:
        if channel in free:
            take(channel, channel)
    for channel in CHANNELS:
        for hint in HINTS[channel] if channel not in chosen else ():
            matching = [name for name in free if hint in re.split(r"[\s_.:-]+", name.lower()) or name.lower() == hint]
            if len(matching) == 1:
                take(channel, matching[0])
                break
    for channel, unit in LIKE.items():
        if channel not in chosen:
            matching = [name for name, one in free.items() if one.unit and unit_factor(one.unit, unit) is not None]
            if len(matching) == 1:
                take(channel, matching[0])
    named = {key: pattern.search(source.path.stem) for key, pattern in FROM_FILE_NAME.items()}
    values = {key: float(found[1].replace("p", ".")) for key, found in named.items() if found}
    gap: float | str | None = values["gap_mm"] * 1e-3 if "gap_mm" in values else None
    if NO_SPHERE_NAME.search(source.path.stem):
        gap = 0.0
    frequency: float | str | None = values.get("frequency_hz")
    if "frequency" in free:
        frequency = "frequency"
    if "gap" in free:
        gap = "gap"
    return Mapping(channels=chosen, frequency=frequency, gap=gap)


def refined(mapping: Mapping, text: str) -> Mapping:
    """Return a mapping with what a YAML text says of it.

        rate_hz: 5000
        frequency: 9.1               # Hz, or the name of a column
        gap_mm: 6                    # 0 without sphere; or gap: the name of a column, in metres
        channels:
          laser: {column: ai0, unit: V, sensitivity: 500 mV/mm, sign: -1, sensitivity_uncertainty: 0.01}

    Raises:
        ConfigError: a key or value is wrong; the message names both.
    """
    try:
        content = budget.load_yaml(text, MAPPING_CHARACTERS)
    except budget.PlainYamlError as error:
        raise ConfigError(f"the mapping is no YAML: {error}") from error
    given = _mapping("the mapping", content)
    _refuse_unknown(
        "", given, ("rate_hz", "resample_hz", "frequency", "amplitude", "gap", "gap_mm", "notes", "channels")
    )
    channels = dict(mapping.channels)
    for name, value in _mapping("channels", given.get("channels")).items():
        if name not in CHANNELS:
            raise ConfigError(f"channels: unknown channel {name}; there are {', '.join(CHANNELS)}")
        if value is None:
            channels.pop(name, None)
        else:
            channels[name] = _channel(name, _mapping(f"channels.{name}", value), channels.get(name))
    changes: dict[str, object] = {"channels": channels}
    for key in ("rate_hz", "amplitude"):
        if key in given:
            changes[key] = _number(key, given[key])
    if "resample_hz" in given:
        changes["resample_hz"] = round(_number("resample_hz", given["resample_hz"]))
    for key in ("frequency", "gap"):
        if key in given:
            value = given[key]
            changes[key] = value if isinstance(value, str) else _number(key, value)
    if "gap_mm" in given:
        changes["gap"] = 1e-3 * _number("gap_mm", given["gap_mm"])
    if "notes" in given:
        notes = given["notes"]
        changes["notes"] = tuple(map(_text, notes)) if isinstance(notes, list) else (_text(notes),)
    return attrs.evolve(mapping, **changes)  # type: ignore[arg-type]  # checked above


def as_yaml(mapping: Mapping) -> str:
    """Return a mapping as the text that `refined` takes."""
    content: dict[str, object] = {
        "channels": {
            name: {
                **{key: value for key, value in attrs.asdict(one).items() if key != "calibration"},
                **dict(one.calibration),
            }
            for name, one in mapping.channels.items()
        },
        **{key: getattr(mapping, key) for key in ("rate_hz", "resample_hz", "frequency", "gap")},
        "amplitude": None if math.isnan(mapping.amplitude) else mapping.amplitude,
        "notes": list(mapping.notes),
    }
    texts = {key: json.dumps(value, ensure_ascii=False) for key, value in content.items() if value not in (None, [])}
    lines = [f"{key}: {_WHOLE_BY_POWER.sub(lambda m: m[1] or f'{m[2]}.0e', text)}" for key, text in texts.items()]
    return "\n".join(lines) + "\n"


_WHOLE_BY_POWER = re.compile(r'("(?:[^"\\]|\\.)*")|(?<![\d.])(\d+)e')
"""A text, or the begin of a number such as 1e-06: JSON writes it so, and in YAML it is a text without a point."""

_CALIBRATION = tuple(column.name for column in DAQ_INFO_COLUMNS if column.name not in ("name", "unit", "rate"))
_OWN = ("column", "unit", "scale", "sensitivity", "sign", "offset")


def _channel(name: str, given: AnyMapping[str, object], known: Channel | None) -> Channel:
    _refuse_unknown(f"channels.{name}.", given, (*_OWN, *_CALIBRATION))
    values: dict[str, object] = {}
    for key in ("column", "unit", "sensitivity"):
        if key in given:
            values[key] = _text(given[key])
    for key in ("scale", "sign", "offset"):
        if key in given:
            values[key] = _number(f"channels.{name}.{key}", given[key])
    figures = {k: _number(f"channels.{name}.{k}", given[k]) for k in _CALIBRATION if k in given and k not in _OWN}
    if known is None:
        if "column" not in values:
            raise ConfigError(f"channels.{name}.column is missing: the name of a signal in the file")
        known = Channel(column=str(values["column"]))
    return attrs.evolve(known, **values, calibration={**known.calibration, **figures})  # type: ignore[arg-type]


def _mapping(key: str, value: object) -> dict[str, object]:
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise ConfigError(f"{key} must be a mapping, got {_text(value)[:60]!r}")
    return {str(name): one for name, one in value.items()}


def _refuse_unknown(where: str, given: AnyMapping[str, object], known: Sequence[str]) -> None:
    for name in given:
        if name not in known:
            raise ConfigError(f"unknown key {where}{name}{did_you_mean(name, known)}")


def _number(key: str, value: object) -> float:
    try:
        number = float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else math.nan
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ConfigError(f"{key} must be a finite number, got {_text(value)[:60]!r}")
    return number


def _text(value: object) -> str:
    try:
        return str(value)
    except ValueError:  # Python does not write out the longest integers
        return "a number beyond all measure"


# --- units

_STRANGE_UNIT = re.compile(r"[^\w\s µμ°%/*^·.²³()-]|\d{3}|\d\s*(\*\*|\^)|__")
"""What no unit has; a power of a power would keep the parser busy for ever."""


def unit_factor(unit: str, wanted: str) -> float | None:
    """Return what a value in a unit is multiplied by to be in another; None: the unit is unknown or of another kind."""
    if unit == wanted:
        return 1.0
    if not unit or len(unit) > LONGEST_UNIT or _STRANGE_UNIT.search(unit):
        return None
    try:
        import pint  # noqa: PLC0415  # of an extra
    except ImportError as error:
        raise RecordingError(f"the unit {unit!r} needs pint: pip install 'impact_rig[import]'") from error
    registry = pint.application_registry
    words = unit.replace("·", "*").replace("²", "^2").replace("³", "^3")
    gravity = re.sub(r"\bg(rav|_0|n)?\b", "standard_gravity", words)  # of an acceleration, g is never a gram
    for candidate in (words, gravity):
        try:
            return float(registry.Quantity(1.0, registry.parse_units(candidate)).to(wanted).magnitude)
        except Exception:  # noqa: S112  # pint raises what its parser, tokenizer and registry raise
            continue
    return None


def _to_si(name: str, one: Channel) -> float:
    """Return what a value of a channel's signal is multiplied by."""
    unit = one.unit or UNITS[name]
    if one.sensitivity:
        number, _, rest = one.sensitivity.strip().partition(" ")
        above, slash, below = rest.partition("/")
        upper = unit_factor(above.strip(), "V")
        lower = unit_factor(below.strip().strip("()"), UNITS[name])
        volts = unit_factor(unit, "V")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not slash or upper is None or lower is None or volts is None or not abs(value) > 0.0:
            raise ConfigError(
                f"channels.{name}.sensitivity must be like `100 mV/{UNITS[name].split('/')[0]}` of a signal in V, "
                f"got {one.sensitivity!r} of {unit!r}"
            )
        return volts * lower / (value * upper)
    factor = unit_factor(unit, UNITS[name])
    if factor is None:
        hint = (
            f"; a voltage needs a sensitivity, such as `sensitivity: 100 mV/{UNITS[name]}`"
            if unit in ("V", "mV")
            else ""
        )
        raise ConfigError(f"channels.{name}.unit must be a unit of {UNITS[name]}, got {unit!r}{hint}")
    return factor


# --- from file to run


def measurement(
    source: Foreign, mapping: Mapping, drive: Foreign | None = None, sheet: Foreign | None = None
) -> ImportedFile:
    """Return what a file holds as scans, calibration, drive and labels.

    Args:
        source: the file.
        mapping: what its signals are.
        drive: table with `frequency`, `current` and `time` or `stamp_ns`: what was commanded when; None: as mapped.
        sheet: table with columns of `daq/info`, a row a channel: the calibration; None: as mapped.

    Raises:
        ConfigError: no channel is mapped, a signal or unit is not there, or times are not uniform.
        RecordingError: lengths differ.
    """
    if not mapping.channels:
        known = ", ".join(f"{name} [{one.unit}]" if one.unit else name for name, one in source.signals.items())
        raise ConfigError(f"{source.path}: which signal is which channel is not known; it has: {known[:500]}")
    found: dict[str, NDArray[np.float64]] = {}
    used: dict[str, Channel] = {}
    for name in CHANNELS:
        if name in mapping.channels:
            one = mapping.channels[name]
            signal = source.signals.get(one.column)
            if signal is None:
                there = f"there are {', '.join(source.signals)[:300]}"
                hint = did_you_mean(one.column, source.signals, "did you mean {!r}?", there)
                raise ConfigError(f"{source.path} has no signal {one.column!r} for {name}: {hint}")
            one = used[name] = attrs.evolve(one, unit=one.unit or signal.unit)
            found[name] = one.sign * one.scale * _to_si(name, one) * signal.values
            if one.offset:
                found[name] += one.offset
    mapping = attrs.evolve(mapping, channels=used)
    lengths = {name: len(values) for name, values in found.items()}
    if len(set(lengths.values())) != 1:
        raise RecordingError(
            f"{source.path}: signals differ in length: " + ", ".join(f"{name} {n}" for name, n in lengths.items())
        )
    count = next(iter(lengths.values()))
    followed: dict[str, NDArray[np.float64]] = {}
    for key, column in (("frequency", mapping.frequency), ("gap", mapping.gap)):
        if isinstance(column, str):
            if column not in source.signals or len(source.signals[column].values) != count:
                raise ConfigError(f"{key}: {source.path} has no signal {column!r} of {count} values")
            followed[key] = source.signals[column].values
    rate, index, found, followed = _uniform(source, mapping, found, followed)
    info = _calibration(mapping, rate, sheet)
    start_ns = source.start_ns or 0
    if (
        sheet is not None
        and "since_start" in sheet.signals
        and sheet.start_ns is not None
        and source.start_ns is not None
    ):
        start_ns = sheet.start_ns - round(float(sheet.signals["since_start"].values[0]) * NS_PER_S)
        index = index + round((source.start_ns - start_ns) * rate / NS_PER_S)
    names = tuple(info["name"].astype(str))
    rows = np.zeros(
        len(index), row_type((topics.SCAN.fields[0], *(Column(n, UNITS[n], "") for n in names), topics.SCAN.fields[1]))
    )
    for bit, name in enumerate(names):
        rows[name] = found[name]
        with np.errstate(invalid="ignore"):
            beyond = (found[name] <= info["range_low"][bit]) | (found[name] >= info["range_high"][bit])
        rows["status"] |= beyond.astype(np.uint8) << bit
    # in two steps: the product of both exceeds 64 bits after days
    stamps = start_ns + index // rate * NS_PER_S + index % rate * NS_PER_S // rate
    commands = _commands(source, mapping, drive, followed.get("frequency"), stamps, start_ns)
    if not commands:
        commands = ((start_ns, _frequency_of(found, rate), math.nan),)
    commands = tuple(_with_amplitude(commands, found, stamps))
    labels = list(mapping.notes)
    if "gap" in followed:
        gaps = followed["gap"]
        labels += [GapLabel(float(gaps[scan]), int(stamps[scan])).text() for scan in _changes(gaps)]
    elif isinstance(mapping.gap, float):
        labels.append(GapLabel(mapping.gap, start_ns).text())
    return ImportedFile(source, mapping, rate, start_ns, index, rows, info, commands, tuple(labels))


def _uniform(
    source: Foreign, mapping: Mapping, found: _Signals, followed: _Signals
) -> tuple[int, NDArray[np.int64], _Signals, _Signals]:
    """Return rate, numbers of the scans, their values and what is followed, on a uniform grid with losses left open."""
    count = len(next(iter(found.values())))
    times = source.time_s
    used = {one.column for one in mapping.channels.values()}
    rates = {one.rate_hz for name, one in source.signals.items() if one.rate_hz and name in used}
    rate = rates.pop() if len(rates) == 1 else None
    if mapping.rate_hz is not None:
        rate, times = mapping.rate_hz, None
        if not 0.0 < rate <= MOST_HZ:
            raise ConfigError(f"rate_hz must be > 0 and <= {MOST_HZ:g}, got {rate:g}")
    elif (
        rate and times is not None and len(times) == count and np.all(np.abs(times * rate - np.arange(count)) < ROUNDED)
    ):
        times = None  # the file says the rate beside times that were rounded
    if times is None and rate is None:
        raise ConfigError(f"{source.path} has neither times nor a rate: give the rate, in scans per second")
    if times is None:
        assert rate is not None
        times = np.arange(count) / rate
    if len(times) != count:
        raise RecordingError(f"{source.path}: {len(times)} times for {count} values")
    if count < 2 or not np.all(np.isfinite(times)) or not np.all(np.diff(times) > 0.0):
        place = int(np.argmin(np.diff(times))) + 1 if count > 1 else 0
        raise ConfigError(f"{source.path}: times must increase, and do not at value {place + 1} of {count}")
    if not float(times[-1]) <= LONGEST_S:
        raise ConfigError(f"{source.path}: its times span {float(times[-1]):.3g} s, more than {LONGEST_S:g}")
    exact = rate or 1.0 / float(np.median(np.diff(times)))
    whole = round(exact)
    if mapping.resample_hz is not None:
        return _resampled(source, times, found, followed, exact, mapping.resample_hz)
    if not 1 <= whole <= MOST_HZ or abs(exact - whole) > WHOLE * whole:
        raise ConfigError(
            f"{source.path}: its rate of {exact:.6g} scans per second is no whole number up to {MOST_HZ:g}: resample, "
            f"e.g. to {math.ceil(exact)} Hz"
        )
    index = np.round(times * whole).astype(np.int64)
    off = np.abs(times * whole - index)
    resolution = whole * float(np.spacing(np.float32(times[-1])))  # times kept in single precision
    if np.any(np.diff(index) < 1) or float(off.max()) > EVEN + resolution:
        scan = int(np.argmax(off))
        raise ConfigError(
            f"{source.path}: not uniform in time: value {scan + 1} is {off[scan]:.2f} of a period off {whole} "
            "scans per second; resample it, or give its rate if the times are not to be believed"
        )
    return whole, index, found, followed


def _resampled(
    source: Foreign, times: NDArray[np.float64], found: _Signals, followed: _Signals, exact: float, rate: int
) -> tuple[int, NDArray[np.int64], _Signals, _Signals]:
    """Return signals on another grid, by a cubic through the values around; never a coarser one, which would alias.

    What is followed keeps its value until the next. Nothing is made up where scans are missing: each stretch between
    two holes has a cubic of its own.
    """
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  # heavy: only where it is asked for

    if not exact * (1.0 - WHOLE) <= rate <= MOST_HZ:
        raise ConfigError(f"{source.path}: resample to at least its {exact:.6g} Hz, at most {MOST_HZ:g}, got {rate}")
    budget.allow("values after resampling", float(times[-1]) * rate * len(found), VALUES)
    for name, values in found.items():
        if not np.all(np.isfinite(values)):
            wrong = int(np.argmin(np.isfinite(values)))
            raise ConfigError(f"{source.path}: {name} cannot be resampled: value {wrong + 1} is no finite number")
    index = np.arange(int(times[-1] * rate) + 1, dtype=np.int64)
    place = np.searchsorted(times, (index + 1e-3) / rate, side="right") - 1  # a time may be rounded up
    cuts = [0, *(np.flatnonzero(np.diff(times) * exact > HOLE) + 1).tolist(), len(times)]
    parts = []
    for begin, end in itertools.pairwise(cuts):
        first, last = np.searchsorted(index / rate, (times[begin], times[end - 1] + 1e-9 / rate))
        if end - begin > 1:
            parts.append((slice(begin, end), index[first:last]))
    if not parts:
        raise ConfigError(f"{source.path}: its times have more holes than scans")
    splined = {
        name: np.concatenate([CubicSpline(times[part], values[part])(own / rate) for part, own in parts])
        for name, values in found.items()
    }
    index = np.concatenate([own for _, own in parts])
    return rate, index, splined, {key: values[place[index]] for key, values in followed.items()}


def _calibration(mapping: Mapping, rate: int, sheet: Foreign | None) -> NDArray[np.void]:
    """Return rows of `daq/info`: what the sheet and the mapping say; beyond that, without limit and without error."""
    names = [name for name in CHANNELS if name in mapping.channels]
    rows = np.zeros(len(names), DAQ_INFO)
    rows["name"], rows["unit"] = names, [UNITS[name] for name in names]
    rows["range_low"], rows["range_high"], rows["sensitivity"] = -math.inf, math.inf, 1.0
    listed = (sheet.texts.get("name") or []) if sheet is not None else []
    for place, name in enumerate(names):
        if sheet is not None and name in listed:
            for key in _CALIBRATION:
                if key in sheet.signals and len(sheet.signals[key].values) == len(listed):
                    rows[key][place] = sheet.signals[key].values[listed.index(name)]
        for key, value in mapping.channels[name].calibration.items():
            rows[key][place] = value
        if not rows["range_low"][place] < rows["range_high"][place]:
            raise ConfigError(f"channels.{name}: range_low must be < range_high")
    rows["rate"], rows["since_start"] = rate, 0.0  # its stamp in the run is that of scan 0
    return rows


def _commands(
    source: Foreign,
    mapping: Mapping,
    drive: Foreign | None,
    followed: NDArray[np.float64] | None,
    stamps: NDArray[np.int64],
    start_ns: int,
) -> tuple[tuple[int, float, float], ...]:
    """Return when which drive was commanded: by a table, by a signal, or one value for all; empty: nothing says so."""
    if drive is not None:
        frequency, current = (drive.signals.get(key) for key in ("frequency", "current"))
        if frequency is None or drive.time_s is None:
            raise ConfigError(f"{drive.path} must have the columns `time` or `stamp_ns`, and `frequency`")
        amplitude = current.values if current is not None else np.full(len(frequency.values), mapping.amplitude)
        if not np.all(np.isfinite(drive.time_s)):
            raise ConfigError(f"{drive.path}: a time is no number")
        first = start_ns + round((drive.begins_s - source.begins_s) * NS_PER_S)  # both count from one instant
        if drive.start_ns is not None and source.start_ns is not None:
            first = drive.start_ns
        instants = [first + round(float(one) * NS_PER_S) for one in drive.time_s]
        return tuple(zip(instants, frequency.values.tolist(), amplitude.tolist(), strict=True))
    if followed is not None:
        return tuple((int(stamps[scan]), float(followed[scan]), mapping.amplitude) for scan in _changes(followed))
    if isinstance(mapping.frequency, float):
        return ((start_ns, mapping.frequency, mapping.amplitude),)
    return ()


def _changes(values: NDArray[np.float64]) -> list[int]:
    """Return where a signal has another value than before, the first scan included; NaN is one value, unknown."""
    same = (values[1:] == values[:-1]) | (np.isnan(values[1:]) & np.isnan(values[:-1]))
    return [0, *(np.flatnonzero(~same) + 1).tolist()]


def _with_amplitude(
    commands: Sequence[tuple[int, float, float]], found: AnyMapping[str, NDArray[np.float64]], stamps: NDArray[np.int64]
) -> Iterator[tuple[int, float, float]]:
    """Yield the commands; where none says an amplitude, that of current or base as measured: √2 times its rms."""
    values = next((found[name] for name in ("current", "base") if name in found), np.zeros(len(stamps)))
    ends = [*(one[0] for one in commands[1:]), math.inf]
    for (instant, frequency, amplitude), end in zip(commands, ends, strict=True):
        part = values[(stamps >= instant) & (stamps < end)]
        known = not math.isnan(amplitude) or not len(part)
        yield instant, frequency, amplitude if known else math.sqrt(2.0) * float(np.std(np.nan_to_num(part)))


def _frequency_of(found: AnyMapping[str, NDArray[np.float64]], rate: int) -> float:
    """Return the frequency of the largest line of base, current, laser or acceleration, by a sine fit; 0 if none."""
    from impact_rig.analysis.sine import fit_sine_frequency  # noqa: PLC0415  # only where no frequency is given
    from impact_rig.states import Status  # noqa: PLC0415  # as above

    values = next(found[name] for name in ("base", "current", "laser", "accelerometer") if name in found)
    part = values[-min(len(values), 20 * rate) :]
    if not np.all(np.isfinite(part)) or not float(np.ptp(part)) > 0.0:
        return 0.0
    lines = np.abs(np.fft.rfft((part - part.mean()) * np.hanning(len(part))))
    coarse = float(np.argmax(lines[1:]) + 1) * rate / len(part)
    fit = fit_sine_frequency(part, rate, coarse)
    return fit.frequency_hz if fit.status is Status.OK else coarse


WRITTEN = (topics.INFO, topics.APPLIED, topics.NOTES, topics.SCAN, topics.TRANSMISSIBILITY_TABLE, topics.IMPACTS)


def write(found: ImportedFile, directory: Path, clock_ns: int | None = None) -> Path:
    """Write a measurement as a run, with what the analysis finds in it; return the directory.

    Raises:
        RecordingError: it cannot be written, or holds a recording already.
    """
    now = time.time_ns() if clock_ns is None else clock_ns
    about = {MODE_KEY: MEASURED, "source": found.source.path.name, "format": found.source.kind}
    provenance = Provenance(version=impact_rig.__version__, seed=0, wall_start_ns=now, extra=about)
    kept = Attachment(MAPPING_FILE, as_yaml(found.mapping).encode(), "application/yaml")
    if directory.is_dir() and any(directory.iterdir()):
        raise RecordingError(f"{directory} is not empty: nothing is overwritten")
    numbers: dict[str, int] = {}
    with RunWriter(directory, provenance=provenance, attachments=(kept,), clock=time.monotonic) as writer:
        for topic in WRITTEN:
            writer.add_topic(TopicDescription(name=f"/{topic.name}", type_name=topic.type_name))

        def put(topic: topics.Topic, data: bytes) -> None:
            numbers[topic.name] = numbers.get(topic.name, 0) + 1
            writer.write(f"/{topic.name}", data, now, numbers[topic.name])

        def tell(findings: Findings) -> None:
            for one in findings.impacts:
                put(topics.IMPACTS, codec.encode(one))
            for one in findings.measurements:
                put(topics.TRANSMISSIBILITY_TABLE, codec.encode(one))

        tracker = Tracker()
        for topic, one in _heads(found):
            put(topic, one if isinstance(one, bytes) else codec.encode(one))
            if isinstance(one, Table):
                (tracker.configure if topic is topics.INFO else tracker.on_applied)(one)
        for label in filter(None, map(parse_label, found.labels)):
            tracker.label(label.gap_m, label.stamp_ns)
        for block in _blocks(found):
            put(topics.SCAN, codec.encode(block))
            tell(tracker.feed(block))
        tell(tracker.flush())
    return directory


def _heads(found: ImportedFile) -> Iterator[tuple[topics.Topic, Table | bytes]]:
    """Yield what is known before the first scan."""
    yield topics.INFO, Table(found.start_ns, found.info)
    for instant, frequency, current in found.drive:
        row = np.zeros(1, APPLIED)
        row["frequency"], row["current"] = frequency, current
        row["sample"] = max(0, round((instant - found.start_ns) * found.rate_hz / NS_PER_S))
        yield topics.APPLIED, Table(instant, row)
    for text in found.labels:
        words = text.encode() + b"\0"
        yield topics.NOTES, b"\x00\x01\x00\x00" + len(words).to_bytes(4, "little") + words


def _blocks(found: ImportedFile) -> Iterator[Table]:
    """Yield the scans in blocks, a new one after each loss."""
    length = max(1, min(BLOCK_SCANS, round(BLOCK_S * found.rate_hz)))
    cuts = [0, *(np.flatnonzero(np.diff(found.index) != 1) + 1).tolist(), len(found.index)]
    for first, end in itertools.pairwise(cuts):
        for begin in range(first, end, length):
            rows = found.rows[begin : min(begin + length, end)].copy()
            rows["time"] = np.arange(len(rows)) / found.rate_hz
            yield Table(stamp_ns(int(found.index[begin]), found.rate_hz, found.start_ns), rows)
