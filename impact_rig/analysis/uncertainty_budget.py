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
"""Uncertainty budget of the mean transmissibility of settled measurements, line by line as in the GUM.

The module also has the coverage factor of every expanded uncertainty, and functions that format a value with its
uncertainty.

The relative variance of DT is the sum of four terms for each of the channels laser and base, and a remainder:

    u²(DT)/DT² = u²(ε) + Σ { u²(S) + [(1.5 − 1.875 a²) (L/R) u(c_3)]² + (Re ∂lnH/∂ln τ · u_τ)² + u_Q² }

- u(S): sensitivity, without the slope of the sensor's curve at mid-range, which the next term contains
- [...]: curve of the sensor at the amplitude a·R of the vibration. R is half the range, L the bound of the error of
  linearity, c_3 the unknown share of the cubic in it (`calibration`).
- u_τ: relative uncertainty of the sensor's lag τ. H is the frequency response of that lag.
- u_Q: steps of sensor and converter
- u(ε): noise, scatter and the remnant of a transient. It is the remainder of the stated total, so the lines add up to
  the total. It is 0 if the other terms already exceed the total.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import U_CUBIC, Calibration
from impact_rig.analysis.scans import BASE, CHANNELS, LASER

COVERAGE = 2.0  # standard uncertainties in an expanded uncertainty, which covers about 95 % of cases
CERTAIN, CERTAIN_PART = 1e-12, 1e-9  # expanded uncertainties, absolute and relative, below which a value is exact
AMPLITUDES = ((LASER, "laser_amplitude"), (BASE, "base_amplitude"))


def rounded(value: float, u: float) -> tuple[str, str]:
    """Return a value and its expanded uncertainty 2u as two texts, both rounded to the second significant digit of 2u.

    A number that is NaN or infinite becomes "-", and a zero has no minus sign. If 2u is zero, negligible or not finite,
    the value has ten significant digits.
    """
    expanded = COVERAGE * u
    if not (math.isfinite(value) and max(CERTAIN, CERTAIN_PART * abs(value)) < expanded < math.inf):
        return _text(value, ".10g"), _text(expanded, ".2g")
    places = 1 - int(f"{expanded:.1e}".partition("e")[2])
    value_text, expanded_text = (f"{round(one, places):z.{max(places, 0)}f}" for one in (value, expanded))
    return value_text, expanded_text


def _text(number: float, spec: str) -> str:
    return format(number, f"z{spec}") if math.isfinite(number) else "-"


def plus_minus(value: float, u: float) -> str:
    """Return `value ± 2u` as text, e.g. "63.57 ± 0.32", where `u` is the standard uncertainty.

    Both parts are formatted by `rounded`. A part that is NaN or infinite becomes "-", as in "63.57 ± -".
    """
    return " ± ".join(rounded(value, u))


def combined(rows: NDArray[np.void]) -> float:
    """Return the standard uncertainty of the mean transmissibility of some rows.

    The result is the rms of the rows' uncertainties. Averaging does not reduce it, because the sensitivities dominate
    the uncertainty, and their errors are the same in all rows.
    """
    return math.sqrt(float(np.mean(rows["transmissibility_uncertainty"] ** 2)))


@attrs.frozen
class Contribution:
    """Line of the uncertainty budget: one source of error of the mean transmissibility."""

    source: str  # channel, or `measurement`
    what: str  # error that it represents
    evaluation: str  # A (statistics of this measurement) or B (certificate), in the terms of the GUM
    u_relative: float  # its contribution to the relative standard uncertainty of DT


@attrs.frozen
class Budget:
    """Uncertainty budget of a mean transmissibility: all its lines, and the total."""

    transmissibility: float  # mean of the rows
    u_transmissibility: float  # its stated standard uncertainty
    parts: Sequence[Contribution]  # the lines; their squares add up to at least (u/DT)²

    def share(self, part: Contribution) -> float:
        """Return the fraction that one line contributes to the sum of the variances of all lines.

        The fractions of all lines add up to 1. If the sum of the variances is 0, the result is 0.
        """
        whole = sum(part.u_relative**2 for part in self.parts)
        return part.u_relative**2 / whole if whole else 0.0


def budget(rows: NDArray[np.void], calibration: Calibration, lag_uncertainty: float = 0.0) -> Budget:
    """Return the uncertainty budget of the mean transmissibility of settled rows at one frequency and gap.

    `rows` are rows of `transmissibility/table`, shape (n,), n >= 1. `lag_uncertainty` is the relative standard
    uncertainty of the sensors' lags.
    """
    dt, u = float(np.mean(rows["transmissibility"])), combined(rows)
    frequency_hz = float(rows["frequency"][0])
    parts: list[Contribution] = []
    for channel, column in AMPLITUDES:
        amplitude = float(np.mean(rows[column]))
        reading = amplitude * calibration.scale(channel, frequency_hz)
        curve = _curve(calibration, channel, reading)
        gain = math.sqrt(max(calibration.gain_uncertainty_at(channel, reading) ** 2 - curve**2, 0.0))
        read = amplitude * abs(complex(calibration.response(channel, frequency_hz)))
        lag, _ = calibration.lag_uncertainties(channel, frequency_hz, lag_uncertainty)
        parts += [
            Contribution(CHANNELS[channel], "sensitivity", "B", gain),
            Contribution(CHANNELS[channel], "linearity at this amplitude", "B", curve),
            Contribution(CHANNELS[channel], "lag", "B", lag),
            Contribution(CHANNELS[channel], "steps", "B", calibration.steps_uncertainty(channel, read) / read),
        ]
    rest = (u / dt) ** 2 - sum(part.u_relative**2 for part in parts)
    parts.append(Contribution("measurement", "noise, scatter, remnant", "A", math.sqrt(max(rest, 0.0))))
    return Budget(dt, u, parts)


def _curve(calibration: Calibration, channel: int, amplitude: float) -> float:
    """Return the relative standard uncertainty of a channel's gain because its sensor is not exactly linear.

    `amplitude` is the amplitude of the vibration [unit of the channel]. For a very small amplitude, the result is
    1.5 u(c_3) L/R, where L is the `linearity`, R half the range, and u(c_3) = 1/√6 (`Calibration.gain_uncertainty_at`).
    """
    half_range = float(calibration.high[channel] - calibration.low[channel]) / 2.0
    share = amplitude / half_range
    return abs(1.5 - 1.875 * share**2) * float(calibration.linearity[channel]) / half_range * U_CUBIC
