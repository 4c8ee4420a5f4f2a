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
"""Build of the kernels, next to their sources or in a folder: `python -m impact_rig.kernels.build [FOLDER]`.

    _library.abi3.so   the shared library that Python loads
    impact_rig.o       the same kernels for programs in C, without Python
    impact_rig.h       declarations of the kernels for C

Up-to-date files next to the sources are kept, and copied to the folder if one is given. `--machine aarch64` builds for
another machine, with the cross compiler that the environment variable CC names. `--keep DIR` keeps the translated
kernels, which serve every machine. A release contains the kernels as assembly, which needs no translation.

Numba translates the kernels to LLVM code for the oldest supported CPU, in two parts at the same time. LLVM optimises
each part as a whole (`emit`). The system's C compiler links the parts with kernels.c and, for Python, with library.c.
The build uses Numba's internals, so it needs one exact version of Numba.
"""

from __future__ import annotations

import argparse
import importlib.metadata
import json
import math
import os
import platform
import re
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

from impact_rig import __version__
from impact_rig.kernels import PACKAGE, VARIABLE, code_digest, digest, has_code_of, library
from impact_rig.kernels.header import whole

FOLDER = Path(__file__).parent
ASSEMBLY = FOLDER / "assembly"
"""Folder with the kernels as assembly for each machine of RELEASED; only a released source distribution has it."""
RELEASED = ("x86_64", "aarch64")
STAMP = "sources.json"
OUTPUT, HEADER, OBJECT = "_library.abi3.so", "impact_rig.h", "impact_rig.o"
OTHER_SOURCES = ("emit.py", "kernels.c", "library.c")
PARTS = {
    "mechanics": ("physics.simulation", "physics.function_generator", "rig.interlock", "rig.monitors", "rig.truth"),
    "instruments": ("instruments.chain", "analysis.tracker", "analysis.convergence", "codec"),
}
"""Parts of the kernels, which are translated in parallel: for each, the modules whose import declares its entries."""
CPUS = {"x86_64": "x86-64", "aarch64": "generic", "arm64": "generic"}
"""LLVM's name of the oldest CPU that kernels must run on, by machine.

For a name that does not belong to the machine, LLVM would emit calls of functions that compute in software.
"""
NUMBA = "0.68.1"
"""Version of Numba that translates the kernels; other versions may lack the internal parts that the build uses."""
TELL_S = 5.0
WITHOUT = f"set {VARIABLE}=jit (compiled by Numba at the first start after each change) or =plain (very slow)"


def this_machine() -> str:
    """Return the machine for which this Python builds binaries, such as `x86_64`.

    It is this machine, unless the environment variable _PYTHON_HOST_PLATFORM names another (`linux-aarch64`).
    """
    return sysconfig.get_platform().rpartition("-")[2]


def cpu(machine: str) -> str:
    """Return LLVM's name of the CPU for which kernels are compiled: the oldest supported one of this kind of machine.

    `machine` is a name such as `platform.machine` returns.

    Raises:
        SystemExit: kernels are not supported on such a machine.
    """
    try:
        return CPUS[machine]
    except KeyError:
        raise SystemExit(f"kernels are compiled for {', '.join(CPUS)}, not for {machine}: there, {WITHOUT}") from None


def sources() -> list[Path]:
    """Return the files that determine the library: modules with kernels, their direct imports, and build files."""
    texts = {path: path.read_text(encoding="utf-8") for path in PACKAGE.rglob("*.py")}
    declares = re.compile(r"^from impact_rig\.(kernels|physics\.contact\.law) import", re.MULTILINE)
    holders = {path for path, text in texts.items() if declares.search(text)}
    found = set(holders)
    for holder in holders:
        for module in re.findall(r"^from impact_rig\.([\w.]+) import", texts[holder], re.MULTILINE):
            stem = PACKAGE.joinpath(*module.split("."))
            found |= {stem.with_suffix(".py"), stem / "__init__.py"} & texts.keys()
    return sorted(found | {FOLDER / name for name in OTHER_SOURCES})


def stamps() -> dict[str, tuple[str, str]]:
    """Return the digests of content and code of each source file of the kernels, by its path in the package."""
    return {str(path.relative_to(PACKAGE)): (digest(path), code_digest(path)) for path in sources()}


def compiler() -> list[str]:
    """Return the command of the system's C compiler: `cc`, or the one that the environment variable CC names."""
    return shlex.split(os.environ.get("CC") or "cc")


def symbol(name: str) -> str:
    """Return the name of a kernel in C, such as `ir_physics_event_loop_run_slots` for `physics.event_loop.run`.

    Names that begin with `force.` get no suffix `_slots`, because force functions take their arguments directly.
    """
    plain = f"ir_{name.replace('.', '_')}"
    return plain if name.startswith("force.") else f"{plain}_slots"


