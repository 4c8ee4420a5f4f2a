# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Hurt a running graph in every way and measure how it recovers: `python tools/fault_matrix.py`, about two minutes.

Rig, analysis and recorder run as processes, freewheeling; a client is a peer as well, so what it misses is a loss.
Each case hurts one of them, undoes it as an operator would, and measures the wall time until blocks flow again. At the
end the recording is checked: every block that the recorder acknowledged must be in it.
"""

from __future__ import annotations

import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from impact_rig import topics
from impact_rig.client import Client, Collector, Processes, isolated_domain
from impact_rig.client.collector import Received
from impact_rig.nodes.messages import nanoseconds
from impact_rig.recording import open_run
from impact_rig.runs import recover

TICK_NS = 10_000_000
PEERS = ("analysis", "recorder", "client")
SUSPENDED_S = 1.0
SLOWED_S, SLICE_S = 2.0, 0.02
TIMEOUT_S = 60.0
AGAIN_S = 0.5
SUSTAINED = 100
"""Blocks; many more than the rig sends to a peer that never answers."""


class Graph:
    """The graph under test."""

    def __init__(self, directory: Path, domain_id: int, processes: Processes) -> None:
        self.directory = directory
        self.domain_id = domain_id
        self.processes = processes
        self.recordings = 0
        self.acknowledged: list[Counter[int]] = []
        """Stamps that the recorder has acknowledged, by recording."""
        self.start("rig")
        self.start("analysis")
        self.start("recorder")
        self.client = Client(domain_id)
        self.client.wait_active("rig", "analysis", "recorder")
        self.read()
        self.flows()

    def start(self, node: str) -> None:
        """Start a process, or start it again."""
        parameters: dict[str, object] = {}
        if node == "rig":
            parameters = {"time.mode": "freewheel", "time.peers": PEERS, "drive.amplitude": 0.52}
        elif node == "recorder":
            parameters = {"directory": str(self.directory), "name": f"run{self.recordings}"}
            self.recordings += 1
            self.acknowledged.append(Counter())
        self.processes.running.pop(node, None)
        self.processes.start(node, parameters)

    def read(self) -> None:
        """Read as a peer does, and what the recorder says it has."""
        self.scans: Collector = self.client.collect(topics.SCAN.name, acknowledge=True)
        self.client.listen(topics.ACK.name, self._take_acknowledgement)

    def _take_acknowledgement(self, message: Received) -> None:
        if message.data.frame_id == "recorder":
            self.acknowledged[-1][nanoseconds(message.data.stamp)] += 1

    def flows(self, blocks: int = 50) -> None:
        """Wait until that many more blocks have come."""
        goal = len(self.scans) + blocks
        self.client.wait_until(lambda: len(self.scans) >= goal, "blocks to flow", TIMEOUT_S)

    def go_on(self) -> None:
        """Tell the rig to go on without what a peer missed, again until it does: the peer may not be matched yet."""
        goal = len(self.scans) + SUSTAINED
        for _ in range(round(TIMEOUT_S / AGAIN_S)):
            self.client.pause(False)
            self.client.spin_for(AGAIN_S)
            if len(self.scans) > goal:
                return
        self.flows()

    def silent(self, peer: str) -> None:
        """Wait until the rig names a peer."""
        self.client.wait_until(lambda: peer in self.client.status("rig").message, f"the rig to name {peer}", TIMEOUT_S)

    def gaps(self, since: int) -> int:
        """Return blocks missing among those that came since then; a rig that began again is no gap."""
        steps = np.diff([table.stamp_ns for table in self.scans.tables(since)])
        return int(sum(step // TICK_NS - 1 for step in steps if step > 0))


def killed(graph: Graph, node: str) -> float:
    """SIGKILL, and an operator who starts it again and lets the rig go on."""
    graph.processes.running[node].signal(signal.SIGKILL)
    graph.processes.running[node].process.wait()
    if node != "rig":
        graph.silent(node)
    began = time.monotonic()
    graph.start(node)
    graph.client.wait_active(node)
    if node != "rig":
        graph.go_on()
    graph.flows(1)
    return time.monotonic() - began


def suspended(graph: Graph, node: str) -> float:
    """SIGSTOP for a second."""
    graph.processes.running[node].signal(signal.SIGSTOP)
    graph.client.spin_for(SUSPENDED_S)
    began = time.monotonic()
    graph.processes.running[node].signal(signal.SIGCONT)
    graph.flows(1)
    return time.monotonic() - began


def slowed(graph: Graph, node: str) -> float:
    """Half of the processor, in slices."""
    end = time.monotonic() + SLOWED_S
    while time.monotonic() < end:
        graph.processes.running[node].signal(signal.SIGSTOP)
        graph.client.spin_for(SLICE_S)
        graph.processes.running[node].signal(signal.SIGCONT)
        graph.client.spin_for(SLICE_S)
    began = time.monotonic()
    graph.flows(1)
    return time.monotonic() - began


def participant(graph: Graph, _node: str) -> float:
    """A peer's DDS participant goes and comes back under the same name."""
    graph.client.close()
    began = time.monotonic()
    graph.client = Client(graph.domain_id)
    graph.read()
    graph.go_on()
    return time.monotonic() - began


