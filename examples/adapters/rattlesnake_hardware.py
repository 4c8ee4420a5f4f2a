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
"""The rig as hardware of Rattlesnake, in its acquisition and output processes.

Call `replace_state_space()` before Rattlesnake starts, and choose the hardware "State Space Integration". Its hardware
file is the namespace of a rig that runs in real time with `drive.waveform: stream`. `physical_channel` of a channel is
one of accelerometer, laser, base or current.
"""

import sys
from types import SimpleNamespace

import numpy as np

from impact_rig.driver import Acquisition, AnalogOutput, RosRig

BLOCKS_AHEAD = 3  # written ahead of what is played


class RigAcquisition:
    """Acquisition with the methods that Rattlesnake calls."""

    def set_up_data_acquisition_parameters_and_channels(self, test_data, channel_data):
        rig = RosRig({"daq.rate_hz": int(test_data.sample_rate)}, namespace=test_data.hardware_file)
        self.acquisition, self.count, self.close = Acquisition(rig), test_data.samples_per_read, rig.close
        self.names = [channel.physical_channel for channel in channel_data]
        self.delay = BLOCKS_AHEAD * test_data.samples_per_write
        self.start, self.stop = self.acquisition.start, self.acquisition.stop

    def read(self):
        return self._columns(self.acquisition.read(self.count))

    def read_remaining(self):
        return self._columns(self.acquisition.read_remaining())

    def get_acquisition_delay(self):
        return self.delay

    def _columns(self, rows):
        return np.array([rows[name] for name in self.names], float)


class RigOutput:
    """Output of one drive with the methods that Rattlesnake calls."""

    def set_up_data_output_parameters_and_channels(self, test_data, channel_data):
        rate_hz, self.count = int(test_data.output_sample_rate), test_data.samples_per_write
        rig = RosRig({"drive.stream_rate_hz": rate_hz}, namespace=test_data.hardware_file)
        self.output = AnalogOutput(rig, buffer_s=BLOCKS_AHEAD * self.count / rate_hz)
        self.start, self.stop, self.close = self.output.start, self.output.stop, rig.close

    def write(self, data):
        self.output.write(data[0])

    def ready_for_new_output(self):
        return self.output.ready(self.count)


def replace_state_space():
    """Let Rattlesnake's processes load this hardware instead of their state space model."""
    sys.modules["components.state_space_virtual_hardware"] = SimpleNamespace(
        StateSpaceAcquisition=lambda *_: RigAcquisition(), StateSpaceOutput=lambda *_: RigOutput()
    )
