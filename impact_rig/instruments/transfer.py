"""Transfer functions of analogue chains: poles, zeros and gain, and the partial fractions in which they are simulated.

A chain H(s) is run as Σ r_k / (s − p_k): every mode is one complex number that follows z' = p z + u, exactly, however
its input is cut into steps. So there is no discretised filter and no sampling rate in here: a 25 kHz resonance is the
same at 1 kS/s and at 250 kS/s.
"""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray
from scipy import signal

_DISTINCT = 1e-5
"""Poles nearer to each other than this, relative, are moved apart by it: partial fractions need distinct poles."""


@attrs.frozen(eq=False)
class Modes:
    """Partial fractions of a strictly proper H: y = Σ Re(residue z), z' = pole z + u.

    Attributes:
        poles: complex, shape (k,) [rad/s]; one of each conjugate pair, imaginary part >= 0.
        residues: complex, shape (k,); doubled where a pair is represented.
    """

    poles: NDArray[np.complex128]
    residues: NDArray[np.complex128]

    def settled(self, level: float) -> NDArray[np.complex128]:
        """Return the modes' values after the input has been at `level` for ever."""
        settled: NDArray[np.complex128] = -level / self.poles
        return settled

    def same_as(self, other: Modes) -> bool:
        """Whether both describe the same chain, bit for bit."""
        return np.array_equal(self.poles, other.poles) and np.array_equal(self.residues, other.residues)


@attrs.frozen(eq=False)
class Transfer:
    """H(s) = gain Π(s − zero) / Π(s − pole); a product of two is the cascade.

    Attributes:
        zeros: complex, shape (m,) [rad/s].
        poles: complex, shape (n,) [rad/s].
        gain: leading coefficient.
    """

    zeros: NDArray[np.complex128]
    poles: NDArray[np.complex128]
    gain: float

    def __mul__(self, other: Transfer) -> Transfer:
        return Transfer(
            np.concatenate([self.zeros, other.zeros]),
            np.concatenate([self.poles, other.poles]),
            self.gain * other.gain,
        )

    def response(self, frequency_hz: NDArray[np.float64] | float) -> NDArray[np.complex128]:
        """Return H(j 2π f), same shape as the frequencies."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)[..., None]
        ratio = self.gain * np.prod(s - self.zeros, axis=-1) / np.prod(s - self.poles, axis=-1)
        return np.asarray(ratio, dtype=np.complex128)

    def delay_s(self) -> float:
        """Return the group delay at low frequency [s]: −Σ Re(1/p) of a low-pass without zeros."""
        return float(-np.sum((1.0 / self.poles).real))

    def modes(self) -> Modes:
        """Return the partial fractions of H."""
        poles = _distinct(self.poles)
        kept = poles[poles.imag >= 0.0]
        residues = np.empty(len(kept), dtype=np.complex128)
        for k, pole in enumerate(kept):
            others = poles[poles != pole]
            residue = self.gain * np.prod(pole - self.zeros) / np.prod(pole - others)
            residues[k] = 2.0 * residue if pole.imag > 0.0 else residue.real
        return Modes(kept, residues)


def lag(time_constant_s: float) -> Transfer:
    """Return a first-order lag 1 / (1 + τ s)."""
    return Transfer(np.empty(0, complex), np.array([-1.0 / time_constant_s + 0j]), 1.0 / time_constant_s)


def high_pass(corner_hz: float) -> Transfer:
    """Return a first-order high-pass s / (s + ω)."""
    return Transfer(np.zeros(1, complex), np.array([-2.0 * np.pi * corner_hz + 0j]), 1.0)


def butterworth(order: int, corner_hz: float) -> Transfer:
    """Return a Butterworth low-pass: unit gain, −3 dB at the corner."""
    zeros, poles, gain = signal.butter(order, 2.0 * np.pi * corner_hz, analog=True, output="zpk")
    poles = np.asarray(poles, dtype=np.complex128)
    # scipy leaves a rounding error on the real pole of an odd order
    poles = np.where(np.abs(poles.imag) < 1e-12 * np.abs(poles), poles.real + 0j, poles)
    return Transfer(np.asarray(zeros, dtype=np.complex128), poles, float(gain))


def resonance(frequency_hz: float, quality: float) -> Transfer:
    """Return ω² / (s² + s ω/Q + ω²), Q > 1/2: a sensor below its mounted resonance."""
    omega = 2.0 * np.pi * frequency_hz
    damping = omega / (2.0 * quality)
    damped = np.sqrt(omega**2 - damping**2)
    return Transfer(np.empty(0, complex), np.array([-damping + 1j * damped, -damping - 1j * damped]), omega**2)


def _distinct(poles: NDArray[np.complex128]) -> NDArray[np.complex128]:
    """Return the poles, conjugates exactly paired, each further than `_DISTINCT` from all others."""
    upper: list[complex] = []
    for pole in poles[poles.imag >= 0.0]:
        moved = complex(pole)
        while any(abs(moved - other) < _DISTINCT * abs(other) for other in upper):
            moved *= 1.0 + 2.0 * _DISTINCT
        upper.append(moved)
    return np.array([*upper, *(pole.conjugate() for pole in upper if pole.imag > 0.0)], dtype=np.complex128)