def late_joiner(graph: Graph, _node: str) -> float:
    """Somebody comes late and gets calibration, command, journal and configuration."""
    began = time.monotonic()
    with Client(graph.domain_id, name="late") as late:
        wanted = [
            late.collect(name)
            for name in (topics.INFO.name, topics.APPLIED.name, topics.JOURNAL.name, topics.CONFIGURATION.name)
        ]
        late.wait_until(lambda: all(len(one) for one in wanted), "everything latched", TIMEOUT_S)
        took = time.monotonic() - began
    graph.flows(1)
    return took


def second_rig(graph: Graph, _node: str) -> float:
    """A rig in another namespace on the same domain comes and goes."""
    began = time.monotonic()
    with Processes(graph.domain_id, graph.directory / "second", namespace="/other") as others:
        others.start("rig", {"daq.seed": 2})
        with Client(graph.domain_id, namespace="/other", name="other_client") as client:
            client.wait_active("rig")
        graph.flows(10)
    graph.flows(1)
    return time.monotonic() - began


CASES: tuple[tuple[str, Callable[[Graph, str], float], str], ...] = (
    *((f"{node} suspended for {SUSPENDED_S:g} s", suspended, node) for node in ("rig", "analysis", "recorder")),
    *((f"{node} at half speed for {SLOWED_S:g} s", slowed, node) for node in ("rig", "analysis", "recorder")),
    ("a late joiner", late_joiner, ""),
    ("a second rig in another namespace", second_rig, ""),
    ("a peer's DDS participant restarted", participant, ""),
    ("analysis killed (SIGKILL) and started again", killed, "analysis"),
    ("recorder killed (SIGKILL) and started again", killed, "recorder"),
    ("rig killed (SIGKILL) and started again", killed, "rig"),
)


@contextmanager
def running() -> Iterator[Graph]:
    """Start the graph and end it."""
    with (
        tempfile.TemporaryDirectory(prefix="impact_rig_faults_") as folder,
        isolated_domain() as domain_id,
        Processes(domain_id, Path(folder) / "logs") as processes,
    ):
        graph = Graph(Path(folder), domain_id, processes)
        try:
            yield graph
        finally:
            graph.client.close()


def main() -> int:
    """Return 0 if nothing was lost and everything recovered."""
    console, table, lost = Console(), TextTable(), 0
    for heading in ("case", "recovered after [s]", "blocks lost"):
        table.add_column(heading, justify="left" if heading == "case" else "right")
    with running() as graph:
        for name, hurt, node in CASES:
            seen = len(graph.scans)
            took = hurt(graph, node)
            graph.flows()
            gaps = graph.gaps(0 if hurt is participant else seen)
            lost += gaps
            table.add_row(name, f"{took:.2f}", str(gaps))
            console.print(f"{name}: {took:.2f} s, {gaps} lost", style="dim")
        graph.processes.stop()
        for number in range(graph.recordings):
            path = graph.directory / f"run{number}"
            if not (path / "metadata.yaml").exists():
                recover(path, path.with_name(f"{path.name}_recovered"))
                path = path.with_name(f"{path.name}_recovered")
            with open_run(path) as run:
                stamps = [one.stamp_ns for one in run.tables(topics.SCAN.name, recorded_order=True)]
            missing = sum(int(step) // TICK_NS - 1 for step in np.diff(stamps) if step > TICK_NS)
            # counted, as a rig that begins again has the same stamps; a recorder acknowledges before it records, too
            acknowledged = Counter({at: n for at, n in graph.acknowledged[number].items() if at >= stamps[0]})
            broken = (acknowledged - Counter(stamps)).total()
            lost += missing + broken
            text = f"recording {number + 1}: {len(stamps)} blocks, {acknowledged.total()} acknowledged"
            table.add_row(text, "", str(missing + broken))
    console.print(table)
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
