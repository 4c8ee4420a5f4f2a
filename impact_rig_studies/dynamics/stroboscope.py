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
"""Stroboscopic map of the rig: its state once in several cycles of its drive, with exact events in between.

The state is (x_1, v_1, d, d') and, unless the base is prescribed, (x_b, v_b) and a coil's current; d = x_2 − x_1. It is
divided by the size of the motion, so that a step of 1 means the same in each coordinate. The section is the phase of
the drive at which the state is taken. It is in the longest stretch without a contact, because the state alone does not
determine a contact in progress.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Real
from impact_rig.errors import ConfigError, SimulationError
from impact_rig.physics import SEGMENT, Motion, Simulation
from impact_rig.physics.linear import constants
from impact_rig.physics.model import Model, build
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.dynamics.orbits import FLIP, FOLD, SYMMETRY, Orbit
from impact_rig_studies.maps.measure import MapRig, Reading
from impact_rig_studies.maps.plan import CURRENT, FREQUENCY, GAP

COORDINATES = {"prescribed": (0, 1, 5, 6), "current": (0, 1, 2, 3, 5, 6), "voltage": (0, 1, 2, 3, 4, 5, 6)}
"""Indices of the coordinates in `Simulation.state`, by kind of drive."""
SPHERE = (5, 6)  # indices of the sphere
CLOSE = 0.02  # turns of the drive between an impact and the section below which another section is chosen
_TURN = 2.0 * math.pi
_FINE = 64  # parts of a cycle among which a section is chosen


class Place(NamedTuple):
    """Rig and its drive."""

    config: RigConfig
    frequency_hz: float
    amplitude: float


class Energy(NamedTuple):
    """Energies per cycle of the drive [J]."""

    work: float  # of the shaker, or of a prescribed base
    columns: float  # loss in the columns
    shaker: float  # loss in the shaker
    contact: float  # loss in the contacts
    friction: float  # loss on the guide
    imbalance: float  # work − losses − stored energy


class Properties(NamedTuple):
    """Properties of a periodic orbit."""

    dt: float  # |X_1| / |X_b| of the fundamentals
    phase_rad: float  # phase of X_1 / X_b
    base_m: float  # |X_b|
    superior_m: float  # |X_1|
    impacts_per_cycle: float  # number of all impacts
    slowest_m_s: float  # approach speed of the slowest impact; NaN without one
    loss_factor: float  # of the damper from energy: its loss per cycle over π m_1 ω² |X_1|²
    dt_loss_factor: float  # the same from DT alone: −Im N / (m_1 ω²), N the sphere's force per x_1
    added_mass: float  # of the damper from DT alone, over m_1: Re N / (m_1 ω²)
    energy: Energy  # per cycle


class OrbitSummary(NamedTuple):
    """Properties of an orbit, its period in cycles, and its state at the section [turns]."""

    properties: Properties
    cycles: int
    turn: float
    state: tuple[float, ...]  # state of the whole rig at the section, as in `Simulation.state`


class Slopes(NamedTuple):
    """Transmissibility on an orbit, and its derivatives by the rig's parameters."""

    log_dt: float  # ln(|X_1| / |X_b|) of the fundamentals
    by: Real  # its derivatives by each parameter
    stable: bool  # whether all multipliers of the orbit are inside the unit circle


BORN = 1e-4  # largest component by which an orbit differs from itself half a period later, or from its mirror image
STEP = 1e-6
"""Relative step of differences: truncation falls with it, rounding and the contacts' tolerance grow."""


