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
"""Stroboscopic map of the rig: its state once per period of an orbit (one or several cycles of the drive).

Between two such states the motion is simulated with exactly located impacts. The state consists of the displacement and
velocity of the superior base (x_1, v_1), and of the sphere's relative position d = x_2 − x_1 and its rate d'. If the
inferior base moves freely, its displacement and velocity (x_b, v_b) are added. A voltage drive adds the current of the
coil. The coordinates are dimensionless: each is divided by the size of the motion.

The section is the phase of the drive at which the state is taken. It lies in the longest part of the cycle without a
contact of the sphere and a wall, because the state alone does not determine a contact in progress.
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
from impact_rig_studies.campaign import axes
from impact_rig_studies.dynamics.orbits import FLIP, FOLD, STEP, SYMMETRY, Orbit, jacobian
from impact_rig_studies.maps.measure import COORDINATES, MapRig, Reading
from impact_rig_studies.maps.plan import CURRENT, FREQUENCY, GAP

SPHERE = (5, 6)  # indices of the sphere's relative position and its rate in a state (`Simulation.state`)
CLOSE = 0.02  # time between an impact and the section, in cycles, below which another section is chosen
_TURN = 2.0 * math.pi
_FINE = 64  # equal parts of a cycle, of which those with a contact exclude a section


class Place(NamedTuple):
    """Point of parameter space: configuration of a rig, frequency and amplitude (A, m or V) of its sine drive."""

    config: RigConfig
    frequency_hz: float  # frequency of the drive
    amplitude: float  # peak amplitude of the drive: A, m or V by `drive.kind`


class Energy(NamedTuple):
    """Energy balance of a motion: work done by the drive, and losses in the parts of the rig, per drive cycle [J]."""

    work: float  # work of the coil's force or voltage, or of the force that moves a prescribed inferior base
    columns: float  # loss in the columns that carry the superior base
    shaker: float  # loss in the shaker
    contact: float  # loss in the contacts of the sphere with the walls
    friction: float  # loss by friction of the sphere on its guide
    imbalance: float  # work − losses − increase of the stored energy: the error of the balance


class Properties(NamedTuple):
    """Mean properties of a periodic orbit over its period; X_1, X_b: complex amplitudes at the drive frequency.

    x_1 is the displacement of the superior base, x_b that of the inferior base. In the loss factors and the added mass,
    the damper is the sphere.
    """

    dt: float  # transmissibility |X_1| / |X_b|
    phase_rad: float  # phase of X_1 relative to X_b
    base_m: float  # |X_b|, peak
    superior_m: float  # |X_1|, peak
    impacts_per_cycle: float  # number of impacts per cycle of the drive, including weak ones
    slowest_m_s: float  # approach speed of the slowest impact; NaN without one
    loss_factor: float  # loss factor of the damper from energy: its loss per cycle over π m_1 ω² |X_1|²
    dt_loss_factor: float  # loss factor from DT and phase: −Im N / (m_1 ω²), N is the sphere's force on m_1 over X_1
    added_mass: float  # mass by which the damper appears to increase m_1, as a share of m_1: Re N / (m_1 ω²)
    energy: Energy  # energies per cycle of the drive


class OrbitSummary(NamedTuple):
    """Properties of a periodic orbit, its period, and its state at the section, as stored in a row of results."""

    properties: Properties
    cycles: int  # period of the orbit in cycles of the drive
    turn: float  # phase of the drive at the section, in turns
    state: tuple[float, ...]  # state of the whole rig at the section, in the order of `Simulation.state`


class Slopes(NamedTuple):
    """Derivatives of ln DT (DT: transmissibility) on an orbit by parameters of the rig, and the orbit's stability."""

    by: Real  # derivatives of ln(|X_1| / |X_b|) of the fundamentals by each parameter, shape (number of parameters,)
    stable: bool  # whether all multipliers of the orbit are inside the unit circle


BORN = 1e-4
"""Largest coordinate difference of an orbit that counts as equal to itself, or its mirror image, half a period later.
"""


