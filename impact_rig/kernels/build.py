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
"""Build the shared library of all kernels, next to them or in a folder: `python -m impact_rig.kernels.build [FOLDER]`.

Where there is one of these sources already, it is left, or copied.

Numba translates each entry, and whatever it calls, to LLVM's code once, for a plain CPU of this machine's kind (the
arithmetic is portable, so nothing is lost and the bits are the same). All of it becomes one module, in which LLVM sees
and optimises everything together, once; the system's C compiler links it with library.c. Two processes share the
translation.

This uses parts of Numba that are not its public interface: the build pins its version.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Iterable
from pathlib import Path

from impact_rig.kernels import PACKAGE, VARIABLE, digest, library
from impact_rig.kernels.header import whole

FOLDER = Path(__file__).parent
OUTPUT, HEADER = "_library.abi3.so", "impact_rig.h"
PARTS = {
    "mechanics": ("physics.simulation", "physics.function_generator", "rig.interlock", "rig.monitors", "rig.truth"),
    "instruments": ("instruments.chain", "analysis.tracker", "codec"),
}
"""What is translated side by side: modules whose import declares the entries."""
CPUS = {"x86_64": "x86-64", "aarch64": "generic", "arm64": "generic"}
"""LLVM's name of a plain CPU by machine. LLVM ignores the name of another machine's and emits soft-float calls."""
NUMBA = "0.68.1"
"""The build uses parts of it that other versions may not have."""
TELL_S = 5.0


def cpu(machine: str) -> str:
    """Return the CPU that code is made for on a machine, as `platform.machine` names it.

    Raises:
        SystemExit: the kernels are not made for such a machine.
    """
    try:
        return CPUS[machine]
    except KeyError:
        raise SystemExit(f"kernels are compiled for {' and '.join(CPUS)}, this machine is {machine}") from None


def sources() -> list[Path]:
    """Return the files that decide the library: kernels, contact laws, what these import from, the C code."""
    texts = {path: path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    declares = re.compile(r"^from impact_rig\.(kernels|physics\.contact\.law) import", re.MULTILINE)
    holders = {path for path, text in texts.items() if declares.search(text)}
    found = set(holders)
    for holder in holders:
        for module in re.findall(r"^from impact_rig\.([\w.]+) import", texts[holder], re.MULTILINE):
            stem = PACKAGE.joinpath(*module.split("."))
            found |= {stem.with_suffix(".py"), stem / "__init__.py"} & texts.keys()
    return sorted(found | {FOLDER / "library.c"})


def build(folder: Path = FOLDER) -> None:
    """Build the library into a folder, by default next to the sources; say how far it is.

    Raises:
        SystemExit: no Numba or another one than the build is made for, no C compiler, or one of them failed.
    """
    began = time.monotonic()
    _check_numba()
    with tempfile.TemporaryDirectory(prefix="impact_rig_kernels_") as name:
        work = Path(name)
        _translate_all(work)
        exports = [line for part in PARTS for line in (work / f"{part}.names").read_text().splitlines()]
        (work / "exports.c").write_text(_exports(exports), encoding="utf-8")
        built = work / OUTPUT
        objects = [str(work / f"{part}.o") for part in PARTS]
        _compile([str(FOLDER / "library.c"), str(work / "exports.c"), *objects, "-o", str(built)])
        _check_loads(built)
        folder.mkdir(parents=True, exist_ok=True)
        (folder / HEADER).write_text(whole((work / f"{part}.h").read_text(encoding="utf-8") for part in PARTS), "utf-8")
        new = folder / f".{OUTPUT}.new"
        new.write_bytes(built.read_bytes())
        new.replace(folder / OUTPUT)  # at once: a process that runs the old one keeps it
    print(f"{len(exports)} compiled functions in {folder / OUTPUT}, {time.monotonic() - began:.0f} s")  # noqa: T201


def _check_loads(path: Path) -> None:
    """Load a library in a process of its own: the linker accepts one whose functions exist nowhere.

    Raises:
        SystemExit: it cannot be loaded.
    """
    load = "import importlib.util as u, sys; u.module_from_spec(u.spec_from_file_location('_library', sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", load, str(path)], capture_output=True, text=True, check=False)  # noqa: S603  # ourselves
    if done.returncode:
        raise SystemExit(f"the library of kernels cannot be loaded: {done.stderr.strip().splitlines()[-1]}")


def _check_numba() -> None:
    try:
        found = importlib.metadata.version("numba")
    except importlib.metadata.PackageNotFoundError:
        found = "none"
    if found != NUMBA:
        raise SystemExit(f"kernels are built by Numba {NUMBA}, found: {found}")


def _translate_all(work: Path) -> None:
    """Translate all parts side by side, and tell how far they are.

    Raises:
        SystemExit: a part failed; its own words are on stderr.
    """
    path = os.pathsep.join(filter(None, (str(PACKAGE.parent), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, VARIABLE: "plain", "PYTHONPATH": path}
    command = [sys.executable, "-c", "from impact_rig.kernels.translate import main; main()"]
    running = {
        part: subprocess.Popen([*command, part, str(work)], env=environment)  # noqa: S603  # ourselves
        for part in PARTS
    }
    shown, shown_s = "", -math.inf
    while any(process.poll() is None for process in running.values()):
        time.sleep(0.1)
        done = {part: _read(work / f"{part}.progress") for part in PARTS}
        words = ", ".join(f"{part} {text or 'starts'}" for part, text in done.items())
        if words != shown and time.monotonic() - shown_s > TELL_S:
            shown, shown_s = words, time.monotonic()
            print(f"building kernels: {words}", flush=True)  # noqa: T201
    failed = [part for part, process in running.items() if process.returncode]
    if failed:
        raise SystemExit(f"the kernels of {', '.join(failed)} could not be built: see above")


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def _exports(names: Iterable[str]) -> str:
    """Return the table of what the library holds, and of the sources it is made of."""
    names = list(names)
    stamps = {str(path.relative_to(PACKAGE)): digest(path) for path in sources()}
    declared = "\n".join(f'extern char f{i}[] __asm__("{name}");' for i, name in enumerate(names))
    rows = "\n".join(f'    {{"{name}", f{i}}},' for i, name in enumerate(names))
    return f"""{declared}
typedef struct {{
    const char *name;
    void *address;
}} export;
const export kernel_exports[] = {{
{rows}
    {{0, 0}},
}};
const char kernel_sources[] = {json.dumps(json.dumps(stamps))};
"""


def _compile(arguments: list[str]) -> None:
    """Call the C compiler.

    Raises:
        SystemExit: there is none, or it fails.
    """
    compiler = shlex.split(os.environ.get("CC", "cc"))
    options = ["-shared", "-fPIC", "-O2", "-Wall", "-Wextra", "-Werror", f"-I{sysconfig.get_paths()['include']}"]
    try:
        subprocess.run([*compiler, *options, *arguments, "-lm"], check=True)  # noqa: S603  # the user's own compiler
    except (OSError, subprocess.CalledProcessError) as error:
        raise SystemExit(f"the kernels were not linked: {error}") from None


def main(folder: Path = FOLDER) -> None:
    """Put the library of these sources into a folder: build it, or copy what is there."""
    if library() is None:
        build(folder)
    elif folder != FOLDER:
        folder.mkdir(parents=True, exist_ok=True)
        for name in (OUTPUT, HEADER):
            shutil.copy(FOLDER / name, folder)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
