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
"""Effect of a slow sensor on DT: the calibration corrects it, or the uncertainty contains it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from impact_rig.analysis.tracker import Tracker
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat


def unchanged(_rows: NDArray[np.void]) -> None:
    """Leave scans as they are."""


def measured(change: Callable[[NDArray[np.void]], None] = unchanged, **values: object) -> tuple[float, float, bytes]:
    """Return DT of a rig without sphere at 9.1 Hz, its standard uncertainty and status; `change` alters the scans."""
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
            change(block.scan.rows)
            for table in tracker.feed(block.scan).measurements:
                row = table.rows[0]
                if row["settled"] == 1.0:
                    return float(row["transmissibility"]), float(row["transmissibility_uncertainty"]), row["status"]
    raise AssertionError("nothing settled")


@pytest.fixture(scope="module")
def usual() -> tuple[float, float, bytes]:
    return measured()


@pytest.mark.parametrize("corner_hz", [20.0, 40.0])
def test_the_two_poles_of_a_slow_base_sensor_are_corrected(usual: tuple[float, float, bytes], corner_hz: float) -> None:
    slow, u, _ = measured(instruments__base__bandwidth_hz=corner_hz)
    assert abs(slow - usual[0]) < 2 * u


def test_the_uncertainty_covers_the_amplitude_error_of_a_pure_delay_model(usual: tuple[float, float, bytes]) -> None:
    """An anti-alias filter behind a sensor is only known as a delay."""
    dt, u, _ = measured(instruments__adc__anti_alias="butterworth", instruments__adc__anti_alias_hz=30.0)
    assert abs(dt - usual[0]) < 3 * u
    assert u >= usual[1]


def test_crosstalk_is_undetected_and_changes_dt_by_the_documented_amount(usual: tuple[float, float, bytes]) -> None:
    def cross(rows: NDArray[np.void]) -> None:
        rows["base"] += 1e-5 * rows["current"]

    dt, _, status = measured(cross)
    assert status == b"ok"
    assert dt / usual[0] - 1.0 == pytest.approx(0.0085, rel=0.2)


def test_backlash_is_undetected_and_changes_dt_by_the_documented_amount(usual: tuple[float, float, bytes]) -> None:
    followed: list[float] = []

    def slack(rows: NDArray[np.void]) -> None:
        for i, value in enumerate(rows["base"].tolist()):
            before = followed[-1] if followed else value
            followed.append(min(max(before, value - 2.5e-6), value + 2.5e-6))
            rows["base"][i] = followed[-1]

    dt, _, status = measured(slack)
    assert status == b"ok"
    assert dt / usual[0] - 1.0 == pytest.approx(0.0059, rel=0.3)
