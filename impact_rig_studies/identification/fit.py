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
"""Least squares for the constants: closed forms without the sphere, simulated reductions with it.

    ln f_n, ln ζ                  measured by the free decay
    ln DT, phase                  = T(f; f_n, ζ)
    ln |X_b / I|                  = K_f / |k_f − M ω² + iω c_f − m_1 ω² T|
    ln (DT with / DT without)     = simulation of the mechanics, law as configured, e free about its nominal value

Without the sphere all masses and forces may be multiplied by one factor: nothing is known of m_1 but ratios. The
reductions weigh the structure with the known mass of the sphere.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence

import attrs
import numpy as np
from scipy import special

from impact_rig.analysis.calibration import Real
from impact_rig.analysis.scans import BASE, CURRENT, LASER
from impact_rig.config.tree import Value
from impact_rig.errors import ConfigError
from impact_rig.physics.linear_response import base_per_ampere, transmissibility
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.states import Regime
from impact_rig_studies.identification.measurements import (
    NUISANCES,
    RESTITUTION,
    Measured,
    SettledMotion,
    simulated,
    slope,
)

# --- The constants that are identified, as logarithms, and the rig that they make.

NAMES = ("f_n", "ζ", "m_1", "K_f", "k_f", "M", "c_f")
"""Structure: natural frequency, damping ratio, mass. Shaker: force factor, suspension, mass m_a + m_b, damping."""
UNITS = ("Hz", "-", "kg", "N/A", "N/m", "kg", "N s/m")
SCALED = ("m_1", "K_f", "k_f", "M", "c_f")
"""Forces and masses: multiplied by one factor they give the same motion, unless something of known mass takes part."""
SCALE = np.array([float(name in SCALED) for name in NAMES])  # the direction of that factor


START = np.log([9.0, 0.005, 0.2, 6.0, 8000.0, 2.5, 60.0])
"""Where a fit begins: round numbers in the right order of magnitude."""


def logarithms(config: RigConfig) -> Real:
    """Return the logarithms of a rig's constants, in the order of `NAMES`."""
    structure, shaker = config.structure, config.shaker
    return np.log([
        structure.natural_frequency_hz, structure.damping_ratio, structure.mass_kg, shaker.force_factor_n_a,
        shaker.suspension_stiffness_n_m, shaker.armature_mass_kg + shaker.base_mass_kg, shaker.damping_n_s_m,
    ])  # fmt: skip


def rig(base: RigConfig, log_constants: Real) -> RigConfig:
    """Return `base` with these constants; the share of the armature in the moving mass stays.

    Raises:
        ConfigError: they make no rig.
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
#
# Parameters are logarithms, so a direction in their space is a product of powers, and 1/s, s a singular value of the
# whitened Jacobian, is the relative standard uncertainty of that product. Nuisance parameters (gain errors of sensors,
# say) are eliminated first: what they can imitate is no information.


DETERMINED = 0.2  # relative standard uncertainty up to which a parameter, or a combination, counts as determined
LEAST_SHARE = 0.05  # powers below this share of the largest are left out of a combination's name
SMALLEST = 1e-9  # singular values below this share of the largest are rounding
UNTOUCHED = 1e-3
"""A parameter with less than this power in a combination that is not known at all does not take part in it."""


@attrs.frozen(eq=False)
class Combination:
    """A product of powers of parameters."""

    powers: Real  # by parameter, shape (n,); the largest is 1
    u_relative: float  # its relative standard uncertainty; infinite if the data say nothing
    text: str  # for people

    @property
    def determined(self) -> bool:
        """Whether the data determine it."""
        return self.u_relative <= DETERMINED


@attrs.frozen(eq=False)
class Information:
    """What the data say about logarithmic parameters."""

    names: tuple[str, ...]  # of the parameters, n of them
    combinations: tuple[Combination, ...]  # independent ones, best determined first
    u_relative: Real  # relative standard uncertainty of each parameter, infinite if it takes part in what is not known

    def determined(self, name: str) -> bool:
        """Return whether the data determine a parameter by itself."""
        return bool(self.u_relative[self.names.index(name)] <= DETERMINED)


def information(names: Sequence[str], jacobian: Real, nuisances: Real | None = None) -> Information:
    """Return what a whitened Jacobian says.

    Args:
        names: of the parameters.
        jacobian: d residual / d ln parameter, residuals in units of their standard uncertainty, shape (m, n).
        nuisances: the same for nuisance parameters, shape (m, k), rows of their prior knowledge included.
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

