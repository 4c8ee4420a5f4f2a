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
"""Library of compiled kernels: it is used, it belongs to these sources, and a call with a wrong type is rejected.

That its bits are those of Numba's own compiler and of plain Python is tested in test_digests.py.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from impact_rig import kernels
from impact_rig.arithmetic.random import Random, fill_normal
from impact_rig.instruments import pieces
from impact_rig.kernels import build, header
from impact_rig.physics import SEGMENT, FunctionGenerator, Simulation, event_loop, state
from impact_rig.physics.function_generator import fill_lines
from impact_rig.physics.state import STATE, X1
from impact_rig.rig.config import RigConfig

ROOT = Path(__file__).parents[3]

needs_library = pytest.mark.skipif(kernels.MODE != "library", reason="kernels run otherwise here")

RIG = """
import sys
{before}
from impact_rig import kernels
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
{law}
rig = Rig(RigConfig(), 0)
rig.accept(9.1, 0.52)
import hashlib
found = hashlib.sha256()
for block in rig.advance({ms} * 1_000_000):
    found.update(block.scan.rows.tobytes())
print(kernels.MODE, found.hexdigest())
"""
WITHOUT_NUMBA = "sys.modules.update(numba=None, llvmlite=None)"
NO_NUMBA_FOUND = """
from importlib import util
find = util.find_spec
util.find_spec = lambda name, *more: None if name == "numba" else find(name, *more)
"""
OWN_LAW = '''
from impact_rig.physics.contact import hunt_crossley as law
exec("""
def own(stiffness, factor, per_v0, turned_at, w, speed):
    hertz = stiffness * w * w * w
    damping = factor * per_v0
    pressing = 1.0 + damping * speed
    return hertz, hertz * damping * speed, 0.4 * hertz * w * w, 3.0 * stiffness * w * w * pressing, hertz * damping
""", vars(law) | {"__name__": "somewhere"}, found := {})
law._hertz_damped = found["own"]
'''


def run(before: str = "", law: str = "", ms: int = 200, **environment: str) -> list[str]:
    program = RIG.format(before=before, law=law, ms=ms)
    done = subprocess.run(
        [sys.executable, "-c", program], env=os.environ | environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return [*done.stdout.split(), done.stderr]


@needs_library
def test_a_rig_runs_without_numba() -> None:
    mode, _, stderr = run(WITHOUT_NUMBA)
    assert (mode, stderr) == ("library", "")


@needs_library
def test_a_cache_of_numba_is_neither_cleaned_up_nor_read(tmp_path: Path) -> None:
    """A start must not delete other directories named `compiled-*` there, which may be the user's own."""
    theirs = [tmp_path / f"compiled-thesis-{number}" / "data.nbi" for number in range(1, 10)]
    for number, file in enumerate(theirs):
        file.parent.mkdir()
        file.write_bytes(b"no pickle, and nothing that may be loaded")
        os.utime(file.parent, (number, number))
    tmp_path.chmod(0o777)
    loaded = "import atexit; atexit.register(lambda: print('numba' in sys.modules))"
    found = run(loaded, NUMBA_CACHE_DIR=str(tmp_path))
    assert (found[0], found[2], found[-1]) == ("library", "False", "")
    assert sorted(tmp_path.rglob("*.nbi")) == theirs
    assert len(list(tmp_path.iterdir())) == len(theirs), "and nothing was put beside them"


@needs_library
def test_a_law_of_another_package_runs_compiled_by_numba_or_as_plain_python() -> None:
    """The same force as in the package gives the same bits, compiled or as plain Python."""
    _, ours, _ = run(ms=500)
    assert run(law=OWN_LAW, ms=500)[:2] == ["library", ours]
    blocked = f"{NO_NUMBA_FOUND}{WITHOUT_NUMBA}"
    mode, plain, stderr = run(blocked, OWN_LAW, ms=500)
    assert (mode, plain) == ("library", ours)
    assert "own runs as plain Python" in stderr


@needs_library
@pytest.mark.parametrize("found", ["", f"{NO_NUMBA_FOUND}{WITHOUT_NUMBA}"], ids=["numba", "plain"])
def test_a_law_that_raises_ends_the_run(found: str) -> None:
    """An exception in a law must end the run at once, with one message, on every processor."""
    raising = OWN_LAW.replace("    hertz = ", "    if w > 1e-4:\\n        raise ValueError('too deep')\\n    hertz = ")
    program = RIG.format(before=found, law=raising.replace("\\n", "\n"), ms=500)
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    said = done.stderr.splitlines()
    assert re.match(r"impact_rig\.errors\.(Simulation|Config)Error: ", said[-1])
    assert sum(line.startswith("Traceback") for line in said) <= 3  # that error, and its causes
    if found:
        assert "the contact force force.somewhere.own raised ValueError: too deep, with the arguments " in said[-1]


