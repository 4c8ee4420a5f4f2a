# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Measure the maps that the docs show, on the mechanics, and keep their pictures: some minutes."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from impact_rig.cli.main import main

ROOT = Path(__file__).parents[1]
MAPS = ("gap_frequency", "coexistence")
"""Files in config/maps; the picture of each is docs/images/map_<name>.png."""


def draw() -> int:
    """Measure and draw; return the exit code."""
    for name in MAPS:
        with tempfile.TemporaryDirectory() as directory:
            output = Path(directory, "map")
            code = main(["map", str(ROOT / "config" / "maps" / f"{name}.yaml"), "--output", str(output)])
            if code:
                return code
            shutil.copy(output / "figures" / "map_reset.png", ROOT / "docs" / "images" / f"map_{name}.png")
    return 0


if __name__ == "__main__":
    sys.exit(draw())
