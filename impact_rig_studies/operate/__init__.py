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
"""Operators of a rig: they set the drive, wait until the drive is applied and the response has settled, and measure.

`stepped_sine` and `phase_lock` decide the next setpoint (frequency and current), without access to a rig or ROS.
`operator` applies the setpoint and passes events of the rig to them. It runs in a loop that drives a rig of
`impact_rig.driver`, or in the callbacks of a node.
"""