class Stroboscope:
    """Stroboscopic map z → f(z, p) of a rig, for the periodic orbits of `dynamics.orbits`.

    z is the state at the section in dimensionless coordinates. f(z, p) is the state `cycles` cycles of the drive later.
    `seen` sets the attributes for a settled motion.

    Args:
        place: the rig and its drive.
        over: name of the parameter: frequency_hz, current_a, gap_m, or a number of the configuration by dotted name.
        unit: change of that parameter in its own unit for which the dimensionless p changes by 1; the value of the
            parameter is p · unit.

    Attributes:
        cycles: number of cycles of the drive after which an orbit repeats.
        turn: phase of the drive at the section, in turns.
        scale: SI value of each coordinate that corresponds to 1.
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
        """Return the rig at the dimensionless parameter p, and its compiled model.

        If only the drive differs from that of the original rig, the model is the original one.
        """
        place = at(self._place, self._over, p * self._unit)
        return place, self._model if place.config is self._place.config else build(place.config)

    def __call__(self, z: Real, p: float, returns: int = 1) -> Real:
        """Return the coordinates to which the state z leads after `returns` returns of the map.

        One return takes `cycles` cycles of the drive. `p` is the dimensionless parameter. The result has the shape of
        z, (n,). It is NaN if the sphere is then in contact with a wall, the motion cannot be simulated, or p is out of
        the parameter's range. It is also NaN if a motion that had no impacts when the coordinates were chosen has one.
        """
        try:
            motion = self._run(z, p, self.cycles * returns)
        except (SimulationError, ConfigError):
            return np.full(len(z), math.nan)
        return np.full(len(z), math.nan) if self._quiet and len(motion.impacts) else self._coordinates()

    def seen(self, rig: MapRig, p: float, reading: Reading) -> Real:
        """Choose period, scale and section of the map for a settled motion, and return its coordinates at the section.

        This advances the motion of `rig` by its period, and then on to the section. Without impacts, the coordinates
        do not include the sphere's position, nor its speed unless its guide has friction.

        Args:
            rig: the rig with the settled motion.
            p: dimensionless parameter at which it was measured: value of the parameter divided by `unit`.
            reading: measurement of the motion; if its period is NaN, one cycle is used as the period of the map.

        Raises:
            SimulationError: the motion cannot be simulated, or the sphere is in contact with a wall at the section.
        """
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
            raise SimulationError(
                "the sphere touches a wall at every phase of the drive, so the motion has no section; try another "
                "start or value"
            )
        d, rate = state[list(SPHERE)]
        self._aside = d if rate else 0.0  # a resting sphere may be at a wall, where its neighbours would strike
        self.scale = size(place, state)[self._free]
        return state[self._free] / self.scale

    def moved(self, points: Sequence[tuple[Real, float]]) -> list[Real] | None:
        """Choose another section if the newest orbit of a branch has an impact within `CLOSE` of the present section.

        Args:
            points: points (z, p) of a branch, the newest last.

        Returns:
            The coordinates z of the same motions at the new section, NaN for a motion with the sphere in contact there;
            None if the section is unchanged.
        """
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
        """Classify a turn of a branch in its parameter: the end of its period-doubled or asymmetric orbits, or a fold.

        Args:
            here: an orbit of the branch.
            turn: the orbit at the turn.

        Returns:
            `FLIP` if the orbit at the turn repeats after half of the period and `here` does not, `SYMMETRY` if the
            orbit at the turn is its own mirror image and `here` is not, else `FOLD`.
        """
        for kind, returned in ((FLIP, self._halved), (SYMMETRY, self._mirrored)):
            if returned(turn) < BORN < returned(here):
                return kind
        return FOLD

    def kind(self, one: Orbit) -> str:
        """Return the stability of an orbit as a word: that of `Orbit.kind`, or `SYMMETRY`.

        `SYMMETRY` replaces `FOLD` for a symmetric orbit that loses its mirror symmetry: its two half periods become
        different, and no fold is near.
        """
        if one.kind != FOLD or not self._mirrored(one) <= BORN:
            return one.kind
        matrix = jacobian(self._half, one.z, one.p)
        if not np.isfinite(matrix).all():
            return one.kind
        multipliers = np.linalg.eigvals(matrix)
        return SYMMETRY if multipliers[np.argmax(np.abs(multipliers))].real < 0.0 else FOLD

    def _halved(self, one: Orbit) -> float:
        """Return how far an orbit is from repeating after half of its period, as the largest coordinate difference.

        It is NaN if the period is an odd number of cycles, or if the sphere is in contact half a period later.
        """
        if self.cycles % 2:
            return math.nan
        self._run(one.z, one.p, self.cycles // 2)
        return float(np.abs(self._coordinates() - one.z).max())

    def _mirrored(self, one: Orbit) -> float:
        """Return how far an orbit is from its mirror image half a period later, as the largest coordinate difference.

        The result is NaN if the period is an even number of cycles. It is also NaN if the sphere is in contact with a
        wall half a cycle or half a period later.
        """
        return float(np.abs(self._half(one.z, one.p) - one.z).max()) if self.cycles % 2 else math.nan

    def _half(self, z: Real, p: float) -> Real:
        """Return the mirror image of the state half a period after z.

        The period must be an odd number of cycles. The result is NaN if the sphere is in contact with a wall half a
        cycle or half a period after z.
        """
        turn = self.turn
        try:
            self._run(z, p, 0.5)
            later = self._coordinates()
            self.turn = (turn + 0.5) % 1.0
            if self.cycles > 1 and np.isfinite(later).all():
                self._run(later, p, self.cycles // 2)
                later = self._coordinates()
        finally:
            self.turn = turn
        return -later

    def _coordinates(self) -> Real:
        """Return the scaled free coordinates of the present state; all are NaN while the sphere touches a wall."""
        state = self._simulation.state()
        return np.full(len(self._free), math.nan) if state is None else state[self._free] / self.scale

    def note(self, one: Orbit) -> OrbitSummary:
        """Return the summary of an orbit, with its SI state at the present section of the map.

        Its coordinates must refer to that section, and to the present scale.
        """
        state = self._whole(one.z, self._found(one.p)[0])
        return OrbitSummary(self.properties(one.z, one.p), self.cycles, self.turn, tuple(state.tolist()))

    def properties(self, z: Real, p: float) -> Properties:
        """Simulate one period of the orbit through the coordinates z at the parameter p, and return its properties."""
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
        """Return the derivatives of ln DT on the orbit near z with respect to `count` parameters q of the rig.

        z → f(z, q) is the map, g(z, q) is ln DT during one return, and J = ∂f/∂z. The orbit moves by (I − J)⁻¹ ∂f/∂q,
        so that dg/dq = ∂g/∂q + ∂g/∂z (I − J)⁻¹ ∂f/∂q.

        Args:
            z: coordinates near the orbit, shape (n,).
            p: dimensionless parameter of the map.
            varied: function `varied(i, step)` that returns the rig whose i-th parameter is larger by `step`, which is
                `STEP`. The derivatives are by the parameters in the unit of `step`.
            count: number of parameters.

        Returns:
            The derivatives and whether the orbit is stable. None if a disturbed motion has another number of impacts or
            cannot be simulated, or if the sphere is in contact with a wall at the section.
        """
        place, model = self._found(p)
        here, impacts = self._returned(z, place, model)

        def answer(z: Real, changed: Place = place, built: Model = model) -> Real:
            found, count = self._returned(z, changed, built)
            return found if count == impacts else np.full(len(found), math.nan)

        by_z = jacobian(lambda z, _: answer(z), z, p)
        by_place = np.empty((len(here), count))
        for i in range(count):
            changed = varied(i, STEP)
            built = model if changed.config is place.config else build(changed.config)
            by_place[:, i] = (answer(z, changed, built) - here) / STEP
        if not (np.isfinite(by_z).all() and np.isfinite(by_place).all()):
            return None
        matrix, gradient = by_z[:-1], by_z[-1]
        moved = np.linalg.solve(np.eye(len(z)) - matrix, by_place[:-1])
        stable = bool(np.abs(np.linalg.eigvals(matrix)).max() < 1.0)
        return Slopes(by_place[-1] + gradient @ moved, stable)

    def _returned(self, z: Real, place: Place, model: Model) -> tuple[Real, int]:
        """Simulate one return of the map from z.

        Returns:
            (coordinates after the return and, as last element, ln DT during it, shape (n + 1,); number of impacts).
            These are NaN and −1 if the motion cannot be simulated, or the sphere is in contact with a wall at the end.
        """
        try:
            motion = self._run_at(z, place, model, self.cycles)
            state = self._simulation.state()
        except SimulationError:
            state = None
        if state is None:
            return np.full(len(z) + 1, math.nan), -1
        cycles = motion.cycles()
        ratio = abs(cycles["x_1"].mean() / cycles["x_b"].mean())
        return np.append(state[self._free] / self.scale, math.log(ratio)), len(motion.impacts)

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
        """Return the segments of the drive for `Simulation.advance` over a time in cycles, beginning at the section.

        They are one segment per cycle for a whole number of cycles, or one segment for less than one cycle.
        """
        segments = np.zeros(max(1, int(cycles)), SEGMENT)
        segments["duration"] = min(cycles, 1.0) / place.frequency_hz
        segments["omega"], segments["phase"] = _TURN * place.frequency_hz, _TURN * self.turn
        segments["amplitude"] = place.amplitude
        return segments

    def _whole(self, z: Real, place: Place) -> Real:
        """Convert the coordinates z to the seven SI state values for `Simulation.set_state`.

        Values that are not coordinates are filled in. The displacement and velocity of a prescribed base follow from
        its drive. If the motion has no impacts, the sphere gets an assumed position, and rests in space if its guide
        has no friction.
        """
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
        """Return the coordinates of the motion through z when the drive next has the phase `turn` [turns].

        This phase becomes the section of the map. The coordinates are NaN if the sphere then touches a wall.
        If z is NaN or `turn` is the present section, the section is kept and z is returned.
        """
        later = (turn - self.turn) % 1.0
        if later == 0.0 or not np.isfinite(z).all():  # a point in a contact at an earlier section stays unknown
            return z
        self._run(z, p, later)
        self.turn = turn
        return self._coordinates()


def at(place: Place, over: str, value: float) -> Place:
    """Return a copy of `place` in which one parameter has another value.

    Args:
        place: the rig and its drive.
        over: name of the parameter, as for `Stroboscope`.
        value: value of the parameter in its own unit.

    Raises:
        ConfigError: the configuration has no parameter `over` that is a number, or `value` is out of its range.
    """
    config, frequency, amplitude = place
    if over == FREQUENCY:
        return Place(config, axes.number(over, value, 0.0, 1e4), amplitude)
    if over == CURRENT:
        return Place(config, frequency, axes.number(over, value, 0.0))
    changed = from_flat(config, {"barriers.gap_m" if over == GAP else over: value})
    return Place(changed, frequency, amplitude)


def _longest_flight(motion: Motion, cycles: int) -> float:
    """Return the phase of the drive that is best suited as a section of a motion, in turns since the motion's start.

    This phase is the middle of the longest part of the drive cycle in which the sphere touches no wall in any of the
    cycles. It is 0 if there are no contacts.
    """
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
    """Return the typical SI size of a motion for each value of `Simulation.state`, shape (7,).

    The coordinates of a map are divided by it. `state` is one state of the motion, shape (7,).
    """
    omega, half = _TURN * place.frequency_hz, 0.5 * place.config.barriers.gap_m
    x, b = (max(math.hypot(at, rate / omega), 1e-9) for at, rate in (state[0:2], state[2:4]))
    return np.array([x, omega * x, b, omega * b, max(place.amplitude, 1e-9), half, omega * half])
