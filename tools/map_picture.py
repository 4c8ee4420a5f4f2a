# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
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
