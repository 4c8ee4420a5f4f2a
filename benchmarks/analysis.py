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
"""Speed of the analysis of a recorded 50 kS/s run, file reading included, and its division.

The run contains what a rig publishes: calibration, one command, and blocks of 10 ms with four channels quantised to 16
bit, with two impacts per drive cycle. The benchmark uses one core; the file is read from the disk cache.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from impact_rig import codec, topics
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, DAQ_INFO, Table
from impact_rig.instruments.section import CHANNELS, SCAN
from impact_rig.recording import Provenance, RunWriter, TopicDescription, open_run

RATE_HZ = 50_000
BLOCK_SCANS = 500
SECONDS = 40
FREQUENCY_HZ = 9.1
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
RANGES = (1751.0, 0.01, 0.0125, 25.0)
RMS = (0.05, 3e-6, 1e-6, 2e-3)
AMPLITUDES = (19.0, 5.5e-3, 9e-5, 0.52)
PULSE_M_S2 = 150.0 * np.array([0.05, 0.6, 1.0, 0.7, 0.3, 0.1])


def info() -> Table:
    """Return a calibration like that of the default rig."""
    rows = np.zeros(4, DAQ_INFO)
    rows["name"], rows["rate"], rows["sensitivity"] = CHANNELS, RATE_HZ, 1.0
    rows["range_high"] = RANGES
    rows["range_low"] = -rows["range_high"]
    rows["noise"], rows["sensitivity_uncertainty"] = RMS, 2e-3
    rows["lag"], rows["lag_order"] = (22e-6, 0.7e-3, 225e-6, 8e-6), (0, 1, 0, 1)
    rows["skew"] = np.arange(4) * 5e-6
    return Table(0, rows)


def scans(rng: np.random.Generator) -> np.ndarray:
    """Return scans of a rig that vibrates and strikes, quantised to 16 bit."""
    time_s = np.arange(SECONDS * RATE_HZ) / RATE_HZ
    rows = np.zeros(len(time_s), SCAN)
    rows["time"] = np.arange(len(time_s)) % BLOCK_SCANS / RATE_HZ
    for channel, full, rms, amplitude, phase in zip(
        CHANNELS, RANGES, RMS, AMPLITUDES, (1.0, -2.1, 0, 0.5), strict=True
    ):
        values = amplitude * np.sin(2 * np.pi * FREQUENCY_HZ * time_s + phase) + rng.normal(0, rms, len(time_s))
        if channel == "accelerometer":
            hits = (np.arange(1, 2 * FREQUENCY_HZ * SECONDS - 1) / (2 * FREQUENCY_HZ) * RATE_HZ).astype(int)
            for offset, height in enumerate(PULSE_M_S2):
                values[hits + offset] += height * np.where(np.arange(len(hits)) % 2, 1, -1)
        step = full / 2**15
        rows[channel] = np.round(values / step) * step
    return rows


def write(directory: Path, tables: list[Table]) -> None:
    """Record a run."""
    command = np.zeros(1, APPLIED)
    command["frequency"], command["current"] = FREQUENCY_HZ, 0.52
    with RunWriter(
        directory, provenance=Provenance(version="benchmark", seed=1, wall_start_ns=0), clock=time.monotonic
    ) as run:
        for name in (topics.INFO.name, topics.APPLIED.name, topics.SCAN.name):
            run.add_topic(TopicDescription(name=f"/rig/{name}", type_name=POINT_CLOUD))
        run.write("/rig/daq/info", codec.encode(info()), 0)
        run.write("/rig/shaker/applied", codec.encode(Table(0, command)), 0)
        for table in tables:
            run.write("/rig/daq/scan", codec.encode(table), table.stamp_ns)


def analyse(directory: Path) -> int:
    """Read and analyse a run; return the number of measurements."""
    tracker, found = Tracker(), 0
    with open_run(directory) as run:
        for topic, _, _, _, _, data in run.messages([topics.INFO.name, topics.APPLIED.name, topics.SCAN.name]):
            table = codec.decode(data)
            if topic.endswith("scan"):
                found += len(tracker.feed(table).measurements)
            elif topic.endswith("info"):
                tracker.configure(table)
            else:
                tracker.on_applied(table)
    return found + len(tracker.flush().measurements)


def feed(tables: list[Table]) -> float:
    """Return the time of the tracker alone for the complete run [s]."""
    tracker = Tracker()
    tracker.configure(info())
    command = np.zeros(1, APPLIED)
    command["frequency"], command["current"] = FREQUENCY_HZ, 0.52
    tracker.on_applied(Table(0, command))
    begin = time.perf_counter()
    for table in tables:
        tracker.feed(table)
    return time.perf_counter() - begin


def run() -> dict[str, float]:
    """Measure; keys as in `make bench`. Each figure is the best of three, because other loads can only slow it down."""
    period_ns = BLOCK_SCANS * 10**9 // RATE_HZ
    parts = np.split(scans(np.random.default_rng(1)), SECONDS * RATE_HZ // BLOCK_SCANS)
    tables = [Table(number * period_ns, part) for number, part in enumerate(parts)]
    feed(tables[:600])  # compiles, or loads earlier compiled code
    with tempfile.TemporaryDirectory(prefix="impact_rig_bench_") as scratch:
        directory = Path(scratch) / "run"
        write(directory, tables)
        whole = []
        for _ in range(3):
            begin = time.perf_counter()
            measurements = analyse(directory)
            whole.append(time.perf_counter() - begin)
    assert measurements >= SECONDS // 6, f"only {measurements} measurements: this was no analysis"
    alone = min(feed(tables) for _ in range(3))
    return {
        "analysis_x_realtime_50kSps": SECONDS / min(whole),
        "analysis_tracker_x_realtime_50kSps": SECONDS / alone,
        "analysis_tracker_us_per_block": alone / len(tables) * 1e6,
    }
