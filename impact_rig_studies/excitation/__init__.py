# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Excitation through a stream of samples: frequency response, random control, replicated histories, shocks."""
