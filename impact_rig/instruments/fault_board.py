# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The faults of a rig as they act, each with what it carries from scan to scan.

Faults of a channel act on the volts of its cable, so they pass through the converter like the real thing; `stuck` acts
behind it. `lost_block` and `clock_drift` concern the whole board: the rig asks `FaultBoard` about them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.random import Random
from impact_rig.blocks import FAULTS
from impact_rig.errors import CommandError
from impact_rig.instruments.fault import Fault

_STREAM = 2  # first number of the spawn key of every fault's generator


@attrs.define(eq=False)
class _Active:
    """A fault on the board, with what it carries from scan to scan."""

    number: int
    fault: Fault
    end: float  # first scan it no longer acts on
    random: Random

    def overlap(self, first: int, count: int) -> slice:
        """Return the part of the scans first … first + count it acts on."""
        low = min(max(self.fault.start_sample, first), first + count)
        high = min(max(self.end, low), first + count)
        return slice(low - first, int(high) - first)


class FaultBoard:
    """All faults of a rig, planned or injected."""

    def __init__(self, faults: Iterable[Fault], rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._faults: list[_Active] = []
        self._last_number = 0
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> int:
        """Put a fault on the board and return its number."""
        self._last_number += 1
        end = fault.start_sample + fault.samples if fault.samples else math.inf
        random = Random(np.random.SeedSequence(fault.seed, spawn_key=(_STREAM,)))
        self._faults.append(_Active(self._last_number, fault, end, random))
        return self._last_number

    def numbers(self) -> tuple[int, ...]:
        """Return the numbers of the faults that are not forgotten."""
        return tuple(active.number for active in self._faults)

    def clear(self, number: int | None, scan: int) -> None:
        """End one fault, or all, at a scan; a fault that would have started later never does.

        Raises:
            CommandError: there is no such fault.
        """
        chosen = [active for active in self._faults if number in (None, active.number)]
        if number is not None and not chosen:
            raise CommandError(f"no fault number {number}")
        for active in chosen:
            active.end = min(active.end, max(scan, active.fault.start_sample))
        self._faults = [active for active in self._faults if active.end > active.fault.start_sample]

    def on_cable(
        self, channel: str, volts: NDArray[np.float64], clipped: NDArray[np.bool_], first: int, gain: float, zero: float
    ) -> None:
        """Let the faults of a channel act on the volts of its cable, in place; nominal gain [V/unit] and zero [V]."""
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
                clipped[:] = False  # nobody notices an open cable by its range
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
        """Let a stuck converter repeat itself, in place; `last` is the reading before these."""
        for active in self._faults:
            if active.fault.channel == channel and active.fault.kind == "stuck":
                part = active.overlap(first, len(readings))
                if part.stop > part.start:
                    held = readings[part.start - 1] if part.start else readings[0] if last is None else last
                    readings[part] = held
                    clipped[part] = False

    def rows(self, first: int, count: int) -> NDArray[np.void]:
        """Return the `blocks.FAULTS` rows of the scans first … first + count: starts and ends, in order.

        Faults that ended before these scans are forgotten.
        """
        self._faults = [active for active in self._faults if active.end >= first]
        events: list[tuple[int, int, int, _Active]] = []
        for active in self._faults:
            for scan, starts in ((active.fault.start_sample, 1), (active.end, 0)):
                if first <= scan < first + count:
                    events.append((int(scan), 1 - starts, active.number, active))
        rows = np.zeros(len(events), dtype=FAULTS)
        for row, (scan, ends, number, active) in enumerate(sorted(events, key=lambda event: event[:3])):
            fault = active.fault
            rows[row] = (
                (scan - first) / self._rate_hz,
                scan,
                number,
                fault.kind.encode(),
                fault.channel.encode(),
                1 - ends,
                fault.value,
                fault.samples / self._rate_hz,
            )
        return rows

    def block_lost(self, first: int, count: int) -> bool:
        """Whether a lost_block fault acts on any of these scans."""
        lost = (active for active in self._faults if active.fault.kind == "lost_block")
        return any(active.fault.start_sample < first + count and active.end > first for active in lost)

    def clock_ppm(self, scan: int) -> float:
        """Return by how much the scan clock is off at a scan because of faults [ppm]."""
        drifts = (active for active in self._faults if active.fault.kind == "clock_drift")
        return math.fsum(active.fault.value for active in drifts if active.fault.start_sample <= scan < active.end)
