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
"""A campaign through the real graph gives the numbers of one without DDS, bit for bit: points, sweep and failures."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from kits.campaign import assert_same

from impact_rig.recording import open_run
from impact_rig.runs import reanalysis
from impact_rig.runs.verification import verify

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(200)]


def test_jobs_over_ros_and_in_process_yield_the_same_bits(tmp_path, measured):
    from impact_rig_studies.ros_campaign import ros_runner

    point, _, sweep, _, trip, refused = (job for job, _ in measured.values())
    jobs = [point, sweep, trip, refused]
    found = {job.key: outcome for job, outcome in ros_runner(tmp_path, tmp_path / "runs")(jobs)}
    assert set(found) == {job.key for job in jobs}
    for key, outcome in found.items():
        assert_same(outcome, measured[key][1])
    for job in jobs:
        (path,) = (tmp_path / "runs").glob(f"*_{job.key}")
        if found[job.key].simulated_s == 0.0:
            continue  # refused: nothing to scan
        with open_run(path) as recorded:
            verdict = verify(recorded)
            again = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(recorded)))
        assert verdict.identical, verdict
        settled = again[again["settled"] == 1.0]["transmissibility"]
        np.testing.assert_array_equal(settled[: len(found[job.key].rows)], found[job.key].rows["transmissibility"])


def test_a_job_after_a_trip_is_measured(tmp_path, measured):
    """The latch survives the lifecycle transitions: without a reset, every job after a trip would fail."""
    from impact_rig_studies.ros_campaign import ros_runner

    point, _, _, _, trip, _ = (job for job, _ in measured.values())
    again = attrs.evolve(point, traces=False, changes={**point.changes, "daq.rate_hz": trip.config().daq.rate_hz})
    outcomes = [outcome for _, outcome in ros_runner(tmp_path)([trip, again])]
    assert "over_travel" in outcomes[0].failure
    assert (outcomes[1].failure, len(outcomes[1].rows)) == ("", 1)
