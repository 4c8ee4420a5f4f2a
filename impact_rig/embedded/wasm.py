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
"""Build of the kernels and rig.c as WebAssembly: `python -m impact_rig.embedded.wasm FILE` (pip install ziglang).

The WebAssembly module imports one function, with which libc fills its stack guard. It exports the functions of rig.h,
every kernel under its name in impact_rig.h, `impact_rig_address` and `malloc`. The address of a kernel is its index in
the module's table of functions.
"""

from __future__ import annotations

import argparse
import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

import llvmlite

from impact_rig.embedded.fmu import HERE
from impact_rig.kernels.build import FOLDER, HEADER, PARTS, symbol, translated, write_header, write_tables
from impact_rig.kernels.emit import WASM, emit
from impact_rig.system.files import atomic_write

ZIG = [sys.executable, "-m", "ziglang", "cc", "-target", "wasm32-wasi", "-mexec-model=reactor"]
RIG = (
    *("new", "free", "reset", "command", "set_gap", "advance", "scans", "channels", "channel_name", "sample"),
    *("contact", "tick", "tick_s", "gap", "impacts", "state_size", "save", "restore"),
)
"""Functions of rig.h that the module exports, without their prefix `ir_rig_`."""


def build_wasm(path: Path, keep: Path) -> None:
    """Build the kernels and rig.c as one WebAssembly module.

    Args:
        path: path of the module to write.
        keep: folder in which the translated kernels and their object files are kept for the next build, which reuses
            them if the sources have not changed.

    Raises:
        SystemExit: the kernels cannot be translated.
        CalledProcessError: ziglang is missing, or it fails.
    """
    found = translated(keep)
    with tempfile.TemporaryDirectory(prefix="impact_rig_wasm_") as name:
        work = Path(name)
        names = write_tables(found, work)
        write_header(found, work / HEADER)
        objects = [_emitted(found, part) for part in PARTS]
        exports = [symbol(one) for one in names if not one.startswith("force.")]
        exports += [f"ir_rig_{one}" for one in RIG] + ["impact_rig_address", "malloc"]
        sources = [FOLDER / "kernels.c", work / "tables.c", HERE / "rig.c"]
        options = ["-O2", "-ffp-contract=off", "-fno-stack-protector", f"-I{work}", "-Wl,--strip-all"]
        options += [f"-Wl,--export={one}" for one in exports]
        files = map(str, [*sources, *objects])
        subprocess.run([*ZIG, *options, *files, "-lm", "-o", str(path)], check=True)  # noqa: S603  # our own


def _emitted(found: Path, part: str) -> Path:
    """Return the object file of a part; it is kept in `found` until the part or `emit` changes."""
    code = found / f"{part}.bc"
    made_by = (FOLDER / "emit.py").read_bytes() + llvmlite.__version__.encode()
    key = hashlib.sha256(code.read_bytes() + made_by).hexdigest()[:16]
    path = found / f"{part}-{WASM}-{key}.o"
    if not path.exists():
        for former in found.glob(f"{part}-{WASM}-*.o"):
            former.unlink(missing_ok=True)
        with atomic_write(path) as file:
            file.write(emit(code, WASM)[0])
    return path


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", type=Path, help="module to write, such as rig.wasm")
    build_wasm(parser.parse_args().file, Path("build", "kernels"))
