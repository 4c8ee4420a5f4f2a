# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Example (c), the analysis: a transmissibility and its phase from a recorded run, with a lock-in of its own."""

import sys

import numpy as np
from lockin import LockIn

from impact_rig.recording import open_run


def analyse(path, correct_lag=True):
    """Return {name: value} of the last window of a run."""
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
