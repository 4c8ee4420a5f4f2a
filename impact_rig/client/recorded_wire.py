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
"""Wire to a rig in this process that records what is fed and what the rig publishes."""

from __future__ import annotations

import numpy as np

from impact_rig import topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.client.hardware import InProcess
from impact_rig.rig import Block, Rig
from impact_rig.runs.in_process import RigRecorder
from impact_rig.simtime import NS_PER_S

DRIVEN = (topics.WAVEFORM, topics.STREAM)  # of a rig that is driven by a stream


class RecordedInProcess(InProcess):
    """A wire to a rig in this process that is recorded."""

    def __init__(self, rig: Rig, recorder: RigRecorder) -> None:
        super().__init__(rig)
        self._recorder = recorder

    def feed(self, first: int, samples: np.ndarray) -> None:
        """Feed the rig, and write what it was fed."""
        rows = np.zeros(len(samples), WAVEFORM)
        rows["value"] = samples
        self._recorder.write(topics.WAVEFORM, Table(first * NS_PER_S // self.rate_hz + self.rig.start_ns, rows))
        super().feed(first, samples)

    def advance(self) -> Block:
        """Advance the rig by one block, and write it."""
        block = super().advance()
        self._recorder.block(block)
        self._recorder.write(topics.STREAM, self.rig.stream_state())
        return block
