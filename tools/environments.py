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
"""Virtual environments made from the installed distributions of this one, without a network and within seconds."""

from __future__ import annotations

import functools
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable
from importlib.metadata import Distribution, PackageNotFoundError, distribution, distributions
from pathlib import Path

from packaging.requirements import Requirement

from tools.doc_paths import ROOT

PIN = re.compile(r"^([\w.-]+)==", re.MULTILINE)
SCRIPT = f"#!{sys.prefix}/bin/".encode()


def pinned(part: str) -> list[str]:
    """Return the names of a file of requirements/."""
    return PIN.findall((ROOT / "requirements" / f"{part}.txt").read_text(encoding="utf-8"))


def canonical(name: str) -> str:
    """Return the name of a distribution in the form in which package indexes compare it."""
    return re.sub(r"[-_.]+", "-", name).lower()


def closure(requirements: Iterable[str]) -> set[str]:
    """Return the canonical names of distributions and of their requirements, as far as they are installed here."""
    found: dict[str, set[str]] = {}
    waiting = [Requirement(one) for one in requirements]
    while waiting:
        one = waiting.pop()
        name = canonical(one.name)
        extras = {"", *one.extras}
        if extras <= found.get(name, set()):
            continue
        found[name] = extras | found.get(name, set())
        try:
            requires = _requirements(name)
        except PackageNotFoundError:  # needed on another Python or platform only
            del found[name]
            continue
        waiting += [
            other
            for other in requires
            if other.marker is None or any(other.marker.evaluate({"extra": extra}) for extra in found[name])
        ]
    return set(found)


@functools.cache
def _requirements(name: str) -> list[Requirement]:
    return [Requirement(text) for text in distribution(name).requires or ()]


def assemble(venv: Path, names: Iterable[str]) -> None:
    """Make a virtual environment with links to the files of some installed distributions only.

    A folder that belongs to one distribution alone is linked as a whole.
    """
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(venv)], check=True)  # noqa: S603  # ours
    site = venv / Path(distribution("attrs").locate_file("")).relative_to(sys.prefix)
    for one in map(distribution, names):
        own = Path(one.locate_file(""))
        files = [(file, file.partition("/")[0]) for file in _files(one)]
        for file in dict.fromkeys(top if _tops()[top] == 1 else file for file, top in files):
            source, target = Path(os.path.normpath(own / file)), site / file  # scripts are at ../../../bin
            if target.is_symlink() or target.exists() or not source.exists():
                continue
            target.parent.mkdir(parents=True, exist_ok=True)
            if source.suffix == ".py" and (compiled := source.parent / "__pycache__").is_dir():
                _link(target.parent / "__pycache__", compiled)
            if source.parent == Path(sys.prefix, "bin") and source.read_bytes().startswith(SCRIPT):
                target.write_bytes(source.read_bytes().replace(SCRIPT, f"#!{venv}/bin/".encode(), 1))
                target.chmod(0o755)
            elif source.parent.name != "__pycache__":
                _link(target, source)


def _files(one: Distribution) -> list[str]:
    """Return the files of a distribution, relative to where it is installed."""
    listed = one.read_text("RECORD")  # `files` takes seconds for all of them
    if listed is None:
        return [str(file) for file in one.files or ()]
    return [line.rsplit(",", 2)[0].strip('"') for line in listed.splitlines()]


@functools.cache
def _tops() -> Counter[str]:
    """Return in how many distributions each file or folder next to the packages occurs."""
    return Counter(top for one in distributions() for top in {file.partition("/")[0] for file in _files(one)})


def _link(target: Path, source: Path) -> None:
    if not target.is_symlink() and not target.exists():
        target.symlink_to(source)


def install(venv: Path, wheel: Path) -> None:
    """Install a wheel without its requirements, with this environment's pip, which `--python` would start twice."""
    program = distribution("pip").locate_file("pip")  # importing it would change how distutils is found
    command = [str(venv / "bin" / "python"), str(program), "install", "--quiet"]
    subprocess.run([*command, "--no-deps", "--no-index", "--no-compile", str(wheel)], check=True)  # noqa: S603  # ours
