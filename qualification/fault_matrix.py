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
"""Faults in every part of a measurement and of the graph: `python -m qualification.fault_matrix [sensors] [processes]`.

Sensors: every fault, on each channel, in two sizes, read by three sets of instruments, begins in the middle of a
measurement and lasts. Rows that look good are compared with the motion itself. None may be off by more than 3u. The
exception is a gain error within the limits of the calibration, which no reading shows: the budget names it as
`sensitivity`. Every second the lab page's text about rows, state of the analysis and active faults is checked: it may
not be `measured` during a fault or over a row that is off. Finally the table of docs/explanation/analysis.md is
printed.

Processes: rig, analysis and recorder run as processes, free-running; a client is a peer as well, so a block that it
misses is a loss. Each case disturbs one of them, undoes it as an operator would, and measures the wall time until
blocks flow again. At the end the recording is checked: it must contain every block that the recorder acknowledged.
"""

from __future__ import annotations

import argparse
import functools
import math
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import attrs
import numpy as np
from rich.console import Console
from rich.table import Table as TextTable

from impact_rig import topics
from impact_rig.analysis.scans import CHANNELS
from impact_rig.analysis.sine import fit_sine
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, FAULTS, Table
from impact_rig.client import Client, Collector, Processes, isolated_domain
from impact_rig.client.client import Received
from impact_rig.instruments.chain import Chain
from impact_rig.instruments.fault import Fault
from impact_rig.nodes.messages import nanoseconds
from impact_rig.physics import FunctionGenerator, Motion, Simulation
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import gap_values
from impact_rig.runs import recover
from impact_rig.simtime import NS_PER_S
from impact_rig_lab.record import RigView
from impact_rig_lab.state import Seen, judge

