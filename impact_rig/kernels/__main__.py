# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`python -m impact_rig.kernels [FOLDER]`: build the library, unless one of these sources is next to them.

With a folder it is put there, built or copied.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from impact_rig.kernels import library
from impact_rig.kernels.build import FOLDER, HEADER, OUTPUT, build

folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
if library() is None:
    build(folder)
elif folder != FOLDER:
    folder.mkdir(parents=True, exist_ok=True)
    for name in (OUTPUT, HEADER):
        shutil.copy(FOLDER / name, folder)
