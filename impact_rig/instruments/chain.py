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
"""Instruments of a rig as one chain, which turns complete ticks of motion into complete scans.

A scan is one reading of every channel, a tick 10 ms of the scan clock. The chain works like a board with a FIFO:
`acquire` converts all scans whose instants lie in the given ticks, and `read` returns and removes scans. Neither the
number of ticks per call nor the block length changes a reading, because random numbers, filter states and conversion
times belong to scans and ticks.
"""

from __future__ import annotations

import itertools
from collections import deque

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.random import Random
from impact_rig.blocks import joined
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments import calibration
from impact_rig.instruments.channel import Clock, Sine, digitise, instants, new_buffers, respond, scan_clock, still_on
from impact_rig.instruments.conversion import CHANNEL, set_converter, set_output, take_rows
from impact_rig.instruments.fault import Fault, FaultBoard
from impact_rig.instruments.pieces import PIECES_PER_PERIOD, Limits, Pieces, PiecewiseMotion, cut
from impact_rig.instruments.response import SENSOR_MODE, mode_records
from impact_rig.instruments.section import InstrumentSetup, row_type_of
from impact_rig.instruments.sensor import Sensor, SensorModes
from impact_rig.kernels import records
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S, NS_PER_S

SEED_STREAM = 1
"""First number of the spawn key of every random generator of the instruments. It makes their numbers independent of
those of other generators with the same seed.
"""
_LONGEST_PIECE_S = 2.5e-3
_LONGEST_CONTACT_PIECE_S = 16e-6
"""Length [s] up to which neighbouring integration steps of a contact are joined to one piece with one polynomial: three
such pieces fit a contact of 40 µs to 0.1 %.
"""
_TICKS_AT_ONCE = 25
"""Number of ticks that are converted together: arrays of a quarter of a second fit into the caches. The bits are the
same for any number.
"""
_JUMPS = "a_1"
"""Name of the only quantity whose integral jumps at an instantaneous impact: the acceleration of the superior base,
whose velocity jumps there.
"""
_ERRORS, _NOISE, _CONVERTER_NOISE, _BOARD = range(4)
_LEFT_OVER = 4  # readings that wait for other channels: at most one, and one more after a change of the skews


def sensors(config: InstrumentSetup) -> list[Sensor]:
    """Return the models of the sensors that are scanned, in scan order, with the board's anti-alias filter, if any."""
    return [instrument.sensor().behind(config.instruments.adc) for instrument in config.instruments.fitted()]


