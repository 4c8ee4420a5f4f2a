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
"""Cost of starting: a fresh process, a node's first block, the memory of nodes, and the README's commands.

Installation, demo and tests take minutes and are run elsewhere. Those programs (`qualification/doors.py`, `make test`,
`make check`) store their figures in build/start, each in a separate file, and the latest are read here. Memory is read
after a minute in real time at 10 kS/s; `SECONDS=10 make bench ONLY=start` waits less.
"""

from __future__ import annotations

import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.cpu import resident_mb
from benchmarks.live import DRIVE, graph
from impact_rig import topics
from impact_rig.cli.main import commands
from impact_rig.client import Client, Processes, isolated_domain

NOTED = Path("build") / "start"
ONE_SECOND = """
from impact_rig.rig.config import RigConfig
from impact_rig.rig import Rig
assert Rig(RigConfig()).advance(10**9)
print(next(line.split()[1] for line in open("/proc/self/status") if line.startswith("VmHWM")))
"""
PROGRAM = "import sys; from impact_rig.cli import main; sys.exit(main())"
FRESH = 5
"""Number of processes for each median."""


def run() -> dict[str, float]:
    """Measure what is quick, and read the stored figures."""
    return {
        **first_block(),
        **one_second(),
        **command_line(),
        **memory(float(os.environ.get("SECONDS", "60"))),
        **noted(),
    }


def first_block() -> dict[str, float]:
    """Measure the time from starting a rig process to its first block; cold: the first time, warm: the second."""
    cold, *warm = (_first_block_s() for _ in range(1 + FRESH))
    median = statistics.median(warm)
    return {"cold_start_s": cold, "warm_start_s": median, "node_first_block_s": median}


def _first_block_s() -> float:
    with (
        isolated_domain() as domain_id,
        tempfile.TemporaryDirectory() as logs,
        Processes(domain_id, Path(logs)) as processes,
        Client(domain_id, processes=processes) as client,
    ):
        began = time.monotonic()
        processes.start("rig")
        scans = client.collect(topics.SCAN.name, timeout_s=300.0)
        client.wait_until(lambda: len(scans) > 0, "the first block", timeout_s=300.0)
        return time.monotonic() - began


def one_second() -> dict[str, float]:
    """Measure a fresh process that simulates one second of the rig: its CPU time and its peak memory."""
    subprocess.run(
        [sys.executable, "-c", ONE_SECOND], check=True, stdout=subprocess.DEVNULL
    )  # compiles everything that has to be compiled
    usage = [_fresh([sys.executable, "-c", ONE_SECOND]) for _ in range(FRESH)]
    return {
        "one_second_cpu_s": statistics.median(cpu_s for cpu_s, _ in usage),
        # from the process itself: the value of wait4 includes the memory of its parent
        "one_second_rss_mb": statistics.median(float(output) / 1024.0 for _, output in usage),
    }


def command_line() -> dict[str, float]:
    """Measure the CPU time of importing the package, and of the slowest help page of the program or a command."""
    import_cpu_s = _median_cpu_s([sys.executable, "-c", "import impact_rig"])
    pages = [["--help"], *([name, "--help"] for name in commands())]
    first_line_cpu_s = max(_median_cpu_s([sys.executable, "-c", PROGRAM, *page]) for page in pages)
    return {"import_cpu_s": import_cpu_s, "cli_first_line_cpu_s": first_line_cpu_s}


def _median_cpu_s(command: list[str]) -> float:
    return statistics.median(_fresh(command)[0] for _ in range(FRESH))


def _fresh(command: list[str]) -> tuple[float, str]:
    """Run a process to its end; return its processor time [s] and its output."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        output = process.stdout.read()
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0
    return usage.ru_utime + usage.ru_stime, output


def memory(seconds: float) -> dict[str, float]:
    """Return the memory of rig and analysis after some time in real time at the default rate."""
    with graph(DRIVE) as (client, processes, _):
        client.spin_for(seconds)
        return {f"{node}_rss_mb": resident_mb(processes.running[node].pid) for node in ("rig", "analysis")}


def noted() -> dict[str, float]:
    """Return the latest figures that other programs stored."""
    return {path.name: float(path.read_text()) for path in sorted(NOTED.glob("*_*"))}
