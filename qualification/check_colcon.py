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
"""Test of the package with colcon: built and tested from nothing, then started as installed. See `make colcon`.

It stands in for a workspace on a Jazzy installed by apt, whose colcon is the same program. The workspace contains a
copy of the files that git tracks, so nothing that `make` built can help. Arguments are passed to pytest, in addition to
the names of some quick tests. The tests must run on the installed package and its library of kernels.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree import ElementTree as ET

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT))  # not in the environment: started programs must find the installed package

from impact_rig.client import Client, Processes, isolated_domain  # noqa: E402  # found by the line above
from tools.release import tracked  # noqa: E402

WORKSPACE = ROOT / "build" / "colcon"
SOURCE = WORKSPACE / "src" / "impact_rig"
"""Copy of the files that git tracks: a checkout in which nothing was built."""
PREFIX = WORKSPACE / "install" / "impact_rig"
SHARE = PREFIX / "share" / "impact_rig"
PROGRAMS = PREFIX / "lib" / "impact_rig"
MARKER = PREFIX / "share" / "ament_index" / "resource_index" / "packages" / "impact_rig"
NODES = ("rig", "analysis", "recorder", "stepped_sine")
QUICK = (
    "test/impact_rig/test_codec.py",
    "test/impact_rig/test_config.py",
    "test/test_launch.py",
    "test/impact_rig/nodes/test_convert.py",
    "test/impact_rig/nodes/test_frames.py",
    "test/impact_rig_studies/nodes/test_interface.py",
    "test/impact_rig/nodes/test_managed.py",
    "test/impact_rig/nodes/test_rig_node.py",
    "test/impact_rig/nodes/test_standard_services.py",
)
BUILD_TYPE = "(ros.ament_python)"
START_TIMEOUT_S = 120.0
"""Time limit of the first start, which imports everything that was just installed."""


def run(*command: str | Path, where: Path, more: Mapping[str, str] | None = None) -> str:
    """Run a program and return its output.

    Raises:
        SystemExit: it failed.
    """
    environment = {**os.environ, **(more or {})}
    done = subprocess.run(command, cwd=where, env=environment, stdout=subprocess.PIPE, text=True, check=False)  # noqa: S603  # own arguments
    if done.returncode:
        raise SystemExit(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}")
    return done.stdout


def colcon(verb: str, *arguments: str) -> str:
    """Run colcon; it writes into the workspace only."""
    return run(sys.executable, "-m", "colcon", "--log-base", str(WORKSPACE / "log"), verb, *arguments, where=WORKSPACE)


def absent() -> Iterator[Path]:
    """Yield the files that are not installed but should be, or differ from those here."""
    programs = [PROGRAMS / name for name in ("impact-rig", *(f"{node}_node" for node in NODES))]
    yield from (program for program in programs if not os.access(program, os.X_OK))
    if not MARKER.is_file():
        yield MARKER
    files = (path for name in ("config", "launch", "examples") for path in (ROOT / name).rglob("*.*"))
    for path in (ROOT / "package.xml", *files):
        installed = SHARE / path.relative_to(ROOT)
        is_source = path.is_file() and "__pycache__" not in path.parts
        if is_source and not (installed.is_file() and installed.read_bytes() == path.read_bytes()):
            yield installed


def sourced() -> dict[str, str]:
    """Return the environment variables that `. install/setup.bash` changes."""
    text = run("bash", "-c", '. "$0" && exec env -0', WORKSPACE / "install" / "setup.bash", where=ROOT)
    found = dict(line.split("=", 1) for line in text.split("\0") if line)
    return {key: value for key, value in found.items() if value != os.environ.get(key)}


def start_everything() -> None:
    """Start the nodes and programs that `ros2 run impact_rig …` starts, and end them."""
    ours, elsewhere = sourced(), Path("/")
    ask = "import impact_rig; print(impact_rig.__file__)"
    found = run(sys.executable, "-c", ask, where=elsewhere, more=ours)
    if not found.startswith(str(PREFIX)):
        raise SystemExit(f"after sourcing, impact_rig is not the installed one but {found}")
    run(PROGRAMS / "impact-rig", "--help", where=elsewhere, more=ours)
    run(PROGRAMS / "impact-rig", "check", SHARE / "config" / "nominal.yaml", where=elsewhere, more=ours)
    logs = WORKSPACE / "nodes"
    with isolated_domain() as domain_id, Processes(domain_id, logs) as processes:
        for node in NODES:
            parameters = {"record": False} if node == "recorder" else {}
            processes.start(node, parameters, environment=ours, command=[str(PROGRAMS / f"{node}_node")])
        with Client(domain_id, processes=processes) as client:
            client.wait_active(*NODES, timeout_s=START_TIMEOUT_S)
        codes = processes.stop()
    if any(codes.values()):
        raise SystemExit(f"nodes ended with {codes}, see {logs}")


def check_package_under_test() -> None:
    """Check which package the tests imported.

    Raises:
        SystemExit: it was not the installed package with its library of kernels.
    """
    said = (WORKSPACE / "log" / "latest_test" / "impact_rig" / "stdout.log").read_text(encoding="utf-8")
    found = next((line for line in said.splitlines() if line.startswith("impact_rig: ")), "nothing")
    if not found.startswith(f"impact_rig: {PREFIX}/") or not found.endswith("kernels: library"):
        raise SystemExit(f"colcon test tested {found}; expected the library below {PREFIX}")


def tests_run() -> int:
    """Return the number of tests that `colcon test` has run."""
    (suite,) = ET.parse(WORKSPACE / "build" / "impact_rig" / "pytest.xml").getroot()  # noqa: S314  # pytest's own
    return int(suite.attrib["tests"]) - int(suite.attrib["skipped"])


def check_changelog() -> None:
    """Parse the changelog with catkin_pkg, as a release does; colcon needs catkin_pkg, too.

    Raises:
        SystemExit: it finds neither a version nor a section of upcoming changes.
    """
    read = (
        "from catkin_pkg import changelog, package_version; log = changelog.get_changelog_from_path('.'); "
        "print(*log.foreach_version(), package_version.get_forthcoming_label(log.rst) or '')"
    )
    if not run(sys.executable, "-c", read, where=ROOT).strip():
        raise SystemExit("catkin_pkg finds no section in CHANGELOG.rst")


def main() -> None:
    """Build, install, test and start the package, and print a summary."""
    _, for_pytest = argparse.ArgumentParser(description=__doc__, allow_abbrev=False).parse_known_args()
    check_changelog()
    shutil.rmtree(WORKSPACE, ignore_errors=True)
    for name in tracked():
        (SOURCE / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(ROOT / name, SOURCE / name)
    listed = colcon("list", "--paths", str(SOURCE))
    if not listed.strip().endswith(BUILD_TYPE):
        raise SystemExit(f"colcon does not recognise the package as {BUILD_TYPE}: {listed}")
    places = ("--paths", str(SOURCE), "--packages-select", "impact_rig", "--build-base", str(WORKSPACE / "build"))
    places = (*places, "--install-base", str(WORKSPACE / "install"))
    colcon("build", *places)
    missing = [str(path) for path in absent()]
    if missing:
        raise SystemExit("not installed, or different from the sources:\n" + "\n".join(missing))
    start_everything()
    chosen = [f" {argument}" for argument in (*for_pytest, *QUICK)]  # the blank keeps colcon from parsing options
    colcon("test", *places, "--return-code-on-test-failure", "--pytest-args", *chosen)
    check_package_under_test()
    tests = tests_run()
    if not tests:
        raise SystemExit("colcon test ran no test")
    print(f"colcon built, installed and started the package; it ran {tests} tests, all passed")  # noqa: T201  # the result


if __name__ == "__main__":
    main()
