# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The dynamics of the model: sections, bifurcations, basins, orbits and their branches, exponents, energy per cycle.

Everything here is of the mechanics alone, with exact events and without instruments, and is named so where it is shown.
"""
