# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Random numbers, one generator for every stream of the rig: the same numbers on every machine and with every NumPy.

    bits        xoshiro256++ (Blackman & Vigna 2021, ACM Trans. Math. Softw. 47, 36)
    uniform     53 bits / 2^53
    normal      a ziggurat of 256 layers of equal area A under f(x) = exp(−x²/2) (Marsaglia & Tsang 2000, J. Stat.
                Softw. 5, 8): right ends x_1 = 3.654…, x_{i+1} = f⁻¹(f(x_i) + A / x_i), the tail by its own rule

Layers and tail take exponential and logarithm from `elementary`. Seeds come from `numpy.random.SeedSequence`, which
is arithmetic of integers and fixed by NumPy's promise.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp, log
from impact_rig.kernels import MODE, REALS, WORDS, entry, kernel

_LAYERS = 256
_TAIL = 3.6541528853610088  # where the lowest layer ends and the tail begins
_AREA = 0.00492867323399  # of each layer, under exp(-x²/2)


def _ziggurat() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the right ends of the layers, lowest first, and the density there; both of shape (_LAYERS + 1,)."""
    plain_exp, plain_log = getattr(exp, "py_func", exp), getattr(log, "py_func", log)  # importing compiles nothing
    ends, density = np.zeros(_LAYERS + 1), np.ones(_LAYERS + 1)
    height = plain_exp(-0.5 * _TAIL * _TAIL)
    ends[0], density[0] = _AREA / height, 0.0
    ends[1], density[1] = _TAIL, height
    for i in range(1, _LAYERS - 1):
        density[i + 1] = density[i] + _AREA / ends[i]
        ends[i + 1] = math.sqrt(-2.0 * plain_log(density[i + 1]))
    return ends, density


_ENDS, _DENSITY = _ziggurat()
_ELEVEN, _TWELVE, _SEVENTEEN = (np.uint64(n) for n in (11, 12, 17))
_23, _41, _45, _19, _BYTE, _EIGHT, _ONE = (np.uint64(n) for n in (23, 41, 45, 19, 0xFF, 8, 1))
_SIGNS = np.array([1.0, -1.0])
_UNIT_52, _UNIT_53 = 1.0 / 4503599627370496.0, 1.0 / 9007199254740992.0


class Random:
    """A stream of random numbers: it does not matter how many are taken at once.

    Args:
        seed: decides the stream.

    Attributes:
        state: of the generator, 64-bit words, shape (4,), for compiled code that fills arrays itself.
    """

    def __init__(self, seed: np.random.SeedSequence | int) -> None:
        sequence = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        self.state = sequence.generate_state(4, np.uint64)

    def normal(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` standard normal numbers."""
        numbers = np.empty(count)
        fill_normal(self.state, numbers)
        return numbers

    def uniform(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` numbers spread evenly over 0 <= x < 1."""
        numbers = np.empty(count)
        fill_uniform(self.state, numbers)
        return numbers

    def copy(self) -> Random:
        """Return a stream that goes on from here on its own."""
        twin = Random(0)
        twin.state = self.state.copy()
        return twin


@kernel
def _next(s0, s1, s2, s3):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return 64 random bits and the state that follows."""
    mixed = s0 + s3
    bits = ((mixed << _23) | (mixed >> _41)) + s0
    shifted = s1 << _SEVENTEEN
    s2 ^= s0
    s3 ^= s1
    s1 ^= s2
    s0 ^= s3
    s2 ^= shifted
    s3 = (s3 << _45) | (s3 >> _19)
    return bits, s0, s1, s2, s3


@kernel
def _beyond(s0, s1, s2, s3):  # type: ignore[no-untyped-def]
    """Return a number of the tail (Marsaglia 1964) and the state that follows."""
    while True:
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        excess = -log(1.0 - np.float64(bits >> _TWELVE) * _UNIT_52) / _TAIL
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        if -2.0 * log(1.0 - np.float64(bits >> _TWELVE) * _UNIT_52) > excess * excess:
            return _TAIL + excess, s0, s1, s2, s3


@kernel
def _rejected(bits, x, s0, s1, s2, s3):  # type: ignore[no-untyped-def]
    """Go on with bits whose number x lies beyond the next layer; return both as accepted, and the state behind them."""
    while True:
        layer = np.int64(bits & _BYTE)
        if layer == 0:
            x, s0, s1, s2, s3 = _beyond(s0, s1, s2, s3)
            break
        chance, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        low, high = _DENSITY[layer], _DENSITY[layer + 1]
        if low + np.float64(chance >> _TWELVE) * _UNIT_52 * (high - low) < exp(-0.5 * x * x):
            break
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        layer = np.int64(bits & _BYTE)
        x = np.float64(np.int64(bits >> _TWELVE)) * _UNIT_52 * _ENDS[layer]
        if x < _ENDS[layer + 1]:
            break
    return bits, x, s0, s1, s2, s3


@entry(WORDS, REALS)
def fill_normal(state, out):  # type: ignore[no-untyped-def]
    """Fill an array with the next standard normal numbers."""
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    for i in range(out.shape[0]):
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        layer = np.int64(bits & _BYTE)
        x = np.float64(np.int64(bits >> _TWELVE)) * _UNIT_52 * _ENDS[layer]  # of signed integers the CPU knows how
        if not x < _ENDS[layer + 1]:  # 99 % end here
            bits, x, s0, s1, s2, s3 = _rejected(bits, x, s0, s1, s2, s3)
        out[i] = x * _SIGNS[np.int64((bits >> _EIGHT) & _ONE)]  # a branch on a random bit costs as much as all the rest
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3


@entry(WORDS, REALS)
def fill_uniform(state, out):  # type: ignore[no-untyped-def]
    """Fill an array with the next even numbers, 0 <= x < 1."""
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    for i in range(out.shape[0]):
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        out[i] = np.float64(bits >> _ELEVEN) * _UNIT_53
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3


if MODE == "plain":  # the sums of the generator drop what is beyond 64 bits, which plain NumPy takes for a mishap
    fill_normal, fill_uniform = (np.errstate(over="ignore")(fill) for fill in (fill_normal, fill_uniform))
