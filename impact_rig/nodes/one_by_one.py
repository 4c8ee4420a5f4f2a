# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The service `set_parameters`: one after the other as ROS has it, but in an order that works where there is one.

A file of parameters, as `ros2 param load` sends it, comes sorted by name: a new drive frequency comes before the limit
of the shaker that allows it. What is refused at first is tried again as long as another value has been taken.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any  # rclpy messages

from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

from impact_rig.nodes.guard import describe

Attempt = Callable[[list[Parameter]], SetParametersResult]
"""Sets some parameters together, or says why not."""


def set_one_by_one(messages: list[Any], attempt: Attempt) -> list[SetParametersResult]:
    """Set parameters and return a result for each, in their order; `attempt` may be asked several times."""
    results: list[SetParametersResult] = []
    refused: dict[int, Parameter] = {}
    for number, message in enumerate(messages):
        try:
            parameter = Parameter.from_parameter_msg(message)
        except Exception as error:  # a type that does not exist raises in rclpy
            results.append(SetParametersResult(successful=False, reason=describe(error)))
            continue
        results.append(attempt([parameter]))
        if not results[number].successful:
            refused[number] = parameter
    progress = any(result.successful for result in results)
    while refused and progress:
        again = {number: attempt([parameter]) for number, parameter in refused.items()}
        progress = any(result.successful for result in again.values())
        for number, result in again.items():
            results[number] = result
            if result.successful:
                del refused[number]
    return results
