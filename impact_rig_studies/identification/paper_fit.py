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
"""Derivation of the default rig from the paper: natural frequency f_n and damping ratio ζ of its structure.

Both are fitted to the five published reductions of DT and to the published resonance frequency. The sphere, the contact
law and e are those of the paper. Mass and shaker have catalogue values. The current is chosen such that the superior
base moves as in the paper. `PaperFit.information` shows how well the paper determines each constant.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import attrs
import numpy as np

from impact_rig.analysis.calibration import Real
from impact_rig.rig.config import RigConfig
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig_studies.identification.fit import NAMES, Information, information, logarithms, rig
from impact_rig_studies.identification.motions import simulated

U_POINTS = 1.0
"""Assumed standard uncertainty of a published reduction [percentage points]: three of the five are printed as whole
percent, no uncertainty is stated, and the gaps were set by hand.
"""
U_FREQUENCY_HZ = 0.05 / 3**0.5  # standard uncertainty of the published 9.1 Hz, which is printed to one decimal
ALL = (*NAMES, "I")  # names of all constants: those that are identified, and the current
START = {"f_n": 9.1, "ζ": 0.005, "I": 0.5}  # start of the fit [Hz, -, A]: away from the shipped values
# relative steps for derivatives by `NAMES` and I: the natural frequency has the largest effect
STEPS = np.array([2e-4, *[0.02] * 6, 0.02])
LARGEST = {"f_n": 5e-4, "ζ": 0.1, "I": 0.1}  # largest relative steps of the fit, which is far from linear
ITERATIONS = 12
CONVERGED = 0.1  # step, in standard uncertainties, that ends the fit


@attrs.frozen(eq=False)
class PaperFit:
    """Result of the fit of the simulated rig to the figures that the paper publishes."""

    fitted: Mapping[str, float]  # fitted values by name: f_n [Hz], ζ, optionally I [A peak]
    u: Mapping[str, float]  # standard uncertainty of each fitted value if the values that are not fitted are exact
    converged: bool  # whether the last step of the fit was small
    points: dict[float, float]  # reductions of DT of the fitted rig [%], by gap [m]
    rms_points: float  # rms difference of these from the reductions in the paper [percentage points]
    default_rms_points: float  # the same for the shipped configuration
    information: Information  # how well the paper determines all constants (`ALL`), near the shipped configuration


def fit_paper(
    base: RigConfig, free: Sequence[str] = ("f_n", "ζ"), on_step: Callable[[str], None] = lambda _: None
) -> PaperFit:
    """Fit values of the simulated rig to the paper's reductions of DT and resonance, starting at `START`.

    The result also states how well the paper determines each constant in `ALL`.

    Args:
        base: rig with all other values, which count as known; normally the shipped configuration.
        free: names of the values to fit, which are keys of `START`.
        on_step: receives a description of each step for the user.

    Raises:
        ConfigError: a value leaves its range during the fit.
        SimulationError: a motion during the fit cannot be simulated.
    """
    published = np.array(list(REDUCTION_PERCENT.values()))
    default = np.append(logarithms(base), np.log(CURRENT_A))

    def residual(at: Real) -> Real:
        """Return simulated minus published values, in standard uncertainties of the published values, shape (6,).

        The first five are reductions of DT, the last is the natural frequency. `at` contains the logarithms of the
        values in `ALL`.
        """
        reductions = _reductions(base, at)
        return np.append((reductions - published) / U_POINTS, (np.exp(at[0]) - FREQUENCY_HZ) / U_FREQUENCY_HZ)

    at = default.copy()
    places = [ALL.index(name) for name in free]
    at[places] = np.log([START[name] for name in free])
    largest = np.array([LARGEST[name] for name in free])
    converged = False
    for iteration in range(ITERATIONS):
        on_step(f"fitting {', '.join(free)} to the paper, step {iteration + 1} of at most {ITERATIONS}")
        fitted_residual = residual(at)
        jacobian = _slopes(residual, at, fitted_residual, places)
        information_matrix = jacobian.T @ jacobian
        change = -np.linalg.solve(information_matrix, jacobian.T @ fitted_residual)
        converged = bool(change @ information_matrix @ change < CONVERGED**2)
        if converged or iteration == ITERATIONS - 1:
            break  # the slopes belong to these values
        at[places] += change * min(1.0, float((largest / np.abs(change)).min()))
    covariance = np.linalg.inv(information_matrix)
    on_step("computing how well the paper determines each constant of the rig")
    here = residual(default)
    slopes = _slopes(residual, default, here, range(len(default)))
    rms = [float(np.sqrt(np.mean((U_POINTS * r[:-1]) ** 2))) for r in (fitted_residual, here)]
    fitted = np.exp(at[places])
    return PaperFit(
        fitted=dict(zip(free, fitted.tolist(), strict=True)),
        u=dict(zip(free, (fitted * np.sqrt(np.diag(covariance))).tolist(), strict=True)),
        converged=converged,
        points=dict(zip(REDUCTION_PERCENT, (published + U_POINTS * fitted_residual[:-1]).tolist(), strict=True)),
        rms_points=rms[0],
        default_rms_points=rms[1],
        information=information(ALL, slopes),
    )


def _slopes(residual: Callable[[Real], Real], at: Real, here: Real, places: Sequence[int]) -> Real:
    """Return the derivatives of residuals by the logarithms of some of the values in `ALL`, one column for each value.

    Args:
        residual: function that returns the residuals for the logarithms of all values.
        at: logarithms of all values in `ALL`, at which to differentiate.
        here: residuals at `at`.
        places: indices of the values by which to differentiate.
    """
    unit = np.eye(len(at))
    return np.stack([(residual(at + STEPS[place] * unit[place]) - here) / STEPS[place] for place in places], axis=1)


def _reductions(base: RigConfig, at: Real) -> Real:
    """Simulate the rig with each of the five gaps of the paper, and return the reductions of DT [%], shape (5,).

    Args:
        base: rig with all other values.
        at: logarithms of the values in `ALL`, among them the current.

    Raises:
        ConfigError: a value is out of its range.
        SimulationError: a motion cannot be simulated.
    """
    config, current_a = rig(base, at[:-1]), float(np.exp(at[-1]))
    motions = [simulated(config, gap, FREQUENCY_HZ, current_a) for gap in REDUCTION_PERCENT]
    return 100.0 * (1.0 - np.exp([motion.log_ratio for motion in motions]))
