"""`Simulation`: the rig's mechanics as one object that advances by drive segments."""

from __future__ import annotations

import copy

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.config import RigConfig
from impact_rig.errors import SimulationError
from impact_rig.physics import contact as contact_laws
from impact_rig.physics.event_loop import NEED_ROOM, STUCK, new_work, run
from impact_rig.physics.forcing import Forcing, drive
from impact_rig.physics.linear import V1, VB, X1, XB
from impact_rig.physics.model import CONTACT_RTOL, PRESCRIBED, Parameters, build
from impact_rig.physics.motion import IMPACT, Motion
from impact_rig.physics.state import (
    ATTACHED,
    COLLISION,
    FREE,
    GAP,
    IMPACT_COLUMNS,
    KNOT,
    LEDGER,
    PHASE,
    RATE,
    RIDING,
    SIDE,
    STATE,
    Log,
    T,
    Y,
)

MOST_KNOTS = 200_000
"""Contacts, rides and flights in one drive segment (10 ms); a chattering sphere makes some ten of them."""

_GROWTH = 4  # of the log, when a call needs more room
_PLACES = {"left": -1.0, "centre": 0.0, "right": 1.0}


@attrs.frozen
class EnergyAccount:
    """Energies since the reset [J]: each term integrated on its own, so that `imbalance` measures the integration.

    work: done by the drive (coil force, coil voltage or prescribed base);
    columns, shaker, contact, friction: lost there;
    stored: kinetic and potential, less what was stored at the reset.
    """

    work: float
    columns: float
    shaker: float
    contact: float
    friction: float
    stored: float

    @property
    def imbalance(self) -> float:
        """Return work − losses − stored: zero but for integration errors."""
        return self.work - self.columns - self.shaker - self.contact - self.friction - self.stored


