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
"""Least-squares fit of the rig's constants to measurements: `identify` returns their values with uncertainties.

X_1 and X_b are the complex displacement amplitudes of the superior and the inferior base. I is the complex amplitude of
the current, T = X_1 / X_b, and DT = |T|. The measured quantities and their models are:

    ln f_n, ln ζ                  measured by the free decay
    ln DT, phase of T             closed form T(f; f_n, ζ)
    ln |X_b / I|                  closed form K_f / |k_f − M ω² + iω c_f − m_1 ω² T|
    ln (DT with / DT without)     simulation with the configured contact law, e free about its nominal value

"With" and "without" refer to the sphere. Without the sphere, a common factor of all masses and forces changes no
motion, so the data determine m_1 only as a ratio to other constants. With the sphere, whose mass is known, the
reductions of DT determine the mass of the structure.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence

import attrs
import numpy as np
import scipy

from impact_rig.analysis.calibration import Real
from impact_rig.analysis.scans import BASE, CURRENT, LASER
from impact_rig.config.tree import Value
from impact_rig.errors import ConfigError, SimulationError
from impact_rig.physics.linear_response import base_per_ampere, transmissibility
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.states import Regime
from impact_rig_studies.dynamics.stroboscope import Place
from impact_rig_studies.identification.measurements import GAIN_CURRENT, NUISANCES, Measured
from impact_rig_studies.identification.motions import SettledMotion, SettledRig, place_of

# --- The constants that are identified, as logarithms, and the rig that they make.

NAMES = ("f_n", "ζ", "m_1", "K_f", "k_f", "M", "c_f")
"""Names of the identified constants.

