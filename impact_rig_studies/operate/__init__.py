# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The operator: sets the drive, waits until it is applied and settled, measures, notes. No rig of its own, no ROS.

`stepped_sine` is what is wanted and decides what comes next, `operator` is the loop that does it with whatever
apparatus it is given: a rig in this process, one behind topics that is stepped or runs freely, or a node's callbacks.
"""