class Simulation:
    """Exact flights and integrated contacts of the configured rig; pure, deterministic, bounded memory.

    Args:
        config: the rig.
        rtol: relative tolerance of the contact integrators, per step.
        account: whether to keep the energy account (flights then cost about twice as much).

    Attributes:
        segment: number of the next drive segment, counted since the reset.
    """

    def __init__(self, config: RigConfig, *, rtol: float = CONTACT_RTOL, account: bool = False) -> None:
        self._rtol = rtol
        self._account = account
        self._config = config
        self._log = _room(1 << 15, 1 << 11)  # pages that are not touched take no memory
        self.reset()

    @property
    def config(self) -> RigConfig:
        """The configuration in force."""
        return self._config

    @property
    def parameters(self) -> Parameters:
        """The numbers of the equations of motion in force, SI."""
        return self._model.p

    @property
    def realised_restitution(self) -> float:
        """The restitution that the configured contact law really returns."""
        return contact_laws.from_config(self._config.contact).realised_restitution()

    def reset(self) -> None:
        """Put everything to rest at zero, the sphere at its start, and free a locked base."""
        self._model = build(self._config, self._rtol)
        self.locked = False
        self._begin(np.zeros(5))
        self.segment = 0

    def configure(self, config: RigConfig) -> None:
        """Go on with another configuration: the structure keeps its motion, the sphere rests at its start again."""
        y = self._structure()
        self._config = config
        kind_changed = len(build(config, self._rtol).loose.b0) != len(self._model.loose.b0)
        if not self.locked:
            self._model = build(config, self._rtol)
        if kind_changed and not self.locked:
            y = np.zeros(5)
        self._begin(y)

    def pluck(self, displacement_m: float) -> None:
        """Lock the base and release the superior base at rest from a displacement: a free decay, until `reset`."""
        locked = attrs.evolve(self._config, drive=attrs.evolve(self._config.drive, kind="prescribed"))
        self._model = build(locked, self._rtol)
        self.locked = True
        y = np.zeros(5)
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
        """Set the state by hand: superior base, sphere relative to it (d = x_2 − x_1), base of a free shaker."""
        y = np.zeros(5)
        y[X1], y[V1], y[XB], y[VB] = x_1, v_1, x_b, v_b
        self._begin(y)
        self._put_sphere(d, d_rate)
        self._stored = self.stored_energy()

    def advance(self, segments: NDArray[np.void]) -> Motion:
        """Simulate the drive segments (dtype `forcing.SEGMENT`) and return their motion.

        Raises:
            SimulationError: the integration makes no progress, or needs more than `MOST_KNOTS` steps in a segment.
        """
        segments = np.ascontiguousarray(segments)
        if self.locked:
            segments = segments.copy()
            segments["amplitude"] = segments["slope"] = 0.0
        log = self._log
        log.filled[:] = 0
        log = log._replace(first=np.zeros(len(segments) + 1, np.int64))
        index = 0
        while True:
            ended, index = run(
                self._model, segments, index, self.segment, self._state, self._work, log, self._ledger, self._account
            )
            if ended == STUCK:
                raise SimulationError(
                    f"no progress in drive segment {self.segment + index} at {self._state[T]:.9f} s of it, "
                    f"phase {int(self._state[PHASE])}"
                )
            if ended != NEED_ROOM:
                break
            if log.filled[0] - log.first[index] > MOST_KNOTS:
                raise SimulationError(
                    f"more than {MOST_KNOTS} contacts, rides and flights in drive segment {self.segment + index}, "
                    f"at {self._state[T]:.9f} s of it: the motion cannot be resolved"
                )
            log = _grown(log)
        self._log = log
        if self._model.p.drive == PRESCRIBED and len(segments):  # not integrated, but the columns' energy depends on it
            last = segments[-1]
            f = Forcing(last["omega"], last["phase"], last["amplitude"], last["slope"])
            self._state[Y + XB], self._state[Y + VB] = drive(f, last["duration"])
        knots, impacts = int(log.filled[0]), int(log.filled[1])
        log.first[-1] = knots
        rows = np.zeros(impacts, IMPACT)
        for column, name in enumerate(IMPACT_COLUMNS):
            rows[name] = log.impacts[:impacts, column]
        motion = Motion(self._model, self.segment, segments, log.knots[:knots].copy(), log.first, rows)
        self.segment += len(segments)
        return motion

    def copy(self) -> Simulation:
        """Return a simulation that goes on from here on its own; scratch memory is shared, so advance them in turn."""
        twin = copy.copy(self)
        twin._state, twin._ledger = self._state.copy(), self._ledger.copy()
        return twin

    def energy(self) -> EnergyAccount:
        """Return the energy account since the reset; only the contacts' share is kept unless `account` is on."""
        work, columns, shaker, contact, friction = (float(term) for term in self._ledger)
        return EnergyAccount(work, columns, shaker, contact, friction, self.stored_energy() - self._stored)

    def stored_energy(self) -> float:
        """Return kinetic plus potential energy [J], at the end of the last segment."""
        p, s = self._model.p, self._state
        y = self._structure()
        x_b, v_b = y[XB], y[VB]
        total = 0.5 * p.c.m_1 * y[V1] ** 2 + 0.5 * p.c.k_1 * (y[X1] - x_b) ** 2
        if len(self._model.loose.b0) > 2:
            total += 0.5 * p.c.m_base * v_b**2 + 0.5 * p.c.k_f * x_b**2
        if len(self._model.loose.b0) > 4:
            total += 0.5 * p.c.inductance * y[4] ** 2
        if p.sphere_present:
            pressed = s[PHASE] in (COLLISION, RIDING)
            rate = s[SIDE] * s[RATE] if pressed else s[RATE]
            total += 0.5 * p.m * (y[V1] + rate) ** 2
            if pressed:
                depth = s[GAP] if s[PHASE] == RIDING else s[GAP] ** 2
                linear = p.force.kind == int(contact_laws.ForceKind.LINEAR)
                total += p.force.stiffness * (0.5 * depth**2 if linear else 0.4 * depth**2.5)
        return float(total)

    def _begin(self, y: NDArray[np.float64]) -> None:
        self._state = np.zeros(STATE)
        self._state[Y : Y + 5] = y
        self._put_sphere(_PLACES[self._config.sphere.start] * self._model.p.half_gap, 0.0)
        self._work = new_work(len(self._model.loose.b0))
        self._ledger = np.zeros(LEDGER)
        self._stored = self.stored_energy()

    def _put_sphere(self, d: float, d_rate: float) -> None:
        """Set the sphere; where the guide has friction, one at rest is held and a sliding one braked."""
        s = self._state
        s[PHASE], s[SIDE], s[GAP], s[RATE] = FREE, 0.0, d, d_rate
        if self._model.p.friction > 0.0 and self._model.p.sphere_present:
            s[PHASE] = FREE if d_rate else ATTACHED
            s[SIDE] = np.sign(d_rate)

    def _structure(self) -> NDArray[np.float64]:
        """Return y = (x_1, v_1, x_b, v_b, i) whatever the phase."""
        p, s = self._model.p, self._state
        y = s[Y : Y + 5].copy()
        if s[PHASE] in (COLLISION, RIDING):
            depth = s[GAP] if s[PHASE] == RIDING else s[GAP] ** 2
            y[X1] -= p.share * s[SIDE] * (p.half_gap + depth)
            y[V1] -= p.share * s[SIDE] * s[RATE]
        return y


def _room(knots: int, impacts: int) -> Log:
    return Log(
        np.zeros((knots, KNOT)), np.zeros((impacts, len(IMPACT_COLUMNS))), np.zeros(2, np.int64), np.zeros(1, np.int64)
    )


def _grown(log: Log) -> Log:
    knots = np.zeros((_GROWTH * len(log.knots), KNOT))
    knots[: len(log.knots)] = log.knots
    impacts = np.zeros((_GROWTH * len(log.impacts), len(IMPACT_COLUMNS)))
    impacts[: len(log.impacts)] = log.impacts
    return log._replace(knots=knots, impacts=impacts)
