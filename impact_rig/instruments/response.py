"""The exact response of a sensor's modes to a motion, read off at the instants of conversion.

Each mode follows z' = p z + u. Over a step of length h in which u = Σ d_j (τ − 1/2)^j, τ = t/h in 0 … 1 and j = 0 … 3,

    z(h) = e^{ph} z(0) + Σ_j d_j W_j,    W_j = h ∫_0^1 e^{ph(1−τ)} (τ − 1/2)^j dτ

exactly, however long the step is against 1/p. Steps end at conversions and wherever the motion is rough; those between
two conversions all have the same length and share their weights. A step is at most 100 µs and a quarter of a piece, and
u is taken from the piece's polynomial: no pulse falls between two scans.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from impact_rig.instruments.clock import ScanClock
from impact_rig.instruments.pieces import NODES, Pieces
from impact_rig.instruments.transfer import Modes

TERMS = 4
LAST = NODES - 1
SHORT = 0.25
"""A step is at most this part of its piece: four terms about its middle then hold what eight hold on the piece."""


class _Steps(NamedTuple):
    """The scan clock, for compiled code."""

    step: int
    tick: int
    substeps: int


class _Running(NamedTuple):
    """Modes and the weights of a whole step, for compiled code."""

    poles: NDArray[np.complex128]
    residues: NDArray[np.complex128]
    decay: NDArray[np.complex128]
    weights: NDArray[np.complex128]


class Response:
    """Runs one channel's modes over a motion and remembers where it is.

    Attributes:
        modes: the chain's partial fractions.
        state: their values now, complex, shape (k,).
        converted: how many scans have been converted.
    """

    def __init__(self, modes: Modes, clock: ScanClock, channel: int) -> None:
        self.modes = modes
        self.state = np.zeros(len(modes.poles), dtype=np.complex128)
        self.converted = 0
        self._clock = clock
        self._channel = channel
        self._cursor = np.array([clock.skews[channel], 0], dtype=np.int64)  # next step's end in this tick, its substep
        self._weights_for = math.nan
        self._decay = np.empty(0, dtype=np.complex128)
        self._weights = np.empty((0, TERMS), dtype=np.complex128)

    def adopt(self, modes: Modes, clock: ScanClock, *, keep_state: bool) -> None:
        """Go on with other modes, or another clock of the same rate; without `keep_state` the modes start from zero."""
        self._cursor[0] += clock.skews[self._channel] - self._clock.skews[self._channel]
        self._clock = clock
        self._weights_for = math.nan
        if not keep_state:
            self.state = np.zeros(len(modes.poles), dtype=np.complex128)
        self.modes = modes

    def run(self, pieces: Pieces, coefficients: NDArray[np.float64], kicks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Run over the next ticks and return the output at each conversion in them, shape (n,).

        Args:
            pieces: the ticks, cut.
            coefficients: polynomial of the input on each piece, shape (pieces, NODES).
            kicks: impulse of the input at the start of each piece (its unit times seconds), shape (pieces,).
        """
        clock, tick_s = self._clock, pieces.tick_s
        if self._weights_for != tick_s:
            self._decay, self._weights = step_weights(self.modes.poles, tick_s * clock.step_fraction())
            self._weights_for = tick_s
        running = _Running(self.modes.poles, self.modes.residues, self._decay, self._weights)
        out = np.empty((len(pieces.first) - 1) * (clock.scans_per_tick() + 1))
        count = _run(pieces, coefficients, kicks, self._steps(), self._cursor, running, self.state, out)
        self.converted += count
        return out[:count]

    def instants(self, ticks: int, first_segment: int, tick_s: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the next conversions themselves as (segment, offset [s]): for instruments without dynamics."""
        clock = self._clock
        size = ticks * (clock.scans_per_tick() + 1)
        segment, offset = np.empty(size, np.int64), np.empty(size)
        count = _instants(ticks, first_segment, tick_s, self._steps(), self._cursor, segment, offset)
        self.converted += count
        return segment[:count], offset[:count]

    def _steps(self) -> _Steps:
        return _Steps(self._clock.step, self._clock.tick, self._clock.substeps)


@njit(cache=True, nogil=True)
def weigh(z, h):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return e^z and W_0 … W_3 for z = p h, from φ_k(z) = ∫_0^1 e^{z(1−τ)} τ^{k−1} / (k−1)! dτ."""
    size = abs(z.real) + abs(z.imag)
    if size < 2.0:  # Taylor for φ_4, then downwards: no cancellation
        terms = 8 if size < 0.1 else 13 if size < 0.5 else 22
        term = 1.0 / 24.0 + 0.0j
        phi4 = term
        for i in range(1, terms):
            term *= z / (i + 4)
            phi4 += term
        phi3 = 1.0 / 6.0 + z * phi4
        phi2 = 0.5 + z * phi3
        phi1 = 1.0 + z * phi2
        e = 1.0 + z * phi1
    else:
        decay = math.exp(z.real)
        e = complex(decay * math.cos(z.imag), decay * math.sin(z.imag))
        phi1 = (e - 1.0) / z
        phi2 = (phi1 - 1.0) / z
        phi3 = (phi2 - 0.5) / z
        phi4 = (phi3 - 1.0 / 6.0) / z
    return (
        e,
        h * phi1,
        h * (phi2 - 0.5 * phi1),
        h * (2.0 * phi3 - phi2 + 0.25 * phi1),
        h * (6.0 * phi4 - 3.0 * phi3 + 0.75 * phi2 - 0.125 * phi1),
    )


@njit(cache=True, nogil=True)
def step_weights(poles, h):  # type: ignore[no-untyped-def]
    """Return e^{ph}, shape (k,), and W, shape (k, TERMS), for steps of length h."""
    decay, weights = np.empty_like(poles), np.empty((poles.shape[0], TERMS), np.complex128)
    for k in range(poles.shape[0]):
        decay[k], weights[k, 0], weights[k, 1], weights[k, 2], weights[k, 3] = weigh(poles[k] * h, h)
    return decay, weights


@njit(cache=True, nogil=True, inline="always")
def _local(c, i, x, r):  # type: ignore[no-untyped-def]
    """Return d_0 … d_3 of piece i about x for a step of r half pieces: its Taylor coefficients there, scaled."""
    d0, d1, d2, d3 = c[i, LAST], 0.0, 0.0, 0.0
    for k in range(LAST - 1, -1, -1):
        d3 = d3 * x + d2
        d2 = d2 * x + d1
        d1 = d1 * x + d0
        d0 = d0 * x + c[i, k]
    return d0, d1 * r, d2 * r * r, d3 * r * r * r


@njit(cache=True, nogil=True)
def _odd(poles, state, c, i, last, start, end, pos, t):  # type: ignore[no-untyped-def]
    """Go from pos to t, which is no whole step; return the piece that was used last."""
    parts = max(1, math.ceil((t - pos) / (SHORT * (end[i] - start[i]))))
    for part in range(parts):
        low = pos + (t - pos) * (part / parts)
        high = t if part + 1 == parts else pos + (t - pos) * ((part + 1) / parts)
        h, middle = high - low, 0.5 * (low + high)
        while i < last and end[i] < middle:
            i += 1
        per_half = 2.0 / (end[i] - start[i])
        d0, d1, d2, d3 = _local(c, i, (middle - 0.5 * (start[i] + end[i])) * per_half, h * per_half)
        for k in range(poles.shape[0]):
            e, w0, w1, w2, w3 = weigh(poles[k] * h, h)
            state[k] = e * state[k] + (w0 * d0 + w1 * d1 + w2 * d2 + w3 * d3)
    return i


@njit(cache=True, nogil=True)
def _whole(mode, running, state, n, d, sub, substeps, out, count):  # type: ignore[no-untyped-def]
    """Run one mode over n whole steps with the inputs d, adding to `out` what it puts out at every conversion."""
    decay, residue = running.decay[mode], running.residues[mode]
    w0, w1 = running.weights[mode, 0], running.weights[mode, 1]
    w2, w3 = running.weights[mode, 2], running.weights[mode, 3]
    real, imag = state[mode].real, state[mode].imag
    if running.poles[mode].imag == 0.0:
        for m in range(n):
            answer = (w0.real * d[0, m] + w1.real * d[1, m]) + (w2.real * d[2, m] + w3.real * d[3, m])
            real = decay.real * real + answer
            if sub == 0:
                out[count] += residue.real * real
                count += 1
            sub = sub + 1 if sub + 1 < substeps else 0
    else:
        for m in range(n):
            answer = (w0.real * d[0, m] + w1.real * d[1, m]) + (w2.real * d[2, m] + w3.real * d[3, m])
            beside = (w0.imag * d[0, m] + w1.imag * d[1, m]) + (w2.imag * d[2, m] + w3.imag * d[3, m])
            before = real
            real = (decay.real * real + answer) - decay.imag * imag
            imag = (decay.real * imag + beside) + decay.imag * before
            if sub == 0:
                out[count] += residue.real * real - residue.imag * imag
                count += 1
            sub = sub + 1 if sub + 1 < substeps else 0
    state[mode] = complex(real, imag)


@njit(cache=True, nogil=True)
def _run(pieces, c, kicks, clock, cursor, running, state, out):  # type: ignore[no-untyped-def]
    first, start, end, tick_s = pieces.first, pieces.start, pieces.end, pieces.tick_s
    modes = running.poles.shape[0]
    whole = tick_s * (clock.step / clock.tick)
    room = clock.tick // clock.step + 2
    places, d = np.empty(room), np.empty((TERMS, room))
    out[:] = 0.0
    count = 0
    due, sub = cursor[0], cursor[1]
    for k in range(first.shape[0] - 1):
        pos = 0.0
        i = first[k]
        while i < first[k + 1]:  # from one rough instant to the next
            last = i
            while not pieces.hard[last]:
                last += 1
            until = end[last]
            for mode in range(modes):
                state[mode] += kicks[i]
            while due < clock.tick and tick_s * (due / clock.tick) <= until:
                t = tick_s * (due / clock.tick)  # up to the next step's end
                if t > pos:
                    i = _odd(running.poles, state, c, i, last, start, end, pos, t)
                    pos = t
                if sub == 0:
                    for mode in range(modes):
                        z, residue = state[mode], running.residues[mode]
                        out[count] += residue.real * z.real - residue.imag * z.imag
                    count += 1
                sub = sub + 1 if sub + 1 < clock.substeps else 0
                due += clock.step
                while whole <= SHORT * (end[i] - start[i]):  # whole steps, as many as have their middle in one piece
                    per_half, centre = 2.0 / (end[i] - start[i]), 0.5 * (start[i] + end[i])
                    bound = until if i == last else min(until, end[i] + 0.5 * whole)
                    n = 0
                    while due < clock.tick:
                        t = tick_s * (due / clock.tick)
                        if t > bound:
                            break
                        places[n] = (t - 0.5 * whole - centre) * per_half
                        pos = t
                        n += 1
                        due += clock.step
                    r = whole * per_half
                    for m in range(n):
                        d[0, m], d[1, m], d[2, m], d[3, m] = _local(c, i, places[m], r)
                    for mode in range(modes):
                        _whole(mode, running, state, n, d, sub, clock.substeps, out, count)
                    for _ in range(n):
                        count += sub == 0
                        sub = sub + 1 if sub + 1 < clock.substeps else 0
                    if i == last or bound == until or due >= clock.tick:
                        break
                    i += 1
            if until > pos:
                i = _odd(running.poles, state, c, i, last, start, end, pos, until)
            pos = until
            i = last + 1
        due -= clock.tick
    cursor[0], cursor[1] = due, sub
    return count


@njit(cache=True, nogil=True)
def _instants(ticks, first_segment, tick_s, clock, cursor, segment, offset):  # type: ignore[no-untyped-def]
    count = 0
    due, sub = cursor[0], cursor[1]
    for k in range(ticks):
        while due < clock.tick:
            if sub == 0:
                segment[count] = first_segment + k
                offset[count] = max(0.0, tick_s * (due / clock.tick))
                count += 1
            sub = sub + 1 if sub + 1 < clock.substeps else 0
            due += clock.step
        due -= clock.tick
    cursor[0], cursor[1] = due, sub
    return count
