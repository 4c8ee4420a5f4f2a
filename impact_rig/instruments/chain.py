# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The instruments of a rig as one chain: whole ticks of motion go in, whole scans come out.

Like a board with a FIFO: `acquire` converts everything whose instant lies in the ticks it is given, `read` takes scans
away. Every random number, every filter and every conversion time belongs to a scan or a tick, so neither the number of
ticks per call nor the block length changes one bit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.random import Random
from impact_rig.blocks import joined
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments import calibration
from impact_rig.instruments.channel import Channel, Instants, Sine, Stretch
from impact_rig.instruments.clock import scan_clock
from impact_rig.instruments.fault import Fault, FaultBoard
from impact_rig.instruments.pieces import PIECES_PER_PERIOD, Limits, Motion, Pieces, cut, polynomials
from impact_rig.instruments.section import Setup, row_type_of
from impact_rig.instruments.sensor import Sensor
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S, NS_PER_S

SEED_STREAM = 1
"""First number of the spawn key of every generator of the instruments."""
_LONGEST_PIECE_S = 2.5e-3
_LONGEST_PULSE_PIECE_S = 16e-6
"""Integration steps inside a contact are joined up to this: three polynomials hold one of 40 µs to 0.1 %."""
_TICKS_AT_ONCE = 25
"""Arrays of a quarter of a second fit into the caches; the bits are the same for any number."""
_JUMPS = "a_1"
"""The one quantity whose integral an instantaneous impact makes jump."""
_ERRORS, _NOISE, _CONVERTER_NOISE, _BOARD = range(4)


def sensors(config: Setup) -> list[Sensor]:
    """Return the sensors of a configuration in scan order, the anti-alias filter of the board behind them."""
    return [instrument.sensor().behind(config.instruments.adc) for instrument in config.instruments.fitted()]


