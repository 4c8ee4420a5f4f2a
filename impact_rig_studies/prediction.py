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
"""Closed-form theory of motions with two symmetric impacts of the sphere per cycle, without simulation.

**The rig**: DT, phase, impacts, and the limits of such motions. Θ is the amplitude of the
sphere over half the gap. The sphere acts on the structure with the force N x_1. N follows from the slow invariant
manifold (below) and depends on Θ and ω alone, neither on the gap nor on the amplitude. With this force in the rig's
linear model (s = iω, K = k_1 + c_1 s, Z = (m_a + m_b) s² + c_f s + k_f),

    T = X_1/X_b = K / (K + m_1 s² − N),      X_b = K_f I / (Z + K (1 − T)),      g = 2 |X_1| / ξ(Θ)

every Θ gives one motion in closed form, for a constant current, base amplitude or superior amplitude. A branch over the
gap results from a range of values of Θ. At a given gap, Θ is the root of one equation with one unknown. On the backbone
(T at −90°) frequency and DT depend on Θ alone: ω² M k_1 − ω² c_1 (c_1 + c_N) = k_1² with M = m_1 + the added mass and
c_N the added damping.

A motion is `stable` if all Floquet multipliers of rig and sphere together lie within the unit circle. They belong to
half a cycle: the flight, and the impact that ends it (its saltation matrix). The way in which a motion loses its
stability is named: fold, symmetry breaking, or torus. If the amplitude of the superior base or the phase is held
constant, a controller stabilises the structure, and only the motion of the sphere can become unstable
(`Manifold.stable`).

The theory is valid for one sphere between walls without friction of the guide, symmetric motion with two impacts per
cycle, m ≪ m_1, and contacts much shorter than the cycle. The first order of m/m_1 is included unless `recoil` is false.
e is the realised restitution of the contact law, not its nominal value. docs/explanation/prediction.md has the
derivation and a comparison with simulation.

**The slow invariant manifold** of a vibro-impact energy sink: two symmetric impacts per cycle, without any structure.
A sphere of mass m moves between two walls, each b = g/2 from the middle of a structure that moves as
x_1 = A cos(ωt + α). It strikes one wall every half cycle. Between impacts it flies freely, so its motion over the time
is a triangle of amplitude P whose corners are the impacts. With ξ = A/b and Θ = P/b, at the right wall (t = 0, speed
V = 2ωP/π before, −V after):

    position    P = A cos α + b                                        A cos α = b (Θ − 1)
    impact      V + v_1 = e (V − v_1)   →   v_1 = −ω ρ P               A sin α = b ρ Θ,    ρ = (2/π)(1 − e)/(1 + e)
    together    ξ² = (Θ − 1)² + ρ²Θ²    →   Θ = [1 + √((1 + ρ²) ξ² − ρ²)] / (1 + ρ²)

No such motion exists below ξ = ρ/√(1 + ρ²): the fold, g/A = 2√(1 + ρ²)/ρ. The triangle's fundamental is (8/π²) P cos
ωt, so the structure feels the force (8/π²) m ω² P cos ωt, which is N x_1 with

    N = (8/π²) m ω² [Θ(Θ − 1) − iρΘ²] / ξ²

that is, a mass (8/π²) m Θ(Θ − 1)/ξ² and, at its natural frequency, a damping ratio (4/π²)(m/m_1) ρ (Θ/ξ)².

**Recoil.** The structure's speed jumps by 2μV in an impact, μ = m/m_1, and its motion has odd harmonics, of which
near resonance the n-th is −(8/π²) μ P cos(nωt) / (n² − 1). To first order in μ this changes only two numbers:

    mean speed at the impact     −V (1 − e)(1 + μ)/(1 + e)                 ρ → ρ (1 + μ)
    sum of the harmonics there   −(8/π²) μ P Σ 1/(n² − 1) = −(2/π²) μ P    (Θ − 1) → (κΘ − 1),   κ = 1 + 2μ/π²
    so    ξ² = (κΘ − 1)² + ρ²Θ²,    Θ = [κ + √((κ² + ρ²) ξ² − ρ²)] / (κ² + ρ²),    fold at g/A = 2√(κ² + ρ²)/ρ

With μ = 0 these are the published formulas (`mass_ratio` = 0). With μ > 0 they agree with the exact orbits for
instantaneous impacts (Masri & Caughey) up to an error of the order μ².

**Stability of the sphere alone.** A half period maps small errors of the instant and speed of an impact into those of
the next. The matrix of this map has the determinant e² and the trace 2e − q, q = (π²/4)(1 + e)²(Θ − 1)/Θ. Its
eigenvalues are within the unit circle for 1/(1 + ρ²) < Θ < π²/(π² − 4). At the lower bound, the fold, an eigenvalue is
1; at the upper bound, where the two half cycles become different, one is −1. The smaller solution Θ of the quadratic
equation is below the fold and is never stable. (This map neglects the recoil, μ = 0.)

The theory neglects the order μ², the duration of a contact, and the effect of the harmonics away from resonance.

Sources: O. V. Gendelman & A. Alloni (2015), "Dynamics of forced system with vibro-impact energy sink", J. Sound Vib.
358, 301–314; E. Gourc, G. Michon, S. Seguy & A. Berlioz (2015), "Targeted energy transfer under harmonic forcing with
a vibro-impact nonlinear energy sink: analytical and experimental developments", J. Vib. Acoust. 137, 031008.
Recoil and both bounds of Θ are derived here.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.errors import ConfigError
from impact_rig.physics import contact as contact_laws
from impact_rig.physics.linear import Constants, MechanicsSetup, constants, sphere_mass_kg
from impact_rig.physics.linear_response import transmissibility

THETA_SYMMETRIC = math.pi**2 / (math.pi**2 - 4.0)
"""Largest Θ (amplitude of the sphere over half the gap) of a stable symmetric motion, for any restitution.

