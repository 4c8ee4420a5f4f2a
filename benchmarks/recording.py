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
"""Speed of writing and reading a run: the recorder's sustained rate, its longest stall, and the reader's rate.

MB are CDR bytes passed to the writer. The data are scans as an ADC gives them (a sine, two LSB of noise, 16 bit), so
that the compression has as much work as in a real run.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.instruments.section import SCAN
from impact_rig.recording import Provenance, RunWriter, TopicDescription, open_run
from impact_rig.recording.writer import COMPRESSIONS

RATE_HZ = 50_000
BLOCK_SCANS = 500
DISTINCT_BLOCKS = 200  # 4 MB: no chunk holds the same block twice
MEASURE_S = 2.0
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
FLOAT64 = b"\0\1\0\0" + np.float64(9.1).tobytes()


def blocks(rng: np.random.Generator) -> list[np.ndarray]:
    """Return scans of a rig driven at 9.1 Hz, quantised to 16 bit."""
    times = np.arange(BLOCK_SCANS * DISTINCT_BLOCKS) / RATE_HZ
    rows = np.zeros(len(times), SCAN)
    rows["time"] = np.tile(times[:BLOCK_SCANS], DISTINCT_BLOCKS)
    for phase, (channel, full_scale) in enumerate(
        (("accelerometer", 500.0), ("laser", 0.01), ("base", 0.0125), ("current", 5.0))
    ):
        lsb = full_scale / 2**15
        signal = 0.5 * full_scale * np.sin(2 * np.pi * 9.1 * times + phase) + rng.normal(0, 2 * lsb, len(times))
        rows[channel] = np.round(signal / lsb) * lsb
    return np.split(rows, DISTINCT_BLOCKS)


def messages(pool: list[np.ndarray], count: int) -> list[bytes]:
    """Return `count` consecutive blocks as received from the middleware."""
    period_ns = BLOCK_SCANS * 10**9 // RATE_HZ
    return [codec.encode(Table(number * period_ns, pool[number % DISTINCT_BLOCKS])) for number in range(count)]


def writer(directory: Path, compression: str) -> RunWriter:
    provenance = Provenance(version="benchmark", seed=1, wall_start_ns=0)
    run = RunWriter(directory, provenance=provenance, clock=time.monotonic, compression=compression)
    run.add_topic(TopicDescription(name="/rig/daq/scan", type_name=POINT_CLOUD))
    run.add_topic(TopicDescription(name="/rig/transmissibility", type_name="std_msgs/msg/Float64"))
    return run


def write_blocks(directory: Path, compression: str, sent: list[bytes]) -> tuple[float, float]:
    """Return MB/s over `MEASURE_S` and the longest single call [ms]."""
    run = writer(directory, compression)
    done, longest = 0, 0.0
    begin = now = time.perf_counter()
    while now - begin < MEASURE_S:
        for data in sent:
            before = now
            run.write("/rig/daq/scan", data, 0)
            now = time.perf_counter()
            longest = max(longest, now - before)
            done += len(data)
    run.finish()
    return done / (time.perf_counter() - begin) / 1e6, longest * 1e3


def write_small(directory: Path, compression: str) -> float:
    """Return small messages per second over half of `MEASURE_S`."""
    run = writer(directory, compression)
    count = 0
    begin = time.perf_counter()
    while time.perf_counter() - begin < MEASURE_S / 2:
        for _ in range(1000):
            run.write("/rig/transmissibility", FLOAT64, 0)
        count += 1000
    run.finish()
    return count / (time.perf_counter() - begin)


def read_back(directory: Path, compression: str, sent: list[bytes]) -> float:
    """Return the speed of reading and decoding the scans of a 50 kS/s run, as a multiple of real time."""
    with writer(directory, compression) as run:
        for data in sent:
            run.write("/rig/daq/scan", data, 0)
    scans = 0
    begin = time.perf_counter()
    with open_run(directory) as opened:
        for table in opened.tables(topics.SCAN.name):
            scans += len(table.rows)
    return scans / RATE_HZ / (time.perf_counter() - begin)


def run() -> dict[str, float]:
    """Measure; keys as in `make bench`."""
    figures = {}
    sent = messages(blocks(np.random.default_rng(1)), 2000)
    with tempfile.TemporaryDirectory(prefix="impact_rig_bench_") as scratch:
        for compression in COMPRESSIONS:
            place = Path(scratch)
            rate, stall_ms = write_blocks(place / f"blocks_{compression}", compression, sent)
            figures[f"recorder_MB_per_s_{compression}"] = rate
            figures[f"recorder_longest_write_ms_{compression}"] = stall_ms
            figures[f"recorder_messages_per_s_{compression}"] = write_small(place / f"small_{compression}", compression)
            figures[f"reader_x_realtime_50kSps_{compression}"] = read_back(
                place / f"read_{compression}", compression, sent
            )
    return figures
