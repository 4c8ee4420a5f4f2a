# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The analysis takes its channels by name: other channels may be there, in any order, and one may be missing."""

from __future__ import annotations

import numpy as np
import pytest
from kits.records import info_rows

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.scans import CHANNELS, LASER, status_of
from impact_rig.columns import Column, row_type
from impact_rig.errors import ConfigError


def test_status_bits_follow_the_names_not_the_places():
    names = ("force", "current", "laser", "accelerometer", "base")
    rows = np.zeros(
        3, row_type([*(Column(name, "-", "") for name in ("time", *names)), Column("status", "-", "", "u1")])
    )
    rows["status"] = 1 << names.index("laser"), 1 << names.index("force"), 0
    assert status_of(rows).tolist() == [1 << LASER, 0, 0]


def test_a_channel_more_or_less_is_no_matter_and_one_twice_is_named():
    rows = info_rows()
    more = np.concatenate([rows[:1], rows])
    more["name"][0] = b"force"
    assert Calibration.from_info(more).noise.tolist() == Calibration.from_info(rows).noise.tolist()
    with pytest.raises(ConfigError, match=r"one row for each of .*laser"):
        Calibration.from_info(np.concatenate([rows, rows[:1]]))
    without = Calibration.from_info(rows[rows["name"] != b"accelerometer"])
    assert without.present.tolist() == [name != "accelerometer" for name in CHANNELS]
