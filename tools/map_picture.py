# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Pictures of the maps and the dynamics in the docs: measured on the mechanics and drawn, some minutes.

`python -m tools.map_picture dynamics` makes only the pictures whose names begin so. Their results are stored in
build/pictures and used again; remove that folder to measure everything again.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from impact_rig.cli.main import main

ROOT = Path(__file__).parents[1]
PICTURES = {
    ("map", "maps/gap_frequency"): ("map_reset", "map_gap_frequency"),
    ("map", "maps/coexistence"): ("map_reset", "map_coexistence"),
    **{
        ("dynamics", kind, "dynamics/nominal"): (f"dynamics_{kind}", f"dynamics_{kind}")
        for kind in ("section", "bifurcation", "continue", "exponent")
    },
    **{
        ("dynamics", kind, "dynamics/two_motions"): (f"dynamics_{kind}", f"dynamics_{kind}")
        for kind in ("basin", "orbit")
    },
    ("dynamics", "continue", "dynamics/current"): ("dynamics_continue", "dynamics_current"),
}
"""Command and file in config/ -> the picture that it draws, and the picture's name in docs/images."""
RESULTS = ROOT / "build" / "pictures"  # results of each picture, in a folder with the picture's name


def draw(beginning: str) -> int:
    """Measure and draw the pictures whose names begin with a text; return the exit code."""
    for words, (picture, name) in PICTURES.items():
        if not name.startswith(beginning):
            continue
        output, file = RESULTS / name, str(ROOT / "config" / f"{words[-1]}.yaml")
        output.mkdir(parents=True, exist_ok=True)
        code = main([*words[:-1], file, "--output", str(output), "--format", "png"])
        if code:
            return code
        shutil.copy(output / "figures" / f"{picture}.png", ROOT / "docs" / "images" / f"{name}.png")
    return 0


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("beginning", nargs="?", default="", help="beginning of the pictures' names (default: all)")
    sys.exit(draw(parser.parse_args().beginning))
