# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Band-passed noise of unit rms: a digital Butterworth band-pass of 8th order, refined with many digits, rounded once.

prototype     s_k = e^{jπ(2k + 5)/8}, k = 0 … 3, of the low-pass with corner 1
band-pass     s² − s_k B s + ω_0² = 0, B = ω_2 − ω_1, ω_0² = ω_1 ω_2, ω_i = tan(π f_i h)
digital       p = (1 + s) / (1 − s): H(z) = g Π (1 − z⁻²) / (1 + a_1 z⁻¹ + a_2 z⁻²), four sections
unit rms      g⁻² = Σ h_n² of H/g, which is a sum over its partial fractions
"""

from __future__ import annotations

import functools
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.precise import ONE, TWO, ZERO, Complex, pi, precise, product, square_root, unit
from impact_rig.arithmetic.random import Random
from impact_rig.arithmetic.records import records
from impact_rig.kernels import REALS, entry

SECTIONS = 4
_SECTION = np.dtype([("a_1", "f8"), ("a_2", "f8")])
_MEMORY = np.dtype([("first", "f8"), ("second", "f8")])


class BandPass(NamedTuple):
    """A filter: `gain` of its input, then its sections, records of a_1 and a_2, the least resonant first."""

    gain: float
    sections: NDArray[np.void]


@functools.cache
@precise
def band_pass(low_hz: float, high_hz: float, tick_s: float) -> BandPass:
    """Return the filter that makes white noise of unit rms, a number per tick, band-passed noise of unit rms.

    Raises:
        ValueError: the band is empty or does not lie below half of the rate of ticks.
    """
    if not 0.0 < low_hz < high_hz < 0.5 / tick_s:
        raise ValueError(f"the band must lie within 0 to {0.5 / tick_s:g} Hz, got {low_hz!r} to {high_hz!r} Hz")
    turns = [unit(pi() * Decimal(f) * Decimal(tick_s)) for f in (low_hz, high_hz)]
    low, high = (turn.imag / turn.real for turn in turns)
    poles = sorted(
        (pole for k in range(2) for pole in _digital_poles(unit(pi() * (2 * k + 5) / 8), high - low, low * high)),
        key=lambda pole: pole.square(),
    )
    rows = [(float(-TWO * pole.real), float(pole.square())) for pole in poles]
    sections = records(SECTIONS, _SECTION)
    sections[:] = rows
    return BandPass(float(ONE / _power([*poles, *(pole.conjugate() for pole in poles)]).sqrt()), sections)


def _digital_poles(prototype: Complex, width: Decimal, centre_square: Decimal) -> list[Complex]:
    """Return two poles in the z plane, one of each conjugate pair that a prototype pole and its conjugate make."""
    half = prototype * Complex(width / 2)
    root = square_root(half * half - Complex(centre_square))
    return [(Complex(ONE) + s) / (Complex(ONE) - s) for s in (half + root, half - root)]


def _power(poles: list[Complex]) -> Decimal:
    """Return Σ h_n² of Π (1 − z⁻²)⁴ / Π (1 − p_k z⁻¹): of c + Σ r_k / (1 − p_k z⁻¹) with h_0 = 1."""
    residues = [_residue(k, poles) for k in range(len(poles))]
    later = ZERO
    for first, r in zip(poles, residues, strict=True):
        for second, q in zip(poles, residues, strict=True):
            both = first * second
            later += (r * q * both / (Complex(ONE) - both)).real
    return ONE + later


def _residue(k: int, poles: list[Complex]) -> Complex:
    per_pole = Complex(ONE) / poles[k]
    zeros = Complex(ONE) - per_pole * per_pole
    others = (Complex(ONE) - other * per_pole for j, other in enumerate(poles) if j != k)
    return product([zeros] * SECTIONS) / product(others)


class BandNoise:
    """A stream of band-passed noise: which numbers it gives does not depend on how they are asked for.

    Args:
        filtered: the band.
        random: where white noise comes from.
    """

    _CHUNK = 256  # numbers made at once: the filter's arrays stay small

    def __init__(self, filtered: BandPass, random: Random) -> None:
        self._filter, self._random = filtered, random
        self._memory = records(SECTIONS, _MEMORY)
        self._made: NDArray[np.float64] = np.empty(0)
        self._first = 0

    def copy(self) -> BandNoise:
        """Return a stream that goes on from here on its own."""
        twin = BandNoise(self._filter, self._random.copy())
        twin._memory, twin._made, twin._first = self._memory.copy(), self._made, self._first
        return twin

    def numbers(self, first: int, count: int) -> NDArray[np.float64]:
        """Return the numbers first … first + count; the next call must not begin earlier, nor behind their end."""
        parts = [self._made[first - self._first :]]
        ready = len(parts[0])
        while ready < count:
            parts.append(self._random.normal(self._CHUNK) * self._filter.gain)
            run(self._filter.sections, self._memory, parts[-1])
            ready += self._CHUNK
        self._first, self._made = first, np.concatenate(parts)
        return self._made[:count]


@entry(_SECTION, _MEMORY, REALS)
def run(sections, memory, samples):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Filter samples in place, in transposed direct form II: y = x + m_1, m_1' = m_2 − a_1 y, m_2' = −x − a_2 y."""
    for i in range(samples.shape[0]):
        value = samples[i]
        for k in range(sections.shape[0]):
            section, past = sections[k], memory[k]
            out = value + past.first
            past.first = past.second - section.a_1 * out
            past.second = -value - section.a_2 * out
            value = out
        samples[i] = value