STEP = 1e-6  # of logarithms, for derivatives of closed forms
U_SIMULATED = 1e-4
"""Relative standard uncertainty of a ratio beside its noise: transients that the analysis calls settled."""
SIGNIFICANCE = 0.01  # a fit as bad as this or worse by chance alone is an alarm
ITERATIONS = 30
CONVERGED = 1e-4  # a step this small, in standard uncertainties, ends the fit of the closed forms
ROUNDS = 8  # of adjusting the constants to the reductions, at most; each simulates all derivatives anew
SMALL = 0.05  # a step this small, in standard uncertainties, ends them
RANK = 1e-6
"""Share of the largest singular value below which a direction is not determined; derivatives are good to that."""
UNBOUND = 1.0
"""Relative standard uncertainty beyond which a constant is hardly moved: a few data would send it out of all range."""
LARGEST_STEP = 0.5
COARSE = 0.02  # step for the common factor, which need not be exact
CROSSED = "the orbit changes, or does not quite repeat: no step of a constant gives one slope on both sides"
LEAST_RESTITUTION, MOST_RESTITUTION = 0.02, 0.98  # of a fitted e


@attrs.frozen(eq=False)
class Identified:
    """The result."""

    log_constants: Real  # in the order of `constants.NAMES`; what the data do not determine stays near its start
    information: Information  # what the data say
    chi_square: float  # sum of squared residuals, prior of the nuisances included
    freedom: int  # residuals less determined parameters
    config: RigConfig  # the known rig, with the identified constants
    restitution: float = math.nan  # nominal e found, NaN without reductions; u_restitution likewise
    u_restitution: float = math.nan
    left_out: Mapping[float, str] = attrs.field(factory=dict)
    """Gaps [m] whose reductions were not used, with the reason."""
    contradicted: tuple[float, ...] = ()  # those of them that were measured to be periodic where the fitted rig is not
    converged: bool = True  # whether the last step was small; where not, the uncertainties are of no minimum

    @property
    def chance(self) -> float:
        """Probability of a fit this bad or worse if model and uncertainties are right; 1 without any freedom."""
        return float(special.chdtrc(self.freedom, self.chi_square)) if self.freedom > 0 else 1.0

    @property
    def consistent(self) -> bool:
        """Whether the fit has converged, and data, uncertainties and what was taken as known go together."""
        return self.converged and self.chance >= SIGNIFICANCE and not self.contradicted

    def value(self, name: str) -> float:
        """Return a constant."""
        return float(np.exp(self.log_constants[NAMES.index(name)]))

    def u(self, name: str) -> float:
        """Return its standard uncertainty."""
        return self.value(name) * float(self.information.u_relative[NAMES.index(name)])


def identify(
    measured: Measured, known: RigConfig, start: Real = START, on_step: Callable[[str], None] = lambda _: None
) -> Identified:
    """Return the constants that fit best.

    Args:
        measured: what there is.
        known: what is taken as known: sphere, contact, barriers; its own constants do not matter.
        start: logarithms of the constants to begin with.
        on_step: is told what is being done.

    Raises:
        ConfigError: nothing was measured.
    """
    if measured.decay is None and measured.sine is None and measured.reduced is None:
        raise ConfigError("nothing to identify from: no free decay, no stepped sine, no reductions")
    theta, nuisance = _begun(measured, start), np.zeros(len(NUISANCES))
    converged = False
    for _ in range(ITERATIONS if measured.decay or measured.sine else 0):
        residual, jacobian, bent = _linear(measured, known, theta, nuisance)
        change, along = _step(residual, jacobian, bent)
        theta, nuisance = theta + change, nuisance + along
        # seen by the data: along what they do not determine, rounding in the derivatives moves the constants for ever
        converged = bool(np.linalg.norm(jacobian @ change + bent @ along) < CONVERGED)
        if converged:
            break
    residual, jacobian, bent = _linear(measured, known, theta, nuisance)
    restitution = u_restitution = math.nan
    left_out: Mapping[float, str] = {}
    contradicted: tuple[float, ...] = ()
    if measured.reduced is not None:
        impacts = _Impacts(measured, known)
        on_step("weighing the structure with the sphere")
        theta = impacts.weigh(theta)
        for turn in range(1, ROUNDS + 1):
            on_step(f"adjusting, {turn} of at most {ROUNDS}")
            parts = zip(_linear(measured, known, theta, nuisance), impacts.linear(theta, nuisance), strict=True)
            residual, jacobian, bent = (np.concatenate(part) for part in parts)
            change, along = _step(residual, jacobian, bent)
            size = np.linalg.norm(jacobian @ change + bent @ along)
            converged = bool(size < SMALL)
            if converged or turn == ROUNDS:
                break
            theta, nuisance = theta + change, nuisance + along
            nuisance[RESTITUTION] = impacts.within(nuisance[RESTITUTION])
        left_out, contradicted = impacts.left_out, impacts.contradicted()
        if len(left_out) < len(measured.reduced.ratio):
            restitution = known.contact.restitution + float(nuisance[RESTITUTION])
            u_restitution = 0.0
            if measured.u_restitution > 0.0:
                u_restitution = _spread(np.concatenate([jacobian, bent], axis=1), len(NAMES) + RESTITUTION)
    found = information(NAMES, jacobian, bent)
    determined = sum(combination.determined for combination in found.combinations)
    config = rig(known, theta)
    if math.isfinite(restitution):
        config = from_flat(config, {"contact.restitution": restitution})
    return Identified(
        theta, found, float(residual @ residual), len(residual) - len(NUISANCES) - determined, config,
        restitution, u_restitution, left_out, contradicted, converged,
    )  # fmt: skip


