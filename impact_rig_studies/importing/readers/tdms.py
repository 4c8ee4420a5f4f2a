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
"""Reader of LabVIEW TDMS files, with npTDMS."""

from __future__ import annotations

import io
from pathlib import Path
from types import ModuleType

import attrs
import numpy as np

from impact_rig.simtime import NS_PER_S
from impact_rig_studies.importing import headings, units
from impact_rig_studies.importing.limits import check_column_count, check_value_count
from impact_rig_studies.importing.signals import (
    NO_ABSCISSA,
    Abscissa,
    AbscissaKind,
    ImportedSignals,
    Real,
    Signal,
    SignalKind,
    UniqueNames,
    even_times,
)

NO_INCREMENT = 1.0  # wf_increment of waveforms whose program set none
UNIT_KEYS = ("unit_string", "NI_UnitDescription", "NI_ChannelUnit", "Unit", "unit", "Units", "units", "UnitSymbol")


def read(path: Path, content: bytes, library: ModuleType) -> ImportedSignals:
    """Read the channels of numbers in all groups of a TDMS file as signals; `library` is nptdms.

    The first channel of times in a group is not a signal: it gives the times of the group's channels. If only one group
    has such a channel, it serves all groups. Channels without values or without real numbers are left out, with the
    reason for the user. The result may have no signals.

    Raises:
        BudgetError: the file claims more values than a file of its size may contain, or too many channels.
    """
    file = library.TdmsFile.read_metadata(io.BytesIO(content))
    channels = [channel for group in file.groups() for channel in group.channels()]
    check_column_count(len(channels))
    check_value_count(sum(len(channel) for channel in channels), len(content))
    file = library.TdmsFile.read(io.BytesIO(content))
    left_out: dict[str, str] = {}
    signals: dict[str, Signal] = {}
    names = UniqueNames()
    several = len(file.groups()) > 1
    counts: dict[str, int] = {}
    for group in file.groups():
        for channel in group.channels():
            counts[channel.name] = counts.get(channel.name, 0) + 1
    start_ns: int | None = None
    times = {group.name: _listed_times(group) for group in file.groups()}
    alone = [one for one in times.values() if one is not None]
    for group in file.groups():
        listed = times[group.name] or (alone[0] if len(alone) == 1 else None)
        for channel in group.channels():
            origin = f"{group.name}/{channel.name}"
            values = np.asarray(channel[:])
            own_times = times[group.name]
            if values.dtype.kind == "M" or (own_times is not None and channel.name == own_times[0]):
                if own_times is None or channel.name != own_times[0]:
                    left_out[origin] = "time stamps"
                continue
            if values.dtype.kind not in "fiub":
                left_out[origin] = "complex numbers" if values.dtype.kind == "c" else "no numbers"
                continue
            if not len(values):
                left_out[origin] = "no values"
                continue
            unit = next((str(channel.properties[key]).strip() for key in UNIT_KEYS if channel.properties.get(key)), "")
            plain, own = headings.split_unit(channel.name)
            rate_hz = next(filter(None, map(_rate_hz, (channel, group, file))), None)
            abscissa, kind = _abscissa(channel, None if listed is None else listed[1], rate_hz, len(values))
            own_ns = _start_ns(channel)
            if start_ns is None:
                start_ns = own_ns
            elif own_ns is not None and abscissa.kind is AbscissaKind.TIME:
                abscissa = attrs.evolve(abscissa, start=abscissa.start + (own_ns - start_ns) / NS_PER_S)
            name = plain if counts[channel.name] == 1 or not several else f"{group.name} {plain}"
            signals[names.unique(name)] = Signal(values.astype(np.float64), unit or own, abscissa, kind, origin)
    return ImportedSignals(path, "TDMS", signals, start_ns, left_out=left_out)


def _rate_hz(holder: object) -> float | None:
    """Return the sampling rate [Hz] that a property of a channel, group or file states; None if there is no rate."""
    stated = ((str(name), _number(one)) for name, one in holder.properties.items())  # type: ignore[attr-defined]  # untyped
    return next(filter(None, (headings.rate_hz(name, one) for name, one in stated if one is not None)), None)


