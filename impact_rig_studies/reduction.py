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
"""Reduction of the transmissibility by a damper, and the damper's added mass and loss factor, with uncertainties.

They are computed from settled rows that were measured with the same instruments.

The reduction is 100 (1 − DT / DT_0), where DT_0 is the transmissibility without the damper. A measured value is
DT' = DT (1 + g_1 + b_1(A_1) − g_b − b_b(A_b) + ε) with laser (1) and base sensor (b):

    g      error of the sensitivity, the same in both measurements
    b(A)   effect of the sensor's curved characteristic at the amplitude A: c_3 (L/R) (1.875 (A/R)² − 1.5)
           (`analysis.calibration`); c_3 is the same in both measurements
    ε      noise, scatter, remnant of a transient: different in every measurement

In the quotient Q = DT / DT_0 every g cancels, and of b all but the difference of the squared amplitudes:

    u²(Q)/Q² = Σ_{1,b} [1.875 (L/R) u(c_3) (A² − A_0²)/R²]² + u²(ε) + u²(ε_0) + u_Q² + u_Q0²

and 100 u(Q) is the uncertainty of the reduction in percentage points. u_Q is due to the resolution steps of sensors and
converter (column `steps_uncertainty`): this error differs between amplitudes, but is the same in all rows of one
amplitude. u(ε) is the rest of a row's stated uncertainty, without sensitivities and steps. n consecutive rows have n
independent errors ε (the remnant of a transient decays from row to row), so their mean has the uncertainty √Σu²(ε) / n.
Zero errors do not affect the amplitude of a sine.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.uncertainty_budget import AMPLITUDES


@attrs.frozen
class Reduction:
    """Reduction of the transmissibility DT by the damper in percent of DT without the damper (DT_0)."""

    percent: float  # 100 (1 − DT / DT_0)
    u_points: float  # standard uncertainty of `percent`, in percentage points
    steps_points: float = 0.0  # the part of `u_points` due to the steps of sensors and converter


def reduction(without: NDArray[np.void], rows: NDArray[np.void], calibration: Calibration) -> Reduction:
    """Return the reduction of the mean transmissibility by the damper in percent, with its uncertainty.

    Args:
        without: settled rows of `transmissibility/table` without the damper, shape (n,), n >= 1.
        rows: settled rows with the damper, at the same frequency and by the same instruments, shape (k,), k >= 1.
        calibration: calibration of these instruments.
    """
    quotient = float(np.mean(rows["transmissibility"]) / np.mean(without["transmissibility"]))
    variance = repeatability(without, calibration) ** 2 + repeatability(rows, calibration) ** 2
    for channel, amplitude in AMPLITUDES:
        bent, bent_without = (
            calibration.curvature_uncertainty(channel, float(np.mean(one[amplitude]))) for one in (rows, without)
        )
        variance += (bent - bent_without) ** 2
    steps = _steps(without) + _steps(rows)
    points = 100.0 * quotient
    return Reduction(100.0 * (1.0 - quotient), points * math.sqrt(variance), points * math.sqrt(steps))


def repeatability(rows: NDArray[np.void], calibration: Calibration) -> float:
    """Return the relative standard uncertainty of the mean transmissibility, without that of the sensitivities.

    This uncertainty remains in the quotient of two measurements. The errors of the sensors' sensitivities cancel there.

    Args:
        rows: settled rows of `transmissibility/table` at one gap and frequency, shape (n,), n >= 1.
        calibration: calibration of the instruments.
    """
    sensitivities = np.array(
        [
            sum(
                calibration.gain_uncertainty_at(
                    channel, float(row[amplitude]) * calibration.scale(channel, float(row["frequency"]))
                )
                ** 2
                for channel, amplitude in AMPLITUDES
            )
            for row in rows
        ]
    )
    relative, steps = rows["transmissibility_uncertainty"] / rows["transmissibility"], _steps(rows)
    own = np.maximum(relative**2 - sensitivities - steps, 0.0)
    return math.sqrt(float(np.sum(own)) / len(rows) ** 2 + steps)


def _steps(rows: NDArray[np.void]) -> float:
    """Return the relative variance of DT due to the resolution steps of sensors and converter.

    This is the mean over the rows. It also applies to the mean DT, because the error is the same in all rows. A row
    whose column `steps_uncertainty` is NaN counts as 0.
    """
    return float(np.mean((np.nan_to_num(rows["steps_uncertainty"]) / rows["transmissibility"]) ** 2))


@attrs.frozen
class Damper:
    """Added mass and loss factor of a damper at one frequency, relative to the mass m_1, with their uncertainties."""

    added_mass: float  # in units of m_1: force in phase with the displacement over ω² m_1 X_1
    loss_factor: float  # energy lost per cycle over 2π · ½ m_1 ω² X_1²
    u_added_mass: float  # standard uncertainty of `added_mass`
    u_loss_factor: float  # standard uncertainty of `loss_factor`


def damper_effect(without: NDArray[np.void], rows: NDArray[np.void], calibration: Calibration) -> Damper:
    """Derive a damper's added mass and loss factor from DT with and without it at one frequency.

    No constant of the rig is needed.

    The structure obeys m_1 ω² (K/ω² (1 − 1/D) − 1) X_1 = F, D = X_1/X_b complex, with K its complex stiffness over m_1.
    Without the damper F = 0, which is K/ω² = 1 / (1 − 1/D_0). So

        F / (m_1 ω² X_1) = (1/D_0 − 1/D) / (1 − 1/D_0) = added mass − i · loss factor

    The error of a sensitivity is a common factor of D and D_0; unrepeatable errors are independent.

    Args:
        without: settled rows of `transmissibility/table` without the damper, shape (n,), n >= 1.
        rows: settled rows with the damper, at the same frequency, shape (k,), k >= 1.
        calibration: calibration of these instruments.
    """
    d_0, d = (complex(np.mean(one["transmissibility"] * np.exp(1j * one["phase"]))) for one in (without, rows))
    a, b = 1.0 / d, 1.0 / d_0
    z = (b - a) / (1.0 - b)
    slopes = (-b * (1.0 - a) / (1.0 - b) ** 2, a / (1.0 - b))  # by ln D_0 and ln D
    variance = np.zeros(2)
    for slope, one in zip(slopes, (without, rows), strict=True):
        phase_u = math.sqrt(float(np.sum(one["phase_uncertainty"] ** 2))) / len(one)
        for part, u in ((slope, repeatability(one, calibration)), (1j * slope, phase_u)):
            variance += (u * np.array([part.real, part.imag])) ** 2
    gain = sum(slopes)
    common = math.hypot(*(float(calibration.gain_uncertainty[channel]) for channel, _ in AMPLITUDES))
    variance += (common * np.array([gain.real, gain.imag])) ** 2
    return Damper(z.real, -z.imag, math.sqrt(variance[0]), math.sqrt(variance[1]))
