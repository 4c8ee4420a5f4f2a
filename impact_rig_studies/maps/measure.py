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
"""Measurement of one point of a map on the simulated mechanics: DT, phase, impacts per cycle and regime once settled.

The record has one row per drive cycle, with the complex amplitudes of both bases and the motion of the sphere. A motion
that approaches a periodic motion has settled when the remaining transient is negligible (`analysis.convergence`).

If a motion does not settle, `analysis.spread.classify` judges its regime by the amplitude of the superior base and the
impacts. These may look periodic though the sphere moves chaotically. Therefore the largest Lyapunov exponent is usually
measured too (see `exponent`). If neighbouring motions separate, the motion is chaotic. If they approach one another, it
may repeat after more cycles than `classify` considers.

Near an unstable periodic orbit neighbouring motions separate as well. A motion that is still leaving such an orbit is
therefore continued until it has left, and then measured again. Everything is deterministic, and starts either from a
reset rig or from the state of the previous point.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Complex, Real
from impact_rig.analysis.convergence import settled_period
from impact_rig.analysis.cycles import PHASE_BINS
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.spread import LONGEST_PERIOD, Behaviour, classify, rms_deviation
from impact_rig.blocks import joined
from impact_rig.config.fields import integer, quantity
from impact_rig.errors import SimulationError
from impact_rig.physics import SEGMENT, Motion, Simulation
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig
from impact_rig.states import Regime
from impact_rig_studies.maps import exponent

CHUNK = 24  # number of cycles examined together, for a response that repeats after up to six cycles
_PART = CHUNK // 2  # number of cycles at the end of these from which such a response is measured
_FIRST = 2 * CHUNK  # number of cycles before the first check: hardly any response has settled earlier
TINY = 1e-12  # smallest scale of a coordinate
WEAK = 0.02
"""Approach speed, relative to the fastest impact, below which impacts are settling bounces.

They are not counted and do not influence the regime.
"""
WINDOW_CYCLES = 12  # number of cycles in a window of an exponent
DEPARTURES = 10  # number of times that a motion is continued because it is leaving an unstable orbit
_CLOSE = 0.05  # largest change per period, relative to the motion, of one that is still near the orbit it leaves
_RISES = 4  # number of equal parts of a record from each to the next of which the changes of such a motion must grow
LONGEST_LOOKED = 64  # longest period, in cycles, considered if neighbouring motions approach one another
NEAR_S = TrackerSettings().wait_limit_s
"""Time [s] ahead within which a drifting sphere must reach a wall to count as one that will strike again.

