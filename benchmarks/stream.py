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
"""Speed of a rig driven by a stream of samples, and its delay in playing a controller's answer to a scan.

The speed is measured in this process, in one thread, by CPU time. For the delay, a rig in real time with blocks of 1 ms
and a controller in Python run as two processes. The controller answers a block of scans with samples that begin at the
end of that block. The rig drops and counts samples that arrive too late. The delay is the time from a scan's last
sample to the first sample of the answer that takes effect.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from impact_rig import codec, topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.client import Client, Collector, Processes, isolated_domain
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S

RATE_HZ = 10_000
SETTLE_S = 2
ANSWERS, LONGEST_S = 500, 0.2


def run() -> dict[str, float]:
    """Measure both."""
    return {**speed(), **round_trip()}


def speed(seconds: int = 10) -> dict[str, float]:
    """Run a rig in process: a sine with noise at 10 kS/s, scans at 10 kS/s, 6 mm gap; the median second counts."""
    config = from_flat(
        RigConfig(),
        {"daq.rate_hz": RATE_HZ, "drive.waveform": "stream", "drive.stream_rate_hz": RATE_HZ, "barriers.gap_m": 6e-3},
    )
    rig, random = Rig(config), np.random.default_rng(1)
    t = np.arange((SETTLE_S + seconds) * RATE_HZ + 1) / RATE_HZ
    samples = 0.45 * np.sin(2.0 * np.pi * 9.1 * t) + 0.02 * random.normal(size=len(t))
    spent, impacts = [], 0
    for second in range(SETTLE_S + seconds):
        first = second * RATE_HZ + (second > 0)
        began = time.thread_time()
        rig.feed(first, samples[first : (second + 1) * RATE_HZ + 1])
        blocks = rig.advance((second + 1) * NS_PER_S)
        spent.append(time.thread_time() - began)
        impacts += sum(len(block.impacts.rows) for block in blocks if block.impacts is not None)
    assert impacts > seconds, f"only {impacts} impacts: the sphere did not take part"
    return {"stream_x_realtime_10kSps": 1.0 / float(np.median(spent[SETTLE_S:]))}


def round_trip() -> dict[str, float]:
    """Answer blocks of scans over topics, one after the other; return the delays that half and 99 of 100 keep."""
    answer, spent = np.zeros(round(LONGEST_S * RATE_HZ), WAVEFORM), []
    with (
        isolated_domain() as domain_id,
        tempfile.TemporaryDirectory() as logs,
        Processes(domain_id, Path(logs)) as processes,
        Client(domain_id, processes=processes) as client,
    ):
        processes.start("rig", {"drive.waveform": "stream", "daq.rate_hz": RATE_HZ, "daq.block_scans": RATE_HZ // 1000})
        client.wait_active("rig")
        scans, stream = client.collect(topics.SCAN.name), client.collect(topics.STREAM.name)
        client.wait_until(lambda: len(stream) > 0, "shaker/stream")
        late = 0.0
        for _ in range(ANSWERS):
            scans.clear()
            stream.clear()
            client.wait_until(lambda: len(scans) > 0, "scans")
            scan = scans.tables()[-1]
            end_ns = scan.stamp_ns + len(scan.rows) * NS_PER_S // RATE_HZ
            client.publish(topics.WAVEFORM, codec.encode(Table(end_ns, answer)), listener="rig")
            before = late
            late = client.wait_until(lambda: _late(stream, before), "the answer to be counted")  # noqa: B023  # at once
            spent.append(1e3 * (late - before) / RATE_HZ)
    half, most = np.percentile(spent, (50, 99))
    return {"stream_round_trip_p50_ms": float(half), "stream_round_trip_p99_ms": float(most)}


def _late(stream: Collector, before: float) -> float | None:
    """Return the number of late samples, once it has grown."""
    late = max((float(table.rows["late"][0]) for table in stream.tables()), default=0.0)
    return late if late > before else None
