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
"""`python -m tools.figures`: drawing of every figure; pictures of the lab only if there is a Chromium."""

from __future__ import annotations

import argparse
import itertools
import shutil
import subprocess
import sys
from pathlib import Path

from tools.figures import DRAWN, IMAGES, ROOT, digests, there
from tools.figures.same import difference
from tools.generate import generated

UNCHANGED = 1e-5
"""Tolerance, as a part of the canvas: a figure that differs only by rounding stays as it is committed."""
NEEDS = {"tools/lab_pictures.py": "chromium"}


def write(path: Path, text: str) -> None:
    """Write a drawing that has changed, and report it."""
    if not path.exists() or difference(path.read_text(encoding="utf-8"), text, UNCHANGED):
        path.write_text(text, encoding="utf-8")
        sys.stdout.write(f"{path.relative_to(ROOT)}\n")


def main() -> None:
    """Draw all figures, or those on the command line: pictures, or all of a tool by the stem of its file."""
    parser = argparse.ArgumentParser(prog="python -m tools.figures", description=__doc__)
    stems = {tool: Path(tool.split()[0]).stem for tool in there()}
    known = ", ".join(dict.fromkeys((*DRAWN, *stems.values(), *itertools.chain(*there().values()))))
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"figures to draw (default: all): {known}")
    names = parser.parse_args().names
    for name, draw in DRAWN.items():
        if not names or name in names:
            write(IMAGES / name, draw())
    for path, text in () if names else generated().items():
        if path.parent == IMAGES:
            write(path, text)
    for tool, stem in stems.items():
        program = NEEDS.get(tool)
        if names and not {stem, *there()[tool]} & {*names}:
            continue
        if program and not shutil.which(program):
            sys.stdout.write(f"{tool}: its pictures are kept, because there is no {program}\n")
            continue
        module = tool.split()[0].removesuffix(".py").replace("/", ".")
        subprocess.run([sys.executable, "-m", module, *tool.split()[1:]], cwd=ROOT, check=True)  # noqa: S603  # our own
        digests.write(there()[tool])


if __name__ == "__main__":
    main()