def _begun(measured: Measured, start: Real) -> Real:
    """Return the start with the f_n and ζ that the data show at a glance: far from them nothing else can be fitted."""
    theta = start.copy()
    if measured.decay is not None:
        theta[:2] = np.log([measured.decay.natural_frequency_hz, measured.decay.damping_ratio])
    elif measured.sine is not None:
        peak = int(np.argmax(measured.sine.dt))
        theta[:2] = np.log([measured.sine.frequency_hz[peak], 0.5 / measured.sine.dt[peak]])
    return theta


def _spread(jacobian: Real, column: int) -> float:
    """Return the standard uncertainty of one unknown, all others free."""
    size = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-30)
    return float(np.linalg.norm(np.linalg.pinv(jacobian / size, rcond=RANK)[column]) / size[column])


def _step(residual: Real, jacobian: Real, bent: Real) -> tuple[Real, Real]:
    """Return the Gauss-Newton step; along what the data do not determine, none, or a damped one."""
    damped = np.eye(len(NAMES), len(NAMES) + bent.shape[1]) / UNBOUND
    whole = np.concatenate([np.concatenate([jacobian, bent], axis=1), damped])
    size = np.maximum(np.linalg.norm(whole, axis=0), 1e-30)  # so that f_n, known best, hides nothing
    change = -np.linalg.lstsq(whole / size, np.append(residual, np.zeros(len(damped))), rcond=RANK)[0] / size
    change *= min(1.0, LARGEST_STEP / max(float(np.abs(change).max()), 1e-30))
    return change[: len(NAMES)], change[len(NAMES) :]


