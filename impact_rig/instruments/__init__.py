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
"""Instruments of the rig: sensors, conditioning, the multiplexed converter, calibration and faults; without ROS."""

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.instruments.chain import Chain
    from impact_rig.instruments.checks import ChannelCheck, check_known_input, check_polarity
    from impact_rig.instruments.fault import Fault
    from impact_rig.instruments.pieces import PiecewiseMotion

__getattr__ = lazily(  # compiled code is loaded where it is used, not where a configuration is read
    __name__,
    Chain="chain",
    ChannelCheck="checks",
    check_known_input="checks",
    check_polarity="checks",
    Fault="fault",
    PiecewiseMotion="pieces",
)

__all__ = ["Chain", "ChannelCheck", "Fault", "PiecewiseMotion", "check_known_input", "check_polarity"]
