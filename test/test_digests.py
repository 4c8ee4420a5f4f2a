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
"""This machine gives the committed bits: compiled, with the libraries masked, and as plain Python."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import attrs
import numpy as np
import pytest
from kits.measured import measured
from rich.console import Console

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # the tool is no part of the package

from qualification.portability import __main__ as command  # noqa: E402
from qualification.portability import digests  # noqa: E402
from qualification.portability.masks import BARE, LIBRARIES, LLVM_GENERIC, Mask, full_environment  # noqa: E402
from qualification.portability.runs import LONG, QUICK, SHORT, known  # noqa: E402

RUNS = known((*LONG, *SHORT))
pytestmark = pytest.mark.timeout(900)  # on a busy machine with an empty cache the first of them compiles for minutes


@attrs.frozen
class Recorded:
    """Digests of a process, and its lines about differences."""

    digests: digests.Digests
    said: dict[str, str]

    def assert_committed(self) -> None:
        different = digests.different(digests.read(), self.digests)
        assert different == {}, {run: self.said.get(run, "as this machine") for run in different}


def record(directory: Path, mask: Mask, *arguments: str, **environment: str) -> Recorded:
    """Compute the digests in a separate process; report where runs differ from the kept ones."""
    output = directory / f"{mask.name}{len(list(directory.iterdir()))}.txt"
    command = [sys.executable, "-m", "qualification.portability.child", str(output), *arguments]
    found = full_environment(mask) | environment
    if environment.get("IMPACT_RIG_KERNELS") == "plain":  # of compiled code coverage sees nothing
        found = measured(found)
    done = subprocess.run(command, cwd=ROOT, env=found, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    said = (line.partition(" differs: ")[::2] for line in done.stdout.splitlines() if " differs: " in line)
    return Recorded(digests.read(output), dict(said))


@pytest.fixture(scope="module")
def directory(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("bits")


@pytest.fixture(scope="module")
def compiled(directory: Path) -> Recorded:
    """Every run, on this machine as it is; the rows are kept."""
    return record(directory, BARE, "long", "short", "--save", str(directory / "rows"))


def test_this_machine_reproduces_the_committed_digests(compiled: Recorded) -> None:
    assert {run for run, _ in compiled.digests} == {run.name for run in RUNS}
    compiled.assert_committed()


def test_no_bit_depends_on_a_library(compiled: Recorded, directory: Path) -> None:
    """The masks make OpenBLAS, NumPy and glibc use the code for an old CPU."""
    record(directory, LIBRARIES, "long", "short", "--against", str(directory / "rows")).assert_committed()


@pytest.mark.slow
def test_no_bit_depends_on_the_compiler(compiled: Recorded, directory: Path) -> None:
    """Numba compiles for a CPU without vectors or fused multiply-add."""
    masked = record(directory, LLVM_GENERIC, "long", "short", "--against", str(directory / "rows"))
    masked.assert_committed()


def test_plain_python_yields_the_compiled_bits(directory: Path) -> None:
    """A kernel computes what its Python text says, so debuggers and coverage see the same physics."""
    compiled = record(directory, BARE, "quick", "--save", str(directory / "quick"))
    plain = record(directory, BARE, "quick", "--against", str(directory / "quick"), IMPACT_RIG_KERNELS="plain")
    assert {run for run, _ in plain.digests} == {run.name for run in known(QUICK)}
    assert {run.name for run in QUICK if run.seconds} == {run for run, topic in plain.digests if topic == "daq/scan"}
    assert plain.said == {}
    assert plain.digests == compiled.digests


@pytest.mark.slow
def test_plain_python_yields_the_committed_bits(compiled: Recorded, directory: Path) -> None:
    plain = record(directory, BARE, "short", "--against", str(directory / "rows"), IMPACT_RIG_KERNELS="plain")
    assert {run for run, _ in plain.digests} == {run.name for run in known(SHORT)}
    assert plain.said == {}
    assert plain.digests.items() <= compiled.digests.items()


def test_the_committed_digests_cover_exactly_the_runs() -> None:
    """No run is left out, and no digest is left over; laws that are not finished have no line yet."""
    header = digests.FILE.read_text(encoding="utf-8").splitlines()
    assert [line for line in header if line.startswith("#")] == digests.HEADER.splitlines()
    committed = digests.read()
    assert {run for run, _ in committed} == {run.name for run in RUNS}
    assert all({(run.name, "daq/scan"), (run.name, "rig/journal")} <= committed.keys() for run in RUNS if run.seconds)
    hits = {run for run, topic in committed if topic == "truth/impacts"}
    assert {run.name for run in RUNS} - hits == {"no_sphere", "short_no_sphere", "short_contacts"}


def test_one_changed_bit_changes_a_digest_and_is_found() -> None:
    rows = np.zeros(5, [("time", "f8"), ("status", "u1")])
    other = rows.copy()
    other["time"][3] = -0.0
    assert digests.digest(rows) != digests.digest(other)
    found = digests.different({("run", "daq/scan"): digests.digest(rows)}, {("run", "daq/scan"): digests.digest(other)})
    assert found == {"run": "daq/scan"}
    assert digests.first_difference({"daq/scan": rows}, {"daq/scan": other}) == (
        "daq/scan row 3 of 5, time: -0.0, not 0.0"
    )
    assert digests.first_difference({"daq/scan": rows}, {"daq/scan": rows.copy()}) == ""


def test_written_digests_are_read_back(tmp_path: Path) -> None:
    one = {("default", "truth/impacts"): digests.digest(np.arange(3.0))}
    digests.write(one, tmp_path / "digests.txt")
    assert digests.read(tmp_path / "digests.txt") == one
    missing = digests.different(one, {("default", "daq/scan"): digests.digest(np.arange(3.0))})
    assert missing == {"default": "daq/scan"}, "a topic that is not there at all is a difference"
    assert os.fspath(digests.FILE.relative_to(ROOT)) == "test/data/digests.txt"


def test_the_figure_states_whether_all_agree_and_keeps_other_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    figures = tmp_path / "bench.json"
    figures.write_text('{"cold_start_s": 1.5}')
    monkeypatch.setattr(command, "FIGURES", figures)
    good = command.Outcome("all", "yes", len(RUNS), {})
    for outcome, well in [
        (good, True),
        (attrs.evolve(good, different={"default": "daq/scan"}), False),
        (attrs.evolve(good, held="NO"), False),
        (attrs.evolve(good, equal=0), False),
    ]:
        code = command.report(Console(quiet=True), [good, outcome], complete=True)
        assert (code == 0) == well
        assert json.loads(figures.read_text()) == {"cold_start_s": 1.5, "portable_bits": int(well)}
    command.report(Console(quiet=True), [good], complete=False)
    assert json.loads(figures.read_text())["portable_bits"] == 0, "one mask alone proves nothing"
