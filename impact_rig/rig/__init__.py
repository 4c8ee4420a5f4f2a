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
"""Virtual rig without ROS: physics and instruments on one time base, with commands and a journal of all inputs."""

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.rig.core import Block, Rig
    from impact_rig.rig.journal import InputKind, Journal, takes_effect
    from impact_rig.rig.resimulation import resimulate

__getattr__ = lazily(  # `rig.config` works without compiled code
    __name__,
    Block="core",
    takes_effect="journal",
    Rig="core",
    Journal="journal",
    InputKind="journal",
    resimulate="resimulation",
)

__all__ = ["Block", "InputKind", "Journal", "Rig", "resimulate", "takes_effect"]
