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
"""The locked versions fit every supported Python, in three parts, and an installation resumes where it stopped."""

from __future__ import annotations

import argparse
import ast
import functools
import importlib
import importlib.util
import os
import re
import runpy
import subprocess
import sys
import zipfile
from importlib import metadata
from importlib.util import cache_from_source
from pathlib import Path
from types import ModuleType

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.utils import canonicalize_name

pytestmark = pytest.mark.heavy

ROOT = Path(__file__).parents[1]
REQUIREMENTS = ROOT / "requirements"
EXTRAS = {"argcomplete", "distributed", "hypothesis", "pint", "pytest", "rosbags"}
"""Packages that are imported only for users of an extra, which is in the tests' part."""

IN_ORDER = True


def script(name: str) -> ModuleType:
    """Import a script that is in no package."""
    found = importlib.util.spec_from_file_location(name, REQUIREMENTS / f"{name}.py")
    assert found is not None
    module = importlib.util.module_from_spec(found)
    assert found.loader is not None
    found.loader.exec_module(module)
    return module


lock, install = script("lock"), script("install")
LINES = {
    part: [line for line in (REQUIREMENTS / f"{part}.txt").read_text().splitlines() if "==" in line]
    for part in lock.SECTIONS
}
PINS = {part: {(pin := Requirement(line.partition("  #")[0])).name: pin for line in LINES[part]} for part in LINES}


@functools.cache
def installed() -> dict[str, metadata.Distribution]:
    return {canonicalize_name(one.name): one for one in metadata.distributions()}


@functools.cache
def required(name: str) -> list[Requirement]:
    """Return the requirements of a distribution that is installed here."""
    return [Requirement(text) for text in installed()[name].requires or ()]


def versions(*parts: str) -> dict[str, str]:
    return {name: str(pin.specifier)[2:] for part in parts for name, pin in PINS[part].items()}


@pytest.mark.parametrize("python", lock.PYTHONS)
def test_every_pin_supports_every_python(python: str) -> None:
    """Compare with the index at the time of the choice; `make lock ARGS=--check` queries it again."""
    unfit = []
    for line in [line for part in LINES.values() for line in part]:
        pin, asked = Requirement(line.partition("  #")[0]), line.partition("# Python ")[2]
        needed_here = pin.marker is None or pin.marker.evaluate(lock.environment(python))
        if needed_here and not SpecifierSet(asked.replace("any", "")).contains(python):
            unfit.append(line)
    assert unfit == []


@pytest.mark.parametrize("python", lock.PYTHONS)
@pytest.mark.parametrize("part", ["run", "kernels", "test", "docs"])
def test_the_lock_satisfies_every_requirement_of_its_pins(part: str, python: str) -> None:
    """Every requirement of the installed packages, with the markers of each Python, is satisfied by the lock."""
    pinned = versions("run", "wheels", part)
    known = {
        name: required(name)
        for name, version in pinned.items()
        if name in installed() and installed()[name].version == version and name not in lock.UNUSED_REQUIREMENTS_OF
    }
    assert len(known) > 20
    direct = lock.direct()
    begin = [*direct["run"], *direct["wheels"], *direct[part]]
    for name, requirement in lock.needed(begin, known, python).items():
        assert name in pinned, f"{requirement} on Python {python}"
        assert requirement.specifier.contains(pinned[name]), f"{requirement}, but {pinned[name]} is locked"


def test_a_requirement_with_a_marker_is_resolved_for_each_python() -> None:
    """pip evaluates markers for the Python that runs it, not for `--python-version`."""
    known = {"a": [Requirement("b; python_full_version < '3.11.1'"), Requirement("c[x]; python_version >= '3.12'")]}
    known["c"] = [Requirement("d; extra == 'x'"), Requirement("e; extra == 'y'")]
    begin = [Requirement("a")]
    assert lock.needed(begin, known, "3.11.0").keys() == {"a", "b"}
    assert lock.needed(begin, known, "3.11.2").keys() == {"a"}
    assert lock.needed(begin, known, "3.13.0").keys() == {"a", "c", "d"}


