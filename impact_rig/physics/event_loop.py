"""The event loop: fly, collide, ride, leave — segment by segment of the drive.

Each verb is a file. Every segment starts from its own time zero, and the loop always stops at its end, so nothing
depends on how a run was cut.
"""

from __future__ import annotations

import math
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
    begin,
    collide,
    grip,
)
from impact_rig.physics.contact.base import ForceKind
from impact_rig.physics.flight import STOPPED, aim, carry, flight_energy, fly, rounding, wall
from impact_rig.physics.forcing import Forcing, transfer
from impact_rig.physics.linear import V1, X1
from impact_rig.physics.series import WIDTH, Series, new_series
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
    GRIP,
    IMPULSE,
    LEDGER_CONTACT,
    LOST,
    PEAK_FORCE,
    PEAK_INDENTATION,
    PHASE,
    RATE,
    RIDING,
    SIDE,
    SLID,
    STEP,
    T,
    Y,
    add_knot,
)

DONE, NEED_ROOM, STUCK = range(3)
"""How `run` ends: all segments done; call again with more room in the log; no progress."""

_SPEED_RESOLUTION = 2.0**-48
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
    change: NDArray[np.float64]
    series: Series


def new_work(n: int) -> Work:
    """Return scratch arrays for n structural states."""
    stages = riding.STAGES
    modal = [np.zeros(n, complex) for _ in range(5)]
    states = [np.zeros(5), np.zeros(WIDTH), np.zeros(WIDTH)]
    tables = [np.zeros((stages, width)) for width in (4, WIDTH, WIDTH)]
    per_stage = [np.zeros(stages) for _ in range(6)]
    newton = [np.zeros((stages, stages)), np.zeros(stages), np.zeros(stages)]
    return Work(*modal, np.zeros(3), *states, *tables, *per_stage, *newton, new_series())  # type: ignore[call-arg, arg-type]  # in the order of the fields


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _touch(p, s, side, segment):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Begin a contact with the wall just reached: from (x_1, v_1, d, d') to the pair's centre of mass and (w, δ')."""
    speed = max(side * s[RATE], p.touch_speed)
    s[SIDE] = side
    s[Y + X1] += p.share * s[GAP]
    s[Y + V1] += p.share * s[RATE]  # not `speed`: the least speed must not change the pair's momentum
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


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _fly_on(p, s, d, rate):  # type: ignore[no-untyped-def]
    """Set a flight that starts at d with the relative speed d'; guide friction works against it from the start."""
    s[PHASE] = FREE
    s[GAP] = d
    s[RATE] = rate
    s[SIDE] = np.sign(rate) if p.friction > 0.0 else 0.0
    s[STEP] = 0.0
    s[SLID] = d


@njit(cache=True, nogil=True, error_model="numpy")
def _least_speed(p, s):  # type: ignore[no-untyped-def]
    """Return the least relative speed [m/s] that the rounding of the structure's speed leaves standing."""
    return max(p.touch_speed, _SPEED_RESOLUTION * abs(s[Y + V1]))


@njit(cache=True, nogil=True, error_model="numpy")
def _part(p, s, way):  # type: ignore[no-untyped-def]
    """Let a sphere at rest on the base begin to slide: with the least speed, and nothing added to the momentum."""
    rate = way * _least_speed(p, s)
    s[Y + V1] -= p.share * rate
    _fly_on(p, s, s[GAP], rate)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _note(log, segment, offset, side, approach, separation, force, indentation, impulse, duration, lost):  # type: ignore[no-untyped-def]
    """Append an impact."""
    row = log.impacts[log.filled[1]]
    row[0], row[1], row[2], row[3], row[4] = segment, offset, side, approach, separation
    row[5], row[6], row[7], row[8], row[9] = force, indentation, impulse, duration, lost
    log.filled[1] += 1


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _leave(p, s, log):  # type: ignore[no-untyped-def]
    """End a contact: note the impact and return to (x_1, v_1, d, d')."""
    side, speed = s[SIDE], s[RATE]
    _note(
        log, s[BEGIN_SEGMENT], s[BEGIN_OFFSET], side, s[APPROACH], -speed,
        s[PEAK_FORCE], s[PEAK_INDENTATION], s[IMPULSE], s[ELAPSED], s[LOST]
    )  # fmt: skip
    s[Y + X1] -= p.share * side * p.half_gap
    s[Y + V1] -= p.share * side * speed
    _fly_on(p, s, side * p.half_gap, side * speed)


@njit(cache=True, nogil=True, error_model="numpy")
def _bounce(p, s, side, segment, acceleration, noise, log, ledger):  # type: ignore[no-untyped-def]
    """Reverse the relative speed at once, or let a sphere ride that no longer bounces off a pressing wall.

    A bounce lower than the `noise` [m] of the positions would be thrown up again by their rounding, for ever.
    """
    speed = max(0.0, side * s[RATE])
    e = p.force.restitution
    least = max(p.touch_speed, math.sqrt(2.0 * abs(acceleration) * noise))
    rides = e * speed <= least and side * acceleration <= 0.0
    if rides:
        e = 0.0
    lost = 0.5 * p.m_eff * speed * speed * (1.0 - e * e)
    ledger[LEDGER_CONTACT] += lost
    away = 0.0 if rides else max(e * speed, _least_speed(p, s))
    s[Y + V1] += p.share * side * (speed + away)
    if speed > p.touch_speed:
        _note(log, segment, s[T], side, speed, e * speed, 0.0, 0.0, p.m_eff * speed * (1.0 + e), 0.0, lost)
    if rides:
        s[PHASE], s[SIDE], s[GAP], s[RATE] = ATTACHED, side, side * p.half_gap, 0.0
    else:
        _fly_on(p, s, side * p.half_gap, -side * away)


@njit(cache=True, nogil=True, error_model="numpy", forceinline=True)
def _free_phase(p, system, f, work, s, t_end, segment, log, ledger, account):  # type: ignore[no-untyped-def]
    """Fly, and begin whatever the flight ends in."""
    add_knot(log, s)
    begin_t, push = s[T], s[SIDE] * p.m * p.friction
    s[SLID] = s[GAP]
    touched = fly(p, system, f, work, s, t_end)
    if account:
        flight_energy(p, system, f, work, push, begin_t, s[T], s, ledger)
    if touched == 0:
        return
    _, _, acceleration, _ = wall(system, f, work, push, s[T] - begin_t, s[T], 0)
    acceleration = (p.c.m_1 * acceleration - push) * p.per_m_pair  # of both together, were they held
    if touched == STOPPED:
        if abs(acceleration) <= p.friction:
            s[Y + V1] += p.share * s[RATE]
            s[PHASE], s[SIDE], s[RATE] = ATTACHED, 0.0, 0.0
        else:
            _part(p, s, -np.sign(acceleration))
    elif p.force.kind == _IMPULSIVE:
        _bounce(p, s, touched, segment, acceleration, rounding(p, system, work, s[T]), log, ledger)
    else:
        _touch(p, s, touched, segment)


@njit(cache=True, nogil=True, error_model="numpy")
def _attached_phase(p, system, f, work, s, t_end, log, ledger, account):  # type: ignore[no-untyped-def]
    """Move as one body until sphere and base part."""
    add_knot(log, s)
    begin_t = s[T]
    parted = carry(p, system, f, work, s, t_end)
    if account:
        flight_energy(p, system, f, work, 0.0, begin_t, s[T], s, ledger)
    if parted != 0.0:
        _part(p, s, parted)


@njit(cache=True, nogil=True, error_model="numpy")
def run(model, segments, first, base, s, work, log, ledger, account):  # type: ignore[no-untyped-def]
    """Advance s through `segments[first:]`, numbered from `base`; return (how it ended, the segment it is in).

    Knots, impacts and energies go to `log` and `ledger`; flights are accounted for only if `account`, because it
    costs as much as flying.
    """
    p = model.p
    omega, aimed = -1.0, -1
    for index in range(first, segments.shape[0]):
        row = segments[index]
        f = Forcing(row["omega"], row["phase"], row["amplitude"], row["slope"])
        t_end = row["duration"]
        if s[T] == 0.0:
            log.first[index] = log.filled[0]
        fresh = True
        for _ in range(_EVENTS_PER_SEGMENT):
            if log.filled[0] + _ROOM > log.knots.shape[0] or log.filled[1] + 2 > log.impacts.shape[0]:
                return NEED_ROOM, index
            phase = s[PHASE]
            if phase in (FREE, ATTACHED):
                attached = 1 if phase == ATTACHED else 0
                system = model.attached if attached else model.loose
                if attached != aimed or f.omega != omega:
                    transfer(system, f.omega, work.answer, work.drift)
                    omega, aimed, fresh = f.omega, attached, True
                if fresh:
                    aim(f, work, t_end)
                    fresh = False
                if attached:
                    _attached_phase(p, system, f, work, s, t_end, log, ledger, account)
                else:
                    _free_phase(p, system, f, work, s, t_end, base + index, log, ledger, account)
            elif phase == COLLISION:
                ended = collide(p, f, work.series, work.at, s, t_end, log, ledger, account)
                if ended == LEFT_WALL:
                    _leave(p, s, log)
                elif ended == STIFF:
                    s[PHASE] = RIDING
                    s[GAP] *= s[GAP]  # riding counts in δ
                elif ended == FAILED:
                    return STUCK, index
            else:
                ended = riding.ride(p, f, work, s, t_end, log, ledger)
                if ended == NOT_STIFF:
                    s[PHASE] = COLLISION
                    s[GAP] = np.sqrt(s[GAP])
                    s[GRIP] = grip(p, s)
                elif ended == FAILED:
                    return STUCK, index
            if s[T] >= t_end:
                break
        else:
            return STUCK, index
        s[T] = 0.0
    return DONE, segments.shape[0]
