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
"""Runner of the fuzz targets, with a table of their inputs: `make fuzz`, `python -m fuzz --inputs 1000 texts`."""

from __future__ import annotations

import argparse
import atexit
import contextlib
import multiprocessing
import sys
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NoReturn

from coverage import CoverageData
from hypothesis import find, settings
from hypothesis import strategies as st
from rich.console import Console
from rich.table import Table as TextTable

from fuzz.process import PACKAGES, branch_coverage, run_one, targets
from fuzz.target import MEMORY_MIB, Tally, Target, prepared

INPUTS = 10_000


def main() -> int:
    """Run the targets; return 0 if nothing was found."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("targets", nargs="*", help="names of the targets to run (default: all)")
    parser.add_argument("--inputs", type=int, default=INPUTS, help=f"least number per target (default: {INPUTS})")
    parser.add_argument("--seed", type=int, default=0, help="seed of the inputs (default: 0)")
    parser.add_argument(
        "--guided", metavar="TARGET", help="target to fuzz with atheris; libFuzzer's options may follow"
    )
    arguments, rest = parser.parse_known_args()
    if arguments.guided:
        _run_guided(parser, arguments, rest)
    if rest:
        parser.error(f"unrecognized arguments: {' '.join(rest)}")
    chosen = _chosen(parser, arguments.targets)
    # hypothesis makes its table of characters once in each folder, with 200 MiB: not in a process that is measured
    find(st.text(), lambda _: True, settings=settings(database=None))
    console, table, total, reached = Console(), TextTable(), 0, branch_coverage()
    for heading in ("target", "inputs", "refused", "accepted", "slowest [ms]", "memory [MiB]", "wall [s]"):
        table.add_column(heading, justify="left" if heading == "target" else "right")
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), max_tasks_per_child=1) as processes:
        for one in chosen:
            tally, branches = processes.submit(run_one, one.name, arguments.inputs, arguments.seed).result()
            total += tally.inputs
            figures = (tally.inputs, tally.refused, tally.inputs - tally.refused)
            costs = (tally.slowest_s * 1e3, tally.peak_mib, tally.wall_s)
            table.add_row(one.name, *map(str, figures), *(f"{cost:.0f}" for cost in costs))
            if tally.peak_mib > MEMORY_MIB:
                console.print(f"{one.name}: a process occupied {tally.peak_mib:.0f} MiB, more than {MEMORY_MIB:g}")
                console.print(f"since {tally.largest}", markup=False)
                return 1
            console.print(f"{one.name}: {tally.inputs} inputs, nothing found", style="dim")
            found = CoverageData(no_disk=True)
            found.loads(branches)
            reached.get_data().update(found)
    console.print(table)
    console.print(f"{total} inputs, no crash, no hang, no undefined number and nothing accepted silently")
    root = Path(__file__).parents[1]
    reached.report(include=sorted({str(root / module) for one in chosen for module in one.modules}))
    return 0


def _chosen(parser: argparse.ArgumentParser, names: list[str]) -> list[Target]:
    """Return the targets of these names, all without names."""
    known = targets()
    if unknown := set(names) - set(known):
        parser.error(f"targets are {', '.join(known)}; got {', '.join(sorted(unknown))}")
    return [known[name] for name in names or known]


def _run_guided(parser: argparse.ArgumentParser, arguments: argparse.Namespace, rest: list[str]) -> NoReturn:
    """Fuzz one target with libFuzzer, which ends the process."""
    warnings.simplefilter("ignore")  # as in `run_one`
    with _guide() as watching:
        (target,), tally = _chosen(parser, [arguments.guided]), Tally()
        atexit.register(lambda: print(f"{tally.inputs} inputs, {tally.refused} refused"))
        test = prepared(target, INPUTS, 0, tally)
        watching.Setup([sys.argv[0], *arguments.targets, *rest], test.hypothesis.fuzz_one_input)
        watching.Fuzz()


@contextlib.contextmanager
def _guide() -> Iterator[Any]:
    """Let libFuzzer mutate the data from which hypothesis draws, guided by the branches that it reaches."""
    try:
        import atheris  # noqa: PLC0415  # optional: where it installs
    except ImportError:
        sys.exit("atheris is not installed: pip install atheris")
    root = Path(__file__).parents[1]
    # functions compiled by Numba cannot be instrumented
    compiled = [path for path in root.glob("impact_rig*/**/*.py") if "import njit" in path.read_text(encoding="utf-8")]
    names = [".".join(path.relative_to(root).with_suffix("").parts) for path in compiled]
    with atheris.instrument_imports(include=PACKAGES, exclude=names):
        yield atheris


if __name__ == "__main__":
    sys.exit(main())
