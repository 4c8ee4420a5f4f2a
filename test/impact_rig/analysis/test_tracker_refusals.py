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
"""Rejections: a quantity that cannot be measured has a reason and no number."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import blocks, feed_all, info_rows, statuses
from kits.tracker import RATE, record, tracker

from impact_rig.analysis.tracker import Counters, Tracker
from impact_rig.blocks import Table
from impact_rig.errors import ConfigError
from impact_rig.simtime import NS_PER_S
from impact_rig.states import MEASURED, SETTLED, Status


def _silence(rows, rng):
    for name, rms in (("laser", 3e-6), ("base", 1e-6), ("current", 2e-3), ("accelerometer", 0.05)):
        rows[name] = rms * rng.standard_normal(len(rows))


def _swap(rows, _):
    rows["laser"], rows["base"] = rows["base"].copy(), rows["laser"].copy()


@pytest.mark.parametrize(
    ("spoil", "status"),
    [
        (_silence, "silence"),
        (lambda rows, _: rows["laser"].fill(1e-3), "constant"),
        (lambda rows, _: rows["base"].fill(np.nan), "not_finite"),
        (lambda rows, _: rows["laser"].fill(0.5), "over_range"),
        (_swap, "swapped_channels"),
    ],
    ids=["silence", "constant", "nan", "clipped", "swapped"],
)
def test_a_corrupted_stream_yields_a_status_and_no_number(spoil, status):
    rows = record(seconds=20.0)
    spoil(rows, np.random.default_rng(7))
    measurements, _ = feed_all(tracker(), blocks(rows, RATE, 20))
    assert measurements
    assert set(statuses(measurements)) == {status}
    assert len(measurements) <= 5, "a lasting fault is reported once per measurement, not once per window"
    assert all(np.isnan(table.rows[0]["transmissibility"]) for table in measurements)


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, np.nan, 900.0])
def test_an_unusable_frequency_has_a_status(frequency_hz):
    measurements, _ = feed_all(tracker(frequency_hz), blocks(record(seconds=2.5), RATE, 20))
    assert set(statuses(measurements)) == {"no_frequency"}


def test_a_missing_command_is_reported_once_a_second():
    measurements, _ = feed_all(tracker(None), blocks(record(seconds=3.6), RATE, 20))
    assert statuses(measurements) == ["no_frequency"] * 3
    assert [table.stamp_ns for table in measurements] == [k * NS_PER_S - NS_PER_S // RATE for k in (1, 2, 3)]


def test_scans_without_a_calibration_are_counted_not_measured():
    """The blocks of the last 50 ms wait for a calibration until the record ends."""
    made = Tracker()
    feed_all(made, blocks(record(seconds=0.5), RATE, 20))
    assert made.counters == Counters(unconfigured_scans=RATE // 2 - 6 * 20)
    assert made.flush().measurements == ()
    assert made.counters == Counters(unconfigured_scans=RATE // 2)


def test_an_invalid_calibration_is_rejected_and_the_previous_one_kept():
    made = tracker()
    with pytest.raises(ConfigError):
        made.configure(Table(0, info_rows(RATE)[:0]))
    measurements, _ = feed_all(made, blocks(record(seconds=6.0), RATE, 20))
    assert statuses(measurements) == ["ok"]


def test_the_statuses_with_numbers_are_the_documented_ones():
    unsound = {Status.ACCELEROMETER_OVER_RANGE, Status.ACCELEROMETER_UNSOUND, Status.CURRENT_UNSOUND}
    sound = {Status.OK, Status.NO_IMPACTS} | unsound
    assert sound | {Status.NOT_SETTLED} == MEASURED
    assert sound == set(SETTLED)
    assert all(len(status.value) < 32 for status in Status), "text columns hold 32 bytes"
