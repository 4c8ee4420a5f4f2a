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
"""The testing kit itself: isolation, clear messages about dead processes, no process left running."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from impact_rig.client import ProcessDiedError, Processes, isolated_domain
from impact_rig.client.processes import FIRST_PORT, PORTS_PER_DOMAIN, _yaml, remove_litter
from impact_rig.errors import ImpactRigError
from impact_rig.system.segments import PORTS, SHARED

ROOT = Path(__file__).parents[3]


def test_domains_in_use_at_the_same_time_differ() -> None:
    with isolated_domain() as one, isolated_domain() as two, isolated_domain() as three:
        assert len({one, two, three}) == 3
        assert os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"


@pytest.mark.ros
def test_ports_of_killed_processes_are_removed_and_those_in_use_are_not(tmp_path: Path) -> None:
    """Leftover files could crash the next participant on the domain."""
    from impact_rig.client import Client  # needs rclpy

    with isolated_domain() as domain_id, Processes(domain_id, tmp_path) as processes:
        first = FIRST_PORT + PORTS_PER_DOMAIN * domain_id

        def ports() -> set[str]:
            numbers = range(first, first + PORTS_PER_DOMAIN)
            return {name for n in numbers for kind in PORTS if (SHARED / (name := f"{kind}{n}")).exists()}

        assert not ports(), "an isolated domain begins clean"
        processes.start("analysis")
        with Client(domain_id, processes=processes) as client:
            client.wait_active("analysis")
            used = ports()
            remove_litter(domain_id)
            assert ports() == used
            assert client.state("analysis") == "active"
        processes.running["analysis"].signal(signal.SIGKILL)
        processes.running["analysis"].wait(5)
        assert ports(), "nothing is left to be removed"  # in addition to those that the client may still be removing
        remove_litter(domain_id)
        assert not ports()


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        (3, "3"),
        (1e-7, "1.0e-07"),
        (0.006, "0.006"),
        (1e22, "1.0e+22"),
        (np.float64(0.004), "0.004"),
        ((np.float64(8.5), 9.0), "[8.5, 9.0]"),
        ("a b", "'a b'"),
        ("it's", "'it''s'"),
        (("analysis", "recorder"), "['analysis', 'recorder']"),
        ((), "['']"),
    ],
)
def test_parameters_are_written_as_ros_reads_them(value: object, text: str) -> None:
    """A number of NumPy must not become the text `np.float64(0.004)`, which no node accepts."""
    assert _yaml(value) == text


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a function that makes small modules, which `Processes` can start instead of nodes."""
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    return tmp_path


def test_an_unknown_name_does_not_prevent_the_end_of_other_processes(module: Path) -> None:
    """If a name is unknown, the processes named before it must still be stopped."""
    (module / "sleeps.py").write_text("import time\ntime.sleep(60)\n")
    with Processes(1, module / "logs") as processes:
        process = processes.start("sleeps")
        with pytest.raises(KeyError, match="nobody"):
            processes.stop("sleeps", "nobody")
        assert process.exit_code is None
    assert process.exit_code is not None


def test_the_last_output_and_exit_code_of_a_dead_process_are_reported(module: Path) -> None:
    (module / "dies.py").write_text("import sys\nprint('line', 'one')\nprint('the reason')\nsys.exit(3)\n")
    with Processes(1, module / "logs") as processes:
        process = processes.start("dies")
        assert process.wait(10) == 3
        with pytest.raises(ProcessDiedError) as died:
            processes.check()
    assert "the dies process ended with exit code 3" in str(died.value)
    assert str(died.value).endswith("    line one\n    the reason")


def test_a_process_that_ignores_signals_is_ended(module: Path) -> None:
    stubborn = "import signal\nfor n in (signal.SIGINT, signal.SIGTERM): signal.signal(n, signal.SIG_IGN)\n"
    (module / "stubborn.py").write_text(stubborn + "print('ready')\nwhile True: signal.pause()\n")
    with Processes(1, module / "logs") as processes:
        process = processes.start("stubborn")
        deadline = time.monotonic() + 10
        while "ready" not in process.log.read_text() and time.monotonic() < deadline:
            process.wait(0.01)
        assert processes.stop(timeout_s=0.1) == {"stubborn": -signal.SIGKILL}
        with pytest.raises(KeyError):
            processes.stop("stubborn")


def test_the_name_of_a_process_can_be_used_only_once(module: Path) -> None:
    (module / "waits.py").write_text("import signal\nsignal.pause()\n")
    with Processes(1, module / "logs") as processes:
        processes.start("waits")
        with pytest.raises(ImpactRigError, match="already running"):
            processes.start("waits")
        processes.stop(timeout_s=0.1)  # SIGINT may be ignored here: so it is where a shell started us in the background


@pytest.mark.ros
def test_a_client_uses_the_domain_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Client  # needs rclpy

    with isolated_domain() as domain_id:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        with Client() as client:
            assert client.context.get_domain_id() == domain_id


@pytest.mark.ros
def test_a_node_ends_when_the_process_that_started_it_is_killed(tmp_path: Path) -> None:
    """This holds even for SIGKILL, after which no process can end the nodes."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    starter = tmp_path / "starter.py"
    starter.write_text(
        "import signal\nfrom pathlib import Path\nfrom impact_rig.client import Client, Processes, isolated_domain\n"
        f"with isolated_domain() as domain, Processes(domain, Path({str(tmp_path)!r})) as processes:\n"
        "    node = processes.start('recorder', {'record': False})\n"
        "    with Client(domain, processes=processes) as client:\n"
        "        client.wait_active('recorder')\n"
        "    print(node.pid, flush=True)\n"
        "    signal.pause()\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen([sys.executable, str(starter)], stdout=subprocess.PIPE, env=environment) as process:
        assert process.stdout is not None
        node = int(process.stdout.readline())
        watched = os.pidfd_open(node)
        process.kill()
    try:
        ended, _, _ = select.select([watched], [], [], 10.0)
        assert ended, "the node is still running"
    finally:
        os.close(watched)
    assert "terminated, as the process that started it is gone" in (tmp_path / "recorder.log").read_text()


@pytest.mark.ros
@pytest.mark.parametrize("value", ["twelve", "-1", "²"])
def test_an_invalid_domain_in_the_environment_is_rejected_with_a_message(
    value: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.driver import RosRig

    monkeypatch.setenv("ROS_DOMAIN_ID", value)
    with (
        pytest.raises(ImpactRigError, match=f"ROS_DOMAIN_ID must be a whole number >= 0, got {value!r}"),
        RosRig(record=tmp_path / "run", namespace="/rig"),
    ):
        pass
