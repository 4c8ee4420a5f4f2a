# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`python -m impact_rig.kernels [FOLDER]`: build the library, next to the sources unless it is there and of them."""

from __future__ import annotations

import sys
from pathlib import Path

from impact_rig.kernels import library
from impact_rig.kernels.build import FOLDER, build

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
if folder != FOLDER or library() is None:
    build(folder)
