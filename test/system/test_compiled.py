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
    told: str


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
        return Answer(int(value), misses != "0", Path(directory.strip()), done.stderr)


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


def test_only_what_was_made_here_is_deleted(package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user's own directory may be named like ours, and hold the same file that backups look for."""
    place = tmp_path / "chosen"
    own = [place / f"compiled-thesis-{number}" for number in range(9)] + [
        place / f"compiled-{number:016x}" for number in range(9)
    ]
    for directory in own:
        directory.mkdir(parents=True)
        (directory / "CACHEDIR.TAG").write_text(compiled.MARK.splitlines()[0])
        (directory / "chapter.tex").write_text("years of work")
        os.utime(directory, ns=(1, 1))
    linked = place / f"compiled-{99:016x}"
    linked.symlink_to(tmp_path / "elsewhere")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "CACHEDIR.TAG").write_text(compiled.MARK)
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(place))
    made = []
    for number in range(compiled.KEPT + 2):
        package.write(callee=CALLEE.format(number))
        made.append(compiled.Cache(package.root).directory)
    assert [(directory / "chapter.tex").read_text() for directory in own] == ["years of work"] * len(own)
    assert (linked / "CACHEDIR.TAG").exists()
    assert [directory for directory in made if directory is not None and directory.exists()] == made[-compiled.KEPT :]


def plant(directory: Path, proof: Path) -> None:
    """Put a payload in place of all indices of compiled functions, which says so once it is run."""
    proof.unlink(missing_ok=True)
    payload = f"cbuiltins\nexec\n(Vopen({str(proof)!r}, 'w')\ntR.".encode()
    for index in directory.rglob("*.nbi"):
        index.write_bytes(payload)


def test_code_that_others_could_have_written_is_not_loaded(package: Package, tmp_path: Path) -> None:
    """Nor kept, where every place is open to others; one line says so."""
    chosen, proof = tmp_path / "chosen", tmp_path / "proof"
    first = package.outer(NUMBA_CACHE_DIR=str(chosen))
    plant(chosen, proof)
    package.outer(NUMBA_CACHE_DIR=str(chosen))
    assert proof.exists()  # this is how it would be run
    plant(chosen, proof)
    chosen.chmod(0o777)
    again = package.outer(NUMBA_CACHE_DIR=str(chosen))
    assert (first.value, again.value, again.compiled) == (2, 2, True)
    assert again.told == f"compiled code is not kept: nobody but this user may be able to write {chosen}\n"
    assert not again.directory.exists()
    assert not proof.exists()


def test_another_place_is_chosen_where_others_can_write(
    package: Package, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    beside = compiled.Cache(package.root).directory
    assert beside is not None
    assert beside.parent == package.root / "__pycache__"
    for opened in (beside, beside.parent):
        opened.chmod(0o777)
        other = compiled.Cache(package.root).directory
        assert other is not None
        assert other.is_relative_to(tmp_path / "home")
        opened.chmod(0o755)
    assert compiled.Cache(package.root).directory == beside


@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives directories away")
def test_a_directory_of_somebody_else_is_not_used(package: Package, tmp_path: Path) -> None:
    first = compiled.Cache(package.root).directory
    assert first is not None
    assert compiled.is_private(first)
    os.chown(first, 65534, -1)
    assert not compiled.is_private(first)
    os.chown(first, 0, -1)
    os.chown(first.parent, 65534, -1)  # its owner may put another one in its place
    assert not compiled.is_private(first)


def test_a_directory_below_one_that_is_shared_as_tmp_is_private(tmp_path: Path) -> None:
    shared, own = tmp_path / "shared", tmp_path / "shared" / "own"
    own.mkdir(mode=0o700, parents=True)
    shared.chmod(0o777)
    assert not compiled.is_private(own)
    shared.chmod(0o1777)
    assert compiled.is_private(own)
    (shared / "linked").symlink_to(own)
    assert not compiled.is_private(shared / "linked")


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
