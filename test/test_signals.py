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
"""Programs that get a signal at any instant from their first import on: one line, an exit code, no process, intact
files.

`qualification/endings.py` does this twenty times for each program and signal; here, every program gets each signal
once.
"""

from __future__ import annotations

import os
import re
import runpy
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig.system import endings
from impact_rig.system.endings import PARENT_VARIABLE

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]
TOOL: dict[str, Any] = runpy.run_path(str(Path(__file__).parents[1] / "qualification" / "endings.py"))
SIGNALS = [signal.SIGINT, signal.SIGTERM]
SOON_S = {"campaign": 1.5, "report": 1.0, "identify": 1.0, "verify": 1.0, "replay": 2.0}
"""Instants are drawn from the first seconds: no program is run to its end only to see how long it takes."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Any:
    return TOOL["Bench"](tmp_path_factory.mktemp("endings"), times=1, seed=2, longest_s=SOON_S)


@pytest.mark.parametrize("program", [*SOON_S, "nodes"])  # the demo is ended in test_demo.py
def test_a_program_ends_cleanly_on_a_signal(bench: Any, program: str) -> None:
    tally = bench.end(program)
    assert tally.faults == []
    assert tally.endings == len(SIGNALS), "each got its signal while it ran"


def test_a_driven_and_recorded_rig_ends_cleanly_on_repeated_signals(tmp_path: Path) -> None:
    tally = TOOL["Tally"]()
    TOOL["end_driven"](0.2, 0.5, tmp_path, tally)
    assert tally.faults == []


@pytest.mark.parametrize(
    ("program", "number"),
    [*zip(("demo", "campaign", "identify", "replay", "verify", "export"), 3 * SIGNALS, strict=True)],  # one `main`
)
def test_a_signal_during_imports_is_reported_in_one_line(tmp_path: Path, program: str, number: int) -> None:
    words = {"export": ["export", "x", "y", "z.csv"], "demo": ["demo", "--output", "x"]}.get(program, [program, "x"])
    tally = TOOL["Tally"]()
    TOOL["end_program"](words, number, 0.0, tmp_path, tally)
    assert tally.faults == []
    assert tally.endings == 1


DONE = """
import signal, sys, time
signal.signal(signal.SIGTERM, lambda *_: None)
print("runs 1 of 1: gap 2 mm, 9.1 Hz{more}", file=sys.stderr, flush=True)
time.sleep(1)
"""


@pytest.mark.parametrize(("more", "done"), [("", 1), (r"\nand more", 0)])
def test_a_signal_after_the_last_progress_line_does_not_count_as_an_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: str, done: int
) -> None:
    monkeypatch.setitem(TOOL["end_program"].__globals__, "SCRIPT", DONE.format(more=more))
    tally = TOOL["Tally"]()
    TOOL["end_program"](["campaign"], signal.SIGTERM, 0.3, tmp_path, tally)
    assert (tally.done, tally.endings, len(tally.faults)) == (done, 1 - done, 1 - done)


PAUSING = """
import os, sys, threading, time
from impact_rig.system.endings import Ending, defer_signals
ending = Ending("program")
def ready():
    print("ready", flush=True)
def work():
    {work}
sys.exit(ending.run(work))
"""
SLEEP = "ready(); time.sleep(100)"
WORK = {
    "waiting": ("ready(); threading.Event().wait()", ""),
    "an exception that is swallowed": (f"try: {SLEEP}\n    except BaseException: pass\n    time.sleep(100)", ""),
    "an exception that becomes another": (
        f"try: {SLEEP}\n    except BaseException as error: raise ImportError from error",
        "",
    ),
    "a file being closed": (
        "with defer_signals(): ready(); time.sleep(0.3); print('closed', flush=True)\n    time.sleep(100)",
        "closed\n",
    ),
    "a thread that never ends": (f"threading.Thread(target=threading.Event().wait).start()\n    {SLEEP}", ""),
}


@pytest.mark.parametrize(("what", "number"), [*zip(WORK, 3 * SIGNALS, strict=False), ("waiting", signal.SIGTERM)])
def test_the_first_signal_ends_a_program_at_any_work_with_the_right_code(what: str, number: int) -> None:
    work, said = WORK[what]
    program = subprocess.Popen(
        [sys.executable, "-c", PAUSING.format(work=work)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert program.stdout is not None
    assert program.stdout.readline() == "ready\n"
    for _ in range(3):  # more of them change nothing
        program.send_signal(number)
    output, error = program.communicate(timeout=60)
    assert (program.returncode, output, error) == (128 + number, said, f"program: {TOOL['WORDS'][number]}\n")


@pytest.fixture
def campaign(tmp_path: Path) -> Iterator[subprocess.Popen[bytes]]:
    (tmp_path / "plan.yaml").write_text(TOOL["PLAN"])
    command = [sys.executable, "-c", TOOL["SCRIPT"], "campaign", "plan.yaml", "--output", "out", "--workers", "2"]
    with subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        yield process
        process.kill()


def workers(process: int) -> set[int]:
    """Return the child processes that measure."""
    found = set()
    for task in Path(f"/proc/{process}/task").iterdir():
        for pid in map(int, (task / "children").read_text().split()):
            if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes():
                found.add(pid)
    return found


def test_the_workers_of_a_killed_campaign_end_with_it(campaign: subprocess.Popen[bytes]) -> None:
    deadline = time.monotonic() + 100.0
    while len(found := workers(campaign.pid)) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    watched = {os.pidfd_open(pid) for pid in found}
    assert len(watched) == 2
    campaign.kill()
    try:
        while watched:
            ended, _, _ = select.select(list(watched), [], [], 60.0)  # one that still imports ends when that is done
            assert ended, "a worker is still there"
            for descriptor in ended:
                watched.remove(descriptor)
                os.close(descriptor)
    finally:
        for descriptor in watched:
            os.close(descriptor)


def test_a_node_whose_parent_process_has_ended_does_not_start() -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    ended = subprocess.run(
        [sys.executable, "-m", "impact_rig.nodes", "recorder"],
        env={**os.environ, PARENT_VARIABLE: str(gone.pid)},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert re.fullmatch("recorder_node: terminated, as the process that started it is gone\n", ended.stderr)


def test_the_launch_file_passes_its_process_id_to_the_nodes() -> None:
    source = (Path(__file__).parents[1] / "launch" / "rig.launch.py").read_text(encoding="utf-8")
    assert "SetEnvironmentVariable(PARENT_VARIABLE, str(os.getpid()))" in source
    assert endings.PARENT_VARIABLE == "IMPACT_RIG_EXIT_WITH", "users' own launch files may set it"
