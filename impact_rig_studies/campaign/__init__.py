# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Measuring what the paper measured: cases, summaries and comparisons. Knows no ROS."""