The value neglects the recoil of the structure.
"""

Real = NDArray[np.float64]
Complex = NDArray[np.complex128]


@attrs.frozen
class Manifold:
    """Family of closed-form motions, one for each Θ, of a sphere that strikes each wall once per cycle.

    A is the amplitude of the structure and b half the gap. The amplitude of the sphere is Θ b.

    Attributes:
        restitution: restitution of the impacts in (0, 1), as the contact law realises it, not its nominal value.
        mass_ratio: μ, mass of the sphere over that of the structure; 0 means that the structure does not recoil.

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
        """Loss parameter ρ = (2/π)(1 − e)(1 + μ)/(1 + e) of the impacts; it tends to 0 as e approaches 1."""
        return 2.0 / math.pi * (1.0 - self.restitution) / (1.0 + self.restitution) * (1.0 + self.mass_ratio)

    @property
    def kappa(self) -> float:
        """Factor κ = 1 + 2μ/π² (μ: `mass_ratio`) that accounts for the recoil of the structure; 1 without recoil."""
        return 1.0 + 2.0 * self.mass_ratio / math.pi**2

    @property
    def theta_fold(self) -> float:
        """Θ at the fold, κ/(κ² + ρ²): at a given gap, the motion with the smallest amplitude A of the structure."""
        return self.kappa / (self.kappa**2 + self.rho**2)

    @property
    def gap_per_amplitude_at_fold(self) -> float:
        """Largest gap over the structure's amplitude A at which two symmetric impacts exist, 2√(κ² + ρ²)/ρ."""
        return 2.0 * math.hypot(self.kappa, self.rho) / self.rho

    def theta(self, xi: Real | float) -> Real:
        """Return Θ of the motion for a given ξ, the structure's amplitude over half the gap.

        The result is NaN below the fold, where no such motion exists. Of two solutions, the larger one is returned,
        since the smaller one is never stable.
        """
        both = self.kappa**2 + self.rho**2
        square = both * np.asarray(xi, float) ** 2 - self.rho**2
        root: Real = np.sqrt(np.where(square >= 0.0, square, np.nan))
        return (self.kappa + root) / both

    def xi(self, theta: Real | float) -> Real:
        """Return ξ, the structure's amplitude over half the gap, of the motion with a given Θ.

        `theta` is Θ, the sphere's amplitude over half the gap. The result has the shape of `theta`.
        """
        found: Real = np.hypot(self.kappa * np.asarray(theta, float) - 1.0, self.rho * np.asarray(theta, float))
        return found

    def force(self, theta: Real) -> Complex:
        """Return the complex force N / (m ω²) of the sphere on the structure.

        N is the fundamental of the force, per displacement of the structure, and m is the mass of the sphere. The real
        part acts as an added mass, the negative imaginary part as damping. `theta` is Θ, the amplitude of the sphere
        over half the gap.
        """
        top = theta * (self.kappa * theta - 1.0) - 1j * self.rho * theta**2
        return np.asarray(8.0 / math.pi**2 * top / self.xi(theta) ** 2, np.complex128)

    def impact_phase_rad(self, theta: Real) -> Real:
        """Return α: the phase of the structure past its right turning point when the sphere strikes the right wall.

        `theta` is Θ, the amplitude of the sphere over half the gap.
        """
        found: Real = np.arctan2(self.rho * theta, self.kappa * theta - 1.0)
        return found

    def approach_speed(self, theta: Real) -> Real:
        """Return the sphere's speed relative to the wall before an impact, in units of ω b.

        The value is 4Θ(1 + μ) / (π(1 + e)). `theta` is Θ, the amplitude of the sphere over b, which is half the gap.
        """
        found: Real = 4.0 * (1.0 + self.mass_ratio) / (math.pi * (1.0 + self.restitution)) * theta
        return found

    def stable(self, theta: Real) -> NDArray[np.bool_]:
        """Return for each Θ whether the motion of the sphere is stable, that is, whether small errors decay.

        Θ is the sphere's amplitude over half the gap. The motion of the structure is taken as given.
        """
        found: NDArray[np.bool_] = (theta > self.theta_fold) & (theta < THETA_SYMMETRIC)
        return found


