# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Commands of the studies, each with what it prints."""
