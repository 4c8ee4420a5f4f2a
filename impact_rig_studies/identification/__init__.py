# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""From measurements to the constants of the rig, and what the measurements cannot tell."""
