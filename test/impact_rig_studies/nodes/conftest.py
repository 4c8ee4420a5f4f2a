# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A user of the graph on a ROS domain of its own."""

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.ros_user import client

__all__ = ["client"]
