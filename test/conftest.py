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
"""Environment of all tests: their own ROS domain, strict message types, a check of what they leave behind, order."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import fcntl
import gc
import importlib
import multiprocessing
import os
import random
import select
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings
from hypothesis.internal.conjecture import providers
from package_under_test import prefer_installed

prefer_installed()  # before anything imports the package

import impact_rig  # noqa: E402  # see above
from impact_rig import kernels  # noqa: E402
from impact_rig.client.processes import remove_litter  # noqa: E402

if TYPE_CHECKING:
    from kits.browser import Browser

pytest.register_assert_rewrite("kits")
sys.path.append(str(Path(__file__).parents[1]))  # for `tools` and `qualification`, which are no part of it

REQUIRE_ROS = os.environ.get("IMPACT_RIG_REQUIRE_ROS") == "1"
DOMAINS = range(50, 100)  # 0 to 101 are safe on Linux; people and `make demo` use low numbers
LONGEST_FILES = (
    "test_journeys", "test_live_page", "test_excitation", "test_identification", "test_site", "test_extending",
    "test_measurement", "test_figures", "test_accessibility", "test_dask", "test_generated_recordings", "test_demo",
    "test_dynamics", "test_platforms", "test_plugin", "test_report", "test_guide", "test_fuzz", "test_environment",
    "test_drawings", "test_three_processes", "test_schedule", "test_controllers", "test_fmu",
)  # fmt: skip
"""Longest files by `--durations=0`, the longest first. They begin in this order: a worker takes whole files, and one
that begins a long file last makes the other wait for it. A shuffle mixes them among themselves, and the others behind
them."""
GRACE_S = 5.0  # how long a thread or process may take to end after its test

# before any module imports a message class or starts a node, and inherited by the processes that tests start
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("MPLBACKEND", "agg")

# derandomised: two runs of the suite see the same examples; `--hypothesis-profile=random` looks for new ones.
# No deadline: the first example of a compiled function takes seconds, a ROS one waits for discovery.
_COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow]}
settings.register_profile("repeatable", derandomize=True, database=None, **_COMMON)
settings.register_profile("random", print_blob=True, **_COMMON)
settings.register_profile("check", derandomize=True, database=None, max_examples=20, **_COMMON)
settings.load_profile("repeatable")
# Nor do they depend on what else is imported: Hypothesis draws numbers that it finds in the sources of all modules
# loaded so far, which another order of tests, or a worker of its own, makes others.
providers._get_local_constants = lambda: providers._local_constants


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--thorough", action="store_true", help="run the tests marked slow as well")
    parser.addoption("--shuffle", type=int, metavar="SEED", help="run the tests in an order drawn with this seed")
    parser.addoption("--check", action="store_true", help="leave out what needs a process, a browser, ROS, or patience")
    parser.addoption(
        "--changed", nargs="?", const="HEAD", type=_commit, metavar="COMMIT",
        help="run what a change since a commit (HEAD) can reach",
    )  # fmt: skip


def _commit(name: str) -> str:
    command = ["git", "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}"]
    if subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, check=False).returncode:
        raise argparse.ArgumentTypeError(f"no such commit: {name!r}; --changed=HEAD leaves paths apart")
    return name


def pytest_report_header() -> str:
    return f"impact_rig: {Path(impact_rig.__file__).parent}, kernels: {kernels.MODE}"


def pytest_configure(config: pytest.Config) -> None:
    if REQUIRE_ROS and _why_no_ros():
        raise pytest.UsageError(f"IMPACT_RIG_REQUIRE_ROS=1, but {_why_no_ros()}")
    if config.getoption("--check"):
        settings.load_profile("check")
        # a skipped test leaves open the files that were opened for its process
        config.addinivalue_line("filterwarnings", "ignore::ResourceWarning")
        config.addinivalue_line("filterwarnings", "ignore::pytest.PytestUnraisableExceptionWarning")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """In `make check`, do not even import the test files that import ROS."""
    if not config.getoption("--check") or collection_path.suffix != ".py":
        return None
    return '\npytest.importorskip("rclpy"' in collection_path.read_text(encoding="utf-8") or None


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    seed = config.getoption("--shuffle")
    if seed is not None:
        before = {item: number for number, item in enumerate(items)}
        random.Random(seed).shuffle(items)
        for module in {getattr(item, "module", None) for item in items}:
            if getattr(module, "IN_ORDER", False):  # each of its tests goes on with what the one before has left
                places = [number for number, item in enumerate(items) if getattr(item, "module", None) is module]
                for place, item in zip(places, sorted((items[n] for n in places), key=before.__getitem__), strict=True):
                    items[place] = item
    if not config.getoption("-m"):
        left_out = {"benchmark"} if config.getoption("--thorough") else {"benchmark", "slow"}
        left_out |= {"ros", "pipeline", "repeats", "heavy", "_chromium"} if config.getoption("--check") else set()
        _leave_out(
            config, items,
            lambda item: bool(left_out & {*(marker.name for marker in item.iter_markers()), *item.fixturenames}),
        )  # fmt: skip
    if since := config.getoption("--changed"):
        from kits.reach import ROOT, Reach, changed

        reached = Reach().files(changed(since))
        _leave_out(config, items, lambda item: reached is not None and str(item.path.relative_to(ROOT)) not in reached)
    place = {name: number if seed is None else 0 for number, name in enumerate(LONGEST_FILES)}
    items.sort(key=lambda item: place.get(item.path.stem, len(place)))


@pytest.hookimpl(tryfirst=True)
def pytest_collection() -> None:
    """Let no garbage collection pass half a million objects again and again while they are made."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Except what was collected, which stays to the end, from garbage collections."""
    gc.enable()
    gc.freeze()


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    if session.config.getoption("--changed") and exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.OK  # no test depends on the change


