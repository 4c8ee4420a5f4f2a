# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The exact response of a sensor's modes to a motion, read off at the instants of conversion.

Each mode follows z' = p z + u, the output is Σ Re(r z). Over a step of length h in which u = Σ d_j (τ − 1/2)^j, with
τ = t/h and j = 0 … 3,

    z(h) = e^{ph} z(0) + Σ_j d_j W_j,    W_j = h ∫_0^1 e^{ph(1−τ)} (τ − 1/2)^j dτ

exactly, however long the step is against 1/p. Steps end at conversions and wherever the motion is rough; those between
two conversions are "whole": all of the same length, they share their weights. A step is at most 100 µs and a quarter of
a piece, and u is taken from the piece's polynomial, d_j = (h / half piece)^j u^(j)(x) / j!: no pulse falls between two
scans. With q = ph and φ_k = ∫_0^1 e^{q(1−τ)} τ^{k−1} / (k−1)! dτ, so that φ_k = (φ_{k−1} − 1/(k−1)!) / q and φ_0 = e^q,

    W_0 = h φ_1         W_1 = h (φ_2 − φ_1/2)
    W_2 = h (2 φ_3 − φ_2 + φ_1/4)       W_3 = h (6 φ_4 − 3 φ_3 + 3/4 φ_2 − φ_1/8)
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp, sincos
from impact_rig.instruments.clock import ScanClock
from impact_rig.instruments.pieces import NODES, PIECES, Pieces
from impact_rig.instruments.sensor import Modes
from impact_rig.kernels import INTEGERS, REALS, TABLE, Fields, entry, kernel, records

_PER_FACTORIAL = np.array([1 / math.factorial(k) for k in range(26)])


class Weights(NamedTuple):
    """What one step does to one mode: e^{ph} and W_j [s], each with its real and imaginary part."""

    decay_re: float
    decay_im: float
    w0_re: float
    w0_im: float
    w1_re: float
    w1_im: float
    w2_re: float
    w2_im: float
    w3_re: float
    w3_im: float


