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
"""Imported runs of one sweep as a campaign: a point for each gap and frequency that settled, and the calibration."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import DAQ_INFO
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, load_config
from impact_rig.runs import reanalysis
from impact_rig.runs.wholes import calibration_rows
from impact_rig.system import files
from impact_rig_studies.campaign.job import Outcome
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.run import (
    CALIBRATION_FILE,
    CAMPAIGN_FILE,
    Finished,
    finished,
    prepare,
    unique_jobs,
    write_results,
)

STUDY = "measured"
SAME_HZ = 0.002  # frequencies of two files that differ by less are equal: each was measured, or typed with other digits


def make_campaign(runs: Sequence[Path], directory: Path, config: Path | None = None) -> Finished:
    """Combine runs into one campaign and return it.

    Args:
        runs: runs of one rig, with the same instruments.
        directory: directory of the campaign, which may contain the runs.
        config: known properties of the rig (sphere, contact law); None means the default rig.

    Raises:
        ConfigError: a gap is unknown, or nothing was measured.
        RecordingError: it cannot be written, or the calibrations of the runs differ.
    """
    found: dict[tuple[float, float], NDArray[np.void]] = {}
    info: NDArray[np.void] | None = None
    currents, seconds = [], 0.0
    for path in runs:
        with open_run(path) as run:
            rows = reanalysis.newest_settled(reanalysis.measurements(reanalysis.analyze(run)))
            own = calibration_rows(run).copy()
            seconds += (run.end_ns - run.start_ns) / 1e9
        own["since_start"] = 0.0
        if info is not None and own.tobytes() != info.tobytes():
            raise RecordingError(
                f"{path}: its calibration differs from that of {runs[0]}: a campaign has one set of sensors"
            )
        info = own
        for row in rows:
            if math.isnan(row["gap"]):
                raise ConfigError(
                    f"{path}: its gap is unknown: state it (--gap, in the mapping, or by the file's name)"
                )
            found[float(row["gap"]), _known(float(row["frequency"]), found)] = row
            currents.append(float(row["current_amplitude"] if row["current_amplitude"] > 0.0 else 1.0))
    if info is None or not found:
        raise ConfigError("no run contains a measurement: `impact-rig analyze RUN --all` shows why")
    base = load_config(config) if config else RigConfig()
    text = json.dumps({
        "title": directory.name,
        "studies": {STUDY: {
            "frequencies_hz": sorted({frequency for _, frequency in found}),
            "gaps_m": [gap or "none" for gap in sorted({gap for gap, _ in found})],
            "currents_a": float(np.median(currents)),
        }},
    }, indent=1)  # fmt: skip
    files.make_folder(directory)
    files.write_text(directory / CAMPAIGN_FILE, text)
    try:
        campaign = load_campaign(directory / CAMPAIGN_FILE, resolved=base)
    except ConfigError:
        (directory / CAMPAIGN_FILE).unlink()  # otherwise the directory would look like a campaign
        raise
    store = prepare(campaign, directory, "import")
    files.write_text(directory / CALIBRATION_FILE, json.dumps([_plain(row) for row in info], indent=1))
    for job in unique_jobs(campaign.planned()):
        point = found.get((job.gap_m, job.frequencies_hz[0]))
        if point is not None:
            point["frequency"] = job.frequencies_hz[0]
            store.put(job, Outcome(rows=point.reshape(1).copy()))
    done = finished(campaign, directory)
    write_results(done, seconds)
    return done


def _known(frequency_hz: float, found: dict[tuple[float, float], NDArray[np.void]]) -> float:
    """Return the frequency of an existing point that is the same, or this one, rounded to a millihertz."""
    near = (known for _, known in found if abs(known - frequency_hz) <= SAME_HZ)
    return next(near, round(float(frequency_hz), 3))


def _plain(row: np.void) -> dict[str, object]:
    cells = zip(DAQ_INFO.names or (), row.tolist(), strict=True)
    return {name: cell.decode() if isinstance(cell, bytes) else float(cell) for name, cell in cells}