def _leave_out(config: pytest.Config, items: list[pytest.Item], out: Callable[[pytest.Item], bool]) -> None:
    dropped = [item for item in items if out(item)]
    config.hook.pytest_deselected(items=dropped)
    gone = set(dropped)
    items[:] = [item for item in items if item not in gone]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Print why a test was repeated: the first failure is shown nowhere else."""
    for report in terminalreporter.stats.get("rerun", []):
        terminalreporter.write_line(f"RERUN {report.nodeid}: {report.longreprtext[-2000:]}")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("ros") and _why_no_ros():
        pytest.skip(_why_no_ros())


def _why_no_ros() -> str:
    try:
        import rclpy  # noqa: F401  # asked for, not used
    except ImportError as error:
        return f"rclpy cannot be imported: {error}"
    return ""


@pytest.fixture(scope="session", autouse=True)
def _own_domain_and_logs(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Give this process (each xdist worker is one) a ROS domain that no other test run of this user uses."""
    from kits.measured import hold_back

    hold_back()
    os.environ["ROS_LOG_DIR"] = str(tmp_path_factory.mktemp("ros_log"))
    domain, lock = _claim_domain()
    os.environ["ROS_DOMAIN_ID"] = str(domain)
    remove_litter(domain)
    with lock:
        yield


def _claim_domain() -> tuple[int, IO[str]]:
    """Return a free domain and the locked file that claims it; the claim ends with this process, however it ends."""
    for domain in DOMAINS:
        path = Path(tempfile.gettempdir(), f"impact_rig_domain_{os.getuid()}_{domain}.lock")
        lock = path.open("w")  # open for as long as the claim holds
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
        else:
            return domain, lock
    raise RuntimeError(f"no free ROS domain in {DOMAINS}: too many test runs at once")


@pytest.fixture(scope="session", autouse=True)
def _no_process_in_a_check(request: pytest.FixtureRequest) -> None:
    """Skip each test that starts a process, at the moment when it does so, because a marker could be forgotten."""
    if request.config.getoption("--check"):
        with contextlib.suppress(ImportError):
            importlib.import_module("matplotlib.font_manager")  # asks a program for fonts, once on a machine
        for starter in (subprocess.Popen, multiprocessing.process.BaseProcess):
            starter.__init__ = _skip  # type: ignore[method-assign]  # for as long as these tests run


def _skip(*_arguments: object, **_words: object) -> None:
    pytest.skip("it starts a process")


@pytest.fixture
def measured_programs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Measure the coverage of all programs that a test starts."""
    from kits.measured import measured

    for name, value in measured().items():
        monkeypatch.setenv(name, value)


@pytest.fixture(scope="session", autouse=True)
def _adopt_orphans() -> None:
    """Make this process the parent of orphaned descendants, so that a forgotten grandchild is noticed as well."""
    set_child_subreaper = 36  # <linux/prctl.h>
    ctypes.CDLL(None).prctl(set_child_subreaper, 1, 0, 0, 0)


@pytest.fixture(scope="session")
def _chromium() -> Iterator[Browser]:
    """Start one browser for all tests of a process."""
    pytest.importorskip("aiohttp", reason="the extra [lab] is not installed")
    from kits.browser import Browser

    with contextlib.closing(Browser()) as found:
        yield found


@pytest.fixture
def browser(_chromium: Browser) -> Iterator[Browser]:
    """Open pages of one test in the shared browser; no page outlives the test."""
    yield _chromium
    _chromium.close_pages()


@pytest.fixture(autouse=True)
def _nothing_left_behind() -> Iterator[None]:
    """Fail a test that leaves threads or processes behind."""
    threads, processes = set(threading.enumerate()), _children()
    yield
    deadline = time.monotonic() + GRACE_S
    while set(threading.enumerate()) - threads and time.monotonic() < deadline:
        time.sleep(0.01)  # none is joined: one that is just beginning cannot be
    left: list[object] = [thread for thread in threading.enumerate() if thread not in threads]
    for process in _children() - processes:
        if not _ended(process, deadline):
            left.append(f"process {process}: {_command(process)}")
            os.kill(process, signal.SIGKILL)
    assert not left, f"still running {GRACE_S:g} s after the test: {left}"


def _children() -> set[int]:
    """Return the process ids of this process's children, including those that its threads started."""
    found: set[int] = set()
    for task in Path("/proc/self/task").iterdir():
        try:
            found.update(map(int, (task / "children").read_text().split()))
        except OSError:  # the thread has ended, or the kernel does not tell
            continue
    return found


def _command(process: int) -> str:
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        return "?"


def _ended(process: int, deadline: float) -> bool:
    """Wait until `process` has ended; an ended process counts even if its parent has not waited for it."""
    try:
        descriptor = os.pidfd_open(process)
    except ProcessLookupError:
        return True
    try:
        ready, _, _ = select.select([descriptor], [], [], max(0.0, deadline - time.monotonic()))
        return bool(ready)
    finally:
        os.close(descriptor)