It is the time for which the analysis of measurements waits for such an impact.
"""
COORDINATES = {"prescribed": (0, 1, 5, 6), "current": (0, 1, 2, 3, 5, 6), "voltage": (0, 1, 2, 3, 4, 5, 6)}
"""Indices of the free numbers of a state (`Simulation.state`), by `drive.kind`; the drive itself sets the others."""
FAILED = "failed"  # regime of a point whose motion could not be simulated


@attrs.frozen(kw_only=True)
class Settings:
    """Criteria by which the motion at a point of a map counts as settled and periodic, and numbers of drive cycles."""

    settle_tolerance: float = quantity(
        5e-4,
        "-",
        "Relative change per period, and sum of all further changes, up to which a response counts as settled.",
        above=0,
        at_most=0.1,
    )
    periodic_tolerance: float = quantity(
        1e-3, "-", "Relative rms deviation from repetition up to which a response is periodic.", above=0, at_most=0.5
    )
    settle_cycles: int = integer(
        360, "-", "Maximum number of drive cycles to wait for a settled response.", at_least=48, at_most=100_000
    )
    cycles: int = integer(
        200, "-", "Number of drive cycles over which an irregular response is averaged.", at_least=48, at_most=100_000
    )


class Reading(NamedTuple):
    """Properties of the motion at one point of a map, such as regime and DT.

    X_1 and X_b are the complex amplitudes of the superior and the inferior base at the drive frequency.
    """

    regime: str
    """Regime of the motion: periodic, modulated, chaotic, intermittent or `FAILED`.

    Intermittent: there are no impacts at the end of the record, but the sphere drifts towards one.
    """
    dt: float  # transmissibility |X_1| / |X_b|
    reduction_percent: float  # 100 (1 − DT / DT without the sphere), the latter in closed form
    phase_rad: float  # phase of X_1 relative to X_b
    base_m: float  # |X_b|, peak
    superior_m: float  # |X_1|, peak
    impacts_per_cycle: float  # number of impacts per drive cycle, without weak ones (`WEAK`)
    period: float  # number of drive cycles after which the response repeats; NaN if it does not
    spread: float  # rms deviation of the X_1 of single cycles from their mean, relative to the mean
    drift: float  # relative change of DT from the first to the second half of the record
    cycles: float  # number of drive cycles in the record


NOTHING = Reading(FAILED, *[math.nan] * 10)  # reading of a point whose motion could not be simulated


class _Record(NamedTuple):
    """Record of drive cycles: amplitudes of both bases and motion of the sphere in each cycle, and the impacts."""

    cycles: NDArray[np.void]  # one row of dtype `fundamental.CYCLE` per cycle
    cycle: NDArray[np.int64]  # for each impact, the index of its cycle in the record
    turn: NDArray[np.float64]  # for each impact, the time since the beginning of its cycle, in periods
    speed: NDArray[np.float64]  # approach speed of each impact [m/s]

    def last(self, n: int) -> _Record:
        """Return a record of the last n cycles, or of all cycles if there are fewer."""
        before = max(0, len(self.cycles) - n)
        first = int(self.cycle.searchsorted(before))  # impacts are in the order of time
        return _Record(self.cycles[before:], self.cycle[first:] - before, self.turn[first:], self.speed[first:])

    def then(self, other: _Record) -> _Record:
        """Return one record of these cycles followed by the cycles of `other`, which must directly continue them."""
        return _Record(
            joined([self.cycles, other.cycles]),
            np.concatenate([self.cycle, other.cycle + len(self.cycles)]),
            np.concatenate([self.turn, other.turn]),
            np.concatenate([self.speed, other.speed]),
        )


class MapRig:
    """Simulated mechanics of a rig that measures the points of a map one after the other.

    Args:
        config: configuration of the rig.
        settings: criteria by which a motion counts as settled.

    Attributes:
        simulation: the mechanics, whose state persists from point to point.
    """

    def __init__(self, config: RigConfig, settings: Settings) -> None:
        self._settings = settings
        self._config = config
        self.simulation = Simulation(config)
        self._amplitude = 0.0

    def change(self, config: RigConfig) -> None:
        """Continue with another configuration: both bases keep their motion, the sphere returns to its start.

        If `config` is the same object as the current configuration, nothing changes.
        """
        if config is not self._config:
            self.simulation.configure(config)
            self._config = config

    def carry(self, config: RigConfig) -> None:
        """Continue with another configuration: both bases and the sphere keep their motion.

        A sphere outside of the new gap is placed at the nearer wall. A sphere in contact with a wall returns to its
        start, at rest.
        """
        if config is self._config:
            return
        state = self.simulation.state()
        self.change(config)
        if state is not None:  # in a contact: the sphere returns to its start
            half = config.barriers.gap_m / 2.0
            state[-2] = min(max(state[-2], -half), half)
            self.simulation.set_state(state)

    def reset(self, sphere: tuple[float, float] | None = None) -> None:
        """Put the rig to rest without a drive, with the sphere at a start.

        Args:
            sphere: start position from the middle between the walls [m] and speed relative to the walls [m/s], both
                positive to the right. None means the start `sphere.start` of the configuration, at rest.
        """
        self.simulation.reset()
        if sphere is not None:
            place, speed = sphere
            self.simulation.place(d=place, d_rate=speed)
        self._amplitude = 0.0

    def measure(self, frequency_hz: float, amplitude: float) -> Reading:
        """Drive the rig with a sine from its present state until the motion has settled, and measure the motion.

        A motion that has not settled after `Settings.settle_cycles` is averaged over many drive cycles. If the motion
        cannot be simulated, the rig is reset, and the reading has the regime `FAILED`.

        Args:
            frequency_hz: frequency of the drive.
            amplitude: peak amplitude of the drive; A, m or V by `drive.kind`.
        """
        try:
            return self._measured(frequency_hz, amplitude)
        except SimulationError:
            self.reset()
            return NOTHING

    def _measured(self, frequency_hz: float, amplitude: float) -> Reading:
        for _ in range(1 + DEPARTURES):
            reading, leaving = self._attempt(frequency_hz, amplitude)
            if not leaving:
                break
        return reading

    def _attempt(self, frequency_hz: float, amplitude: float) -> tuple[Reading, bool]:
        """Continue the motion until it has settled or `settle_cycles` are over, then measure and classify it.

        Returns:
            The reading, and whether the motion is leaving an unstable periodic orbit. If it is leaving, call again to
            continue the motion. The regime of the reading is then preliminary: the Lyapunov exponent is not used.
        """
        settings = self._settings
        record = self._run(frequency_hz, amplitude, _FIRST)
        while True:
            last = record.last(CHUNK)
            period = _settled(last, frequency_hz, settings)
            if period and self._stays(frequency_hz, amplitude, last):
                behaviour = Behaviour(Regime.PERIODIC, float(period), rms_deviation(_deviation(last)), steady=True)
                found = _reading(last.last(_PART), behaviour, self._config, frequency_hz)
                # whole for an orbit, although an impact at the border of a cycle may count on either side
                whole = round(found.impacts_per_cycle * found.period)
                return found._replace(impacts_per_cycle=whole / found.period), False
            done = len(record.cycles)
            if done >= settings.settle_cycles:
                break
            more, rest = done // 2 // _PART * _PART, settings.settle_cycles - done  # checked less often later
            record = record.then(self._run(frequency_hz, amplitude, more if rest > 2 * more else rest))
        recent = record.last(2 * CHUNK)
        behaviour, drifts, sign, leaving = _behaviour(recent, settings), self._drifts(recent), 0, False
        if math.isfinite(behaviour.period) and not drifts:
            sign = self._parting(frequency_hz, amplitude, recent)
            leaving = sign > 0 and _leaves(record, frequency_hz)
            if leaving or sign <= 0:
                return _reading(recent, behaviour, self._config, frequency_hz), leaving
        if done < _FIRST + settings.cycles:
            record = record.then(self._run(frequency_hz, amplitude, _FIRST + settings.cycles - done))
        last = record.last(settings.cycles)
        behaviour = _behaviour(last, settings)
        if drifts or self._drifts(last):
            behaviour = attrs.evolve(behaviour, regime=Regime.INTERMITTENT, period=math.nan)
        else:
            long_period = _long_period(last, frequency_hz, settings)
            if sign == 0 and (behaviour.regime is not Regime.CHAOTIC or long_period):
                sign = self._parting(frequency_hz, amplitude, recent)
                leaving = sign > 0 and _leaves(record, frequency_hz)
            if sign > 0 and not leaving:
                behaviour = attrs.evolve(behaviour, regime=Regime.CHAOTIC, period=math.nan)
            elif sign < 0 and long_period:
                behaviour = attrs.evolve(behaviour, regime=Regime.PERIODIC, period=float(long_period))
        return _reading(last, behaviour, self._config, frequency_hz), leaving

    def _stays(self, frequency_hz: float, amplitude: float, record: _Record) -> bool:
        """Return whether a motion that seems to have settled still seems so some cycles later.

        The check detects chaotic motions that seem settled for a short time. The result is True without a check if
        there are no impacts or the sphere is in contact with a wall. The state of the rig is restored.
        """
        before = self.simulation.state()
        if before is None or not len(record.speed):
            return True
        later = record.then(self._run(frequency_hz, amplitude, _PART)).last(CHUNK)
        self.simulation.set_state(before)
        return _settled(later, frequency_hz, self._settings) > 0

    def _parting(self, frequency_hz: float, amplitude: float, record: _Record) -> int:
        """Return the sign of the largest Lyapunov exponent of the present motion.

        It is 1 if neighbouring motions certainly separate, -1 if they certainly approach one another, and otherwise 0.
        It is also 0 if `record` has no impacts, or if the sphere is in contact with a wall. `frequency_hz` and
        `amplitude` describe the drive of the record. The state of the rig is restored.
        """
        before = self.simulation.state()
        if before is None or not len(record.speed):
            return 0
        superior, base = (float(np.abs(record.cycles[name]).max()) for name in ("x_1", "x_b"))
        omega, half = 2.0 * np.pi * frequency_hz, 0.5 * self._config.barriers.gap_m
        scale = np.array([superior, omega * superior, base, omega * base, amplitude, half, omega * half])
        free = list(COORDINATES[self._config.drive.kind])
        scale = np.maximum(scale[free], TINY)

        def returned(z: Real, windows: int) -> Real:
            start = before.copy()
            start[free] = z * scale
            self.simulation.set_state(start)
            self.run_cycles(frequency_hz, amplitude, windows * WINDOW_CYCLES)
            state = self.simulation.state()
            return np.full(len(z), math.nan) if state is None else state[free] / scale

        found = exponent.sign(exponent.in_windows(returned, before[free] / scale, 1))
        self.simulation.set_state(before)
        return found

    def _drifts(self, record: _Record) -> bool:
        """Return whether the sphere has not struck during a record, but will strike a wall within `NEAR_S` seconds."""
        if len(record.speed) or not self._config.sphere.present:
            return False
        place, velocity = float(record.cycles["x_2"][-1]), float(record.cycles["v_2"][-1])
        reach = self._config.barriers.gap_m / 2.0 - float(np.abs(record.cycles["x_1"][-CHUNK:]).max())
        return bool(abs(place + velocity * NEAR_S) > reach > 0.0) and abs(velocity) > 0.0

    def behaviour(self, frequency_hz: float, amplitude: float, cycles: int) -> Behaviour:
        """Advance by some drive cycles, and classify their motion as the analysis of a measurement does.

        Only the amplitude of the superior base and the impacts are used, so a chaotic motion with small changes from
        cycle to cycle may be classified as periodic. The arguments and errors are those of `run_cycles`.
        """
        return _behaviour(self._run(frequency_hz, amplitude, cycles), self._settings)

    def run_cycles(self, frequency_hz: float, amplitude: float, cycles: int) -> Motion:
        """Advance by whole drive cycles, and return their motion with one drive segment per cycle.

        If the amplitude differs from that of the previous cycles, it changes linearly during the first cycle.

        Args:
            frequency_hz: frequency of the drive.
            amplitude: peak amplitude of the drive; A, m or V by `drive.kind`.
            cycles: number of drive cycles.

        Raises:
            SimulationError: the motion cannot be simulated.
        """
        period = 1.0 / frequency_hz
        segments = np.zeros(cycles, SEGMENT)
        segments["duration"], segments["omega"] = period, 2.0 * np.pi * frequency_hz
        segments["amplitude"] = amplitude
        segments[0]["amplitude"] = self._amplitude  # a ramp of one cycle to the new values
        segments[0]["growth"] = (amplitude - self._amplitude) / period
        self._amplitude = amplitude
        return self.simulation.advance(segments)

    def _run(self, frequency_hz: float, amplitude: float, cycles: int) -> _Record:
        """Advance by whole drive cycles, and return their record; arguments and errors are those of `run_cycles`."""
        motion, period = self.run_cycles(frequency_hz, amplitude, cycles), 1.0 / frequency_hz
        hits = motion.impacts
        cycle = np.maximum(hits["tick"] - motion.first_tick, 0)  # an impact that began earlier is reported now
        return _Record(motion.cycles(), cycle, hits["offset"] / period, hits["approach_speed"].copy())


def _series(record: _Record, frequency_hz: float) -> NDArray[np.complex128] | None:
    """Return the dimensionless motion of bases and sphere in each cycle, shape (4, cycles).

    The rows are the complex amplitudes x_b and x_1 of the bases, and position and velocity of the sphere. They are
    divided by the mean amplitudes of the bases; the velocity also by the drive frequency in rad/s. The result is None
    if the mean of x_b or x_1 is zero.
    """
    series = np.array([record.cycles[name] for name in ("x_b", "x_1", "x_2", "v_2")])
    base, superior = np.abs(series[:2].sum(axis=1)).tolist()
    if base == 0.0 or superior == 0.0:
        return None
    sizes = np.array([base, superior, superior, 2.0 * np.pi * frequency_hz * superior]) / series.shape[1]
    return np.asarray(series / sizes[:, np.newaxis])


def _leaves(record: _Record, frequency_hz: float) -> bool:
    """Return whether a motion is leaving a periodic orbit: its changes from period to period are small, but growing.

    The end of the record is divided into `_RISES` parts. The largest change must be larger in each part than in the
    part before. In the last part it must be at most `_CLOSE` times the mean amplitude.
    """
    series = _series(record.last(_RISES * CHUNK), frequency_hz)
    if series is None:
        return False
    for period in range(1, LONGEST_PERIOD + 1):
        change = np.abs(series[:, period:] - series[:, :-period]).max(axis=0)
        largest_changes = [float(part.max()) for part in np.array_split(change, _RISES)]
        if largest_changes[-1] <= _CLOSE and all(a < b for a, b in itertools.pairwise(largest_changes)):
            return True
    return False


def _settled(record: _Record, frequency_hz: float, settings: Settings) -> int:
    """Return the period of a settled motion in drive cycles; 0 if the motion has not settled."""
    rows = record.cycles.view(np.float64).reshape(len(record.cycles), -1)
    omega, longest = 2.0 * np.pi * frequency_hz, min(LONGEST_PERIOD, CHUNK // 4)
    tolerances = settings.settle_tolerance, settings.periodic_tolerance
    return settled_period(rows, _strikes(record), omega, *tolerances, longest, np.empty_like(rows))


def _long_period(record: _Record, frequency_hz: float, settings: Settings) -> int:
    """Return the number of drive cycles after which the motion repeats; 0 if it does not repeat.

    Periods up to `LONGEST_LOOKED` and up to a third of the record are considered. The superior base and the sphere must
    repeat within `periodic_tolerance`.
    """
    series = np.array([record.cycles[name] for name in ("x_1", "x_2", "v_2")])
    superior = float(np.abs(series[0]).mean())
    sizes = np.array([superior, superior, 2.0 * np.pi * frequency_hz * superior])[:, np.newaxis]
    longest = min(LONGEST_LOOKED, series.shape[1] // 3)
    last_apart = (np.abs(series[:, -1:] - series[:, -2 : -2 - longest : -1]) / sizes).max(axis=0)
    for period in (np.flatnonzero(last_apart <= settings.periodic_tolerance) + 1).tolist():
        apart = np.abs(series[:, -period:] - series[:, -2 * period : -period]) / sizes
        if apart.max() <= settings.periodic_tolerance:
            return int(period)
    return 0


def _strong(record: _Record) -> NDArray[np.bool_]:
    if not len(record.speed):
        return np.zeros(0, bool)
    return np.asarray(record.speed >= WEAK * record.speed.max())


def _strikes(record: _Record) -> NDArray[np.uint8]:
    """Return an array of shape (cycles, `PHASE_BINS`): 1 for each phase bin of a cycle with a strong impact, else 0.

    An impact is strong if its speed is at least `WEAK` times the speed of the fastest impact.
    """
    strikes, strong = np.zeros((len(record.cycles), PHASE_BINS), np.uint8), _strong(record)
    strikes[record.cycle[strong], (record.turn[strong] * PHASE_BINS).astype(np.int64) % PHASE_BINS] = 1
    return strikes


def _deviation(record: _Record) -> Complex:
    """Return the deviation of x_1 from its mean in each cycle, relative to the mean; NaN if the mean is zero."""
    superior = record.cycles["x_1"]
    mean = superior.mean()
    return np.asarray(superior / mean - 1.0 if mean else np.full(len(superior), math.nan + 0.0j))


def _behaviour(record: _Record, settings: Settings) -> Behaviour:
    return classify(_deviation(record), 0.0, settings.periodic_tolerance, _strikes(record))


def _reading(record: _Record, behaviour: Behaviour, config: RigConfig, frequency_hz: float) -> Reading:
    half = len(record.cycles) // 2
    if math.isfinite(behaviour.period):  # whole periods, otherwise the mean is meaningless
        half -= half % int(behaviour.period)
    parts = record.cycles[-2 * half : -half], record.cycles[-half:]
    amplitudes = np.array([[part["x_b"].mean(), part["x_1"].mean()] for part in parts])
    first, last = np.abs(amplitudes[:, 1] / amplitudes[:, 0]).tolist()
    base, superior = amplitudes.mean(axis=0)
    ratio = superior / base
    dt, n = float(abs(ratio)), 2 * half
    impacts = float(np.sum(_strong(record) & (record.cycle >= len(record.cycles) - n))) / n
    return Reading(
        regime=behaviour.regime.value,
        dt=dt,
        reduction_percent=100.0 * (1.0 - dt / abs(complex(transmissibility(config, frequency_hz)))),
        phase_rad=float(np.angle(ratio)),
        base_m=float(abs(base)),
        superior_m=float(abs(superior)),
        impacts_per_cycle=impacts,
        period=behaviour.period,
        spread=behaviour.spread,
        drift=abs(last - first) / dt,
        cycles=float(len(record.cycles)),
    )
