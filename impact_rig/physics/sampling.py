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
"""Evaluation of a trajectory after its simulation, at any instants or as polynomials; it never changes the trajectory.

In flight the closed form of the structure's motion is expanded into Taylor polynomials, about instants at fixed
distances from the start of the flight. So a sample does not depend on which other samples are requested. Inside a
contact the integration step is solved again up to the instant. A contact whose outcome was tabulated is integrated here
first. With F the contact force, F_c the force of the columns, δ the indentation and `dent` the residual indentation,

    x_1 = x_1* − side σ δ,    x_2 = x_1 + side (g/2 + `dent` + δ),    a_1 = (F_c + side F) / m_1,    a_2 = −side F / m

In the functions, s is the stored state at the event or step from which the motion continues, and t the time since the
start of the drive segment. `since` is the time since the start of the flight, step or contact, and τ the time since the
instant about which a polynomial is expanded, its anchor.

The sensors evaluate a motion piece by piece, each piece as one polynomial (`fit`); `refine` returns the instants
between the pieces. In flight the polynomial is the shortened Taylor polynomial about the middle of the piece. In a
contact it runs through eight instants of the step's dense output or, if the contact was tabulated, of δ integrated
again. Any other piece, also in a tabulated contact of a law with a memory, is fitted through eight samples.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import sincos
from impact_rig.arithmetic.interpolation import NODE_AT, NODES, PIECE_TERMS, shorten, through_nodes
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
from impact_rig.physics.collocation import LAST
from impact_rig.physics.contact_phase import conclude, take_next_step
from impact_rig.physics.contact_step import (
    ROUNDS,
    add_correction,
    begin_step,
    dense_output,
    drop_dense_output,
    expand,
    force_at,
    keep_dense_output,
    pair_at,
    polynomial,
    solve,
)
from impact_rig.physics.flight import (
    SEGMENT,
    DriveSegment,
    begin_flight,
    bound_omega,
    choose_system,
    drive,
    drive_segment,
    guide_friction,
    mode_decay,
    particular,
    phasor,
)
from impact_rig.physics.model import MODEL, Model
from impact_rig.physics.state import (
    ATTACHED,
    COIL,
    CONTACT,
    CONTACT_STEP,
    FAILED,
    FLIGHT,
    PRESCRIBED,
    RELEASED,
    SEPARATED,
    STATE,
    V1,
    VB,
    VOLTAGE,
    X1,
    XB,
    record,
)

OF_X_B, OF_X_1, OF_X_2, OF_V_B, OF_V_1, OF_V_2, OF_A_B, OF_A_1, OF_A_2 = range(9)
OF_CURRENT, OF_FORCE_LEFT, OF_FORCE_RIGHT = range(9, 12)
QUANTITIES = ("x_b", "x_1", "x_2", "v_b", "v_1", "v_2", "a_b", "a_1", "a_2", "current", "force_left", "force_right")
"""Names of the quantities for which a motion can be evaluated, SI: displacement, velocity and acceleration of inferior
base (b), superior base (1) and sphere (2), current of the coil, and the forces of both walls. OF_X_1 is the index of
x_1 here, X1 that in a structural state.
"""

_INTERVAL_RADIANS = 0.5  # of the fastest motion per polynomial: the first neglected term is 0.25^14 / 14! = 4e-20
_MOST_STEPS = 500
_ROOT_ROUNDS = 60  # Newton needs three to six
_ROOT_TOLERANCE = 1e-9  # of the step
_SAME_INSTANT_S = 1e-12  # instants closer than this are one [s]
_LONGEST_PIECE = 4.0 / _INTERVAL_RADIANS  # in a flight, over `flight.interval`: 2 radians either side of its middle
_PULSE_STEPS = 12  # least number of steps in a tabulated contact; the nodes add more
_LENGTH_CORRECTIONS = 2  # of a step's length: the dense output is off by parts in 1e4; a correction squares the error


class Trajectory(NamedTuple):
    """Simulated motion of consecutive drive segments: the drive and the history of states.

    Attributes:
        segments: records of SEGMENT: the drive.
        first_tick: number of the first tick, counted since the reset.
        first_segment: for each tick the index of its first segment; the last element is the number of segments.
        history: records of STATE; the last one is the state after all segments.
        first_state: for each segment the row of `history` with its first state; the last element is the row of the last
            record.
    """

    segments: NDArray[np.void]
    first_tick: int
    first_segment: NDArray[np.int64]
    history: NDArray[np.void]
    first_state: NDArray[np.int64]


TRAJECTORY = Fields(Trajectory, (SEGMENT, int, INTEGERS, STATE, INTEGERS))


class Query(NamedTuple):
    """Request for the values of some quantities at given instants, with memory for the values.

    Attributes:
        wanted: indices of the quantities in QUANTITIES, shape (q,).
        tick: number of the tick of each instant, counted since the reset, shape (n,).
        offset: time since the tick's start [s], shape (n,).
        out: the values, which `sample` fills in, shape (q, n).
    """

    wanted: NDArray[np.int64]
    tick: NDArray[np.int64]
    offset: NDArray[np.float64]
    out: NDArray[np.float64]


QUERY = Fields(Query, (INTEGERS, INTEGERS, REALS, REALS_2D))


class Spans(NamedTuple):
    """Request for some quantities as polynomials on pieces of time, with memory for the coefficients.

    Attributes:
        wanted: indices of the quantities in QUANTITIES, shape (q,).
        tick: number of the tick of each piece, counted since the reset, shape (n,).
        start: start of the piece since the tick's start [s], shape (n,).
        end: end of the piece since the tick's start [s], shape (n,).
        out: the coefficients, which `fit` fills in, constant first, shape (q, n, NODES). The variable x is −1 at the
            start and 1 at the end of the piece.
    """

    wanted: NDArray[np.int64]
    tick: NDArray[np.int64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    out: NDArray[np.float64]


SPANS = Fields(Spans, (INTEGERS, INTEGERS, REALS, REALS, REALS_3D))


@functools.cache
def places(names: tuple[str, ...]) -> NDArray[np.int64]:
    """Return the index of each of the named quantities in QUANTITIES, shape (number of names,).

    Raises:
        ValueError: a name is not in QUANTITIES, or there are more names than QUANTITIES, so that one occurs twice.
    """
    if unknown := [name for name in names if name not in QUANTITIES]:
        raise ValueError(f"{unknown[0]!r} is no quantity of a motion; known: {', '.join(QUANTITIES)}")
    if len(names) > len(QUANTITIES):
        raise ValueError(f"at most {len(QUANTITIES)} names are allowed, got {len(names)}, so some are repeated")
    return np.array([QUANTITIES.index(name) for name in names], np.int64)


class SamplingWorkspace(NamedTuple):
    """Scratch memory of the kernels that evaluate a motion.

    Attributes:
        flight: one record of FLIGHT.
        step: one record of CONTACT_STEP.
        steps: records of STATE: the states at the steps of a tabulated contact. The last record is for the state at the
            start of this contact.
        polynomials: Taylor polynomials, one row for each wanted quantity in use, shape (QUANTITIES, PIECE_TERMS).
        quantities: all quantities at one instant, shape (QUANTITIES,).
        powers: factors (λ half)^k / k! of a Taylor series (see `_add_series`), shape (2, PIECE_TERMS): real parts, then
            imaginary parts.
        pulse: state of a tabulated contact: time since the touch [s], δ [m], δ' [m/s]; shape (3,).
        pulse_row: row of the history where the contact of `pulse` begins, −1 for none; shape (1,).
        tick: tick of each of a piece's nodes, shape (NODES,).
        offset: time of each node since its tick's start [s], shape (NODES,).
        values: values at a piece's nodes, one row for each wanted quantity in use, shape (QUANTITIES, NODES).
    """

    flight: NDArray[np.void]
    step: NDArray[np.void]
    steps: NDArray[np.void]
    polynomials: NDArray[np.float64]
    quantities: NDArray[np.float64]
    powers: NDArray[np.float64]
    pulse: NDArray[np.float64]
    pulse_row: NDArray[np.int64]
    tick: NDArray[np.int64]
    offset: NDArray[np.float64]
    values: NDArray[np.float64]


SAMPLING_WORKSPACE = Fields(
    SamplingWorkspace,
    (FLIGHT, CONTACT_STEP, STATE, REALS_2D, REALS, REALS_2D, REALS, INTEGERS, INTEGERS, REALS, REALS_2D),
)


SAMPLED = MODEL, TRAJECTORY, SAMPLING_WORKSPACE
"""Types of the first arguments of a kernel that evaluates a motion; `Motion.sampled` returns these arguments."""


def new_sampling_workspace() -> SamplingWorkspace:
    """Return new scratch memory for the kernels that evaluate a motion."""
    n = len(QUANTITIES)
    return SamplingWorkspace(
        record(FLIGHT),
        record(CONTACT_STEP),
        record(STATE, _MOST_STEPS + 1),
        np.zeros((n, PIECE_TERMS)),
        np.zeros(n),
        np.zeros((2, PIECE_TERMS)),
        np.zeros(3),
        np.zeros(1, np.int64),
        np.zeros(NODES, np.int64),
        np.zeros(NODES),
        np.zeros((n, NODES)),
    )


@kernel
def _place_and_order(p: Record, quantity: int) -> tuple[int, int, bool]:
    """Return how to compute a quantity of the structure: (entry of y, order of derivative, whether it is the drive).

    y is the structural state: displacements, velocities and coil current. An acceleration is therefore the first
    derivative of a velocity. If the last result is true, the quantity is this derivative of the drive u instead of an
    entry of y.
    """
    if quantity in (OF_X_1, OF_V_1, OF_A_1):
        return X1 if quantity == OF_X_1 else V1, 1 if quantity == OF_A_1 else 0, False
    if quantity == OF_CURRENT:
        return COIL, 0, p.drive_kind != VOLTAGE
    order = 2 if quantity == OF_A_B else 1 if quantity == OF_V_B else 0
    if p.drive_kind == PRESCRIBED:
        return XB, order, True
    return XB if order == 0 else VB, max(0, order - 1), False


@kernel
def _fill_powers(workspace: SamplingWorkspace, rate: complex, half: float) -> int:
    """Fill `workspace.powers` with (λ half)^k / k! for k = 0, 1, …, where λ = `rate`; return the number of terms.

    `half` is the unit of time of the polynomial [s]. The number of terms is PIECE_TERMS, but 2 for λ = 0, because a
    drive without oscillation is a straight line.
    """
    scaled_rate, term = rate * half, 1.0 + 0.0j
    terms = 2 if rate == 0.0 else PIECE_TERMS
    for k in range(terms):
        workspace.powers[0, k], workspace.powers[1, k] = term.real, term.imag
        term = term * scaled_rate * (1.0 / (k + 1))
    return terms


@kernel
def _add_series(
    poly: Reals,
    workspace: SamplingWorkspace,
    terms: int,
    value: complex,
    growth: complex,
    rate: complex,
    order: int,
    half: float,
) -> None:
    """Add the Taylor series of Re[(value + growth τ) exp(λ τ)], differentiated `order` times by τ, to `poly`.

    λ is `rate`. τ is the time since the instant about which the series is expanded, and the variable of the series is τ
    / `half`. `workspace.powers` must hold `terms` numbers for the same λ and `half`.
    """
    for _ in range(order):
        value, growth = rate * value + growth, rate * growth
    re, im = workspace.powers[0], workspace.powers[1]
    value_re, value_im, growth_re, growth_im = value.real, value.imag, half * growth.real, half * growth.imag
    poly[0] += value_re * re[0] - value_im * im[0]
    for k in range(1, terms):
        poly[k] += (value_re * re[k] - value_im * im[k]) + (growth_re * re[k - 1] - growth_im * im[k - 1])


@kernel
def _expand_flight(
    p: Record,
    system: Record,
    f: DriveSegment,
    flight: Record,
    quantity: int,
    poly: Reals,
    since: float,
    workspace: SamplingWorkspace,
) -> None:
    """Fill `poly` with a quantity's Taylor polynomial about the instant `since` seconds after the flight's start.

    The variable of the polynomial is the time after this instant [s]. The quantity must be a motion of a base or the
    current of a coil, see `_is_of_structure`.
    """
    poly[:] = 0.0
    t = flight.t_b + since
    place, order, is_drive = _place_and_order(p, quantity)
    jw = complex(0.0, f.omega)
    rotor = phasor(f.omega * t) * complex(0.0, -1.0)  # Im(…) = Re(−j …)
    terms = _fill_powers(workspace, jw, 1.0)
    if is_drive:
        unit = phasor(f.phase) * rotor
        _add_series(poly, workspace, terms, (f.amplitude + f.growth * t) * unit, f.growth * unit, jw, order, 1.0)
        return
    steady, growing = flight.steady[place], flight.growing[place]
    _add_series(poly, workspace, terms, (steady + growing * t) * rotor, growing * rotor, jw, order, 1.0)
    for n in range(system.modes):
        rate = system.rate[n]
        _, decay = mode_decay(rate, since)
        terms = _fill_powers(workspace, rate, 1.0)
        _add_series(poly, workspace, terms, system.right[n, place] * flight.modal[n] * decay, 0.0j, rate, order, 1.0)
    if order == 0:
        poly[0] += system.static[place] * flight.friction_force


@kernel
def _is_of_structure(p: Record, quantity: int) -> bool:
    """Return whether a quantity has a Taylor polynomial in flight.

    The motions of both bases and the coil's current have one. If the base is prescribed, there is no coil, and the
    result for the current is false.
    """
    of_sphere = quantity in (OF_X_2, OF_V_2, OF_A_2, OF_FORCE_LEFT, OF_FORCE_RIGHT)
    return not (of_sphere or (quantity == OF_CURRENT and p.drive_kind == PRESCRIBED))


@kernel
def _structure_quantity(s: Record, quantity: int) -> int:
    """Return the quantity whose Taylor polynomial is needed to compute a given quantity in the flight from s.

    In phase ATTACHED, motion of the sphere and wall forces are computed from a quantity of the superior base. In all
    other cases the result is the given quantity itself.
    """
    if s.phase == ATTACHED:  # one body: the sphere moves with the structure, and a wall may push it
        if quantity in (OF_X_2, OF_V_2, OF_A_2):
            return quantity - 1  # x_1, v_1, a_1 precede x_2, v_2, a_2 in QUANTITIES
        if quantity >= OF_FORCE_LEFT:
            return OF_A_1
    return quantity


@kernel
def _quantity_in_flight(p: Record, s: Record, quantity: int, poly: Reals, tau: float, since: float) -> float:
    """Return the value of a quantity `since` seconds after the start of the flight from s.

    `poly` is the Taylor polynomial of the quantity that `_structure_quantity` returns. `tau` is the time since the
    instant about which `poly` is expanded [s]. The motion of a loose sphere is a parabola and does not need `poly`.
    """
    if quantity == OF_CURRENT and p.drive_kind == PRESCRIBED:
        return 0.0
    if s.phase == ATTACHED:
        value = polynomial(poly, tau, PIECE_TERMS)
        if quantity == OF_X_2:
            return value + s.d
        if quantity >= OF_FORCE_LEFT:
            side = 1.0 if quantity == OF_FORCE_RIGHT else -1.0
            return max(0.0, -side * p.m * value) if s.side == side else 0.0
        return value
    sphere_acceleration = -s.slide * p.friction_acceleration
    if quantity == OF_X_2:
        return s.y[X1] + s.d + since * (s.y[V1] + s.d_rate + 0.5 * since * sphere_acceleration)
    if quantity == OF_V_2:
        return s.y[V1] + s.d_rate + since * sphere_acceleration
    if quantity == OF_A_2:
        return sphere_acceleration
    return polynomial(poly, tau, PIECE_TERMS) if quantity < OF_FORCE_LEFT else 0.0


@kernel
def integrate_tabulated(model: Model, f: DriveSegment, step: Record, steps: Records) -> int:
    """Integrate a contact whose outcome came from a table; return the number of states that were stored in `steps`.

    The contact begins in the state `steps[_MOST_STEPS]`, which is overwritten. The states at its steps are stored in
    `steps[0]`, `steps[1]`, and so on. The last state is at the end of the contact, or where a step had no solution or
    the room in `steps` ran out.
    """
    p, s = model.parameters[0], steps[_MOST_STEPS]
    drop_dense_output(step)
    for n in range(_MOST_STEPS - 1):
        ended = take_next_step(model, f, s, step, np.inf)
        steps[n] = s
        if ended != FAILED:
            conclude(p, s, step, ended, np.inf)
        if ended in (SEPARATED, RELEASED, FAILED):
            s.h = 0.0
            steps[n + 1] = s
            return n + 2
    return _MOST_STEPS - 1


@kernel
def last_not_after(history: Records, first_row: int, end_row: int, t: float) -> int:
    """Return the last row in [first_row, end_row) whose time is not after t [s], or `first_row` if all are later."""
    while end_row - first_row > 1:
        middle_row = (first_row + end_row) // 2
        if history[middle_row].t <= t:
            first_row = middle_row
        else:
            end_row = middle_row
    return first_row


@kernel
def _step_length_for(s: Record, step: Record, end_point: tuple[float, float, float], since: float) -> float:
    """Return the length in χ of the first part of a contact's step, which lasts about `since` seconds.

    χ is the variable of integration, with dt = w dχ. `step` is the whole step, which begins at the state `s`.
    `end_point` is the end of the whole step: (its duration [s], w, δ'), with w the square root of the indentation δ.
    """
    low, high = 0.0, 1.0
    x = min(1.0, since / end_point[0])
    for _ in range(_ROOT_ROUNDS):
        since_x, w, _ = dense_output(s, step, x)
        if since_x > since:
            high = x
        else:
            low = x
        correction = (since - since_x) / (w * s.h) if w > 0.0 else np.inf
        x += correction
        if abs(correction) <= _ROOT_TOLERANCE:  # tested before the limits: at the root, rounding puts x on one of them
            break
        if not low < x < high:
            x = 0.5 * (low + high)
    return min(max(x, 0.0), 1.0) * s.h


@kernel
def _solve_up_to(
    model: Model, s: Record, step: Record, end_point: tuple[float, float, float], since: float
) -> tuple[float, float]:
    """Return (w, δ') at `since` seconds after the start of a contact's step, by solving a shorter step that ends there.

    `end_point` is the end of the whole step: (its duration [s], w, δ'), with w the square root of the indentation δ.
    """
    if s.h == 0.0 or since <= 0.0:
        return s.w, s.speed
    h = s.h
    if since < end_point[0]:
        h = _step_length_for(s, step, end_point, since)
        for _ in range(_LENGTH_CORRECTIONS):
            solve(model.parameters[0], model.law, s, step, h, ROUNDS)
            if step.w[LAST] > 0.0:
                h = min(s.h, h - (step.since[LAST] - since) / step.w[LAST])
    solve(model.parameters[0], model.law, s, step, h, ROUNDS)
    return max(step.w[LAST], 0.0), step.speed[LAST]


@kernel
def _quantities_in_contact(
    model: Model,
    f: DriveSegment,
    s: Record,
    step: Record,
    point: tuple[float, float, float],
    solved_there: bool,
    out: Reals,
) -> None:
    """Fill `out` with all QUANTITIES at a point of a contact's step, which begins at s.

    `step` must be expanded about s. `point` is (time since the start of the step [s], w [√m], dδ/dt [m/s]), with w the
    square root of the indentation δ. `solved_there` is true if the step has been solved to end at the point. Only then
    does the result include the effect of the indentation on the structure through the columns, which is about a
    millionth.
    """
    p, side = model.parameters[0], s.side
    since, w, speed = point
    t = s.t + since
    pair_at(step, since, step.y)
    if solved_there and since > 0.0:
        add_correction(p, side, step, LAST, step.y)
    depth = w * w
    elastic, lossy, _, _, _ = force_at(p, model.law, s.per_v0, step.turned_at, w, speed, step)
    force = max(0.0, elastic + lossy) if p.lets_go else elastic + lossy
    u, _ = drive(f, t)
    d = s.d + side * depth
    x_b, v_b = step.y[XB], step.y[VB]
    out[OF_X_1] = step.y[X1] - p.share * side * depth
    out[OF_V_1] = step.y[V1] - p.share * side * speed
    out[OF_X_2], out[OF_V_2] = out[OF_X_1] + d, out[OF_V_1] + side * speed
    columns_force = -p.k_1 * (out[OF_X_1] - x_b) - p.c_1 * (out[OF_V_1] - v_b)
    out[OF_A_1], out[OF_A_2] = (columns_force + side * force) * p.per_m_1, -side * force / p.m
    out[OF_X_B], out[OF_V_B] = x_b, v_b
    out[OF_FORCE_LEFT] = force if side < 0.0 else 0.0
    out[OF_FORCE_RIGHT] = force if side > 0.0 else 0.0
    if p.drive_kind == PRESCRIBED:
        _, cosine = sincos(f.omega * t + f.phase)
        out[OF_A_B], out[OF_CURRENT] = 2.0 * f.growth * f.omega * cosine - f.omega * f.omega * u, 0.0
        return
    out[OF_CURRENT] = step.y[COIL] if p.drive_kind == VOLTAGE else u
    base_force = p.force_factor * out[OF_CURRENT] - p.c_f * v_b - p.k_f * x_b - columns_force
    out[OF_A_B] = base_force * p.per_m_base


@kernel
def _solve_again(model: Model, f: DriveSegment, s: Record, step: Record) -> tuple[float, float, float]:
    """Expand `step` about s and solve it again with its length `s.h`; return its end: (duration [s], w = √δ, δ')."""
    p = model.parameters[0]
    expand(p, f, s, step)
    begin_step(p, model.law, s, step)
    if s.h == 0.0:
        return 0.0, s.w, s.speed
    drop_dense_output(step)
    solve(p, model.law, s, step, s.h, ROUNDS)
    keep_dense_output(s, step)
    return step.since[LAST], max(step.w[LAST], 0.0), step.speed[LAST]


@kernel
def _sample_contact(
    model: Model,
    f: DriveSegment,
    history: Records,
    row: int,
    start: int,
    stop: int,
    query: Query,
    workspace: SamplingWorkspace,
) -> None:
    """Fill `query.out` for the instants number `start` to `stop` − 1, all in the part that begins at `history[row]`.

    This part is one integration step of a contact, or a whole tabulated contact. `f` is the segment of the drive.
    """
    step, s = workspace.step[0], history[row]
    steps, first_row, end_row, solved_row = history, row, row + 1, -1
    if s.tabulated:
        steps = workspace.steps
        steps[_MOST_STEPS] = s
        first_row, end_row = 0, integrate_tabulated(model, f, step, steps)
    end_point = 0.0, 0.0, 0.0
    for i in range(start, stop):
        t = query.offset[i] - f.begin
        step_row = last_not_after(steps, first_row, end_row, t)
        start_state = steps[step_row]
        if step_row != solved_row:
            solved_row, end_point = step_row, _solve_again(model, f, start_state, step)
        since = min(max(t - start_state.t, 0.0), end_point[0])
        w, speed = _solve_up_to(model, start_state, step, end_point, since)
        _quantities_in_contact(model, f, start_state, step, (since, w, speed), True, workspace.quantities)
        for q in range(query.wanted.shape[0]):
            query.out[q, i] = workspace.quantities[query.wanted[q]]


@kernel
def begin_flight_at(model: Model, f: DriveSegment, s: Record, flight: Record) -> Record:
    """Prepare `flight` for the evaluation of the flight that begins at s; return the linear system of this flight."""
    renewed = choose_system(model, f, s, flight)
    system = model.systems[flight.system]
    if renewed:
        flight.interval = _INTERVAL_RADIANS / bound_omega(system, f.omega)
    particular(system, f, flight)
    flight.friction_force = guide_friction(model.parameters[0], s)
    begin_flight(system, f, flight, s.y, s.t)
    return system


@kernel
def _sample_flight(
    model: Model, f: DriveSegment, s: Record, start: int, stop: int, query: Query, workspace: SamplingWorkspace
) -> None:
    """Fill `query.out` for the instants number `start` to `stop` − 1, which are all in the flight that begins at s."""
    p, flight = model.parameters[0], workspace.flight[0]
    system = begin_flight_at(model, f, s, flight)
    expanded_interval = -1
    for i in range(start, stop):
        since = query.offset[i] - f.begin - s.t
        interval = int(since / flight.interval)
        since_middle = (interval + 0.5) * flight.interval
        if interval != expanded_interval:
            expanded_interval = interval
            for q in range(query.wanted.shape[0]):
                quantity = _structure_quantity(s, query.wanted[q])
                if _is_of_structure(p, quantity):
                    _expand_flight(p, system, f, flight, quantity, workspace.polynomials[q], since_middle, workspace)
        for q in range(query.wanted.shape[0]):
            query.out[q, i] = _quantity_in_flight(
                p, s, query.wanted[q], workspace.polynomials[q], since - since_middle, since
            )


@kernel
def _rows_at(trajectory: Trajectory, tick: int, offset: float) -> tuple[int, int, int]:
    """Return (row of the drive segment, row of the state, row after the segment's last state) for an instant.

    The row of the state is that of the last state at or before the instant. `tick` counts from the first tick of the
    trajectory, and `offset` is the time since the start of the tick [s].
    """
    segment, end_segment = trajectory.first_segment[tick], trajectory.first_segment[tick + 1]
    while end_segment - segment > 1:
        middle_segment = (segment + end_segment) // 2
        if trajectory.segments[middle_segment].begin <= offset:
            segment = middle_segment
        else:
            end_segment = middle_segment
    t, end_row = offset - trajectory.segments[segment].begin, trajectory.first_state[segment + 1]
    return segment, last_not_after(trajectory.history, trajectory.first_state[segment], end_row, t), end_row


@entry(*SAMPLED, QUERY, returns=bool)
def sample(model: Model, trajectory: Trajectory, workspace: SamplingWorkspace, query: Query) -> bool:
    """Fill `query.out` with the quantities at the instants; return whether the trajectory contains all their ticks.

    The instants may be in any order. If the result is false, the values are missing from the first instant of the query
    on that is outside the trajectory. Consecutive instants in the same flight or step of a contact are evaluated
    together.
    """
    workspace.flight[0].omega = -1.0
    return _sample(model, trajectory, query, workspace)


@kernel
def _sample(model: Model, trajectory: Trajectory, query: Query, workspace: SamplingWorkspace) -> bool:
    n = query.offset.shape[0]
    i = 0
    while i < n:
        tick = query.tick[i] - trajectory.first_tick
        if not 0 <= tick < trajectory.first_segment.shape[0] - 1:
            return False
        segment, row, end_row = _rows_at(trajectory, tick, query.offset[i])
        f = drive_segment(trajectory.segments[segment])
        # since the start of the tick, as `offset`
        ends_in_tick = segment + 1 < trajectory.first_segment[tick + 1]
        segment_end = trajectory.segments[segment + 1].begin if ends_in_tick else np.inf
        state_start = trajectory.history[row].t
        state_end = trajectory.history[row + 1].t if row + 1 < end_row else np.inf
        start = i
        i += 1
        while i < n and query.tick[i] - trajectory.first_tick == tick:
            if not (state_start <= query.offset[i] - f.begin < state_end and query.offset[i] < segment_end):
                break
            i += 1
        if trajectory.history[row].phase == CONTACT:
            _sample_contact(model, f, trajectory.history, row, start, i, query, workspace)
        else:
            _sample_flight(model, f, trajectory.history[row], start, i, query, workspace)
    return True


@kernel
def _fit_flight(
    p: Record, system: Record, f: DriveSegment, flight: Record, spans: Spans, i: int, workspace: SamplingWorkspace
) -> None:
    """Fill `spans.out` for piece i with the polynomials of the wanted quantities in a flight.

    Each quantity must be a motion of a base or the current of a coil (`_is_of_structure`). The piece must lie in the
    flight for which `flight` has been prepared.
    """
    half = 0.5 * (spans.end[i] - spans.start[i])
    t_middle = 0.5 * (spans.start[i] + spans.end[i]) - f.begin
    since_middle, wanted, poly = t_middle - flight.t_b, spans.wanted, workspace.polynomials
    rotor = phasor(f.omega * t_middle) * complex(0.0, -1.0)  # Im(…) = Re(−j …)
    jw = complex(0.0, f.omega)
    terms = _fill_powers(workspace, jw, half)
    for q in range(wanted.shape[0]):
        place, order, is_drive = _place_and_order(p, wanted[q])
        poly[q, :] = 0.0
        if is_drive:
            unit = phasor(f.phase) * rotor
            value, growth = (f.amplitude + f.growth * t_middle) * unit, f.growth * unit
        else:
            growth = flight.growing[place] * rotor
            value = flight.steady[place] * rotor + growth * t_middle
            if order == 0:
                poly[q, 0] = system.static[place] * flight.friction_force
        _add_series(poly[q], workspace, terms, value, growth, jw, order, half)
    for n in range(system.modes):
        rate = system.rate[n]
        _, decay = mode_decay(rate, since_middle)
        modal = flight.modal[n] * decay
        terms = _fill_powers(workspace, rate, half)
        for q in range(wanted.shape[0]):
            place, order, is_drive = _place_and_order(p, wanted[q])
            if not is_drive:
                _add_series(poly[q], workspace, terms, system.right[n, place] * modal, 0.0j, rate, order, half)
    for q in range(wanted.shape[0]):
        shorten(poly[q], spans.out[q, i])


@kernel
def _fit_contact(
    model: Model, f: DriveSegment, history: Records, row: int, spans: Spans, i: int, workspace: SamplingWorkspace
) -> None:
    """Fill `workspace.values` with the quantities at the nodes of piece i, which lies inside one step of a contact.

    The values come from the dense output of the step that begins at `history[row]`.
    """
    step, s = workspace.step[0], history[row]
    t_middle, half = 0.5 * (spans.start[i] + spans.end[i]) - f.begin, 0.5 * (spans.end[i] - spans.start[i])
    end_point = _solve_again(model, f, s, step)
    for j in range(NODES):
        since, w, speed = 0.0, s.w, s.speed
        if s.h > 0.0:
            since = min(max(t_middle + half * NODE_AT[j] - s.t, 0.0), end_point[0])
            _, w, speed = dense_output(s, step, _step_length_for(s, step, end_point, since) / s.h)
        _quantities_in_contact(model, f, s, step, (since, max(w, 0.0), speed), False, workspace.quantities)
        for q in range(spans.wanted.shape[0]):
            workspace.values[q, j] = workspace.quantities[spans.wanted[q]]


@kernel
def _depth_acceleration(model: Model, step: Record, per_v0: float, since: float, depth: float, speed: float) -> float:
    """Return the acceleration δ'' [m/s²] of the indentation, `since` seconds after the touch, in a tabulated contact.

    `depth` [m] and `speed` [m/s] are the indentation and its rate. `step` must be expanded about the touch.
    """
    p = model.parameters[0]
    w = math.sqrt(max(0.0, depth))
    elastic, lossy, _, _, _ = force_at(p, model.law, per_v0, 0.0, w, speed, step)
    force = max(0.0, elastic + lossy) if p.lets_go else elastic + lossy
    relative_acceleration = step.acceleration[0] + since * (step.acceleration[1] + since * step.acceleration[2])
    return relative_acceleration - (p.slowing_by_depth * depth + p.slowing_by_speed * speed) - force * p.per_m_eff


@kernel
def _integrate_pulse(
    model: Model, step: Record, per_v0: float, pulse: Reals, since_end: float, longest_step: float
) -> None:
    """Move `pulse`, the state (time since the touch [s], δ, δ') of a tabulated contact, on to the time `since_end` [s].

    The equation of motion is integrated by the fourth-order Runge–Kutta method, in steps of at most `longest_step` [s].
    """
    steps = math.ceil((since_end - pulse[0]) / longest_step)
    for n in range(steps):
        since, depth, speed = pulse[0], pulse[1], pulse[2]
        dt = (since_end - since) / (steps - n)
        acceleration = _depth_acceleration(model, step, per_v0, since, depth, speed)
        speed_2 = speed + 0.5 * dt * acceleration
        since_middle = since + 0.5 * dt
        acceleration_2 = _depth_acceleration(model, step, per_v0, since_middle, depth + 0.5 * dt * speed, speed_2)
        speed_3 = speed + 0.5 * dt * acceleration_2
        acceleration_3 = _depth_acceleration(model, step, per_v0, since_middle, depth + 0.5 * dt * speed_2, speed_3)
        speed_4 = speed + dt * acceleration_3
        acceleration_4 = _depth_acceleration(model, step, per_v0, since + dt, depth + dt * speed_3, speed_4)
        pulse[0] = since + dt
        pulse[1] = depth + dt * (speed + 2.0 * (speed_2 + speed_3) + speed_4) * (1.0 / 6.0)
        accelerations = acceleration + 2.0 * (acceleration_2 + acceleration_3) + acceleration_4
        pulse[2] = speed + dt * accelerations * (1.0 / 6.0)
    pulse[0] = since_end


@kernel
def _fit_pulse(
    model: Model, f: DriveSegment, history: Records, row: int, spans: Spans, i: int, workspace: SamplingWorkspace
) -> None:
    """Fill `workspace.values` with the quantities at the nodes of piece i, which lies in a tabulated contact.

    The contact is integrated to the nodes. The error of the force is at most 3e-4 of its peak.
    """
    p, step, pulse, s = model.parameters[0], workspace.step[0], workspace.pulse, history[row]
    since_middle, half = 0.5 * (spans.start[i] + spans.end[i]) - f.begin - s.t, 0.5 * (spans.end[i] - spans.start[i])
    if workspace.pulse_row[0] != row or since_middle + half * NODE_AT[0] < pulse[0]:
        expand(p, f, s, step)
        step.turned_at = 0.0
        workspace.pulse_row[0], pulse[0], pulse[1], pulse[2] = row, 0.0, 0.0, s.speed
    longest_step = (history[row + 1].t - s.t) / _PULSE_STEPS
    for j in range(NODES):
        _integrate_pulse(model, step, s.per_v0, pulse, since_middle + half * NODE_AT[j], longest_step)
        point = pulse[0], math.sqrt(max(0.0, pulse[1])), pulse[2]
        _quantities_in_contact(model, f, s, step, point, False, workspace.quantities)
        for q in range(spans.wanted.shape[0]):
            workspace.values[q, j] = workspace.quantities[spans.wanted[q]]


@kernel
def _fit_samples(model: Model, trajectory: Trajectory, spans: Spans, i: int, workspace: SamplingWorkspace) -> None:
    """Fill `workspace.values` with the quantities at the nodes of piece i by sampling them one by one.

    This is for pieces that no faster function can fit. Examples are a piece with parts of several flights or steps, and
    the sphere's motion or a force in flight.
    """
    middle, half = 0.5 * (spans.start[i] + spans.end[i]), 0.5 * (spans.end[i] - spans.start[i])
    for j in range(NODES):
        workspace.tick[j], workspace.offset[j] = spans.tick[i], middle + half * NODE_AT[j]
    _sample(model, trajectory, Query(spans.wanted, workspace.tick, workspace.offset, workspace.values), workspace)


@entry(MODEL, TRAJECTORY, SPANS, SAMPLING_WORKSPACE, returns=bool)
def fit(model: Model, trajectory: Trajectory, spans: Spans, workspace: SamplingWorkspace) -> bool:
    """Fit polynomials to the quantities on the pieces and store them in `spans.out`; return whether all ticks exist.

    If the result is false, a piece is in a tick before or after the trajectory. This piece and all pieces after it are
    then not filled in.

    The error depends on the piece. In flight, it is about 5e-5 of the fastest motion if the piece extends at most 2
    radians of this motion to either side of its middle. Longer pieces are fitted through eight samples, and their error
    is not limited. In a step of a contact the error is about a millionth. In a tabulated contact the polynomial misses
    the force by up to a thousandth of its peak.
    """
    p, flight, history = model.parameters[0], workspace.flight[0], trajectory.history
    flight.omega, workspace.pulse_row[0] = -1.0, -1
    structure_alone = True
    for q in range(spans.wanted.shape[0]):
        structure_alone = structure_alone and _is_of_structure(p, spans.wanted[q])
    prepared_row = -1  # row of the state at the start of the prepared flight
    for i in range(spans.start.shape[0]):
        tick = spans.tick[i] - trajectory.first_tick
        if not 0 <= tick < trajectory.first_segment.shape[0] - 1:
            return False
        middle = 0.5 * (spans.start[i] + spans.end[i])
        segment, row, end_row = _rows_at(trajectory, tick, middle)
        f = drive_segment(trajectory.segments[segment])
        ends_inside = (
            spans.end[i] - f.begin
            <= (history[row + 1].t if row + 1 < end_row else trajectory.segments[segment].duration) + _SAME_INSTANT_S
        )
        inside = spans.start[i] - f.begin >= history[row].t - _SAME_INSTANT_S and ends_inside
        if inside and history[row].phase == CONTACT and not (history[row].tabulated and p.remembers):
            if history[row].tabulated:
                _fit_pulse(model, f, history, row, spans, i, workspace)
            else:
                _fit_contact(model, f, history, row, spans, i, workspace)
                workspace.pulse_row[0] = -1
        else:
            if inside and structure_alone:
                if row != prepared_row:
                    begin_flight_at(model, f, history[row], flight)
                    prepared_row = row
                if spans.end[i] - spans.start[i] <= _LONGEST_PIECE * flight.interval:
                    _fit_flight(p, model.systems[flight.system], f, flight, spans, i, workspace)
                    continue
            _fit_samples(model, trajectory, spans, i, workspace)
            prepared_row, workspace.pulse_row[0] = -1, -1
        for q in range(spans.wanted.shape[0]):
            through_nodes(workspace.values[q], spans.out[q, i])
    return True


TABULATED_PIECES = 3
"""Number of pieces into which `refine` divides a tabulated contact, short enough for one polynomial of `fit` each."""


@entry(TRAJECTORY, INTEGERS, REALS, returns=int)
def refine(trajectory: Trajectory, tick: Integers, offset: Reals) -> int:
    """Fill `tick` and `offset` [s] with the instants between which every quantity is smooth; return their number.

    The instants are the times of all states in the history except the last state, and two instants inside each
    tabulated contact. They are in order, and some are equal. The arrays must have room for TABULATED_PIECES instants
    per state.
    """
    history, first_state, count = trajectory.history, trajectory.first_state, 0
    tick_index = -1
    for segment in range(first_state.shape[0] - 1):
        segment_start = trajectory.segments[segment].begin
        if segment == trajectory.first_segment[tick_index + 1]:
            tick_index += 1
        for row in range(first_state[segment], first_state[segment + 1]):
            s = history[row]
            tick[count], offset[count] = trajectory.first_tick + tick_index, segment_start + s.t
            count += 1
            if s.phase == CONTACT and s.tabulated != 0:
                duration = history[row + 1].t - s.t
                for part in range(1, TABULATED_PIECES):
                    tick[count], offset[count] = (
                        trajectory.first_tick + tick_index,
                        segment_start + (s.t + duration * (part / TABULATED_PIECES)),
                    )
                    count += 1
    return count