POINTS = 2000
"""Number of values of Θ on the grid for a branch (`LinearRig.thetas`)."""
BEYOND = 1.5
"""Largest Θ of a branch, as a multiple of `THETA_SYMMETRIC`, above which the motions are unstable."""
_NEAR_FOLD = 1e-9  # relative distance of Θ from the fold, where slopes are infinite
PAIRED = 1e-6  # imaginary part of a multiplier, over its absolute value, above which it is one of a complex pair
STABLE, FOLD, SYMMETRY, TORUS = "stable", "fold", "symmetry", "torus"
_HALVINGS = 45  # number of halvings of a step of Θ
_AT_ONCE = 32  # number of frequencies whose gaps are computed together, such that the arrays fit into a cache


@attrs.frozen(eq=False, kw_only=True)
class Branch:
    """Motions with two symmetric impacts per cycle, such as those along a curve; every attribute has the shape (n,).

    Attributes:
        frequency_hz: frequency of the drive.
        gap_m: gap g.
        current_a: coil current, peak.
        base_m: amplitude of the inferior base.
        superior_m: amplitude of the superior base.
        dt: displacement transmissibility.
        phase_rad: phase of the superior base relative to the inferior one, −π … π.
        impact_speed_m_s: speed of the sphere relative to the wall, before an impact.
        impact_phase_rad: phase of the superior base's motion when the sphere strikes the right wall, counted from the
            superior base's right turning point.
        theta: amplitude of the sphere over half the gap, Θ.
        stable: whether the motion is stable; for a constant amplitude of the superior base, and on a backbone, the
            motion of the sphere alone.
        kind: `stable`, or how it loses its stability: `fold`, `symmetry` (the half cycles become different) or `torus`
            (sphere and structure exchange a slow beat).
    """

    frequency_hz: Real
    gap_m: Real
    current_a: Real
    base_m: Real
    superior_m: Real
    dt: Real
    phase_rad: Real
    impact_speed_m_s: Real
    impact_phase_rad: Real
    theta: Real
    stable: NDArray[np.bool_]
    kind: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.theta)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> Branch:
        """Return some of the motions, selected by a mask or by indices."""
        return Branch(**{field.name: getattr(self, field.name)[which] for field in attrs.fields(Branch)})

    def reduction_percent(self, config: MechanicsSetup) -> Real:
        """Return the reduction of DT by the sphere of each motion, 100 (1 − DT / DT without the sphere) [%].

        `config` is the rig, which is needed for DT without the sphere.
        """
        without: Real = np.abs(transmissibility(config, self.frequency_hz))
        return 100.0 * (1.0 - self.dt / without)


