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
"""Source without a rig: ring buffers that a test fills, and a list of the requests."""

from __future__ import annotations

import numpy as np

from impact_rig.blocks import Table
from impact_rig.instruments.section import SCAN
from impact_rig_lab.protocol import Request
from impact_rig_lab.record import RigView
from impact_rig_lab.scope import Scope
from impact_rig_lab.state import Answer, Snapshot

RATE = 1000


class FakeSource:
    other: Scope | None = None

    def __init__(self) -> None:
        self.snapshot = Snapshot()
        self.snapshot.put(rig={"word": "at rest", "text": "", "name": ""})
        self.record = RigView()
        self.record.scope = self.scope = Scope(RATE)
        self.record.epoch = 1
        self.now_s = 0.0
        self.watchers = 0
        self.asked: list[Request] = []

    def ask(self, request: Request, answer: Answer) -> None:
        self.asked.append(request)
        answer(True, f"did {request.do}")


def scans(first: int, count: int, *, rate_hz: int = RATE, **columns: object) -> Table:
    """Block from scan `first` on; some columns are given, the others are zero."""
    rows = np.zeros(count, SCAN)
    rows["time"] = np.arange(count) / rate_hz
    for name, values in columns.items():
        rows[name] = values
    return Table(first * 10**9 // rate_hz, rows)