def _abscissa(channel: object, listed: Real | None, rate_hz: float | None, count: int) -> tuple[Abscissa, SignalKind]:
    """Return the abscissa of a channel with `count` values, and the kind of its signal, such as time response.

    The step in the channel's properties takes precedence, then the times `listed` in another channel [s], then
    `rate_hz`, the rate in a property of the channel, its group or the file. A step of `NO_INCREMENT` may mean that no
    step was set: listed times take precedence over it, and if only `rate_hz` is known and contradicts it, there is no
    abscissa. Listed times are ignored if their number is not `count`.
    """
    properties: dict[str, object] = channel.properties  # type: ignore[attr-defined]  # of an untyped library
    step = _number(properties.get("wf_increment"))
    offset = _number(properties.get("wf_start_offset")) or 0.0
    has_times = listed is not None and len(listed) == count
    if step == NO_INCREMENT and has_times:
        step = None
    elif step == NO_INCREMENT and rate_hz and abs(rate_hz - 1.0) > headings.SAME_RATE:
        note = f"several rates are stated: 1 Hz (wf_increment), {rate_hz:g} Hz"
        return attrs.evolve(NO_ABSCISSA, note=note), SignalKind.TIME_RESPONSE
    words = " ".join(str(properties.get(key, "")) for key in ("wf_xname", "wf_xunit_string")).lower()
    if step is not None and step > 0.0:
        if "freq" in words or "hz" in words.split():
            return Abscissa(AbscissaKind.FREQUENCY, "Hz", offset, step), SignalKind.SPECTRUM
        unit = str(properties.get("wf_xunit_string") or "s").strip()
        factor = units.unit_factor(unit, "s") if units.quantity(unit) == "s" else None
        if factor is None:
            return Abscissa(AbscissaKind.OTHER, unit, offset, step), SignalKind.OTHER
        note = "wf_increment is 1 s, as of waveforms without a time step; --scan-rate HZ states another rate"
        note = note if step == NO_INCREMENT else ""
        return Abscissa(AbscissaKind.TIME, unit, offset * factor, step * factor, note=note), SignalKind.TIME_RESPONSE
    if listed is not None and has_times:
        return Abscissa(AbscissaKind.TIME, "s", float(listed[0]), None, listed - listed[0]), SignalKind.TIME_RESPONSE
    return even_times(rate_hz) if rate_hz else NO_ABSCISSA, SignalKind.TIME_RESPONSE


def _listed_times(group: object) -> tuple[str, Real] | None:
    """Return name and times [s] of the first channel of a group that contains times; None if there is none.

    Numbers are converted to seconds by their unit, dates to seconds since the first date.
    """
    for channel in group.channels():  # type: ignore[attr-defined]  # as above
        name, unit = headings.split_unit(channel.name)
        values = np.asarray(channel[:])
        if values.dtype.kind == "M" and len(values) > 1 and not np.isnat(values).any():
            ns = values.astype("datetime64[ns]").astype(np.int64)
            return channel.name, (ns - ns[0]) / NS_PER_S
        unit = unit or next((str(channel.properties[key]) for key in UNIT_KEYS if channel.properties.get(key)), "")
        unit = headings.time_unit(name, unit) or "s"
        is_column = values.dtype.kind in "fiu" and len(values) > 1
        if is_column and headings.is_time_name(name) and units.quantity(unit) == "s":
            return channel.name, values.astype(np.float64) * (units.unit_factor(unit, "s") or 1.0)
    return None


def _start_ns(channel: object) -> int | None:
    begin = channel.properties.get("wf_start_time")  # type: ignore[attr-defined]  # as above
    if not isinstance(begin, np.datetime64) or np.isnat(begin):
        return None
    ns = int(begin.astype("datetime64[ns]").astype(np.int64))
    return ns if 0 < ns < 2**62 else None


def _number(value: object) -> float | None:
    try:
        number = float(value)  # type: ignore[arg-type]  # whatever a property holds
    except (TypeError, ValueError):
        return None
    return number if np.isfinite(number) else None
