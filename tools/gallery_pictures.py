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
"""Pictures of the gallery: both campaigns are measured if runs/ lacks them, a quarter of an hour."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from impact_rig.cli.main import main

ROOT = Path(__file__).parents[1]
IMAGES = ROOT / "docs" / "images"
SHOWN = {
    "config/paper.yaml": ("fig7_all_gaps", "amplitudes", "study_gap", "regimes", "trace_gap_10mm", "phase_gap_10mm"),
    "config/campaigns/beyond.yaml": (
        "study_laws",
        "study_restitution",
        "study_mass",
        "study_amplitude",
        "study_hysteresis",
    ),
}
"""Figures of each campaign's report."""


def draw() -> int:
    """Measure, write both reports and copy their figures; return the exit code."""
    for file, names in SHOWN.items():
        directory = ROOT / "runs" / f"campaign_{Path(file).stem}"
        code = main(["campaign", str(ROOT / file), "--output", str(directory)]) or main(["report", str(directory)])
        if code:
            return code
        for name in names:
            shutil.copy(directory / "figures" / f"{name}.png", IMAGES / f"gallery_{name}.png")
    return 0


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    sys.exit(draw())
