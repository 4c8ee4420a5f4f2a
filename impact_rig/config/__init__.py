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
"""Tools for configurations: sections with units, ranges and origins, and one validator for all sources of values.

`impact_rig.rig.config` combines the sections into the configuration of a rig.
"""

from impact_rig.config.fields import FieldInfo, Origin
from impact_rig.config.sections import Barriers, Daq, Drive, Output, Pluck, Shaker, Sphere, Step, Structure, Time
from impact_rig.config.tree import Tree

__all__ = [
    "Barriers", "Daq", "Drive", "FieldInfo", "Origin", "Output", "Pluck", "Shaker", "Sphere", "Step", "Structure",
    "Time", "Tree",
]  # fmt: skip
