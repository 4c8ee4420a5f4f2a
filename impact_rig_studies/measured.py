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
"""Conversion of imported runs into a campaign: one point per settled gap and frequency, and the calibration."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import DAQ_INFO
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, load_config
from impact_rig.rig.gaps import case_of
from impact_rig.runs import reanalysis
from impact_rig.runs.excerpts import calibration_rows
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
from impact_rig_studies.importing.store import estimated

STUDY = "measured"
# largest difference of equal frequencies and gaps: in each file they were measured or typed with other digits
SAME_HZ, SAME_M = 0.002, 1e-9
SAME_RATE = 1e-3  # largest relative difference of equal scan rates that were estimated from times of few digits
STATED = tuple(name for name in DAQ_INFO.names or () if name not in ("name", "since_start"))
"""Columns of `daq/info` that must be the same in all runs of a campaign."""
SHOWN = 3  # largest number of points listed in the message that no point settled


def make_campaign(runs: Sequence[Path], directory: Path, config: Path | None = None) -> tuple[Finished, list[str]]:
    """Write a campaign from imported runs; return it, and a text for each point that is left out as not settled.

    Properties of the instruments that a user or certificate states must be the same in all runs. Properties that the
    import estimated from the data may differ. A stated value takes precedence over an estimated value. Of estimated
    values, that of the first run counts, or the coarsest resolution. Scan rates may differ only by `SAME_RATE`. If a
    run measured a point several times, the last settled measurement counts.

    Args:
        runs: imported runs of one rig, with the same instruments.
        directory: directory of the campaign to write, which may contain the runs.
        config: known properties of the rig (sphere, contact law); None means the default rig.

    Raises:
        ConfigError: the gap of a settled measurement is unknown, two runs measured the same point, or no run has a
            settled measurement.
        RecordingError: the directory cannot be written or already contains a campaign, or the calibrations of the
            runs differ.
    """
    if (directory / CAMPAIGN_FILE).exists():
        raise RecordingError(f"{directory} holds a campaign already; nothing is overwritten: choose another directory")
    found: dict[tuple[float, float], tuple[Path, NDArray[np.void]]] = {}
    left_out: list[str] = []
    sensors: _Sensors | None = None
    currents, seconds = [], 0.0
    for path in runs:
        with open_run(path) as run:
            tables = reanalysis.measurements(reanalysis.analyze(run))
            own = _Sensors(path.name, calibration_rows(run).copy(), estimated(run.attachments()))
            seconds += (run.end_ns - run.start_ns) / 1e9
        sensors = own if sensors is None else sensors.joined(own)
        left_out += (f"{path.name}, {point}" for point in _unsettled(reanalysis.rows(tables)))
        for row in reanalysis.newest_settled(tables):
            if math.isnan(row["gap"]):
                raise ConfigError(
                    f"{path.name}: its gap is unknown: state it (--gap 6mm, gap_mm in --mapping, or in the "
                    "file's name, such as gap_6mm.csv)"
                )
            gap = _known(float(row["gap"]), {gap for gap, _ in found}, SAME_M)
            frequency = _known(float(row["frequency"]), {frequency for _, frequency in found}, SAME_HZ)
            other, _ = found.setdefault((gap, frequency), (path, row))
            if other != path:
                raise ConfigError(
                    f"{path.name}: {case_of(gap)} at {frequency:g} Hz is measured in {other.name}, too, and a "
                    "campaign has one measurement of each point: import one of the two, or each without --campaign"
                )
            found[gap, frequency] = path, row
            currents.append(float(row["current_amplitude"] if row["current_amplitude"] > 0.0 else 1.0))
    if sensors is None or not found:
        raise ConfigError(
            f"no file contains a settled measurement: {'; '.join(left_out[:SHOWN])}; import the files without "
            "--campaign, and examine the runs with impact-rig analyze"
        )
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
    campaign = load_campaign(directory / CAMPAIGN_FILE, resolved=base)
    store = prepare(campaign, directory, "import")
    files.write_text(directory / CALIBRATION_FILE, json.dumps([_plain(row) for row in sensors.info], indent=1))
    for job in unique_jobs(campaign.planned()):
        gap, frequency = job.gap_m, job.frequencies_hz[0]
        if (gap, frequency) in found:
            _, point = found[gap, frequency]
            point["gap"], point["frequency"] = gap, frequency
            store.put(job, Outcome(rows=point.reshape(1).copy()))
    done = finished(campaign, directory)
    write_results(done, seconds)
    return done, left_out


def _unsettled(rows: NDArray[np.void]) -> list[str]:
    """Return a text with gap, frequency and last status for each point without a settled measurement.

    `rows` contains the measurements. If it is empty, the only text is "nothing was measured".
    """
    points = [case_of(gap) + (f" at {hz:.4g} Hz" if hz > 0.0 else "") for gap, hz in rows[["gap", "frequency"]]]
    settled = {point for point, row in zip(points, rows, strict=True) if row["settled"] == 1.0}
    last = dict(zip(points, rows["status"].astype(str), strict=True))
    unsettled = [f"{point}: {status}" for point, status in last.items() if point not in settled]
    return unsettled if points else ["nothing was measured"]


def _known(value: float, known: set[float], same: float) -> float:
    """Return the smallest number in `known` that differs from `value` by at most `same`; otherwise `value`, rounded.

    The rounding error is smaller than `same`.
    """
    near = (one for one in sorted(known) if abs(one - value) <= same)
    return next(near, round(value, math.ceil(-math.log10(same))))


@attrs.frozen(eq=False)
class _Sensors:
    """Calibration of the instruments, common to one or several runs."""

    name: str  # of the first run, for messages
    info: NDArray[np.void]  # rows of `daq/info`
    estimated: dict[str, tuple[str, ...]]  # columns whose values the import estimated from the data, by channel

    def joined(self, other: _Sensors) -> _Sensors:
        """Return the common calibration of these runs and of the run `other`.

        Stated values must be equal. A stated value replaces an estimated value. Of two estimated values the first
        counts, or the coarser resolution. If a scan rate is estimated, scan rates may differ by at most `SAME_RATE`.

        Raises:
            RecordingError: the channels or a stated property differ; the message names channel, column and both values.
        """
        channels, others = (one.info["name"].astype(str).tolist() for one in (self, other))
        if channels != others:
            raise self._differs(other, "the list of channels", ", ".join(others), ", ".join(channels))
        info, estimated = self.info.copy(), {}
        for row, new in zip(info, other.info, strict=True):
            channel = row["name"].decode()
            ours, theirs = (one.estimated.get(channel, ()) for one in (self, other))
            for column in STATED:
                old, own = row[column], new[column]
                unsure = (column in ours, column in theirs)
                if any(unsure) and (column != "rate" or abs(own - old) <= SAME_RATE * old):
                    if all(unsure):
                        row[column] = max(old, own) if column == "resolution" else old
                    elif unsure[0]:
                        row[column] = own
                elif _text(own) != _text(old):
                    raise self._differs(other, f"{column} of {channel}", _text(own), _text(old))
            estimated[channel] = tuple(column for column in ours if column in theirs)
        return _Sensors(self.name, info, estimated)

    def _differs(self, other: _Sensors, what: str, value: str, first: str) -> RecordingError:
        return RecordingError(
            f"{other.name}: {what} is {value}, but {first} in {self.name}: all runs of a campaign must have the same "
            f"instruments, so import {other.name} into a campaign of its own"
        )


def _text(cell: bytes | float) -> str:
    return cell.decode() if isinstance(cell, bytes) else repr(float(cell) + 0.0)


def _plain(row: np.void) -> dict[str, object]:
    cells = zip(DAQ_INFO.names or (), row.tolist(), strict=True)
    return {name: cell.decode() if isinstance(cell, bytes) else float(cell) for name, cell in cells}