@attrs.frozen
class HeldDrive:
    """Quantity that is held constant while gap or frequency changes: exactly one of the attributes is given.

    Attributes:
        current_a: coil current, peak.
        base_m: amplitude of the inferior base.
        superior_m: amplitude of the superior base.

    Raises:
        ConfigError: none or several are given, or the value is not finite and > 0.
    """

    current_a: float | None = None
    base_m: float | None = None
    superior_m: float | None = None

    def __attrs_post_init__(self) -> None:
        given = attrs.asdict(self, filter=lambda _, value: value is not None)
        if len(given) != 1:
            raise ConfigError(
                "exactly one amplitude must be held constant: current_a, base_m or superior_m, "
                f"got {' and '.join(given) or 'none'}"
            )
        for name, value in given.items():
            if not (math.isfinite(value) and value > 0.0):
                raise ConfigError(
                    f"{name}, the amplitude that the prediction holds constant, must be > 0 and finite, got {value!r}"
                )


class _Answer(NamedTuple):
    """Response of the linear rig to drive and sphere for given Θ, the sphere's amplitude over half the gap."""

    ratio: Complex  # X_1 / X_b
    current_a: Real
    base: Complex  # X_b
    superior_m: Real  # |X_1|
    gap_m: Real


@attrs.frozen
class LinearRig:
    """Data of a rig for the closed-form prediction: linear constants, mass of the sphere, and its motions."""

    linear: Constants
    sphere_kg: float
    manifold: Manifold

    @classmethod
    def of(cls, config: MechanicsSetup, *, recoil: bool = True) -> LinearRig:
        """Create the data of a configured rig.

        With `recoil` false, the recoil of the structure in an impact is neglected, as in the published formulas.

        Raises:
            ConfigError: the rig has no sphere, its guide has friction, or the realised restitution is not > 0 and < 1.
        """
        restitution = contact_laws.from_config(config.contact).realised_restitution()
        if not config.sphere.present:
            raise ConfigError("a prediction needs a sphere: sphere.present must be true, got false")
        if config.sphere.guide_friction > 0.0:
            raise ConfigError(
                "a prediction does not include friction of the guide: sphere.guide_friction must be 0, got "
                f"{config.sphere.guide_friction:g}"
            )
        if not 0.0 < restitution < 1.0:
            raise ConfigError(
                "a prediction needs a realised restitution > 0 and < 1: contact.law and contact.restitution give "
                f"{restitution:g}"
            )
        linear, sphere_kg = constants(config), sphere_mass_kg(config.sphere)
        return cls(linear, sphere_kg, Manifold(restitution, sphere_kg / linear.m_1 if recoil else 0.0))

    def thetas(self) -> Real:
        """Return an ascending grid of Θ for a branch, from the fold to beyond the bound of stable motion.

        Θ is the sphere's amplitude over half the gap. The grid is denser near the fold.
        """
        low, high = self.manifold.theta_fold * (1.0 + _NEAR_FOLD), BEYOND * THETA_SYMMETRIC
        return low + (high - low) * np.linspace(0.0, 1.0, POINTS) ** 2

    def gaps(self, theta: Real, frequency_hz: Real, held: HeldDrive) -> Real:
        """Return the gap [m] at which the motion with each Θ occurs; it is > 0.

        `theta` is Θ, the sphere's amplitude over half the gap. `theta` and `frequency_hz` are broadcast.
        """
        return self._answer(theta, frequency_hz, held).gap_m

    def _answer(self, theta: Real, frequency_hz: Real, held: HeldDrive) -> _Answer:
        c = self.linear
        s: Complex = np.asarray(2j * math.pi * frequency_hz, np.complex128)
        force = self.sphere_kg * (2.0 * math.pi * frequency_hz) ** 2 * self.manifold.force(theta)
        k = c.k_1 + c.c_1 * s
        ratio = k / (k + c.m_1 * s**2 - force)
        per_current = c.force_factor / (c.m_base * s**2 + c.c_f * s + c.k_f + k * (1.0 - ratio))
        if held.current_a is not None:
            current = np.full(theta.shape, held.current_a)
        elif held.base_m is not None:
            current = held.base_m / np.abs(per_current)
        else:
            assert held.superior_m is not None
            current = held.superior_m / np.abs(per_current * ratio)
        base = current * per_current
        superior = np.abs(base * ratio)
        return _Answer(ratio, current, base, superior, 2.0 * superior / self.manifold.xi(theta))

    def motions(self, theta: Real, frequency_hz: Real | float, held: HeldDrive) -> Branch:
        """Return the motions with these Θ, shape (n,), each with the gap at which it occurs and its stability.

        `theta` is Θ, the sphere's amplitude over half the gap. `frequency_hz` is one value for all motions, or has the
        shape (n,).
        """
        manifold = self.manifold
        frequency = np.broadcast_to(np.asarray(frequency_hz, float), theta.shape).copy()
        answer = self._answer(theta, frequency, held)
        ratio, current, base, superior, gap = answer
        if held.superior_m is not None:  # a controller stabilises the structure
            kind = np.where(manifold.stable(theta), STABLE, np.where(theta < THETA_SYMMETRIC, FOLD, SYMMETRY))
        else:
            kind = _kinds(self._multipliers(theta, frequency, answer, held))
        return Branch(
            frequency_hz=frequency,
            gap_m=gap,
            current_a=current,
            base_m=np.abs(base),
            superior_m=superior,
            dt=np.abs(ratio),
            phase_rad=np.angle(ratio),
            impact_speed_m_s=manifold.approach_speed(theta) * (2.0 * math.pi * frequency) * gap / 2.0,
            impact_phase_rad=manifold.impact_phase_rad(theta),
            theta=theta,
            stable=kind == STABLE,
            kind=kind,
        )

    def _multipliers(self, theta: Real, frequency_hz: Real, answer: _Answer, held: HeldDrive) -> Complex:
        """Return the Floquet multipliers of each motion over half a cycle; shape (n, 6), or (n, 4) for a held base.

        A motion is unstable if a multiplier is outside the unit circle. The multipliers are the eigenvalues of −S Φ,
        with the transition matrix Φ of the flight between impacts, and the saltation matrix S of the impact. `theta` is
        Θ, the sphere's amplitude over half the gap.

        Source: Leine & Nijmeijer 2004, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, chapter 7.
        """
        c, manifold = self.linear, self.manifold
        free = held.base_m is None  # whether the base can move
        matrix = np.zeros((4, 4))
        matrix[[0, 2], [1, 3]] = 1.0
        matrix[1] = np.array([-c.k_f - c.k_1, -c.c_f - c.c_1, c.k_1, c.c_1]) / c.m_base
        matrix[3] = np.array([c.k_1, c.c_1, -c.k_1, -c.c_1]) / c.m_1
        own = slice(0, 4) if free else slice(2, 4)
        values, vectors = np.linalg.eig(matrix[own, own].astype(np.complex128))
        omega, n = 2.0 * math.pi * frequency_hz, len(theta)
        half_s, size = math.pi / omega, len(values) + 2
        flight = np.zeros((n, size, size))
        growth = np.exp(values * half_s[:, None])
        flight[:, :-2, :-2] = ((vectors * growth[:, None, :]) @ np.linalg.inv(vectors)).real
        flight[:, -2:, -2:] = np.eye(2)
        flight[:, -2, -1] = half_s
        # before and after the impact at the right wall
        e, mu, b = manifold.restitution, manifold.mass_ratio, 0.5 * answer.gap_m
        speed, approach = 2.0 * omega * b * theta / math.pi, manifold.approach_speed(theta) * omega * b
        # speed of the superior base; that of the sphere is ± `speed`
        before, after = speed - approach, -speed + e * approach
        base = answer.superior_m * np.exp(1j * manifold.impact_phase_rad(theta)) / answer.ratio
        x_b, v_b, x_1 = base.real, (1j * omega * base).real, b * (theta - 1.0)
        jump = np.broadcast_to(np.eye(size), (n, size, size)).copy()
        i_v1, i_v2 = size - 3, size - 1
        jump[:, i_v1, [i_v1, i_v2]] = np.array([1.0 - mu * (1.0 + e) / (1.0 + mu), mu * (1.0 + e) / (1.0 + mu)])
        jump[:, i_v2, [i_v1, i_v2]] = np.array([(1.0 + e) / (1.0 + mu), 1.0 - (1.0 + e) / (1.0 + mu)])
        # derivatives of the state, before and after; the force of the coil is equal in both
        rates = np.zeros((2, n, size))
        for side, v_1, v_2 in ((0, before, speed), (1, after, -speed)):
            rates[side, :, -4], rates[side, :, -2] = v_1, v_2
            rates[side, :, -3] = (c.k_1 * (x_b - x_1) + c.c_1 * (v_b - v_1)) / c.m_1
            if free:
                rates[side, :, 0] = v_b
                rates[side, :, 1] = c.c_1 * v_1 / c.m_base
        normal = np.zeros(size)
        normal[[-4, -2]] = -1.0, 1.0
        left = rates[1] - (jump @ rates[0][:, :, None])[:, :, 0]
        saltation = jump + left[:, :, None] * normal / approach[:, None, None]
        return np.asarray(np.linalg.eigvals(-saltation @ flight), np.complex128)


