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
"""Comparison of the bits of fixed runs, under every mask, with the committed ones: `make portability`.

    make portability                           every mask, and other CPUs if qemu-x86_64 (qemu-user) is installed
    make portability ARGS=--write              commit this machine's bits as the reference
    make portability ARGS='--only all'         one mask, or one emulated CPU
    make portability ARGS='--root DIRECTORY'   also an arm64 system with the wheel in /venv; needs root and binfmt_misc

It writes `portable_bits` into build/bench.json: 1 if every digest agrees everywhere, else 0. Masks that change Numba's
code have separate caches, so the first run with each compiles everything.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import attrs
from rich.console import Console
from rich.table import Table

from impact_rig.kernels import digest
from qualification.portability import digests
from qualification.portability.machine import Machine
from qualification.portability.masks import BARE, MASKS, Mask, full_environment
from qualification.portability.runs import INTERPRETED_ELSEWHERE, LONG, SHORT, Run, known

FIGURES = Path("build", "bench.json")
WORK = Path("build", "portability")
"""Caches of compiled code, and error output of the processes."""
EMULATOR = "qemu-x86_64"
WASM, ARM = "wasm32", "aarch64"
INSTALLED = "venv/lib/python3*/site-packages/impact_rig-*.dist-info/RECORD"
EMULATED = ("Nehalem", "EPYC")
"""An Intel CPU without AVX and an AMD one with AVX2 and FMA; NumPy's wheels need at least SSE4.2."""


ALL_RUNS = known((*SHORT, *LONG))


@attrs.frozen
class Outcome:
    """Result of one mask or CPU."""

    name: str  # name of the mask or the CPU
    held: str  # whether the mask took effect
    equal: int  # number of runs whose topics all have the committed digest
    different: dict[str, str]  # the other runs, each with the first topic that differs
    first: str = ""  # where the first of them deviates from the unmasked run of this machine

    @property
    def well(self) -> bool:
        """Return whether the mask took effect and all runs are equal."""
        return self.equal > 0 and not self.different and self.held != "NO"


