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
"""Operators: set the drive, wait until it is applied and settled, measure, and set again. No rig of their own, no ROS.

`stepped_sine` decides what comes next; `operator` is the loop that does it on a rig of `impact_rig.driver`, in this
process or behind topics, or from a node's callbacks.
"""
