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
"""Simulation of the rig's mechanics: `Simulation` advances by drive segments, `Motion` is the result of an advance."""

from __future__ import annotations

import copy
from typing import Any  # records, which are other arrays where kernels run as plain Python

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import TWO_PI
from impact_rig.arithmetic.interpolation import NODES
from impact_rig.blocks import joined
from impact_rig.errors import SimulationError
from impact_rig.kernels import for_kernels, room, with_fields
from impact_rig.physics import contact as contact_laws
from impact_rig.physics.contact.law import raise_failure
from impact_rig.physics.contact_step import force_at, turned_at
from impact_rig.physics.event_loop import DONE, NEED_ROOM, STUCK, UNSOLVED, Workspace, new_workspace, run
from impact_rig.physics.flight import SEGMENT
from impact_rig.physics.fundamental import CYCLE, follow_cycles
from impact_rig.physics.linear import MechanicsSetup
from impact_rig.physics.model import CONTACT_RTOL, Model, build
from impact_rig.physics.sampling import (
    QUANTITIES,
    TABULATED_PIECES,
    Query,
    SamplingWorkspace,
    Spans,
    Trajectory,
    fit,
    new_sampling_workspace,
    places,
    refine,
    sample,
)
from impact_rig.physics.state import (
    ATTACHED,
    COIL,
    CONTACT,
    COUNTS,
    FREE,
    IMPACT,
    LEDGER,
    PHASES,
    PRESCRIBED,
    SPHERE_LOOSE,
    STATE,
    STRUCTURE,
    V1,
    VB,
    X1,
    XB,
)
from impact_rig.simtime import COMMAND_GRID_S

__all__ = ["IMPACT", "SAMPLE", "Motion"]

SAMPLE = np.dtype([(name, "f8") for name in QUANTITIES])