def _kinds(multipliers: Complex) -> NDArray[np.str_]:
    """Return for each motion whether it is stable, or how it loses its stability, as in `Branch.kind`.

    The largest of its Floquet multipliers of half a cycle decides. The multipliers have the shape (n, k).
    """
    largest = np.take_along_axis(multipliers, np.abs(multipliers).argmax(axis=1)[:, None], axis=1)[:, 0]
    paired = np.abs(largest.imag) > PAIRED * np.abs(largest)
    lost = np.where(paired, TORUS, np.where(largest.real > 0.0, FOLD, SYMMETRY))
    return np.asarray(np.where(np.abs(largest) < 1.0, STABLE, lost))


def branch(
    config: MechanicsSetup,
    frequency_hz: float,
    *,
    current_a: float | None = None,
    base_m: float | None = None,
    superior_m: float | None = None,
    recoil: bool = True,
) -> Branch:
    """Return the motions with two symmetric impacts per cycle at one frequency, for all gaps at which they exist.

    The motions are in the order of increasing Θ, the sphere's amplitude over half the gap, starting at the fold. The
    branch has `POINTS` motions and ends where motions are unstable. Exactly one of `current_a`, `base_m` and
    `superior_m` must be given. This quantity is held constant along the branch.

    Args:
        config: the rig; its own gap is ignored.
        frequency_hz: frequency of the drive.
        current_a: peak coil current.
        base_m: amplitude of the inferior base.
        superior_m: amplitude of the superior base.
        recoil: whether the structure recoils in an impact, to first order in m/m_1; False means the published formulas.

    Raises:
        ConfigError: the rig has no sphere, its guide has friction, or the realised restitution is not > 0 and < 1. Or
            not exactly one constant quantity is given, or it is not finite and > 0.
    """
    rig = LinearRig.of(config, recoil=recoil)
    return rig.motions(rig.thetas(), frequency_hz, HeldDrive(current_a, base_m, superior_m))


