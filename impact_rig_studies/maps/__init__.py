# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Maps: DT, regime and impacts over two or three parameters, measured on the mechanics alone, and the best gap.

No instruments, no analysis of scans, no noise: what is measured here is what the mechanics do, and named so.
"""
