# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The ROS 2 nodes: they publish what the rig, the analysis and the recorder compute, and decide nothing themselves.

Of the layers below, none imports rclpy.
"""
