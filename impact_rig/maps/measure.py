# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the mechanics settle to at one place of a map: DT and phase of the fundamental, impacts per cycle, regime.

The regime is that of `analysis.spread.classify`. One drive segment is one cycle, so the record is
stroboscopic: the fundamental of both bases is a sum over each cycle. Everything is deterministic, and starts either
from a reset rig or from what the place before left.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.cycles import PHASE_BINS
from impact_rig.analysis.spread import Behaviour, classify
from impact_rig.config.fields import integer, quantity
from impact_rig.errors import SimulationError
from impact_rig.physics import SEGMENT, Motion, Simulation
from impact_rig.physics.prediction import transmissibility
from impact_rig.rig.config import RigConfig
from impact_rig.states import Regime

PER_CYCLE = 32
"""Instants per cycle of the fundamental's sum: the 31st harmonic is the first that disturbs it, by less than 1e-5."""
CHUNK = 24  # cycles looked at together: responses of period 1, 2, 3, 4, 6 and 8 have one mean in each
WEAK = 0.02
"""Impacts slower than this share of the fastest one are bounces that settle: not counted, no part of the regime."""
NEAR_S = 60.0  # a sphere that flies towards a wall and will strike it within this time has not come to rest
FAILED = "failed"  # the regime of a place whose motion could not be resolved
_ANGLE = 2.0 * np.pi * np.arange(PER_CYCLE) / PER_CYCLE
_TURN = 2j / PER_CYCLE * np.exp(-1j * _ANGLE)


@attrs.frozen(kw_only=True)
class Settings:
    """How a place of a map is measured."""

    settle_tolerance: float = quantity(
        5e-4,
        "-",
        "Relative change from one stretch of 24 cycles to the next that counts as none.",
        above=0,
        at_most=0.1,
    )
    periodic_tolerance: float = quantity(
        1e-3, "-", "Relative cycle-to-cycle spread up to which a response counts as periodic.", above=0, at_most=0.5
    )
    settle_cycles: int = integer(
        360, "-", "Cycles of waiting for a settled response, at most.", at_least=48, at_most=100_000
    )
    cycles: int = integer(
        200, "-", "Cycles over which a response that does not repeat is averaged.", at_least=48, at_most=100_000
    )


class Reading(NamedTuple):
    """What was found at one place."""

    regime: str
    """Periodic, modulated, chaotic, intermittent (impacts came, stay away, and will come again), or `FAILED`."""
    dt: float  # |X_1| / |X_b| of the fundamentals
    reduction_percent: float  # 100 (1 − DT / DT without the sphere, in closed form)
    phase_rad: float  # of X_1 / X_b
    base_m: float  # |X_b|
    superior_m: float  # |X_1|
    impacts_per_cycle: float  # of the impacts that are not weak
    period: float  # cycles after which the response repeats; NaN if it does not
    spread: float  # relative cycle-to-cycle rms of X_1
    drift: float  # relative change of DT between the halves of the record: what a longer one might change
    cycles: float


NOTHING = Reading(FAILED, *[math.nan] * 10)


class _Record(NamedTuple):
    """Consecutive cycles: fundamentals of x_b and x_1, shape (n,), and impacts as (cycle, turn, speed)."""

    base: NDArray[np.complex128]
    superior: NDArray[np.complex128]
    cycle: NDArray[np.int64]
    turn: NDArray[np.float64]
    speed: NDArray[np.float64]