class Stroboscope:
    """Map of a rig along one parameter, in dimensionless coordinates.

    Args:
        place: the rig and its drive.
        over: name of the parameter: frequency_hz, current_a, gap_m, or a number of the configuration by dotted name.
        unit: size of a step of 1 of the dimensionless parameter.

    Attributes:
        cycles: cycles of the drive after which an orbit repeats.
        turn: the section: phase of the drive, in turns.
        scale: scale of each coordinate.
    """

    def __init__(self, place: Place, over: str, unit: float) -> None:
        self._place, self._over, self._unit, self.cycles = place, over, unit, 1
        self.turn = 0.0
        self._quiet, self._aside = False, 0.0
        self._free = list(COORDINATES[place.config.drive.kind])
        self.scale = np.ones(len(self._free))
        self._at = self._model = build(place.config)
        self._simulation = Simulation(place.config, model=self._model)
        self._found = functools.lru_cache(maxsize=8)(self._find)

    def _find(self, p: float) -> tuple[Place, Model]:
        """Return the rig and its model; a change of the drive alone does not change the model."""
        place = at(self._place, self._over, p * self._unit)
        return place, self._model if place.config is self._place.config else build(place.config)

    def __call__(self, z: Real, p: float, returns: int = 1) -> Real:
        """Return the coordinates after `cycles`; NaN if the motion is in a contact, or cannot be resolved."""
        try:
            motion = self._run(z, p, self.cycles * returns)
            state = None if self._quiet and len(motion.impacts) else self._simulation.state()
        except (SimulationError, ConfigError):
            state = None
        return np.full(len(z), math.nan) if state is None else state[self._free] / self.scale

    def seen(self, rig: MapRig, p: float, reading: Reading) -> Real:
        """Return the coordinates of a settled motion, and choose scale and section for it; this advances the motion."""
        place, _ = self._found(p)
        frequency, amplitude = place.frequency_hz, place.amplitude
        self.cycles = int(reading.period) if math.isfinite(reading.period) else 1
        self._quiet = not reading.impacts_per_cycle
        if self._quiet:  # without impacts the position of the sphere is irrelevant, and without friction its speed
            sphere = place.config.sphere
            left_out = SPHERE[:1] if sphere.present and sphere.guide_friction > 0.0 else SPHERE
            self._free = [i for i in self._free if i not in left_out]
        motion = rig.run_cycles(frequency, amplitude, self.cycles)
        self.turn = _longest_flight(motion, self.cycles)
        part = np.zeros(1, SEGMENT)
        part["duration"], part["omega"], part["amplitude"] = self.turn / frequency, _TURN * frequency, amplitude
        rig.simulation.advance(part)
        state = rig.simulation.state()
        if state is None:
            raise SimulationError("the sphere is never free of the walls: there is no section")
        d, rate = state[list(SPHERE)]
        self._aside = d if rate else 0.0  # a resting sphere may be at a wall, where its neighbours would strike
        self.scale = size(place, state)[self._free]
        return state[self._free] / self.scale

    def moved(self, points: Sequence[tuple[Real, float]]) -> list[Real] | None:
        """Return points of a branch at another section if an impact of the last one is near this section, else None."""
        motion = self._run(*points[-1], self.cycles)
        turns = motion.impacts["offset"] / motion.segments["duration"][0]
        if not len(turns) or np.abs((turns + 0.5) % 1.0 - 0.5).min() > CLOSE:
            return None
        turn, old = (self.turn + _longest_flight(motion, self.cycles)) % 1.0, self.turn
        found = []
        for z, p in points:
            self.turn = old
            found.append(self._moved(z, p, turn))
        return found

    def born(self, here: Orbit, turn: Orbit) -> str:
        """Classify a turn of a branch: the birth of its doubled or asymmetric orbits, or a fold.

        Args:
            here: an orbit of the branch.
            turn: the orbit at the turn; only at a birth is it its own half or its own mirror image.
        """
        for kind, returned in ((FLIP, self._halved), (SYMMETRY, self._mirrored)):
            there = returned(turn)
            if there is not None and there < BORN < (returned(here) or 0.0):
                return kind
        return FOLD

    def _halved(self, one: Orbit) -> float | None:
        """Return the distance of an orbit from itself half of its cycles later, None if they are odd."""
        if self.cycles % 2:
            return None
        self._run(one.z, one.p, self.cycles // 2)
        return self._apart(one.z)

    def _mirrored(self, one: Orbit) -> float | None:
        """Return the distance of an orbit from its mirror image half of its cycles later, None if they are even."""
        if self.cycles % 2 == 0:
            return None
        self._run(one.z, one.p, 0.5)
        state = self._simulation.state()
        if state is None:
            return None
        turn, self.turn = self.turn, (self.turn + 0.5) % 1.0
        try:
            z = state[self._free] / self.scale
            if self.cycles > 1:
                self._run(z, one.p, self.cycles // 2)
                return self._apart(-one.z)
            return float(np.abs(z + one.z).max())
        finally:
            self.turn = turn

    def _apart(self, z: Real) -> float | None:
        state = self._simulation.state()
        return None if state is None else float(np.abs(state[self._free] / self.scale - z).max())

    def note(self, one: Orbit) -> OrbitSummary:
        """Return the properties of an orbit in the present coordinates."""
        state = self._whole(one.z, self._found(one.p)[0])
        return OrbitSummary(self.properties(one.z, one.p), self.cycles, self.turn, tuple(state.tolist()))

    def properties(self, z: Real, p: float) -> Properties:
        """Return the properties of the orbit through z."""
        place, model = self._found(p)
        config, frequency = place.config, place.frequency_hz
        simulation = Simulation(config, account=True, model=model)
        simulation.set_state(self._whole(z, place))
        motion = simulation.advance(self._segments(place, self.cycles))
        energy = simulation.energy()
        cycles = motion.cycles()
        base, superior = cycles["x_b"].mean(), cycles["x_1"].mean()
        ratio, speeds = superior / base, motion.impacts["approach_speed"]
        c, s = constants(config), 1j * _TURN * frequency
        k, inertia = c.k_1 + c.c_1 * s, c.m_1 * abs(s) ** 2
        force = k - inertia - k / ratio
        per_cycle = [getattr(energy, name) / self.cycles for name in Energy._fields]
        damper = (energy.contact + energy.friction) / self.cycles
        return Properties(
            dt=float(abs(ratio)),
            phase_rad=float(np.angle(ratio)),
            base_m=float(abs(base)),
            superior_m=float(abs(superior)),
            impacts_per_cycle=len(speeds) / self.cycles,
            slowest_m_s=float(speeds.min()) if len(speeds) else math.nan,
            loss_factor=damper / (math.pi * inertia * float(abs(superior)) ** 2),
            dt_loss_factor=float(-force.imag / inertia),
            added_mass=float(force.real / inertia),
            energy=Energy(*per_cycle),
        )

    def slopes(self, z: Real, p: float, varied: Callable[[int, float], Place], count: int) -> Slopes | None:
        """Return the transmissibility on the orbit near z and its derivatives by `count` parameters.

        z → f(z, q) is the map, g(z, q) the transmissibility of one return, and J = ∂f/∂z. The orbit moves by
        (I − J)⁻¹ ∂f/∂q, so that dg/dq = ∂g/∂q + ∂g/∂z (I − J)⁻¹ ∂f/∂q. Single returns are enough.

        Args:
            z: coordinates near the orbit, shape (n,).
            p: the parameter of the map.
            varied: returns the rig with the i-th parameter changed by a small step.
            count: number of parameters.

        Returns:
            None if a neighbour strikes in another pattern or cannot be resolved.
        """
        place, model = self._found(p)
        here, log_dt, impacts = self._returned(z, place, model)
        n = len(z)
        matrix, gradient = np.zeros((n, n)), np.zeros(n)
        by_place, direct = np.zeros((n, count)), np.zeros(count)
        for i in range(n):
            aside = np.zeros(n)
            aside[i] = STEP
            sides = (self._returned(z + sign * aside, place, model) for sign in (1.0, -1.0))
            (more, upper, one), (less, lower, other) = sides
            matrix[:, i], gradient[i] = (more - less) / (2.0 * STEP), (upper - lower) / (2.0 * STEP)
            if not one == other == impacts:
                return None
        for i in range(count):
            changed = varied(i, STEP)
            built = model if changed.config is place.config else build(changed.config)
            other_z, other_dt, other = self._returned(z, changed, built)
            by_place[:, i], direct[i] = (other_z - here) / STEP, (other_dt - log_dt) / STEP
            if other != impacts:
                return None
        if not (np.isfinite(matrix).all() and np.isfinite(by_place).all()):
            return None
        moved = np.linalg.solve(np.eye(n) - matrix, np.column_stack([here - z, by_place]))
        stable = bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)
        return Slopes(log_dt + float(gradient @ moved[:, 0]), direct + gradient @ moved[:, 1:], stable)

    def _returned(self, z: Real, place: Place, model: Model) -> tuple[Real, float, int]:
        """Return coordinates, ln DT and number of impacts of one return; NaN in a contact or if unresolved."""
        try:
            motion = self._run_at(z, place, model, self.cycles)
            state = self._simulation.state()
        except SimulationError:
            state = None
        if state is None:
            return np.full(len(z), math.nan), math.nan, -1
        cycles = motion.cycles()
        ratio = abs(cycles["x_1"].mean() / cycles["x_b"].mean())
        return state[self._free] / self.scale, math.log(ratio), len(motion.impacts)

    def _run(self, z: Real, p: float, cycles: float) -> Motion:
        place, model = self._found(p)
        return self._run_at(z, place, model, cycles)

    def _run_at(self, z: Real, place: Place, model: Model, cycles: float) -> Motion:
        if model is not self._at:
            self._simulation.configure(place.config, model)
            self._at = model
        self._simulation.set_state(self._whole(z, place))
        return self._simulation.advance(self._segments(place, cycles))

    def _segments(self, place: Place, cycles: float) -> NDArray[np.void]:
        """Return the drive from the section on, one segment per cycle; a part of a cycle is one segment."""
        segments = np.zeros(max(1, int(cycles)), SEGMENT)
        segments["duration"] = min(cycles, 1.0) / place.frequency_hz
        segments["omega"], segments["phase"] = _TURN * place.frequency_hz, _TURN * self.turn
        segments["amplitude"] = place.amplitude
        return segments

    def _whole(self, z: Real, place: Place) -> Real:
        """Return all state values for `Simulation.set_state`."""
        state = np.zeros(7)
        state[self._free] = z * self.scale
        if self._quiet and SPHERE[1] in self._free:
            state[SPHERE[0]] = self._aside
        elif self._quiet:
            state[list(SPHERE)] = -state[:2]
        if place.config.drive.kind == "prescribed":
            angle = _TURN * self.turn
            state[2] = place.amplitude * math.sin(angle)
            state[3] = place.amplitude * _TURN * place.frequency_hz * math.cos(angle)
        return state

    def _moved(self, z: Real, p: float, turn: float) -> Real:
        """Return the coordinates at another section, and use that section from now on."""
        later = (turn - self.turn) % 1.0
        if later == 0.0 or not np.isfinite(z).all():  # a point in a contact at an earlier section stays unknown
            return z
        self._run(z, p, later)
        state = self._simulation.state()
        self.turn = turn
        return np.full(len(z), math.nan) if state is None else state[self._free] / self.scale


def at(place: Place, over: str, value: float) -> Place:
    """Return a rig with another value of one parameter.

    Raises:
        ConfigError: the configuration has no such number, or it is out of range.
    """
    config, frequency, amplitude = place
    if over == FREQUENCY:
        return Place(config, value, amplitude)
    if over == CURRENT:
        return Place(config, frequency, value)
    changed = from_flat(config, {"barriers.gap_m" if over == GAP else over: value})
    return Place(changed, frequency, amplitude)


def _longest_flight(motion: Motion, cycles: int) -> float:
    """Return the middle of the longest stretch of the drive's cycle without a contact in any cycle, in turns."""
    period = float(motion.segments["duration"][0])
    number = np.repeat(np.arange(motion.first_tick, motion.last_tick + 1), _FINE)
    part = np.tile(np.arange(_FINE) / _FINE, cycles)
    force = motion.quantities(("force_left", "force_right"), number, part * period)
    busy = (force != 0.0).any(axis=0).reshape(cycles, _FINE).any(axis=0)
    busy[(motion.impacts["offset"] / period * _FINE).astype(np.int64) % _FINE] = True
    if not busy.any():
        return 0.0
    places = np.flatnonzero(busy)
    lengths = np.diff(np.append(places, places[0] + _FINE))
    best = int(np.argmax(lengths))
    return float((places[best] + 0.5 + 0.5 * lengths[best]) / _FINE % 1.0)


def size(place: Place, state: Real) -> Real:
    """Return the size of a motion in each coordinate of `Simulation.state`, shape (7,)."""
    omega, half = _TURN * place.frequency_hz, 0.5 * place.config.barriers.gap_m
    x, b = (max(math.hypot(at, rate / omega), 1e-9) for at, rate in (state[0:2], state[2:4]))
    return np.array([x, omega * x, b, omega * b, max(place.amplitude, 1e-9), half, omega * half])