class _Impacts:
    """The reductions' part of the problem; gaps whose motion has no derivative are left out as they are found."""

    def __init__(self, measured: Measured, known: RigConfig) -> None:
        assert measured.reduced is not None
        self._reduced, self._known = measured.reduced, known
        self._uncertain = _prior(measured) > 0.0
        self.left_out: dict[float, str] = {}

    def contradicted(self) -> tuple[float, ...]:
        """Return the gaps left out for a motion that does not repeat, though it was measured to be periodic."""
        regimes = self._reduced.regimes
        return tuple(g for g, why in self.left_out.items() if why != CROSSED and regimes[g] == Regime.PERIODIC.value)

    def within(self, change: float) -> float:
        """Return a change of e that leaves it possible."""
        e = self._known.contact.restitution
        return min(max(change, LEAST_RESTITUTION - e), MOST_RESTITUTION - e)

    def linear(self, theta: Real, nuisance: Real) -> tuple[Real, Real, Real]:
        """Return whitened residuals, their derivatives by the constants and by the nuisances, a row a gap in use."""
        residual, jacobian, bent = [], [], []
        for place, (gap, ratio) in enumerate(self._reduced.ratio.items()):
            if gap in self.left_out:
                continue
            u = math.hypot(self._reduced.u[place], U_SIMULATED)
            here = self._motion(gap, theta, nuisance[RESTITUTION])
            slopes = [self._slope(gap, theta, nuisance, here, direction) for direction in np.eye(len(NAMES) + 1)]
            if here.orbit() is None or None in slopes:
                self.left_out[gap] = (
                    f"the motion is {here.regime}: it does not repeat" if here.orbit() is None
                    else CROSSED
                )  # fmt: skip
                continue
            row = self._reduced.effects[place] * self._uncertain
            row[RESTITUTION] = slopes[-1] if self._uncertain[RESTITUTION] else 0.0
            others = np.where(np.arange(len(NUISANCES)) == RESTITUTION, 0.0, nuisance)  # e is in the simulation
            residual.append((here.log_ratio - math.log(ratio) + row @ others) / u)
            jacobian.append(np.array(slopes[:-1]) / u)
            bent.append(row / u)
        return (
            np.array(residual),
            np.reshape(jacobian, (len(residual), len(NAMES))),
            np.reshape(bent, (len(residual), len(NUISANCES))),
        )

    def weigh(self, theta: Real) -> Real:
        """Return the constants with their common factor adjusted to the reductions."""
        for _ in range(ROUNDS):
            here, slopes = [], []
            for gap, ratio in self._reduced.ratio.items():
                motion = self._motion(gap, theta, 0.0)
                here.append(motion.log_ratio - math.log(ratio))
                slopes.append((self._motion(gap, theta + COARSE * SCALE, 0.0).log_ratio - motion.log_ratio) / COARSE)
            change = float(np.clip(-np.dot(slopes, here) / np.dot(slopes, slopes), -LARGEST_STEP, LARGEST_STEP))
            theta = theta + change * SCALE
            if abs(change) < COARSE:
                break
        return theta

    def _motion(self, gap_m: float, theta: Real, restitution: float) -> SettledMotion:
        e = self._known.contact.restitution + restitution
        config = from_flat(rig(self._known, theta), {"contact.restitution": e})
        return simulated(config, gap_m, self._reduced.frequency_hz, self._reduced.current_a)

    def _slope(self, gap_m: float, theta: Real, nuisance: Real, here: SettledMotion, direction: Real) -> float | None:
        """Return the derivative along a direction in the space of the constants and, last, e."""
        e = float(nuisance[RESTITUTION])
        return slope(lambda h: self._motion(gap_m, theta + h * direction[:-1], e + h * direction[-1]), here)


def _linear(measured: Measured, known: RigConfig, theta: Real, nuisance: Real) -> tuple[Real, Real, Real]:
    """Return whitened residuals of what needs no simulation, and their derivatives by constants and nuisances."""
    residuals, slopes, bends = [], [], []
    decay, sine, gains = measured.decay, measured.sine, measured.gains
    if decay is not None:
        for place, value, u_value in (
            (0, decay.natural_frequency_hz, decay.u_natural_frequency_hz),
            (1, decay.damping_ratio, decay.u_damping_ratio),
        ):
            residuals.append(np.array([(theta[place] - np.log(value)) * value / u_value]))
            slopes.append(np.eye(len(NAMES))[place : place + 1] * value / u_value)
            bends.append(np.zeros((1, len(NUISANCES))))
    if sine is not None:
        laser, base = gains.relative(LASER, sine.laser_m), gains.relative(BASE, sine.base_m)
        current = gains.relative(CURRENT, sine.base_m)
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
            told = np.isfinite(data[row])  # a point whose current is unsound tells DT and phase
            residuals.append(((off[row] + effects[row] @ nuisance) / u[row])[told])
            slopes.append((derivative[row] / u[row][:, None])[told])
            bends.append((effects[row] / u[row][:, None])[told])
    prior = _prior(measured)
    uncertain = prior > 0.0  # what is known exactly bends nothing
    width = np.where(uncertain, prior, 1.0)
    residuals.append(np.where(uncertain, nuisance / width, 0.0))
    slopes.append(np.zeros((len(NUISANCES), len(NAMES))))
    bends = [bent * uncertain for bent in bends]
    bends.append(np.diag(1.0 / width))
    return np.concatenate(residuals), np.concatenate(slopes), np.concatenate(bends)


def _apart(one: Real, other: Real) -> Real:
    """Return the difference of two arrays as `_model` returns them; of phases the smallest."""
    difference = one - other
    difference[2] -= 2.0 * math.pi * np.round(difference[2] / (2.0 * math.pi))
    return difference


def _prior(measured: Measured) -> Real:
    """Return the standard uncertainty of each nuisance, known beforehand."""
    without = measured.reduced.u_without if measured.reduced else 0.0
    return np.array([*measured.gains.u, without, measured.u_restitution])


def _model(known: RigConfig, theta: Real, frequency_hz: Real) -> Real:
    """Return ln DT, ln |X_b / I| and the phase, shape (3, n)."""
    config = rig(known, theta)
    ratio = transmissibility(config, frequency_hz)
    return np.stack([np.log(np.abs(ratio)), np.log(np.abs(base_per_ampere(config, frequency_hz))), np.angle(ratio)])
