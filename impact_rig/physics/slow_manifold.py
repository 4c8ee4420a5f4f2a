# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The slow invariant manifold of a vibro-impact energy sink: two symmetric impacts per cycle, without any structure.

A sphere of mass m between two walls b = g/2 from the middle of what moves as x_1 = A cos(ωt + α). Let it strike one
wall every half cycle. Between impacts it flies freely, so it moves as a triangle of amplitude P whose corners are the
impacts. With ξ = A/b and Θ = P/b, at the right wall (t = 0, speed V = 2ωP/π before, −V after):

    position    P = A cos α + b                                        A cos α = b (Θ − 1)
    impact      V + v_1 = e (V − v_1)   →   v_1 = −ω ρ P               A sin α = b ρ Θ,    ρ = (2/π)(1 − e)/(1 + e)
    together    ξ² = (Θ − 1)² + ρ²Θ²    →   Θ = [1 + √((1 + ρ²) ξ² − ρ²)] / (1 + ρ²)

No such motion exists below ξ = ρ/√(1 + ρ²): the fold, g/A = 2√(1 + ρ²)/ρ. The triangle's fundamental is (8/π²) P cos
ωt, so the structure feels the force (8/π²) m ω² P cos ωt, which is N x_1 with

    N = (8/π²) m ω² [Θ(Θ − 1) − iρΘ²] / ξ²

that is, a mass (8/π²) m Θ(Θ − 1)/ξ² and, at its natural frequency, a damping ratio (4/π²)(m/m_1) ρ (Θ/ξ)².

**Recoil.** The structure's speed jumps by 2μV in an impact, μ = m/m_1, and its motion has odd harmonics, of which
near resonance the n-th is −(8/π²) μ P cos(nωt) / (n² − 1). To first order in μ this changes two numbers, nothing
else:

    mean speed at the impact     −V (1 − e)(1 + μ)/(1 + e)                 ρ → ρ (1 + μ)
    sum of the harmonics there   −(8/π²) μ P Σ 1/(n² − 1) = −(2/π²) μ P    (Θ − 1) → (κΘ − 1),   κ = 1 + 2μ/π²
    so    ξ² = (κΘ − 1)² + ρ²Θ²,    Θ = [κ + √((κ² + ρ²) ξ² − ρ²)] / (κ² + ρ²),    fold at g/A = 2√(κ² + ρ²)/ρ

With μ = 0 these are the published formulas (`mass_ratio` = 0). With it they agree with the exact orbits of an
instantaneous law, Masri & Caughey's, to the order μ².

**Stability.** A half period maps small errors of the instant and speed of an impact into those of the next, by a
matrix with determinant e² and trace 2e − q, q = (π²/4)(1 + e)²(Θ − 1)/Θ. Its eigenvalues lie within the unit circle
for 1/(1 + ρ²) < Θ < π²/(π² − 4): from the fold (an eigenvalue 1) to where the two half cycles become different (−1).
The lower solution of the quadratic lies below the fold and is never stable. (This map is that of μ = 0.)

Left out: the order μ², how long a contact lasts, and what the harmonics do away from resonance.

Sources: O. V. Gendelman & A. Alloni (2015), "Dynamics of forced system with vibro-impact energy sink", J. Sound Vib.
358, 301–314; E. Gourc, G. Michon, S. Seguy & A. Berlioz (2015), "Targeted energy transfer under harmonic forcing with
a vibro-impact nonlinear energy sink: analytical and experimental developments", J. Vib. Acoust. 137, 031008.
Recoil and both bounds of Θ are derived here.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

THETA_SYMMETRIC = math.pi**2 / (math.pi**2 - 4.0)
"""Largest Θ of stable symmetric motion, whatever e; without recoil."""

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@attrs.frozen
class Manifold:
    """The manifold for one restitution.

    Attributes:
        restitution: what the impacts really return, in (0, 1).
        mass_ratio: μ, of sphere to structure; 0: the structure does not recoil.

    Raises:
        ValueError: the restitution is out of range.
    """

    restitution: float = attrs.field()
    mass_ratio: float = 0.0

    @restitution.validator
    def _check(self, _: object, value: float) -> None:
        if not 0.0 < value < 1.0:
            raise ValueError(f"restitution must be > 0 and < 1, got {value!r}")

    @property
    def rho(self) -> float:
        """ρ = (2/π)(1 − e)(1 + μ)/(1 + e)."""
        return 2.0 / math.pi * (1.0 - self.restitution) / (1.0 + self.restitution) * (1.0 + self.mass_ratio)

    @property
    def kappa(self) -> float:
        """κ = 1 + 2μ/π²."""
        return 1.0 + 2.0 * self.mass_ratio / math.pi**2

    @property
    def theta_fold(self) -> float:
        """Θ of the fold, κ/(κ² + ρ²)."""
        return self.kappa / (self.kappa**2 + self.rho**2)

    @property
    def gap_per_amplitude_at_fold(self) -> float:
        """Largest g/A at which two symmetric impacts per cycle exist, 2√(κ² + ρ²)/ρ."""
        return 2.0 * math.hypot(self.kappa, self.rho) / self.rho

    def theta(self, xi: Real | float) -> Real:
        """Return Θ of the upper solution for ξ = A/b, NaN below the fold."""
        both = self.kappa**2 + self.rho**2
        square = both * np.asarray(xi, float) ** 2 - self.rho**2
        root: Real = np.sqrt(np.where(square >= 0.0, square, np.nan))
        return (self.kappa + root) / both

    def xi(self, theta: Real | float) -> Real:
        """Return ξ = A/b for Θ."""
        found: Real = np.hypot(self.kappa * np.asarray(theta, float) - 1.0, self.rho * np.asarray(theta, float))
        return found

    def force(self, theta: Real) -> Complex:
        """Return N / (m ω²): the fundamental of the sphere's force per displacement of the structure."""
        top = theta * (self.kappa * theta - 1.0) - 1j * self.rho * theta**2
        return np.asarray(8.0 / math.pi**2 * top / self.xi(theta) ** 2, np.complex128)

    def force_slope(self, theta: Real) -> Complex:
        """Return ξ dN/dξ / (m ω²): what a larger amplitude changes of it; infinite at the fold."""
        kappa, xi = self.kappa, self.xi(theta)
        xi_slope = (kappa * (kappa * theta - 1.0) + self.rho**2 * theta) / xi
        top_slope = 8.0 / math.pi**2 * ((2.0 * kappa * theta - 1.0) - 2j * self.rho * theta) / xi**2
        with np.errstate(divide="ignore", invalid="ignore"):
            growth = xi * top_slope / xi_slope
        return np.asarray(growth - 2.0 * self.force(theta), np.complex128)

    def impact_phase_rad(self, theta: Real) -> Real:
        """Return α: how far past its right turning point the structure is when the sphere strikes the right wall."""
        found: Real = np.arctan2(self.rho * theta, self.kappa * theta - 1.0)
        return found

    def approach_speed(self, theta: Real) -> Real:
        """Return the sphere's speed relative to the wall before an impact, over ω b: 4Θ(1 + μ) / (π(1 + e))."""
        found: Real = 4.0 * (1.0 + self.mass_ratio) / (math.pi * (1.0 + self.restitution)) * theta
        return found

    def stable(self, theta: Real) -> NDArray[np.bool_]:
        """Return where small errors of the sphere's motion die on a structure that keeps its own."""
        found: NDArray[np.bool_] = (theta > self.theta_fold) & (theta < THETA_SYMMETRIC)
        return found
