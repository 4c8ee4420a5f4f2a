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
"""Time from a clone to the first result behind each door of the README: `python -m qualification.doors` (ten minutes).

The last commit of this repository is cloned into a temporary directory, with nothing installed and nothing compiled,
and the README is followed there; the program prints seconds. Downloads through pip are included, so the network
matters. `make bench ONLY=start` repeats the time of the demo from a clone, and the size of what is installed for it.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "test"))

from kits.browser import Browser  # noqa: E402

DOMAIN = "73"
"""Not the domain of `make`, which another terminal may be using."""
SETTLED = "window.lab && lab.now.dt.length && lab.now.dt.at(-1).settled"
PATIENCE_S = 600.0


@contextmanager
def started(command: list[str], directory: Path, environment: dict[str, str]) -> Iterator[subprocess.Popen[str]]:
    """Run a program with its children, and end all of them afterwards."""
    with subprocess.Popen(  # noqa: S603  # our own commands
        command, cwd=directory, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        try:
            yield process
        finally:
            os.killpg(process.pid, signal.SIGINT)
            process.wait(PATIENCE_S)


def line_with(process: subprocess.Popen[str], word: str) -> str:
    """Return the first line of a program's output that contains a word.

    Raises:
        RuntimeError: the program ended before.
    """
    assert process.stdout is not None
    found = next((line for line in process.stdout if word in line), None)
    if found is None:
        raise RuntimeError(f"{process.args} ended without saying {word!r}")
    return found.strip()


def measure(say: Callable[[str, float], None], directory: Path) -> None:
    """Follow the README and report the duration of each part [s]."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("ROS_", "AMENT_"))}
    environment |= {"ROS_DOMAIN_ID": DOMAIN, "PYTHONUNBUFFERED": "1"}
    checkout = directory / "impact_rig"
    begin = time.monotonic()

    def run(*command: str) -> str:
        done = subprocess.run(command, cwd=checkout, env=environment, check=True, stdout=subprocess.PIPE, text=True)  # noqa: S603  # as above
        return done.stdout

    subprocess.run(["git", "clone", "--quiet", str(ROOT), str(checkout)], check=True)  # noqa: S603, S607  # as above
    run("make", "demo")
    demo = time.monotonic()
    say("from the clone to the demo's five reductions", demo - begin)
    note("demo_from_clone_s", demo - begin)
    note("install_run_tier_mb", float(run("du", "-sm", ".venv").split()[0]))
    with started(["make", "lab", "ARGS=--no-browser --port 0 --no-record"], checkout, environment) as lab:
        address = line_with(lab, "http")
        with closing(Browser()) as browser:
            page = browser.page()
            page.goto(address)
            page.wait("window.lab && lab.now.rig?.word === 'at rest'", "a rig at rest", PATIENCE_S)
            page.key("r")
            page.wait(SETTLED, "DT on the page", PATIENCE_S)
        first = time.monotonic()
        say("then: `make lab`, to DT on the page", first - demo)
        node = [".venv/bin/python", "-u", "examples/first_node.py", "--ros-args", "-r", "__ns:=/rig"]
        with started(
            [*node, "--log-level", "info"], checkout, {**environment, "RCUTILS_LOGGING_USE_STDOUT": "1"}
        ) as own:
            line_with(own, "DT = ")
        say("with the lab running, to DT in a node of one's own", time.monotonic() - first)
    third = time.monotonic()
    run("make", "test", "ARGS=-n 0 test/impact_rig/testing/test_examples.py")
    say("then: the tests' part, to passed tests of three pipelines", time.monotonic() - third)


def note(figure: str, value: float) -> None:
    """Store a figure for `make bench ONLY=start`."""
    directory = ROOT / "build" / "start"
    directory.mkdir(parents=True, exist_ok=True)
    (directory / figure).write_text(f"{value:.1f}\n", encoding="utf-8")


def main() -> None:
    """Print the table."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    with tempfile.TemporaryDirectory(prefix="impact_rig_doors_") as directory:
        measure(lambda what, seconds: print(f"{what:60} {seconds:6.0f} s", flush=True), Path(directory))  # noqa: T201


if __name__ == "__main__":
    main()