class Motion:
    """Motion of the rig over consecutive ticks, the result of `Simulation.advance`; it can be evaluated at any instant.

    A tick consists of one drive segment, or of several if the drive is a stream. An instant is given as the number of
    its tick, counted since the reset, and its offset from the start of this tick [s]. The values do not depend on how
    ticks are divided among calls of `advance`. Several motions may share `work`, their scratch memory, if they are
    evaluated one after the other. In a rig without a sphere, x_2, v_2 and a_2 have no meaning.

    Attributes:
        first_tick: number of the first tick, counted since the reset.
        segments: the drive, shape (n,), dtype `flight.SEGMENT`.
        first_segment: for each tick the row of its first segment in `segments`; the last element is the number of
            segments.
        impacts: contacts that ended in this motion, dtype `IMPACT`; a contact may have begun in an earlier motion.
    """

    def __init__(
        self, model: Model, trajectory: Trajectory, impacts: NDArray[np.void], work: SamplingWorkspace
    ) -> None:
        self.segments, self.first_tick, self.first_segment, *_ = trajectory
        self.impacts = impacts
        self._model, self._trajectory, self._sampling = model, trajectory, work

    @property
    def sampled(self) -> tuple[Model, Trajectory, SamplingWorkspace]:
        """First arguments of every kernel that evaluates this motion: model, trajectory and scratch memory."""
        return self._model, self._trajectory, self._sampling

    @property
    def last_tick(self) -> int:
        """Number of the last tick of this motion, counted since the reset."""
        return self.first_tick + len(self.first_segment) - 2

    def sample(self, tick: NDArray[np.int64], offset_s: NDArray[np.float64]) -> NDArray[np.void]:
        """Return all quantities at some instants, dtype `SAMPLE`, SI, in the shape of the instants.

        An instant is a tick and the offset from its start [s]. The evaluation is fastest if the instants are in the
        order of time. Offsets beyond the tick are not detected.

        Raises:
            ValueError: a tick is not in this motion, or the shapes differ.
        """
        found = np.moveaxis(self.quantities(QUANTITIES, tick, offset_s), 0, -1)
        rows: NDArray[np.void] = np.ascontiguousarray(found).view(SAMPLE)[..., 0]
        return rows

    def quantity(self, name: str, tick: NDArray[np.int64], offset_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the quantity of `SAMPLE` called `name` at some instants, SI, in the shape of the instants.

        An instant is a tick and the offset from its start [s]. Offsets beyond the tick are not detected.

        Raises:
            ValueError: a tick is not in this motion, the shapes differ, or no quantity has such a name.
        """
        column: NDArray[np.float64] = self.quantities((name,), tick, offset_s)[0]
        return column

    def quantities(
        self, names: tuple[str, ...], tick: NDArray[np.int64], offset_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return some quantities of `SAMPLE` at some instants, SI, shape (names, *instants).

        An instant is a tick and the offset from its start [s]. Offsets beyond the tick are not detected. One call of
        this method is faster than one call of `quantity` for each name.

        Raises:
            ValueError: a tick is not in this motion, `tick` and `offset_s` have different shapes, a name is not in
                `QUANTITIES`, or there are more names than it has.
        """
        tick = np.ascontiguousarray(tick, np.int64)
        offset_s = np.ascontiguousarray(offset_s, np.float64)
        if tick.shape != offset_s.shape:
            raise ValueError(f"tick and offset must have the same shape, got {tick.shape} and {offset_s.shape}")
        out = np.empty((len(names), tick.size))
        query = Query(places(names), tick.reshape(-1), offset_s.reshape(-1), out)
        found = sample(*self.sampled, query)
        raise_failure()
        if not found:
            raise self._elsewhere(tick)
        return out.reshape(len(names), *tick.shape)

    def polynomials(
        self, names: tuple[str, ...], tick: NDArray[np.int64], start_s: NDArray[np.float64], end_s: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return some quantities of `SAMPLE` as polynomials of eight terms, one for each piece of time.

        The variable x of a polynomial is −1 at the start of its piece and 1 at the end. The values are in SI.
        `sampling.fit` describes the error, which is larger in a piece with a breakpoint (see `breakpoints`) inside.
        Times beyond the tick are not detected.

        Args:
            names: names of the quantities.
            tick: tick of each piece, shape (n,).
            start_s: start of each piece since the start of its tick [s], shape (n,).
            end_s: end of each piece since the start of its tick [s], shape (n,).

        Returns:
            The coefficients, constant first, shape (names, n, NODES).

        Raises:
            ValueError: a tick is not in this motion, the shapes differ, no quantity has such a name, or there are more
                names than `QUANTITIES`.
        """
        tick = np.ascontiguousarray(tick, np.int64)
        start_s, end_s = (np.ascontiguousarray(times, np.float64) for times in (start_s, end_s))
        if tick.ndim != 1 or not tick.shape == start_s.shape == end_s.shape:
            raise ValueError(
                f"tick, start and end must have one shape (n,), got {tick.shape}, {start_s.shape} and {end_s.shape}"
            )
        out = np.empty((len(names), len(tick), NODES))
        found = fit(self._model, self._trajectory, Spans(places(names), tick, start_s, end_s, out), self._sampling)
        raise_failure()
        if not found:
            raise self._elsewhere(tick)
        return out

    def cycles(self) -> NDArray[np.void]:
        """Return the complex amplitudes of both bases and the sphere's motion at the start of each tick, dtype `CYCLE`.

        There is one record per tick. The amplitude X [m] gives the part Im(X exp(jωt)) of a motion at the drive
        frequency, with t from the start of the tick.

        Raises:
            ValueError: a tick is not a single segment of the drive with one complete cycle; impacts do not matter.
        """
        turns = self.segments["duration"] * self.segments["omega"]
        if len(self.segments) >= len(self.first_segment) or np.abs(turns - TWO_PI).max(initial=0.0) > _WHOLE:
            raise ValueError(
                "cycles() needs a motion in which each tick is one drive segment with one complete cycle of the drive "
                "(impacts do not matter)"
            )
        out = np.empty((len(self.segments), CYCLE.itemsize // 8))
        follow_cycles(self._model, self._trajectory, self._sampling.flight, out)
        found: NDArray[np.void] = out.view(CYCLE)[:, 0]
        return found

    def _elsewhere(self, tick: NDArray[np.int64]) -> ValueError:
        return ValueError(
            f"this motion holds ticks {self.first_tick} to {self.last_tick}, got {tick.min()} to {tick.max()}"
        )

    def breakpoints(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return (tick, offset [s]) of the instants between which every quantity is smooth, in order; some are equal.

        The instants are the starts of drive segments, events, the steps of contacts, and two instants inside each
        tabulated contact. The end of the motion is not included.
        """
        most = TABULATED_PIECES * len(self._trajectory.history)
        tick, offset = np.empty(most, np.int64), np.empty(most)
        count = refine(self._trajectory, tick, offset)
        return tick[:count], offset[:count]


MOST_STATES = 200_000
"""Largest number of states, which begin flights and steps of contacts, in one drive segment. A segment with more ends
`Simulation.advance` with an error. The limit is checked only when the memory of the states is full; even a chattering
sphere needs only some ten states per segment.
"""

_FAILURES = {
    NEED_ROOM: f"more than {MOST_STATES} flights and steps of contacts in one drive segment",
    STUCK: "no progress in a drive segment",
    UNSOLVED: "no solution for a step of a contact in a drive segment",
}
_WHOLE = 1e-9  # largest error of the phase of a complete cycle [rad]
_STATES, _IMPACTS = 1 << 15, 1 << 11  # initial room: untouched pages take no memory
_NOTHING_FILLED, _NO_IMPACTS = np.zeros((), COUNTS), np.empty(0, IMPACT)
_GROWTH = 4  # factor by which the history grows when a call needs more room
_PLACES = {"left": -1.0, "centre": 0.0, "right": 1.0}


@attrs.frozen
class EnergyAccount:
    """Energies since the account began [J], each integrated independently; `imbalance` shows the integration error.

    The account begins again at a reset, with another configuration, at a pluck, and when the state is set.
    `Simulation.set_state` starts it again only if the simulation was created with `account`.

    Attributes:
        work: work of the drive (coil force, coil voltage or prescribed base).
        columns: loss in the columns' damping.
        shaker: loss in the suspension's damping and, with a voltage drive, in the coil's resistance.
        contact: loss in contacts.
        friction: loss by the guide's friction.
        stored: kinetic and potential energy, minus its value when the account began.
    """

    work: float
    columns: float
    shaker: float
    contact: float
    friction: float
    stored: float

    @property
    def imbalance(self) -> float:
        """Work minus losses minus stored energy [J]: the integration error.

        It has no meaning if the simulation was created without `account`.
        """
        return self.work - self.columns - self.shaker - self.contact - self.friction - self.stored


class Simulation:
    """Simulation of the rig's mechanics with exact flights and integrated contacts; deterministic, with bounded memory.

    Args:
        config: configuration of the rig.
        rtol: relative tolerance of each step of a contact.
        account: whether to compute the work of the drive and all losses (flights then cost about twice as much).
        model: the model of `config` if it is already built. It keeps its own tolerance; `rtol` applies to models that
            the simulation builds later.

    Attributes:
        tick: number of the next tick to simulate, counted since the reset. The drive segments of a tick give its
            duration.
        locked: whether `pluck` has locked the inferior base, which lasts until `reset`.
    """

    def __init__(
        self, config: MechanicsSetup, *, rtol: float = CONTACT_RTOL, account: bool = False, model: Model | None = None
    ) -> None:
        self._rtol = rtol
        self._account = account
        self._config = config
        self._work = new_workspace(_STATES, _IMPACTS)
        self._sampling = new_sampling_workspace()
        self._model, self.locked = model or build(config, rtol), False
        self.reset()

    @property
    def config(self) -> MechanicsSetup:
        """Configuration of the rig's mechanics that is simulated now."""
        return self._config

    @property
    def parameters(self) -> np.record:
        """Constants of the equations of motion that are used now, SI: one record of PARAMETERS."""
        record_: np.record = self._model.parameters[0]
        return record_

    @property
    def realised_restitution(self) -> float:
        """Restitution that the configured contact law really gives between two free bodies."""
        return contact_laws.from_config(self._config.contact).realised_restitution()

    def reset(self) -> None:
        """Set structure and shaker to rest at zero, the sphere to rest at `sphere.start`, and the tick to 0.

        `sphere.start` is the left wall, the right wall or the centre between the walls. The energy account begins
        again. The inferior base is released if `pluck` has locked it.
        """
        if self.locked:
            self._model, self.locked = build(self._config, self._rtol), False
        self._begin(np.zeros(STRUCTURE))
        self.tick = 0

    def configure(self, config: MechanicsSetup, model: Model | None = None) -> None:
        """Change the configuration: the structure keeps its motion, and the sphere is at rest at `sphere.start` again.

        If the kind of drive changes, the structure starts at rest at zero as well, unless the inferior base is locked.
        A base that `pluck` has locked stays locked. The energy account begins again, and the count of ticks continues.

        Args:
            config: the new configuration.
            model: the model of `config`, if it is already built; ignored while the base is locked.

        Raises:
            ConfigError: structure and shaker have no usable modes or no position of rest; nothing is changed.
        """
        y = self._structure()
        if self.locked:
            model = build(config, self._rtol, kind="prescribed")
        else:
            model = model or build(config, self._rtol)
            if model.systems[SPHERE_LOOSE].states != self._model.systems[SPHERE_LOOSE].states:  # another kind of drive
                y = np.zeros(STRUCTURE)
        self._config, self._model = config, model
        self._begin(y)

    def pluck(self, displacement_m: float) -> None:
        """Lock the inferior base at zero and release the superior base at rest from a displacement: a free decay.

        The sphere starts at rest at `sphere.start`, relative to the superior base. The inferior base stays locked until
        `reset`, and the drive has no effect. The count of ticks continues.
        """
        self._model = build(self._config, self._rtol, kind="prescribed")
        self.locked = True
        y = np.zeros(STRUCTURE)
        y[X1] = displacement_m
        self._begin(y)

    def place(
        self,
        x_1: float = 0.0,
        v_1: float = 0.0,
        d: float = 0.0,
        d_rate: float = 0.0,
        x_b: float = 0.0,
        v_b: float = 0.0,
    ) -> None:
        """Set the state (SI): motion of superior base, sphere relative to it (d = x_2 − x_1), and inferior base.

        x_b and v_b have no effect on the motion if the inferior base is prescribed. The coil current is set to zero,
        and the energy account begins again. d is not checked against the walls.
        """
        y = np.zeros(STRUCTURE)
        y[X1], y[V1], y[XB], y[VB] = x_1, v_1, x_b, v_b
        self._begin(y)
        self._put_sphere(d, d_rate)
        self._stored = self.stored_energy()

    def state(self) -> NDArray[np.float64] | None:
        """Return the present state, SI, shape (7,), or None during a contact.

        The numbers are x_1, v_1, x_b, v_b, the coil's current, x_2 − x_1 and the rate of x_2 − x_1. A wall's residual
        indentation is not included. During a contact these numbers do not determine the state, because the contact
        force also depends on how the contact began.
        """
        s = self._work.states[0]
        if s["phase"] == CONTACT:
            return None
        return np.array([*s["y"].tolist(), float(s["d"]), float(s["d_rate"])])

    def set_state(self, state: NDArray[np.float64]) -> None:
        """Set the seven numbers of motion and current that `state` returns; the next `advance` continues from them.

        A sphere that is on a wall and at rest relative to it stays attached to the wall until the wall moves away from
        it. With friction of the guide, a sphere at rest between the walls is attached as well, until it slips. The
        energy account begins again if this simulation was created with `account`.
        """
        *y, d, rate = state.tolist()
        self._work.states[0] = np.zeros((), STATE)
        s = self._work.states[0]
        s["y"][:], s["d"], s["d_rate"] = y, d, rate
        p = self._model.parameters[0]
        if p["sphere_present"]:
            if rate == 0.0 and (p["friction_acceleration"] > 0.0 or abs(d) >= p["half_gap"]):
                s["phase"], s["side"] = ATTACHED, np.sign(d) if abs(d) >= p["half_gap"] else 0.0
            elif p["friction_acceleration"] > 0.0:
                s["slide"] = np.sign(rate)
        if self._account:
            self._work.ledger[0] = np.zeros((), LEDGER)
            self._stored = self.stored_energy()

    def advance(self, segments: NDArray[np.void]) -> Motion:
        """Simulate the drive segments (dtype `flight.SEGMENT`) from the present state on; return their motion.

        The first segment must begin a tick.

        Raises:
            SimulationError: the motion makes no progress, a step of a contact cannot be solved, the contact law raised
                an exception, or a segment needs more than `MOST_STATES` states. To continue, set the state again, for
                example by `reset`.
        """
        segments = np.ascontiguousarray(segments, SEGMENT)
        if self.locked:
            segments = segments.copy()
            segments["amplitude"] = segments["growth"] = 0.0
        segments = for_kernels(segments)
        rows = len(segments) + 1
        work = Workspace(*self._work[:-2], np.empty(rows, np.int64), np.empty(rows, np.int64))
        work.counts[0] = _NOTHING_FILLED
        index = 0
        while True:
            ended, index = run(self._model, segments, self.tick, index, work, self._account)
            raise_failure()
            ((states, impacts, _, ticks),) = work.counts.tolist()
            if ended == DONE:
                break
            if ended != NEED_ROOM or states - work.first_state[index] > MOST_STATES:
                s = work.states[0]
                raise SimulationError(
                    f"the motion cannot be simulated: {_FAILURES[ended]}, in phase {PHASES[s['phase']]}, tick "
                    f"{self.tick + ticks - 1} (of {COMMAND_GRID_S:g} s each), {s['t']:.9f} s after the start of a "
                    "drive segment in this tick; change the mechanics or the drive"
                )
            more = {"history": _longer(work.history, STATE), "impacts": _longer(work.impacts, IMPACT)}
            work = self._work = work._replace(**more)
        kept = work.history[: states + 1]  # including the state from which the next motion begins
        if len(work.history) > _STATES:  # a grown history is handed over: copying it takes a tenth of the motion's time
            self._work = work._replace(history=room(_STATES, STATE))
        else:
            kept = joined([kept])  # a copy by bytes: NumPy copies records field by field
        hits = joined([work.impacts[:impacts]]) if impacts else _NO_IMPACTS
        trajectory = Trajectory(segments, self.tick, work.first_segment[: ticks + 1], kept, work.first_state)
        self.tick += ticks
        return Motion(self._model, trajectory, hits, self._sampling)

    def copy(self) -> Simulation:
        """Return an independent copy of the simulation in its present state.

        Both share scratch memory, so two threads must not advance them, or evaluate their motions, at the same time.
        """
        twin = copy.copy(self)
        twin._work = self._work._replace(states=joined([self._work.states]), ledger=joined([self._work.ledger]))
        return twin

    def energy(self) -> EnergyAccount:
        """Return the energies since the account began [J].

        If this simulation was created without `account`, the work and the losses outside the contacts are zero, and
        `imbalance` has no meaning.
        """
        ledger = self._work.ledger[0]
        work, columns, shaker, contact, friction = (float(ledger[name]) for name in LEDGER.names or ())
        return EnergyAccount(work, columns, shaker, contact, friction, self.stored_energy() - self._stored)

    def stored_energy(self) -> float:
        """Return the kinetic and potential energy of the rig in its present state [J].

        It includes the energy of the indentation during a contact and, with a voltage drive, the energy of the coil's
        field. The inferior base and its suspension count only if the base is not prescribed.
        """
        p, s, y = self._model.parameters[0], self._state, self._structure()
        stretch = y[X1] - y[XB]
        total = 0.5 * p.m_1 * y[V1] * y[V1] + 0.5 * p.k_1 * stretch * stretch
        if p.drive_kind != PRESCRIBED:
            total += 0.5 * p.m_base * y[VB] * y[VB] + 0.5 * p.k_f * y[XB] * y[XB]
            total += 0.5 * y[COIL] * y[COIL] / p.per_inductance
        if p.sphere_present:
            pressed = s.phase == CONTACT
            speed = y[V1] + (s.side * s.speed if pressed else s.d_rate)
            total += 0.5 * p.m * speed * speed
            if pressed:
                step = with_fields(self._work.step)[0]
                total += force_at(p, self._model.law, s.per_v0, turned_at(s), s.w, s.speed, step)[2]
        return float(total)

    @property
    def _state(self) -> np.record:
        """Current state, a record with fields as attributes."""
        record_: np.record = with_fields(self._work.states)[0]
        return record_

    def _begin(self, y: NDArray[np.float64]) -> None:
        for rows in (self._work.states, self._work.step, self._work.ledger):
            rows.view(np.uint8)[:] = 0  # as bytes: NumPy fills records field by field
        self._work.states[0]["y"][:] = y
        self._put_sphere(_PLACES[self._config.sphere.start] * self._model.parameters[0].half_gap, 0.0)
        self._stored = self.stored_energy() if y.any() else 0.0  # the sphere is at rest

    def _put_sphere(self, d: float, d_rate: float) -> None:
        """Set the sphere to d = x_2 − x_1 [m], unchecked, with the rate d_rate [m/s] relative to the superior base.

        If the guide has friction, a sphere at rest is held and a sliding one is braked.
        """
        p, s = self._model.parameters[0], self._work.states[0]
        s["phase"], s["side"], s["slide"], s["d"], s["d_rate"] = FREE, 0.0, 0.0, d, d_rate
        if p["friction_acceleration"] > 0.0 and p["sphere_present"]:
            s["phase"] = FREE if d_rate else ATTACHED
            s["slide"] = np.sign(d_rate)

    def _structure(self) -> NDArray[np.float64]:
        """Return the structural state y = (x_1, v_1, x_b, v_b, i) in any phase, SI, shape (STRUCTURE,)."""
        p, s = self._model.parameters[0], self._state
        y: NDArray[np.float64] = s.y.copy()
        if s.phase == CONTACT:
            y[X1] -= p.share * s.side * s.w * s.w
            y[V1] -= p.share * s.side * s.speed
        return y


def _longer(rows: Any, kind: np.dtype[np.void]) -> Any:
    """Return a copy of records with room for four times as many; the additional records are not initialised."""
    grown = room(_GROWTH * len(rows), kind)
    grown.view(np.uint8)[: rows.nbytes] = rows.view(np.uint8)
    return grown
