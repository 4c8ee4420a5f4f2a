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
"""The rig as acquisition and generation of LDAQ, which share one rig and run in LDAQ's threads."""

import itertools

import numpy as np
from LDAQ.acquisition_base import BaseAcquisition
from LDAQ.generation_base import BaseGeneration

from impact_rig.driver import Acquisition, AnalogOutput

CHANNELS = ("accelerometer", "laser", "base", "current")
BLOCK_S = 0.05


class RigAcquisition(BaseAcquisition):
    """Acquisition of the four channels in SI units."""

    def __init__(self, rig, acquisition_name="rig"):
        super().__init__()
        self.acquisition_name, self.sample_rate = acquisition_name, rig.rate_hz
        self.acquisition, self.block = Acquisition(rig), round(BLOCK_S * rig.rate_hz)
        self._channel_names_init = list(CHANNELS)
        super().set_data_source()
        self.set_trigger(1e20, 0, duration=1.0)

    def set_data_source(self):
        self.acquisition.start()
        super().set_data_source()

    def terminate_data_source(self):
        self.acquisition.stop()

    def read_data(self):
        rows = self.acquisition.read(self.block)
        return np.column_stack([rows[name] for name in CHANNELS])

    def clear_buffer(self):
        self.acquisition.read_remaining()


class RigGeneration(BaseGeneration):
    """Generation that repeats a signal [A] until it is stopped."""

    def __init__(self, rig, signal, generation_name="rig"):
        super().__init__()
        self.generation_name, self.output = generation_name, AnalogOutput(rig, buffer_s=0.5)
        self.parts = np.array_split(np.asarray(signal, float), -(-len(signal) // round(BLOCK_S * rig.stream_rate_hz)))

    def set_data_source(self):
        self.output.start()

    def generate(self):
        parts = itertools.cycle(self.parts)
        while self.is_running:
            self.output.write(next(parts))

    def terminate_data_source(self):
        self.output.stop()