@kernel
def weigh(pole_re, pole_im, h):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return the weights of a step of h seconds for the mode with that pole [rad/s]."""
    q_re, q_im = pole_re * h, pole_im * h
    if abs(q_re) + abs(q_im) < 2.0:
        e, phi1, phi2, phi3, phi4 = _by_series(q_re, q_im)
    else:
        e, phi1, phi2, phi3, phi4 = _by_division(q_re, q_im)
    return Weights(
        e[0],
        e[1],
        h * phi1[0],
        h * phi1[1],
        h * (phi2[0] - 0.5 * phi1[0]),
        h * (phi2[1] - 0.5 * phi1[1]),
        h * (2.0 * phi3[0] - phi2[0] + 0.25 * phi1[0]),
        h * (2.0 * phi3[1] - phi2[1] + 0.25 * phi1[1]),
        h * (6.0 * phi4[0] - 3.0 * phi3[0] + 0.75 * phi2[0] - 0.125 * phi1[0]),
        h * (6.0 * phi4[1] - 3.0 * phi3[1] + 0.75 * phi2[1] - 0.125 * phi1[1]),
    )


@kernel
def _by_series(q_re, q_im):  # type: ignore[no-untyped-def]
    """Return e^q and φ_1 … φ_4 for small q: φ_4 = Σ q^i / (i + 4)!, then φ_{k−1} = 1/(k−1)! + q φ_k."""
    size = abs(q_re) + abs(q_im)
    terms = 8 if size < 0.1 else 13 if size < 0.5 else 22
    re, im = _PER_FACTORIAL[terms + 3], 0.0
    for i in range(terms + 2, 3, -1):
        re, im = _PER_FACTORIAL[i] + (q_re * re - q_im * im), q_re * im + q_im * re
    phi4 = (re, im)
    phi3 = _one_up(q_re, q_im, phi4, 1.0 / 6.0)
    phi2 = _one_up(q_re, q_im, phi3, 0.5)
    phi1 = _one_up(q_re, q_im, phi2, 1.0)
    return _one_up(q_re, q_im, phi1, 1.0), phi1, phi2, phi3, phi4


@kernel
def _one_up(q_re, q_im, phi, constant):  # type: ignore[no-untyped-def]
    return constant + (q_re * phi[0] - q_im * phi[1]), q_re * phi[1] + q_im * phi[0]


@kernel
def _by_division(q_re, q_im):  # type: ignore[no-untyped-def]
    """Return e^q and φ_1 … φ_4 for large q: φ_k = (φ_{k−1} − 1/(k−1)!) / q."""
    size = exp(q_re)
    sine, cosine = sincos(q_im)
    e = (size * cosine, size * sine)
    phi1 = _one_down(q_re, q_im, e, 1.0)
    phi2 = _one_down(q_re, q_im, phi1, 1.0)
    phi3 = _one_down(q_re, q_im, phi2, 0.5)
    return e, phi1, phi2, phi3, _one_down(q_re, q_im, phi3, 1.0 / 6.0)


@kernel
def _one_down(q_re, q_im, phi, constant):  # type: ignore[no-untyped-def]
    per_square = 1.0 / (q_re * q_re + q_im * q_im)
    real = phi[0] - constant
    return (real * q_re + phi[1] * q_im) * per_square, (phi[1] * q_re - real * q_im) * per_square


HIGHEST = NODES - 1
SHORT = 0.25
"""A step is at most this part of its piece: four terms about its middle then hold what eight hold on the piece."""

MODE = np.dtype(
    [(name, "f8") for name in ("pole_re", "pole_im", "residue_re", "residue_im", "z_re", "z_im", *Weights._fields)]
)
"""Pole [rad/s], residue, value z now [unit s], and the weights of a whole step."""

CURSOR = np.dtype([("due", "i8"), ("substep", "i8"), ("since_s", "f8"), ("piece", "i8"), ("written", "i8")])
"""Where a response is: the next step's end in this tick [clock units] and its number in the scan (0: a conversion);
time run of this tick; the piece it is in; readings written by this call."""


class Clock(NamedTuple):
    """The scan clock, for compiled code [clock units]."""

    step: int
    tick: int
    substeps: int


CLOCK = Fields(Clock, (int, int, int))


class Steps(NamedTuple):
    """Whole steps run together: middle in their piece (−1 … 1), shape (n,), and d_j about it, shape (4, n)."""

    middle: NDArray[np.float64]
    d: NDArray[np.float64]


STEPS = Fields(Steps, (REALS, TABLE))


class Task(NamedTuple):
    """What does not change during a run: the clock, the pieces with their polynomials, room for steps and outputs."""

    clock: Clock
    pieces: Pieces
    coefficients: NDArray[np.float64]
    steps: Steps
    out: NDArray[np.float64]


class Response:
    """Runs one channel's modes over a motion and remembers where it is.

    Attributes:
        modes: the chain's partial fractions.
        converted: how many scans have been converted.
    """

    def __init__(self, modes: Modes, clock: ScanClock, channel: int) -> None:
        self.modes = modes
        self.converted = 0
        self._channel = channel
        self._cursor = records(1, CURSOR)
        self._cursor["due"] = clock.skews[channel]
        self._weights_for = math.nan  # tick for which whole steps are weighed
        self._set(modes, clock)

    def adopt(self, modes: Modes, clock: ScanClock, *, keep_state: bool) -> None:
        """Go on with other modes, or another clock of the same rate; without `keep_state` the modes start from zero."""
        self._cursor["due"] += clock.skews[self._channel] - self._scan_clock.skews[self._channel]
        before = self._modes
        self._set(modes, clock)
        if keep_state:
            self._modes["z_re"], self._modes["z_im"] = before["z_re"], before["z_im"]

    def settle(self, level: float) -> None:
        """Go on as if the input had been at `level` for ever: z = −level / pole."""
        real, imag = self._modes["pole_re"], self._modes["pole_im"]
        square = real * real + imag * imag
        self._modes["z_re"], self._modes["z_im"] = -level * real / square, level * imag / square

    def run(self, pieces: Pieces, coefficients: NDArray[np.float64], kicks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Run over the next ticks and return the output at each conversion in them, shape (n,).

        Args:
            pieces: the ticks, cut.
            coefficients: polynomial of the input on each piece, shape (pieces, NODES).
            kicks: impulse of the input at the start of each piece (its unit times seconds), shape (pieces,).
        """
        if self._weights_for != pieces.tick_s:
            weigh_whole(self._modes, pieces.tick_s * self._scan_clock.step_fraction())
            self._weights_for = pieces.tick_s
        out = np.empty((len(pieces.first) - 1) * self._most)
        count = run(self._modes, self._clock, self._cursor, pieces, coefficients, kicks, self._steps, out)
        self.converted += count
        return out[:count]

    def instants(self, ticks: int, motion_tick: int, tick_s: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the next conversions themselves as (tick, offset [s]): for instruments without dynamics."""
        at_tick, offset = np.empty(ticks * self._most, np.int64), np.empty(ticks * self._most)
        count = instants(self._clock, self._cursor, ticks, tick_s, at_tick, offset)
        self.converted += count
        return at_tick[:count] + motion_tick, offset[:count]

    def _set(self, modes: Modes, clock: ScanClock) -> None:
        self.modes = modes
        self._modes = records(len(modes.poles), MODE)
        self._modes["pole_re"], self._modes["pole_im"] = modes.poles.real, modes.poles.imag
        self._modes["residue_re"], self._modes["residue_im"] = modes.residues.real, modes.residues.imag
        self._weights_for = math.nan
        self._scan_clock: ScanClock = clock
        self._clock: Clock = Clock(clock.step, clock.tick, clock.substeps)
        room = clock.tick // clock.step + 2
        self._steps = Steps(np.empty(room), np.empty((4, room)))
        self._most: int = clock.scans_per_tick() + 1  # conversions in a tick


@entry(MODE, float)
def weigh_whole(modes, h):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Give every mode the weights of whole steps of h seconds."""
    for k in range(modes.shape[0]):
        mode = modes[k]
        w = weigh(mode.pole_re, mode.pole_im, h)
        mode.decay_re, mode.decay_im = w.decay_re, w.decay_im
        mode.w0_re, mode.w0_im, mode.w1_re, mode.w1_im = w.w0_re, w.w0_im, w.w1_re, w.w1_im
        mode.w2_re, mode.w2_im, mode.w3_re, mode.w3_im = w.w2_re, w.w2_im, w.w3_re, w.w3_im


@entry(MODE, CLOCK, CURSOR, PIECES, TABLE, REALS, STEPS, REALS, returns=int)
def run(modes, clock, cursor, pieces, coefficients, kicks, steps, out):  # type: ignore[no-untyped-def]
    """Run the modes over all pieces; fill `out`, return the number of readings. `steps` has room for a tick."""
    task = Task(clock, pieces, coefficients, steps, out)
    at = cursor[0]
    at.written, out[:] = 0, 0.0
    for tick in range(pieces.first.shape[0] - 1):
        at.since_s, at.piece = 0.0, pieces.first[tick]
        while at.piece < pieces.first[tick + 1]:  # from one rough instant to the next
            last = at.piece
            while not pieces.hard[last]:
                last += 1
            for k in range(modes.shape[0]):
                modes[k].z_re += kicks[at.piece]
            _smooth_stretch(modes, task, at, last)
            at.piece = last + 1
        at.due -= clock.tick
    return at.written


@kernel
def _smooth_stretch(modes, task, at, last):  # type: ignore[no-untyped-def]
    """Run to the end of the piece `last`, between which and here the motion is smooth."""
    clock, tick_s = task.clock, task.pieces.tick_s
    until = task.pieces.end[last]
    while at.due < clock.tick and tick_s * (at.due / clock.tick) <= until:
        _odd_steps(modes, task, at, last, tick_s * (at.due / clock.tick))
        if at.substep == 0:
            task.out[at.written] = _output(modes)
        _count(clock, at, 1)
        _whole_steps(modes, task, at, last)
    _odd_steps(modes, task, at, last, until)


@kernel
def _odd_steps(modes, task, at, last, t):  # type: ignore[no-untyped-def]
    """Go on to the time t, which is no whole step away; through as many pieces as lie between."""
    start, end = task.pieces.start, task.pieces.end
    since = at.since_s
    if not t > since:
        return
    parts = max(1, math.ceil((t - since) / (SHORT * (end[at.piece] - start[at.piece]))))
    for part in range(parts):
        low = since + (t - since) * (part / parts)
        high = t if part + 1 == parts else since + (t - since) * ((part + 1) / parts)
        h, middle = high - low, 0.5 * (low + high)
        while at.piece < last and end[at.piece] < middle:
            at.piece += 1
        first, final = start[at.piece], end[at.piece]
        per_half = 2.0 / (final - first)
        d_0, d_1, d_2, d_3 = _about(
            task.coefficients, at.piece, (middle - 0.5 * (first + final)) * per_half, h * per_half
        )
        for k in range(modes.shape[0]):
            mode = modes[k]
            w = weigh(mode.pole_re, mode.pole_im, h)
            z_re, z_im = mode.z_re, mode.z_im
            u_re = (w.w0_re * d_0 + w.w1_re * d_1) + (w.w2_re * d_2 + w.w3_re * d_3)
            u_im = (w.w0_im * d_0 + w.w1_im * d_1) + (w.w2_im * d_2 + w.w3_im * d_3)
            mode.z_re = (w.decay_re * z_re + u_re) - w.decay_im * z_im
            mode.z_im = (w.decay_re * z_im + u_im) + w.decay_im * z_re
    at.since_s = t


@kernel
def _whole_steps(modes, task, at, last):  # type: ignore[no-untyped-def]
    """Run whole steps from a conversion on, piece by piece, each in the piece that holds its middle."""
    start, end, clock = task.pieces.start, task.pieces.end, task.clock
    whole = task.pieces.tick_s * (clock.step / clock.tick)
    until = end[last]
    while whole <= SHORT * (end[at.piece] - start[at.piece]):
        bound = until if at.piece == last else min(until, end[at.piece] + 0.5 * whole)
        count = _steps_in_piece(task, at, whole, bound)
        for k in range(modes.shape[0]):
            if modes[k].pole_im == 0.0:
                _follow_real(modes[k], task, at, count)
            else:
                _follow_pair(modes[k], task, at, count)
        _count(clock, at, count)
        if at.piece == last or bound == until or at.due >= clock.tick:
            break
        at.piece += 1


@kernel
def _steps_in_piece(task, at, whole, bound):  # type: ignore[no-untyped-def]
    """Note the inputs of the whole steps that end by `bound`, go on to the last's end; return how many there are."""
    clock, steps, tick_s = task.clock, task.steps, task.pieces.tick_s
    first, final = task.pieces.start[at.piece], task.pieces.end[at.piece]
    per_half, centre = 2.0 / (final - first), 0.5 * (first + final)
    due, t, count = at.due, at.since_s, 0
    while due < clock.tick:
        ends = tick_s * (due / clock.tick)
        if ends > bound:
            break
        steps.middle[count] = (ends - 0.5 * whole - centre) * per_half
        t = ends
        count += 1
        due += clock.step
    at.since_s = t
    _expand(task.coefficients, at.piece, whole * per_half, steps.middle[:count], steps.d)
    return count


@kernel
def _expand(coefficients, piece, r, middle, d):  # type: ignore[no-untyped-def]
    """Fill in d_j about the middles of steps of r half pieces."""
    for m in range(middle.shape[0]):
        d[0, m], d[1, m], d[2, m], d[3, m] = _about(coefficients, piece, middle[m], r)


@kernel
def _about(coefficients, piece, x, r):  # type: ignore[no-untyped-def]
    """Return d_0 … d_3 about x in a piece, for a step of r half pieces: d_j = r^j u^(j)(x) / j!, by Horner's rule."""
    d_0, d_1, d_2, d_3 = coefficients[piece, HIGHEST], 0.0, 0.0, 0.0
    for k in range(HIGHEST - 1, -1, -1):
        d_3 = d_3 * x + d_2
        d_2 = d_2 * x + d_1
        d_1 = d_1 * x + d_0
        d_0 = d_0 * x + coefficients[piece, k]
    return d_0, d_1 * r, d_2 * r * r, d_3 * r * r * r


@kernel
def _follow_real(mode, task, at, count):  # type: ignore[no-untyped-def]
    """Run a real mode over the noted whole steps; add what it puts out at every conversion to the readings."""
    d, out, substeps = task.steps.d, task.out, task.clock.substeps
    decay, residue, z = mode.decay_re, mode.residue_re, mode.z_re
    w0, w1, w2, w3 = mode.w0_re, mode.w1_re, mode.w2_re, mode.w3_re
    put, substep = at.written, at.substep
    for m in range(count):
        z = decay * z + ((w0 * d[0, m] + w1 * d[1, m]) + (w2 * d[2, m] + w3 * d[3, m]))
        if substep == 0:
            out[put] += residue * z
            put += 1
        substep = substep + 1 if substep + 1 < substeps else 0
    mode.z_re = z


@kernel
def _follow_pair(mode, task, at, count):  # type: ignore[no-untyped-def]
    """The same for a complex mode, which stands for itself and its conjugate."""
    d, out, substeps = task.steps.d, task.out, task.clock.substeps
    decay_re, decay_im, residue_re, residue_im = mode.decay_re, mode.decay_im, mode.residue_re, mode.residue_im
    w0_re, w1_re, w2_re, w3_re = mode.w0_re, mode.w1_re, mode.w2_re, mode.w3_re
    w0_im, w1_im, w2_im, w3_im = mode.w0_im, mode.w1_im, mode.w2_im, mode.w3_im
    z_re, z_im, put, substep = mode.z_re, mode.z_im, at.written, at.substep
    for m in range(count):
        u_re = (w0_re * d[0, m] + w1_re * d[1, m]) + (w2_re * d[2, m] + w3_re * d[3, m])
        u_im = (w0_im * d[0, m] + w1_im * d[1, m]) + (w2_im * d[2, m] + w3_im * d[3, m])
        before = z_re
        z_re = (decay_re * z_re + u_re) - decay_im * z_im
        z_im = (decay_re * z_im + u_im) + decay_im * before
        if substep == 0:
            out[put] += residue_re * z_re - residue_im * z_im
            put += 1
        substep = substep + 1 if substep + 1 < substeps else 0
    mode.z_re, mode.z_im = z_re, z_im


@kernel
def _output(modes):  # type: ignore[no-untyped-def]
    """Return Σ Re(residue z)."""
    total = 0.0
    for k in range(modes.shape[0]):
        mode = modes[k]
        total += mode.residue_re * mode.z_re - mode.residue_im * mode.z_im
    return total


@kernel
def _count(clock, at, steps):  # type: ignore[no-untyped-def]
    """Count steps that have been run, and the conversions at which some of them ended."""
    at.due += steps * clock.step
    # multiples of substeps in substep … substep + steps − 1
    at.written += (at.substep + steps - 1) // clock.substeps - (at.substep - 1) // clock.substeps
    at.substep = (at.substep + steps) % clock.substeps


@entry(CLOCK, CURSOR, int, float, INTEGERS, REALS, returns=int)
def instants(clock, cursor, ticks, tick_s, at_tick, offset):  # type: ignore[no-untyped-def]
    """Fill in when the next conversions come: tick and offset into it [s]; return how many."""
    at = cursor[0]
    count = 0
    for tick in range(ticks):
        while at.due < clock.tick:
            if at.substep == 0:
                at_tick[count] = tick
                offset[count] = max(0.0, tick_s * (at.due / clock.tick))
                count += 1
            at.substep = at.substep + 1 if at.substep + 1 < clock.substeps else 0
            at.due += clock.step
        at.due -= clock.tick
    return count
