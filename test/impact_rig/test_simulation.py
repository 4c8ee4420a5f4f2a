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
"""`impact_rig.simulate` gives the results of rig and analysis; test_docs.py runs the code of docs/index.md."""

from __future__ import annotations

import re
import subprocess
import sys

import numpy as np
import pytest

import impact_rig
from impact_rig.errors import ConfigError
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simulation import DRAWN_S, simulate
from impact_rig.states import AnalysisWord

DRIVEN = {"drive.frequency_hz": 9.1, "drive.amplitude": 0.52}


@pytest.mark.heavy
def test_dt_without_sphere_is_the_closed_form_within_its_uncertainty():
    record = simulate(30.0, {**DRIVEN, "sphere.present": False})
    value, u = record.transmissibility
    assert abs(value - abs(complex(transmissibility(record.config, 9.1)))) < 3.0 * u
    assert str(record) == f"DT {value:.2f} ± {2 * u:.2f} (2u) at 9.1 Hz"


@pytest.mark.heavy
def test_a_small_dt_is_printed_with_its_uncertainty():
    """Above the resonance DT is near 0.1, and ± 0.00 would mean that it is exact."""
    record = simulate(20.0, {"drive.frequency_hz": 30.0, "drive.amplitude": 0.52})
    value, u = record.transmissibility
    printed = re.fullmatch(r"DT (0\.\d+) ± (0\.0+[1-9]\d) \(2u\) at 30 Hz", str(record))
    assert printed is not None, str(record)
    assert float(printed[1]) == pytest.approx(value, abs=0.1 * u)
    assert float(printed[2]) == pytest.approx(2 * u, rel=0.05)


def test_scans_equal_those_of_the_rig_and_found_impacts_are_the_true_ones():
    record = simulate(2.0, DRIVEN)
    rig = Rig(from_flat(RigConfig(), DRIVEN))
    blocks = rig.advance(2 * 10**9)
    assert np.array_equal(record.scans["laser"], np.concatenate([block.scan.rows["laser"] for block in blocks]))
    assert np.allclose(np.diff(record.scans["time"]), 1e-4, rtol=0.0, atol=1e-12)
    hard = record.truth[record.truth["approach_speed"] > 0.05]
    assert len(hard) > 5
    for begin in hard["time"]:
        assert np.min(np.abs(record.impact_times - begin)) < 2e-3
    assert str(record) == "no DT: settling"


@pytest.mark.parametrize(
    "parameters",
    [
        {**DRIVEN, "output.command_timeout_s": 1.0},
        {"drive.frequency_hz": 8.0, "drive.amplitude": 5.0, "shaker.travel_limit_m": 2e-3},
    ],
    ids=["time-out", "trip"],
)
def test_the_analysis_knows_that_the_drive_was_stopped(parameters):
    """The analysis must know that the current is zero, not only the initial drive."""
    record = simulate(3.0, {**parameters, "sphere.present": False})
    assert (record.state.word, record.state.reason) == (AnalysisWord.AT_REST, "")


def test_scans_that_a_fault_withholds_are_missing_for_the_analysis_too():
    record = impact_rig.simulate(1.0, {"instruments.faults.planned": ["lost_block start_s=0.8 duration_s=0.02"]})
    assert len(record.scans) == 9_800
    assert np.diff(record.scans["time"]).max() == pytest.approx(0.02 + 1e-4)
    assert record.state.reason == "lost_blocks"
    drawn = record.plot().axes[0].lines[0].get_xdata()
    assert drawn[-1] - drawn[0] == pytest.approx(DRAWN_S, abs=1e-3)
    assert len(impact_rig.simulate(0.1, {"instruments.faults.planned": ["lost_block duration_s=1"]}).scans) == 0


def test_an_impossible_simulation_is_rejected():
    for seconds in (0.0, -1.0, float("nan"), 1e9):
        with pytest.raises(ConfigError, match="seconds must be above 0"):
            simulate(seconds)
    with pytest.raises(ConfigError, match=r"at least 0\.01 s, one block"):
        simulate(0.009)
    with pytest.raises(ConfigError, match="gap"):
        simulate(1.0, {"barriers.gap_m": -1.0})
    assert impact_rig.simulate is simulate
    with pytest.raises(AttributeError, match="simulat"):
        impact_rig.simulat  # noqa: B018


def test_importing_the_package_loads_no_large_library():
    code = "import sys, impact_rig; print({'numpy', 'scipy', 'attrs'} & set(sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout == "set()\n"


def test_a_record_without_any_scan_is_drawn_empty():
    """The drawing must not need the time of a first scan."""
    record = simulate(0.1, {"instruments.faults.planned": ["lost_block"]})
    assert len(record.scans) == 0
    assert record.plot().axes[0].get_title(loc="left") == str(record)
