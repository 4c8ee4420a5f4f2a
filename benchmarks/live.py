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
"""The complete graph as processes: real time at 10 and 50 kS/s, free-running at 10 kS/s, compared with bare messages.

Lateness is the receipt at an additional subscriber minus the end of the block. It contains computation, pacing, DDS and
that subscriber's own wake-up. CPU shares are those of the processes, from /proc, in percent of one core. The
environment variable SECONDS sets the duration of each measurement: `SECONDS=300 make bench ONLY=live`.

`stop_latency_p99_s` is the time from sending `rig/stop` to receiving the block in which the current has become zero,
the ramp included, while a busy process loads every core.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np

from benchmarks import wire
from benchmarks.cpu import cpu_share
from impact_rig import codec, topics
from impact_rig.client import Client, Collector, Processes, isolated_domain
from impact_rig.client.processes import ParameterValue
from impact_rig.runs import info

BLOCK_NS = 10_000_000
DRIVE = {"drive.amplitude": 0.52, "barriers.gap_m": 0.006}
NODES = ("rig", "analysis", "recorder")
WARM_UP_S = 2.0
FREE_RUNNING_WINDOW = 64
ROUNDS = 3
STOPS = 50
BESIDE = dict(zip(NODES, ("source", *wire.READERS), strict=True))  # node -> the bare process with its messages
WORST = ("lost_blocks", "wrong_stamps", "p99_lateness_ms", "slips")  # figures of which no median is taken


def run() -> dict[str, float]:
    """Measure everything."""
    seconds = float(os.environ.get("SECONDS", "20"))
    return {
        **live_beside_the_wire(seconds / 2),
        **live(seconds, 50_000),
        **free_running_beside_the_wire(seconds / 2),
        **stop_under_load(),
    }


def live_beside_the_wire(seconds: float) -> dict[str, float]:
    """Measure real time and its bare messages alternately; return medians, also of ratios, and worst faults."""
    found = [{**live(seconds, 10_000), **wire.run_paced(seconds)} for _ in range(ROUNDS)]
    for one in found:
        for ours, bare in BESIDE.items():
            share = one[f"live_10kSps_{ours}_cpu_percent"]
            one[f"live_10kSps_{ours}_over_wire_{bare}"] = share / one[f"wire_live_{bare}_cpu_percent"]
    return {
        name: float((np.max if name.endswith(WORST) else np.median)([one[name] for one in found])) for name in found[0]
    }


def free_running_beside_the_wire(seconds: float) -> dict[str, float]:
    """Measure free-running mode and bare messages alternately; return both and the ratio of their medians."""
    found = [
        (
            free_running(seconds)["freewheel_x_realtime_10kSps"],
            wire.run(seconds, FREE_RUNNING_WINDOW),
            wire.run(seconds, FREE_RUNNING_WINDOW, patient=True),
        )
        for _ in range(ROUNDS)
    ]
    own, bare, patient = map(float, np.median(found, axis=0))
    return {
        "freewheel_x_realtime_10kSps": own,
        "wire_x_realtime_10kSps": bare,
        "patient_wire_x_realtime_10kSps": patient,
        "freewheel_over_wire": own / bare,
        "freewheel_over_patient_wire": own / patient,
    }


def live(seconds: float, rate_hz: int) -> dict[str, float]:
    """Run the default instruments in real time, with analysis and recorder attached."""
    with graph({"daq.rate_hz": rate_hz, "daq.block_scans": rate_hz // 100, **DRIVE}) as (client, processes, directory):
        scans = client.collect(topics.SCAN.name)
        client.spin_for(WARM_UP_S)
        scans.clear()
        shares, began = {name: cpu_share(processes.running[name].pid) for name in NODES}, time.monotonic()
        client.spin_for(seconds)
        wall, cpu = time.monotonic() - began, {name: share() for name, share in shares.items()}
        ends = np.array([codec.header_stamp_ns(data) for data in scans.messages]) + BLOCK_NS
        late_ms = (np.array([message.received_system_ns for message in scans.received]) - ends) * 1e-6
        wrong = np.count_nonzero(np.diff(ends) != BLOCK_NS)  # a block starts exactly where the one before ends
        lost = scans.lost() + float(client.figures("analysis").get("lost_scans", "nan")) / (rate_hz // 100)
        slips = float(client.figures("rig")["slips"])
        processes.stop()
        recorded = info(directory / "run").scans
        assert recorded is not None
        figures = {
            "seconds": wall,
            "lost_blocks": lost + recorded.lost_blocks,
            "wrong_stamps": float(wrong),
            **{f"{name}_cpu_percent": share for name, share in cpu.items()},
            "median_lateness_ms": float(np.median(late_ms)),
            "p99_lateness_ms": float(np.percentile(late_ms, 99)),
            "slips": slips,
        }
        return {f"live_{rate_hz // 1000}kSps_{name}": value for name, value in figures.items()}


def free_running(seconds: float) -> dict[str, float]:
    """Run as fast as analysis and recorder acknowledge, at the default rate."""
    parameters = {
        "time.mode": "free_running",
        "time.peers": ("analysis", "recorder"),
        "time.ack_window": FREE_RUNNING_WINDOW,
        **DRIVE,
    }
    with graph(parameters) as (client, _, _):
        client.spin_for(WARM_UP_S)
        marks = []
        for duration in (0.0, seconds):
            client.spin_for(duration)
            status = client.status("rig")
            client.wait_until(lambda status=status: client.status("rig") is not status, "diagnostics")
            marks.append((time.monotonic(), float(client.figures("rig")["rig_time_s"])))
        (began, first), (ended, last) = marks
        return {"freewheel_x_realtime_10kSps": (last - first) / (ended - began)}


def stop_under_load() -> dict[str, float]:
    """Stop a rig in real time repeatedly, with analysis and recorder attached and all cores busy."""
    latencies_s = []
    with graph({"output.truth_scan": True, **DRIVE}) as (client, _, _), ExitStack() as load:
        for _ in range(os.cpu_count() or 1):
            busy = load.enter_context(subprocess.Popen([sys.executable, "-c", "while True: pass"]))
            load.callback(busy.kill)
        truth = client.collect(topics.TRUTH_SCAN.name)
        for _ in range(STOPS):
            client.wait_until(lambda: _ends_with_current(truth, True), "a current")
            truth.clear()
            sent_ns = time.time_ns()
            client.trigger("rig/stop")
            client.wait_until(lambda: _ends_with_current(truth, False), "the end of the current")
            last = max(number for number, table in enumerate(truth.tables()) if table.rows["current"].any())
            latencies_s.append((truth.received[last + 1].received_system_ns - sent_ns) * 1e-9)
            client.trigger("rig/clear_trip")
            client.command(current_a=DRIVE["drive.amplitude"])
    return {"stop_latency_p99_s": float(np.percentile(latencies_s, 99))}


def _ends_with_current(truth: Collector, flows: bool) -> bool:
    newest = truth.last()
    return newest is not None and bool(newest.rows["current"].any()) is flows


@contextmanager
def graph(parameters: Mapping[str, ParameterValue]) -> Iterator[tuple[Client, Processes, Path]]:
    """Run rig, analysis and recorder as processes, with a client."""
    with (
        tempfile.TemporaryDirectory() as name,
        isolated_domain() as domain_id,
        Processes(domain_id, Path(name) / "logs") as processes,
    ):
        processes.start("rig", parameters)
        processes.start("analysis")
        processes.start("recorder", {"directory": name, "name": "run"})
        with Client(domain_id, processes=processes) as client:
            client.wait_active(*NODES, timeout_s=300.0)
            client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
            client.wait_until(lambda: "rig_time_s" in client.figures("rig"), "the rig to begin")
            yield client, processes, Path(name)
