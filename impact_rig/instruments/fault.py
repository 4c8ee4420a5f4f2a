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
"""Faults of instruments, planned or injected: their text form, their times in scans, and their effect on the readings.

A configuration plans faults in lines of text, with times in seconds since the reset:

    offset_step channel=laser start_s=2 duration_s=0.5 value=1e-3 seed=7

`duration_s=0` (the default) means until the fault is cleared. Faults of the whole board have no `channel`.

`FaultBoard` holds the faults of a rig. Most faults of a channel change the volts on its cable, ahead of the converter.
`stuck` changes the readings behind the converter. `lost_block` and `clock_drift` concern the whole board.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.random import Random
from impact_rig.blocks import FAULTS
from impact_rig.config.fields import names
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.instrument import BOARD_KINDS, FAULT_KINDS
from impact_rig.instruments.registry import INSTRUMENTS

DEFAULT_SPIKE_RATE_HZ = 10.0
MOST = 2**53  # largest integer: the columns of `truth/faults` are not exact beyond it
LARGEST_DRIFT_PPM = 5e5
"""Largest drift of the scan clock that faults can cause [ppm], in either direction. At −10⁶ ppm a tick of the clock
would take no time, and at a very large drift it would take so long that the rig seems to stop.
"""
_NUMBERS = ("start_s", "duration_s", "value", "seed", "rate_hz")
_COUNTS = ("start_sample", "samples", "seed")


@attrs.frozen(kw_only=True)
class Fault:
    """One fault of an instrument or of the whole board, with times in scans since the reset.

    Attributes:
        kind: kind of fault, such as `dropout`, `stuck` or `offset_step`; docs/reference/instruments.md lists all kinds.
        channel: channel that it acts on: accelerometer, laser, base or current. Empty (the default) for faults of the
            whole board.
        start_sample: first scan that it acts on (default: 0).
        samples: number of scans that it lasts; 0, the default, means until it is cleared.
        value: size, in the channel's unit or as the kind defines it (default: 0).
        seed: seed of its own random numbers (default: 0).
        rate_hz: mean rate of a spike train [Hz] (default: 10).

    Raises:
        CommandError: the kind or channel does not exist, or a number is out of range.

    Examples:
        >>> import impact_rig
        >>> fault = impact_rig.Fault(kind="offset_step", channel="laser", start_sample=5000, samples=2000, value=1e-3)
        >>> print(fault)
        offset_step on laser from sample 5000 to sample 7000, value 0.001

        The laser of a rig at rest reads 0 m, and 1 mm during the fault:

        >>> rig = impact_rig.LocalRig(faults=[fault])
        >>> rig.run(seconds=1)
        >>> laser = rig.rows("daq/scan")["laser"]
        >>> print(f"{laser[:5000].mean():.5f} {laser[5000:7000].mean():.5f}")
        0.00000 0.00100

    See Also:
        - `LocalRig`: plans faults (`faults`), and adds them while it runs (`inject`).
    """

    kind: str
    channel: str = ""
    start_sample: int = 0
    samples: int = 0
    value: float = 0.0
    seed: int = 0
    rate_hz: float = DEFAULT_SPIKE_RATE_HZ

    def __attrs_post_init__(self) -> None:
        _check_kind(self.kind, self.channel)
        for key in (*_COUNTS, "rate_hz", "value"):
            number = getattr(self, key)
            if not math.isfinite(number) or (number < 0 and key != "value"):
                rule = "finite" if key == "value" else "finite and >= 0"
                raise CommandError(f"{key} of the fault {self.kind} must be {rule}, got {number!r}")
            if key in _COUNTS and number > MOST:
                raise CommandError(f"{key} of the fault {self.kind} must be at most 2**53, got {number:.17g}")
        if self.kind == "clock_drift" and abs(self.value) > LARGEST_DRIFT_PPM:
            raise CommandError(
                f"value of the fault clock_drift, by which the clock is slow, must be within ± {LARGEST_DRIFT_PPM:g} "
                f"ppm, got {self.value!r} ppm"
            )

    def line(self, scan_rate_hz: int) -> str:
        """Return the fault as one line of text for `instruments.faults.planned`, with its times in seconds.

        `from_line` converts the line back to a fault. The line leaves out numbers that equal their defaults.

        Args:
            scan_rate_hz: scans per second of the rig, to convert numbers of scans to seconds.
        """
        numbers = (self.start_sample / scan_rate_hz, self.samples / scan_rate_hz, self.value, self.seed, self.rate_hz)
        return fault_line(self.kind, self.channel, **dict(zip(_NUMBERS, numbers, strict=True)))

    @classmethod
    def from_line(cls, line: str, scan_rate_hz: int) -> Fault:
        """Return the fault that a line of text describes, such as `offset_step channel=laser start_s=2 value=1e-3`.

        Args:
            line: kind, then `key=value` with the keys channel, start_s, duration_s, value, seed and rate_hz. A missing
                key has its default.
            scan_rate_hz: scans per second of the rig. Times are rounded up to whole scans.

        Raises:
            ConfigError: the kind, channel or key is unknown, or a value is malformed or out of range.
        """
        kind, *pairs = line.split() or [""]
        texts = dict(pair.partition("=")[::2] for pair in pairs)
        channel = texts.pop("channel", "")
        values = {key: _number(line, key, text) for key, text in texts.items()}
        duration_s = values.get("duration_s", 0.0)
        try:
            return cls(
                kind=kind,
                channel=channel,
                start_sample=_scans(values.get("start_s", 0.0), scan_rate_hz),
                samples=max(_scans(duration_s, scan_rate_hz), int(duration_s > 0.0)),  # 0 means without end
                value=values.get("value", 0.0),
                seed=int(values.get("seed", 0.0)),
                rate_hz=values.get("rate_hz", DEFAULT_SPIKE_RATE_HZ),
            )
        except CommandError as error:
            raise ConfigError(f"{error}, in {line!r}") from error

    def __str__(self) -> str:
        where = f" on {self.channel}" if self.channel else ""
        until = f"sample {self.start_sample + self.samples}" if self.samples else "the end"
        size = f", value {self.value:g}" if self.value else ""
        return f"{self.kind}{where} from sample {self.start_sample} to {until}{size}"


def fault_line(kind: str, channel: str, **numbers: float) -> str:
    """Return one line of text that describes a fault, in the form that `Fault.from_line` reads.

    `numbers` may be start_s [s], duration_s [s], value, seed and rate_hz [Hz]. The line leaves out numbers that equal
    their defaults.
    """
    usual = dict.fromkeys(_NUMBERS, 0) | {"rate_hz": DEFAULT_SPIKE_RATE_HZ}
    given = [f"{key}={number!r}" for key, number in numbers.items() if number != usual[key]]
    return " ".join([kind, *([f"channel={channel}"] if channel else []), *given])


@attrs.frozen(kw_only=True)
class FaultPlan:
    """Section `instruments.faults` of a configuration: the planned faults as lines of text; empty by default."""

    planned: tuple[str, ...] = names(
        (),
        "Faults: `kind channel=... start_s=... duration_s=... value=...`; start_s counts from the reset, or from when "
        "the line is added to a running rig.",
    )

    def __attrs_post_init__(self) -> None:
        try:
            self.faults(scan_rate_hz=1)
        except ConfigError as error:
            raise ConfigError(f"planned: {error}") from error

    def faults(self, scan_rate_hz: int) -> tuple[Fault, ...]:
        """Return the planned faults, with times rounded up to whole scans at this scan rate; empty lines are ignored.

        Raises:
            ConfigError: a line is malformed; the message quotes it.
        """
        return tuple(Fault.from_line(line, scan_rate_hz) for line in self.planned if line.split())


def _check_kind(kind: str, channel: str) -> None:
    """Raise a CommandError if the kind of fault is unknown or does not fit the channel."""
    if kind not in FAULT_KINDS:
        raise CommandError(f"fault kind must be one of {', '.join(FAULT_KINDS)}, got {kind!r}")
    if kind in BOARD_KINDS:
        if channel:
            raise CommandError(f"{kind} is a fault of the whole board, not of a channel: omit the channel {channel!r}")
        return
    having = [name for name, instrument in INSTRUMENTS.items() if kind in instrument.faults]
    if channel not in having:
        raise CommandError(f"{kind} needs a channel, one of {', '.join(having)}, got {channel!r}")


def _number(line: str, key: str, text: str) -> float:
    if key not in _NUMBERS:
        raise ConfigError(f"key of a fault must be one of channel, {', '.join(_NUMBERS)}, got {key!r} in {line!r}")
    try:
        number = float(text)
    except ValueError as error:
        raise ConfigError(f"{key} of a fault must be a number, got {text!r} in {line!r}") from error
    if not math.isfinite(number) or (key != "value" and number < 0) or (key == "seed" and not number.is_integer()):
        rule = {"value": "finite", "seed": "an integer >= 0"}.get(key, "finite and >= 0")
        raise ConfigError(f"{key} of a fault must be {rule}, got {text} in {line!r}")
    return number


def _scans(seconds: float, rate_hz: int) -> int:
    return math.ceil(min(seconds * rate_hz, sys.float_info.max) - 1e-6)


_STREAM = 2  # first number of the spawn key of every fault's generator
_NO_ROWS = np.zeros(0, FAULTS)


@attrs.define(eq=False)
class _Active:
    """Entry of a `FaultBoard` for one fault: the fault, its number, its end and its random generator."""

    number: int
    fault: Fault
    end: float  # first scan after its effect
    random: Random

    def overlap(self, first: int, count: int) -> slice:
        """Return the scans in which the fault acts, as a slice of the `count` scans from scan number `first` on."""
        low = min(max(self.fault.start_sample, first), first + count)
        high = min(max(self.end, low), first + count)
        return slice(low - first, int(high) - first)


class FaultBoard:
    """All faults of a rig, numbered from 1, with methods that apply them to volts, readings and the scan clock."""

    def __init__(self, faults: Iterable[Fault], rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._faults: list[_Active] = []
        self._last_number = 0
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> int:
        """Add a fault and return its number, which `clear` accepts.

        The fault is not validated here; see `Chain.inject`.
        """
        self._last_number += 1
        end = fault.start_sample + fault.samples if fault.samples else math.inf
        random = Random(np.random.SeedSequence(fault.seed, spawn_key=(_STREAM,)))
        self._faults.append(_Active(self._last_number, fault, end, random))
        return self._last_number

    def numbers(self) -> tuple[int, ...]:
        """Return the numbers of the stored faults.

        A fault that has ended remains stored until `rows` removes it.
        """
        return tuple(active.number for active in self._faults)

    def clear(self, number: int | None, scan: int) -> None:
        """End one fault, or all faults if `number` is None.

        Scan number `scan` is the first scan without the fault. A fault that would start at this scan or later never
        acts. Clearing a fault that has ended has no effect.

        Raises:
            CommandError: no fault has had this number since the reset.
        """
        if number is not None and not 0 < number <= self._last_number:
            known = f"1 to {self._last_number}" if self._last_number else "none"
            raise CommandError(
                f"no fault number {number}; numbers of faults planned or injected since the reset: {known}"
            )
        chosen = [active for active in self._faults if number in (None, active.number)]
        for active in chosen:
            active.end = min(active.end, max(scan, active.fault.start_sample))
        self._faults = [active for active in self._faults if active.end > active.fault.start_sample]

    def channels(self) -> set[str]:
        """Return the names of the channels of all stored faults; "" stands for faults of the whole board.

        A fault that has ended remains stored until `rows` removes it.
        """
        return {active.fault.channel for active in self._faults}

    def on_cable(
        self, channel: str, volts: NDArray[np.float64], clipped: NDArray[np.bool_], first: int, gain: float, zero: float
    ) -> None:
        """Apply the faults of a channel, except `stuck`, to the volts on its cable, in place.

        `first` is the scan number of the first value. `gain` [V/unit] and `zero` [V] are the sensor's nominal
        sensitivity and output at zero. `clipped` holds a flag for each value, which a dropout clears and a saturation
        sets.
        """
        for active in self._faults:
            if active.fault.channel == channel:
                part = active.overlap(first, len(volts))
                if part.stop > part.start:
                    self._act(active, volts[part], clipped[part], gain, zero)

    def _act(
        self, active: _Active, volts: NDArray[np.float64], clipped: NDArray[np.bool_], gain: float, zero: float
    ) -> None:
        fault, value = active.fault, active.fault.value
        match fault.kind:
            case "dropout":
                volts[:] = 0.0
                clipped[:] = False  # the range of an open cable's reading does not reveal it
            case "offset_step":
                volts += gain * value
            case "gain_error":
                volts += value * (volts - zero)
            case "added_noise":
                volts += gain * value * active.random.normal(len(volts))
            case "spike_train":
                chance = active.random.uniform(len(volts)) * self._rate_hz / max(fault.rate_hz, 1e-300)
                volts += gain * value * np.where(chance < 0.5, 1.0, np.where(chance < 1.0, -1.0, 0.0))
            case "saturation":
                limit = abs(gain * value)
                clipped |= np.abs(volts - zero) >= limit
                np.clip(volts, zero - limit, zero + limit, out=volts)

    def behind_converter(
        self, channel: str, readings: NDArray[np.float64], clipped: NDArray[np.bool_], first: int, last: float | None
    ) -> None:
        """Apply the `stuck` faults of a channel to its readings [unit], in place.

        During such a fault, the last reading before the fault is repeated. `first` is the scan number of the first
        reading. `last` is the reading before it, or None at the start, where the first reading is repeated instead. The
        flags of repeated readings in `clipped` are cleared.
        """
        for active in self._faults:
            if active.fault.channel == channel and active.fault.kind == "stuck":
                part = active.overlap(first, len(readings))
                if part.stop > part.start:
                    held = readings[part.start - 1] if part.start else readings[0] if last is None else last
                    readings[part] = held
                    clipped[part] = False

    def rows(self, first: int, count: int) -> NDArray[np.void]:
        """Return starts and ends of faults in the scans first … first + count − 1, as `blocks.FAULTS` rows in order.

        A fault ends at the first scan that it no longer affects. Call this method once per block, in ascending order:
        it removes the faults that ended before the scan `first`.
        """
        if not self._faults:
            return _NO_ROWS
        self._faults = [active for active in self._faults if active.end >= first]
        events = [
            (int(scan), ends, active.number, active.fault)
            for active in self._faults
            for ends, scan in enumerate((active.fault.start_sample, active.end))
            if first <= scan < first + count
        ]
        rows = np.zeros(len(events), dtype=FAULTS)
        for row, (scan, ends, number, fault) in enumerate(sorted(events, key=lambda event: event[:3])):
            time, duration = (scan - first) / self._rate_hz, fault.samples / self._rate_hz
            kind, channel = fault.kind.encode(), fault.channel.encode()
            rows[row] = time, scan, number, kind, channel, 1 - ends, fault.value, duration
        return rows

    def block_lost(self, first: int, count: int) -> bool:
        """Return whether a `lost_block` fault acts in the scans first … first + count − 1 and withholds their block."""
        lost = (active for active in self._faults if active.fault.kind == "lost_block")
        return any(active.fault.start_sample < first + count and active.end > first for active in lost)

    def clock_ppm(self, scan: int) -> float:
        """Return by how much the `clock_drift` faults slow the scan clock at a scan [ppm].

        The values of all faults that act there are added. The sum is limited to ± `LARGEST_DRIFT_PPM`.
        """
        if not self._faults:
            return 0.0
        drifts = (active for active in self._faults if active.fault.kind == "clock_drift")
        total = math.fsum(active.fault.value for active in drifts if active.fault.start_sample <= scan < active.end)
        return max(-LARGEST_DRIFT_PPM, min(LARGEST_DRIFT_PPM, total))
