# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""Parameter values as rclpy takes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rclpy.parameter import Parameter

from impact_rig.client.processes import ParameterValue


def ros_parameters(values: Mapping[str, ParameterValue]) -> list[Parameter]:
    """Return parameters by name and value; rclpy knows no sequences but lists, tuples and arrays."""
    return [
        Parameter(name, value=value if isinstance(value, str) or not isinstance(value, Sequence) else list(value))
        for name, value in values.items()
    ]