def test_the_smallest_part_contains_only_what_the_package_imports() -> None:
    """An installation that only runs the rig has no other costs."""
    imported = set()
    for path in ROOT.glob("impact_rig*/**/*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                imported |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                imported.add(node.module.partition(".")[0])
    imported -= {"numba", "llvmlite"}  # by what builds the kernels, see requirements/kernels.sh
    provided = {name: set(map(canonicalize_name, by)) for name, by in metadata.packages_distributions().items()}
    providers = [
        provided[name]
        for name in imported - EXTRAS - {"impact_rig", "impact_rig_studies", "impact_rig_lab"}
        if name in provided
    ]
    assert {"aiohttp", "zstandard"} < set().union(*providers)
    assert [by for by in providers if not by & versions("run", "wheels").keys()] == []
    unused = {"numba", "pyarrow", "distributed", "mypy", "ruff", "pytest", "mkdocs", "ipython", "pyuff", "hypothesis"}
    assert versions("run", "wheels").keys().isdisjoint(unused)
    assert unused <= versions("kernels", "test", "docs").keys()


@pytest.mark.parametrize("part", ["run", "wheels", "kernels", "test"])
def test_the_stated_size_of_a_part_is_an_upper_bound(part: str) -> None:
    """The size before equal files are stored once must not exceed the stated one either."""
    names = versions(part).keys() & installed().keys()
    if part == "wheels" and not names:
        pytest.skip("ROS 2 is not installed from wheels here")
    files = {str(file.locate()) for name in names for file in installed()[name].files or ()}
    files |= {cache_from_source(file) for file in files if file.endswith(".py")}
    sizes = {(one.st_dev, one.st_ino): one.st_blocks * 512 for one in map(os.lstat, filter(os.path.lexists, files))}
    on_disk_mb = sum(install.size_mb(installed()[name]) for name in names)
    assert max(on_disk_mb, sum(sizes.values()) / 1e6) <= install.ON_DISK_MB[part] <= 1.25 * on_disk_mb


def test_durations_of_the_readme_commands_are_among_the_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each run writes a file; a part that was not run lately is absent, never zero."""
    from benchmarks import start

    monkeypatch.chdir(tmp_path)
    assert start.noted() == {}
    start.NOTED.mkdir(parents=True)
    (start.NOTED / "suite_s").write_text("431\n")  # as the shell of `make test` writes it
    assert start.noted() == {"suite_s": 431.0}
    assert f"{start.NOTED}/$(1)" in (ROOT / "Makefile").read_text(encoding="utf-8")


@pytest.mark.ros
def test_every_benchmark_can_be_imported() -> None:
    """The import of a renamed module, for example, must not be found only by a complete benchmark run."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from benchmarks.__main__ import PARTS

    assert all(callable(importlib.import_module(f"benchmarks.{part}").run) for part in PARTS)


PROGRAMS = sorted(
    str(path.relative_to(ROOT).with_suffix(""))
    for folder in ("benchmarks", "fuzz", "impact_rig", "impact_rig_lab", "impact_rig_studies", "qualification", "tools")
    for path in (ROOT / folder).rglob("*.py")
    if '\nif __name__ == "__main__":\n' in path.read_text(encoding="utf-8")
)


@pytest.mark.ros
@pytest.mark.parametrize("program", [*PROGRAMS, "requirements/lock"])
def test_the_help_of_every_program_prints_its_usage_and_does_nothing_else(
    program: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A request for help must not start the work, such as a release in a folder of the name `--help`."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [program, "--help"])
    monkeypatch.setattr(sys, "path", [*sys.path])
    try:
        runpy.run_path(str(ROOT / f"{program}.py"), run_name="__main__")
    except SystemExit as ended:
        assert not ended.code  # noqa: PT017  # some programs return
    assert "usage:" in (said := capsys.readouterr()).out
    assert said.err == ""
    assert not [*tmp_path.iterdir()]


@pytest.mark.ros
@pytest.mark.parametrize("program", ["benchmarks/__main__", "qualification/fault_matrix"])
def test_a_program_runs_all_its_parts_if_none_is_chosen(program: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Python 3.11 rejects no choice, or a list as default, like a wrong choice."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    parse = argparse.ArgumentParser.parse_known_args

    def parse_nothing(parser: argparse.ArgumentParser, *_: object) -> None:
        parse(parser, [])
        sys.exit(0)

    monkeypatch.setattr(argparse.ArgumentParser, "parse_known_args", parse_nothing)
    with pytest.raises(SystemExit) as ended:
        runpy.run_path(str(ROOT / f"{program}.py"), run_name="__main__")
    assert ended.value.code == 0


# --- An installation: real pip, real environment, three tiny packages -------------------------------------------------


def write_wheel(directory: Path, name: str, version: str = "1.0") -> None:
    info = f"{name}-{version}.dist-info"
    with zipfile.ZipFile(directory / f"{name}-{version}-py3-none-any.whl", "w") as wheel:
        wheel.writestr(f"{name}.py", f"VERSION = {version!r}\n")
        wheel.writestr(f"{info}/METADATA", f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
        wheel.writestr(f"{info}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{info}/RECORD", f"{name}.py,,\n{info}/METADATA,,\n{info}/WHEEL,,\n{info}/RECORD,,\n")


class Checkout:
    """Directory with the scripts of this checkout and its own lock."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.wheels = root / "wheels"
        (root / "requirements").mkdir(parents=True)
        self.wheels.mkdir()
        for script in ("venv.sh", "install.py"):
            (root / "requirements" / script).write_bytes((REQUIREMENTS / script).read_bytes())
        (root / "requirements" / "venv.sh").chmod(0o755)
        self.lock(
            run="inner==1.0",
            wheels="",
            kernels="",
            test='tester==1.0  # Python any\nolder==1.0 ; python_version in "3.9"',
        )
        for name in ("inner", "tester"):
            write_wheel(self.wheels, name)

    def lock(self, **parts: str) -> None:
        for part, text in parts.items():
            (self.root / "requirements" / f"{part}.txt").write_text(f"{text}\n")

    def install(self, *tiers: str, python: str = sys.executable, code: int = 0) -> str:
        """Call the script as make does; return its output."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("PIP_", "PYTHON"))}
        environment |= {"PIP_NO_INDEX": "1", "PIP_FIND_LINKS": str(self.wheels), "PYTHON": python}
        environment |= {"PIP_CONFIG_FILE": os.devnull}
        done = subprocess.run(
            ["requirements/venv.sh", "wheels", ".venv", *tiers],
            cwd=self.root, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False,
        )  # fmt: skip
        assert done.returncode == code, done.stdout
        return done.stdout

    def there(self) -> dict[str, str]:
        (site,) = (self.root / ".venv").glob("lib/python3*/site-packages")
        found = {one.name: one.version for one in metadata.distributions(path=[str(site)])}
        return {name: found[name] for name in ("inner", "tester", "older") if name in found}


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Checkout:
    """One environment for the tests below; each begins with the state that the previous one has left."""
    made = Checkout(tmp_path_factory.mktemp("checkout"))
    said = made.install("run")
    assert "installing 1 of 1 packages (run)" in said
    assert re.search(r"up to \d+ MB on disk", said)
    assert made.there() == {"inner": "1.0"}
    return made


def test_installing_a_further_part_adds_only_the_difference(checkout: Checkout) -> None:
    kept = checkout.root / ".venv" / "kept"
    kept.touch()
    assert "installing 1 of 2 packages (run, test)" in checkout.install("run", "test")
    assert checkout.there() == {"inner": "1.0", "tester": "1.0"}
    assert checkout.install("run", "test") == ""
    assert kept.exists()


def test_a_half_installed_package_is_installed_again_and_the_others_are_kept(checkout: Checkout) -> None:
    checkout.install("run", "test")
    (record,) = (checkout.root / ".venv").rglob("tester-1.0.dist-info/RECORD")
    record.write_text("tester.py,,\n")  # as the wheel has it: pip writes its own line last
    module = record.parents[1] / "tester.py"
    module.write_text("VERSI")
    inner = record.parents[1] / "inner.py"
    before = inner.stat().st_mtime_ns
    assert "installing 1 of 2 packages" in checkout.install("run", "test")
    assert module.read_text() == "VERSION = '1.0'\n"
    assert inner.stat().st_mtime_ns == before


def test_a_new_version_replaces_the_old_one_and_an_absent_one_is_named(checkout: Checkout) -> None:
    checkout.lock(run="inner==2.0")
    said = checkout.install("run", code=1)
    assert "No matching distribution found for inner==2.0" in said
    assert "the same command goes on where this one stopped" in said
    write_wheel(checkout.wheels, "inner", "2.0")
    checkout.install("run")
    assert checkout.there()["inner"] == "2.0"


def test_an_unsuitable_interpreter_is_rejected_in_one_line(tmp_path: Path) -> None:
    old = tmp_path / "python3.10"
    old.write_text('#!/bin/sh\n[ "$1" = --version ] && echo Python 3.10.13 || exit 1\n')
    old.chmod(0o755)
    asked = "impact_rig needs CPython 3.11 to 3.14"
    checkout = Checkout(tmp_path / "checkout")
    for python, found in ((str(old), "is Python 3.10.13"), (str(tmp_path / "none"), "is not there")):
        said = checkout.install("run", python=python, code=1)
        assert said == f"error: {asked}, and {python} {found}: make PYTHON=/path/to/python3.12 ...\n"


def test_files_with_equal_content_are_stored_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ROS wheels hold some libraries under up to eight names."""
    names = {"liba.so": b"same", "sub/liba.so.2": b"same", "libb.so": b"else", "text.py": b"same"}
    for name, content in names.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    install.link_equal_files()
    assert {name: (tmp_path / name).read_bytes() for name in names} == names
    assert (tmp_path / "liba.so").samefile(tmp_path / "sub" / "liba.so.2")
    assert [(tmp_path / name).stat().st_nlink for name in ("libb.so", "text.py")] == [1, 1]


def test_pytest_plugins_of_an_installed_ros_do_not_interfere(tmp_path: Path) -> None:
    """launch_testing of Jazzy has a hook with an argument that newer versions of pytest do not know."""
    names = ("launch_testing", "launch_ros", "launch_pytest")
    (tmp_path / "alien_hooks.py").write_text("def pytest_pycollect_makemodule(path, parent): ...\n")
    metadata_of = tmp_path / "alien-1.0.dist-info"
    metadata_of.mkdir()
    (metadata_of / "METADATA").write_text("Metadata-Version: 2.1\nName: alien\nVersion: 1.0\n")
    lines = ["[pytest11]", *(f"{name} = alien_hooks" for name in names), ""]
    (metadata_of / "entry_points.txt").write_text("\n".join(lines))
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    environment.pop("PYTEST_DISABLE_PLUGIN_AUTOLOAD", None)
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test/impact_rig/test_simtime.py"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_folder_that_holds_a_clone_does_not_hide_the_package(tmp_path: Path) -> None:
    """The clone is called `impact_rig`, too: for Python a folder without `__init__.py` is a namespace package."""
    (tmp_path / "impact_rig").symlink_to(ROOT)
    program = "import impact_rig; print(impact_rig.simulate.__name__)"
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr) == ("simulate\n", "")
