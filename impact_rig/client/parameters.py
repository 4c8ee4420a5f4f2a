# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
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
