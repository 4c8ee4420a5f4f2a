# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Studies with the rig: campaigns, maps, dynamics, identification, closed loops, imported measurements, reports."""
