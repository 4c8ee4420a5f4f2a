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
"""Example (c), the analysis: a transmissibility and its phase from a recorded run, with a lock-in of its own."""

import sys

import numpy as np
from lockin import LockIn

from impact_rig.recording import open_run


def analyse(path, correct_lag=True):
    """Return the number of windows and gaps in a run, and DT and phase [degrees] of the last window, by name."""
    with open_run(path) as run:
        info = next(run.tables("daq/info")).rows
        drive = [table.rows[-1] for table in run.tables("shaker/applied")][-1]
        lockin = LockIn(float(drive["frequency"]), float(info["rate"][0]))
        ratios = [ratio for table in run.tables("daq/scan") for ratio in lockin.feed(table.stamp_ns, table.rows)]
    omega = 2 * np.pi * lockin.frequency_hz
    lag = {row["name"].decode(): row["lag"] + row["skew"] for row in info}
    ratio = ratios[-1] * np.exp(1j * omega * (lag["laser"] - lag["base"]) * correct_lag)
    return {
        "windows": len(ratios),
        "transmissibility": abs(ratio),
        "phase_deg": np.degrees(np.angle(ratio)),
        "gaps": lockin.gaps,
    }


if __name__ == "__main__":
    for key, value in analyse(sys.argv[1]).items():
        print(f"{key}: {value:.6g}")
