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
"""Directory of a campaign: its files, and the results derived from them. `tasks.measure` measures missing jobs.

| file | content |
|---|---|
| `campaign.yaml` | the campaign file as it was given |
| `configuration.yaml` | the rig that all studies start with, complete |
| `provenance.json` | versions, machine, and how the jobs were measured |
| `points/` | one file per job, and its trace |
| `points.csv` | every point of every study |
| `summary.json` | figures for programs |
| `calibration.json` | `daq/info` of the instruments, if the points were imported and not measured on this rig |
"""

from __future__ import annotations

import json
import platform
import sys
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import kernels
from impact_rig.analysis.calibration import Calibration
from impact_rig.arithmetic import ARITHMETIC
from impact_rig.blocks import DAQ_INFO
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.instruments.chain import Chain
from impact_rig.rig.config import dump, load_config
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.system import files, machine
from impact_rig_studies.campaign import statements
from impact_rig_studies.campaign.job import Job, Outcome
from impact_rig_studies.campaign.paper import FREQUENCY_HZ, REDUCTION_PERCENT, Reductions
from impact_rig_studies.campaign.plan import Campaign, Planned, load_campaign
from impact_rig_studies.campaign.results import Curves, Point, points_of, table, write_summary
from impact_rig_studies.campaign.statements import Verdict
from impact_rig_studies.campaign.store import FOLDER, Store, code_fingerprint
from impact_rig_studies.campaign.tasks import CONFIGURATION_FILE, refuse_other_results

CAMPAIGN_FILE, PROVENANCE_FILE = "campaign.yaml", "provenance.json"
CSV_FILE, CALIBRATION_FILE = "points.csv", "calibration.json"
MAX_CALIBRATION_BYTES = 100_000
LIBRARIES = ("numpy", "scipy", "numba", "llvmlite", "attrs", "matplotlib")

Runner = Callable[[Sequence[Job]], Generator[tuple[Job, Outcome], None, None]]
"""Function that measures jobs, in processes or through ROS: it yields each job with its outcome, in any order."""


@attrs.frozen(eq=False, kw_only=True)
class Finished:
    """Campaign with the results that are stored in its directory; it may be incomplete."""

    campaign: Campaign  # definition of the campaign
    directory: Path
    points: list[Point]  # all points of the jobs with a stored result
    outcomes: dict[str, Outcome]  # stored results, by job key

    @property
    def curves(self) -> Curves:
        """Settled points of the reference rig (the rig of the first job), by gap and frequency.

        Points of sweeps without a reset are left out.
        """
        return Curves.of(self.points)

    def verdicts(self) -> list[Verdict]:
        """Return the verdict on each of the paper's statements."""
        return statements.judge(self.curves)

    def reductions(self) -> Reductions:
        """Return the reductions of DT at 9.1 Hz for the paper's gaps.

        Gaps without a settled point are left out. There are no reductions if the point without the sphere at 9.1 Hz is
        missing or not settled.
        """
        curves = self.curves
        found = {gap: curves.at(gap, FREQUENCY_HZ) for gap in (NO_SPHERE, *REDUCTION_PERCENT)}
        return Reductions.of({gap: point.rows for gap, point in found.items() if point}, self.calibration)

    @property
    def imported(self) -> bool:
        """Return whether the directory was created by an import of measured files: it contains `calibration.json`."""
        return (self.directory / CALIBRATION_FILE).exists()

    @property
    def info(self) -> NDArray[np.void]:
        """Rows of `daq/info` that describe the instruments of the campaign.

        For an imported campaign, they are read from `calibration.json`. Otherwise, they are those of the reference rig.

        Raises:
            RecordingError: the file that contains them is damaged.
        """
        path = self.directory / CALIBRATION_FILE
        if not path.exists():
            return Chain(self.campaign.reference().config()).info()
        try:
            rows = json.loads(files.read_bytes(path, MAX_CALIBRATION_BYTES))
            names = DAQ_INFO.names or ()
            found: NDArray[np.void] = np.array([tuple(row[name] for name in names) for row in rows], DAQ_INFO)
            Calibration.from_info(found)
        except (OSError, ValueError, TypeError, KeyError, RecursionError, OverflowError) as error:
            why = f"no column {error}" if isinstance(error, KeyError) else " ".join(str(error).split())[:200]
            raise RecordingError(
                f"{path}, the stored calibration, is damaged, changed or unreadable: {why}; import the campaign again "
                "into a new directory"
            ) from error
        return found

    @property
    def calibration(self) -> Calibration:
        """Calibration of the instruments that measured the points, as their certificate states it."""
        return Calibration.from_info(self.info)

    def failed(self) -> list[Point]:
        """Return the points with a missing or unsettled measurement.

        Jobs without a stored result have no points.
        """
        return [point for point in self.points if not point.settled]


