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
"""Measurement of a campaign's jobs through ROS: rig, analysis and recorder are node processes, in lockstep.

The results are bit for bit equal to those measured in one process without ROS. Before every job the rig is configured
and the analysis activated again, so both start in the same state as new processes.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Generator, Sequence
from pathlib import Path

from impact_rig.driver.ros_rig import RosRig
from impact_rig.system import files
from impact_rig_studies.campaign.job import TRACED, Job, Outcome, run_job
from impact_rig_studies.campaign.run import Runner
from impact_rig_studies.operate.stepped_sine import SteppedSine

Watch = Callable[[Job, SteppedSine | None], None]
"""Callback for the progress of a job, which receives the job and its sweep.

It is first called with None, before the rig is prepared, then with the sweep at its start and after each measurement.
"""


def run_name(job: Job) -> str:
    """Return the directory name of a job's recording: gap, frequencies and key, as in `gap4mm_9.1Hz_<key>`."""
    case = job.describe().replace(", ", "_").replace(" ", "")
    return f"{case}_{job.key}"


def ros_runner(
    logs: Path,
    runs: Path | None = None,
    name: Callable[[Job], str] = run_name,
    watch: Watch = lambda _job, _sweep: None,
) -> Runner:
    """Return a function that measures jobs with a rig, an analysis and a recorder running as ROS node processes.

    The processes start when the first job is requested, and end after the last. Jobs that differ in scan rate or block
    length need different processes. Such jobs are measured in groups, so the order of the results can differ from the
    order of the jobs.

    Args:
        logs: directory in which a folder `logs` is created for the logs of the processes.
        runs: directory in which every job is recorded as one run; None means no recording.
        name: function that returns the name of a job's run, a directory in `runs`.
        watch: callback for the progress of each job.
    """

    def run(jobs: Sequence[Job]) -> Generator[tuple[Job, Outcome], None, None]:
        if runs is not None:
            with files.translate_errors(f"cannot record into {runs}"):
                files.make_folder(runs)
        # rate and block length of a rig node are fixed at its start
        for _, group in itertools.groupby(sorted(jobs, key=_fixed), key=_fixed):
            yield from _run_all(list(group))

    def _run_all(jobs: Sequence[Job]) -> Generator[tuple[Job, Outcome], None, None]:
        rate_hz, block_scans = _fixed(jobs[0])
        fixed = {"daq.rate_hz": rate_hz, "daq.block_scans": block_scans}
        with RosRig(fixed, directory=logs, analysis={}, also=TRACED) as rig:

            def start(job: Job) -> RosRig:
                return rig.restart(job.config(), job.labelled_settings(), None if runs is None else runs / name(job))

            for job in jobs:
                watch(job, None)
                outcome = run_job(job, start, functools.partial(watch, job))
                rig.stop_recording()
                yield job, outcome

    return run


def _fixed(job: Job) -> tuple[int, int]:
    config = job.config()
    return config.daq.rate_hz, config.daq.block_scans
