# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`python -m impact_rig.kernels`: build the library, unless it is there and of these sources."""

from __future__ import annotations

from impact_rig.kernels import library
from impact_rig.kernels.build import build

if library() is None:
    build()