def unique_jobs(planned: Sequence[Planned]) -> list[Job]:
    """Return every job of a campaign once.

    If several studies contain a job and one of them requests traces, the returned job requests traces.
    """
    found: dict[str, Job] = {}
    for job in (one.job for one in planned):
        if job.key not in found or (job.traces and not found[job.key].traces):
            found[job.key] = job
    return list(found.values())


def prepare(campaign: Campaign, directory: Path, through: str) -> Store:
    """Create the directory of a campaign with its descriptive files, and return the store of its results.

    In a directory with results of the same rig, the descriptive files are replaced and the results kept.

    Args:
        campaign: campaign to measure.
        directory: its directory, new or with results of the same rig.
        through: how the jobs are measured, such as `process` or `import`, for `provenance.json`.

    Raises:
        RecordingError: the directory cannot be written, or contains other files, results of another rig, or imported
            points to which simulated ones would be added.
    """
    refuse_other_results(directory, "campaign", campaign.base)
    if through != "import" and (directory / CALIBRATION_FILE).exists():  # with which simulated points would be read
        raise RecordingError(
            f"{directory} holds an imported campaign, to which no simulated points can be added: choose another "
            "directory"
        )
    store = Store(directory)
    with files.translate_errors(f"cannot write {directory}"):
        files.write_text(directory / CAMPAIGN_FILE, campaign.text)
        files.write_text(directory / CONFIGURATION_FILE, dump(campaign.base))
        provenance = {
            "impact_rig": code_fingerprint(), "arithmetic": ARITHMETIC, "python": sys.version.split()[0],
            **machine.versions(LIBRARIES), "kernels": kernels.MODE,
            "machine": platform.machine(), "system": platform.platform(), "through": through,
        }  # fmt: skip
        files.write_json(directory / PROVENANCE_FILE, provenance)
    return store


def finished(campaign: Campaign, directory: Path) -> Finished:
    """Return a campaign with all results stored in its directory, even if another version of the code measured them.

    Jobs without a stored result have no points.

    Raises:
        DamagedPointError: a stored result is damaged.
    """
    planned = campaign.planned()
    store = Store(directory)
    outcomes = {job.key: outcome for job in unique_jobs(planned) if (outcome := store.get(job, as_it_is=True))}
    points = [point for one in planned if one.job.key in outcomes for point in points_of(one, outcomes[one.job.key])]
    return Finished(campaign=campaign, directory=directory, points=points, outcomes=outcomes)


def open_finished(directory: str | Path) -> Finished:
    """Read the campaign in a directory, with its stored results.

    Raises:
        ConfigError: `directory` is not the directory of a campaign, or its campaign file or configuration is invalid.
        BudgetError: the campaign file has more than `budget.POINTS` points.
        DamagedPointError: a stored result is damaged.
    """
    directory = Path(directory)
    if not (directory / CAMPAIGN_FILE).exists() or not (directory / FOLDER).is_dir():
        raise ConfigError(
            f"{directory} is not a campaign's directory: create one with `impact-rig campaign config/paper.yaml "
            "--output NEW`"
        )
    base = load_config(directory / CONFIGURATION_FILE)
    return finished(load_campaign(directory / CAMPAIGN_FILE, resolved=base), directory)


def write_results(done: Finished, wall_s: float) -> dict[str, object]:
    """Write `points.csv` and `summary.json` into the campaign's directory, and return the content of `summary.json`.

    `wall_s` is the duration of the present measurement by this machine's clock [s]. After an import, it is the length
    of the imported runs [s].
    """
    files.write_csv(done.directory / CSV_FILE, *table(done.points))
    block_scans = done.campaign.planned()[0].job.config().daq.block_scans
    return write_summary(
        done.directory,
        done.reductions(),
        {one.name: one.result for one in done.verdicts() if one.result is not None},
        lost_blocks=sum(-(-outcome.lost_scans // block_scans) for outcome in done.outcomes.values()),
        wall_s=wall_s,
        simulated_s=sum(outcome.simulated_s for outcome in done.outcomes.values()),
        seed=done.campaign.base.daq.seed,
        more={
            "title": done.campaign.title,
            "points": len(done.points),
            "failed_points": len(done.failed()),
            "written": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        },
    )
