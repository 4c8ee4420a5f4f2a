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
"""Properties of every instrument in the folder, present by default or not."""

from __future__ import annotations

from pathlib import Path

import attrs
import numpy as np
import pytest

from impact_rig.blocks import Column
from impact_rig.instruments import registry
from impact_rig.instruments.checks import check_known_input
from impact_rig.instruments.instrument import CHANNEL_KINDS
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.instruments.section import CHANNELS, COLUMNS, SCAN, channels_of
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, fields, from_flat
from impact_rig.testing import LocalRig

OPTIONAL = tuple(name for name, kind in INSTRUMENTS.items() if "present" in attrs.fields_dict(kind))
ALL = {f"instruments.{name}.present": True for name in OPTIONAL}
NAMES = {name for name, _, _ in fields()}


def test_every_instrument_of_the_folder_is_found():
    files = Path(registry.__file__).parent.glob("*.py")
    assert sum("(Instrument):" in path.read_text(encoding="utf-8") for path in files) == len(INSTRUMENTS)


def test_an_optional_instrument_is_off_by_default_and_adds_no_column():
    assert set(CHANNELS) == set(INSTRUMENTS) - set(OPTIONAL)
    assert SCAN.itemsize == 8 * (1 + len(CHANNELS)) + 1
    assert CHANNELS[:4] == ("accelerometer", "laser", "base", "current"), "their bits and noise depend on it"


@pytest.mark.parametrize("instrument", INSTRUMENTS.values(), ids=INSTRUMENTS)
def test_an_instrument_describes_its_channel_and_its_faults(instrument):
    assert Column(instrument.name, instrument.unit, instrument.doc) in COLUMNS
    assert instrument.doc.endswith(".")
    assert instrument.faults <= CHANNEL_KINDS
    assert {f"instruments.{instrument.name}.{field}" for field in ("adc_range_v", "inverted")} <= NAMES
    if instrument.monitor is not None:
        assert instrument.monitor.publisher == "rig"
        said = {column.name for column in instrument.monitor.fields}
        assert said <= set(instrument().message(0.0, clipped=False, noise=0.0))


@pytest.mark.parametrize("name", INSTRUMENTS)
def test_the_channel_of_an_instrument_reads_a_known_sine(name):
    check = {one.channel: one for one in check_known_input(from_flat(RigConfig(), ALL))}[name]
    assert check.ok, check


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> np.ndarray:
    pytest.importorskip("sensor_msgs", reason="no ROS 2 here")
    rig = LocalRig({"drive.amplitude": 0.52, **ALL})
    rig.run(seconds=1.5)
    with open_run(rig.save(tmp_path_factory.mktemp("runs") / "run")) as run:
        return np.concatenate([table.rows for table in run.tables(run.resolve("daq/scan"))])


@pytest.mark.ros
@pytest.mark.parametrize("name", INSTRUMENTS)
def test_the_channel_of_an_instrument_is_recorded(recorded, name):
    assert channels_of(recorded) == tuple(INSTRUMENTS)
    assert np.isfinite(recorded[name]).all()
    assert recorded[name].any()
