"""A campaign through the real graph gives the numbers of one without DDS, bit for bit: points, sweep and failures."""

from __future__ import annotations

import pytest
from campaign_kit import assert_same

pytestmark = [pytest.mark.ros, pytest.mark.pipeline, pytest.mark.timeout(200)]


def test_ros_and_process_give_the_same_bits(tmp_path, measured):
    from impact_rig.cli.campaign_ros import ros_runner

    jobs = [job for job, _ in measured.values()]
    found = {job.key: outcome for job, outcome in ros_runner(tmp_path)(jobs)}
    assert set(found) == set(measured)
    for key, outcome in found.items():
        assert_same(outcome, measured[key][1])
