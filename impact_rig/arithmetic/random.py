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
"""Random numbers from one kind of generator: the same numbers on every machine and with every NumPy.

    bits        xoshiro256++ (Blackman & Vigna 2021, ACM Trans. Math. Softw. 47, 36)
    uniform     53 bits / 2^53
    normal      a ziggurat of 256 layers of equal area A under f(x) = exp(−x²/2) (Marsaglia & Tsang 2000, J. Stat.
                Softw. 5, 8): right ends x_1 = 3.654…, x_{i+1} = f⁻¹(f(x_i) + A / x_i), the tail by its own rule

Layers and tail use the exponential and logarithm of `elementary`. Seeds come from `numpy.random.SeedSequence`, which is
integer arithmetic that NumPy promises not to change.

**Band-passed noise** has unit rms. Normal numbers pass a digital Butterworth band-pass of 8th order, whose coefficients
are computed with many digits and rounded once.

- Prototype: s_k = e^{jπ(2k + 5)/8}, k = 0 … 3, of the low-pass with corner 1.
- Band-pass from f_1 to f_2: s² − s_k W s + ω_0² = 0, W = ω_2 − ω_1, ω_0² = ω_1 ω_2, ω_i = tan(π f_i tick), with
  tick the time between two numbers.
- Digital: poles p = (1 + s) / (1 − s) of g B(z), B = Π (1 − z⁻²) / (1 + a_1 z⁻¹ + a_2 z⁻²), four sections.
- Unit rms: g⁻² = Σ b_n² of B(z) = Σ b_n z⁻ⁿ, which is a sum over its partial fractions.
"""

from __future__ import annotations

import functools
import math
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import exp, log
from impact_rig.arithmetic.precise import ONE, TWO, ZERO, Complex, pi, product, square_root, unit, with_70_digits
from impact_rig.kernels import MODE, REALS, WORDS, Reals, Records, Words, entry, kernel, records

_LAYERS = 256
_TAIL = 3.6541528853610088  # right end of the lowest layer, where the tail begins
_AREA = 0.00492867323399  # of each layer, under exp(-x²/2)


def _ziggurat() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the right end of each layer of the ziggurat, lowest layer first, and the density at each right end.

    Both arrays have the shape (_LAYERS + 1,). The density is exp(−x²/2). Entry 0 is special: its end is the width of a
    rectangle with the area of the lowest layer and its tail, and its density is 0.
    """
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
    """Stream of random numbers; the numbers do not depend on how many are drawn at once.

    Args:
        seed: seed of the stream.

    Attributes:
        state: state of the generator, 64-bit words, shape (4,). Compiled code that draws numbers itself advances it.
    """

    def __init__(self, seed: np.random.SeedSequence | int) -> None:
        sequence = np.random.SeedSequence(seed) if isinstance(seed, int) else seed
        self.state: Words = sequence.generate_state(4, np.uint64)  # type: ignore[assignment]  # NumPy's types know no dtype

    def normal(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` standard normal numbers."""
        numbers = np.empty(count)
        fill_normal(self.state, numbers)
        return numbers

    def uniform(self, count: int) -> NDArray[np.float64]:
        """Return the next `count` uniformly distributed numbers, 0 <= x < 1."""
        numbers = np.empty(count)
        fill_uniform(self.state, numbers)
        return numbers

    def copy(self) -> Random:
        """Return an independent copy of the stream at its present position."""
        twin = Random(0)
        twin.state = self.state.copy()
        return twin


