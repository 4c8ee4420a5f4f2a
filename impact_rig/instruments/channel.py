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
"""Processing of all channels over some ticks: conversion times, sensor dynamics, output stage and converter.

Times of conversions are counted in clock units: 1 ns divided by the number `rate_hz` · channels. A scan period, a skew
and a 10 ms tick are all integers in this unit. So no scan drifts, and no result depends on where a block or a call
begins.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import TWO_PI, sincos
from impact_rig.arithmetic.interpolation import polynomials
from impact_rig.errors import ConfigError
from impact_rig.instruments.conversion import CHANNEL, STRETCH, TWO_D_FLAGS, to_units, to_volts
from impact_rig.instruments.pieces import PIECES, Pieces
from impact_rig.instruments.response import (
    SENSOR_MODE,
    SERIES_TERMS,
    input_at_start,
    output_at_start,
    set_period,
    settle,
    through_piece,
)
from impact_rig.instruments.section import InstrumentSetup
from impact_rig.kernels import (
    INTEGERS,
    REALS,
    REALS_2D,
    REALS_3D,
    Fields,
    Integers,
    Reals,
    Record,
    Records,
    entry,
    kernel,
)
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S, NS_PER_S


class Clock(NamedTuple):
    """Lengths of a scan period and of a tick of 10 ms, in clock units of 1 ns / (`rate_hz` · channels)."""

    period: int
    tick: int


CLOCK = Fields(Clock, (int, int))


@attrs.frozen
class ScanClock:
    """Times at which a multiplexed converter converts its channels, one after another in each scan.

    Times are integers in clock units, see `Clock`.

    Attributes:
        rate_hz: scans per second.
        lengths: lengths of a scan period and of a tick, in clock units.
        skews: time from the start of a scan to the conversion of each channel, in clock units.
    """

    rate_hz: int
    lengths: Clock
    skews: tuple[int, ...]

    def skew_s(self, channel: int) -> float:
        """Return the time [s] from the start of a scan to the conversion of its channel number `channel`, from 0."""
        return self.skews[channel] / self.lengths.tick * COMMAND_GRID_NS / NS_PER_S

    def scans_per_tick(self) -> int:
        """Return the largest number of scans that start in one tick of 10 ms."""
        return -(-self.lengths.tick // self.lengths.period)


def scan_clock(config: InstrumentSetup) -> ScanClock:
    """Return the conversion times that a configuration's scan rate, converter and number of channels give.

    Raises:
        ConfigError: the scan rate needs more conversions per second than the converter can do.
    """
    rate, adc, channels = config.daq.rate_hz, config.instruments.adc, len(config.instruments.fitted())
    if rate * channels > adc.aggregate_limit_hz:
        raise ConfigError(
            f"daq.rate_hz must be <= {int(adc.aggregate_limit_hz) // channels} Hz: {channels} channels share"
            f" instruments.adc.aggregate_limit_hz = {adc.aggregate_limit_hz:g} Hz, got {rate} Hz"
        )
    units_per_ns = rate * channels  # clock units per nanosecond
    interval = min(adc.conversion_ns * units_per_ns, NS_PER_S)  # the smaller of the board's and period / channels
    is_skewed = adc.multiplexed and not config.instruments.ideal
    return ScanClock(
        rate_hz=rate,
        lengths=Clock(NS_PER_S * channels, COMMAND_GRID_NS * units_per_ns),
        skews=tuple(channel * interval * is_skewed for channel in range(channels)),
    )


class Buffers(NamedTuple):
    """Arrays for the channels' readings on their way from a sensor's output to scans.

    Attributes:
        values: output of the sensors' dynamics [unit], which becomes volts and then readings [unit] in place, shape
            (channels, room).
        clipped: whether the sensor or the converter was at an end of its range, for each value, same shape.
        white: scratch for random numbers, shape (STRETCH,).
        series: scratch of `response`, shape (3, SERIES_TERMS).
        first_and_spacing: scratch, shape (2,): time from the start of a piece to its first conversion, and between
            conversions [s].
    """

    values: NDArray[np.float64]
    clipped: NDArray[np.bool_]
    white: NDArray[np.float64]
    series: NDArray[np.float64]
    first_and_spacing: NDArray[np.float64]


BUFFERS = Fields(Buffers, (REALS_2D, TWO_D_FLAGS, REALS, REALS_2D, REALS))


def new_buffers(channels: int, room: int) -> Buffers:
    """Return zeroed buffers with room for `room` readings of each channel."""
    values, clipped = np.zeros((channels, room)), np.zeros((channels, room), np.bool_)
    return Buffers(values, clipped, np.zeros(STRETCH), np.zeros((3, SERIES_TERMS)), np.zeros(2))


@kernel
def _conversions(clock: Clock, due: int, tick_s: float, end: float) -> int:
    """Return the number of conversions of a channel that are due up to the time `end`, inclusive.

    `end` is in seconds since the start of the tick. `due` is the time of the next conversion since the start of the
    tick [clock units], and `tick_s` the duration of the tick [s]. Conversions in later ticks do not count.
    """
    if due >= clock.tick or tick_s * (due / clock.tick) > end:
        return 0
    period_s = tick_s * (clock.period / clock.tick)
    count = max(1, int((end - tick_s * (due / clock.tick)) / period_s))  # off by one at most, because of rounding
    last = due + (count - 1) * clock.period
    while count > 1 and (last >= clock.tick or tick_s * (last / clock.tick) > end):
        count, last = count - 1, last - clock.period
    while last + clock.period < clock.tick and tick_s * ((last + clock.period) / clock.tick) <= end:
        count, last = count + 1, last + clock.period
    return count


@kernel
def _respond(
    channel: Record,
    modes: Records,
    clock: Clock,
    pieces: Pieces,
    coefficients: Reals,
    kicks: Reals,
    values: Reals,
    buffers: Buffers,
) -> None:
    """Advance the dynamics of one channel's sensor through the pieces, and append its output at each conversion.

    The output [unit of the channel] is written to `values`, after the first `channel.filled` values. `kicks` are the
    jumps of the input's integral [unit s] at the start of each piece, shape (pieces,), or (0,) without jumps.
    """
    tick_s, first_and_spacing = pieces.tick_s, buffers.first_and_spacing
    first_and_spacing[1] = tick_s * (clock.period / clock.tick)
    set_period(modes, first_and_spacing[1])
    if channel.awake == 0:
        channel.awake = 1
        if channel.starts_settled != 0:
            settle(modes, input_at_start(coefficients[0]))
    if channel.due < 0:  # a skew that became smaller puts it before these ticks: it is converted at their start
        values[channel.filled] = output_at_start(modes)
        channel.filled += 1
        channel.due += clock.period
    for tick in range(pieces.first_piece.shape[0] - 1):
        for i in range(pieces.first_piece[tick], pieces.first_piece[tick + 1]):
            if kicks.shape[0] > 0:
                for k in range(modes.shape[0]):
                    modes[k].psi_re += kicks[i]
            start = pieces.start[i]
            count = _conversions(clock, channel.due, tick_s, pieces.end[i])
            first_and_spacing[0] = max(0.0, tick_s * (channel.due / clock.tick) - start)
            out = values[channel.filled : channel.filled + count]
            through_piece(modes, coefficients[i], pieces.end[i] - start, first_and_spacing, buffers.series, out)
            channel.due += count * clock.period
            channel.filled += count
        channel.due -= clock.tick
    channel.converted += channel.filled - channel.finished


@entry(SENSOR_MODE, CHANNEL, CLOCK, PIECES, REALS_3D, REALS_2D, BUFFERS)
def respond(
    modes: Records, channels: Records, clock: Clock, pieces: Pieces, coefficients: Reals, kicks: Reals, buffers: Buffers
) -> None:
    """Compute the output of all channels over some ticks, up to the volts on their cables.

    Args:
        modes: SENSOR_MODE records of all channels, one channel after another; changed in place.
        channels: CHANNEL records; changed in place.
        clock: the scan clock.
        pieces: the pieces into which these ticks of the motion are cut.
        coefficients: coefficients of x^0, x^1, … of each channel's input on each piece, x = −1 … 1, shape (channels,
            pieces, NODES).
        kicks: jump of the input's integral [unit s] at the start of each piece, shape (channels, pieces), or
            (channels, 0) without jumps.
        buffers: buffers with room for the conversions; the output is appended to them.
    """
    for j in range(channels.shape[0]):
        channel = channels[j]
        own_modes = modes[channel.first_mode : channel.first_mode + channel.modes]
        _respond(channel, own_modes, clock, pieces, coefficients[j], kicks[j], buffers.values[j], buffers)
        for begin in range(channel.finished, channel.filled, STRETCH):
            end = min(begin + STRETCH, channel.filled)
            to_volts(channel, buffers.values[j, begin:end], buffers.clipped[j, begin:end], buffers.white[: end - begin])


@entry(CHANNEL, BUFFERS)
def digitise(channels: Records, buffers: Buffers) -> None:
    """Convert the volts that `respond` appended to each channel's buffer into readings in the unit of the channel.

    The converter adds its noise and errors, rounds to its steps and limits readings to its range. Readings at the ends
    of the range are marked in `buffers.clipped`.
    """
    for j in range(channels.shape[0]):
        channel = channels[j]
        for begin in range(channel.finished, channel.filled, STRETCH):
            end = min(begin + STRETCH, channel.filled)
            to_units(channel, buffers.values[j, begin:end], buffers.clipped[j, begin:end], buffers.white[: end - begin])
        if channel.filled > channel.finished:
            channel.last_reading = buffers.values[j, channel.filled - 1]
        channel.finished = channel.filled


@entry(CHANNEL, CLOCK, int, float, INTEGERS, REALS, returns=int)
def instants(channels: Records, clock: Clock, ticks: int, tick_s: float, tick_of: Integers, offset: Reals) -> int:
    """Compute the instants at which channels without skew convert in the next `ticks` ticks; return their number.

    The instants are written to `tick_of` (number of the tick, from 0 in this call) and `offset` (time within the tick
    [s]). The counters of the channels are advanced. A channel that is one scan behind, after a change of its skew,
    converts at all instants; the other channels then omit the first.
    """
    earliest = channels[0].due
    for j in range(channels.shape[0]):
        earliest = min(earliest, channels[j].due)
    count, due = 0, earliest
    for tick in range(ticks):
        while due < clock.tick:
            tick_of[count] = tick
            offset[count] = max(0.0, tick_s * (due / clock.tick))
            count += 1
            due += clock.period
        due -= clock.tick
    for j in range(channels.shape[0]):
        channel = channels[j]
        made = count - (channel.due - earliest) // clock.period
        channel.due = due
        channel.converted += made
        channel.filled += made
    return count


@attrs.frozen
class Sine:
    """Calibration sine that replaces a channel's input for some ticks.

    Attributes:
        first_tick: number of the first tick in which it is on, since the reset; its phase is zero at the start of this
            tick.
        ticks: number of ticks.
        frequency_hz: frequency.
        amplitude: peak value, in the channel's unit.
        anchor_s: time from the start of the sine to the start of `anchor_tick` [s].
        anchor_tick: tick at which the duration of a tick last changed; by default the first tick.
        tick_s: duration of a tick from `anchor_tick` on [s].
    """

    first_tick: int
    ticks: int
    frequency_hz: float
    amplitude: float
    anchor_s: float = 0.0
    anchor_tick: int = attrs.field(default=attrs.Factory(lambda sine: sine.first_tick, takes_self=True))
    tick_s: float = COMMAND_GRID_S

    def paced(self, tick: int, tick_s: float) -> Sine:
        """Return a sine that continues this sine without a jump, with ticks of `tick_s` seconds from tick `tick` on.

        The duration of a tick changes with the error of the scan clock.
        """
        if tick_s == self.tick_s:
            return self
        anchor_s = self.anchor_s + (tick - self.anchor_tick) * self.tick_s
        return attrs.evolve(self, anchor_s=anchor_s, anchor_tick=tick, tick_s=tick_s)

    def covers(self, tick: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return for each of these tick numbers whether the sine is on in that tick, as a mask of the same shape."""
        return (tick >= self.first_tick) & (tick < self.first_tick + self.ticks)

    def values(self, tick: NDArray[np.int64], offset_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the sine's values [unit of the channel] at given instants, shape (1, n).

        An instant is the number of a tick and the offset into the tick [s].
        """
        out = np.empty((1, len(tick)))
        since_anchor = tick - self.anchor_tick
        _sine(since_anchor, offset_s, self.tick_s, self.anchor_s, TWO_PI * self.frequency_hz, self.amplitude, out[0])
        return out

    def replace(self, coefficients: NDArray[np.float64], tick: NDArray[np.int64], pieces: Pieces) -> NDArray[np.bool_]:
        """Replace the polynomials of a channel's input by this sine on all pieces in its ticks.

        Args:
            coefficients: coefficients of x^0, x^1, … on each piece, x = −1 … 1, overwritten; shape (pieces, NODES).
            tick: number of the tick of each piece, counted since the reset.
            pieces: the pieces.

        Returns:
            For each piece, whether it was replaced.
        """
        on = self.covers(tick)
        coefficients[on] = polynomials(self.values, tick[on], pieces.start[on], pieces.end[on])[0]
        return on


@entry(INTEGERS, REALS, float, float, float, float, REALS)
def _sine(
    tick: Integers, offset: Reals, tick_s: float, anchor_s: float, omega: float, amplitude: float, values: Reals
) -> None:
    """Fill `values` with a sine of angular frequency `omega` [rad/s] at instants (tick, `offset` into it [s]).

    At the start of tick 0, the sine has been on for `anchor_s` seconds.
    """
    for i in range(values.shape[0]):
        sine, _ = sincos(omega * (anchor_s + (tick[i] * tick_s + offset[i])))
        values[i] = amplitude * sine


def still_on(sines: Iterable[tuple[int, Sine]], tick: int, tick_s: float) -> dict[int, Sine]:
    """Return the sines that have not ended at tick number `tick`, by channel.

    From this tick on, a tick of these sines takes `tick_s` seconds.
    """
    return {channel: sine.paced(tick, tick_s) for channel, sine in sines if tick < sine.first_tick + sine.ticks}