def at(
    config: MechanicsSetup,
    frequency_hz: float,
    gap_m: float,
    *,
    current_a: float | None = None,
    base_m: float | None = None,
    superior_m: float | None = None,
    recoil: bool = True,
) -> Branch:
    """Return all motions with two symmetric impacts per cycle at one frequency and gap.

    The motion with the largest amplitude of the sphere is first. The result has the length 0 if there are no such
    motions. Unstable motions beyond the end of a `branch` are left out. Exactly one of `current_a`, `base_m` and
    `superior_m` must be given.

    Raises:
        ConfigError: as for `branch`.
    """
    rig, held = LinearRig.of(config, recoil=recoil), HeldDrive(current_a, base_m, superior_m)
    (theta,) = _roots(rig, np.array([frequency_hz], float), gap_m, held)
    return rig.motions(theta, frequency_hz, held)


def curves(
    config: MechanicsSetup,
    frequencies_hz: Real,
    gap_m: float,
    *,
    current_a: float | None = None,
    base_m: float | None = None,
    superior_m: float | None = None,
    recoil: bool = True,
) -> list[Branch]:
    """Return the motions with two symmetric impacts per cycle at one gap, as curves over the frequency.

    Each branch in the list is one continuous curve. The list is empty if there are no such motions. Curves end and
    begin where the number of motions changes. The arguments are those of `branch`, but `frequencies_hz` is ascending,
    shape (n,). Exactly one of `current_a`, `base_m` and `superior_m` must be given.

    Raises:
        ConfigError: as for `branch`.
    """
    rig, held = LinearRig.of(config, recoil=recoil), HeldDrive(current_a, base_m, superior_m)
    frequencies = np.asarray(frequencies_hz, float)
    found = _roots(rig, frequencies, gap_m, held)
    lines: list[Branch] = []
    for first, last in _stretches([len(roots) for roots in found]):
        for sheet in range(len(found[first])):
            theta = np.array([roots[sheet] for roots in found[first:last]])
            lines.append(rig.motions(theta, frequencies[first:last], held))
    return lines


