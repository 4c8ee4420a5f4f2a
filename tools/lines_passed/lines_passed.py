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
"""Record of the lines of the package that a process executes, from before the first import to its end.

SlipCover hardly slows running code, but importing the instrumented modules costs each process about two seconds more.
The tracer of coverage.py makes a Python before 3.12 nearly twice as slow. The result is stored as data of coverage.py,
which combines and reports it. `kits.measured` selects the programs that are measured.
"""

import atexit
import os
import typing
from pathlib import Path

from coverage import CoverageData
from slipcover import FileMatcher, ImportManager, Slipcover, wrap_pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = [ROOT / name for name in ("impact_rig", "impact_rig_studies", "impact_rig_lab")]


def note(data: str) -> None:
    """Start recording; at the end, a file whose name begins with `data` contains the lines."""
    passed, ours = Slipcover(), FileMatcher(PACKAGES)
    ImportManager(passed, ours).__enter__()
    wrap_pytest(passed, ours)  # it imports by itself what comes with one of its plugins: the complete package
    passed._filter_excluded_lines = lambda _files: None  # type: ignore[method-assign]  # it parses all files again
    os.register_at_fork(after_in_child=passed.signal_child_process)  # a child stores what its parent has not passed
    first = os.getpid()

    def keep() -> None:
        os.chdir(ROOT)  # SlipCover names files relative to the working directory
        found = passed.get_coverage()["files"]
        lines = {str(Path(file).absolute()): one["executed_lines"] for file, one in found.items()}
        if os.getpid() == first:  # including files that no program imports
            lines = {str(file): [] for package in PACKAGES for file in package.rglob("*.py")} | lines
        else:
            lines = {file: passed_here for file, passed_here in lines.items() if passed_here}
        kept = CoverageData(basename=data, suffix=True)
        kept.add_lines(lines)
        kept.write()

    def end(status: int) -> typing.NoReturn:
        keep()
        leave(status)

    leave, os._exit = os._exit, end  # workers of pytest and of campaigns end by it
    atexit.register(keep)
