# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Measure the map of gap and frequency on the mechanics, and keep its picture for the gallery: some minutes."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from impact_rig.cli.main import main

ROOT = Path(__file__).parents[1]
PLAN = ROOT / "config" / "maps" / "gap_frequency.yaml"
PICTURE = ROOT / "docs" / "images" / "map_gap_frequency.png"


def draw() -> int:
    """Measure and draw; return the exit code."""
    with tempfile.TemporaryDirectory() as directory:
        output = Path(directory, "map")
        code = main(["map", str(PLAN), "--output", str(output)])
        if not code:
            shutil.copy(output / "figures" / "map_reset.png", PICTURE)
        return code


if __name__ == "__main__":
    sys.exit(draw())
