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
"""Runs over hours with checks of memory, files and losses: `make soak`, `… soak.py --part live --minutes 3`.

Two parts, each with the rig, the analysis and the recorder as processes, as a user has them:

- free-running mode: hours of rig time, as fast as the peers follow, at 10 kS/s;
- live: minutes of real time at 50 kS/s.

Memory must be flat: the slope over the second half, times the whole duration, must stay below a limit. The pools
of Python and DDS grow in the first minutes, which is why the first half does not count.
"""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path

import attrs
import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from impact_rig import topics
from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.recording import open_run
from impact_rig.runs import check_contiguity

NODES = ("rig", "analysis", "recorder")
SAMPLES = 60
GROWTH_LIMIT_MB = 10.0
DESCRIPTOR_LIMIT = 2
RATES = {"free_running": 10_000, "live": 50_000}


@attrs.define
class Watched:
    """Memory [MB] and descriptors of a process, over wall time [s]."""

    times: list[float] = attrs.field(factory=list)
    memory: list[float] = attrs.field(factory=list)
    descriptors: list[int] = attrs.field(factory=list)

    def read(self, pid: int) -> None:
        """Take one sample of a process."""
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        self.times.append(time.monotonic())
        self.memory.append(pages * 4096 / 1e6)
        self.descriptors.append(len(list(Path(f"/proc/{pid}/fd").iterdir())))

    def growth_mb(self) -> float:
        """Return the growth over the whole time at the slope of the second half."""
        half = len(self.times) // 2
        slope = np.polyfit(self.times[half:], self.memory[half:], 1)[0]
        return float(slope * (self.times[-1] - self.times[0]))


def soak(part: str, duration_s: float, directory: Path, console: Console) -> bool:
    """Run one part for a duration: rig time in free_running, real time live; return whether all checks passed."""
    rate, mode = RATES[part], "free_running" if part == "free_running" else "realtime"
    with isolated_domain() as domain_id, Processes(domain_id, directory / "logs") as processes:
        processes.start(
            "rig",
            {
                "time.mode": mode,
                "time.peers": ["analysis", "recorder"],
                "daq.rate_hz": rate,
                "daq.block_scans": rate // 100,
                "drive.amplitude": 0.52,
            },
        )
        processes.start("analysis", {"gap_m": 0.006})
        processes.start("recorder", {"directory": str(directory), "name": part, "max_file_mb": 500})
        with Client(domain_id, processes=processes) as client:
            client.wait_active(*NODES)
            watched = {node: Watched() for node in NODES}
            begin, began = _rig_time_s(client), time.monotonic()
            done = 0.0
            for number in range(1, SAMPLES + 1):
                while done < duration_s * number / SAMPLES:
                    client.spin_for(0.2)
                    done = (_rig_time_s(client) - begin) if part == "free_running" else (time.monotonic() - began)
                for node, record in watched.items():
                    record.read(processes.running[node].pid)
                console.print(f"{part}: {done:.0f} of {duration_s:.0f} s", end="\r")
            wall_s = time.monotonic() - began
            client.pause()
            figures = client.figures("rig")
            client.trigger("recorder/stop")
        codes = processes.stop()
    with open_run(directory / part) as run:
        tables = run.tables(topics.SCAN.name, recorded_order=True)
        contiguity = check_contiguity(((table.stamp_ns, len(table.rows)) for table in tables), rate)
    lost = {key: value for key, value in figures.items() if key.startswith("lost_blocks") and int(value)}
    for gap in contiguity.gaps[:10]:
        console.print(f"gap before block {gap.block} of {contiguity.blocks}: {gap.missing_scans} scans missing")
    console.print(f"lost by peers: {lost or 'nothing'}; slips of the pacer: {figures.get('slips')}")
    well = contiguity.whole and not lost
    table = TextTable(title=f"{part}: {done:.0f} s in {wall_s:.0f} s of wall time, scans whole: {well}")
    for heading in ("node", "memory [MB]", "growth [MB]", "descriptors", "more", "exit code"):
        table.add_column(heading, justify="right")
    for node, record in watched.items():
        opened = record.descriptors
        growth, more = record.growth_mb(), opened[-1] - opened[len(opened) // 2]  # since half-way
        well &= growth < GROWTH_LIMIT_MB and more <= DESCRIPTOR_LIMIT and codes[node] == 0
        cells = (f"{record.memory[-1]:.0f}", f"{growth:+.1f}", str(opened[-1]), f"{more:+d}", str(codes[node]))
        table.add_row(node, *cells)
    console.print(table)
    return well


def _rig_time_s(client: Client) -> float:
    """Return the rig's newest stamp from its diagnostics."""
    client.wait_until(lambda: "rig_time_s" in client.figures("rig"), "the rig's diagnostics")
    return float(client.figures("rig")["rig_time_s"])


def main() -> int:
    """Return 0 if memory and descriptors were flat and nothing was lost."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=tuple(RATES), help="the only part to run (default: both)")
    parser.add_argument("--hours", type=float, default=2.0, help="hours of rig time free-running (default: 2)")
    parser.add_argument("--minutes", type=float, default=10.0, help="minutes of real time live (default: 10)")
    parser.add_argument("--keep", type=Path, help="directory that keeps runs and logs (default: they are removed)")
    arguments = parser.parse_args()
    console = Console()
    directory = arguments.keep or Path(tempfile.mkdtemp(prefix="impact_rig_soak_"))
    durations = {"free_running": arguments.hours * 3600, "live": arguments.minutes * 60}
    try:
        parts = [arguments.part] if arguments.part else list(RATES)
        well = [soak(part, durations[part], directory / part, console) for part in parts]
    finally:
        if arguments.keep is None:
            shutil.rmtree(directory, ignore_errors=True)
    console.print("nothing grew, nothing was lost" if all(well) else "[red]not as it should be[/red]")
    return 0 if all(well) else 1


if __name__ == "__main__":
    sys.exit(main())
