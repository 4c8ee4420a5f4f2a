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
"""Cost of a minute of rig time in a test of a pipeline, including the start of Python and of the rig.

python -m benchmarks.testing
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time

import numpy as np

RIG_S = 60.0
REPEATS = 3
KINDS = ("virtual", "hosted", "processes")
DRIVE = {"drive.amplitude": 0.52, "barriers.gap_m": 0.006}


def run() -> dict[str, float]:
    """Return the wall time of each kind of rig [s], the median of some runs."""
    command = [sys.executable, "-m", "benchmarks.testing"]
    found = {}
    for kind in KINDS:
        walls = []
        for _ in range(REPEATS):
            began = time.monotonic()
            subprocess.run([*command, kind], check=True)
            walls.append(time.monotonic() - began)
        found[f"minute_{kind}_s"] = float(np.median(walls))
    return found


def minute(kind: str) -> None:
    """Run a rig for a minute of its time, with a client that takes every block."""
    if kind == "virtual":
        from impact_rig.driver.local_rig import LocalRig  # noqa: PLC0415  # loads compiled code

        blocks = []
        rig = LocalRig(DRIVE)
        rig.connect(blocks.append)
        rig.run(RIG_S)
        assert sum(len(block.rows) for block in blocks) >= RIG_S * rig.config.daq.rate_hz
        return
    from impact_rig.driver.ros_rig import RosRig  # noqa: PLC0415  # needs ROS

    with RosRig(DRIVE, hosted=kind == "hosted", record=True) as ros_rig:
        ros_rig.run(RIG_S)
        assert sum(len(table.rows) for table in ros_rig.tables()) >= RIG_S * ros_rig.config.daq.rate_hz


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("kind", nargs="?", choices=KINDS, help="kind of rig that runs once (default: measure all)")
    if chosen := parser.parse_args().kind:
        minute(chosen)
    else:
        for figure, value in run().items():
            print(f"{figure:40} {value:.4g}")
