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
"""Pytest plugin: fixtures that start and end rigs, and keep the run of every failed test as MCAP.

With `scope="module"` or `scope="session"`, `ros_rig` starts a rig for the first test of that module or session, and
resets it for each later test that asks for a rig with the same arguments. Rigs in the test's process are always new.

Pytest loads it through its entry point wherever the package is installed, so it imports neither rclpy nor numba; the
names of `testing` import them when a fixture is used.

| fixture | value |
|---|---|
| `virtual_rig` | function that starts a rig in the test's process, without ROS: see `LocalRig` |
| `virtual_rig_with_nodes` | function that starts such a rig that also runs ROS nodes: see `LocalRigWithNodes` |
| `ros_rig` | function that starts a rig on its own ROS domain: see `RosRig` |
| `golden` | comparison with golden data next to the test file: see `Golden` |
"""

from __future__ import annotations

import contextlib
import itertools
import re
import shutil
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any, TypeVar  # Any: arguments of a rig

import pytest

from impact_rig import testing

DEFAULT_DIRECTORY = "failed_runs"
_RIGS = pytest.StashKey[list["testing.RigDriver"]]()
_SHARED = pytest.StashKey[dict[str, tuple[Any, Any]]]()  # arguments -> rig and its configuration at the start
R = TypeVar("R", bound="testing.RigDriver")
_UNSAFE = re.compile(r"[^\w.-]+")


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options `--rig-runs` and `--rig-update-golden` and the ini setting `rig_runs` to pytest."""
    group = parser.getgroup("impact_rig", "virtual test rig")
    group.addoption(
        "--rig-runs", metavar="DIR", help="directory for the runs of failed tests (default: the ini setting rig_runs)"
    )
    group.addoption(
        "--rig-update-golden",
        action="store_true",
        help="replace the golden data of the tests that run by their results, instead of comparing",
    )
    parser.addini(
        "rig_runs",
        f"directory for the runs of failed tests, relative to the rootdir (default: {DEFAULT_DIRECTORY})",
        default=DEFAULT_DIRECTORY,
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the marker `requirement`, by which a test names the requirements that it verifies."""
    config.addinivalue_line(
        "markers", "requirement(id, ...): requirements that the test verifies; listed in JUnit files"
    )


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Add the requirements that a test names to its properties, so that a JUnit file lists them even if it fails."""
    named = dict.fromkeys(str(name) for marker in item.iter_markers("requirement") for name in marker.args)
    item.user_properties += [("requirement", name) for name in named]


@pytest.fixture
def virtual_rig(request: pytest.FixtureRequest) -> Iterator[Callable[..., testing.LocalRig]]:
    """Return a function that starts a rig in this process: `virtual_rig({"barriers.gap_m": 0.004}, faults=[...])`."""
    yield from _starting(request, testing.LocalRig)


@pytest.fixture
def virtual_rig_with_nodes(request: pytest.FixtureRequest) -> Iterator[Callable[..., testing.LocalRigWithNodes]]:
    """Return a function that starts a rig in this process; the rig's method `host` adds ROS nodes: `host(MyNode)`."""
    yield from _starting(request, testing.LocalRigWithNodes)