class Chain:
    """All channels of a rig.

    Args:
        config: the rig's configuration; `daq.seed` seeds noise and calibration errors.

    Raises:
        ConfigError: the converter cannot do it.
    """

    def __init__(self, config: Setup) -> None:
        self._config = config
        self.reset()

    @property
    def config(self) -> Setup:
        """The configuration in force."""
        return self._config

    @property
    def ready(self) -> int:
        """How many whole scans can be read."""
        return len(self._rows) - self._taken + self._gatherable

    @property
    def _gatherable(self) -> int:
        return min(channel.waiting for channel in self._channels)

    @property
    def next_scan(self) -> int:
        """Index of the first scan not yet read."""
        return self._next_scan

    @property
    def first_open_scan(self) -> int:
        """Index of the first scan of which no channel has been converted: where a fault can still start."""
        return max(channel.response.converted for channel in self._channels)

    def reset(self) -> None:
        """Start over at scan 0 with the seeds as new: the same motion gives the same bits again."""
        config = self._config
        self._clock = scan_clock(config)
        adc, ideal = config.instruments.adc, config.instruments.ideal
        self._sensors = sensors(config)
        board = calibration.draw_board(Random(self._seed(_BOARD, 0)))
        places = [instrument.place for instrument in config.instruments.fitted()]
        self._channels = [
            Channel(
                sensor,
                adc,
                self._clock,
                index,
                calibration.draw(Random(self._seed(_ERRORS, place))),
                board,
                Random(self._seed(_NOISE, place)),
                Random(self._seed(_CONVERTER_NOISE, place)),
                ideal,
            )
            for index, (place, sensor) in enumerate(zip(places, self._sensors, strict=True))
        ]
        self._names = tuple(sensor.name for sensor in self._sensors)
        self._quantities = tuple(sensor.quantity for sensor in self._sensors)
        rate = config.daq.rate_hz
        self._faults = FaultBoard(config.instruments.faults.faults(rate), rate)
        self._rows = np.zeros(0, dtype=row_type_of(config.instruments))
        self._taken = 0
        self._times = np.zeros(0)  # of the last read: blocks are all of one length
        self._next_scan = 0
        self._tick = 0

    def reconfigure(self, config: Setup) -> None:
        """Change the instruments from the next tick on; counters, noise and faults go on.

        Raises:
            ConfigError: scan rate, channels, seed or planned faults differ: they need a reset.
        """
        fitted = tuple(instrument.name for instrument in config.instruments.fitted())
        for key, old, new in (
            ("the list of instruments that are present", self._names, fitted),
            ("daq.rate_hz", self._config.daq.rate_hz, config.daq.rate_hz),
            ("daq.seed", self._config.daq.seed, config.daq.seed),
            (
                "instruments.faults.planned",
                self._config.instruments.faults.planned,
                config.instruments.faults.planned,
            ),
        ):
            if old != new:
                raise ConfigError(f"{key} cannot change without a reset: is {old}, got {new}")
        if config.instruments == self._config.instruments:
            self._config = config
            return
        self._clock = scan_clock(config)
        self._config = config
        self._sensors = sensors(config)
        for channel, sensor in zip(self._channels, self._sensors, strict=True):
            channel.change(sensor, config.instruments.adc, self._clock, config.instruments.ideal)

    def acquire(self, motion: Motion, motion_tick: int, count: int, tick_s: float = COMMAND_GRID_S) -> None:
        """Convert every scan that falls into the next ticks.

        Args:
            motion: covers the ticks; every tick must come once, in order.
            motion_tick: the motion's number of the first tick.
            count: of ticks.
            tick_s: duration of one tick in the motion's time [s]: 10 ms, scaled by the error of the scan clock.
        """
        rough = motion.breakpoints()
        blows = motion.impacts[motion.impacts["duration"] == 0.0]
        for first in range(0, count, _TICKS_AT_ONCE):
            ticks = min(_TICKS_AT_ONCE, count - first)
            stretch = Stretch(motion, motion_tick + first, self._tick, ticks, tick_s)
            if self._config.instruments.ideal:
                self._acquire_directly(stretch)
            else:
                self._acquire(stretch, rough, blows)
            self._tick += ticks

    def read(self, count: int) -> NDArray[np.void]:
        """Return the next `count` scans as `scan.row_type_of` the instruments; `time` counts from the first of them.

        Raises:
            ValueError: fewer are ready.
        """
        if not 0 <= count <= self.ready:
            raise ValueError(f"count must be 0 to {self.ready}, the scans that are ready, got {count}")
        if len(self._times) != count:
            self._times = np.arange(count) / self._config.daq.rate_hz
        if self._taken + count > len(self._rows):
            self._gather()
        rows = self._rows[self._taken : self._taken + count]
        rows["time"] = self._times
        self._taken += count
        if self._taken == len(self._rows):  # nothing of them is kept that nobody needs
            self._rows, self._taken = np.zeros(0, self._rows.dtype), 0
        self._next_scan += count
        return rows

    def _gather(self) -> None:
        """Make rows of all that every channel has: once for all blocks that will be cut from them."""
        count, left = self._gatherable, self._rows[self._taken :]
        rows = np.zeros(count, dtype=self._rows.dtype)
        for index, channel in enumerate(self._channels):
            rows[channel.sensor.name], clipped = channel.take(count)
            if clipped.any():
                rows["status"] |= clipped.astype(np.uint8) << np.uint8(index)
        self._rows, self._taken = joined([left, rows]) if len(left) else rows, 0

    def info(self) -> NDArray[np.void]:
        """Return the calibration certificate, `blocks.DAQ_INFO` rows."""
        instruments = self._config.instruments
        return calibration.certificate(self._sensors, instruments.adc, self._clock, instruments.ideal)

    def calibrate(self, channel: str, frequency_hz: float, amplitude: float, ticks: int) -> None:
        """Put a known sine in place of one channel's input for some ticks, from the next one on.

        Args:
            channel: which.
            frequency_hz: of the sine; its phase is zero where it starts.
            amplitude: peak, in the channel's unit.
            ticks: how long, in ticks of 10 ms.

        Raises:
            CommandError: no such channel, or a number out of range.
        """
        if channel not in self._names:
            raise CommandError(f"channel must be one of {', '.join(self._names)}, got {channel!r}")
        highest = self._config.shaker.frequency_max_hz
        if not 0.0 < frequency_hz <= highest:
            raise CommandError(f"frequency_hz must be > 0 and <= {highest:g} Hz, got {frequency_hz!r} Hz")
        if not np.isfinite(amplitude) or ticks < 0:
            raise CommandError(f"amplitude must be finite and ticks >= 0, got {amplitude!r} and {ticks!r}")
        self._channels[self._names.index(channel)].sine = Sine(self._tick, ticks, frequency_hz, amplitude)

    def inject(self, fault: Fault) -> int:
        """Put a fault on the rig and return its number.

        Raises:
            CommandError: it would start at a scan that has already been converted, or its channel is not there.
        """
        if fault.start_sample < self.first_open_scan:
            raise CommandError(f"a fault must start at scan >= {self.first_open_scan}, got {fault.start_sample}")
        if fault.channel and fault.channel not in self._names:
            raise CommandError(f"{fault.kind} needs a channel that is present, {fault.channel} is not")
        return self._faults.add(fault)

    def clear(self, number: int | None = None) -> None:
        """End one fault, or all of them, at the first scan not yet converted.

        Raises:
            CommandError: there is no such fault.
        """
        self._faults.clear(number, self.first_open_scan)

    def fault_numbers(self) -> tuple[int, ...]:
        """Return the numbers of the faults that act or will act, and of some that have ended."""
        return self._faults.numbers()

    def fault_rows(self, first_scan: int, count: int) -> NDArray[np.void]:
        """Return starts and ends of faults in these scans, `blocks.FAULTS` rows; ask once per block, in order."""
        return self._faults.rows(first_scan, count)

    def block_lost(self, first_scan: int, count: int) -> bool:
        """Whether a lost_block fault acts on any of these scans: number the block, but do not publish it."""
        return self._faults.block_lost(first_scan, count)

    def clock_ppm(self, tick: int) -> float:
        """Return how fast clock_drift faults make the scan clock at a tick [ppm]: part of that tick's `tick_s`."""
        return self._faults.clock_ppm(-(-tick * COMMAND_GRID_NS * self._clock.rate_hz // NS_PER_S))

    def _acquire(self, stretch: Stretch, rough: Instants, blows: NDArray[np.void]) -> None:
        longest = min(_LONGEST_PIECE_S, 1.0 / (PIECES_PER_PERIOD * self._config.shaker.frequency_max_hz))
        pieces = cut(rough, stretch.motion_tick, stretch.ticks, Limits(stretch.tick_s, longest, _LONGEST_PULSE_PIECE_S))
        nodes = pieces.nodes()
        values = stretch.motion.quantities(self._quantities, *nodes)
        kicks = [np.zeros(len(pieces.start))] * len(self._channels)
        if len(blows) and _JUMPS in self._quantities:
            jumps = _kicks(blows, stretch, pieces, self._config.structure.mass_kg)
            kicks = [jumps if sensed == _JUMPS else none for sensed, none in zip(self._quantities, kicks, strict=True)]
        for index, channel in enumerate(self._channels):
            kicks[index] = channel.see(stretch, pieces, nodes, values[index], kicks[index])
        coefficients = polynomials(values, len(pieces.start))
        for index, channel in enumerate(self._channels):
            channel.convert(channel.respond(pieces, coefficients[index], kicks[index]), self._faults)

    def _acquire_directly(self, stretch: Stretch) -> None:
        # ideal instruments have no skew: all channels are converted at the same instants
        ticks, motion_tick, tick_s = stretch.ticks, stretch.motion_tick, stretch.tick_s
        for channel in self._channels:
            instants = channel.response.instants(ticks, motion_tick, tick_s)
        for channel, values in zip(self._channels, stretch.motion.quantities(self._quantities, *instants), strict=True):
            channel.convert(channel.read_directly(stretch, instants, values), self._faults)

    def _seed(self, purpose: int, index: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self._config.daq.seed, spawn_key=(SEED_STREAM, purpose, index))


def _kicks(blows: NDArray[np.void], stretch: Stretch, pieces: Pieces, mass_kg: float) -> NDArray[np.float64]:
    """Return what instantaneous impacts add to the structure's velocity [m/s] at each piece's start, shape (n,)."""
    kicks = np.zeros(len(pieces.start))
    tick = blows["tick"] - stretch.motion_tick
    for k, blow in zip(tick, blows, strict=True):
        if 0 <= k < stretch.ticks:
            low, high = pieces.first[k], pieces.first[k + 1]
            # blows within 16 µs of each other share a piece: all come at its start
            piece = low + np.searchsorted(pieces.start[low:high], blow["offset"] + 1e-9, side="right") - 1
            kicks[piece] += float(blow["wall"]) * float(blow["impulse"]) / mass_kg
    return kicks


__all__ = ["SEED_STREAM", "Chain", "sensors"]
