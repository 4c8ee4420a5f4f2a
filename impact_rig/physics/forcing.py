"""The drive inside one segment: u(t) = (A + B t) sin(ω t + φ), and the linear systems' particular answer to it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

SEGMENT = np.dtype([("duration", "f8"), ("omega", "f8"), ("phase", "f8"), ("amplitude", "f8"), ("slope", "f8")])
"""Drive segments, in order: seconds, rad/s, rad, and amplitude and its rate in A, m or V by drive."""


class Forcing(NamedTuple):
    """One segment of the drive."""

    omega: float
    phase: float
    amplitude: float
    slope: float


@njit(cache=True, nogil=True, error_model="numpy")
def drive(f, t):  # type: ignore[no-untyped-def]  # compiled: types are inferred
    """Return u and u' at t."""
    angle = f.omega * t + f.phase
    level = f.amplitude + f.slope * t
    s, c = np.sin(angle), np.cos(angle)
    return level * s, f.slope * s + level * f.omega * c


@njit(cache=True, nogil=True, error_model="numpy")
def bound_omega(system, omega):  # type: ignore[no-untyped-def]
    """Return the fastest rate [1/s] of the drive and the modes."""
    fastest = max(omega, 1e-9)
    for k in range(system.modes.rate.shape[0]):
        fastest = max(fastest, abs(system.modes.rate[k]))
    return fastest


@njit(cache=True, nogil=True)
def _resolvent(modes, omega, vector, out):  # type: ignore[no-untyped-def]
    """Out = (jω − M)^-1 vector; each kept mode stands for itself and its conjugate."""
    out[:] = 0.0
    for k in range(modes.rate.shape[0]):
        rate = modes.rate[k]
        plus, minus = 0.0j, 0.0j
        for i in range(vector.shape[0]):
            plus += modes.left[k, i] * vector[i]
            minus += np.conj(modes.left[k, i]) * vector[i]
        plus *= 0.5 / (1j * omega - rate)
        minus *= 0.5 / (1j * omega - np.conj(rate))
        for i in range(vector.shape[0]):
            out[i] += modes.right[k, i] * plus + np.conj(modes.right[k, i]) * minus


@njit(cache=True, nogil=True)
def transfer(system, omega, answer, drift):  # type: ignore[no-untyped-def]
    """Fill H = R (b0 + jω b1) and G = R b1 − R H, R = (jω − M)^-1: answers to a steady and a growing drive."""
    n = system.b0.shape[0]
    vector = np.empty(n, np.complex128)
    for i in range(n):
        vector[i] = system.b0[i] + 1j * omega * system.b1[i]
    _resolvent(system.modes, omega, vector, answer)
    for i in range(n):
        vector[i] = system.b1[i] - answer[i]
    _resolvent(system.modes, omega, vector, drift)


@njit(cache=True, nogil=True)
def particular(f, answer, drift, steady, growing):  # type: ignore[no-untyped-def]
    """Fill P and Q of y_p(t) = Im[(P + Q t) exp(jωt)]: P = A H + B G, Q = B H with the phase in A and B."""
    turn = np.cos(f.phase) + 1j * np.sin(f.phase)
    for i in range(answer.shape[0]):
        growing[i] = f.slope * turn * answer[i]
        steady[i] = f.amplitude * turn * answer[i] + f.slope * turn * drift[i]
