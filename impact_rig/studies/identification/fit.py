# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Least squares for the constants: closed forms without the sphere, simulated reductions with it.

    ln f_n, ln ζ                  measured by the free decay
    ln DT, phase                  = T(f; f_n, ζ)
    ln |X_b / I|                  = K_f / |k_f − M ω² + iω c_f − m_1 ω² T|
    ln (DT with / DT without)     = simulation of the whole rig, contact law and e as configured

Without the sphere all masses and forces may be multiplied by one factor: nothing is known of m_1 but ratios. The
reductions weigh the structure with the known mass of the sphere.
"""

from __future__ import annotations

from collections.abc import Callable

import attrs
import numpy as np

from impact_rig.analysis.channels import BASE, CURRENT, LASER
from impact_rig.errors import ConfigError
from impact_rig.physics.closed_form import base_amplitude, transmissibility
from impact_rig.rig.config import RigConfig
from impact_rig.studies.identification.constants import NAMES, SCALE, START, rig
from impact_rig.studies.identification.fisher import Information, Real, information
from impact_rig.studies.identification.impacts import simulated_log_ratios
from impact_rig.studies.identification.measurements import NUISANCES, Measured

STEP = 1e-6
"""Of logarithms, for derivatives of closed forms."""
SIMULATED_STEP = 0.02
"""For derivatives of simulated reductions: wide enough that orbits which change their pattern do not matter."""
U_SIMULATED = 5e-4
"""Relative standard uncertainty of a simulated ratio: transients that the analysis calls settled."""
ITERATIONS = 30
CONVERGED = 1e-9
CHORDS = 4
RANK = 1e-6
"""Share of the largest singular value below which a direction is not determined; derivatives are good to that."""
LARGEST_STEP = 0.5


@attrs.frozen(eq=False)
class Identified:
    """The result.

    Attributes:
        log_constants: in the order of `constants.NAMES`; what the data do not determine stays near its start.
        information: what the data say.
        chi_square: sum of squared residuals, prior of the nuisances included.
        freedom: residuals less determined parameters.
        config: the known rig, with the identified constants.
    """

    log_constants: Real
    information: Information
    chi_square: float
    freedom: int
    config: RigConfig

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
    theta, nuisance = start.copy(), np.zeros(len(NUISANCES))
    for _ in range(ITERATIONS if measured.decay or measured.sine else 0):
        change, along = _step(*_linear(measured, known, theta, nuisance))
        theta, nuisance = theta + change, nuisance + along
        if max(np.abs(change).max(), np.abs(along).max()) < CONVERGED:
            break
    residual, jacobian, bent = _linear(measured, known, theta, nuisance)
    if measured.reduced is not None:
        impacts = _Impacts(measured, known)
        on_step("weighing the structure with the sphere")
        theta = impacts.weigh(theta)
        on_step("how the reductions depend on every constant")
        here = impacts.misfit(theta)
        slopes = impacts.slopes(theta, here)
        for chord in range(CHORDS):
            residual, jacobian, bent = _linear(measured, known, theta, nuisance)
            residual = np.concatenate([residual, here + impacts.effects @ nuisance])
            jacobian, bent = np.concatenate([jacobian, slopes]), np.concatenate([bent, impacts.effects])
            if chord == CHORDS - 1:
                break
            on_step(f"adjusting, {chord + 1} of {CHORDS - 1}")
            change, along = _step(residual, jacobian, bent)
            theta, nuisance = theta + change, nuisance + along
            here = impacts.misfit(theta)
    found = information(NAMES, jacobian, bent)
    determined = sum(combination.determined for combination in found.combinations)
    return Identified(
        theta, found, float(residual @ residual), len(residual) - len(NUISANCES) - determined, rig(known, theta)
    )


def _step(residual: Real, jacobian: Real, bent: Real) -> tuple[Real, Real]:
    """Return the Gauss-Newton step; along what the data do not determine, none."""
    whole = np.concatenate([jacobian, bent], axis=1)
    size = np.maximum(np.linalg.norm(whole, axis=0), 1e-30)  # so that f_n, known best, hides nothing
    change = -np.linalg.lstsq(whole / size, residual, rcond=RANK)[0] / size
    change *= min(1.0, LARGEST_STEP / max(float(np.abs(change).max()), 1e-30))
    return change[: len(NAMES)], change[len(NAMES) :]


class _Impacts:
    """The reductions' part of the problem; every evaluation simulates all gaps."""

    def __init__(self, measured: Measured, known: RigConfig) -> None:
        assert measured.reduced is not None
        self._reduced, self._known = measured.reduced, known
        self._u = np.hypot(measured.reduced.u, U_SIMULATED)
        self._log_ratios = np.log(list(measured.reduced.ratio.values()))
        self.effects = measured.reduced.effects * (_prior(measured) > 0.0) / self._u[:, None]

    def misfit(self, theta: Real) -> Real:
        """Return the whitened residuals but for the nuisances."""
        simulated = simulated_log_ratios(rig(self._known, theta), self._reduced)
        return np.asarray((simulated - self._log_ratios) / self._u)

    def slopes(self, theta: Real, here: Real) -> Real:
        """Return their derivatives by the constants; `here` is the misfit at `theta`."""
        return np.stack([self._slope(theta, here, direction) for direction in np.eye(len(NAMES))], axis=1)

    def weigh(self, theta: Real) -> Real:
        """Return the constants with their common factor adjusted to the reductions."""
        for _ in range(CHORDS):
            here = self.misfit(theta)
            slope = self._slope(theta, here, SCALE)
            change = float(np.clip(-(slope @ here) / (slope @ slope), -LARGEST_STEP, LARGEST_STEP))
            theta = theta + change * SCALE
            if abs(change) < SIMULATED_STEP:
                break
        return theta

    def _slope(self, theta: Real, here: Real, direction: Real) -> Real:
        return np.asarray((self.misfit(theta + SIMULATED_STEP * direction) - here) / SIMULATED_STEP)


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
            [(_model(known, theta + STEP * e, sine.frequency_hz) - model) / STEP for e in np.eye(len(NAMES))], axis=2
        )
        data = np.stack([np.log(sine.dt), np.log(sine.base_per_a), sine.phase_rad])
        u = np.stack([sine.u_amplitude, sine.u_amplitude, sine.u_phase])
        effects = np.stack([laser - base, base - current, np.zeros_like(base)])
        for row in range(3):
            residuals.append((model[row] + effects[row] @ nuisance - data[row]) / u[row])
            slopes.append(derivative[row] / u[row][:, None])
            bends.append(effects[row] / u[row][:, None])
    prior = _prior(measured)
    uncertain = prior > 0.0  # what is known exactly bends nothing
    width = np.where(uncertain, prior, 1.0)
    residuals.append(np.where(uncertain, nuisance / width, 0.0))
    slopes.append(np.zeros((len(NUISANCES), len(NAMES))))
    bends = [bent * uncertain for bent in bends]
    bends.append(np.diag(1.0 / width))
    return np.concatenate(residuals), np.concatenate(slopes), np.concatenate(bends)


def _prior(measured: Measured) -> Real:
    """Return the standard uncertainty of each nuisance, known beforehand."""
    return np.append(measured.gains.u, measured.reduced.u_without if measured.reduced else 0.0)


def _model(known: RigConfig, theta: Real, frequency_hz: Real) -> Real:
    """Return ln DT, ln |X_b / I| and the phase, shape (3, n)."""
    config = rig(known, theta)
    ratio = transmissibility(config, frequency_hz)
    return np.stack([np.log(np.abs(ratio)), np.log(np.abs(base_amplitude(config, frequency_hz))), np.angle(ratio)])
