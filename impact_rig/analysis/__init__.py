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
"""Analysis of scans, live or recorded: transmissibility with its uncertainty, impacts, frequency responses.

The input is what a real rig also provides: scans, `daq/info` (calibration), `shaker/applied` (drive) and the operator's
label of the gap. Nothing here imports ROS, the physics or the instruments, so the same code analyses live, recorded and
imported data. Each module has one subject: `sine` (IEEE 1057 fits), `cycles` (the fit of each drive cycle),
`transmissibility`, `settling`, `tracker` (transmissibility of a stream), `impacts`, `frf`, `health` (plausibility of
channels). Import the module you need: this package imports none of them by itself.
"""
