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
"""Acquisition and generation against the real LDAQ."""

import numpy as np
import pytest

pytest.importorskip("LDAQ", reason="make adapters installs it")

import LDAQ
from ldaq_rig import CHANNELS, RigAcquisition, RigGeneration

from impact_rig import transmissibility
from impact_rig.driver import LocalRig

RATE_HZ = 2000
SETTINGS = {
    "sphere.present": False, "daq.rate_hz": RATE_HZ, "daq.block_scans": 20,
    "drive.waveform": "stream", "drive.stream_rate_hz": RATE_HZ,
}  # fmt: skip


def test_an_acquisition_without_generation_returns_all_samples():
    acquisition = RigAcquisition(LocalRig({**SETTINGS, "drive.waveform": "sine", "drive.amplitude": 0.3}))
    acquisition.run_acquisition(2.0)
    found = acquisition.get_measurement_dict()
    assert found["channel_names"] == list(CHANNELS)
    assert found["sample_rate"] == RATE_HZ
    assert found["data"].shape[0] >= 2.0 * RATE_HZ
    assert np.isfinite(found["data"]).all()


def test_acquisition_and_generation_measure_the_transmissibility():
    rig = LocalRig({**SETTINGS, "structure.damping_ratio": 0.02})  # which settles within 6 s
    signal = 0.3 * np.sin(2.0 * np.pi * 9.0 * np.arange(RATE_HZ) / RATE_HZ)
    acquisition, generation = RigAcquisition(rig), RigGeneration(rig, signal)
    core = LDAQ.Core(acquisitions=[acquisition], generations=[generation])
    core.run(6.0, autostart=True, hotkeys=False, verbose=0)
    data = core.get_measurement_dict()["rig"]["data"]
    lines = np.abs(np.fft.rfft(data[-RATE_HZ:] - data[-RATE_HZ:].mean(axis=0), axis=0)) / (RATE_HZ / 2)
    _, laser, base, current = lines[9]
    assert (lines.argmax(axis=0) == 9).all()
    assert current == pytest.approx(0.3, rel=0.02)
    assert laser / base == pytest.approx(abs(transmissibility(rig.config, 9.0)), rel=0.01)
    assert acquisition.acquisition.lost == 0