@needs_library
def test_a_library_of_other_sources_is_not_loaded_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    built = kernels.library()
    assert built is not None
    assert not capsys.readouterr().err
    monkeypatch.setattr(kernels, "PACKAGE", tmp_path)
    assert kernels.library() is None
    assert "has changed since the kernels were built; run `make kernels`" in capsys.readouterr().err


SOURCE = '''"""A law."""

RATE = 2.0  # measured
"""Rate in 1/s."""


def rise(x: float) -> float:
    """Return the rise."""
    return RATE * x
'''


@pytest.mark.parametrize(
    ("old", "new", "outdated"),
    [
        ("measured", "estimated", False), ("A law.", "The law.", False), ("in 1/s", "[1/s]", False),
        ("Return the", "Compute the", False), ("RATE * x", "(RATE * x)", False),
        ("2.0", "2.5", True), ("2.0", "2", True), ("* x", "+ x", True), ("x: float", "x: int", True),
        ("* x", "*", True),
    ],
)  # fmt: skip
def test_a_change_of_code_outdates_the_library_but_one_of_a_text_does_not(
    tmp_path: Path, old: str, new: str, outdated: bool
) -> None:
    path = tmp_path / "law.py"
    path.write_text(SOURCE, encoding="utf-8")
    stamp = kernels.digest(path), kernels.code_digest(path)
    path.write_text(SOURCE.replace(old, new), encoding="utf-8")
    assert kernels.digest(path) != stamp[0]
    assert kernels.has_code_of(path, stamp) is not outdated
    path.unlink()
    assert not kernels.has_code_of(path, stamp)


@needs_library
@pytest.mark.parametrize("kept", [0.0, 0.05, 0.5, 0.999])
def test_a_truncated_library_is_reported_in_one_line(tmp_path: Path, kept: float) -> None:
    """The system's loader maps pages that do not exist, so the process would end with SIGBUS."""
    whole = next(kernels.PACKAGE.glob("kernels/_library*.so")).read_bytes()
    end_with_one_line(tmp_path, whole[: int(kept * len(whole))])


def test_a_library_that_cannot_be_loaded_is_reported_in_one_line(tmp_path: Path) -> None:
    """A library for another machine must not prevent the import of the package."""
    end_with_one_line(tmp_path, b"\x7fELF, and no more")


def end_with_one_line(tmp_path: Path, library: bytes) -> None:
    """Import the kernels of a copy of the package with this library, and check the message."""
    copied = shutil.copytree(kernels.PACKAGE, tmp_path / "impact_rig", ignore=shutil.ignore_patterns("__pycache__"))
    (copied / "kernels/_library.abi3.so").write_bytes(library)
    code = "from impact_rig import kernels; print(kernels.__file__, kernels.MODE)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
    )  # fmt: skip
    assert done.stdout.split() == [str(copied / "kernels/__init__.py"), "jit" if find_spec("numba") else "plain"]
    assert done.stderr.startswith("impact_rig: the library of kernels cannot be loaded (")
    assert done.stderr.count("\n") == 1


def test_the_target_cpu_follows_from_the_machine() -> None:
    assert [build.cpu(machine) for machine in ("x86_64", "aarch64", "arm64")] == ["x86-64", "generic", "generic"]
    with pytest.raises(
        SystemExit, match="compiled for x86_64, aarch64, arm64, not for riscv64: there, set IMPACT_RIG_KERNELS=jit"
    ):
        build.cpu("riscv64")