class Chain:
    """All instruments of a rig, which turn its motion into scans.

    Args:
        config: the rig's configuration; `daq.seed` seeds noise and calibration errors.

    Raises:
        ConfigError: the converter cannot convert so many channels at this scan rate.
    """

    def __init__(self, config: InstrumentSetup) -> None:
        self._config = config
        self.reset()

    @property
    def config(self) -> InstrumentSetup:
        """Configuration that the chain uses now: that of its creation, or of the last `reconfigure`."""
        return self._config

    @property
    def ready(self) -> int:
        """Number of complete scans that `read` can return."""
        return self._ready

    @property
    def next_scan(self) -> int:
        """Number of the first scan that `read` has not returned yet, counted from 0 since the reset."""
        return self._next_scan

    @property
    def first_open_scan(self) -> int:
        """Number of the first scan of which no channel is converted yet, the earliest that a new fault can affect."""
        return int(self._channels["converted"].max())

    def reset(self) -> None:
        """Restart at scan 0 with the seed and the planned faults of `config`.

        After each reset, the same motion gives identical readings. Injected faults, calibration sines, and scans that
        were not read are dropped.
        """
        config = self._config
        self._clock = scan_clock(config)
        self._sensors = sensors(config)
        self._board = calibration.draw_board(Random(self._seed(_BOARD, 0)))
        places = [instrument.place for instrument in config.instruments.fitted()]
        self._errors = [calibration.draw_channel(Random(self._seed(_ERRORS, place))) for place in places]
        self._channels = records(len(places), CHANNEL)
        for index, place in enumerate(places):
            self._channels["noise_random"][index] = Random(self._seed(_NOISE, place)).state
            self._channels["adc_random"][index] = Random(self._seed(_CONVERTER_NOISE, place)).state
        self._channels["due"] = self._clock.skews
        self._sines: dict[int, Sine] = {}
        self._names = tuple(sensor.name for sensor in self._sensors)
        self._quantities = tuple(sensor.quantity for sensor in self._sensors)
        self._most_per_tick = self._clock.scans_per_tick() + 1
        self._buffers = new_buffers(len(places), _TICKS_AT_ONCE * self._most_per_tick + _LEFT_OVER)
        self._words = self._buffers.values.view(np.uint64)
        self._dynamics: list[SensorModes] = []
        self._modes: NDArray[np.void] = records(0, SENSOR_MODE)
        self._longest_piece_s = _LONGEST_PIECE_S
        if config.drive.waveform == "chirp":  # a chirp is no command and may end above the highest commanded frequency
            self._shorten_pieces(config.drive.chirp_end_hz)
        self._equip()
        rate = config.daq.rate_hz
        self._faults = FaultBoard(config.instruments.faults.faults(rate), rate)
        self._row_type = row_type_of(config.instruments)
        columns = self._row_type.fields
        assert columns is not None
        layout = [self._row_type.itemsize, *(columns[name][1] for name in ("status", *self._names))]
        self._layout = np.array(layout, np.int64)
        self._rows: deque[NDArray[np.void]] = deque()
        self._ready = 0
        self._times = np.zeros(0)  # of the last read: all blocks have the same length
        self._next_scan = 0
        self._tick = 0

    def reconfigure(self, config: InstrumentSetup) -> None:
        """Change the settings of the instruments from the next tick on; counters, noise and faults continue.

        The state of a sensor's filters continues if its dynamics are unchanged; otherwise it starts as at a reset.

        Raises:
            ConfigError: the list of channels, the scan rate, the seed or the planned faults differ, which is possible
                only in a new chain; or the converter is too slow for the scan rate. Nothing is changed.
        """
        fitted, present = tuple(instrument.name for instrument in config.instruments.fitted()), self._config
        planned = list(config.instruments.faults.planned)
        for key, old, new in (
            ("the list of instruments that are present", ", ".join(self._names), ", ".join(fitted)),
            ("daq.rate_hz", present.daq.rate_hz, config.daq.rate_hz),
            ("daq.seed", present.daq.seed, config.daq.seed),
            ("instruments.faults.planned", list(present.instruments.faults.planned), planned),
        ):
            if old != new:
                raise ConfigError(f"{key} is fixed at start: it is {old}, got {new}; create a new rig to change it")
        if config.instruments == self._config.instruments:
            self._config = config
            self._shorten_pieces(config.shaker.frequency_max_hz)
            return
        skews, ideal = self._clock.skews, self._config.instruments.ideal
        self._clock = scan_clock(config)
        self._channels["due"] += np.subtract(self._clock.skews, skews)
        self._config = config
        self._sensors = sensors(config)
        self._equip(keep=config.instruments.ideal == ideal)

    def acquire(self, motion: PiecewiseMotion, motion_tick: int, count: int, tick_s: float = COMMAND_GRID_S) -> None:
        """Convert every scan in the next `count` ticks of a motion; `read` returns them.

        Args:
            motion: motion that covers these ticks, which continue those of the call before.
            motion_tick: number of the first of these ticks as `motion` counts its ticks.
            count: number of ticks.
            tick_s: duration of one tick in the motion's time [s]: 10 ms, scaled by the error of the scan clock, which
                includes `clock_ppm`.
        """
        clock = self._clock.lengths
        breakpoints = None if self._config.instruments.ideal else motion.breakpoints()
        limits = Limits(tick_s, self._longest_piece_s, _LONGEST_CONTACT_PIECE_S)
        durations = motion.impacts["duration"]
        blows = motion.impacts[durations == 0.0] if 0.0 in durations.tolist() else motion.impacts[:0]
        for first in range(0, count, _TICKS_AT_ONCE):
            ticks = min(_TICKS_AT_ONCE, count - first)
            if breakpoints is None:
                self._acquire_directly(motion, motion_tick + first, ticks, tick_s, clock)
            else:
                pieces = cut(breakpoints, motion_tick + first, ticks, limits)
                self._acquire(motion, pieces, blows, motion_tick + first, clock)
            self._make_rows(ticks)
            self._tick += ticks

    def read(self, count: int) -> NDArray[np.void]:
        """Return and remove the next `count` scans, as rows of the type that `section.row_type_of` returns.

        The column `time` is the time since the first scan returned by this call [s].

        Raises:
            ValueError: `count` is negative, or fewer scans are ready.
        """
        if not 0 <= count <= self._ready:
            raise ValueError(f"count must be 0 to {self._ready}, the number of scans that are ready, got {count}")
        if len(self._times) != count:
            self._times = np.arange(count) / self._config.daq.rate_hz
        parts: list[NDArray[np.void]] = []
        missing = count
        while missing or not parts:
            rows = self._rows.popleft() if self._rows else np.zeros(0, self._row_type)
            parts.append(rows[:missing])
            if len(rows) > missing:
                self._rows.appendleft(rows[missing:])
            missing -= len(parts[-1])
        rows = parts[0] if len(parts) == 1 else joined(parts)
        rows["time"] = self._times
        self._ready -= count
        self._next_scan += count
        return rows

    def _make_rows(self, ticks: int) -> None:
        """Make rows, which `read` returns, of all scans whose readings are complete in every channel.

        `ticks` is the number of ticks converted since the last call, which limits the number of rows.
        """
        rows = np.empty((ticks * self._most_per_tick + _LEFT_OVER) * self._row_type.itemsize, np.uint8)
        count = take_rows(self._channels, self._words, self._buffers.clipped, rows, self._layout)
        if count:
            # NumPy inspects a view as records field by field
            self._rows.append(np.frombuffer(rows, self._row_type, count))
            self._ready += count

    def info(self) -> NDArray[np.void]:
        """Return the calibration certificate, `blocks.DAQ_INFO` rows: one per channel, in scan order."""
        instruments = self._config.instruments
        skews_s = [self._clock.skew_s(channel) for channel in range(len(self._sensors))]
        return calibration.certificate(self._sensors, instruments.adc, self._clock.rate_hz, skews_s, instruments.ideal)

    def calibrate(self, channel: str, frequency_hz: float, amplitude: float, ticks: int) -> None:
        """Replace the input of one channel by a known sine for some ticks, from the next tick on.

        If an earlier sine is still on at this channel, the new one replaces it.

        Args:
            channel: name of the channel.
            frequency_hz: frequency of the sine; its phase is zero at the start.
            amplitude: peak value in the channel's unit.
            ticks: duration in ticks of 10 ms; 0 only ends an earlier sine.

        Raises:
            CommandError: there is no such channel, or a number is out of range.
        """
        if channel not in self._names:
            raise CommandError(f"channel must be one of {', '.join(self._names)}, got {channel!r}")
        highest = self._config.shaker.frequency_max_hz
        if not 0.0 < frequency_hz <= highest:
            raise CommandError(
                "frequency_hz of a calibration sine must be > 0 and <= shaker.frequency_max_hz = "
                f"{highest:g} Hz, got {frequency_hz!r} Hz"
            )
        if not np.isfinite(amplitude):
            raise CommandError(f"amplitude of a calibration sine must be finite, got {amplitude!r}")
        if ticks < 0:
            raise CommandError(f"ticks of a calibration sine must be >= 0, got {ticks}")
        self._sines[self._names.index(channel)] = Sine(self._tick, ticks, frequency_hz, amplitude)

    def inject(self, fault: Fault) -> int:
        """Add a fault, which acts from its `start_sample` on; return the number by which `clear` ends the fault.

        Raises:
            CommandError: `start_sample` is before `first_open_scan`, so a channel has already converted that scan; or
                the fault's channel is not present.
        """
        if fault.start_sample < self.first_open_scan:
            raise CommandError(
                f"start_sample of a fault must be >= {self.first_open_scan}, the first scan not yet converted, "
                f"got {fault.start_sample}"
            )
        if fault.channel and fault.channel not in self._names:
            present = ", ".join(self._names)
            raise CommandError(
                f"{fault.kind} needs a channel that is present, but {fault.channel} is not; use {present}"
            )
        return self._faults.add(fault)

    def clear(self, number: int | None = None) -> None:
        """End the fault with this number, or all faults, at the first scan not yet converted.

        A fault that would start at that scan or later never acts. Clearing a fault that has ended has no effect.

        Raises:
            CommandError: no fault, planned or injected, has had this number since the reset.
        """
        self._faults.clear(number, self.first_open_scan)

    def fault_numbers(self) -> tuple[int, ...]:
        """Return the numbers of faults that act or will act, and of ended faults until `fault_rows` drops them."""
        return self._faults.numbers()

    def fault_rows(self, first_scan: int, count: int) -> NDArray[np.void]:
        """Return the starts and ends of faults in `count` scans from `first_scan` on, as `blocks.FAULTS` rows.

        The end of a fault is the first scan that it no longer affects. Call this once per block, in ascending order: it
        forgets the faults that ended before `first_scan`.
        """
        return self._faults.rows(first_scan, count)

    def block_lost(self, first_scan: int, count: int) -> bool:
        """Return whether a `lost_block` fault acts on any of `count` scans from number `first_scan` on.

        A block with such a scan is not published.
        """
        return self._faults.block_lost(first_scan, count)

    def clock_ppm(self, tick: int) -> float:
        """Return by how much clock_drift faults slow the scan clock at the start of a tick [ppm], 0 if none acts.

        `tick` counts from 0 since the reset. A tick of 10 ms on that clock lasts 10 ms · (1 + ppm · 10⁻⁶) in the time
        of the motion.
        """
        return self._faults.clock_ppm(-(-tick * COMMAND_GRID_NS * self._clock.rate_hz // NS_PER_S))

    def _equip(self, *, keep: bool = False) -> None:
        """Set the records of all channels and modes to the present sensors, calibration errors and converter.

        A mode is a pole of a sensor's dynamics. With `keep`, the modes of a sensor with unchanged dynamics keep their
        state. Other modes start as at a reset.
        """
        config, channels, modes = self._config, self._channels, []
        dynamics = [sensor.transfer.modes() for sensor in self._sensors]
        for j, (sensor, own) in enumerate(zip(self._sensors, dynamics, strict=True)):
            row = channels[j : j + 1]
            set_output(row, sensor, self._errors[j], 1.0 / self._clock.rate_hz)
            set_converter(row, sensor, config.instruments.adc, self._board)
            goes_on = keep and own.same_as(self._dynamics[j])
            first, count = int(row["first_mode"][0]), int(row["modes"][0])
            modes.append(
                self._modes[first : first + count].copy() if goes_on else mode_records(own.poles, own.residues)
            )
            row["starts_settled"], row["awake"] = sensor.starts_settled, goes_on and row["awake"][0]
        *firsts, total = itertools.accumulate(map(len, modes), initial=0)
        channels["modes"], channels["first_mode"] = list(map(len, modes)), firsts
        self._dynamics, self._modes = dynamics, records(total, SENSOR_MODE)
        self._modes[:] = np.concatenate(modes)
        self._shorten_pieces(config.shaker.frequency_max_hz)

    def _shorten_pieces(self, frequency_hz: float) -> None:
        """Limit the length of the pieces into which a motion is cut, as a drive of this frequency requires.

        The length does not grow again until a reset, because a drive of a higher frequency may still be on.
        """
        self._longest_piece_s = min(self._longest_piece_s, 1.0 / (PIECES_PER_PERIOD * frequency_hz))

    def _acquire(
        self, motion: PiecewiseMotion, pieces: Pieces, blows: NDArray[np.void], motion_tick: int, clock: Clock
    ) -> None:
        coefficients = motion.polynomials(self._quantities, pieces.tick, pieces.start, pieces.end)
        kicks = np.zeros((len(self._names), len(pieces.start) if len(blows) else 0))
        if len(blows):
            kicks[[quantity == _JUMPS for quantity in self._quantities]] = _kicks(
                blows, motion_tick, pieces, self._config.structure.mass_kg
            )
        if self._sines:
            self._sines = still_on(self._sines.items(), self._tick, pieces.tick_s)
            for j, sine in self._sines.items():
                on = sine.replace(coefficients[j], pieces.tick - motion_tick + self._tick, pieces)
                kicks[j, on[: kicks.shape[1]]] = 0.0
        respond(self._modes, self._channels, clock, pieces, coefficients, kicks, self._buffers)
        channels = self._faults.channels()
        faulty = [(j, *self._newest(j)) for j, name in enumerate(self._names) if name in channels]
        for j, values, clipped, first, _ in faulty:
            sensor = self._sensors[j]
            self._faults.on_cable(sensor.name, values, clipped, first, sensor.volt_per_unit, sensor.offset_v)
        digitise(self._channels, self._buffers)
        for one in faulty:
            self._stick(*one)

    def _acquire_directly(
        self, motion: PiecewiseMotion, motion_tick: int, ticks: int, tick_s: float, clock: Clock
    ) -> None:
        """Convert ticks for ideal instruments, whose readings are the motion itself.

        All channels have the same instants of conversion. Calibration sines and faults act on the readings.
        """
        tick, offset = np.empty(ticks * self._most_per_tick, np.int64), np.empty(ticks * self._most_per_tick)
        count = instants(self._channels, clock, ticks, tick_s, tick, offset)
        tick, offset = tick[:count], offset[:count]
        self._sines = still_on(self._sines.items(), self._tick, tick_s)
        for j, values_there in enumerate(motion.quantities(self._quantities, tick + motion_tick, offset)):
            one = j, *self._newest(j)
            _, values, clipped, first, _ = one
            own = slice(count - len(values), count)  # one more if a skew had kept the channel one scan behind
            values[:], clipped[:] = values_there[own], False
            if j in self._sines:
                at = tick[own] + self._tick
                on = self._sines[j].covers(at)
                values[on] = self._sines[j].values(at[on], offset[own][on])[0]
            self._faults.on_cable(self._names[j], values, clipped, first, 1.0, 0.0)
            self._stick(*one)
        self._channels["finished"] = self._channels["filled"]

    def _newest(self, channel: int) -> tuple[NDArray[np.float64], NDArray[np.bool_], int, float | None]:
        """Return a channel's values that are not digitised yet, their clipping flags, first scan, and last reading.

        Values and flags are views into the buffers. The values are volts, or readings if the instruments are ideal. The
        last reading is the one before these values, None at the start.
        """
        row = self._channels[channel]
        part = slice(int(row["finished"]), int(row["filled"]))
        first = int(row["converted"]) - (part.stop - part.start)
        last = float(row["last_reading"]) if first else None
        return self._buffers.values[channel, part], self._buffers.clipped[channel, part], first, last

    def _stick(
        self, channel: int, readings: NDArray[np.float64], clipped: NDArray[np.bool_], first: int, last: float | None
    ) -> None:
        """Apply the fault `stuck`, a converter that repeats its last reading, to a channel's readings [unit] in place.

        The clipping flags of repeated readings are cleared. `first` is the number of the scan of the first reading, and
        `last` the reading before it; None at the start.
        """
        self._faults.behind_converter(self._names[channel], readings, clipped, first, last)
        if len(readings):
            self._channels["last_reading"][channel] = readings[-1]

    def _seed(self, purpose: int, index: int) -> np.random.SeedSequence:
        return np.random.SeedSequence(self._config.daq.seed, spawn_key=(SEED_STREAM, purpose, index))


def _kicks(blows: NDArray[np.void], motion_tick: int, pieces: Pieces, mass_kg: float) -> NDArray[np.float64]:
    """Return the jump of the superior base's velocity [m/s] at the start of each piece, shape (n,).

    The instantaneous impacts `blows` cause the jumps; `mass_kg` is the mass of the superior base [kg]. Several impacts
    in one piece add up. `motion_tick` is the tick at which the pieces begin. Impacts outside the pieces are ignored.
    """
    kicks = np.zeros(len(pieces.start))
    tick = blows["tick"] - motion_tick
    for tick_index, blow in zip(tick, blows, strict=True):
        if 0 <= tick_index < len(pieces.first_piece) - 1:
            first, end = pieces.first_piece[tick_index], pieces.first_piece[tick_index + 1]
            # impacts within 16 µs of each other share a piece, and all act at its start
            piece = first + np.searchsorted(pieces.start[first:end], blow["offset"] + 1e-9, side="right") - 1
            kicks[piece] += float(blow["wall"]) * float(blow["impulse"]) / mass_kg
    return kicks


__all__ = ["SEED_STREAM", "Chain", "sensors"]
