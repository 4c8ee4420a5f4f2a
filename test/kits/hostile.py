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
"""Attacks on a node: number of cases, values of any kind, and the processes under attack.

By default, a short sample is tested; IMPACT_RIG_HOSTILE=2000 tests this number of cases of each kind.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from impact_rig.client import Client, Processes
from impact_rig.rig import config

CASES = int(os.environ.get("IMPACT_RIG_HOSTILE", "120"))
FIELDS = {name: (about, default) for name, about, default in config.fields()}

cases = settings(max_examples=CASES, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])

texts = st.text(st.characters(blacklist_categories=["Cs"], blacklist_characters="\0"), max_size=40)
"""Texts that a ROS string can carry: no surrogates, no NUL."""


class Attacked:
    """Three node processes in a namespace, and the client that attacks them."""

    def __init__(self, domain_id: int, directory: Path) -> None:
        self.processes = Processes(domain_id, directory, namespace="/target")
        self.processes.start("rig", {"time.mode": "realtime", "daq.seed": 4})
        self.processes.start("analysis")
        self.processes.start("recorder", {"record": False})
        self.directory, self.runs = directory, list[Path]()
        self.client = Client(domain_id, "/target", self.processes)
        self.client.wait_active("rig", "analysis", "recorder")
        self.scans = self.client.collect("daq/scan")
        self.monitors = [self.client.collect(name) for name in ("accelerometer", "laser", "base_displacement")]

    def record(self) -> None:
        """Start a run, whatever the parameters of the recorder are by now."""
        run = self.directory / f"run{len(self.runs)}"
        self.client.set_parameters("recorder", {"directory": str(run.parent), "name": run.name, "max_file_mb": 0})
        assert self.client.trigger("recorder/start") == str(run)
        self.runs.append(run)

    def refused(self, node: str, reason: str) -> int:
        return int(self.client.figures(node).get(f"refused.{reason}", "0"))

    def refused_before(self, node: str, reason: str) -> int:
        """Return the count when everything that was sent before has been reported."""
        self.quiet()
        return self.refused(node, reason)

    def await_refusals(self, node: str, reason: str, count: int) -> None:
        """Wait until diagnostics have counted `count` rejections, and no more; check that they explain the last one."""
        what = f"{count} refusals ({reason})"
        self.client.wait_until(lambda: self.refused(node, reason) >= count, what)
        assert self.refused(node, reason) == count
        assert count == 0 or self.client.figures(node)[f"last_refused.{reason}"]

    def assert_sound(self) -> None:
        """Assert that new blocks arrive, finite and without a gap, and that every node answers without an exception."""
        for collector in (self.scans, *self.monitors):
            collector.clear()
        self.client.wait_until(lambda: len(self.scans) >= 10 and all(self.monitors), "new blocks")
        rows = self.scans.rows()
        assert all(np.isfinite(rows[name]).all() for name in rows.dtype.names)
        assert self.scans.lost() == 0
        imu, laser, base = (collector.messages for collector in self.monitors)
        assert all(math.isfinite(message.linear_acceleration.x) for message in imu)
        assert not any(math.isnan(message.range) for message in laser)
        assert all(math.isfinite(message.vector.x) for message in base)
        for node in ("rig", "analysis", "recorder"):
            assert self.client.state(node) == "active"
            assert "refused.exception" not in self.client.figures(node), self.client.figures(node)

    def quiet(self) -> None:
        """Wait for two reports: messages sent before are counted in the second."""
        for _ in range(2):
            self.client.diagnostics.clear()
            self.client.wait_until(lambda: self.client.figures("rig"), "diagnostics")

    def call(self, kind: Any, name: str, request: Any) -> Any:
        return self.client.call(kind, name, request)
