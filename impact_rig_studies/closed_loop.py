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
"""Closed-loop tests of a rig in this process: amplitudes held, resonances locked, backbones."""

from __future__ import annotations

from collections.abc import Mapping

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import joined
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.campaign.job import Job, ProcessApparatus
from impact_rig_studies.operate.operator import PatientApparatus, operate
from impact_rig_studies.operate.phase_lock import Look, PhasorMeter
from impact_rig_studies.operate.stepped_sine import ControlledSine, HoldPlan, Setpoint

BLOCKS_PER_S = 20  # blocks of the rig in a loop: rig time passes in steps of 50 ms


@attrs.frozen(eq=False)
class HeldSweep:
    """A controlled sine that ended."""

    rows: NDArray[np.void]  # of `blocks.HELD`
    failure: str  # why it did not reach its end; empty otherwise


def hold(job: Job, plan: HoldPlan, apparatus: PatientApparatus | None = None) -> HeldSweep:
    """Walk through a job's points with an amplitude held; its current is what the first point begins with.

    Args:
        job: the points, and the rig.
        plan: what is held.
        apparatus: that was prepared for the job; None: a rig in this process.

    Raises:
        ImpactRigError: the rig refused.
    """
    apparatus, sweep = apparatus or ProcessApparatus(job), ControlledSine(job.plan(), plan)
    operate(sweep, apparatus)
    return HeldSweep(sweep.held, sweep.reason)


def with_short_blocks(config: RigConfig) -> RigConfig:
    """Return the rig with the blocks of a loop."""
    return from_flat(config, {"daq.block_scans": max(1, config.daq.rate_hz // BLOCKS_PER_S)})


class ProcessLoop:
    """A `LoopApparatus` in this process."""

    def __init__(self, config: RigConfig) -> None:
        self._rig = Rig(with_short_blocks(config))
        self._meter = PhasorMeter(self._rig.info().rows)
        self._frequency_hz = self._rig.frequency_hz

    def now_ns(self) -> int:
        """Return the rig time since the reset."""
        return self._rig.next_block_ns - self._rig.start_ns

    def set(self, setpoint: Setpoint) -> None:
        """Command frequency, then current, where they are new."""
        rig = self._rig
        if rig.latched is not None:
            return
        if setpoint.frequency_hz != rig.frequency_hz:
            rig.accept(frequency_hz=setpoint.frequency_hz)
        if setpoint.current_a != rig.target_amplitude:
            rig.accept(amplitude=setpoint.current_a)
        rig.take_applied()
        self._frequency_hz = setpoint.frequency_hz

    def change(self, values: Mapping[str, object]) -> None:
        """Change the configuration under way, such as the gap."""
        self._rig.configure(values)
        self._meter = PhasorMeter(self._rig.info().rows)

    def look(self, seconds: float) -> Look | str:
        """Let rig time pass and return what the rig did."""
        blocks = max(1, round(seconds * BLOCKS_PER_S))
        found = [block for _ in range(blocks) for block in self._rig.advance(self._rig.block_end_ns(1))]
        self._rig.take_journal()
        if self._rig.latched is not None:
            return f"the rig tripped: {self._rig.latched}"
        rows = joined([block.scan.rows for block in found])
        look = self._meter.look(rows, self._frequency_hz, self.now_ns())
        return look or f"{len(rows)} scans are too few to look at"
