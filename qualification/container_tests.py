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
"""Qualification of the runs that failed tests leave, in an environment like that of a container.

`python -m qualification.container_tests [--tests 50]` writes a folder of tests of which five fail, runs it with `pytest
-n 2 --junitxml`, and reads the JUnit file. As root it runs as another user (`--user`) whose home is empty, with a small
/dev/shm and TMPDIR elsewhere; without root only the directories differ. Exit code 1 if a failure names no complete run.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from xml.etree import ElementTree as ET

ROOT = Path(__file__).parents[1]
SHM_BYTES = 4_000_000
NOBODY = 65534
INFO = """
import sys
from impact_rig.cli import main
for run in sys.argv[1:]:
    print("RUN", main(["info", run]), flush=True)
"""
FAILURES = {
    "test_number": "a number",
    "test_topics": "a ratio on topics",
    "test_a_node_raises": "RuntimeError: of a hosted node",
    "test_a_hosted_node_raises": "RuntimeError: of a hosted node",
    "test_a_process_ends": "was ended by SIGKILL",
}

TESTS = """
import signal

import pytest
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2

QUICK = {"daq.rate_hz": 1000}


class Counter(Node):
    def __init__(self, error=""):
        super().__init__("counter")
        self.error, self.count = error, 0
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 10)

    def on_scan(self, message):
        self.count += 1
        if self.count == 30 and self.error:
            raise RuntimeError(self.error)


@pytest.mark.parametrize("number", range(NUMBERS))
def test_number(virtual_rig, number):
    rig = virtual_rig({"daq.seed": number + 1})
    rig.command(9.1, 0.5)
    rig.run(1.0)
    assert number != 1, "a number"


@pytest.mark.parametrize("number", range(TOPICS))
def test_topics(ros_rig, number):
    rig = ros_rig(QUICK, hosted=True)
    node = rig.host(Counter)
    rig.step(20)
    assert node.count == 20
    assert number != 1, "a ratio on topics"


def test_a_node_raises(ros_rig):
    rig = ros_rig(QUICK, hosted=True)
    rig.host(Counter, error="of a hosted node")
    rig.step(40)


def test_a_hosted_node_raises(virtual_rig_with_nodes):
    rig = virtual_rig_with_nodes(QUICK)
    rig.host(Counter, error="of a hosted node")
    rig.step(40)


def test_a_process_ends(ros_rig):
    rig = ros_rig(QUICK)
    rig.step(20)
    rig.processes.running["rig"].signal(signal.SIGKILL)
    rig.step(20)


def test_a_shared_rig(ros_rig):
    rig = ros_rig(QUICK, hosted=True, scope="module")
    rig.step(10)
    assert rig.sample == 10 * rig.block_scans
