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
"""Event loop of the simulation: flights, contacts and their transitions, segment by segment of the drive.

Each phase of the motion lasts until an event, or until it is PAUSED and entered again: at the end of a segment, and in
a contact also after very many steps.

    phase      event           what then happens                                    next phase
    FREE       TOUCHED         a contact begins (`_touch`)                          CONTACT
                               off a rigid wall: the speed reverses (`_bounce`)     FREE; slow and pressed: ATTACHED
    FREE       STOPPED         friction holds both as one (`_hold`) or cannot       ATTACHED, or FREE (`_part`)
    CONTACT    SEPARATED       the sphere flies on from there (`_leave`)            FREE
               or RELEASED
    CONTACT    SETTLED         a law with a memory only rings (`settles`; `_leave`) ATTACHED
    ATTACHED   PARTED          the structure pulls away, or friction yields         FREE
                               (`_part`)

A sphere that rests on a wall under any other law that yields stays in CONTACT until it is lifted off: SEPARATED or
RELEASED. A rig begins FREE, or ATTACHED if its sphere is at rest and the guide has friction or `set_state` puts it at
rest on a wall. A call of `run` can start in any phase. A contact whose outcome is tabulated ends SEPARATED. TURNED and
RELOADED end a step of a contact, not the contact. `_change_phase` implements this table. Every segment has its own time
zero, and every phase stops at the segment's end, so nothing depends on the number of calls that a motion takes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.kernels import INTEGERS, Fields, Record, Records, entry, kernel, records, room
from impact_rig.physics.contact_phase import (
    account_step,
    conclude,
    dissipated,
    find_peaks,
    settles,
    t_0_of,
    take_next_step,
)
from impact_rig.physics.contact_step import drop_dense_output, expand, force_at, turned_at
from impact_rig.physics.energy import account_flight
from impact_rig.physics.flight import (
    SEGMENT,
    DriveSegment,
    choose_system,
    drive,
    drive_segment,
    evaluate,
    fly,
    fly_attached,
    guide_friction,
    prepare_segment,
    rounding,
)
from impact_rig.physics.model import MODEL, Model
from impact_rig.physics.outcome import apply_outcome, look_up
from impact_rig.physics.state import (
    ATTACHED,
    CONTACT,
    CONTACT_STEP,
    COUNTS,
    FAILED,
    FLIGHT,
    FREE,
    IMPACT,
    LEDGER,
    NOTHING,
    PAUSED,
    PRESCRIBED,
    RELEASED,
    SEPARATED,
    SETTLED,
    SPHERE_LOOSE,
    STATE,
    TOUCHED,
    TURNED,
    V1,
    VB,
    X1,
    XB,
)

DONE, NEED_ROOM, STUCK, UNSOLVED = range(4)
"""Results of `run`. DONE: all segments are simulated. NEED_ROOM: call again with more room for the history or the
impacts. STUCK: ten million events did not reach the end of a segment. UNSOLVED: a step of a contact has no solution.
"""

_SPEED_RESOLUTION = 2.0**-48
_STEPS = 500  # largest number of steps of a contact in one call of its phase
ROWS_PER_PHASE = 2 * _STEPS
"""Number of rows of the history that must be free before a phase of the motion is entered; the phase fills little more
than half of them.
"""
_EVENTS_PER_SEGMENT = 10_000_000


class Workspace(NamedTuple):
    """Arrays of the event loop: the current state, scratch memory, and the history that the loop fills.

    Attributes:
        states: two records of STATE: the current state, and a copy with which `account_contact` follows a contact.
        flight: one record of FLIGHT.
        step: one record of CONTACT_STEP.
        ledger: one record of LEDGER: energies, to which the loop adds.
        counts: one record of COUNTS: how many states, impacts, segments and ticks have been filled in.
        history: records of STATE: the state at the start of each segment, at each event and at each step of a contact.
        impacts: records of IMPACT: the finished contacts.
        first_state: for each drive segment the row of `history` with its first state; the last element is the number of
            rows.
        first_segment: for each tick the index of its first segment; the element after the last tick is the number of
            segments. A tick consists of one or more segments.
    """

    states: NDArray[np.void]
    flight: NDArray[np.void]
    step: NDArray[np.void]
    ledger: NDArray[np.void]
    counts: NDArray[np.void]
    history: NDArray[np.void]
    impacts: NDArray[np.void]
    first_state: NDArray[np.int64]
    first_segment: NDArray[np.int64]


WORKSPACE = Fields(Workspace, (STATE, FLIGHT, CONTACT_STEP, LEDGER, COUNTS, STATE, IMPACT, INTEGERS, INTEGERS))


def new_workspace(states: int, impacts: int) -> Workspace:
    """Return a workspace whose state is zero, with room for `states` rows of history and for `impacts` impacts.

    The caller must replace `first_state` and `first_segment` by arrays with one element more than there are segments.
    """
    return Workspace(
        records(2, STATE),
        records(1, FLIGHT),
        records(1, CONTACT_STEP),
        records(1, LEDGER),
        records(1, COUNTS),
        room(states, STATE),
        room(impacts, IMPACT),
        np.zeros(1, np.int64),
        np.zeros(1, np.int64),
    )


@kernel
def _keep_state(work: Workspace) -> None:
    """Append the current state of the workspace to its history."""
    work.history[work.counts[0].states] = work.states[0]
    work.counts[0].states += 1


@kernel
def _fly_on(p: Record, s: Record, d: float, d_rate: float) -> None:
    """Start a flight of the sphere, in phase FREE, at d = x_2 − x_1 [m] with the rate d_rate [m/s].

    d and d_rate are relative to the superior base. If the guide has friction, it acts against d_rate from the start.
    """
    s.phase, s.side = FREE, 0.0
    s.d, s.d_rate = d, d_rate
    s.slide = np.sign(d_rate) if p.friction_acceleration > 0.0 else 0.0


@kernel
def _hold(s: Record, d: float, side: float) -> None:
    """Attach the sphere to the superior base at d = x_2 − x_1 [m]: phase ATTACHED.

    `side` is the wall that presses the sphere, −1 (left) or 1 (right), or 0 if friction of the guide holds the sphere.
    """
    s.phase, s.side, s.slide = ATTACHED, side, 0.0
    s.d, s.d_rate = d, 0.0


@kernel
def _least_speed(p: Record, s: Record) -> float:
    """Return the least speed, relative to the superior base, with which a sphere starts to fly away from it [m/s].

    It is `touch_speed`, or the rounding error of the superior base's speed if that error is larger.
    """
    return max(p.touch_speed, _SPEED_RESOLUTION * abs(s.y[V1]))


@kernel
def _part(p: Record, s: Record, way: float, ledger: Record) -> None:
    """Release a sphere that moves with the superior base, so that it flies in the direction `way`: −1 left, 1 right.

    The sphere starts with the relative speed `_least_speed`. The total momentum of both bodies does not change. The
    energy that this adds is recorded in `ledger` as a negative loss in contacts.
    """
    if s.side != 0.0:
        s.dent, s.dent_side = max(0.0, s.side * s.d - p.half_gap), s.side
    d_rate = way * _least_speed(p, s)
    s.y[V1] -= p.share * d_rate
    ledger.contact -= 0.5 * p.m_eff * d_rate * d_rate
    _fly_on(p, s, s.d, d_rate)


@kernel
def _touch(p: Record, s: Record, side: float, ledger: Record) -> None:
    """Begin a contact with the wall that the sphere has just reached: `side` is −1 for the left, 1 for the right wall.

    During the contact `s.y` holds the centre of mass of sphere and superior base. A slower approach than `touch_speed`
    is raised to `touch_speed`. The energy that this adds is recorded in `ledger` as a negative loss in contacts, but is
    not part of the `energy_lost` of the impact.
    """
    speed = max(side * s.d_rate, p.touch_speed)
    ledger.contact -= 0.5 * p.m_eff * (speed * speed - s.d_rate * s.d_rate)
    if s.dent_side != side:
        s.dent, s.dent_side = 0.0, side
    s.y[V1] += p.share * s.d_rate  # not `speed`: the least speed must not change the pair's momentum
    s.phase, s.side = CONTACT, side
    s.d, s.d_rate, s.slide = side * (p.half_gap + s.dent), 0.0, 0.0
    s.w, s.speed, s.deepest_w = 0.0, speed, 0.0
    s.per_v0 = 1.0 / max(speed, p.speed_floor)
    s.next_h, s.tabulated = 0.0, 0
    s.approach = speed
    s.elapsed, s.peak_force, s.impulse, s.lost = 0.0, 0.0, 0.0, 0.0


@kernel
def _keep_impact(work: Workspace, s: Record, separation: float, indentation: float) -> None:
    """Append the finished contact of the state s to the impacts of the workspace.

    `separation` is the relative speed at the end of the contact [m/s], positive away from the wall. `indentation` is
    the largest indentation of the contact [m].
    """
    row = work.impacts[work.counts[0].impacts]
    row.tick, row.offset, row.wall = s.touch_tick, s.touch_offset, int(s.side)
    row.approach_speed, row.separation_speed = s.approach, separation
    row.peak_force, row.peak_indentation = s.peak_force, indentation
    row.impulse, row.duration, row.energy_lost = s.impulse, s.elapsed, s.lost
    work.counts[0].impacts += 1


@kernel
def _leave(model: Model, s: Record, work: Workspace, settled: bool) -> None:
    """End a contact: append its impact, and let the sphere fly on or, if `settled`, stay on the wall in phase ATTACHED.

    After this, `s.y` holds the motion of the superior base again, instead of the centre of mass of both bodies. The
    elastic energy that the contact still stores counts as lost.
    """
    p, depth, side = model.parameters[0], s.w * s.w, s.side
    if depth > 0.0:
        _, _, stored, _, _ = force_at(p, model.law, s.per_v0, turned_at(s), s.w, s.speed, work.step[0])
        s.lost += stored
        work.ledger[0].contact += stored
    _keep_impact(work, s, -s.speed, s.deepest_w * s.deepest_w)
    s.y[X1] -= p.share * side * depth
    s.y[V1] -= p.share * side * s.speed
    d = s.d + side * depth
    if settled:  # at a turning point: the indentation's rate is zero
        _hold(s, d, side)
    else:
        s.dent += depth
        _fly_on(p, s, d, side * s.speed)
    s.w, s.speed, s.h, s.tabulated = 0.0, 0.0, 0.0, 0


@kernel
def _bounce(
    p: Record, s: Record, side: float, pair_acceleration: float, position_rounding: float, work: Workspace
) -> None:
    """Let the sphere rebound from a rigid wall with e times its relative speed, or attach it to the wall.

    The sphere is attached if the wall would press it and the rebound would be too slow. `pair_acceleration` [m/s²], the
    acceleration of sphere and superior base as one body, shows whether the wall would press. A rebound is too slow up
    to `touch_speed`, or if it would be no higher than `position_rounding` [m], the rounding error of the positions. The
    impact is appended to `work` only if the approach was faster than `touch_speed`.
    """
    speed = max(0.0, side * s.d_rate)
    e = p.restitution
    least_rebound = max(p.touch_speed, math.sqrt(2.0 * abs(pair_acceleration) * position_rounding))
    stays = e * speed <= least_rebound and side * pair_acceleration <= 0.0
    if stays:
        e = 0.0
    rebound_speed = 0.0 if stays else max(e * speed, _least_speed(p, s))
    s.y[V1] += p.share * (s.d_rate + side * rebound_speed)  # not of `speed`: the momentum of both must not change
    s.side, s.approach, s.elapsed, s.peak_force = side, speed, 0.0, 0.0
    s.impulse, s.lost = p.m_eff * speed * (1.0 + e), 0.5 * p.m_eff * speed * speed * (1.0 - e * e)
    work.ledger[0].contact += 0.5 * p.m_eff * (s.d_rate * s.d_rate - rebound_speed * rebound_speed)
    if speed > p.touch_speed:
        _keep_impact(work, s, e * speed, 0.0)
    if stays:
        _hold(s, side * p.half_gap, side)
    else:
        _fly_on(p, s, side * p.half_gap, -side * rebound_speed)


@kernel
def _flight_phase(model: Model, f: DriveSegment, work: Workspace, t_end: float, account: bool) -> int:
    """Advance a flight, with the sphere loose or attached, to its next event or to `t_end`; return the event or PAUSED.

    `t_end` is the end of the drive segment, since its start [s]. If `account`, work and losses are added to the ledger.
    """
    p, s, flight = model.parameters[0], work.states[0], work.flight[0]
    _keep_state(work)
    system, d_before = model.systems[flight.system], s.d
    flight.friction_force = guide_friction(p, s)
    ended = fly_attached(p, system, f, flight, s, t_end) if s.phase == ATTACHED else fly(p, system, f, flight, s, t_end)
    if account:
        account_flight(p, system, f, flight, s.t, work.ledger[0])
        work.ledger[0].friction += abs(flight.friction_force) * abs(s.d - d_before)
    return ended


@kernel
def _apply_tabulated(model: Model, f: DriveSegment, work: Workspace, t_end: float, account: bool) -> bool:
    """Complete a contact that has just started by its outcome in the law's table; return whether that was possible.

    If the result is false, the state is unchanged, and the caller must integrate the contact. The loss in the contact
    comes from the table. If `account`, a copy of the state is also integrated to compute the drive's work and the
    losses in columns and shaker.
    """
    p, table = model.parameters[0], model.table[0]
    s, step = work.states[0], work.step[0]
    if table.high == 0.0:
        return False
    expand(p, f, s, step)
    t_0 = t_0_of(p, s.speed)
    if not look_up(p, table, s, step, t_0, t_end - s.t):
        return False
    s.tabulated = 1
    _keep_state(work)
    if account:
        work.states[1] = s
        account_contact(model, f, work.states[1], step, work.ledger[0])
        expand(p, f, s, step)
    apply_outcome(p, table, s, step, t_0)
    work.ledger[0].contact += s.lost
    return True


@kernel
def account_contact(model: Model, f: DriveSegment, s: Record, step: Record, ledger: Record) -> None:
    """Add the drive's work and the losses in columns and shaker during the contact that begins at s to `ledger`.

    The contact is integrated step by step, and s is moved to its end. If a step has no solution, the rest of the
    contact is left out. This is for contacts whose outcome comes from the table, which does not contain these energies.
    """
    drop_dense_output(step)
    for _ in range(_STEPS):
        ended = take_next_step(model, f, s, step, math.inf)
        if ended == FAILED:
            return
        account_step(model.parameters[0], f, s, step, ledger)
        conclude(model.parameters[0], s, step, ended, 0.0)
        if ended not in (NOTHING, TURNED):
            return


@kernel
def _contact_phase(model: Model, f: DriveSegment, work: Workspace, t_end: float, account: bool) -> int:
    """Advance a contact to the event that ends it, or to `t_end`; return the event, PAUSED or FAILED.

    `t_end` is the end of the drive segment, since its start [s]. PAUSED means that the contact is not over: `t_end` or
    the largest number of steps per call is reached, and the caller calls again. FAILED means that a step has no
    solution. The losses in the contact are always added to the ledger. The drive's work and the losses in columns and
    shaker are added only if `account` is true.
    """
    p, s, step, ledger = model.parameters[0], work.states[0], work.step[0], work.ledger[0]
    if s.next_h == 0.0 and _apply_tabulated(model, f, work, t_end, account):
        return SEPARATED
    drop_dense_output(step)
    ended = PAUSED
    for _ in range(_STEPS):
        if s.w == 0.0 and s.speed < 0.0:  # the last segment ended where the sphere left
            ended = SEPARATED
            break
        ended = take_next_step(model, f, s, step, t_end)
        if ended == FAILED:
            return FAILED
        _keep_state(work)
        lost = dissipated(step, s.h)
        ledger.contact += lost
        s.lost += lost
        find_peaks(p, model.law, s, step)
        if account:
            account_step(p, f, s, step, ledger)
        conclude(p, s, step, ended, t_end)
        if ended in (SEPARATED, PAUSED, RELEASED):
            break
        if ended == TURNED and p.remembers and settles(p, model.law, s, step):
            ended = SETTLED
            break
        ended = PAUSED
        if s.t >= t_end:  # the step ended there, or beyond by less than the tolerance of PAUSED
            break
    s.h = 0.0
    _keep_state(work)
    return ended


@kernel
def _change_phase(model: Model, f: DriveSegment, work: Workspace, tick: int, ended: int) -> None:
    """Enter the phase of the motion that follows the event `ended`, by the table in the docstring of this module.

    `tick` is the number of the present tick since the reset. A contact records it as its beginning.
    """
    p, s, flight, ledger = model.parameters[0], work.states[0], work.flight[0], work.ledger[0]
    if ended == PAUSED:
        return
    if ended == TOUCHED:
        s.touch_tick, s.touch_offset = tick, f.begin + s.t
    if s.phase == CONTACT:
        _leave(model, s, work, ended == SETTLED)
    elif s.phase == ATTACHED:
        _part(p, s, s.slide, ledger)
    elif ended == TOUCHED and not p.rigid:
        _touch(p, s, s.side, ledger)
    else:
        system = model.systems[SPHERE_LOOSE]
        evaluate(system, f, flight, s.t, 0)
        pair_acceleration = (p.m_1 * flight.x_1[2] - flight.friction_force) * p.per_m_pair  # of both as one body
        if ended == TOUCHED:
            _bounce(p, s, s.side, pair_acceleration, rounding(p, system, flight, s.t), work)
        elif abs(pair_acceleration) <= p.friction_acceleration:
            _hold(s, s.d, 0.0)
        else:
            _part(p, s, -np.sign(pair_acceleration), ledger)


@kernel
def _prepare_flight(model: Model, f: DriveSegment, work: Workspace, t_end: float, fresh: bool) -> None:
    """Compute the flight's response to the drive, unless the response computed last is still valid.

    The response is valid within one drive segment, while the linear system (sphere loose or attached) is the same.
    `fresh` is true for the first flight in a segment. `t_end` is the end of the segment, since its start [s].
    """
    flight = work.flight[0]
    renewed = choose_system(model, f, work.states[0], flight)
    if fresh or renewed:
        prepare_segment(model.systems[flight.system], f, flight, t_end)


@kernel
def _move_base(p: Record, f: DriveSegment, s: Record, ledger: Record, account: bool) -> None:
    """Set position and velocity of a prescribed base to their values at the start of the drive segment f.

    If `account`, the work of a jump of the position against the springs of the columns is added to `ledger`.
    """
    x_b_before = s.y[XB]
    s.y[XB], s.y[VB] = drive(f, 0.0)
    if account:
        x_1 = s.y[X1]
        if s.phase == CONTACT:
            x_1 -= p.share * s.side * s.w * s.w
        ledger.work += p.k_1 * (s.y[XB] - x_b_before) * (0.5 * (s.y[XB] + x_b_before) - x_1)


@entry(MODEL, SEGMENT, int, int, WORKSPACE, bool, returns=(int, int))
def run(
    model: Model, segments: Records, first_tick: int, segment: int, work: Workspace, account: bool
) -> tuple[int, int]:
    """Simulate the drive segments from index `segment` on; return (result, index of a segment).

    The result is DONE, NEED_ROOM, STUCK or UNSOLVED; the documentation of `DONE` explains them. The index is the
    segment in which the simulation stopped, or the number of segments after DONE. After NEED_ROOM, call again with this
    index and a larger workspace of the same content. `first_tick` is the number of the tick of `segments[0]`, counted
    since the reset, even if `segment` is not 0. If `account` is true, the work of the drive and the losses outside the
    contacts are computed as well.
    """
    s = work.states[0]
    work.flight[0].omega = -1.0
    while segment < segments.shape[0]:
        row = segments[segment]
        f, t_end, fresh = drive_segment(row), row.duration, True
        if work.counts[0].segments == segment:  # not set before a call ran out of room
            work.first_state[segment] = work.counts[0].states
            work.counts[0].segments += 1
            if row.begin == 0.0:
                work.first_segment[work.counts[0].ticks] = segment
                work.counts[0].ticks += 1
            if model.parameters[0].drive_kind == PRESCRIBED:
                _move_base(model.parameters[0], f, s, work.ledger[0], account)
        for _ in range(_EVENTS_PER_SEGMENT):
            counts = work.counts[0]
            if counts.states + ROWS_PER_PHASE > work.history.shape[0] or counts.impacts + 2 > work.impacts.shape[0]:
                return NEED_ROOM, segment
            if s.phase == CONTACT:
                ended = _contact_phase(model, f, work, t_end, account)
                if ended == FAILED:
                    return UNSOLVED, segment
            else:
                _prepare_flight(model, f, work, t_end, fresh)
                fresh = False
                ended = _flight_phase(model, f, work, t_end, account)
            _change_phase(model, f, work, first_tick + work.counts[0].ticks - 1, ended)
            if s.t >= t_end:
                break
        else:
            return STUCK, segment
        if model.parameters[0].drive_kind == PRESCRIBED:  # a prescribed base is not integrated but has energy
            s.y[XB], s.y[VB] = drive(f, t_end)
        s.t = 0.0
        segment += 1
    counts = work.counts[0]
    work.history[counts.states] = s  # the state from which the next motion begins; not a row of this one
    work.first_state[segment], work.first_segment[counts.ticks] = counts.states, segment
    return DONE, segment
