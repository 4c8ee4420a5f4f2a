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
"""The analysis selects its channels by name: there may be others, in any order, and one may be missing."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import info_rows

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.scans import ACCELEROMETER, BASE, CURRENT, LASER, status_of
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, Column, Table, row_type
from impact_rig.errors import ConfigError


def test_status_bits_follow_the_names_of_channels_not_their_positions():
    names = ("force", "current", "laser", "accelerometer", "base")
    rows = np.zeros(
        3, row_type([*(Column(name, "-", "") for name in ("time", *names)), Column("status", "-", "", "u1")])
    )
    rows["status"] = 1 << names.index("laser"), 1 << names.index("force"), 0
    assert status_of(rows).tolist() == [1 << LASER, 0, 0]


def test_calibration_tolerates_extra_and_absent_channels_but_rejects_none_and_duplicates():
    rows = info_rows()
    more = np.concatenate([rows[:1], rows])
    more["name"][0] = b"force"
    assert Calibration.from_info(more).noise.tolist() == Calibration.from_info(rows).noise.tolist()
    assert Calibration.from_info(rows[rows["name"] != b"laser"]).present.tolist() == [True, False, True, True]
    for wrong in (rows[:0], more[:1], np.concatenate([rows, rows])):
        with pytest.raises(ConfigError, match=r"or more of the channels .*laser.* each once"):
            Calibration.from_info(wrong)


def test_a_scan_that_lacks_a_calibrated_channel_is_rejected_with_its_name():
    rows = np.zeros(4, row_type([Column(name, "-", "") for name in ("time", "base", "current")]))
    tracker = Tracker()
    tracker.configure(Table(0, info_rows()[[ACCELEROMETER, LASER, BASE, CURRENT]]))
    with pytest.raises(ConfigError, match="lacks the column accelerometer, laser, status"):
        tracker.feed(Table(0, rows))


def test_text_in_a_column_of_numbers_is_refused_and_names_it():
    rows = np.zeros(1, [(name, "S4" if name == "frequency" else APPLIED[name]) for name in APPLIED.names])
    with pytest.raises(ConfigError, match=r"^shaker/applied has text instead of numbers in the column frequency; corr"):
        Tracker().on_applied(Table(0, rows))