"""


def run_tests(folder: Path, tests: int, user: int | None) -> list[str]:
    """Run the tests in a folder; return what is wrong with the result, one line each."""
    topics = max(2, tests // 8)
    numbers = tests - topics - 4
    text = TESTS.replace("NUMBERS", str(numbers)).replace("TOPICS", str(topics))
    (folder / "test_pipeline.py").write_text(text, encoding="utf-8")
    home, temporary = folder / "home", folder / "elsewhere"
    for place in (home, temporary):
        place.mkdir()
    command = [sys.executable, "-m", "pytest", "-p", "impact_rig.testing.plugin", "-p", "no:cacheprovider", "-q"]
    command += ["-n", "2", "--junitxml=results.xml", "test_pipeline.py"]
    if user is not None:
        for place in (folder, *folder.rglob("*")):
            os.chown(place, user, user)
        inner = f'{_mounts(folder)} && exec setpriv --reuid {user} --regid {user} --clear-groups "$@"'
        command = ["unshare", "--mount", "sh", "-c", inner, "sh", *command]
    environment = {
        "PATH": os.environ["PATH"], "HOME": str(home), "TMPDIR": str(temporary), "PYTHONPATH": str(ROOT),
        "AMENT_PREFIX_PATH": os.environ.get("AMENT_PREFIX_PATH", sys.prefix), "PYTHONDONTWRITEBYTECODE": "1",
    }  # fmt: skip
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    results = folder / "results.xml"
    if not results.exists():
        return [f"no JUnit file: {done.stdout[-2000:]}{done.stderr[-2000:]}"]
    cases = list(ET.parse(results).iter("testcase"))  # noqa: S314  # written by pytest
    failed = [case for case in cases if case.find("failure") is not None or case.find("error") is not None]
    wrong = [] if len(cases) == tests else [f"{len(cases)} tests, not {tests}"]
    names = sorted(str(case.get("name")).partition("[")[0] for case in failed)
    if names != sorted(FAILURES):
        wrong.append(f"failed: {names}: {done.stdout[-3000:]}")
    faults = {case: _wrong_with(case) for case in failed}
    wrong += filter(None, faults.values())
    wrong += _incomplete([case for case in failed if not faults[case]], environment)
    left = [str(path) for place in (home, temporary) for path in place.iterdir() if path.name.startswith("impact_rig_")]
    return [*wrong, *(f"left behind: {path}" for path in left)]


def _mounts(folder: Path) -> str:
    """Return shell commands for a mount namespace: a small /dev/shm, and an interpreter that every user may run."""
    mounts = [f"mount -t tmpfs -o size={SHM_BYTES},mode=1777 tmpfs /dev/shm"]
    base = Path(sys.base_prefix)
    private = [parent for parent in base.parents if not parent.stat().st_mode & 0o001]
    if private:  # such as the home of root
        kept = folder.with_name(f"{folder.name}_python")
        mounts += [f"mkdir {kept}", f"mount --bind {base} {kept}", f"mount -t tmpfs -o mode=755 tmpfs {private[-1]}"]
        mounts += [f"mkdir -p {base}", f"mount --bind {kept} {base}"]
    return " && ".join(mounts)


def _properties(case: ET.Element) -> dict[str, str]:
    return {str(one.get("name")): str(one.get("value")) for one in case.iter("property")}


def _wrong_with(case: ET.Element) -> str:
    """Return the error in the XML of a failed test; empty if there is none."""
    name, properties = str(case.get("name")), _properties(case)
    missing = [key for key in ("rig.run", "rig.report", "rig.seed") if not properties.get(key)]
    if missing:
        return f"{name}: without {', '.join(missing)}"
    said = "".join((one.get("message") or "") + (one.text or "") for one in case)
    if FAILURES.get(name.partition("[")[0], "") not in said:
        return f"{name}: fails by something else: {said[-500:]}"
    return ""


def _incomplete(cases: list[ET.Element], environment: dict[str, str]) -> list[str]:
    """Report the runs of failed tests that `impact-rig info` does not find complete, one line each."""
    command = [sys.executable, "-c", INFO, *(_properties(case)["rig.run"] for case in cases)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    reports = re.findall(r"(.*?)^RUN (\d+)\n", done.stdout, re.MULTILINE | re.DOTALL)
    if len(reports) != len(cases):
        return [f"info: {done.stdout}{done.stderr}"]
    wrong = []
    for case, (report, code) in zip(cases, reports, strict=True):
        first = " ".join(report.split())
        print(f"{case.get('name')}: {first[:140]}", flush=True)
        if code != "0" or ": whole" not in first[:300]:
            wrong.append(f"{case.get('name')}: info: {report}{done.stderr}")
    return wrong


def main() -> int:
    """Run the tests, print what is wrong and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tests", type=int, default=50, metavar="N", help="number of tests (default: 50)")
    parser.add_argument(
        "--user", type=int, default=NOBODY, metavar="ID", help="user that runs them, if started as root"
    )
    options = parser.parse_args()
    private = [parent for parent in ROOT.parents if not parent.stat().st_mode & 0o001]
    if private and os.getuid() == 0:
        parser.error(f"user {options.user} cannot enter {private[0]}: use a checkout that every user can read")
    folder = Path(tempfile.mkdtemp(prefix="container_tests_"))
    folder.chmod(0o755)
    try:
        wrong = run_tests(folder, options.tests, options.user if os.getuid() == 0 else None)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        shutil.rmtree(folder.with_name(f"{folder.name}_python"), ignore_errors=True)
    print("\n".join(wrong) or f"{options.tests} tests, {len(FAILURES)} failures, each with a complete run")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
