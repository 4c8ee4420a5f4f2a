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
"""End every program at random instants: `python -m qualification.endings`, half an hour; `--times 2 verify`: a moment.

Each program gets SIGINT, as Ctrl-C sends it to its whole group, and SIGTERM, alone, at random instants from when it
takes signals (its first import) to its end, early ones more often; one that has ended by itself before is run again. It
must answer with one line and 128 + the signal's number (nodes: no line and 0, or launch takes it for a crash), leave
no process, and every file must be readable.
`driven` ends rigs that are driven and recorded, half of them by a second SIGINT on top. The table is that of
docs/explanation/reliability.md.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import os
import random
import re
import select
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import IO

import attrs
import yaml
from rich.console import Console
from rich.table import Table as TextTable

from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.errors import ImpactRigError
from impact_rig.recording import open_run
from impact_rig.testing import LocalRig

WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
NODES = ("rig", "analysis", "recorder")
PATIENCE_S, GRACE_S = 40.0, 3.0
PROGRESS = re.compile(r"^.* \d+ of \d+: .*\n", re.MULTILINE)
"""A line of progress, which comes every few seconds where nobody sees a bar."""
LONGEST_S = {"demo": 15.0, "campaign": 8.0}
"""Instants of programs that run for long are drawn from their first seconds, in which everything begins."""
MOST_DRAWS = 5
"""Instants drawn for each ending that is asked for: a program that is never there to be told is not being ended."""
PLAN = "studies:\n  s:\n    frequencies_hz: [8.9, 9.1, 9.3, 9.5]\n    gaps_m: [none, 0.002, 0.004, 0.006]\n"
FEW = "studies:\n  s:\n    frequencies_hz: [8.9, 9.1, 9.3]\n    gaps_m: [none]\n"
"""What reports and identifications are made of."""
SCRIPT = "import sys; from impact_rig.cli import main; sys.exit(main())"


@attrs.define
class Tally:
    """What came of the endings of one program."""

    endings: int = 0  # how many were told to end
    done: int = 0  # how many had ended by themselves before, and do not count
    slowest_s: float = 0.0  # longest time from the signal to the end [s]
    faults: list[str] = attrs.field(factory=list)  # what was not as it must be


# --- one ending ------------------------------------------------------------------------------------------------------


def wait_until_taken(pid: int) -> None:
    """Wait until a process takes SIGTERM: Python itself leaves it to the kernel."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
        if caught and int(caught[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.001)
    raise ImpactRigError(f"process {pid} takes no signals")


def start(words: Sequence[str | Path], folder: Path, error: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start `impact-rig` with these words, in a group of its own, and return when it takes signals."""
    process = subprocess.Popen(  # noqa: S603  # our own program
        [sys.executable, "-c", SCRIPT, *map(str, words)],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=error, cwd=folder, start_new_session=True,
    )  # fmt: skip
    wait_until_taken(process.pid)
    return process


def lasts_s(words: Sequence[str | Path], folder: Path) -> float:
    """Return how long `impact-rig` with these words takes from its first signal on [s]; it must succeed."""
    with (folder / "stderr").open("w+b") as error:
        process = start(words, folder, error)
        began = time.monotonic()
        if process.wait() != 0:
            error.seek(0)
            raise ImpactRigError(f"{words[0]} ended with {process.returncode}: {error.read().decode()[-600:]}")
        return time.monotonic() - began


def end_program(words: Sequence[str | Path], number: int, instant_s: float, folder: Path, tally: Tally) -> None:
    """Run `impact-rig` with these words, send it a signal and look at what is left."""
    before = children()
    with (folder / "stderr").open("w+b") as error:
        process = start(words, folder, error)
        try:
            process.wait(instant_s)
        except subprocess.TimeoutExpired:
            tally.endings += 1
        else:
            tally.done += 1
            return
        began = time.monotonic()
        if number == signal.SIGINT:
            os.killpg(process.pid, number)
        else:
            process.send_signal(number)
        try:
            code = process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait()
        tally.slowest_s = max(tally.slowest_s, time.monotonic() - began)
        error.seek(0)
        said = error.read().decode(errors="replace")
    where = f"{words[0]}, {signal.Signals(number).name} after {instant_s:.3f} s"
    if code == 0 and not PROGRESS.sub("", said):
        tally.endings, tally.done = tally.endings - 1, tally.done + 1  # it was done when the signal came
    elif code != 128 + number or PROGRESS.sub("", said) != f"impact-rig {words[0]}: {WORDS[signal.Signals(number)]}\n":
        tally.faults.append(f"{where}: exit code {code}, {said[-600:]!r}")
    tally.faults += [f"{where}: {fault}" for fault in (*left_behind(before), *unreadable(folder))]


def end_nodes(number: int, instant_s: float, folder: Path, tally: Tally) -> None:
    """Start rig, analysis and recorder as a launch file does, and signal all of them."""
    with isolated_domain() as domain, Processes(domain, folder / "logs") as processes:
        processes.start("rig", {"time.mode": "free_running", "time.peers": ["analysis", "recorder"]})
        processes.start("analysis")
        processes.start("recorder", {"directory": str(folder), "name": "run"})
        for name in NODES:
            wait_until_taken(processes.running[name].pid)
        time.sleep(instant_s)
        _end_all(processes, [number], folder, tally, f"nodes, {signal.Signals(number).name} after {instant_s:.3f} s")


def end_driven(twice_s: float, drive_s: float, folder: Path, tally: Tally) -> None:
    """End a rig that is driven and recorded by SIGINT, and once more `twice_s` later if that is not 0."""
    with isolated_domain() as domain, Processes(domain, folder / "logs") as processes:
        processes.start("rig", {"time.mode": "realtime"})
        processes.start("analysis")
        processes.start("recorder", {"directory": str(folder), "name": "run"})
        with Client(domain, processes=processes) as client:
            client.wait_active(*NODES)
            client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
            client.command(frequency_hz=9.1, current_a=0.52)
            client.spin_for(drive_s)
            numbers = [signal.SIGINT] * (2 if twice_s else 1)
            _end_all(processes, numbers, folder, tally, f"driven, twice after {twice_s:g} s", twice_s)


def _end_all(
    processes: Processes, numbers: Sequence[int], folder: Path, tally: Tally, where: str, pause_s: float = 0.0
) -> None:
    tally.endings += 1
    began = time.monotonic()
    nodes = [processes.running[name] for name in NODES]
    for number in numbers:
        for node in nodes:
            node.signal(number)
        time.sleep(pause_s)
    codes = {node.name: node.wait(PATIENCE_S) for node in nodes}
    tally.slowest_s = max(tally.slowest_s, time.monotonic() - began)
    for node in nodes:
        said = [line for line in node.log.read_text(errors="replace").splitlines() if not line.startswith("[INFO]")]
        if codes[node.name] != 0 or any(said):  # a node that ends well has said so in its log
            tally.faults.append(f"{where}: {node.name} ended with {codes[node.name]}: {said[-15:]}")
    tally.faults += [f"{where}: {fault}" for fault in unreadable(folder)]


# --- what is left ----------------------------------------------------------------------------------------------------


def adopt_orphans() -> None:
    """Make this process the parent of orphaned descendants, so that a forgotten grandchild is seen as well."""
    set_child_subreaper = 36  # <linux/prctl.h>
    ctypes.CDLL(None).prctl(set_child_subreaper, 1, 0, 0, 0)


def children() -> set[int]:
    """Return the processes whose parent this one is."""
    return set(map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()))


def left_behind(before: set[int]) -> Iterator[str]:
    """Yield the processes that outlive their program, and end them; those of `before` are others'."""
    deadline = time.monotonic() + GRACE_S
    for pid in children() - before:
        command = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        descriptor = os.pidfd_open(pid)
        ended, _, _ = select.select([descriptor], [], [], max(0.0, deadline - time.monotonic()))
        os.close(descriptor)
        if not ended:
            yield f"still running: {command}"
            os.kill(pid, signal.SIGKILL)
        os.waitpid(pid, 0)


def unreadable(folder: Path) -> Iterator[str]:
    """Yield the files in a folder that their readers do not take, or that nobody will ever read."""
    for path in sorted(folder.rglob("*")):
        if path.name.endswith((".partial", ".tail")):
            yield f"left: {path.name}"
        read = READERS.get(path.suffix)
        if path.is_file() and read is not None:
            try:
                read(path)
            except (ImpactRigError, ValueError, OSError, yaml.YAMLError, zipfile.BadZipFile) as error:
                yield f"unreadable: {path.name}: {error}"


def _read_run(path: Path) -> None:
    with open_run(path) as run:
        for _ in run.messages():
            pass
    yaml.safe_load(path.with_name("metadata.yaml").read_text())


def _read_ending(path: Path) -> None:
    expected = {".png": b"IEND\xaeB`\x82", ".svg": b"</svg>\n", ".html": b"</html>\n", ".csv": b"\n"}[path.suffix]
    if not path.read_bytes().endswith(expected):
        raise ValueError("it is cut short")


READERS: dict[str, Callable[[Path], object]] = {
    ".mcap": _read_run,
    ".json": lambda path: json.loads(path.read_text()),
    ".yaml": lambda path: yaml.safe_load(path.read_text()),
    ".npz": lambda path: zipfile.ZipFile(path).testzip(),
    **dict.fromkeys((".png", ".svg", ".html", ".csv"), _read_ending),
}


# --- all of them -----------------------------------------------------------------------------------------------------


class Bench:
    """Programs, what they work on, and how long they take.

    Args:
        folder: empty; for everything.
        times: how often each program gets each signal.
        seed: of the instants.
        longest_s: what instants are drawn from [s] by program; the others are run once to see how long they take.
    """

    def __init__(self, folder: Path, times: int, seed: int, longest_s: Mapping[str, float] = LONGEST_S) -> None:
        self.folder, self.times, self._longest_s = folder, times, longest_s
        self._random = random.Random(seed)  # noqa: S311  # instants, not secrets
        self.plan = folder / "plan.yaml"
        self.plan.write_text(PLAN)
        self.programs: dict[str, Callable[[Path], list[str | Path]]] = {
            "demo": lambda into: ["demo", "--output", into / "demo"],
            "campaign": lambda into: ["campaign", self.plan, "--output", into / "campaign"],
            "report": lambda into: ["report", self._campaign(), "--output", into],
            "identify": lambda _: ["identify", self._campaign(), "--without", "reductions"],
            "verify": lambda _: ["verify", self._run()],
            "replay": lambda _: ["replay", self._run(), "--delay", "0.2", "--rate", "2"],
        }

    def end(self, what: str) -> Tally:
        """End one of the programs, `nodes` or `driven`, at its random instants."""
        tally = Tally()
        if what == "driven":
            for _ in range(self.times):
                with self._into() as name:
                    twice_s = self._random.choice([0.0, 0.0, 0.0, 0.02, 0.1, 0.3])
                    end_driven(twice_s, self._random.uniform(0.2, 2.0), Path(name), tally)
            return tally
        longest_s = 10.0 if what == "nodes" else self._longest_s.get(what) or self._lasts_s(what)
        for number in (signal.SIGINT, signal.SIGTERM):
            enough = tally.endings + self.times
            for _ in range(MOST_DRAWS * self.times):
                if tally.endings == enough:
                    break
                instant_s = math.exp(self._random.uniform(math.log(0.005), math.log(longest_s)))
                with self._into() as name:
                    if what == "nodes":
                        end_nodes(number, instant_s, Path(name), tally)
                    else:
                        end_program(self.programs[what](Path(name)), number, instant_s, Path(name), tally)
            else:
                tally.faults.append(f"{what}: {tally.done} had ended before they were told")
        return tally

    def _into(self) -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory(dir=self.folder)

    def _lasts_s(self, what: str) -> float:
        with self._into() as name:
            words = self.programs[what](Path(name))  # makes what it works on
            return lasts_s(words, Path(name))

    def _campaign(self) -> Path:
        directory = self.folder / "finished"
        if not directory.exists():
            plan = self.folder / "finished.yaml"
            plan.write_text(FEW)
            command = [sys.executable, "-c", SCRIPT, "campaign", plan, "--output", directory]
            subprocess.run(command, check=True, capture_output=True, cwd=self.folder)  # noqa: S603  # our own program
        return directory

    def _run(self) -> Path:
        path = self.folder / "recorded"
        if not path.exists():
            rig = LocalRig()
            rig.command(9.1, 0.52)
            rig.run(8.0)
            rig.save(path)
            rig.close()
        return path


def main() -> int:
    """End what was asked for, print the table and what was not as it must be; 1 if there is such a thing."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("programs", nargs="*", help="demo, campaign, report, identify, verify, replay, nodes, driven")
    parser.add_argument("--times", type=int, default=20, help="each signal for each program (default: 20)")
    parser.add_argument("--driven", type=int, default=100, help="endings of a driven rig (default: 100)")
    parser.add_argument("--seed", type=int, default=1, help="of the instants")
    arguments = parser.parse_args()
    adopt_orphans()
    table = TextTable(title="endings by SIGINT and SIGTERM at random instants")
    for heading in ("program", "told to end", "done before", "slowest [s]", "not as it must be"):
        table.add_column(heading, justify="right" if table.columns else "left")
    faults: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        bench = Bench(Path(name), arguments.times, arguments.seed)
        for what in arguments.programs or (*bench.programs, "nodes", "driven"):
            bench.times = arguments.driven if what == "driven" else arguments.times
            tally = bench.end(what)
            faults.update(tally.faults)
            table.add_row(what, f"{tally.endings}", f"{tally.done}", f"{tally.slowest_s:.1f}", f"{len(tally.faults)}")
    Console(markup=False).print(table)
    print(*faults, sep="\n")  # noqa: T201  # a tool talks
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