@needs_library
@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: fill_normal(np.zeros(4, np.int64), np.zeros(3)), "array 0 must hold dtype\\('uint64'\\)"),
        (lambda: fill_normal(np.zeros(4, np.uint64), np.zeros((3, 1))), "array 1 must have 1 dimensions, got 2"),
        (lambda: fill_normal(np.zeros(4, np.uint64)), "wrong number of arguments, got 1"),
        (lambda: fill_normal(np.zeros(4, np.uint64), np.zeros(3), 1), "wrong number of arguments, got 3"),
        (lambda: fill_normal(np.zeros(4, np.uint64), [0.0]), "no attribute 'dtype'"),
        (lambda: fill_lines(np.zeros(1, SEGMENT), np.zeros(2), "fast"), "must be real number"),
        (lambda: pieces._cut(np.zeros(0, np.int64), np.zeros(0), 0, (1.0, 2.0), ()), "expected a tuple of 3"),
        (lambda: event_loop.run((np.zeros(1, STATE),) * 4, 1, 1, 1, 1, 1), "array 0 must hold"),
    ],
)
def test_a_kernel_rejects_types_that_it_was_not_compiled_for(call: object, words: str) -> None:
    """No kernel is called with a type it was not compiled for: it would write to wrong addresses."""
    with pytest.raises((TypeError, AttributeError), match=words):
        call()


@needs_library
def test_an_array_that_is_not_in_c_order_is_rejected() -> None:
    with pytest.raises(ValueError, match="not C-contiguous"):
        fill_lines(np.zeros(2, SEGMENT), np.zeros(6)[::2], 1.0)


def test_kernels_are_declared_with_types_that_fit_their_functions() -> None:
    for name, one in kernels.entries.items():
        assert one.function.__code__.co_argcount == len(one.arguments), name


@pytest.mark.parametrize("asked", ["quick", "LIBRARY"])
def test_an_unknown_way_to_run_kernels_is_rejected_by_name(asked: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", "import impact_rig.kernels"],
        env=os.environ | {kernels.VARIABLE: asked}, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert f"must be one of library, jit, plain, got '{asked}'" in done.stderr


@needs_library
def test_a_c_program_simulates_the_same_bits(tmp_path: Path) -> None:
    """Ten seconds by examples/c, without Python, compared with the same ten seconds of `Simulation`."""
    if not shutil.which("cc"):
        pytest.skip("no C compiler here")
    example, folder = ROOT / "examples" / "c", Path(kernels.__file__).parent
    built = [str(tmp_path / "ten_seconds"), str(example / "ten_seconds.c"), f"-I{folder}", str(folder / build.OBJECT)]
    subprocess.run(["cc", "-Wall", "-Wextra", "-Werror", "-O1", "-o", *built, "-lm"], check=True)
    subprocess.run([sys.executable, str(example / "write_model.py"), str(tmp_path / "model")], check=True, cwd=ROOT)
    done = subprocess.run([built[0], str(tmp_path / "model")], capture_output=True, text=True, check=True)
    (status, ended, count, x_1), *impacts = (line.split() for line in done.stdout.splitlines())
    assert (status, ended) == ("0", str(event_loop.DONE))

    config = RigConfig()
    drive = FunctionGenerator(config.drive, config.shaker, Random(0))
    drive.set_frequency(9.1)
    drive.set_amplitude(0.52)
    simulation = Simulation(config)
    motion = simulation.advance(drive.segments(1000))
    assert len(motion.impacts) == int(count) > 100
    assert [
        (int(segment), float.fromhex(offset), float.fromhex(impulse)) for segment, offset, impulse in impacts
    ] == motion.impacts[["tick", "offset", "impulse"]].tolist()
    assert float.fromhex(x_1) == simulation._state.y[X1]


def test_the_header_has_the_constants_of_the_kernels() -> None:
    for words in header.CONSTANTS.values():
        module = event_loop if hasattr(event_loop, words[-1]) else state
        assert [getattr(module, word) for word in words] == list(range(len(words)))


@needs_library
def test_the_header_describes_the_fields_of_each_record_separately() -> None:
    """Each field has the description of its own record, even if another record has a field of the same name."""
    text = (Path(kernels.__file__).parent / "impact_rig.h").read_text(encoding="utf-8")
    flight = text.partition("} ir_flight;")[0].rpartition("typedef struct")[2]
    assert "double y[5]; /* structural state where `structure_at` evaluated it last" in flight
    step = text.partition("} ir_contact_step;")[0].rpartition("typedef struct")[2]
    assert "double y[5]; /* scratch: a state of the pair" in step
    assert re.search(r"double correction\[5\]\[5\]; /\* z at the stages", step)
    fields = re.findall(
        r"^    \w+ (\w+)[\[\]\d]*;(.*)$", "".join(re.findall(r"typedef struct \{(.*?)^\}", text, re.M | re.S)), re.M
    )
    assert len(fields) > 150
    assert [name for name, meaning in fields if not meaning] == []
