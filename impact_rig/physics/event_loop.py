"""The event loop: fly, collide, ride, leave — segment by segment of the drive.

Each verb is a file. Every segment starts from its own time zero, and the loop always stops at its end, so nothing depends on how a run was cut.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from impact_rig.physics import riding
from impact_rig.physics.collision import (
    FAILED,
    LEFT_WALL,
    NOT_STIFF,
    STIFF,
    WIDTH,
    Series,
    begin,
    collide,
    new_series,
)
from impact_rig.physics.contact.base import ForceKind
from impact_rig.physics.flight import bound_drive_jerk, flight_energy, fly
from impact_rig.physics.forcing import Forcing, particular, transfer
from impact_rig.physics.linear import V1, X1
from impact_rig.physics.state import (
    APPROACH,
    ATTACHED,
    BEGIN_OFFSET,
    BEGIN_SEGMENT,
    BETA,
    COLLISION,
    ELAPSED,
    FREE,
    GAP,
    IMPULSE,
    LOST,
    NEXT_STEP,
    PEAK_FORCE,
    PEAK_INDENTATION,
    PHASE,
    RATE,
    RIDING,
    SIDE,
    STEP,
    T,
    Y,
    add_knot,
)

DONE, NEED_ROOM, STUCK = range(3)
"""How `run` ends: all segments done; call again with more room in the log; no progress."""

_ROOM = 1000  # more knots than one phase call leaves
_EVENTS_PER_SEGMENT = 10_000_000
_HERTZIAN = int(ForceKind.HERTZIAN)
_IMPULSIVE = int(ForceKind.IMPULSIVE)


class Work(NamedTuple):
    """Scratch arrays of the compiled functions."""

    steady: NDArray[np.complex128]
    growing: NDArray[np.complex128]
    answer: NDArray[np.complex128]
    drift: NDArray[np.complex128]
    modal: NDArray[np.complex128]
    jerk: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    at: NDArray[np.float64]
    powers: NDArray[np.float64]
    stage: NDArray[np.float64]
    slope: NDArray[np.float64]
    speed: NDArray[np.float64]
    depth: NDArray[np.float64]
    u: NDArray[np.float64]
    du: NDArray[np.float64]
    stiff: NDArray[np.float64]
    damp: NDArray[np.float64]
    matrix: NDArray[np.float64]
    right: NDArray[np.float64]
    series: Series


def new_work(n: int) -> Work:
    """Return scratch arrays for n structural states."""
    s = riding.STAGES
    return Work(
        *(np.zeros(n, complex) for _ in range(5)),
        jerk=np.zeros(1),
        y=np.zeros(5),
        z=np.zeros(WIDTH),
        at=np.zeros(WIDTH),
        powers=np.zeros((s, 4)),
        stage=np.zeros((s, WIDTH)),
        slope=np.zeros((s, WIDTH)),
        **{name: np.zeros(s) for name in ("speed", "depth", "u", "du", "stiff", "damp")},
        matrix=np.zeros((s, s)),
        right=np.zeros(s),
        series=new_series(),
    )


@njit(cache=True, nogil=True)
def _touch(p, s, wall, segment):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Begin a contact with the wall just reached: from (x_1, v_1, d, d') to the pair's centre of mass and (w, δ')."""
    speed = max(wall * s[RATE], p.touch_speed)
    s[SIDE] = wall
    s[Y + X1] += p.share * s[GAP]
    s[Y + V1] += p.share * wall * speed
    s[PHASE] = COLLISION
    s[GAP] = 0.0
    s[RATE] = speed
    s[BETA] = p.force.damping / max(speed, p.speed_floor) if p.force.kind == _HERTZIAN else 0.0
    s[APPROACH] = speed
    s[BEGIN_SEGMENT] = segment
    s[BEGIN_OFFSET] = s[T]
    s[PEAK_FORCE] = 0.0
    s[PEAK_INDENTATION] = 0.0
    s[IMPULSE] = 0.0
    s[LOST] = 0.0
    s[ELAPSED] = 0.0
    begin(p, speed, s)


@njit(cache=True, nogil=True)
def _leave(p, s, log):  # type: ignore[no-untyped-def]
    """End a contact: note the impact and return to (x_1, v_1, d, d')."""
    side, speed = s[SIDE], s[RATE]
    row = log.impacts[log.count[1]]
    row[0], row[1], row[2] = s[BEGIN_SEGMENT], s[BEGIN_OFFSET], side
    row[3], row[4] = s[APPROACH], -speed
    row[5], row[6] = s[PEAK_FORCE], s[PEAK_INDENTATION]
    row[7], row[8], row[9] = s[IMPULSE], s[ELAPSED], s[LOST]
    log.count[1] += 1
    s[Y + X1] -= p.share * side * p.half_gap
    s[Y + V1] -= p.share * side * speed
    s[PHASE] = FREE
    s[GAP] = side * p.half_gap
    s[RATE] = side * speed
    s[SIDE] = 0.0
    s[STEP] = 0.0


@njit(cache=True, nogil=True)
def run(model, segments, first, base, s, work, log, ledger, account):  # type: ignore[no-untyped-def]
    """Advance s through `segments[first:]`, numbered from `base`; return (how it ended, the segment it is in).

    Knots, impacts and energies go to `log` and `ledger`; flights are accounted for only if `account`, because it costs as much as flying.
    """
    omega = -1.0
    for index in range(first, segments.shape[0]):
        row = segments[index]
        f = Forcing(row["omega"], row["phase"], row["amplitude"], row["slope"])
        t_end = row["duration"]
        if f.omega != omega:
            omega = f.omega
            transfer(model.loose, omega, work.answer, work.drift)
        particular(f, work.answer, work.drift, work.steady, work.growing)
        bound_drive_jerk(f, work, t_end)
        if s[T] == 0.0:
            log.first[index] = log.count[0]
        for _ in range(_EVENTS_PER_SEGMENT):
            if log.count[0] + _ROOM > log.knots.shape[0] or log.count[1] + 2 > log.impacts.shape[0]:
                return NEED_ROOM, index
            phase = s[PHASE]
            if phase == FREE:
                add_knot(log, s)
                begin = s[T]
                touched = fly(model, f, work, s, t_end)
                if account:
                    flight_energy(model, f, work, begin, s[T], ledger)
                if touched != 0:
                    _touch(model.p, s, touched, base + index)
            elif phase == COLLISION:
                ended = collide(model.p, f, work.series, work.at, s, t_end, log, ledger, account)
                if ended == LEFT_WALL:
                    _leave(model.p, s, log)
                elif ended == STIFF:
                    s[PHASE] = RIDING
                    s[GAP] *= s[GAP]  # riding counts in δ
                elif ended == FAILED:
                    return STUCK, index
            elif phase == RIDING:
                ended = riding.ride(model.p, f, work, s, t_end, log, ledger)
                if ended == NOT_STIFF:
                    s[PHASE] = COLLISION
                    s[GAP] = np.sqrt(s[GAP])
                elif ended == FAILED:
                    return STUCK, index
            if s[T] >= t_end:
                break
        else:
            return STUCK, index
        s[T] = 0.0
    return DONE, segments.shape[0]