def is_built() -> bool:
    """Return whether library, object file and header exist and the library was built from the present sources."""
    return all((FOLDER / name).exists() for name in (HEADER, OBJECT)) and library() is not None


def build(folder: Path = FOLDER, machine: str = "", keep: Path | None = None) -> None:
    """Build library, object file and header of the kernels into a folder, by default next to the sources.

    The progress is printed. Existing files are replaced only if the build succeeds.

    Args:
        folder: destination of the files.
        machine: machine to build for, named as by `platform.machine`; default: `this_machine`.
        keep: folder for the translated kernels (LLVM code), which are used again if the sources have not changed;
            default: a temporary folder. Unused with the assembly of a release.

    Raises:
        SystemExit: the machine is not supported, the C compiler is missing or fails, the kernels cannot be translated
            (for example without the pinned version of Numba), or Python cannot load the new library.
    """
    began = time.monotonic()
    machine = machine or this_machine()
    cpu(machine)
    with tempfile.TemporaryDirectory(prefix="impact_rig_kernels_") as name:
        work = Path(name)
        _compile(["-c", str(FOLDER / "kernels.c"), "-o", str(work / "kernels.o")])  # before a minute of translation
        has_assembly = machine in RELEASED and _is_of_these_sources(ASSEMBLY)
        found = ASSEMBLY if has_assembly else translated(keep or work)
        objects = [str(work / f"{part}.o") for part in PARTS]
        for part, path in zip(PARTS, objects, strict=True):
            if has_assembly:
                _compile(["-c", str(ASSEMBLY / f"{machine}-{part}.s"), "-o", path])
            else:
                Path(path).write_bytes(_emit(found / f"{part}.bc", machine)[0])
        write_tables(found, work)
        together = str(work / OBJECT)
        _compile(["-r", "-nostdlib", str(work / "kernels.o"), str(work / "tables.c"), *objects, "-o", together])
        _compile(["-shared", str(FOLDER / "library.c"), together, "-o", str(work / OUTPUT), "-lm"])
        if machine == platform.machine():
            _check_loads(work / OUTPUT)
        write_header(found, work / HEADER)
        folder.mkdir(parents=True, exist_ok=True)
        for file in (HEADER, OBJECT, OUTPUT):  # the library last: its presence means that the others are present
            new = folder / f".{file}.new"
            new.write_bytes((work / file).read_bytes())
            new.replace(folder / file)  # atomically: a process that runs the old one keeps it
    print(f"kernels for {machine} in {folder}, {time.monotonic() - began:.0f} s")  # noqa: T201


def translated(folder: Path) -> Path:
    """Translate the kernels to LLVM code in `folder`, unless their code is there already, and return `folder`.

    Raises:
        SystemExit: the pinned version of Numba is not installed, or the translation fails.
    """
    if not _is_of_these_sources(folder):
        _check_numba()
        folder.mkdir(parents=True, exist_ok=True)
        (folder / STAMP).unlink(missing_ok=True)
        _translate_all(folder)
        (folder / STAMP).write_text(json.dumps(stamps()), encoding="utf-8")
    return folder


def _is_of_these_sources(folder: Path) -> bool:
    if not (folder / STAMP).exists():
        return False
    known = json.loads((folder / STAMP).read_text(encoding="utf-8"))
    return {PACKAGE / name for name in known} == {*sources()} and all(
        has_code_of(PACKAGE / name, stamp) for name, stamp in known.items()
    )


def _emit(bitcode: Path, machine: str) -> tuple[bytes, str]:
    from impact_rig.kernels.emit import emit  # noqa: PLC0415  # LLVM is there with Numba

    return emit(bitcode, machine)


def write_assembly(keep: Path, folder: Path) -> None:
    """Create `folder` and write the kernels into it as assembly, from which a C compiler builds them without Numba.

    There is one assembly file for each part of the kernels and each machine of `RELEASED`. `folder` must not exist yet.
    `keep` is the folder for the translated kernels (see `translated`).
    """
    found = translated(keep)
    folder.mkdir()
    for part in PARTS:
        for machine in RELEASED:
            text = _emit(found / f"{part}.bc", machine)[1]
            (folder / f"{machine}-{part}.s").write_text(text, encoding="utf-8")
        for name in (f"{part}.names", f"{part}.h", STAMP):
            shutil.copy(found / name, folder)


def _prototype(name: str) -> str:
    """Return the C declaration of the function that the library exports for the kernel `name`.

    WebAssembly requires the exact types of each function.
    """
    if name.endswith(".at_point"):
        return f"void *{symbol(name)}(void *, double, double, double, double, void *)"
    if name.endswith(".at_stages"):
        return f"void *{symbol(name)}(void *, double, void *)"
    return f"int {symbol(name)}(void *, void *)"


