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
"""What the dynamics of a slow sensor do to DT is corrected from its calibration, or in its uncertainty."""

from __future__ import annotations

import pytest

from impact_rig.analysis.tracker import Tracker
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat


def measured(**values: object) -> tuple[float, float]:
    """Return DT of a rig without sphere at 9.1 Hz, and its standard uncertainty."""
    plain = {"daq.rate_hz": 2000, "daq.block_scans": 200, "sphere.present": False, "daq.seed": 3}
    rig = Rig(from_flat(RigConfig(), {**plain, **{name.replace("__", "."): value for name, value in values.items()}}))
    tracker = Tracker()
    tracker.configure(rig.info())
    tracker.label(0.0, 0)
    rig.accept(frequency_hz=9.1, amplitude=0.52)
    for _ in range(600):
        for block in rig.advance(rig.block_end_ns(1)):
            for table in rig.take_applied():
                tracker.on_applied(table)
            for table in tracker.feed(block.scan).measurements:
                if table.rows["settled"][0] == 1.0:
                    return float(table.rows["transmissibility"][0]), float(
                        table.rows["transmissibility_uncertainty"][0]
                    )
    raise AssertionError("nothing settled")


@pytest.mark.parametrize("corner_hz", [20.0, 40.0])
def test_the_two_poles_of_a_slow_base_sensor_are_corrected(corner_hz: float) -> None:
    usual, u = measured()
    slow, _ = measured(instruments__base__bandwidth_hz=corner_hz)
    assert abs(slow - usual) < 2 * u


def test_what_a_delay_leaves_out_of_the_amplitude_is_in_the_uncertainty() -> None:
    """An anti-alias filter on top of a sensor is known as a delay only."""
    usual, u = measured()
    filtered, filtered_u = measured(instruments__adc__anti_alias="butterworth", instruments__adc__anti_alias_hz=30.0)
    assert abs(filtered - usual) < 3 * filtered_u
    assert filtered_u >= u