class MapRig:
    """The mechanics in the hands of a map."""

    def __init__(self, config: RigConfig, settings: Settings) -> None:
        self._settings = settings
        self._config = config
        self.simulation = Simulation(config)
        self._amplitude = 0.0
        self._newest: Motion | None = None

    def change(self, config: RigConfig) -> None:
        """Go on with another configuration: the structure keeps its motion, the sphere begins at its start again."""
        if config is not self._config:
            self.simulation.configure(config)
            self._config = config

    def carry(self, config: RigConfig) -> None:
        """Go on with another configuration: all keeps its motion, the sphere stays between the new walls."""
        if config is self._config:
            return
        state = self.simulation.state()
        self.change(config)
        if state is not None:  # in a contact: it begins at its start
            half = config.barriers.gap_m / 2.0
            state[-2] = min(max(state[-2], -half), half)
            self.simulation.set_state(state)

    def reset(self, sphere: tuple[float, float] | None = None) -> None:
        """Put everything to rest, the sphere at its start.

        Args:
            sphere: instead, where it is, from the middle between the walls [m], and its speed to the right [m/s].
        """
        self.simulation.reset()
        if sphere is not None:
            place, speed = sphere
            self.simulation.place(d=place, d_rate=speed)
        self._amplitude = 0.0

    def measure(self, frequency_hz: float, amplitude: float) -> Reading:
        """Drive with a sine, wait until settled, and return what the mechanics do.

        Args:
            frequency_hz: of the drive.
            amplitude: peak; A, m or V by `drive.kind`.
        """
        try:
            return self._measured(frequency_hz, amplitude)
        except SimulationError:
            self.reset()
            return NOTHING

    def _measured(self, frequency_hz: float, amplitude: float) -> Reading:
        record = self._settled(frequency_hz, amplitude)
        behaviour = _behaviour(record, self._settings)
        drifts = self._drifts(record)
        if drifts or not math.isfinite(behaviour.period):
            record = self._run(frequency_hz, amplitude, self._settings.cycles)
            behaviour = _behaviour(record, self._settings)
            if drifts or self._drifts(record):
                behaviour = attrs.evolve(behaviour, regime=Regime.INTERMITTENT, period=math.nan)
        return _reading(record, behaviour, self._config, frequency_hz)

    def _settled(self, frequency_hz: float, amplitude: float) -> _Record:
        """Wait, and return the last two chunks."""
        now = self._run(frequency_hz, amplitude, CHUNK)
        quiet = 0
        for _ in range(self._settings.settle_cycles // CHUNK):
            before, now = now, self._run(frequency_hz, amplitude, CHUNK)
            quiet = quiet + 1 if _change(before, now) <= self._settings.settle_tolerance else 0
            if quiet >= 2 and not self._drifts(both := _joined(before, now)):
                return both
        return _joined(before, now)

    def _drifts(self, record: _Record) -> bool:
        """Return whether a record without impacts ends with the sphere on its way to one.

        Between impacts the sphere keeps its velocity, and the wall moves to and fro by |X_1|.
        """
        motion = self._newest
        if len(record.speed) or not self._config.sphere.present or motion is None:
            return False
        end = np.array([motion.last_tick]), motion.segments["duration"][-1:]
        place, velocity = motion.quantities(("x_2", "v_2"), *end)[:, 0].tolist()
        reach = self._config.barriers.gap_m / 2.0 - float(np.abs(record.superior[-CHUNK:]).max())
        return bool(abs(place + velocity * NEAR_S) > reach > 0.0) and abs(velocity) > 0.0

    def advance(self, frequency_hz: float, amplitude: float, cycles: int) -> Motion:
        """Return the motion of the next whole cycles, one drive segment each; the first ramps to a new amplitude."""
        period = 1.0 / frequency_hz
        segments = np.zeros(cycles, SEGMENT)
        segments["duration"], segments["omega"] = period, 2.0 * np.pi * frequency_hz
        segments["amplitude"] = amplitude
        segments[0]["amplitude"] = self._amplitude  # a ramp of one cycle to what is new
        segments[0]["growth"] = (amplitude - self._amplitude) / period
        self._amplitude = amplitude
        return self.simulation.advance(segments)

    def _run(self, frequency_hz: float, amplitude: float, cycles: int) -> _Record:
        """Advance by whole cycles."""
        motion, period = self.advance(frequency_hz, amplitude, cycles), 1.0 / frequency_hz
        number = np.repeat(np.arange(motion.first_tick, motion.last_tick + 1), PER_CYCLE)
        offset = np.tile(_ANGLE / (2.0 * np.pi) * period, cycles)
        x_b, x_1 = motion.quantities(("x_b", "x_1"), number, offset).reshape(2, cycles, PER_CYCLE)
        self._newest, hits = motion, motion.impacts
        place = np.maximum(hits["tick"] - motion.first_tick, 0)  # one that began before is told of now
        return _Record(
            (x_b * _TURN).sum(axis=1), (x_1 * _TURN).sum(axis=1), place, hits["offset"] / period, hits["approach_speed"]
        )


def _joined(one: _Record, other: _Record) -> _Record:
    later = other._replace(cycle=other.cycle + len(one.base))
    return _Record(*(np.concatenate(parts) for parts in zip(one, later, strict=True)))


def _change(before: _Record, now: _Record) -> float:
    """Return the relative change of the means, of whichever base changes more."""
    changes = [
        abs(new.mean() - old.mean()) / max(abs(new.mean()), 1e-300)
        for old, new in zip((before.base, before.superior), (now.base, now.superior), strict=True)
    ]
    return float(max(changes))


def _strong(record: _Record) -> NDArray[np.bool_]:
    if not len(record.speed):
        return np.zeros(0, bool)
    return np.asarray(record.speed >= WEAK * record.speed.max())


def _behaviour(record: _Record, settings: Settings) -> Behaviour:
    n = len(record.superior)
    strikes = np.zeros((n, PHASE_BINS), np.uint8)
    strong = _strong(record)
    strikes[record.cycle[strong], (record.turn[strong] * PHASE_BINS).astype(np.int64) % PHASE_BINS] = 1
    mean = record.superior.mean()
    if mean == 0.0:
        return classify(np.full(n, np.nan, np.complex128), 0.0, settings.periodic_tolerance, strikes)
    return classify(record.superior / mean - 1.0, 0.0, settings.periodic_tolerance, strikes)


def _reading(record: _Record, behaviour: Behaviour, config: RigConfig, frequency_hz: float) -> Reading:
    n = len(record.base)
    if math.isfinite(behaviour.period):  # whole periods, or the mean is none
        n -= n % int(behaviour.period)
    base, superior = record.base[-n:].mean(), record.superior[-n:].mean()
    ratio = superior / base
    dt, half = float(abs(ratio)), n // 2
    first = abs(record.superior[-n:][:half].mean() / record.base[-n:][:half].mean())
    last = abs(record.superior[-n:][half:].mean() / record.base[-n:][half:].mean())
    counted = _strong(record) & (record.cycle >= len(record.base) - n)
    return Reading(
        regime=behaviour.regime.value,
        dt=dt,
        reduction_percent=100.0 * (1.0 - dt / abs(complex(transmissibility(config, frequency_hz)))),
        phase_rad=float(np.angle(ratio)),
        base_m=float(abs(base)),
        superior_m=float(abs(superior)),
        impacts_per_cycle=float(counted.sum()) / n,
        period=behaviour.period,
        spread=behaviour.spread,
        drift=float(abs(last - first) / dt),
        cycles=float(len(record.base)),
    )
