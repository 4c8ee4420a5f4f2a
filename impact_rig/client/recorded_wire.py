# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
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
