# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Band-passed noise of unit rms: a digital Butterworth band-pass of 8th order, made exactly, behind our own generator.

The filter is worked out with many digits and rounded once.

prototype     s_k = e^{jπ(2k + 5)/8}, k = 0 … 3, of the low-pass with corner 1
band-pass     s² − s_k B s + ω_0² = 0, B = ω_2 − ω_1, ω_0² = ω_1 ω_2, ω_i = tan(π f_i · tick)
digital       p = (1 + s) / (1 − s): g B(z), B = Π (1 − z⁻²) / (1 + a_1 z⁻¹ + a_2 z⁻²), four sections
unit rms      g⁻² = Σ b_n² of B(z) = Σ b_n z⁻ⁿ, which is a sum over its partial fractions
"""

from __future__ import annotations

import functools
from decimal import Decimal
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.precise import ONE, TWO, ZERO, Complex, pi, precise, product, square_root, unit
from impact_rig.arithmetic.random import Random
from impact_rig.kernels import REALS, entry, records

SECTIONS = 4
_SECTION = np.dtype(
    [
        ("a_1", "f8"),  # coefficient of z⁻¹ below the line [-]
        ("a_2", "f8"),  # coefficient of z⁻² there [-]
    ]
)
_FILTER_STATE = np.dtype(
    [
        ("delayed_1", "f8"),  # what is added to the next number [-]
        ("delayed_2", "f8"),  # what of the numbers so far is added to the one after it [-]
    ]
)


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
    sections = records(SECTIONS, _SECTION)
    sections[:] = rows
    return BandPass(float(ONE / _noise_power([*poles, *(pole.conjugate() for pole in poles)]).sqrt()), sections)


def _digital_poles(prototype: Complex, width: Decimal, omega_0_square: Decimal) -> list[Complex]:
    """Return two poles in the z plane, one of each conjugate pair that a prototype pole and its conjugate make."""
    half_sum = prototype * Complex(width / 2)
    half_difference = square_root(half_sum * half_sum - Complex(omega_0_square))
    return [(Complex(ONE) + s) / (Complex(ONE) - s) for s in (half_sum + half_difference, half_sum - half_difference)]


def _noise_power(poles: list[Complex]) -> Decimal:
    """Return Σ b_n² of Π (1 − z⁻²)⁴ / Π (1 − p_k z⁻¹): of c + Σ r_k / (1 − p_k z⁻¹) with b_0 = 1."""
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
    return product([zeros] * SECTIONS) / product(other_factors)


class BandNoise:
    """A stream of band-passed noise: which numbers it gives does not depend on how they are asked for.

    Args:
        band: how it is filtered.
        random: where white noise comes from.
    """

    _CHUNK = 256  # numbers made at once: the filter's arrays stay small

    def __init__(self, band: BandPass, random: Random) -> None:
        self._filter, self._random = band, random
        self._states = records(SECTIONS, _FILTER_STATE)
        self._ready: NDArray[np.float64] = np.empty(0)
        self._first_ready = 0

    def copy(self) -> BandNoise:
        """Return a stream that goes on from here on its own."""
        twin = BandNoise(self._filter, self._random.copy())
        twin._states, twin._ready, twin._first_ready = self._states.copy(), self._ready, self._first_ready
        return twin

    def numbers(self, first: int, count: int) -> NDArray[np.float64]:
        """Return the numbers first … first + count − 1; the next call must not begin earlier, nor behind their end."""
        parts = [self._ready[first - self._first_ready :]]
        there = len(parts[0])
        while there < count:
            parts.append(self._random.normal(self._CHUNK) * self._filter.gain)
            filter_in_place(self._filter.sections, self._states, parts[-1])
            there += self._CHUNK
        self._first_ready, self._ready = first, np.concatenate(parts)
        return self._ready[:count]


@entry(_SECTION, _FILTER_STATE, REALS)
def filter_in_place(sections, states, samples):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Filter samples in place by sections one after another, transposed direct form II, each with its filter state."""
    for i in range(samples.shape[0]):
        value = samples[i]
        for k in range(sections.shape[0]):
            section, state = sections[k], states[k]
            out = value + state.delayed_1
            state.delayed_1 = state.delayed_2 - section.a_1 * out
            state.delayed_2 = -value - section.a_2 * out
            value = out
        samples[i] = value