@pytest.fixture
def ros_rig(request: pytest.FixtureRequest) -> Iterator[Callable[..., testing.RosRig]]:
    """Return a function that starts a rig on its own ROS domain: `ros_rig({"barriers.gap_m": 0.004})`.

    The rig is recorded, so that the run of a failed test can be kept, unless the test passes `record=False`.
    """
    yield from _starting(request, lambda *args, **kwargs: testing.RosRig(*args, **{"record": True, **kwargs}))


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> testing.Golden:
    """Return the golden data of this test; see `Golden`.

    Their folder is next to the test file, and named after file and test: `golden/test_file/test_name`.
    """
    directory = request.path.parent / "golden" / request.path.stem / _UNSAFE.sub("_", request.node.name)
    return testing.Golden(directory, update=bool(request.config.getoption("--rig-update-golden")))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Save the runs of a failed test while its rigs still exist, and add their directories to pytest's report.

    The option `--rig-runs`, or else the ini setting `rig_runs`, names the directory for all runs. Runs of an earlier
    failure of the test are replaced.
    """
    report = yield
    rigs = item.stash.get(_RIGS, [])
    if rigs and report.when != "teardown" and report.failed and call.excinfo is not None:
        directory = _directory(item)
        shutil.rmtree(directory, ignore_errors=True)  # left by an earlier failure of this test
        report.sections.append(("impact_rig", "\n".join(_keep(rig, directory, item) for rig in rigs)))
    return report


def _keep(rig: testing.RigDriver, directory: Path, item: pytest.Item) -> str:
    """Save the run of a failed test's rig, and return lines for pytest's report.

    If the run cannot be saved, or the rig gives no report, a line has the error. The test also gets the directory of
    the run (empty if not saved), the report and the seed as properties, which a JUnit file contains.
    """
    try:
        folder = rig.save(directory / rig.name)
        if rig.scenario:
            (folder / "scenario.py").write_text(rig.scenario, encoding="utf-8")
        run = str(folder)
        saved = f"    run: {run}"
    except Exception as error:
        run, saved = "", f"    no run was saved: {error}"
    try:
        report = rig.report()
    except Exception as error:
        report = f"{rig.name}: {error}"
    properties = {"run": run, "report": report, "seed": str(rig.config.daq.seed)}
    item.user_properties += [(f"{rig.name}.{name}", value) for name, value in properties.items()]
    return f"{report}\n{saved}"


def _directory(item: pytest.Item) -> Path:
    """Return the directory for the runs of a failed test, named after the test."""
    wanted = item.config.getoption("--rig-runs")
    root = Path(wanted).absolute() if wanted else item.config.rootpath / str(item.config.getini("rig_runs"))
    return root / _UNSAFE.sub("_", item.nodeid).strip("_")


def _starting(request: pytest.FixtureRequest, make: Callable[..., R]) -> Iterator[Callable[..., R]]:
    """Yield the function of a fixture, which starts a rig with `make` under a name that no open rig of the test has.

    After the test, the rigs are closed, except those with a wider scope, which later tests use again.
    """
    rigs = request.node.stash.setdefault(_RIGS, [])
    shared: list[testing.RigDriver] = []

    def start(*args: Any, scope: str = "function", **kwargs: Any) -> R:
        rigs[:] = [rig for rig in rigs if not rig.closed]
        taken = {rig.name for rig in rigs}
        free = (name for name in itertools.chain(["rig"], map("rig{}".format, itertools.count(2))) if name not in taken)
        kwargs.setdefault("name", next(free))
        if scope == "function":
            rig = make(*args, **kwargs)
        else:
            rig = _reset_or_start(request, scope, make, args, kwargs)
            shared.append(rig)
        rigs.append(rig)
        return rig

    start.__name__ = str(request.fixturename)
    yield start
    while rigs:
        rig = rigs.pop()
        if rig not in shared:
            rig.close()


def _reset_or_start(
    request: pytest.FixtureRequest, scope: str, make: Callable[..., R], args: tuple[Any, ...], kwargs: dict[str, Any]
) -> R:
    """Return a rig that later tests of the scope can use again.

    A rig that an earlier test of the scope started with the same arguments is reset to its first configuration and
    returned. Without such a rig, or if the reset fails, a new rig is started. A rig in this process is always new.

    Raises:
        pytest.UsageError: the scope is neither `module` nor `session`.
    """
    nodes = {"module": request.node.getparent(pytest.Module), "session": request.session}
    if scope not in nodes:
        raise pytest.UsageError(f"scope of a rig must be function, module or session, got {scope!r}")
    node = nodes[scope]
    if _SHARED not in node.stash:
        node.stash[_SHARED] = {}
        node.addfinalizer(lambda: [rig.close() for rig, _ in node.stash[_SHARED].values()])
    kept, key = node.stash[_SHARED], repr((request.fixturename, args, kwargs))
    if key in kept:
        rig, config = kept.pop(key)
        with contextlib.suppress(Exception):  # its processes have ended, or a save has ended its recorder
            if hasattr(rig, "renew"):
                rig.renew(config)
                kept[key] = rig, config
                return rig
        rig.close()
    rig = make(*args, **kwargs)
    kept[key] = rig, rig.config
    return rig
