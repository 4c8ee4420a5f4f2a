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
"""Example (c): an analysis and the rig, compared with their earlier correct results.

The recorded run is an MCAP run like any other; here the rig records it in each session, so that the repository has no
binary. A run of a laboratory works as well: let `recorded` return its path. `golden/` holds what was found in
it, as text, and is written by `pytest --rig-update-golden`.
"""

import numpy as np
import pytest
from analyse_run import analyse

from impact_rig.recording import open_run
from impact_rig.testing import Golden, LocalRig

RIG = {"sphere.present": False, "daq.rate_hz": 1000, "daq.block_scans": 50, "drive.amplitude": 0.3}
DRIVE_HZ = 8.5
FLIPPED = 1e-4
"""Relative: another CPU rounds the last bit elsewhere, so a reading may flip by a step of the converter; one flip
of the base moves the result by up to 4e-5."""
STEPS = 2.5
"""The same for a reading itself, in 2^-16 of the channel's range, of which a step of the laser is two."""


def record(directory, **changes):
    rig = LocalRig({**RIG, "drive.frequency_hz": DRIVE_HZ, **changes})
    rig.run(seconds=5)
    return rig.save(directory)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    return record(tmp_path_factory.mktemp("recorded") / "run")


def readings(path):
    """Return {channel[scan]: reading in steps of the converter} of twenty scans of a run."""
    with open_run(path) as run:
        channels = next(run.tables("daq/info")).rows
        scans = np.concatenate([table.rows for table in run.tables("daq/scan")])
    step = {row["name"].decode(): (row["range_high"] - row["range_low"]) / 2**16 for row in channels}
    return {f"{name}[{scan}]": scans[name][scan] / step[name] for name in step for scan in range(0, len(scans), 250)}


def test_the_analysis_reproduces_the_stored_results(recorded, golden):
    golden.values(analyse(recorded), rel=FLIPPED)


def test_the_stored_results_agree_with_the_closed_form(recorded, virtual_rig):
    expected = virtual_rig(RIG).expected_transmissibility(DRIVE_HZ)
    assert analyse(recorded)["transmissibility"] == pytest.approx(abs(expected), rel=0.01)


def test_a_change_of_the_analysis_changes_the_results(recorded, golden):
    """Without the correction of the laser's lag: 0.7 ms are 2 degrees at 8.5 Hz."""
    right = Golden(golden.directory.parent / test_the_analysis_reproduces_the_stored_results.__name__, update=False)
    with pytest.raises(AssertionError, match="phase_deg"):
        right.values(analyse(recorded, correct_lag=False), rel=FLIPPED)


def test_the_rig_reproduces_the_stored_readings(recorded, golden):
    golden.values(readings(recorded), rel=0.0, abs=STEPS)


def test_a_change_of_the_rig_changes_the_readings(tmp_path, golden):
    """A structure tuned 1 mHz higher: the laser's readings differ by up to 28 of those steps."""
    right = Golden(golden.directory.parent / test_the_rig_reproduces_the_stored_readings.__name__, update=False)
    changed = record(tmp_path / "run", **{"structure.natural_frequency_hz": 9.106})
    with pytest.raises(AssertionError, match="laser"):
        right.values(readings(changed), rel=0.0, abs=STEPS)
