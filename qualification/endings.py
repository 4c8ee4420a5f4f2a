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
"""Endings of every program at random instants: `python -m qualification.endings`; `--times 2 verify` is brief.

Each program gets SIGINT, as Ctrl-C sends it to its whole group, and SIGTERM, sent to it alone. The instants are random
between the first moment at which the program handles signals (its first import) and its end, early ones more often. A
program that has ended by itself before is run again.

A program must answer with one line and 128 + the signal's number. Nodes must end without a line and with 0, or launch
takes it for a crash. No process may be left, and every file must be readable. `driven` ends rigs that are driven and
recorded, half of them with a second SIGINT. The table is shown in docs/explanation/reliability.md.
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
"""A line of progress, printed every few seconds if there is no terminal for a bar."""
LONGEST_S = {"demo": 15.0, "campaign": 8.0}
"""Instants for programs that run for long are drawn from their first seconds, in which everything starts."""
MOST_DRAWS = 5
"""Number of instants drawn per requested ending; a program that always ended before the signal is reported."""
PLAN = "studies:\n  s:\n    frequencies_hz: [8.9, 9.1, 9.3, 9.5]\n    gaps_m: [none, 0.002, 0.004, 0.006]\n"
FEW = "studies:\n  s:\n    frequencies_hz: [8.9, 9.1, 9.3]\n    gaps_m: [none]\n"
"""Campaign for reports and identifications."""
SCRIPT = "import sys; from impact_rig.cli import main; sys.exit(main())"


@attrs.define
class Tally:
    """Result of the endings of one program."""

    endings: int = 0  # number of signals sent
    done: int = 0  # number of runs that had ended by themselves before, which do not count
    slowest_s: float = 0.0  # longest time from the signal to the end [s]
    faults: list[str] = attrs.field(factory=list)  # deviations from the required behaviour


# --- one ending ------------------------------------------------------------------------------------------------------


def wait_until_taken(pid: int) -> None:
    """Wait until a process handles SIGTERM; Python itself leaves it to the kernel."""
    deadline = time.monotonic() + PATIENCE_S
    while time.monotonic() < deadline:
        caught = re.search(r"SigCgt:\s*(\w+)", Path(f"/proc/{pid}/status").read_text())
        if caught and int(caught[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.001)
    raise ImpactRigError(f"process {pid} does not handle signals")


def start(words: Sequence[str | Path], folder: Path, error: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start `impact-rig` with these arguments in its own process group, and return when it handles signals."""
    process = subprocess.Popen(  # noqa: S603  # our own program
        [sys.executable, "-c", SCRIPT, *map(str, words)],
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=error, cwd=folder, start_new_session=True,
    )  # fmt: skip
    wait_until_taken(process.pid)
    return process


def lasts_s(words: Sequence[str | Path], folder: Path) -> float:
    """Return how long `impact-rig` with these arguments runs after it handles signals [s]; it must succeed."""
    with (folder / "stderr").open("w+b") as error:
        process = start(words, folder, error)
        began = time.monotonic()
        if process.wait() != 0:
            error.seek(0)
            raise ImpactRigError(f"{words[0]} ended with {process.returncode}: {error.read().decode()[-600:]}")
        return time.monotonic() - began


def end_program(words: Sequence[str | Path], number: int, instant_s: float, folder: Path, tally: Tally) -> None:
    """Run `impact-rig` with these arguments, send it a signal, and check the result."""
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
        tally.endings, tally.done = tally.endings - 1, tally.done + 1  # it had ended when the signal came
    elif code != 128 + number or PROGRESS.sub("", said) != f"impact-rig {words[0]}: {WORDS[signal.Signals(number)]}\n":
        tally.faults.append(f"{where}: exit code {code}, {said[-600:]!r}")
    tally.faults += [f"{where}: {fault}" for fault in (*left_behind(before), *unreadable(folder))]


def end_nodes(number: int, instant_s: float, folder: Path, tally: Tally) -> None:
    """Start rig, analysis and recorder as a launch file does, and send a signal to all of them."""
    with isolated_domain() as domain, Processes(domain, folder / "logs") as processes:
        processes.start("rig", {"time.mode": "free_running", "time.peers": ["analysis", "recorder"]})
        processes.start("analysis")
        processes.start("recorder", {"directory": str(folder), "name": "run"})
        for name in NODES:
            wait_until_taken(processes.running[name].pid)
        time.sleep(instant_s)
        _end_all(processes, [number], folder, tally, f"nodes, {signal.Signals(number).name} after {instant_s:.3f} s")


def end_driven(twice_s: float, drive_s: float, folder: Path, tally: Tally) -> None:
    """End a driven and recorded rig by SIGINT, and send a second one `twice_s` later if that is not 0."""
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
    """Make this process the parent of orphaned descendants, so that a forgotten grandchild is found as well."""
    set_child_subreaper = 36  # <linux/prctl.h>
    ctypes.CDLL(None).prctl(set_child_subreaper, 1, 0, 0, 0)


def children() -> set[int]:
    """Return the child processes of this process."""
    return set(map(int, Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()))


def left_behind(before: set[int]) -> Iterator[str]:
    """Yield the processes that outlive their program, and end them; those in `before` do not count."""
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
    """Yield the files in a folder that their readers reject, or that are left over and will never be read."""
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
    """Runner of the programs, with their input files and their running times.

    Args:
        folder: an empty folder for all files.
        times: number of each signal per program.
        seed: seed of the instants.
        longest_s: range of the instants [s] by program; other programs are run once to measure how long they take.
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
        """End one of the programs, or `nodes` or `driven`, at its random instants."""
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
                tally.faults.append(f"{what}: {tally.done} had ended before the signal")
        return tally

    def _into(self) -> tempfile.TemporaryDirectory[str]:
        return tempfile.TemporaryDirectory(dir=self.folder)

    def _lasts_s(self, what: str) -> float:
        with self._into() as name:
            words = self.programs[what](Path(name))  # creates its input files
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
    """End the requested programs, and print the table and the deviations; return 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("programs", nargs="*", help="programs, also nodes and driven (default: all)")
    parser.add_argument("--times", type=int, default=20, help="number of each signal per program (default: 20)")
    parser.add_argument("--driven", type=int, default=100, help="endings of a driven rig (default: 100)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the instants (default: 1)")
    arguments = parser.parse_args()
    adopt_orphans()
    table = TextTable(title="endings by SIGINT and SIGTERM at random instants")
    for heading in ("program", "endings", "done before", "slowest [s]", "deviations"):
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