def backbone(config: MechanicsSetup, gap_m: float, *, recoil: bool = True) -> Branch:
    """Return the motions at resonance (the superior base a quarter cycle behind the inferior base) at one gap.

    The amplitude grows along the branch, from the fold on. Each motion has its own frequency, current and
    displacement transmissibility (DT). `recoil` says whether the structure recoils in an impact, to first order in
    m/m_1; False means the published formulas.

    Raises:
        ConfigError: the rig has no sphere, its guide has friction, or the realised restitution is not > 0 and < 1.
    """
    rig = LinearRig.of(config, recoil=recoil)
    c, theta = rig.linear, rig.thetas()
    force = rig.manifold.force(theta)
    mass, damping_per_omega = c.m_1 + rig.sphere_kg * force.real, -rig.sphere_kg * force.imag
    omega = np.full(theta.shape, math.sqrt(c.k_1 / c.m_1))
    for _ in range(60):  # the damping terms are of the order ζ²: the iteration converges in a few rounds
        omega = c.k_1 / np.sqrt(c.k_1 * mass - c.c_1 * (c.c_1 + damping_per_omega * omega))
    frequency = omega / (2.0 * math.pi)
    unit = rig.motions(theta, frequency, HeldDrive(superior_m=1.0))
    size = gap_m / unit.gap_m
    return attrs.evolve(
        unit,
        gap_m=np.full(theta.shape, gap_m),
        current_a=unit.current_a * size,
        base_m=unit.base_m * size,
        superior_m=unit.superior_m * size,
        impact_speed_m_s=unit.impact_speed_m_s * size,
    )


def widest_gap_m(motions: Branch) -> float:
    """Return the largest gap [m] at which this branch has a motion; the branch must not be empty."""
    return float(np.max(motions.gap_m))


def best_gap(motions: Branch) -> Branch:
    """Return the stable motion with the smallest DT on a branch over the gap, as a branch of length 1.

    The length is 0 if no motion is stable.
    """
    stable = np.flatnonzero(motions.stable)
    if not len(stable):
        return motions.take(stable)
    return motions.take(stable[[int(np.argmin(motions.dt[stable]))]])


def _roots(rig: LinearRig, frequencies_hz: Real, gap_m: float, held: HeldDrive) -> list[Real]:
    """Return Θ of all motions with two symmetric impacts per cycle at one gap, as one array per frequency.

    Θ is the sphere's amplitude over half the gap. Each array is in descending order of Θ. Values above `BEYOND` ·
    `THETA_SYMMETRIC` are left out. `held` is the amplitude that is held constant.
    """
    grid = rig.thetas()
    rows, columns = [], []
    for first in range(0, len(frequencies_hz), _AT_ONCE):
        some = frequencies_hz[first : first + _AT_ONCE]
        under = np.signbit(rig.gaps(np.broadcast_to(grid, (len(some), len(grid))), some[:, None], held) - gap_m)
        row, column = np.nonzero(under[:, :-1] != under[:, 1:])
        rows.append(row + first)
        columns.append(column)
    place, at = np.concatenate(rows), np.concatenate(columns)
    low, high, frequency = grid[at], grid[at + 1], frequencies_hz[place]
    under_low = np.signbit(rig.gaps(low, frequency, held) - gap_m)
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        same = np.signbit(rig.gaps(middle, frequency, held) - gap_m) == under_low
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    theta = 0.5 * (low + high)
    return [np.sort(theta[place == i])[::-1].copy() for i in range(len(frequencies_hz))]


def _stretches(counts: list[int]) -> Iterator[tuple[int, int]]:
    """Yield (first, end) of each longest run of equal counts > 0; the run has the indices first … end − 1.

    `counts` are the numbers of motions at successive frequencies.
    """
    first = 0
    for place in range(1, len(counts) + 1):
        if place == len(counts) or counts[place] != counts[first]:
            if counts[first]:
                yield first, place
            first = place
