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
"""Kernels for other machines: properties of the code that the compiler emits."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from kits.shared import shared

from impact_rig.kernels import build

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT))  # the tool is no part of the package

from qualification.portability import digests  # noqa: E402
from qualification.portability.runs import SHORT, known  # noqa: E402

pytest.importorskip("numba")
pytestmark = [pytest.mark.heavy, pytest.mark.timeout(900)]  # translates where `make` has left nothing
EXACT = {"ceil", "floor", "memcpy", "memmove", "memset", "numba_frexp"}
UNREACHED = {"NRT_MemInfo_call_dtor", "numba_gil_ensure", "numba_gil_release", "numba_unpickle"}
"""Functions that kernels.c defines for paths that no kernel takes."""


@pytest.fixture(scope="session")
def translated() -> Path:
    """Return the folder with the translated kernels that `make kernels` keeps."""
    return build.translated(ROOT / "build" / "kernels")


@pytest.fixture(scope="module")
def assembly(translated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the kernels as assembly, as a source distribution contains it."""
    folder = tmp_path_factory.mktemp("kernels") / "assembly"
    build.write_assembly(translated, folder)
    return folder


@pytest.mark.parametrize("part", build.PARTS)
def test_aarch64_neither_contracts_nor_calls_soft_floats(assembly: Path, part: str) -> None:
    """The name of an x86-64 CPU must not reach LLVM here: it would ignore it and emit calls of `__muldf3`."""
    text = (assembly / f"aarch64-{part}.s").read_text(encoding="utf-8")
    assert len(re.findall(r"\tfmul\t", text)) > 500
    assert not re.findall(r"\t(fn?m(?:add|sub)|fml[as])\b", text)
    called = set(re.findall(r"\tbl?\t(\w+)$", text, re.MULTILINE))
    defined = set(re.findall(r"^(\w+):", text, re.MULTILINE))
    unknown = {name for name in called - defined - EXACT - UNREACHED if not name.startswith("Py")}
    assert not unknown


def test_assembly_builds_the_library_without_numba(
    translated: Path, assembly: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assembly from a source distribution becomes a library that knows all kernels."""
    monkeypatch.setattr(build, "ASSEMBLY", assembly)
    monkeypatch.setattr(build, "translated", None)
    build.build(tmp_path / "made")
    load = "s = importlib.util.spec_from_file_location('_library', sys.argv[1]); m = importlib.util.module_from_spec(s)"
    ask = f"import importlib.util, sys; {load}; print(*(name for name in sys.argv[2:] if m.address(name)))"
    names = [line for part in build.PARTS for line in (translated / f"{part}.names").read_text().splitlines()]
    done = subprocess.run(
        [sys.executable, "-c", ask, str(tmp_path / "made" / build.OUTPUT), *names],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == names
    assert len(names) > 20


def test_an_impossible_build_names_the_remedy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build, "NUMBA", "1.2.3")
    with pytest.raises(
        SystemExit, match=r"Numba 1\.2\.3, found: .*pip install numba==1\.2\.3.*source distribution.*=jit"
    ):
        build.build(tmp_path, keep=tmp_path / "keep")
    with pytest.raises(
        SystemExit, match=r"compiled for x86_64, aarch64, arm64, not for riscv64: .*IMPACT_RIG_KERNELS=jit"
    ):
        build.build(tmp_path, "riscv64")
    monkeypatch.setenv("CC", str(tmp_path / "no_compiler"))
    with pytest.raises(SystemExit, match=r"C compiler .*no_compiler.*install gcc, .*IMPACT_RIG_KERNELS=jit"):
        build._compile(["-c", "nothing.c"])
    assert list(tmp_path.glob("*.so")) == []


def test_webassembly_yields_the_committed_bits(
    translated: Path, tmp_path: Path, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """Short runs, with their kernels in wasmtime, as in a page; `make portability` compares all runs."""
    for needed in ("wasmtime", "ziglang", "aiohttp", "uplot"):
        pytest.importorskip(needed)
    from tools import browser_page  # needs LLVM

    module = shared(tmp_path_factory, "rig_page", browser_page.build) / "served" / "rig.wasm"
    found = tmp_path / "digests.txt"
    command = [sys.executable, "-m", "qualification.portability.wasm"]
    command += [str(module), str(translated / build.STAMP), str(found), "short"]
    subprocess.run(command, cwd=ROOT, env={**os.environ, "IMPACT_RIG_KERNELS": "library"}, check=True)
    assert {run for run, _ in digests.read(found)} == {run.name for run in known(SHORT)}
    assert digests.different(digests.read(), digests.read(found)) == {}