def main() -> int:
    """Run the comparison; return 0 if all bits are the committed ones."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="rewrite the committed digests with this machine's")
    names = [mask.name for mask in MASKS] + [*EMULATED, WASM, ARM]
    parser.add_argument("--only", choices=names, help="only mask or emulated CPU to run (default: all)")
    parser.add_argument("--root", type=Path, help="root directory of the arm64 system (default: none)")
    arguments = parser.parse_args()
    if arguments.root and not [*arguments.root.glob(INSTALLED)]:
        parser.error(f"no impact_rig in {arguments.root}/venv")
    if arguments.only == ARM and not arguments.root:
        parser.error(f"{ARM} needs --root")
    console = Console()
    with tempfile.TemporaryDirectory(prefix="impact_rig_bits_") as scratch:
        bench = Bench(console, Path(scratch))
        found = bench.record("this machine", full_environment(BARE), ["long", "short"], save=True)
        if arguments.write:
            digests.write(found)
            console.print(f"written: {digests.FILE}")
        outcomes = [bench.judged("this machine", "-", ALL_RUNS, found)]
        bare = bench.machine(full_environment(BARE))
        for mask in MASKS:
            if arguments.only in (None, mask.name):
                outcomes.append(bench.masked(mask, bare))
        for cpu in EMULATED:
            if arguments.only in (None, cpu) and shutil.which(EMULATOR):
                outcomes.append(bench.emulated(cpu, bare))
        if arguments.only in (None, WASM) and all(map(importlib.util.find_spec, ("llvmlite", "wasmtime", "ziglang"))):
            outcomes.append(bench.webassembly())
        if arguments.only in (None, ARM) and arguments.root:
            outcomes.append(bench.arm(arguments.root))
    return report(console, outcomes, complete=arguments.only is None)


class Bench:
    """Runner of one process per mask, which compares the recorded runs."""

    def __init__(self, console: Console, scratch: Path) -> None:
        self._console = console
        self._scratch = scratch
        self._reference = scratch / "reference"
        self._said: list[str] = []

    def machine(self, environment: dict[str, str], prefix: tuple[str, ...] = ()) -> Machine:
        """Return the machine as a process with this environment sees it."""
        command = [*prefix, sys.executable, "-m", "qualification.portability.machine"]
        done = subprocess.run(command, env=environment, check=True, capture_output=True, text=True)
        return Machine(**json.loads(done.stdout))

    def masked(self, mask: Mask, bare: Machine) -> Outcome:
        """Record every run under a mask."""
        environment = full_environment(mask)
        held = mask.verdict(self.machine(environment), bare)
        return self.judged(mask.name, held, ALL_RUNS, self.record(mask.name, environment, ["long", "short"]))

    def emulated(self, cpu: str, bare: Machine) -> Outcome:
        """Record two short runs on another CPU, as plain Python."""
        emulator = (EMULATOR, "-cpu", cpu)
        # otherwise it would restart itself without a mask
        environment = full_environment(BARE) | {"_ROS_WHEELS_BOOTSTRAP_COMPLETE": "1"}
        seen = self.machine(environment, emulator)
        held = "NO" if seen == bare else f"LLVM sees {seen.llvm[0]}"
        found = self.record(cpu, environment | {"IMPACT_RIG_KERNELS": "plain"}, [*INTERPRETED_ELSEWHERE], emulator)
        runs = [run for run in SHORT if run.name in INTERPRETED_ELSEWHERE]
        return self.judged(" ".join(emulator), held, runs, found)

    def webassembly(self) -> Outcome:
        """Record every run with the kernels as WebAssembly."""
        from impact_rig.embedded.wasm import build_wasm  # noqa: PLC0415  # needs LLVM
        from impact_rig.kernels.build import STAMP  # noqa: PLC0415

        module, translated = self._scratch / "rig.wasm", Path("build", "kernels")
        build_wasm(module, translated)
        program = ("qualification.portability.wasm", str(module), str(translated / STAMP))
        environment = full_environment(BARE) | {"IMPACT_RIG_KERNELS": "library"}
        found = self.record(WASM, environment, ["long", "short"], program=program)
        return self.judged(WASM, "wasmtime", ALL_RUNS, found)

    def arm(self, root: Path) -> Outcome:
        """Record every run in an arm64 system, in a process each; another call with the same wheel continues."""
        (installed,) = root.glob(INSTALLED)
        inside = f"root/portability-{digest(installed)[:12]}"
        shutil.copytree("qualification", root / inside / "qualification", dirs_exist_ok=True)
        command = ["chroot", str(root), "env", "-C", f"/{inside}", "IMPACT_RIG_KERNELS=library", "/venv/bin/python"]
        command += ["-m", "qualification.portability.child", "digests.txt"]
        self._said, found = [], digests.Digests()
        for run in ALL_RUNS:
            kept, began = root / inside / f"{run.name}.txt", time.monotonic()
            if not kept.exists() and subprocess.run([*command, run.name], check=False).returncode == 0:
                (root / inside / "digests.txt").rename(kept)
                self._console.print(f"{ARM} {run.name}: {time.monotonic() - began:.0f} s")
            found |= digests.read(kept) if kept.exists() else {}
        return self.judged(ARM, "qemu-aarch64", ALL_RUNS, found)

    def record(
        self,
        name: str,
        environment: dict[str, str],
        runs: list[str],
        prefix: tuple[str, ...] = (),
        save: bool = False,
        program: tuple[str, ...] = ("qualification.portability.child",),
    ) -> digests.Digests:
        """Record runs in a separate process, show its progress, and return the digests; none if it failed."""
        output = self._scratch / "digests.txt"
        output.unlink(missing_ok=True)
        keep = "--save" if save else "--against"
        command = [*prefix, sys.executable, "-m", *program, str(output), *runs, keep]
        command.append(str(self._reference))
        self._said, began = [], time.monotonic()
        WORK.mkdir(parents=True, exist_ok=True)
        with (
            (WORK / f"{name}.log").open("w", encoding="utf-8") as log,
            self._console.status(f"{name}: starting") as status,
            subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=log, text=True) as child,
        ):
            for line in child.stdout or ():
                self._said.append(line.strip())
                status.update(f"{name}: {line.strip()} after {time.monotonic() - began:.0f} s")
        trouble = f", {log.name} says why" if child.returncode else ""
        self._console.print(f"{name}: {time.monotonic() - began:.0f} s{trouble}")
        return digests.read(output) if output.exists() else {}

    def judged(self, name: str, held: str, runs: Sequence[Run], found: digests.Digests) -> Outcome:
        """Compare with the committed digests; all topics of a run that could not be recorded count as different."""
        different = digests.different(digests.read() if digests.FILE.exists() else {}, found)
        recorded = {run for run, _ in found}
        different |= {run.name: "failed" for run in runs if run.name not in recorded}
        said = (line for line in self._said if " differs: " in line or " failed: " in line)
        return Outcome(name, held, len(runs) - len(different), different, next(said, ""))


def report(console: Console, outcomes: list[Outcome], complete: bool) -> int:
    """Print the table, write the figure and return the exit code."""
    table = Table(title=f"{len(ALL_RUNS)} runs against {digests.FILE.name}")
    for heading in ("machine", "took hold", "equal", "different", "first difference from this machine"):
        table.add_column(heading, overflow="fold")
    for one in outcomes:
        different = ", ".join(f"{run} ({topic})" for run, topic in one.different.items())
        table.add_row(one.name, one.held, str(one.equal), different or "-", one.first or "-")
    console.print(table)
    well = all(one.well for one in outcomes)
    if complete:
        figures = json.loads(FIGURES.read_text(encoding="utf-8")) if FIGURES.exists() else {}
        FIGURES.parent.mkdir(exist_ok=True)
        FIGURES.write_text(json.dumps(figures | {"portable_bits": int(well)}, indent=2) + "\n", encoding="utf-8")
    console.print("the same bits everywhere" if well else "[red]not the same bits everywhere[/red]")
    return 0 if well else 1


if __name__ == "__main__":
    sys.exit(main())
