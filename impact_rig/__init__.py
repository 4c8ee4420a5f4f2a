# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""impact_rig: the test rig of an impact damper as virtual hardware for ROS 2.

Importing this package imports neither rclpy nor numba; see `docs/` for the interface and the physics.
"""

__version__ = "0.1.0"