Structure: natural frequency, damping ratio, mass of the superior base. Shaker: force factor, suspension stiffness,
moving mass (armature and inferior base), damping.
"""
UNITS = ("Hz", "-", "kg", "N/A", "N/m", "kg", "N s/m")
SCALED = ("m_1", "K_f", "k_f", "M", "c_f")
"""Masses and forces: a common factor of all of them changes no motion, unless a sphere of known mass takes part."""
SCALE = np.array([float(name in SCALED) for name in NAMES])  # change of the log constants by that factor, per its log


START = np.log([9.0, 0.005, 0.2, 6.0, 8000.0, 2.5, 60.0])
"""Logarithms of the constants at the start of a fit: round numbers of the right order of magnitude."""


def logarithms(config: RigConfig) -> Real:
    """Return the natural logarithms of the constants of a rig, in the order of `NAMES`, shape (7,)."""
    structure, shaker = config.structure, config.shaker
    return np.log([
        structure.natural_frequency_hz, structure.damping_ratio, structure.mass_kg, shaker.force_factor_n_a,
        shaker.suspension_stiffness_n_m, shaker.armature_mass_kg + shaker.base_mass_kg, shaker.damping_n_s_m,
    ])  # fmt: skip


def rig(base: RigConfig, log_constants: Real) -> RigConfig:
    """Return the configuration `base` with other values of the identified constants.

    `log_constants` contains the natural logarithms of the new values, in the order of `NAMES`. The moving mass M is
    divided between armature and inferior base in the ratio that `base` has.

    Raises:
        ConfigError: a constant is out of its range.
    """
    values = dict(zip(NAMES, (float(value) for value in np.exp(log_constants)), strict=True))
    moving = base.shaker.armature_mass_kg + base.shaker.base_mass_kg
    changes: Mapping[str, Value] = {
        "structure.natural_frequency_hz": values["f_n"],
        "structure.damping_ratio": values["ζ"],
        "structure.mass_kg": values["m_1"],
        "shaker.force_factor_n_a": values["K_f"],
        "shaker.suspension_stiffness_n_m": values["k_f"],
        "shaker.armature_mass_kg": base.shaker.armature_mass_kg * values["M"] / moving,
        "shaker.base_mass_kg": base.shaker.base_mass_kg * values["M"] / moving,
        "shaker.damping_n_s_m": values["c_f"],
    }
    return from_flat(base, changes)


# --- What a least-squares problem determines: Fisher information, its singular values, and combinations of parameters.
# Parameters are logarithms, so a direction in their space is a product of powers, and 1/s, s a singular value of the
# whitened Jacobian, is the relative standard uncertainty of that product. Nuisance parameters (for example gain errors
# of sensors) are eliminated first: effects that they can imitate are no information.


DETERMINED = 0.2  # relative standard uncertainty up to which a parameter, or a combination, counts as determined
LEAST_SHARE = 0.05  # power, relative to the largest, below which a parameter is left out of a combination's text
SMALLEST = 1e-9  # singular value, relative to the largest, below which it counts as a rounding error of 0
UNTOUCHED = 1e-3
"""Component of a unit vector below which a parameter counts as absent from an undetermined combination."""


@attrs.frozen(eq=False)
class Combination:
    """Product of powers of parameters, such as K_f / m_1, with the uncertainty to which the data determine it."""

    powers: Real  # power of each parameter, shape (n,); the largest is 1
    u_relative: float  # relative standard uncertainty of the product; infinite if the data contain nothing on it
    text: str  # the product for users, such as "K_f · m_1^-1"

    @property
    def determined(self) -> bool:
        """Return whether the relative standard uncertainty of this combination is at most `DETERMINED`."""
        return self.u_relative <= DETERMINED


@attrs.frozen(eq=False)
class Information:
    """Accuracy to which data determine parameters: each parameter alone, and combinations of parameters."""

    names: tuple[str, ...]  # names of the parameters
    combinations: tuple[Combination, ...]  # uncorrelated combinations, as many as parameters, the best determined first
    # relative standard uncertainty of each parameter with all others unknown as well; infinite if it is part of a
    # combination on which the data contain nothing
    u_relative: Real

    def determined(self, name: str) -> bool:
        """Return whether the relative standard uncertainty of a parameter is at most `DETERMINED`."""
        return bool(self.u_relative[self.names.index(name)] <= DETERMINED)


def information(names: Sequence[str], jacobian: Real, nuisances: Real | None = None) -> Information:
    """Compute how well data determine parameters, from the derivatives of the data's residuals.

    Args:
        names: names of the n parameters.
        jacobian: derivatives d residual / d ln parameter, shape (m, n). Each residual is divided by its standard
            uncertainty.
        nuisances: derivatives of the same residuals by k nuisance parameters, shape (m, k), or None. Prior knowledge of
            the nuisance parameters must be contained in the m residuals.
    """
    matrix = np.asarray(jacobian, float)
    if nuisances is not None and nuisances.shape[1]:
        basis, _ = np.linalg.qr(nuisances)
        matrix = matrix - basis @ (basis.T @ matrix)
    _, values, directions = np.linalg.svd(matrix, full_matrices=True)
    padded = np.zeros(len(names))
    padded[: len(values)] = values
    padded[padded < SMALLEST * padded.max(initial=0.0)] = 0.0
    with np.errstate(divide="ignore"):
        spread = 1.0 / padded
    combinations = tuple(
        _combination(names, direction, float(u)) for direction, u in zip(directions, spread, strict=True)
    )
    takes_part = np.isfinite(spread)[:, None] | (np.abs(directions) > UNTOUCHED)
    with np.errstate(invalid="ignore"):
        terms = np.where(takes_part, directions**2 * (spread**2)[:, None], 0.0)
    return Information(tuple(names), combinations, np.sqrt(terms.sum(axis=0)))


def _combination(names: Sequence[str], direction: Real, u: float) -> Combination:
    largest = int(np.argmax(np.abs(direction)))
    powers = direction / direction[largest]
    size = float(np.linalg.norm(powers))
    parts = [
        name if math.isclose(power, 1.0, abs_tol=5e-3) else f"{name}^{power:.2g}"
        for name, power in sorted(zip(names, powers, strict=True), key=lambda item: -abs(item[1]))
        if abs(power) >= LEAST_SHARE
    ]
    return Combination(powers, u * size, " · ".join(parts))


# --- The fit

STEP = 1e-6  # step of logarithms for the derivatives of closed forms
U_SIMULATED = 1e-4
"""Relative standard uncertainty of a simulated ratio of DT, due to the rest of the transient of a settled motion."""
SIGNIFICANCE = 0.01  # probability of a fit this bad or worse, below which the fit is reported as inconsistent
ITERATIONS = 30  # maximum number of steps of the fit of the closed forms
CONVERGED = 1e-4  # step, in standard uncertainties, that ends the fit of the closed forms
ROUNDS = 8  # maximum number of steps in which the constants are fitted to the reductions at a fixed e
SMALL = 0.05  # step, in standard uncertainties, that ends such a fit
SCATTERED = 0.5  # the same if a motion is irregular, as its mean scatters
RANK = 1e-6
"""Singular value, relative to the largest, below which a direction is not determined: the accuracy of derivatives."""
UNBOUND = 1.0
"""Relative standard uncertainty above which the fit hardly changes a constant: weak data would move it too far."""
LARGEST_STEP = 0.5  # largest change of a logarithm in one step of a fit
LEAST_RESTITUTION, MOST_RESTITUTION = 0.02, 0.98  # range of a fitted e


@attrs.frozen(eq=False)
class Alternative:
    """Set of constants that explains the data, one of several clearly different sets, with its probability.

    The probabilities of all sets may add up to less than 1, because improbable sets are left out.
    """

    share: float  # probability of this explanation, between 0 and 1
    log_constants: Real  # logarithms of the constants in the order of `NAMES`
    u_relative: Real  # relative standard uncertainties of the constants, in the same order
    restitution: float  # nominal e of this explanation
    u_restitution: float  # standard uncertainty of that e


@attrs.frozen(eq=False)
class Identified:
    """Result of an identification: constants of the rig with uncertainties, and whether model and data agree."""

    # logarithms in the order of `NAMES`; constants that the data do not determine stay near the start of the fit
    log_constants: Real
    information: Information  # how well the data determine the constants, and combinations of them
    chi_square: float  # sum of squared whitened residuals at the best fit, including priors of e and of the nuisances
    freedom: int  # degrees of freedom: number of residuals minus number of determined parameters
    config: RigConfig  # configuration given as known, with the identified constants instead of its own
    restitution: float = math.nan  # fitted nominal e; NaN without reductions, as is u_restitution
    u_restitution: float = math.nan
    irregular: Mapping[float, float] = attrs.field(factory=dict)
    """Standard uncertainty of the simulated ln(DT with the sphere / DT without), by gap [m] with an irregular motion.

    Irregular means that the simulated motion of the best fit is not periodic. DT is then a mean over many cycles. Its
    uncertainty includes the jumps of this mean under small changes of the constants.
    """
    contradicted: tuple[float, ...] = ()
    """Gaps [m] of `irregular` at which the measured motion is periodic, but the simulated one would not look so."""
    alternatives: tuple[Alternative, ...] = ()
    """Clearly different sets of constants that fit the data, the most probable first; empty if there is only one.

    The values in the other fields are then means over all of them, and the uncertainties include their differences.
    """
    converged: bool = True  # whether the last step was small; otherwise the uncertainties do not belong to a minimum

    @property
    def chance(self) -> float:
        """Probability that random errors alone make χ² at least this large (p-value); 1 if `freedom` is not > 0."""
        return float(scipy.special.chdtrc(self.freedom, self.chi_square)) if self.freedom > 0 else 1.0

    @property
    def consistent(self) -> bool:
        """Return whether the fit has converged, `chance` is at least `SIGNIFICANCE`, and no gap is `contradicted`.

        At a contradicted gap the measured motion is periodic, but the simulated one is clearly not.
        """
        return self.converged and self.chance >= SIGNIFICANCE and not self.contradicted

    @property
    def ambiguous(self) -> bool:
        """Return whether clearly different sets of constants fit the data, see `alternatives`."""
        return len(self.alternatives) > 1

    def value(self, name: str) -> float:
        """Return the value of a constant, in its unit in `UNITS`."""
        return float(np.exp(self.log_constants[NAMES.index(name)]))

    def u(self, name: str) -> float:
        """Return the standard uncertainty of a constant, in its unit in `UNITS`; infinite if nothing is known of it."""
        return self.value(name) * float(self.information.u_relative[NAMES.index(name)])


def identify(
    measured: Measured, known: RigConfig, start: Real = START, on_step: Callable[[str], None] = lambda _: None
) -> Identified:
    """Fit the constants of the rig (`NAMES`) to measurements by least squares.

    If `measured` contains reductions of DT by the sphere, the nominal coefficient of restitution e is fitted as well.
    It is not fitted if its standard uncertainty `measured.u_restitution` is 0.

    Args:
        measured: the measurements.
        known: configuration with the known sphere, contact law, nominal e and barriers. Its values of the constants in
            `NAMES` are ignored, except for the ratio of armature mass to mass of the inferior base.
        start: logarithms of the constants at the start of the fit, in the order of `NAMES`.
        on_step: receives a description of each step for the user.

    Raises:
        ConfigError: `measured` contains no data, or a constant leaves its range before the fit with the sphere begins.
        SimulationError: no start of the fit with the sphere leads to a result, because the sphere's motion at a
            measured gap cannot be simulated, or a constant leaves its range.
    """
    if measured.decay is None and measured.sine is None and measured.reduced is None:
        raise ConfigError(
            "nothing to identify from: at least one of free decay, stepped sine without the sphere, or reductions of "
            "DT by the sphere is needed; all are missing, or left out by --without"
        )
    theta, nuisance = _with_estimates(measured, start), np.zeros(len(NUISANCES))
    converged = False
    for _ in range(ITERATIONS if measured.decay or measured.sine else 0):
        residual, jacobian, bent = _linear(measured, known, theta, nuisance)
        change, along = _step(residual, jacobian, bent)
        theta, nuisance = theta + change, nuisance + along
        # measured by the data: along undetermined directions, rounding in the derivatives moves the constants forever
        converged = bool(np.linalg.norm(jacobian @ change + bent @ along) < CONVERGED)
        if converged:
            break
    if measured.reduced is not None:
        return _with_reductions(measured, known, theta, nuisance, on_step)
    residual, jacobian, bent = _linear(measured, known, theta, nuisance)
    found = information(NAMES, jacobian, bent)
    freedom = len(residual) - len(NUISANCES) - sum(one.determined for one in found.combinations)
    return Identified(theta, found, float(residual @ residual), freedom, rig(known, theta), converged=converged)


def _with_estimates(measured: Measured, start: Real) -> Real:
    """Return `start` with f_n and ζ replaced by estimates from the measurements.

    `start` contains log constants in the order of `NAMES`. The estimates are taken from the free decay. Without a free
    decay they are taken from the peak of DT in the stepped sine. Without both, f_n and ζ are unchanged.
    """
    theta = start.copy()
    if measured.decay is not None:
        theta[:2] = np.log([measured.decay.natural_frequency_hz, measured.decay.damping_ratio])
    elif measured.sine is not None:
        peak = int(np.argmax(measured.sine.dt))
        theta[:2] = np.log([measured.sine.frequency_hz[peak], 0.5 / measured.sine.dt[peak]])
    return theta


def _damping(bent: Real) -> Real:
    """Return additional rows for the matrix of derivatives, which keep undetermined constants near their values.

    The shape is (7, 7 + k), for 7 constants and k nuisance parameters. `bent` has the shape (m, k); its values do not
    matter.
    """
    return np.eye(len(NAMES), len(NAMES) + bent.shape[1]) / UNBOUND


def _step(residual: Real, jacobian: Real, bent: Real) -> tuple[Real, Real]:
    """Return the next Gauss-Newton step of a fit: changes of the log constants, and of the nuisance parameters.

    Constants that the data hardly determine change little. The step is shortened so that no value changes by more than
    `LARGEST_STEP`.

    Args:
        residual: whitened residuals, shape (m,).
        jacobian: derivatives of the residuals by the log constants, shape (m, 7).
        bent: derivatives of the residuals by the nuisance parameters, shape (m, 6).
    """
    damped = _damping(bent)
    whole = np.concatenate([np.concatenate([jacobian, bent], axis=1), damped])
    size = np.maximum(np.linalg.norm(whole, axis=0), 1e-30)  # so that f_n, by far the best known, does not hide others
    change = -np.linalg.lstsq(whole / size, np.append(residual, np.zeros(len(damped))), rcond=RANK)[0] / size
    change *= min(1.0, LARGEST_STEP / max(float(np.abs(change).max()), 1e-30))
    return change[: len(NAMES)], change[len(NAMES) :]


# --- Reductions. The masses follow from them, and e is known beforehand within its uncertainty only. χ² is not smooth -
# in e: if the sphere strikes in another pattern, the slopes change, and the data may have another explanation.
# Therefore χ² is profiled: the constants are fitted at many fixed values of e. The result is the mean over the profile,
# weighted by the probability of each e, and includes its spread.

FACTORS = np.arange(-1.2, 1.21, 0.08)  # logarithms of the common factor of forces and masses that are tried first
U_FACTOR = 0.03  # relative uncertainty of a ratio of DT that is assumed to compare these factors
TRIED, WORSE = 3, 24.0  # number of factors that start a fit, and largest excess of χ² over the best one
COARSE_E = np.arange(-30, 31) / 10.0
"""First values of e: distances from the nominal e in prior standard uncertainties.

