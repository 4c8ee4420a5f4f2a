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
"""The controller of the documentation, against a rig in real time: its samples take effect."""

from velocity_feedback import VelocityFeedback

from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.nodes.rig_node import RigNode


def test_the_samples_of_the_controller_drive_the_rig():
    settings = {"drive.waveform": "stream", "sphere.present": False}
    with isolated_domain() as domain_id, Client(domain_id) as client:
        client.host(RigNode, parameter_overrides=ros_parameters(settings))
        node = client.host(VelocityFeedback)
        client.wait_active("rig")
        said = client.collect("shaker/stream")
        client.wait_until(lambda: node.sent > 10_000 and said.last().rows["playing"][0], "a second of samples")
        assert said.last().rows["refused"][0] == 0