def write_header(found: Path, path: Path) -> None:
    """Write the C header for the kernels to the file `path`; `found` is the folder with the translated kernels."""
    path.write_text(whole((found / f"{part}.h").read_text(encoding="utf-8") for part in PARTS), "utf-8")


def write_tables(found: Path, work: Path) -> list[str]:
    """Write the C file `tables.c` into `work`: a table of the kernels' names and addresses. Return the names.

    The file also contains the version of the package and the digests of the sources. `found` is the folder with the
    translated kernels (LLVM code or assembly).
    """
    names = [line for part in PARTS for line in (found / f"{part}.names").read_text().splitlines()]
    declared = "\n".join(f"extern {_prototype(name)};" for name in names)
    rows = "\n".join(f'    {{"{name}", (void *){symbol(name)}}},' for name in names)
    (work / "tables.c").write_text(
        f"""{declared}
typedef struct {{
    const char *name;
    void *address;
}} export;
const export kernel_exports[] = {{
{rows}
    {{0, 0}},
}};
const char kernel_sources[] = {json.dumps(json.dumps(stamps()))};
const char kernel_version[] = {json.dumps(__version__)};
""",
        encoding="utf-8",
    )
    return names


def _check_loads(path: Path) -> None:
    """Check in a separate process that Python can load a library, because the linker accepts undefined functions.

    Raises:
        SystemExit: the library cannot be loaded.
    """
    load = "import importlib.util as u, sys; u.module_from_spec(u.spec_from_file_location('_library', sys.argv[1]))"
    done = subprocess.run([sys.executable, "-c", load, str(path)], capture_output=True, text=True, check=False)  # noqa: S603  # ourselves
    if done.returncode:
        why = done.stderr.strip().rpartition("\n")[2] or f"exit code {done.returncode}"
        raise SystemExit(
            f"the new library of kernels is discarded, as Python cannot load it: {why}; name another C compiler in CC, "
            f"or {WITHOUT}"
        )


def _check_numba() -> None:
    try:
        found = importlib.metadata.version("numba")
    except importlib.metadata.PackageNotFoundError:
        found = "none"
    if found != NUMBA:
        raise SystemExit(
            f"kernels are built by Numba {NUMBA}, found: {found}. Install it (pip install numba=={NUMBA}), build from "
            f"a source distribution, which needs no Numba, or {WITHOUT}"
        )


def _translate_all(work: Path) -> None:
    """Translate all parts of the kernels to LLVM code in `work`, in parallel processes, and print the progress.

    Raises:
        SystemExit: a part failed; its own messages are on stderr.
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
        raise SystemExit(
            f"parts of the kernels could not be translated to LLVM code ({', '.join(failed)}); see the messages above"
        )


def _read(path: Path) -> str:
    return path.read_text() if path.exists() else ""


def _compile(arguments: list[str]) -> None:
    """Call the C compiler with the options of every build and `arguments`.

    Raises:
        SystemExit: there is no compiler, or it fails.
    """
    options = ["-fPIC", "-O2", "-Wall", "-Wextra", f"-I{sysconfig.get_paths()['include']}"]
    try:
        done = subprocess.run([*compiler(), *options, *arguments], check=False)  # noqa: S603  # the user's own compiler
    except OSError as error:
        raise SystemExit(
            f"kernels need a C compiler ({error}): install gcc, name another in CC, or {WITHOUT}"
        ) from None
    if done.returncode:
        raise SystemExit(f"the kernels were not compiled or linked: {compiler()[0]} failed; see its messages above")


def main() -> None:
    """Run the command of this module: build the kernels into a folder.

    If the package's own kernels are up to date and made for the requested machine, they are not built again. They are
    copied if the folder is not the package's own.
    """
    parser = argparse.ArgumentParser(
        description="Build the compiled kernels: a library for Python, and an object file with its header for C. Up-to-"
        "date files are kept, or copied to the folder."
    )
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        default=FOLDER,
        help="folder for library, object file and header (default: the package's own)",
    )
    parser.add_argument(
        "--machine",
        default=this_machine(),
        help=f"machine to build for, one of {', '.join(CPUS)}; another than this one needs its cross compiler in the "
        "environment variable CC (default: this machine, %(default)s)",
    )
    parser.add_argument(
        "--keep",
        type=Path,
        metavar="DIR",
        help="folder that keeps the translated kernels, so that the next build does not translate them again (default: "
        "none is kept)",
    )
    arguments = parser.parse_args()
    if arguments.machine != platform.machine() or not is_built():
        build(arguments.folder, arguments.machine, arguments.keep)
    elif arguments.folder != FOLDER:
        arguments.folder.mkdir(parents=True, exist_ok=True)
        for name in (OUTPUT, HEADER, OBJECT):
            shutil.copy(FOLDER / name, arguments.folder)


if __name__ == "__main__":
    main()
