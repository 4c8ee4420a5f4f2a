# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The one style of all drawings: colours by meaning, type and lines, legends, light and dark."""
