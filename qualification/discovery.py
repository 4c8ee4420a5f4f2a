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
"""Time that a new process needs to discover existing publishers: `python -m qualification.discovery`, a minute or two.

A publisher of `daq/scan` is running. New processes, one after another, each create a node as the rig does, and query
the graph until they see the publisher. The time counts from the creation of the node, as for
`nodes.process.DISCOVERY_S`. This is done on the idle machine, and with enough busy processes for two per core.
Discovery takes longer than usual if the announcement was sent before the new process could receive it; it is repeated
every 3 s.
"""

from __future__ import annotations

import argparse
import os
import statistics
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

from rich.console import Console
from rich.table import Table

from impact_rig.client import isolated_domain
from impact_rig.nodes.process import DISCOVERY_S

STARTS = 40
SOON_S = 1.0
PATIENCE_S = 60.0
NODE = """
import sys, time
import rclpy
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
rclpy.init()
began = time.monotonic()
node = Node(sys.argv[1])
"""
PUBLISHER = NODE + "made = node.create_publisher(PointCloud2, 'daq/scan', 10)\nprint('there', flush=True)\ninput()\n"
LOOKER = NODE + (
    f"while node.count_publishers('daq/scan') == 0 and time.monotonic() < began + {PATIENCE_S}:\n"
    "    time.sleep(0.005)\n"
    "print(time.monotonic() - began)\n"
)
BUSY = "while True: pass"


def running(code: str, name: str) -> subprocess.Popen[str]:
    """Start a Python process that runs this code."""
    return subprocess.Popen(  # noqa: S603  # our own code
        [sys.executable, "-c", code, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )


@contextmanager
def kept(code: str, name: str) -> Iterator[subprocess.Popen[str]]:
    """Run a process until the end of the block."""
    with running(code, name) as process:
        try:
            yield process
        finally:
            process.kill()


def measure(starts: int, busy: int) -> list[float]:
    """Return how long `starts` new processes took [s], next to `busy` processes that never pause."""
    with ExitStack() as stack:
        os.environ["ROS_DOMAIN_ID"] = str(stack.enter_context(isolated_domain()))
        publisher = stack.enter_context(kept(PUBLISHER, "there"))
        assert publisher.stdout is not None
        publisher.stdout.readline()
        for _ in range(busy):
            stack.enter_context(kept(BUSY, "busy"))
        return [float(running(LOOKER, f"new_{i}").communicate()[0]) for i in range(starts)]


def main() -> int:
    """Measure and print the table; return 1 if a process took longer than the rig waits."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--starts", type=int, default=STARTS, help="new processes for each row (default: %(default)s)")
    starts = parser.parse_args().starts
    table = Table(title=f"a new process sees a publisher after [s]; a rig looks for {DISCOVERY_S:g}")
    for heading in ("busy processes", "median", "above 1 s", "longest"):
        table.add_column(heading, justify="right")
    longest = 0.0
    for busy in (0, 2 * (os.cpu_count() or 1)):
        times = measure(starts, busy)
        longest = max(longest, *times)
        late = sum(time > SOON_S for time in times) / len(times)
        table.add_row(str(busy), f"{statistics.median(times):.2f}", f"{late:.0%}", f"{max(times):.2f}")
    Console(markup=False).print(table)
    return int(longest > DISCOVERY_S)


if __name__ == "__main__":
    sys.exit(main())