TICK_NS = 10_000_000
PEERS = ("analysis", "recorder", "client")
SUSPENDED_S = 1.0
SLOWED_S, SLICE_S = 2.0, 0.02
TIMEOUT_S = 60.0
AGAIN_S = 0.5
SUSTAINED = 100
"""Number of blocks, many more than the rig sends to a peer that never answers."""


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
            parameters = {"time.mode": "free_running", "time.peers": PEERS, "drive.amplitude": 0.52}
        elif node == "recorder":
            parameters = {"directory": str(self.directory), "name": f"run{self.recordings}"}
            self.recordings += 1
            self.acknowledged.append(Counter())
        self.processes.running.pop(node, None)
        self.processes.start(node, parameters)

    def read(self) -> None:
        """Receive messages as a peer does, and collect the recorder's acknowledgements."""
        self.scans: Collector = self.client.collect(topics.SCAN.name, acknowledge=True)
        self.client.listen(topics.ACK.name, self._take_acknowledgement)

    def _take_acknowledgement(self, message: Received) -> None:
        if message.data.frame_id == "recorder":
            self.acknowledged[-1][nanoseconds(message.data.stamp)] += 1

    def flows(self, blocks: int = 50) -> None:
        """Wait for that many more blocks."""
        goal = len(self.scans) + blocks
        self.client.wait_until(lambda: len(self.scans) >= goal, "blocks to flow", TIMEOUT_S)

    def go_on(self) -> None:
        """Call `~/pause` false, again until blocks flow: the peer may not be matched yet."""
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
        """Return the number of blocks missing since then; a restarted rig does not count as a gap."""
        steps = np.diff([table.stamp_ns for table in self.scans.tables(since)])
        return int(sum(step // TICK_NS - 1 for step in steps if step > 0))


def killed(graph: Graph, node: str) -> float:
    """Kill a node by SIGKILL, start it again, and let the rig continue."""
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
    """Suspend a node by SIGSTOP for a second."""
    graph.processes.running[node].signal(signal.SIGSTOP)
    graph.client.spin_for(SUSPENDED_S)
    began = time.monotonic()
    graph.processes.running[node].signal(signal.SIGCONT)
    graph.flows(1)
    return time.monotonic() - began


def slowed(graph: Graph, node: str) -> float:
    """Give a node half of the processor, in slices."""
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
    """Remove a peer's DDS participant and create it again under the same name."""
    graph.client.close()
    began = time.monotonic()
    graph.client = Client(graph.domain_id)
    graph.read()
    graph.go_on()
    return time.monotonic() - began


def late_joiner(graph: Graph, _node: str) -> float:
    """Join late and receive calibration, command, journal and configuration."""
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
    """Start and end a rig in another namespace on the same domain."""
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


RATE_HZ, TICKS_PER_S = 10_000, 100
DRIVE_HZ, DRIVE_A = 9.1, 0.52
RUN_S, FAULT_S, FAULT_ENDS_S = 75.0, 27.3, 62.1
"""Time between the start of a fault and the end of the run, in which it begins after some rows and within one."""
WORST_U = 3.0
SEEDS = (2, 3, 4)
"""Sets of instruments."""
GAPS_M = (0.006, 0.0)
FULL_SCALE = {"accelerometer": 20.0, "laser": 6e-3, "base": 1e-4, "current": 0.52}
"""Sizes of the vibration [unit of the channel], of which the faults are fractions."""
NONE = "none"
SENSOR_FAULTS: tuple[tuple[str, tuple[float, float]], ...] = (
    ("dropout", (0.0, 1.0)),  # the second lasts half a cycle
    ("stuck", (0.0, 1.0)),  # the same
    ("offset_step", (0.05, 2.0)),
    ("gain_error", (0.002, 0.05)),
    ("spike_train", (0.2, 5.0)),
    ("saturation", (0.5, 0.95)),
    ("added_noise", (0.02, 1.0)),
)


@attrs.frozen
class Outcome:
    """Effect of a fault on the rows that end in it or after it."""

    worst: float  # largest error of a row that looks good, in units of its u; NaN if there is none
    words: Counter[str]  # statuses with channels, and their numbers
    claims: int  # seconds in which the page showed `measured` in the fault, or over a row off by more than `WORST_U`
    within: bool  # whether the fault is a gain error within the calibration's limits

    @property
    def passes(self) -> bool:
        """Return whether no row that looks good is wrong."""
        return self.within or not (self.worst > WORST_U or self.claims)

    @property
    def cell(self) -> str:
        """Entry in the table of the documentation."""
        good = f"good, {self.worst:.1f} u" if math.isfinite(self.worst) else ""
        words = {word.split()[0] for word in self.words} - {"ok"}
        return ", ".join([*([good] if good else []), *(f"`{word}`" for word in sorted(words))])


@functools.cache
def steady_motion(gap_m: float) -> tuple[RigConfig, Motion]:
    """Return the rig and its motion from rest, after the drive has started."""
    config = from_flat(RigConfig(), {**gap_values(gap_m), "daq.rate_hz": RATE_HZ})
    drive = FunctionGenerator(config.drive, config.shaker, np.random.default_rng(1))
    drive.set_frequency(DRIVE_HZ)
    drive.set_amplitude(DRIVE_A)
    return config, Simulation(config).advance(drive.segments(round(RUN_S * TICKS_PER_S)))


def sensor_fault(kind: str, channel: str, size: float, gap_m: float, seeds: Sequence[int] = SEEDS) -> Outcome:
    """Measure the motion with one fault by every set of instruments; return the worst outcome."""
    found = [_sensor_fault(kind, channel, size, gap_m, seed) for seed in seeds]
    words = sum((one.words for one in found), Counter[str]())
    worst, claims = float(np.fmax.reduce([one.worst for one in found])), sum(one.claims for one in found)
    return Outcome(worst, words, claims, any(one.within for one in found))


def _sensor_fault(kind: str, channel: str, size: float, gap_m: float, seed: int) -> Outcome:
    config, motion = steady_motion(gap_m)
    chain, tracker = Chain(attrs.evolve(config, daq=attrs.evolve(config.daq, seed=seed))), Tracker()
    info = chain.info()
    value = size if kind == "gain_error" else size * FULL_SCALE[channel]
    brief = kind in ("dropout", "stuck") and size > 0.0
    samples = RATE_HZ / DRIVE_HZ / 2.0 if brief else RATE_HZ * (FAULT_ENDS_S - FAULT_S)
    if kind != NONE:
        start = round(FAULT_S * RATE_HZ)
        chain.inject(Fault(kind=kind, channel=channel, start_sample=start, samples=round(samples), value=value, seed=3))
    tracker.configure(Table(0, info))
    command = np.zeros(1, APPLIED)
    command["frequency"], command["current"] = DRIVE_HZ, DRIVE_A
    tracker.on_applied(Table(0, command))
    tracker.label(gap_m, 0)
    chain.acquire(motion, 0, len(motion.segments))
    page = RigView()
    page.faults.add(fault_table(kind, channel, value, round(FAULT_S * NS_PER_S), 1))
    page.faults.add(fault_table(kind, channel, value, round(FAULT_S * NS_PER_S + samples * NS_PER_S / RATE_HZ), 0))
    worst, off, words, claims = math.nan, 0.0, Counter[str](), 0
    rows = chain.read(chain.ready)
    for first in range(0, len(rows), RATE_HZ):
        end_ns = (first + RATE_HZ) * NS_PER_S // RATE_HZ
        block = rows[first : first + RATE_HZ].copy()
        block["time"] = np.arange(len(block)) / RATE_HZ
        for table in tracker.feed(Table(first * NS_PER_S // RATE_HZ, block)).measurements:
            page.curve.add(table)
            row = table.rows[0]
            if table.stamp_ns < FAULT_S * NS_PER_S:
                continue
            word = row["status"].decode()
            words[f"{word} {row['channel'].decode()}" if row["settled"] != 1 else word] += 1
            if row["settled"] == 1.0:
                truth = true_ratio(gap_m, table.stamp_ns, int(row["cycles"]))
                off = abs(row["transmissibility"] - abs(truth)) / row["transmissibility_uncertainty"]
                turned = abs(np.angle(np.exp(1j * row["phase"]) / truth)) / row["phase_uncertainty"]
                off = max(off, turned)
                worst = max(off, -math.inf if math.isnan(worst) else worst)
        doubts = page.doubts(end_ns)
        says = judge(DRIVING, Seen("measuring" if tracker.state.word == "measuring" else "", age_s=0.0), doubts)[0]
        claims += says == "measured" and (off > WORST_U or (kind != NONE and bool(page.faults.in_force(0, end_ns))))
    limit = math.sqrt(3.0) * float(info["sensitivity_uncertainty"][list(CHANNELS).index(channel)])
    return Outcome(float(worst), words, claims, kind == "gain_error" and size <= limit)


DRIVING = Seen("driving", age_s=0.0)


def fault_table(kind: str, channel: str, value: float, stamp_ns: int, active: int) -> Table:
    """Return the row of `truth/faults` for the start or the end of a fault."""
    row = np.zeros(1, FAULTS)
    row["id"], row["active"], row["value"] = 1, active, value
    row["kind"], row["channel"] = kind.encode(), channel.encode()
    return Table(stamp_ns, row)


def true_ratio(gap_m: float, stamp_ns: int, cycles: int) -> complex:
    """Return X_1 / X_b of the motion itself over the scans of a row."""
    last = round(stamp_ns * RATE_HZ / NS_PER_S)
    scans = np.arange(last + 1 - round(cycles * RATE_HZ / DRIVE_HZ), last + 1)
    per_tick = RATE_HZ // TICKS_PER_S
    motion = steady_motion(gap_m)[1]
    values = motion.quantities(("x_1", "x_b"), scans // per_tick, scans % per_tick / RATE_HZ)
    laser, base = (fit_sine(one, RATE_HZ, DRIVE_HZ, 5).phasors[0] for one in values)
    return complex(laser / base)


def sensors(console: Console) -> bool:
    """Print the matrix of sensor faults; return whether all rows that look good are correct."""
    good, cells = True, dict[tuple[str, str], list[str]]()
    for gap_m in GAPS_M:
        for kind, sizes in ((NONE, (0.0,)), *SENSOR_FAULTS):
            for channel in CHANNELS if kind != NONE else CHANNELS[:1]:
                for size in sizes:
                    found = sensor_fault(kind, channel, size, gap_m)
                    good = good and found.passes
                    verdict = "undetectable: sensitivity" if found.within else "" if found.passes else "WRONG"
                    words = ", ".join(f"{word} {count}" for word, count in found.words.items())
                    what = f"{gap_m * 1e3:g} mm, {kind} {channel} {size:g}"
                    console.print(f"{what}: {found.worst:.2f}, claims {found.claims}; {words} {verdict}")
                    cells.setdefault((kind, channel), []).append(found.cell)
    console.print("\n| fault | channel | 6 mm, weak | 6 mm, strong | no sphere, weak | no sphere, strong |")
    console.print("|---|---|---|---|---|---|")
    for (kind, channel), found_cells in cells.items():
        if kind != NONE:
            console.print(f"| {kind.replace('_', ' ')} | {channel} | {' | '.join(found_cells)} |")
    return good


def main() -> int:
    """Return 0 if no wrong row looked good, no block was lost and everything recovered."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", nargs="?", choices=("sensors", "processes"), help="part to run (default: both)")
    part = parser.parse_args().part
    console = Console(soft_wrap=True, markup=False, highlight=False)
    good = [run(console) for run in (sensors, processes) if part in {None, run.__name__}]
    return 0 if all(good) else 1


def processes(console: Console) -> bool:
    """Print the recovery of the graph; return whether no block was lost."""
    table, lost = TextTable(), 0
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
            # counted by number, as a restarted rig repeats stamps; a recorder acknowledges before it records, too
            acknowledged = Counter({at: n for at, n in graph.acknowledged[number].items() if at >= stamps[0]})
            broken = (acknowledged - Counter(stamps)).total()
            lost += missing + broken
            text = f"recording {number + 1}: {len(stamps)} blocks, {acknowledged.total()} acknowledged"
            table.add_row(text, "", str(missing + broken))
    console.print(table)
    return not lost


if __name__ == "__main__":
    sys.exit(main())
