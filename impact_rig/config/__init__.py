# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The machinery of configurations: sections with units, ranges and origins, and one validator for all ways in.

`impact_rig.rig.config` makes the rig's configuration of it.
"""

from impact_rig.config.fields import FieldInfo, Origin
from impact_rig.config.sections import Barriers, Daq, Drive, Output, Pluck, Shaker, Sphere, Step, Structure, Time
from impact_rig.config.tree import Tree

__all__ = [
    "Barriers", "Daq", "Drive", "FieldInfo", "Origin", "Output", "Pluck", "Shaker", "Sphere", "Step", "Structure",
    "Time", "Tree",
]  # fmt: skip
