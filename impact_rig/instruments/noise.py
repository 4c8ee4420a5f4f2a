"""White Gaussian noise, a stream per source: 400 000 numbers per second of rig time are half of what instruments cost.

xoshiro256++ (Blackman & Vigna 2021, ACM Trans. Math. Softw. 47, 36) feeds a ziggurat of 256 layers (Marsaglia & Tsang
2000, J. Stat. Softw. 5, 8). Numpy's own generator takes three times as long, and its streams may change with its
version; these do not. Seeds come from `numpy.random.SeedSequence`.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

_LAYERS = 256
_TAIL = 3.6541528853610088  # where the lowest layer ends and the tail begins
_AREA = 0.00492867323399  # of each layer, under exp(-x²/2)


def _ziggurat() -> NDArray[np.float64]:
    """Return the right ends of the layers, lowest first; shape (_LAYERS + 1,)."""
    edges = np.zeros(_LAYERS + 1)
    edges[0] = _AREA / math.exp(-0.5 * _TAIL**2)
    edges[1] = _TAIL
    for i in range(1, _LAYERS - 1):
        edges[i + 1] = math.sqrt(-2.0 * math.log(_AREA / edges[i] + math.exp(-0.5 * edges[i] ** 2)))
    return edges


_EDGES = _ziggurat()
_HEIGHTS = np.exp(-0.5 * _EDGES**2)
_SEVEN, _EIGHT, _ELEVEN, _TWELVE, _SEVENTEEN = (np.uint64(n) for n in (7, 8, 11, 12, 17))
_23, _41, _45, _19, _BYTE, _SIGN = (np.uint64(n) for n in (23, 41, 45, 19, 0xFF, 0x100))


class Noise:
    """A stream of standard normal numbers: it does not matter how many are taken at once.

    Args:
        seed: decides the stream.
    """

    def __init__(self, seed: np.random.SeedSequence) -> None:
        self._state = seed.generate_state(4, np.uint64)

    def take(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` numbers."""
        numbers = np.empty(count)
        _fill(self._state, numbers)
        return numbers


@njit(cache=True, nogil=True, inline="always")
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


@njit(cache=True, nogil=True)
def _fill(state, out):  # type: ignore[no-untyped-def]
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    unit = 2.0**-52
    for i in range(out.shape[0]):
        while True:
            bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
            layer = np.int64(bits & _BYTE)
            x = np.float64(bits >> _TWELVE) * unit * _EDGES[layer]
            if x < _EDGES[layer + 1]:  # 99 % end here
                break
            if layer == 0:
                miss = True
                while miss:
                    bits_1, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
                    bits_2, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
                    beyond = -math.log(1.0 - np.float64(bits_1 >> _TWELVE) * unit) / _TAIL
                    miss = -2.0 * math.log(1.0 - np.float64(bits_2 >> _TWELVE) * unit) <= beyond * beyond
                x = _TAIL + beyond
                break
            bits_1, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
            low, high = _HEIGHTS[layer], _HEIGHTS[layer + 1]
            if low + np.float64(bits_1 >> _TWELVE) * unit * (high - low) < math.exp(-0.5 * x * x):
                break
        out[i] = -x if bits & _SIGN else x
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3
