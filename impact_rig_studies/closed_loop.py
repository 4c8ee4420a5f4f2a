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
"""Sweeps in which a controller holds an amplitude, and rigs with blocks short enough for a control loop."""

from __future__ import annotations

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.driver import RigDriver
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.campaign.job import Job, start_local
from impact_rig_studies.operate.operator import operate
from impact_rig_studies.operate.plans import HoldPlan
from impact_rig_studies.operate.stepped_sine import ControlledSine

BLOCKS_PER_S = 20  # blocks of the rig in a loop: rig time passes in steps of 50 ms


@attrs.frozen(eq=False)
class HeldSweep:
    """Result of a sweep during which a controller held an amplitude (`hold`)."""

    rows: NDArray[np.void]  # accepted measurements, rows of `blocks.SWEEP`
    failure: str  # reason why the sweep was aborted; empty if it finished


def hold(job: Job, plan: HoldPlan, rig: RigDriver | None = None) -> HeldSweep:
    """Measure a job's points while a controller adjusts the coil current so that one amplitude keeps its target value.

    Args:
        job: rig and frequencies; the job's current is the controller's initial value at the first frequency.
        plan: held quantity (current, base or superior base), target amplitude and limits.
        rig: rig that was newly started for the job, with its analysis; None means a new one in this process.

    Raises:
        ImpactRigError: the rig rejected a command, or failed.
    """
    sweep = ControlledSine(job.plan(), plan)
    operate(sweep, rig or start_local(job))
    return HeldSweep(sweep.controlled, sweep.reason)


def with_short_blocks(config: RigConfig) -> RigConfig:
    """Return the configuration with blocks of 50 ms, so that a controller can react after each (`BLOCKS_PER_S`)."""
    return from_flat(config, {"daq.block_scans": max(1, config.daq.rate_hz // BLOCKS_PER_S)})
