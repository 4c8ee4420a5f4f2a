# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What was compiled from other sources is never loaded, and what was compiled from these is never thrown away."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import textwrap
from pathlib import Path

import attrs
import pytest

from impact_rig.system import compiled

CALLEE = "from numba import njit\n@njit(cache=True)\ndef inner(x):\n    return x + {}\n"
CALLER = """\
from numba import njit
from package.callee import inner
from package.constants import FACTOR
@njit(cache=True)
def outer(x):
    return inner(x) * FACTOR
"""


@attrs.frozen
class Answer:
    """What a fresh process computed, and whether it had to compile for it."""

    value: int
    compiled: bool
    directory: Path


@attrs.frozen
class Package:
    """A little package with compiled code in two files, a constant, and a file that has nothing to do with it."""

    root: Path

    def write(self, **files: str) -> None:
        for name, text in files.items():
            (self.root / f"{name}.py").write_text(text)

    def outer(self, **environment: str) -> Answer:
        """Call it in a process of its own."""
        script = textwrap.dedent(f"""
            import sys
            from pathlib import Path
            from impact_rig.system.compiled import keep_by_content
            keep_by_content(Path({str(self.root)!r}))
            sys.path.insert(0, {str(self.root.parent)!r})
            from package.caller import outer
            print(outer(1), sum(outer.stats.cache_misses.values()), outer.stats.cache_path)
        """)
        inherited = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
        done = subprocess.run(
            [sys.executable, "-c", script], check=True, capture_output=True, text=True, env=inherited | environment
        )
        value, misses, directory = done.stdout.split(maxsplit=2)
        return Answer(int(value), misses != "0", Path(directory.strip()))


@pytest.fixture
def package(tmp_path: Path) -> Package:
    made = Package(tmp_path / "package")
    made.root.mkdir()
    made.write(__init__="", callee=CALLEE.format(1), caller=CALLER, constants="FACTOR = 1\n", other="")
    return made


def test_edits_reach_their_callers_and_nothing_is_thrown_away(package: Package) -> None:
    """One edit after the other, as in an afternoon's work; every look is a process of its own."""

    def found() -> tuple[int, bool]:
        answer = package.outer()
        return answer.value, answer.compiled

    assert found() == (2, True)
    package.write(other="SOMETHING = 'else'\n", new="")
    os.utime(package.root / "callee.py")
    assert found() == (2, False), "an edit without compiled code"
    package.write(callee=CALLEE.format(10), caller=f"# longer\n{CALLER}")
    os.utime(package.root / "callee.py", ns=(1, 1))  # whatever the clock says
    assert found() == (11, True), "an edit of a callee"
    package.write(constants="FACTOR = 5\n")
    assert found() == (55, True), "a constant that was compiled in"
    package.write(callee=CALLEE.format(1), caller=CALLER, constants="FACTOR = 1\n")
    os.utime(package.root / "caller.py", ns=(1, 1))  # as git does: the content of before, at another time
    assert found() == (2, False), "a branch switch, and back"


def test_old_states_do_not_pile_up(package: Package) -> None:
    directories = []
    for number in range(compiled.KEPT + 2):
        package.write(callee=CALLEE.format(number))
        directories.append(compiled.Cache(package.root).directory)
    there = [directory for directory in directories if directory is not None and directory.exists()]
    assert there == directories[-compiled.KEPT :]


def test_a_state_in_use_outlives_newer_ones(package: Package) -> None:
    """A developer goes back and forth between a branch and passing edits: the branch's code stays."""
    branch = compiled.Cache(package.root).directory
    assert branch is not None
    for number in range(2, compiled.KEPT + 4):
        package.write(callee=CALLEE.format(number))
        assert compiled.Cache(package.root).directory != branch
        package.write(callee=CALLEE.format(1))
        assert compiled.Cache(package.root).directory == branch
    assert branch.exists()


def test_a_package_that_cannot_be_written_keeps_its_code_with_the_user(package: Package, tmp_path: Path) -> None:
    (package.root / "__pycache__").write_text("a file where the directory should be")
    own = tmp_path / "home"
    first, second = (package.outer(XDG_CACHE_HOME=str(own), PYTHONDONTWRITEBYTECODE="1") for _ in range(2))
    assert (first.compiled, second.compiled) == (True, False)
    assert first.directory.is_relative_to(own)


def test_a_directory_of_the_users_choice_is_used(package: Package, tmp_path: Path) -> None:
    assert package.outer(NUMBA_CACHE_DIR=str(tmp_path / "chosen")).directory.is_relative_to(tmp_path / "chosen")


def test_every_compiled_function_is_kept_by_content() -> None:
    """Whoever holds compiled code imports `impact_rig.system.compiled` before, itself or by what it imports."""
    holders = [path for path in compiled.sources() if "import njit" in path.read_text(encoding="utf-8")]
    assert len(holders) > 10
    for holder in holders:
        assert imports_it(holder, set()), holder


def imports_it(path: Path, seen: set[Path]) -> bool:
    """Whether a module of the package imports it when it is itself imported, however far down."""
    seen.add(path)
    names = set()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    if "impact_rig.system.compiled" in names:
        return True
    files = (compiled.ROOT.parent.joinpath(*name.split(".")).with_suffix(".py") for name in names)
    return any(imports_it(file, seen) for file in files if file not in seen and file.is_file())
