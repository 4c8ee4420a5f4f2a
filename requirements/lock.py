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
"""Choice of exact versions that serve every supported Python: `make lock`, then run the tests.

    python requirements/lock.py             resolve direct.txt, write a file for each of its sections, check them
    python requirements/lock.py --check     only check, with the package index, that every pin can be installed

pip chooses for the lowest supported Python (`--python-version`), because versions that exist for it exist for later
ones. However, it evaluates environment markers for the Python that runs it. So the requirements are followed here
again, for every supported Python, and pip is run again with those that it has left out.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

HERE = Path(__file__).parent
PYTHONS = ("3.11.0", "3.11.2", "3.12.0", "3.12.3", "3.13.0", "3.14.0")
"""The first patch release of each supported Python, and the ones of Debian 12 and Ubuntu 24.04."""
SECTIONS = ("run", "wheels", "kernels", "test", "docs")
KILTED = "kilted"
"""Section that replaces `wheels` in an environment with ROS 2 Kilted."""
SOURCE_ONLY = "empy"  # pure Python
OF_ROS = {"empy", "lark", "lark-parser", "numpy"}
"""Distributions that an apt-installed Jazzy brings itself: its message classes are compiled against numpy 1.26."""
UNUSED_REQUIREMENTS_OF = ("uplot-python", "fmpy")
"""Requirements that are left out: uplot-python's IPython (40 MB), as only its JavaScript is used, and fmpy's CMake."""
HEADER = f"""\
# Written by lock.py from direct.txt: exact versions, dependencies of dependencies too, and the Pythons they ask for.
--only-binary :all:
--no-binary {SOURCE_ONLY}
"""


def direct() -> dict[str, list[Requirement]]:
    """Return the requirements of direct.txt by section."""
    found: dict[str, list[Requirement]] = {}
    for line in (HERE / "direct.txt").read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            found[line.strip("[]")] = []
        elif line and not line.startswith("#"):
            found[list(found)[-1]].append(Requirement(line))
    return found


def environment(python: str) -> dict[str, str]:
    """Return the values of environment markers on a supported machine."""
    return {
        "python_full_version": python,
        "python_version": python.rpartition(".")[0],
        "implementation_version": python,
        "implementation_name": "cpython",
        "platform_python_implementation": "CPython",
        "platform_machine": "x86_64",
        "platform_system": "Linux",
        "sys_platform": "linux",
        "os_name": "posix",
    }


def needed(asked: list[Requirement], known: dict[str, list[Requirement]], python: str) -> dict[str, Requirement]:
    """Return all requirements of `asked` on one Python: by name, a requirement that asked for it.

    Args:
        asked: requirements to start from.
        known: requirements of each distribution; one that is missing here is listed, but not followed.
        python: full version of Python.
    """
    found: dict[str, Requirement] = {}
    seen: set[tuple[str, str]] = set()
    left = [(requirement, "") for requirement in asked]
    while left:
        requirement, extra = left.pop()
        if requirement.marker and not requirement.marker.evaluate(environment(python) | {"extra": extra}):
            continue
        name = canonicalize_name(requirement.name)
        found.setdefault(name, requirement)
        for wanted in ("", *requirement.extras):
            if (name, wanted) not in seen:
                seen.add((name, wanted))
                left += [(further, wanted) for further in known.get(name, ())]
    return found


def pip(*arguments: str) -> str:
    """Run pip and return its output; its errors go to the terminal."""
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *arguments]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout  # noqa: S603  # own arguments


def try_for(python: str, *arguments: str) -> str:
    """Let pip resolve an installation for another Python, into an empty directory."""
    with tempfile.TemporaryDirectory() as directory:
        options = ["--quiet", "--dry-run", "--ignore-installed", "--target", directory, "--python-version", python]
        return pip("install", *options, *arguments)


def resolve(asked: list[Requirement], directory: Path) -> dict[str, dict[str, Any]]:
    """Return name -> metadata of pip's choice for the lowest supported Python, in an empty environment."""
    pip("wheel", "--quiet", "--no-deps", "--no-binary", SOURCE_ONLY, "--wheel-dir", str(directory), SOURCE_ONLY)
    options = ["--report", "-", "--only-binary", ":all:", "--find-links", str(directory)]
    report = json.loads(try_for(PYTHONS[0], *options, *map(str, asked)))
    return {canonicalize_name(item["metadata"]["name"]): item["metadata"] for item in report["install"]}


