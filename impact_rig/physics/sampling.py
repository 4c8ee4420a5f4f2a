# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Evaluate a trajectory after the fact, at any instants or as polynomials: instruments read it and never touch it.

In flight the closed form is expanded into short Taylor polynomials anchored at fixed places of the flight, so a
sample costs a dozen multiplications and does not depend on which other samples are asked for. Inside a contact the
step is solved again up to the instant; a contact whose outcome was tabulated is integrated here first. With F the
contact force and F_c that of the columns,

    x_1 = x_1* − side σ δ,    x_2 = x_1 + side (g/2 + dent + δ),    a_1 = (F_c + side F) / m_1,    a_2 = −side F / m

In the functions s is the state at the event or step that the motion goes on from, t the time since the start of the
segment, `since` that since the flight, step or contact began, and τ that from the place a polynomial is anchored at.

The sensors take a motion piece by piece (`refine` gives the instants at which it is cut), each as one polynomial
(`fit`): in flight the Taylor polynomial about its middle, shortened; in a contact the one through eight instants, of a
step's dense output or, if tabulated, of δ integrated anew; anything else, and a tabulated contact of a law with a
memory, through eight samples.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import sincos
from impact_rig.arithmetic.interpolation import NODE_AT, NODES, PIECE_TERMS, shorten, through_nodes
from impact_rig.kernels import INTEGERS, REALS, REALS_2D, REALS_3D, Fields, entry, kernel
from impact_rig.physics.collocation import LAST
from impact_rig.physics.contact_phase import conclude, take_next_step
from impact_rig.physics.contact_step import (
    ROUNDS,
    add_correction,
    begin_step,
    dense_output,
    drop_dense_output,
    expand,
    keep_dense_output,
    pair_at,
    polynomial,
    solve,
)
from impact_rig.physics.flight import (
    SEGMENT,
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
from impact_rig.physics.model import MODEL
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
QUANTITIES = (
    "x_b", "x_1", "x_2", "v_b", "v_1", "v_2", "a_b", "a_1", "a_2", "current", "force_left", "force_right"
)  # fmt: skip
"""What a motion can be asked for, SI; OF_X_1 is the place of x_1 here, X1 that in a structural state."""

_INTERVAL_RADIANS = 0.5  # of the fastest motion per polynomial: the first neglected term is 0.25^14 / 14! = 4e-20
_MOST_STEPS = 500
_ROOT_ROUNDS = 60  # Newton needs three to six
_ROOT_FOUND = 1e-9  # of the step
_SAME = 1e-12  # instants nearer to each other are one [s]
_LONGEST = 4.0 / _INTERVAL_RADIANS  # a piece, times `flight.interval`: 2 radians either side of its middle, see `fit`
_PULSE_STEPS = 12  # of a tabulated contact, at least; the nodes make more of them
_CORRECTIONS = 2  # of the length of a step up to an instant: interpolation leaves parts in 1e4, each squares the error


class Trajectory(NamedTuple):
    """The history of consecutive drive segments.

    Attributes:
        segments: the drive.
        first_tick: number of the first tick.
        first_segment: row of each tick's first segment, and the number of segments.
        history: records of STATE, and last the one after all segments.
        first_state: row of each segment's first state, and of that last one.
    """

    segments: NDArray[np.void]
    first_tick: int
    first_segment: NDArray[np.int64]
    history: NDArray[np.void]
    first_state: NDArray[np.int64]


TRAJECTORY = Fields(Trajectory, (SEGMENT, int, INTEGERS, STATE, INTEGERS))


class Query(NamedTuple):
    """Quantities wanted at instants.

    Attributes:
        wanted: places in QUANTITIES, shape (q,).
        tick: shape (n,).
        offset: time since the tick's start [s], shape (n,).
        out: shape (q, n).
    """

    wanted: NDArray[np.int64]
    tick: NDArray[np.int64]
    offset: NDArray[np.float64]
    out: NDArray[np.float64]


QUERY = Fields(Query, (INTEGERS, INTEGERS, REALS, REALS_2D))


class Spans(NamedTuple):
    """Quantities wanted as polynomials on pieces.

    Attributes:
        wanted: places in QUANTITIES, shape (q,).
        tick: shape (n,).
        start: time since the tick's start [s], shape (n,).
        end: likewise.
        out: coefficients in x = −1 … 1, constant first, shape (q, n, NODES).
    """

    wanted: NDArray[np.int64]
    tick: NDArray[np.int64]
    start: NDArray[np.float64]
    end: NDArray[np.float64]
    out: NDArray[np.float64]


SPANS = Fields(Spans, (INTEGERS, INTEGERS, REALS, REALS, REALS_3D))


@functools.cache
def places(names: tuple[str, ...]) -> NDArray[np.int64]:
    """Return the places of some quantities in QUANTITIES, shape (names,)."""
    return np.array([QUANTITIES.index(name) for name in names], np.int64)


class SamplingWorkspace(NamedTuple):
    """Scratch memory of the sampler.

    Attributes:
        flight: one record of FLIGHT.
        step: one record of CONTACT_STEP.
        steps: records of STATE: the steps of a tabulated contact, and one more.
        polynomials: one for each quantity, shape (QUANTITIES, PIECE_TERMS).
        every: all quantities at one instant, shape (QUANTITIES,).
        powers: (λ half)^k / k! of a mode, real and imaginary part, shape (2, PIECE_TERMS).
        pulse: of a tabulated contact: time since the touch [s], δ [m], δ' [m/s]; shape (3,).
        pulsing: row of the state where that contact begins, shape (1,).
        tick: of a piece's nodes, shape (NODES,).
        offset: likewise.
        values: of all quantities at a piece's nodes, shape (QUANTITIES, NODES).
    """

    flight: NDArray[np.void]
    step: NDArray[np.void]
    steps: NDArray[np.void]
    polynomials: NDArray[np.float64]
    every: NDArray[np.float64]
    powers: NDArray[np.float64]
    pulse: NDArray[np.float64]
    pulsing: NDArray[np.int64]
    tick: NDArray[np.int64]
    offset: NDArray[np.float64]
    values: NDArray[np.float64]


SAMPLING_WORKSPACE = Fields(
    SamplingWorkspace,
    (FLIGHT, CONTACT_STEP, STATE, REALS_2D, REALS, REALS_2D, REALS, INTEGERS, INTEGERS, REALS, REALS_2D),
)


SAMPLED = MODEL, TRAJECTORY, SAMPLING_WORKSPACE
"""What a kernel takes that evaluates a motion, see `Motion.sampled`."""


def new_sampling_workspace() -> SamplingWorkspace:
    """Return scratch memory."""
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
def _place_and_order(p, quantity):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return (place in y, derivative of it, whether it is the drive itself) that a quantity of the structure is."""
    prescribed = p.drive_kind == PRESCRIBED
    if quantity in (OF_X_1, OF_V_1, OF_A_1):
        return X1 if quantity == OF_X_1 else V1, 1 if quantity == OF_A_1 else 0, False
    if quantity == OF_CURRENT:
        return COIL, 0, p.drive_kind != VOLTAGE
    order = 2 if quantity == OF_A_B else 1 if quantity == OF_V_B else 0
    if prescribed:
        return XB, order, True
    return XB if order == 0 else VB, max(0, order - 1), False


@kernel
def _fill_powers(work, rate, half):  # type: ignore[no-untyped-def]
    """Fill in (λ half)^k / k!; return how many terms of a series they make: of a straight line, for λ = 0, two."""
    scaled, term = rate * half, 1.0 + 0.0j
    terms = 2 if rate == 0.0 else PIECE_TERMS
    for k in range(terms):
        work.powers[0, k], work.powers[1, k] = term.real, term.imag
        term = term * scaled * (1.0 / (k + 1))
    return terms


@kernel
def _add_series(poly, work, terms, value, growth, rate, order, half):  # type: ignore[no-untyped-def]
    """Add the Taylor coefficients in x = τ / half of Re[(value + growth τ) exp(λ τ)], differentiated `order` times.

    They are made of as many powers of the rate λ in `work`.
    """
    for _ in range(order):
        value, growth = rate * value + growth, rate * growth
    re, im = work.powers[0], work.powers[1]
    value_re, value_im, growth_re, growth_im = value.real, value.imag, half * growth.real, half * growth.imag
    poly[0] += value_re * re[0] - value_im * im[0]
    for k in range(1, terms):
        poly[k] += (value_re * re[k] - value_im * im[k]) + (growth_re * re[k - 1] - growth_im * im[k - 1])


@kernel
def _expand_flight(p, system, f, flight, quantity, poly, since, work):  # type: ignore[no-untyped-def]
    """Fill the Taylor polynomial of a quantity of the structure, `since` seconds after the flight's beginning."""
    poly[:] = 0.0
    t = flight.t_b + since
    place, order, of_drive = _place_and_order(p, quantity)
    jw = complex(0.0, f.omega)
    rotor = phasor(f.omega * t) * complex(0.0, -1.0)  # Im(…) = Re(−j …)
    terms = _fill_powers(work, jw, 1.0)
    if of_drive:
        unit = phasor(f.phase) * rotor
        _add_series(poly, work, terms, (f.amplitude + f.growth * t) * unit, f.growth * unit, jw, order, 1.0)
        return
    steady, growing = flight.steady[place], flight.growing[place]
    _add_series(poly, work, terms, (steady + growing * t) * rotor, growing * rotor, jw, order, 1.0)
    for n in range(system.modes):
        rate = system.rate[n]
        _, decay = mode_decay(rate, since)
        terms = _fill_powers(work, rate, 1.0)
        _add_series(poly, work, terms, system.right[n, place] * flight.modal[n] * decay, 0.0j, rate, order, 1.0)
    if order == 0:
        poly[0] += system.static[place] * flight.friction_force


@kernel
def _is_of_structure(p, quantity):  # type: ignore[no-untyped-def]
    """Return whether a quantity is a motion of the structure or its drive: then it has a polynomial in flight."""
    of_sphere = quantity in (OF_X_2, OF_V_2, OF_A_2, OF_FORCE_LEFT, OF_FORCE_RIGHT)
    return not (of_sphere or (quantity == OF_CURRENT and p.drive_kind == PRESCRIBED))


@kernel
def _structure_quantity(s, quantity):  # type: ignore[no-untyped-def]
    """Return the quantity of the structure that this one follows from in flight."""
    if s.phase == ATTACHED:  # one body: the sphere moves as the structure, and a wall may push it
        if quantity in (OF_X_2, OF_V_2, OF_A_2):
            return quantity - 1  # x_1, v_1, a_1: each stands before the sphere's
        if quantity >= OF_FORCE_LEFT:
            return OF_A_1
    return quantity


@kernel
def _quantity_in_flight(p, s, quantity, poly, tau, since):  # type: ignore[no-untyped-def]
    """Return a quantity in the flight from s, by its polynomial, or where it has none by the sphere's parabola."""
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
    braking = -s.slide * p.friction_acceleration
    if quantity == OF_X_2:
        return s.y[X1] + s.d + since * (s.y[V1] + s.d_rate + 0.5 * since * braking)
    if quantity == OF_V_2:
        return s.y[V1] + s.d_rate + since * braking
    if quantity == OF_A_2:
        return braking
    return polynomial(poly, tau, PIECE_TERMS) if quantity < OF_FORCE_LEFT else 0.0


@kernel
def integrate_tabulated(model, f, step, steps):  # type: ignore[no-untyped-def]
    """Integrate the contact that begins at `steps[_MOST_STEPS]` into `steps[0]`, `steps[1]`, …; return their number.

    The last of them is its end, or where a step failed or room ran out. What it begins at is overwritten.
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
def last_before(history, low, high, t):  # type: ignore[no-untyped-def]
    """Return the last row in [low, high) that is not after t, or low."""
    while high - low > 1:
        middle = (low + high) // 2
        if history[middle].t <= t:
            low = middle
        else:
            high = middle
    return low


@kernel
def _length_to(s, step, end, since):  # type: ignore[no-untyped-def]
    """Return the length of the step that takes about `since` seconds, by the polynomial of the whole one.

    `s` is the state where it begins, `end` = (time it takes [s], w, δ').
    """
    low, high = 0.0, 1.0
    x = min(1.0, since / end[0])
    for _ in range(_ROOT_ROUNDS):
        at, w, _ = dense_output(s, step, x)
        if at > since:
            high = x
        else:
            low = x
        move = (since - at) / (w * s.h) if w > 0.0 else np.inf
        x += move
        if abs(move) <= _ROOT_FOUND:  # before a look at the limits: at the root, rounding puts x on one of them
            break
        if not low < x < high:
            x = 0.5 * (low + high)
    return min(max(x, 0.0), 1.0) * s.h


@kernel
def _solve_up_to(model, s, step, end, since):  # type: ignore[no-untyped-def]
    """Return (w, δ') `since` seconds after the start of a step: the step is taken again to end there."""
    if s.h == 0.0 or since <= 0.0:
        return s.w, s.speed
    h = s.h
    if since < end[0]:
        h = _length_to(s, step, end, since)
        for _ in range(_CORRECTIONS):
            solve(model.parameters[0], model.law, s, step, h, ROUNDS)
            if step.w[LAST] > 0.0:
                h = min(s.h, h - (step.since[LAST] - since) / step.w[LAST])
    solve(model.parameters[0], model.law, s, step, h, ROUNDS)
    return max(step.w[LAST], 0.0), step.speed[LAST]


@kernel
def _quantities_in_contact(model, f, s, step, at, exact, out):  # type: ignore[no-untyped-def]
    """Fill all quantities at a point of a contact's step, which begins at s; `step` is expanded there.

    The point is `at` = (time since the start of the step [s], w, δ'). If `exact`, the step has been solved to end
    there, and what the indentation moves the pair by is known; else that millionth is left out.
    """
    p, side = model.parameters[0], s.side
    since, w, speed = at
    t = s.t + since
    pair_at(step, since, step.y)
    if exact and since > 0.0:
        add_correction(p, side, step, LAST, step.y)
    depth = w * w
    elastic, lossy, _, _, _ = model.law.at_point(p.stiffness, p.factor, s.per_v0, step.turned_at, w, speed)
    force = max(0.0, elastic + lossy) if p.lets_go else elastic + lossy
    u, _ = drive(f, t)
    d = s.d + side * depth
    x_b, v_b = step.y[XB], step.y[VB]
    out[OF_X_1] = step.y[X1] - p.share * side * depth
    out[OF_V_1] = step.y[V1] - p.share * side * speed
    out[OF_X_2], out[OF_V_2] = out[OF_X_1] + d, out[OF_V_1] + side * speed
    columns = -p.k_1 * (out[OF_X_1] - x_b) - p.c_1 * (out[OF_V_1] - v_b)
    out[OF_A_1], out[OF_A_2] = (columns + side * force) * p.per_m_1, -side * force / p.m
    out[OF_X_B], out[OF_V_B] = x_b, v_b
    out[OF_FORCE_LEFT] = force if side < 0.0 else 0.0
    out[OF_FORCE_RIGHT] = force if side > 0.0 else 0.0
    if p.drive_kind == PRESCRIBED:
        _, cosine = sincos(f.omega * t + f.phase)
        out[OF_A_B], out[OF_CURRENT] = 2.0 * f.growth * f.omega * cosine - f.omega * f.omega * u, 0.0
        return
    out[OF_CURRENT] = step.y[COIL] if p.drive_kind == VOLTAGE else u
    on_base = p.force_factor * out[OF_CURRENT] - p.c_f * v_b - p.k_f * x_b - columns
    out[OF_A_B] = on_base * p.per_m_base


@kernel
def _solve_again(model, f, s, step):  # type: ignore[no-untyped-def]
    """Expand `step` about s and solve it again; return how it ends: (time it takes [s], w, δ')."""
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
def _sample_contact(model, f, history, row, start, stop, query, work):  # type: ignore[no-untyped-def]
    """Fill the query's instants start … stop − 1, all in the contact whose state is `history[row]`."""
    step, s = work.step[0], history[row]
    steps, low, high, current = history, row, row + 1, -1
    if s.tabulated:
        steps = work.steps
        steps[_MOST_STEPS] = s
        low, high = 0, integrate_tabulated(model, f, step, steps)
    end = 0.0, 0.0, 0.0
    for i in range(start, stop):
        t = query.offset[i] - f.begin
        row = last_before(steps, low, high, t)
        if row != current:
            current, end = row, _solve_again(model, f, steps[row], step)
        since = min(max(t - steps[row].t, 0.0), end[0])
        w, speed = _solve_up_to(model, steps[row], step, end, since)
        _quantities_in_contact(model, f, steps[row], step, (since, w, speed), True, work.every)
        for q in range(query.wanted.shape[0]):
            query.out[q, i] = work.every[query.wanted[q]]


@kernel
def begin_flight_at(model, f, s, flight):  # type: ignore[no-untyped-def]
    """Prepare the closed form of the flight that begins at s; return the system that flies."""
    renewed = choose_system(model, f, s, flight)
    system = model.systems[flight.system]
    if renewed:
        flight.interval = _INTERVAL_RADIANS / bound_omega(system, f.omega)
    particular(system, f, flight)
    flight.friction_force = guide_friction(model.parameters[0], s)
    begin_flight(system, f, flight, s.y, s.t)
    return system


@kernel
def _sample_flight(model, f, s, start, stop, query, work):  # type: ignore[no-untyped-def]
    """Fill the query's instants start … stop − 1, all in the flight that begins at s."""
    p, flight = model.parameters[0], work.flight[0]
    system = begin_flight_at(model, f, s, flight)
    expanded = -1
    for i in range(start, stop):
        since = query.offset[i] - f.begin - s.t
        interval = int(since / flight.interval)
        middle = (interval + 0.5) * flight.interval
        if interval != expanded:
            expanded = interval
            for q in range(query.wanted.shape[0]):
                quantity = _structure_quantity(s, query.wanted[q])
                if _is_of_structure(p, quantity):
                    _expand_flight(p, system, f, flight, quantity, work.polynomials[q], middle, work)
        for q in range(query.wanted.shape[0]):
            query.out[q, i] = _quantity_in_flight(p, s, query.wanted[q], work.polynomials[q], since - middle, since)


@kernel
def _rows_at(trajectory, tick, offset):  # type: ignore[no-untyped-def]
    """Return (row of the segment that holds an instant of a tick, row of the state there, row after its last)."""
    low, high = trajectory.first_segment[tick], trajectory.first_segment[tick + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if trajectory.segments[middle].begin <= offset:
            low = middle
        else:
            high = middle
    since, end = offset - trajectory.segments[low].begin, trajectory.first_state[low + 1]
    return low, last_before(trajectory.history, trajectory.first_state[low], end, since), end


@entry(*SAMPLED, QUERY, returns=bool)
def sample(model, trajectory, work, query):  # type: ignore[no-untyped-def]
    """Fill `query.out` and return whether there are such ticks.

    Instants in a row that share one row of the history are evaluated together.
    """
    work.flight[0].omega = -1.0
    return _sample(model, trajectory, query, work)


@kernel
def _sample(model, trajectory, query, work):  # type: ignore[no-untyped-def]
    n = query.offset.shape[0]
    i = 0
    while i < n:
        tick = query.tick[i] - trajectory.first_tick
        if not 0 <= tick < trajectory.first_segment.shape[0] - 1:
            return False
        segment, row, high = _rows_at(trajectory, tick, query.offset[i])
        f = drive_segment(trajectory.segments[segment])
        # since the start of the tick, as `offset`
        ends_in_tick = segment + 1 < trajectory.first_segment[tick + 1]
        segment_end = trajectory.segments[segment + 1].begin if ends_in_tick else np.inf
        begin = trajectory.history[row].t
        end = trajectory.history[row + 1].t if row + 1 < high else np.inf
        start = i
        i += 1
        while i < n and query.tick[i] - trajectory.first_tick == tick:
            if not (begin <= query.offset[i] - f.begin < end and query.offset[i] < segment_end):
                break
            i += 1
        if trajectory.history[row].phase == CONTACT:
            _sample_contact(model, f, trajectory.history, row, start, i, query, work)
        else:
            _sample_flight(model, f, trajectory.history[row], start, i, query, work)
    return True


@kernel
def _fit_flight(p, system, f, flight, spans, i, work):  # type: ignore[no-untyped-def]
    """Fill in the polynomials of a piece in the flight that has been prepared, all quantities of the structure."""
    half = 0.5 * (spans.end[i] - spans.start[i])
    t = 0.5 * (spans.start[i] + spans.end[i]) - f.begin
    since, wanted, poly = t - flight.t_b, spans.wanted, work.polynomials
    rotor = phasor(f.omega * t) * complex(0.0, -1.0)  # Im(…) = Re(−j …)
    jw = complex(0.0, f.omega)
    terms = _fill_powers(work, jw, half)
    for q in range(wanted.shape[0]):
        place, order, of_drive = _place_and_order(p, wanted[q])
        poly[q, :] = 0.0
        if of_drive:
            unit = phasor(f.phase) * rotor
            value, growth = (f.amplitude + f.growth * t) * unit, f.growth * unit
        else:
            growth = flight.growing[place] * rotor
            value = flight.steady[place] * rotor + growth * t
            if order == 0:
                poly[q, 0] = system.static[place] * flight.friction_force
        _add_series(poly[q], work, terms, value, growth, jw, order, half)
    for n in range(system.modes):
        rate = system.rate[n]
        _, decay = mode_decay(rate, since)
        modal = flight.modal[n] * decay
        terms = _fill_powers(work, rate, half)
        for q in range(wanted.shape[0]):
            place, order, of_drive = _place_and_order(p, wanted[q])
            if not of_drive:
                _add_series(poly[q], work, terms, system.right[n, place] * modal, 0.0j, rate, order, half)
    for q in range(wanted.shape[0]):
        shorten(poly[q], spans.out[q, i])


@kernel
def _fit_contact(model, f, history, row, spans, i, work):  # type: ignore[no-untyped-def]
    """Fill in the values at the nodes of a piece within one step of a contact, from the step's dense output."""
    step, s = work.step[0], history[row]
    t_middle, half = 0.5 * (spans.start[i] + spans.end[i]) - f.begin, 0.5 * (spans.end[i] - spans.start[i])
    end = _solve_again(model, f, s, step)
    for j in range(NODES):
        since, w, speed = 0.0, s.w, s.speed
        if s.h > 0.0:
            since = min(max(t_middle + half * NODE_AT[j] - s.t, 0.0), end[0])
            _, w, speed = dense_output(s, step, _length_to(s, step, end, since) / s.h)
        _quantities_in_contact(model, f, s, step, (since, max(w, 0.0), speed), False, work.every)
        for q in range(spans.wanted.shape[0]):
            work.values[q, j] = work.every[spans.wanted[q]]


@kernel
def _acceleration(model, step, per_v0, since, depth, speed):  # type: ignore[no-untyped-def]
    """Return δ'' in a tabulated contact, whose `step` is expanded about the touch."""
    p = model.parameters[0]
    elastic, lossy, _, _, _ = model.law.at_point(p.stiffness, p.factor, per_v0, 0.0, math.sqrt(max(0.0, depth)), speed)
    force = max(0.0, elastic + lossy) if p.lets_go else elastic + lossy
    relative = step.acceleration[0] + since * (step.acceleration[1] + since * step.acceleration[2])
    return relative - (p.slowing_by_depth * depth + p.slowing_by_speed * speed) - force * p.per_m_eff


@kernel
def _integrate_pulse(model, step, per_v0, pulse, until, longest):  # type: ignore[no-untyped-def]
    """Integrate `pulse` = (time since the touch, δ, δ') up to `until`, by Runge and Kutta's fourth order."""
    parts = math.ceil((until - pulse[0]) / longest)
    for part in range(parts):
        since, depth, speed = pulse[0], pulse[1], pulse[2]
        span = (until - since) / (parts - part)
        acceleration = _acceleration(model, step, per_v0, since, depth, speed)
        speed_2 = speed + 0.5 * span * acceleration
        middle = since + 0.5 * span
        acceleration_2 = _acceleration(model, step, per_v0, middle, depth + 0.5 * span * speed, speed_2)
        speed_3 = speed + 0.5 * span * acceleration_2
        acceleration_3 = _acceleration(model, step, per_v0, middle, depth + 0.5 * span * speed_2, speed_3)
        speed_4 = speed + span * acceleration_3
        acceleration_4 = _acceleration(model, step, per_v0, since + span, depth + span * speed_3, speed_4)
        pulse[0] = since + span
        pulse[1] = depth + span * (speed + 2.0 * (speed_2 + speed_3) + speed_4) * (1.0 / 6.0)
        accelerations = acceleration + 2.0 * (acceleration_2 + acceleration_3) + acceleration_4
        pulse[2] = speed + span * accelerations * (1.0 / 6.0)
    pulse[0] = until


@kernel
def _fit_pulse(model, f, history, row, spans, i, work):  # type: ignore[no-untyped-def]
    """Fill in the values at the nodes of a piece of a tabulated contact: it is integrated to them.

    These crowd at the ends of each piece, and so of the contact, where the force has its kinks. The force is wrong by
    at most 3e-4 of its peak.
    """
    p, step, pulse, s = model.parameters[0], work.step[0], work.pulse, history[row]
    since_middle, half = 0.5 * (spans.start[i] + spans.end[i]) - f.begin - s.t, 0.5 * (spans.end[i] - spans.start[i])
    if work.pulsing[0] != row or since_middle + half * NODE_AT[0] < pulse[0]:
        expand(p, f, s, step)
        step.turned_at = 0.0
        work.pulsing[0], pulse[0], pulse[1], pulse[2] = row, 0.0, 0.0, s.speed
    longest = (history[row + 1].t - s.t) / _PULSE_STEPS
    for j in range(NODES):
        _integrate_pulse(model, step, s.per_v0, pulse, since_middle + half * NODE_AT[j], longest)
        at = pulse[0], math.sqrt(max(0.0, pulse[1])), pulse[2]
        _quantities_in_contact(model, f, s, step, at, False, work.every)
        for q in range(spans.wanted.shape[0]):
            work.values[q, j] = work.every[spans.wanted[q]]


@kernel
def _fit_samples(model, trajectory, spans, i, work):  # type: ignore[no-untyped-def]
    """Fill in the values at the nodes of any other piece: samples of it.

    It holds more than one flight or step, or is too long, or the sphere or a force is wanted in flight.
    """
    centre, half = 0.5 * (spans.start[i] + spans.end[i]), 0.5 * (spans.end[i] - spans.start[i])
    for j in range(NODES):
        work.tick[j], work.offset[j] = spans.tick[i], centre + half * NODE_AT[j]
    _sample(model, trajectory, Query(spans.wanted, work.tick, work.offset, work.values), work)


@entry(MODEL, TRAJECTORY, SPANS, SAMPLING_WORKSPACE, returns=bool)
def fit(model, trajectory, spans, work):  # type: ignore[no-untyped-def]
    """Fill `spans.out` and return whether there are such ticks.

    In flight the fastest motion goes at most 2 radians either side of a piece's middle. There the series leaves out
    2^14 / 14! = 2e-7 of it, and its shortening to eight terms 2 / 8! = 5e-5; longer pieces go through
    samples. In a step of a contact a millionth is left out, in a tabulated contact up to a thousandth of the pulse.
    """
    p, flight, history = model.parameters[0], work.flight[0], trajectory.history
    flight.omega, work.pulsing[0] = -1.0, -1
    structure_alone = True
    for q in range(spans.wanted.shape[0]):
        structure_alone = structure_alone and _is_of_structure(p, spans.wanted[q])
    prepared = -1  # row of the state that the flight at hand begins at
    for i in range(spans.start.shape[0]):
        tick = spans.tick[i] - trajectory.first_tick
        if not 0 <= tick < trajectory.first_segment.shape[0] - 1:
            return False
        middle = 0.5 * (spans.start[i] + spans.end[i])
        segment, row, high = _rows_at(trajectory, tick, middle)
        f = drive_segment(trajectory.segments[segment])
        ends_inside = (
            spans.end[i] - f.begin
            <= (history[row + 1].t if row + 1 < high else trajectory.segments[segment].duration) + _SAME
        )
        inside = spans.start[i] - f.begin >= history[row].t - _SAME and ends_inside
        if inside and history[row].phase == CONTACT and not (history[row].tabulated and p.remembers):
            if history[row].tabulated:
                _fit_pulse(model, f, history, row, spans, i, work)
            else:
                _fit_contact(model, f, history, row, spans, i, work)
                work.pulsing[0] = -1
        else:
            if inside and structure_alone:
                if row != prepared:
                    begin_flight_at(model, f, history[row], flight)
                    prepared = row
                if spans.end[i] - spans.start[i] <= _LONGEST * flight.interval:
                    _fit_flight(p, model.systems[flight.system], f, flight, spans, i, work)
                    continue
            _fit_samples(model, trajectory, spans, i, work)
            prepared, work.pulsing[0] = -1, -1
        for q in range(spans.wanted.shape[0]):
            through_nodes(work.values[q], spans.out[q, i])
    return True


PARTS = 3
"""Pieces in which a tabulated contact is smooth enough for the instruments' polynomials."""


@entry(TRAJECTORY, INTEGERS, REALS, returns=int)
def refine(trajectory, tick, offset):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Fill in tick and offset [s] of the instants between which all is smooth; return how many there are.

    The arrays have room for PARTS instants a state.
    """
    history, first_state, count = trajectory.history, trajectory.first_state, 0
    i = -1
    for segment in range(first_state.shape[0] - 1):
        begin = trajectory.segments[segment].begin
        if segment == trajectory.first_segment[i + 1]:
            i += 1
        for row in range(first_state[segment], first_state[segment + 1]):
            s = history[row]
            tick[count], offset[count] = trajectory.first_tick + i, begin + s.t
            count += 1
            if s.phase == CONTACT and s.tabulated != 0:
                length = history[row + 1].t - s.t
                for part in range(1, PARTS):
                    tick[count], offset[count] = trajectory.first_tick + i, begin + (s.t + length * (part / PARTS))
                    count += 1
    return count
