# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What many measurements say together: constants identified, motions predicted and followed."""
