# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One channel: a sensor's dynamics, its output stage, its cable's faults, the converter, and readings not yet taken."""

from __future__ import annotations

from collections import deque

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import TWO_PI, sincos
from impact_rig.arithmetic.random import Random
from impact_rig.instruments import conversion
from impact_rig.instruments.calibration import BoardErrors, Errors
from impact_rig.instruments.clock import ScanClock
from impact_rig.instruments.conversion import Converter, OutputStage
from impact_rig.instruments.fault import FaultBoard
from impact_rig.instruments.pieces import Motion, Pieces, first_value
from impact_rig.instruments.response import Response
from impact_rig.instruments.sensor import Adc, Sensor
from impact_rig.kernels import INTEGERS, REALS, entry

Instants = tuple[NDArray[np.int64], NDArray[np.float64]]
"""(tick, offset into it [s]), shapes (n,)."""


@attrs.frozen(eq=False)
class Stretch:
    """Consecutive ticks of a motion, as `Chain.acquire` got them.

    Attributes:
        motion: covers them.
        motion_tick: the motion's number of the first.
        first_tick: the chain's number of the first.
        ticks: how many.
        tick_s: duration of one [s].
    """

    motion: Motion
    motion_tick: int
    first_tick: int
    ticks: int
    tick_s: float


@attrs.frozen
class Sine:
    """A calibration sine in place of a channel's input, over some ticks; amplitude in the channel's unit."""

    first_tick: int
    ticks: int
    frequency_hz: float
    amplitude: float

    def covers(self, tick: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Whether the sine is on during each of some ticks."""
        return (tick >= self.first_tick) & (tick < self.first_tick + self.ticks)

    def replace(self, values: NDArray[np.float64], stretch: Stretch, at: Instants) -> None:
        """Overwrite the values, shape (n,), at those instants that lie in the sine's ticks."""
        tick = at[0] - stretch.motion_tick + (stretch.first_tick - self.first_tick)
        _sine(tick, at[1], self.ticks, stretch.tick_s, TWO_PI * self.frequency_hz, self.amplitude, values)


@entry(INTEGERS, REALS, int, float, float, float, REALS)
def _sine(tick, offset, ticks, tick_s, omega, amplitude, values):  # type: ignore[no-untyped-def]  # compiled: inferred
    for i in range(values.shape[0]):
        if 0 <= tick[i] < ticks:
            sine, _ = sincos(omega * (tick[i] * tick_s + offset[i]))
            values[i] = amplitude * sine


class Queue:
    """Readings that have not been taken: arrays as they came, copied at most once however they are cut."""

    def __init__(self) -> None:
        self.waiting = 0
        self._parts: deque[tuple[NDArray[np.float64], NDArray[np.bool_]]] = deque()

    def put(self, readings: NDArray[np.float64], clipped: NDArray[np.bool_]) -> None:
        """Append readings and whether each was clipped, both shape (n,)."""
        if len(readings):
            self._parts.append((readings, clipped))
            self.waiting += len(readings)

    def take(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Remove and return the oldest `count`, no more than are waiting."""
        self.waiting -= count
        if self._parts and len(self._parts[0][0]) >= count:
            return self._split(count)
        taken = []
        while count:
            taken.append(self._split(min(count, len(self._parts[0][0]))))
            count -= len(taken[-1][0])
        return (
            np.concatenate([np.empty(0), *(readings for readings, _ in taken)]),
            np.concatenate([np.empty(0, dtype=np.bool_), *(clipped for _, clipped in taken)]),
        )

    def _split(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        readings, clipped = self._parts.popleft()
        if count < len(readings):
            self._parts.appendleft((readings[count:], clipped[count:]))
        return readings[:count], clipped[:count]


class Channel:
    """A sensor on its converter channel, ideal or not; carries everything that goes on from tick to tick.

    Args:
        sensor: what it senses and how.
        adc: the converter.
        clock: the scan clock.
        index: place in the scan.
        errors: the sensor's own.
        board: the converter's own.
        noise: of the sensor.
        converter_noise: of the converter, on this channel.
        ideal: read the motion itself.
    """

    def __init__(
        self,
        sensor: Sensor,
        adc: Adc,
        clock: ScanClock,
        index: int,
        errors: Errors,
        board: BoardErrors,
        noise: Random,
        converter_noise: Random,
        ideal: bool,
    ) -> None:
        self.sensor = sensor
        self.ideal = ideal
        self.response = Response(sensor.transfer.modes(), clock, index)
        self.sine: Sine | None = None
        self._errors, self._board = errors, board
        self._noise, self._converter_noise = noise, converter_noise
        self._period_s = 1.0 / clock.rate_hz
        self._coloured = np.zeros(1)
        self._last: float | None = None
        self._awake = False
        self._queue = Queue()
        self._stage, self._converter = self._stages(adc)

    @property
    def waiting(self) -> int:
        """How many readings have not been taken."""
        return self._queue.waiting

    def take(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Remove and return the oldest readings [unit] and whether each was clipped."""
        return self._queue.take(count)

    def change(self, sensor: Sensor, adc: Adc, clock: ScanClock, ideal: bool) -> None:
        """Become another sensor from the next tick on; noise streams go on, dynamics too where they are the same."""
        modes = sensor.transfer.modes()
        unchanged = modes.same_as(self.response.modes) and self.ideal == ideal
        self.sensor, self.ideal = sensor, ideal
        self._stage, self._converter = self._stages(adc)
        self.response.adopt(modes, clock, keep_state=unchanged)
        self._awake = self._awake and unchanged

    def see(
        self, stretch: Stretch, pieces: Pieces, nodes: Instants, values: NDArray[np.float64], kicks: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Put the calibration sine, if one is on, in place of what the sensor would see; return the kicks that remain.

        Args:
            stretch: the ticks.
            pieces: the same, cut.
            nodes: where the quantity was sampled, `pieces.nodes()`.
            values: what it is there, shape (pieces · NODES,); changed in place.
            kicks: jump of the quantity's integral at the start of each piece, shape (pieces,).
        """
        if self._replace(stretch, nodes, values) and self.sine is not None:
            tick = pieces.tick - stretch.motion_tick + stretch.first_tick
            kicks = np.where(self.sine.covers(tick), 0.0, kicks)
        return kicks

    def respond(
        self, pieces: Pieces, coefficients: NDArray[np.float64], kicks: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return what the sensor's dynamics put out at the conversions in the next ticks [unit], shape (n,).

        Args:
            pieces: the ticks, cut.
            coefficients: polynomial of the quantity on each piece, shape (pieces, NODES).
            kicks: jump of its integral at the start of each piece, shape (pieces,).
        """
        if not self._awake:
            self._awake = True
            if self.sensor.settled:
                self.response.settle(first_value(coefficients))
        return self.response.run(pieces, coefficients, kicks)

    def read_directly(self, stretch: Stretch, instants: Instants, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the quantity itself, as an ideal instrument does, or the calibration sine in its place."""
        self._replace(stretch, instants, values)
        return values

    def convert(self, clean: NDArray[np.float64], faults: FaultBoard) -> None:
        """Turn what the dynamics put out into readings, through output stage, cable and converter.

        Args:
            clean: output at the newest conversions [unit], shape (n,).
            faults: what acts on cable and converter.
        """
        sensor, first_scan = self.sensor, self.response.converted - len(clean)
        if self.ideal:
            readings, clipped = clean, np.zeros(len(clean), dtype=np.bool_)
            faults.on_cable(sensor.name, readings, clipped, first_scan, 1.0, 0.0)
        else:
            volts, clipped = conversion.to_volts(self._stage, clean, self._noise, self._coloured)
            faults.on_cable(sensor.name, volts, clipped, first_scan, sensor.volt_per_unit, sensor.offset_v)
            readings = conversion.to_units(self._converter, volts, self._converter_noise, clipped)
        faults.behind_converter(sensor.name, readings, clipped, first_scan, self._last)
        if len(readings):
            self._last = float(readings[-1])
        self._queue.put(readings, clipped)

    def _replace(self, stretch: Stretch, at: Instants, values: NDArray[np.float64]) -> bool:
        """Put the calibration sine in place of the values where it is on; return whether there is one."""
        if self.sine is not None and stretch.first_tick >= self.sine.first_tick + self.sine.ticks:
            self.sine = None
        if self.sine is None:
            return False
        self.sine.replace(values, stretch, at)
        return True

    def _stages(self, adc: Adc) -> tuple[OutputStage, Converter]:
        return (
            conversion.output_stage(self.sensor, self._errors, self._period_s),
            conversion.converter(self.sensor, adc, self._board),
        )