@kernel
def _next(
    s0: np.uint64, s1: np.uint64, s2: np.uint64, s3: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return 64 random bits of the generator xoshiro256++ and its next state, from the state s0 … s3."""
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
def _beyond(
    s0: np.uint64, s1: np.uint64, s2: np.uint64, s3: np.uint64
) -> tuple[float, np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return the magnitude of a normal number in the tail, beyond `_TAIL`, and the next state of the generator.

    The method is that of Marsaglia (1964).
    """
    while True:
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        excess = -log(1.0 - np.float64(bits >> _TWELVE) * _UNIT_52) / _TAIL
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        if -2.0 * log(1.0 - np.float64(bits >> _TWELVE) * _UNIT_52) > excess * excess:
            return _TAIL + excess, s0, s1, s2, s3


@kernel
def _rejected(
    bits: np.uint64, x: float, s0: np.uint64, s1: np.uint64, s2: np.uint64, s3: np.uint64
) -> tuple[np.uint64, float, np.uint64, np.uint64, np.uint64, np.uint64]:
    """Return the magnitude of a normal number: the candidate x if it is accepted, otherwise a new one.

    x lies in the part of its layer that the layer above does not cover, where only some candidates are accepted. In the
    lowest layer, a number of the tail replaces x. `bits` are the random bits that x was made from. The result is (bits
    of the accepted candidate, magnitude, next state of the generator). The caller takes the sign from the bits.
    """
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
def fill_normal(state: Words, out: Reals) -> None:
    """Fill `out` with the next standard normal numbers of the generator `state`, and advance `state`."""
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    for i in range(out.shape[0]):
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        layer = np.int64(bits & _BYTE)
        x = np.float64(np.int64(bits >> _TWELVE)) * _UNIT_52 * _ENDS[layer]  # the CPU converts signed integers directly
        if not x < _ENDS[layer + 1]:  # 99 % end here
            bits, x, s0, s1, s2, s3 = _rejected(bits, x, s0, s1, s2, s3)
        out[i] = x * _SIGNS[np.int64((bits >> _EIGHT) & _ONE)]  # a branch on a random bit would cost as much as this
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3


@entry(WORDS, REALS)
def fill_uniform(state: Words, out: Reals) -> None:
    """Fill `out` with the next numbers of the generator `state`, uniform in 0 <= x < 1, and advance `state`."""
    s0, s1, s2, s3 = state[0], state[1], state[2], state[3]
    for i in range(out.shape[0]):
        bits, s0, s1, s2, s3 = _next(s0, s1, s2, s3)
        out[i] = np.float64(bits >> _ELEVEN) * _UNIT_53
    state[0], state[1], state[2], state[3] = s0, s1, s2, s3


if MODE == "plain":  # the generator's sums drop bits beyond 64, about which plain NumPy warns
    fill_normal, fill_uniform = (np.errstate(over="ignore")(fill) for fill in (fill_normal, fill_uniform))


_SECTIONS = 4
_SECTION = np.dtype(
    [
        ("a_1", "f8"),  # coefficient of z⁻¹ in the denominator [-]
        ("a_2", "f8"),  # coefficient of z⁻² in the denominator [-]
    ]
)
_FILTER_STATE = np.dtype(
    [
        ("delayed_1", "f8"),  # part of the state that is added to the next number [-]
        ("delayed_2", "f8"),  # part of the state that is added to the number after it [-]
    ]
)


class BandPass(NamedTuple):
    """Digital band-pass filter: a factor for the input (`gain`), then second-order sections in series.

    `sections` are records of the coefficients a_1 and a_2 of each section, the least resonant section first.
    `filter_in_place` applies the sections, but not `gain`.
    """

    gain: float
    sections: NDArray[np.void]


@functools.cache
@with_70_digits
def band_pass(low_hz: float, high_hz: float, tick_s: float) -> BandPass:
    """Return the band-pass filter from `low_hz` to `high_hz` that turns white noise of unit rms into noise of unit rms.

    The noise has one number per tick of `tick_s` seconds. The filter is of 8th order.

    Raises:
        ValueError: not 0 < `low_hz` < `high_hz` < 0.5 / `tick_s`.
    """
    if not 0.0 < low_hz < high_hz < 0.5 / tick_s:
        raise ValueError(f"the band must be 0 < low < high < {0.5 / tick_s:g} Hz, got {low_hz!r} to {high_hz!r} Hz")
    phasors = [unit(pi() * Decimal(f) * Decimal(tick_s)) for f in (low_hz, high_hz)]
    omega_1, omega_2 = (phasor.imag / phasor.real for phasor in phasors)
    poles = sorted(
        (
            pole
            for k in range(2)
            for pole in _digital_poles(unit(pi() * (2 * k + 5) / 8), omega_2 - omega_1, omega_1 * omega_2)
        ),
        key=lambda pole: pole.square(),
    )
    rows = [(float(-TWO * pole.real), float(pole.square())) for pole in poles]
    sections = records(_SECTIONS, _SECTION)
    sections[:] = rows
    return BandPass(float(ONE / _noise_power([*poles, *(pole.conjugate() for pole in poles)]).sqrt()), sections)


def _digital_poles(prototype: Complex, width: Decimal, omega_0_square: Decimal) -> list[Complex]:
    """Return the two poles of the digital band-pass that arise from one pole of the low-pass prototype.

    `width` is W and `omega_0_square` is ω_0² of the band (module docstring). The conjugate of `prototype` gives the
    conjugates of these poles.
    """
    half_sum = prototype * Complex(width / 2)
    half_difference = square_root(half_sum * half_sum - Complex(omega_0_square))
    return [(Complex(ONE) + s) / (Complex(ONE) - s) for s in (half_sum + half_difference, half_sum - half_difference)]


def _noise_power(poles: list[Complex]) -> Decimal:
    """Return the power Σ b_n² of white noise of unit power after it has passed (1 − z⁻²)⁴ / Π (1 − p_k z⁻¹).

    `poles` are the p_k: distinct, inside the unit circle, and with the conjugate of each complex pole. The sum follows
    from the partial fractions of the filter, c + Σ r_k / (1 − p_k z⁻¹), and b_0 = 1.
    """
    residues = [_residue(k, poles) for k in range(len(poles))]
    power_after_first = ZERO
    for pole, residue in zip(poles, residues, strict=True):
        for other, other_residue in zip(poles, residues, strict=True):
            product_of_poles = pole * other
            power_after_first += (residue * other_residue * product_of_poles / (Complex(ONE) - product_of_poles)).real
    return ONE + power_after_first


def _residue(k: int, poles: list[Complex]) -> Complex:
    inverse_pole = Complex(ONE) / poles[k]
    zeros = Complex(ONE) - inverse_pole * inverse_pole
    other_factors = (Complex(ONE) - other * inverse_pole for j, other in enumerate(poles) if j != k)
    return product([zeros] * _SECTIONS) / product(other_factors)


class BandNoise:
    """Stream of band-passed noise.

    The numbers do not depend on how many are requested at once.

    Args:
        band: filter of the noise.
        random: source of white noise for this stream alone; the stream draws more numbers from it than are requested.
    """

    _CHUNK = 256  # numbers computed at once, few enough to keep the filter's arrays small

    def __init__(self, band: BandPass, random: Random) -> None:
        self._filter, self._random = band, random
        self._states = records(_SECTIONS, _FILTER_STATE)
        self._ready: NDArray[np.float64] = np.empty(0)
        self._first_ready = 0

    def copy(self) -> BandNoise:
        """Return an independent copy of the stream at its present position."""
        twin = BandNoise(self._filter, self._random.copy())
        twin._states, twin._ready, twin._first_ready = self._states.copy(), self._ready, self._first_ready
        return twin

    def numbers(self, first: int, count: int) -> NDArray[np.float64]:
        """Return `count` numbers of the stream, from index `first` on, counted from 0.

        The first call must have `first` = 0. In each later call, `first` must be the index of a number that the
        previous call returned, or the index after its last number. This is not checked: another index may give wrong
        numbers.
        """
        parts = [self._ready[first - self._first_ready :]]
        there = len(parts[0])
        while there < count:
            parts.append(self._random.normal(self._CHUNK) * self._filter.gain)
            filter_in_place(self._filter.sections, self._states, parts[-1])
            there += self._CHUNK
        self._first_ready, self._ready = first, np.concatenate(parts)
        return self._ready[:count]


@entry(_SECTION, _FILTER_STATE, REALS)
def filter_in_place(sections: Records, states: Records, samples: Reals) -> None:
    """Filter samples in place by second-order sections in series, and update the state of each.

    A section is (1 − z⁻²) / (1 + a_1 z⁻¹ + a_2 z⁻²), in transposed direct form II.
    """
    for i in range(samples.shape[0]):
        value = samples[i]
        for k in range(sections.shape[0]):
            section, state = sections[k], states[k]
            out = value + state.delayed_1
            state.delayed_1 = state.delayed_2 - section.a_1 * out
            state.delayed_2 = -value - section.a_2 * out
            value = out
        samples[i] = value
