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
"""Uncertainty budget: its lines add up to the uncertainty, and each line is the error that it names."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest
from kits.records import info_rows

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.scans import BASE, LASER
from impact_rig.analysis.uncertainty_budget import budget, plus_minus, rounded
from impact_rig.blocks import TRANSMISSIBILITY

GAIN_U, NOISE, LAG_U = 2e-3, 4e-4, 0.05
AMPLITUDES = {LASER: 5e-3, BASE: 80e-6}
ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize(
    ("value", "u", "text"),
    [
        (63.5674, 0.1597, "63.57 ± 0.32"),
        (0.098342, 0.000246, "0.09834 ± 0.00049"),
        (0.0641, 3.2e-8, "0.064100000 ± 0.000000064"),
        (2.0, 0.0498, "2.00 ± 0.10"),
        (2.0, 0.04974, "2.000 ± 0.099"),
        (110.42, 0.4999, "110.4 ± 1.0"),
        (110.42, 6.0, "110 ± 12"),
        (12345.6, 339.0, "12350 ± 680"),
        (-41.27, 0.25, "-41.27 ± 0.50"),
        (-0.001, 0.25, "0.00 ± 0.50"),
        (-0.0, 0.0, "0 ± 0"),
        (9.1, 0.0, "9.1 ± 0"),
        (0.0, 0.0, "0 ± 0"),
        (0.0, 1e-15, "0 ± 2e-15"),
        (9.1 - 1e-15, 3.6e-17, "9.1 ± 7.2e-17"),
        (9.1, math.nan, "9.1 ± -"),
        (math.nan, math.nan, "- ± -"),
        (math.inf, 1.0, "- ± 2"),
    ],
)
def test_values_are_rounded_to_two_significant_digits_of_2u(value, u, text):
    assert plus_minus(value, u) == text
    assert " ± ".join(rounded(np.float64(value), np.float64(u))) == text


@pytest.mark.parametrize("package", ["impact_rig", "impact_rig_studies", "impact_rig_lab"])
def test_all_programs_round_uncertainties_with_the_same_function(package):
    own = re.compile(r'(?:± "?\n? *f?"?\{|figure\()(?:2|200)(?:\.0)? \*|± \{(?:COVERAGE|u:)')
    for path in (ROOT / package).rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        assert [text[: found.start()].count("\n") + 1 for found in own.finditer(text)] == [], path


@pytest.fixture
def calibration():
    info = info_rows(gain_u=GAIN_U)
    info["linearity"][[LASER, BASE]] = 30e-6, 30e-6
    straight = Calibration.from_info(info)
    slope = 1.5 * straight.linearity / straight.high / math.sqrt(6)
    info["sensitivity_uncertainty"] = np.hypot(GAIN_U, slope)  # a certificate counts the slope at mid-range
    return Calibration.from_info(info)


def rows_of(calibration, lag_u=0.0):
    row = np.zeros(1, TRANSMISSIBILITY)
    row["frequency"], row["laser_amplitude"], row["base_amplitude"] = 9.1, AMPLITUDES[LASER], AMPLITUDES[BASE]
    row["transmissibility"] = AMPLITUDES[LASER] / AMPLITUDES[BASE]
    variance = NOISE**2
    for channel, amplitude in AMPLITUDES.items():
        variance += calibration.gain_uncertainty_at(channel, amplitude) ** 2
        variance += (calibration.lag_sensitivity(channel, 9.1).real * lag_u) ** 2
    row["transmissibility_uncertainty"] = row["transmissibility"] * math.sqrt(variance)
    return row


@pytest.mark.parametrize("lag_u", [0.0, LAG_U])
def test_the_parts_add_up_to_the_stated_uncertainty(calibration, lag_u):
    rows = rows_of(calibration, lag_u)
    found = budget(rows, calibration, lag_u)
    relative = found.u_transmissibility / found.transmissibility
    assert math.hypot(*(part.u_relative for part in found.parts)) == pytest.approx(relative, rel=1e-9)
    assert sum(map(found.share, found.parts)) == pytest.approx(1.0, rel=1e-9)
    assert found.transmissibility == rows["transmissibility"][0]


def test_shares_add_up_to_1_if_the_lines_exceed_the_stated_uncertainty(calibration):
    """This happens if the last calibration of a run is less certain than that of its rows."""
    rows = rows_of(calibration)
    rows["transmissibility_uncertainty"] /= 3.0
    found = budget(rows, calibration)
    assert sum(map(found.share, found.parts)) == pytest.approx(1.0, rel=1e-9)


def test_each_line_of_the_budget_is_the_contribution_that_it_names(calibration):
    found = budget(rows_of(calibration, LAG_U), calibration, LAG_U)
    lines = {(part.source, part.what): part for part in found.parts}
    assert lines["measurement", "noise, scatter, remnant"].u_relative == pytest.approx(NOISE, rel=1e-6)
    assert lines["measurement", "noise, scatter, remnant"].evaluation == "A"
    for channel, name in ((LASER, "laser"), (BASE, "base")):
        assert lines[name, "sensitivity"].u_relative == pytest.approx(GAIN_U, rel=1e-6)
        share = AMPLITUDES[channel] / calibration.high[channel]
        bent = abs(1.5 - 1.875 * share**2) * 30e-6 / calibration.high[channel] / math.sqrt(6)
        assert lines[name, "linearity at this amplitude"].u_relative == pytest.approx(bent)
        lag = abs(calibration.lag_sensitivity(channel, 9.1).real) * LAG_U
        assert lines[name, "lag"].u_relative == pytest.approx(lag)
        assert lines[name, "lag"].evaluation == "B"


def test_nonlinearity_of_a_velocity_sensor_acts_on_its_reading():
    info = info_rows(gain_u=GAIN_U)
    info["unit"][LASER], info["range_low"][LASER], info["range_high"][LASER] = b"m/s", -0.5, 0.5
    info["linearity"][LASER] = 1e-3
    calibration = Calibration.from_info(info)
    found = budget(rows_of(calibration), calibration)
    line = next(part for part in found.parts if (part.source, part.what) == ("laser", "linearity at this amplitude"))
    share = AMPLITUDES[LASER] * 2.0 * math.pi * 9.1 / 0.5
    assert line.u_relative == pytest.approx(abs(1.5 - 1.875 * share**2) * 1e-3 / 0.5 / math.sqrt(6))