def unconditional(requirement: Requirement) -> Requirement:
    """Return a requirement without its marker."""
    extras = f"[{','.join(sorted(requirement.extras))}]" if requirement.extras else ""
    return Requirement(f"{requirement.name}{extras}{requirement.specifier}")


def choose(ros: str = "wheels") -> dict[str, dict[str, str]]:
    """Return section -> name -> the line that pins it, with the ROS 2 of one section."""
    sections = direct()
    sections = {name: sections[name] for name in (*SECTIONS, KILTED) if name == ros or name not in ("wheels", KILTED)}
    asked = [requirement for section in sections.values() for requirement in section]
    with tempfile.TemporaryDirectory() as directory:
        while True:
            chosen = resolve(asked, Path(directory))
            known = {name: list(map(Requirement, data.get("requires_dist", ()))) for name, data in chosen.items()}
            known |= {name: [] for name in UNUSED_REQUIREMENTS_OF}
            left_out = {
                name: requirement
                for python in PYTHONS
                for name, requirement in needed(asked, known, python).items()
                if name not in chosen
            }
            if not left_out:
                break
            asked += map(unconditional, left_out.values())
    pins: dict[str, dict[str, str]] = {}
    for section in sections:
        begin = [*sections["run"], *sections[section]]
        names = set().union(*(needed(begin, known, python) for python in PYTHONS))
        names -= OF_ROS if section == "run" else {*pins["run"], *pins.get(ros, ())}
        pins[section] = {name: pin(name, chosen[name]) for name in names}
    return pins


def pin(name: str, metadata: dict[str, Any]) -> str:
    """Return a line of a lock: the pinned version, its Pythons if not all, and the Pythons that it requires."""
    asked = SpecifierSet(metadata.get("requires_python") or "")
    served = [python for python in PYTHONS if asked.contains(python)]
    minors = " ".join(dict.fromkeys(python.rpartition(".")[0] for python in served))
    marker = "" if len(served) == len(PYTHONS) else f' ; python_version in "{minors}"'
    return f"{name}=={metadata['version']}{marker}  # Python {asked or 'any'}"


def check(parts: Sequence[str]) -> None:
    """Query the package index for every pin of some parts, for every supported Python.

    Raises:
        SystemExit: a pin cannot be installed on one of them; pip has printed which.
    """
    lines = [line for part in parts for line in (HERE / f"{part}.txt").read_text(encoding="utf-8").splitlines()]
    pins = [Requirement(line.partition("  #")[0]) for line in lines if "==" in line]
    for python in PYTHONS:
        served = [str(unconditional(pin)) for pin in pins if not pin.marker or pin.marker.evaluate(environment(python))]
        try:
            try_for(python, "--no-deps", "--only-binary", ":all:", "--no-binary", SOURCE_ONLY, *served)
        except subprocess.CalledProcessError:
            sys.exit(f"these versions do not serve Python {python}")
        print(f"all {len(served)} versions serve Python {python}", flush=True)  # noqa: T201  # a program


def main() -> None:
    """Write the files unless they are only to be checked, and check them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="only check the present versions")
    if not parser.parse_args().check:
        for section, lines in {**choose(), KILTED: choose(KILTED)[KILTED]}.items():
            text = "".join(f"{lines[name]}\n" for name in sorted(lines))
            (HERE / f"{section}.txt").write_text(HEADER + text, encoding="utf-8")
    check(SECTIONS)
    check((KILTED,))


if __name__ == "__main__":
    main()