The minimum of χ² at the right e can be as narrow as 0.12 of this uncertainty; a step of 0.25 misses it.
"""
MINIMA = 6  # number of values of e from which a minimum is searched
PROPOSED = 4  # number of steps towards each minimum
NEAR_E = 0.3  # distance to an existing value of e, in standard uncertainties, below which no value is added
KNOWN = 0.05  # change of the density over an interval of e, as a share of the area, that needs no further value
MOST_E = 100  # maximum number of values of e
# largest change of e, and of the relative mass, over which slopes of one kind of motion are valid
SAME_E, SAME_M = 0.01, 0.01
GRID = 4001  # number of points at which the profile is interpolated
SEPARATE, LEAST_PART = 0.1, 0.05
"""Criteria of separate explanations: density between two, as a share of the lower peak; smallest probability."""
APART = 2.0  # distance, in the sum of both standard uncertainties, above which constants of explanations differ


@attrs.frozen(eq=False)
class _Held:
    """Fit of the constants at a fixed coefficient of restitution e: a point of the profile of χ² over e."""

    e: float  # the fixed nominal e
    theta: Real  # logarithms of the constants, in the order of `NAMES`
    nuisance: Real  # nuisance parameters, in the order of `NUISANCES`
    chi_square: float  # sum of the squared whitened residuals
    misfit: float  # −2 ln of the likelihood: χ², and a term for uncertainties that depend on the motion
    jacobian: Real  # derivatives of the whitened residuals by the log constants
    bent: Real  # their derivatives by the nuisance parameters
    by_e: Real  # their derivatives by e
    residual: Real  # whitened residuals, including those of the prior knowledge of e and of the nuisance parameters
    motions: Mapping[float, SettledMotion]  # simulated motion by gap [m]
    converged: bool  # whether the last step of the fit was small

    @functools.cached_property
    def cost(self) -> float:
        """−2 ln of the probability of this e, up to a constant that is the same for every e.

        The probability is the likelihood, integrated over the constants and nuisance parameters. For the integral, the
        likelihood is approximated by a normal distribution.
        """
        whole = np.concatenate([np.concatenate([self.jacobian, self.bent], axis=1), _damping(self.bent)])
        return self.misfit + 2.0 * float(np.log(np.abs(np.diag(np.linalg.qr(whole, mode="r")))).sum())

    def covariance(self) -> Real:
        """Return the covariance matrix of the log constants at this fixed e, nuisance parameters free; shape (7, 7).

        Along directions that the data do not determine, the variance is 0.
        """
        basis, _ = np.linalg.qr(self.bent)
        matrix = self.jacobian - basis @ (basis.T @ self.jacobian)
        size = np.maximum(np.linalg.norm(matrix, axis=0), 1e-30)
        inverse = np.linalg.pinv(matrix / size, rcond=RANK) / size[:, None]
        return np.asarray(inverse @ inverse.T)

    def proposal(self) -> tuple[float, float]:
        """Estimate the e with the smallest χ², and return this e and its standard uncertainty.

        The residuals are extrapolated linearly from this fit, while constants and nuisance parameters adapt.
        """
        others = np.concatenate([self.jacobian, self.bent], axis=1)
        size = np.maximum(np.linalg.norm(others, axis=0), 1e-30)
        basis, values, _ = np.linalg.svd(others / size, full_matrices=False)
        basis = basis[:, values > RANK * values[0]]
        left = self.by_e - basis @ (basis.T @ self.by_e)
        power = float(left @ left)
        return self.e - float(left @ self.residual) / power, 1.0 / math.sqrt(power)


def _with_reductions(
    measured: Measured, known: RigConfig, theta: Real, nuisance: Real, on_step: Callable[[str], None]
) -> Identified:
    """Fit constants and e to all data, including the reductions of DT by the sphere.

    The fit starts at the log constants `theta` and the nuisance parameters `nuisance`, which fit the data without the
    sphere.
    """
    profile = _Profile(measured, known)
    on_step("estimating the masses from the motion with the sphere")
    starts = profile.factors(theta)
    on_step(f"fitting all constants at fixed values of the coefficient of restitution e, from {len(starts)} starts")
    held = profile.run(starts, nuisance, on_step)
    best = min(held, key=lambda one: one.cost)
    mean, covariance, alternatives = _summary(held)
    constants, e, u_e = mean[:-1], float(mean[-1]), math.sqrt(float(covariance[-1, -1]))
    if np.linalg.matrix_rank(covariance[:-1, :-1] / np.outer(*2 * [np.sqrt(np.diag(covariance)[:-1])])) == len(NAMES):
        found = information(NAMES, np.linalg.cholesky(np.linalg.inv(covariance[:-1, :-1])).T)
    else:  # the data do not determine everything
        found = information(NAMES, best.jacobian, np.column_stack([best.bent, best.by_e]))
    determined = sum(combination.determined for combination in found.combinations)
    irregular = {gap: motion.u for gap, motion in best.motions.items() if motion.regime != Regime.PERIODIC.value}
    assert measured.reduced is not None
    regimes, periodic = measured.reduced.regimes, Regime.PERIODIC.value
    contradicted = [gap for gap in irregular if regimes[gap] == periodic != best.motions[gap].seen]
    return Identified(
        constants, found, best.chi_square, len(best.residual) - len(NUISANCES) - 1 - determined,
        from_flat(rig(known, constants), {"contact.restitution": e}), e, u_e, irregular,
        tuple(contradicted), alternatives, best.converged,
    )  # fmt: skip


class _Profile:
    """Profile of χ² over e: the best fit of the constants at each of many fixed values of e."""

    def __init__(self, measured: Measured, known: RigConfig) -> None:
        assert measured.reduced is not None
        self._measured, self._reduced, self._known = measured, measured.reduced, known
        self._uncertain = _prior(measured) > 0.0
        self._nominal, self._u = known.contact.restitution, measured.u_restitution
        self._slopes: dict[float, list[tuple[float, float, tuple[float, ...], Real, float]]] = {}

    def factors(self, theta: Real) -> list[Real]:
        """Return up to `TRIED` starts for the fits: `theta` with all forces and masses scaled by a common factor.

        `theta` contains the log constants. The factors are those with which simulated and measured ratios (DT with the
        sphere / DT without) agree best. Factors with a much larger misfit than the best factor are left out (`WORSE`).
        """
        misfits = []
        for factor in FACTORS:
            off = 0.0
            for gap, ratio in self._reduced.ratio.items():
                try:
                    motion = SettledRig(self._place(gap, theta + factor * SCALE, 0.0, self._nominal)).motion
                    off += min(abs(motion.log_ratio - math.log(ratio)) / U_FACTOR, 10.0) ** 2
                except (SimulationError, ConfigError):  # a factor may also bring a constant out of its range
                    off += 100.0
            misfits.append(off)
        padded = np.concatenate([[np.inf], misfits, [np.inf]])
        lowest = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] < padded[2:]))
        order = sorted(lowest, key=lambda i: misfits[i])[:TRIED]
        return [theta + FACTORS[i] * SCALE for i in order if misfits[i] <= misfits[order[0]] + WORSE]

    def run(self, starts: Sequence[Real], nuisance: Real, on_step: Callable[[str], None]) -> list[_Held]:
        """Fit the constants at many fixed values of e, and return the best fit at each, in ascending order of e.

        If e is exactly known, only the fit at this e is returned. `starts` contains the log constants of the first
        fits, `nuisance` their nuisance parameters. Each further fit starts at the result at a neighbouring e.

        Raises:
            SimulationError: every start fails, because the motion at a measured gap cannot be simulated, or a constant
                leaves its range.
        """
        first = [one for theta in starts if (one := self._fit(self._nominal, theta, nuisance)) is not None]
        if not first:
            raise SimulationError(
                f"no start of the fit (of {len(starts)}) leads to a result: the motion with the sphere cannot be "
                "simulated at some measured gap, or a constant leaves its range; check sphere and contact law in the "
                "configuration of the known rig, the gaps, and the measured current"
            )
        if self._u == 0.0:
            return [min(first, key=lambda one: one.cost)]
        held: dict[float, _Held] = {}
        for branch in first:
            for side in (COARSE_E[COARSE_E >= 0.0], COARSE_E[COARSE_E < 0.0][::-1]):
                here = branch
                for away in side:
                    e = self._within(self._nominal + away * self._u)
                    new = here if away == 0.0 else self._fit(e, here.theta, here.nuisance)
                    if new is not None:
                        self._keep(held, new)
                        here = new
        on_step("searching for the values of e that agree best with the measurements")
        for one in sorted(held.values(), key=lambda each: each.cost)[:MINIMA]:
            self._descend(held, one)
        while len(held) < MOST_E and self._divide(held):
            pass
        return [held[e] for e in sorted(held)]

    def _descend(self, held: dict[float, _Held], here: _Held) -> None:
        """Add fits at values of e that approach the minimum of χ² near the fit `here`.

        The fits are added to `held`, by their e. The search ends after at most `PROPOSED` fits. It ends earlier if the
        next e is out of range, is close to an e in `held`, or gives no better fit.
        """
        for _ in range(PROPOSED):
            e, u = here.proposal()
            beyond = abs(e - self._nominal) > COARSE_E[-1] * self._u or e != self._within(e)
            if beyond or min(abs(e - other) for other in held) < NEAR_E * u:
                return
            new = self._fit(e, here.theta, here.nuisance)
            if new is None or new.cost > here.cost:
                return
            self._keep(held, new)
            here = new

    def _divide(self, held: dict[float, _Held]) -> bool:
        """Add a fit in the middle of the interval of e in which the probability density changes most.

        e is the coefficient of restitution. The fit is added to `held`, which contains the fits by their e. Returns
        True if a fit was added. Returns False if the change of the probability density is small enough (`KNOWN`) or the
        fit has failed.
        """
        e = sorted(held)
        cost = np.array([held[one].cost for one in e])
        density, width = np.exp(-0.5 * (cost - cost.min())), np.diff(e)
        unknown = width * np.abs(np.diff(density))
        at = int(np.argmax(unknown))
        if unknown[at] < KNOWN * float(width @ (density[1:] + density[:-1])) / 2.0:
            return False
        middle = 0.5 * (e[at] + e[at + 1])
        ends = sorted((held[e[at]], held[e[at + 1]]), key=lambda one: one.cost)
        for one in ends:
            new = self._fit(middle, one.theta, one.nuisance)
            if new is not None:
                self._keep(held, new)
                if new.cost < ends[1].cost:
                    break
        return middle in held

    def _within(self, e: float) -> float:
        return float(min(max(e, LEAST_RESTITUTION), MOST_RESTITUTION))

    @staticmethod
    def _keep(held: dict[float, _Held], new: _Held) -> None:
        if new.e not in held or new.cost < held[new.e].cost:
            held[new.e] = new

    def _place(self, gap_m: float, theta: Real, gain: float, e: float) -> Place:
        """Return the rig at a measured gap, driven by the measured current.

        `theta` contains the log constants, and `e` is the nominal coefficient of restitution. The current is corrected
        for `gain`, the relative error of the current sensor.
        """
        config = from_flat(rig(self._known, theta), {"contact.restitution": e})
        return place_of(config, gap_m, self._reduced.frequency_hz, self._reduced.current_a[gap_m] * math.exp(-gain))

    def _fit(self, e: float, theta: Real, nuisance: Real) -> _Held | None:
        """Fit the constants to all data at a fixed e, starting at log constants `theta` and nuisance parameters.

        Returns None if a motion cannot be simulated, or a constant leaves its range. After `ROUNDS` steps the last
        state is returned, even if the fit has not converged.
        """
        try:
            here = self._at(e, theta, nuisance)
            for _ in range(ROUNDS):
                change, along = _step(here.residual, here.jacobian, here.bent)
                size = np.linalg.norm(here.jacobian @ change + here.bent @ along)
                if size < (SMALL if all(motion.repeats for motion in here.motions.values()) else SCATTERED):
                    return attrs.evolve(here, converged=True)
                new = self._at(e, here.theta + change, here.nuisance + along)
                if new.misfit > here.misfit:  # a step across a jump of the motion, or too large a step
                    new = self._at(e, here.theta + 0.3 * change, here.nuisance + 0.3 * along)
                    if new.misfit > here.misfit:  # a step that ends just before a jump
                        return attrs.evolve(here, converged=True)
                here = new
        except (SimulationError, ConfigError):
            return None
        return here

    def _at(self, e: float, theta: Real, nuisance: Real) -> _Held:
        """Compute the residuals of all data and their derivatives at given e, constants and nuisance parameters.

        The motion at each gap is simulated. Nothing is fitted, so the result is marked as not converged.
        """
        residual, jacobian, bent = _linear(self._measured, self._known, theta, nuisance)
        rows, by_constants, by_nuisances, by_e = [], [], [], []
        motions, widths = {}, 0.0
        for place, (gap, ratio) in enumerate(self._reduced.ratio.items()):
            motion, slope, roughness = self._motion(gap, theta, float(nuisance[GAIN_CURRENT]), e)
            known = math.hypot(self._reduced.u[place], U_SIMULATED)
            u = math.hypot(known, motion.u, roughness)
            effect = self._reduced.effects[place] * self._uncertain
            rows.append((motion.log_ratio - math.log(ratio) + effect @ nuisance) / u)
            effect[GAIN_CURRENT] -= slope[NAMES.index("K_f")] * self._uncertain[GAIN_CURRENT]
            by_constants.append(slope[:-1] / u)
            by_nuisances.append(effect / u)
            by_e.append(slope[-1] / u)
            motions[gap] = motion if motion.repeats else motion._replace(u=math.hypot(motion.u, roughness))
            widths += 2.0 * math.log(u / known)
        away = 0.0 if self._u == 0.0 else (e - self._nominal) / self._u
        whole = np.concatenate([residual, rows, [away]])
        chi_square = float(whole @ whole)
        return _Held(
            e, theta, nuisance, chi_square, chi_square + widths,
            np.concatenate([jacobian, by_constants, np.zeros((1, len(NAMES)))]),
            np.concatenate([bent, by_nuisances, np.zeros((1, len(NUISANCES)))]),
            np.concatenate([np.zeros(len(residual)), by_e, [1.0 / self._u if self._u else 0.0]]),
            whole, motions, converged=False,
        )  # fmt: skip

    def _motion(self, gap_m: float, theta: Real, gain: float, e: float) -> tuple[SettledMotion, Real, float]:
        """Simulate the settled motion at a gap; return it, the derivatives of its `log_ratio`, and their roughness.

        The derivatives are those by the log constants and, last, by e. `SettledRig.slopes` explains the roughness.
        `gain` is the relative error of the measured current. Derivatives and roughness are reused for a similar motion
        at the same gap with nearly the same e and m_1, because they take most of the time.
        """
        force = NAMES.index("K_f")
        here = SettledRig(self._place(gap_m, theta, gain, e))
        motion = here.motion
        kind = (motion.period, motion.impacts) if motion.repeats else ()
        factor = float(theta[NAMES.index("m_1")])
        for e_0, factor_0, kind_0, slopes, rough in self._slopes.setdefault(gap_m, []):
            if kind == kind_0 and abs(e - e_0) <= (SAME_E if kind else 3 * SAME_E) and abs(factor - factor_0) <= SAME_M:
                return motion, slopes, rough

        def neighbour(i: int, step: float) -> Place:
            if i == force:
                return here.place._replace(amplitude=here.place.amplitude * math.exp(step))
            change = step * np.eye(len(NAMES) + 1)[i]
            return self._place(gap_m, theta + change[:-1], gain, e + float(change[-1]))

        slopes, rough = here.slopes(neighbour, len(NAMES) + 1, force, (NAMES.index("m_1"), len(NAMES)))
        self._slopes[gap_m].append((e, factor, kind, slopes, rough))
        return motion, slopes, rough


def _summary(held: Sequence[_Held]) -> tuple[Real, Real, tuple[Alternative, ...]]:
    """Return mean and covariance of the log constants and e (8 values), averaged over fits at many fixed values of e.

    Each e is weighted by its probability. The third result contains clearly different explanations of the data, the
    most probable first. It is empty if there is only one explanation.
    """
    e = np.array([one.e for one in held])
    theta, within = np.array([one.theta for one in held]), np.array([one.covariance() for one in held])
    if len(held) == 1:
        whole = np.zeros((len(NAMES) + 1, len(NAMES) + 1))
        whole[:-1, :-1] = within[0]
        return np.append(theta[0], e), whole, ()
    grid = np.linspace(e[0], e[-1], GRID)
    cost = scipy.interpolate.PchipInterpolator(e, [one.cost for one in held])(grid)
    density = np.exp(-0.5 * (cost - cost.min()))
    values = np.column_stack([scipy.interpolate.interp1d(e, theta, axis=0)(grid), grid])
    inside = scipy.interpolate.interp1d(e, within, axis=0)(grid)

    def moments(part: slice) -> tuple[Real, Real]:
        weight = density[part] / density[part].sum()
        mean = weight @ values[part]
        apart = values[part] - mean
        covariance = (apart * weight[:, None]).T @ apart
        covariance[:-1, :-1] += np.tensordot(weight, inside[part], axes=1)
        return mean, covariance

    found = []
    for part in _parts(density):
        mean, covariance = moments(part)
        u = np.sqrt(np.diag(covariance))
        share = float(density[part].sum() / density.sum())
        if share >= LEAST_PART:
            found.append(Alternative(share, mean[:-1], u[:-1], float(mean[-1]), float(u[-1])))
    mean, covariance = moments(slice(None))
    return mean, covariance, tuple(sorted(found, key=lambda one: -one.share)) if _differ(found) else ()


def _differ(found: Sequence[Alternative]) -> bool:
    """Return whether any two explanations differ clearly in a constant.

    They differ clearly if the difference exceeds `APART` times the sum of both uncertainties. Values of e are not
    compared.
    """
    return any(
        bool(np.any(np.abs(one.log_constants - other.log_constants) > APART * (one.u_relative + other.u_relative)))
        for one, other in itertools.combinations(found, 2)
    )


def _parts(density: Real) -> Iterator[slice]:
    """Yield adjoining index ranges of a tabulated probability density, each with one separate peak.

    Two peaks are separate if the density between them falls below `SEPARATE` times the lower peak.
    """
    level = np.log(np.maximum(density, 1e-300))
    peaks = scipy.signal.find_peaks(np.pad(level, 1, constant_values=-1e9), prominence=-math.log(SEPARATE))[0] - 1
    cuts = [first + int(np.argmin(level[first:last])) for first, last in itertools.pairwise(peaks.tolist())]
    for begin, end in itertools.pairwise([0, *cuts, len(density)]):
        yield slice(begin, end)


def _linear(measured: Measured, known: RigConfig, theta: Real, nuisance: Real) -> tuple[Real, Real, Real]:
    """Return the whitened residuals of the data without the sphere, and their derivatives.

    The results are residuals (m,), derivatives by the log constants `theta` (m, 7), and derivatives by the nuisance
    parameters (m, 6). The last residuals are those of the prior knowledge of the nuisance parameters (`NUISANCES`).
    """
    residuals, rows, bends = [], [], []
    decay, sine, gains = measured.decay, measured.sine, measured.gains
    if decay is not None:
        for place, value, u_value in (
            (0, decay.natural_frequency_hz, decay.u_natural_frequency_hz),
            (1, decay.damping_ratio, decay.u_damping_ratio),
        ):
            residuals.append(np.array([(theta[place] - np.log(value)) * value / u_value]))
            rows.append(np.eye(len(NAMES))[place : place + 1] * value / u_value)
            bends.append(np.zeros((1, len(NUISANCES))))
    if sine is not None:
        laser = gains.relative(LASER, sine.laser_m, sine.frequency_hz)
        base = gains.relative(BASE, sine.base_m, sine.frequency_hz)
        current = gains.relative(CURRENT, sine.base_m, sine.frequency_hz)
        model = _model(known, theta, sine.frequency_hz)
        derivative = np.stack(
            [_apart(_model(known, theta + STEP * e, sine.frequency_hz), model) / STEP for e in np.eye(len(NAMES))],
            axis=2,
        )
        data = np.stack([np.log(sine.dt), np.log(sine.base_per_a), sine.phase_rad])
        u = np.stack([sine.u_amplitude, sine.u_amplitude, sine.u_phase])
        effects = np.stack([laser - base, base - current, np.zeros_like(base)])
        off = _apart(model, data)
        for row in range(3):
            is_finite = np.isfinite(data[row])  # a point without a valid current still has DT and phase
            residuals.append(((off[row] + effects[row] @ nuisance) / u[row])[is_finite])
            rows.append((derivative[row] / u[row][:, None])[is_finite])
            bends.append((effects[row] / u[row][:, None])[is_finite])
    prior = _prior(measured)
    uncertain = prior > 0.0  # exactly known nuisances have no effect
    width = np.where(uncertain, prior, 1.0)
    residuals.append(np.where(uncertain, nuisance / width, 0.0))
    rows.append(np.zeros((len(NUISANCES), len(NAMES))))
    bends = [bent * uncertain for bent in bends]
    bends.append(np.diag(1.0 / width))
    return np.concatenate(residuals), np.concatenate(rows), np.concatenate(bends)


def _apart(one: Real, other: Real) -> Real:
    """Return the difference of two results of `_model`, shape (3, n); phase differences are wrapped to ±π."""
    difference = one - other
    difference[2] -= 2.0 * math.pi * np.round(difference[2] / (2.0 * math.pi))
    return difference


def _prior(measured: Measured) -> Real:
    """Return the standard uncertainty of each parameter in `NUISANCES` before the fit, shape (6,).

    The uncertainties of the sensors come from their certificate. That of DT without the sphere comes from the noise of
    its measurement, and is 0 without reductions. A parameter with an uncertainty of 0 counts as exactly 0.
    """
    without = measured.reduced.u_without if measured.reduced else 0.0
    return np.array([*measured.gains.u, without])


def _model(known: RigConfig, theta: Real, frequency_hz: Real) -> Real:
    """Return ln DT, ln |X_b / I| [m/A] and the phase of X_1 / X_b of the rig without its sphere, shape (3, n)."""
    config = rig(known, theta)
    ratio = transmissibility(config, frequency_hz)
    return np.stack([np.log(np.abs(ratio)), np.log(np.abs(base_per_ampere(config, frequency_hz))), np.angle(ratio)])
