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
"""The paper's 60 points without ROS, on all cores, from the command line to the last table."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

FILE = Path(__file__).parents[1] / "config" / "paper.yaml"
STUDY = "curves"


def run() -> dict[str, float]:
    """Measure with a warm cache: the first campaign, of the same points, compiles."""
    return {"campaign_wall_s": [_campaign() for _ in range(2)][-1]}


def _campaign() -> float:
    script = "import sys; from impact_rig.cli import main; sys.exit(main())"
    with tempfile.TemporaryDirectory(prefix="impact_rig_bench_") as scratch:
        began = time.monotonic()
        output = str(Path(scratch) / "paper")
        command = [sys.executable, "-c", script, "campaign", str(FILE), "--only", STUDY, "--output", output]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        return time.monotonic() - began
