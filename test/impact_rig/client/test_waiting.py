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
"""Waiting: only the time in which something could happen counts."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from impact_rig import topics
from impact_rig.errors import ConfigError, ImpactRigError

if TYPE_CHECKING:
    from impact_rig.client import Client

ROOT = Path(__file__).parents[3]


class Worker:
    """Executor whose callback takes long, like a hosted node that compiles."""

    def __init__(self, works_s: float) -> None:
        self._works_s = works_s

    def spin_once(self, timeout_sec: float) -> None:
        time.sleep(self._works_s or timeout_sec)


@pytest.mark.heavy
def test_the_work_of_a_hosted_node_does_not_shorten_the_timeout() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client.client import Spinner

    busy = Spinner(Worker(works_s=1.0))
    began = busy.waited_s()
    busy.spin(0.05)
    assert busy.waited_s() - began < 0.5
    idle = Spinner(Worker(works_s=0.0))
    began = idle.waited_s()
    idle.spin(0.05)
    assert idle.waited_s() - began >= 0.05


def run_pytest(tmp_path: Path, source: str, *options: str) -> subprocess.CompletedProcess[str]:
    (tmp_path / "test_it.py").write_text(source)
    command = [sys.executable, "-m", "pytest", "-p", "conftest", "-p", "no:cacheprovider", *options, "test_it.py"]
    environment = {**os.environ, "PYTHONPATH": f"{ROOT / 'test'}{os.pathsep}{ROOT}"}
    return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)


@pytest.mark.ros
def test_a_client_works_while_pytest_captures_output(tmp_path: Path) -> None:
    """Under `pytest -s` with `capsys`, sys.stderr has no file."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    done = run_pytest(
        tmp_path,
        "from rclpy.context import Context\nfrom impact_rig.nodes.process import make_executor\n"
        "def test_it(capsys):\n"
        "    context = Context()\n    context.init(args=[])\n"
        "    make_executor(context).shutdown()\n    context.try_shutdown()\n"
        "    print('seen')\n    assert capsys.readouterr().out == 'seen\\n'\n",
        "-s",
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_command_fails_when_its_rig_is_silent_or_another_rig_has_started() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client.client import GONE_S, AddressedActivation, RigGoneError

    now = 0.0
    rig = AddressedActivation(lambda: now)
    unknown = rig.given("a command")
    now = 100.0
    unknown()  # no message yet: it may still be starting
    rig.heard("one")
    unknown()
    check = rig.given("a command")
    now += 0.99 * GONE_S
    check()
    now += 0.02 * GONE_S
    with pytest.raises(RigGoneError, match="a command: the rig is gone: no report"):
        check()
    now += 3.0 * GONE_S
    with pytest.raises(RigGoneError, match=f"no report from it for {4.01 * GONE_S:.1f} s"):
        rig.given("the next")()
    rig.heard("one")  # it was only slow
    patient = rig.given("a law to compile", 1e9)
    now += 10.0 * GONE_S
    patient()
    rig.heard("two")
    with pytest.raises(RigGoneError, match="was activated again"):
        patient()
    rig.given("a command to the second")()
    silent = AddressedActivation(lambda: now)
    silent.changed()  # by a transition, after which the rig has never reported
    check = silent.given("a command")
    now += 1.5 * GONE_S
    with pytest.raises(RigGoneError, match=f"no report from it for {1.5 * GONE_S:.1f} s"):
        check()


def test_a_command_addresses_the_rig_whose_start_the_client_has_seen() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client.client import AddressedActivation, RigGoneError

    now = 0.0
    rig = AddressedActivation(lambda: now)
    rig.heard("one")
    rig.changed()
    check = rig.given("a command")
    rig.heard("one")  # it was under way
    rig.heard("two")
    check()
    rig.heard("three")
    with pytest.raises(RigGoneError):
        check()
    rig.changed()
    now = 1.0
    rig.heard("three")  # it is the same one after all
    check = rig.given("a command")
    rig.heard("four")
    with pytest.raises(RigGoneError):
        check()


def test_an_immediate_command_belongs_to_the_rig_that_is_running() -> None:
    """A quick client must not mistake the successor for its rig while outdated diagnostics are ignored."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client.client import AddressedActivation, RigGoneError

    now = 0.0
    rig = AddressedActivation(lambda: now)
    rig.heard("one")
    rig.changed()
    rig.heard("one")  # the same one, but it could have been under way
    check = rig.given("a command")
    check()
    now = 1.0
    rig.heard("two")
    with pytest.raises(RigGoneError, match="was activated again"):
        check()


def say(client: Client, name: str, instance: str = "", lifecycle: str = "active") -> None:
    """Publish the diagnostics of a rig, and wait until the client has received them."""
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

    figures = {"instance": instance or name, "lifecycle": lifecycle}
    values = [KeyValue(key=key, value=value) for key, value in figures.items()]
    message = " ".join(figures.values())
    status = DiagnosticStatus(name=f"{name}: simulation", level=b"\0", message=message, values=values)
    client.publish(topics.DIAGNOSTICS, DiagnosticArray(status=[status]))
    client.wait_until(lambda: any(one.message == message for one in client.diagnostics.values()), message)


@pytest.mark.ros
def test_a_rig_that_was_just_activated_is_not_taken_for_another_one() -> None:
    """Its diagnostics from before, with another instance, may arrive just before those of the active rig."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Client, isolated_domain

    with isolated_domain() as domain_id, Client(domain_id) as client:
        say(client, "rig", "unconfigured", lifecycle="unconfigured")
        check = client.given("a command")
        say(client, "rig", "first")
        check()
        say(client, "rig", "second")
        with pytest.raises(ImpactRigError, match="was activated again"):
            check()


@pytest.mark.ros
def test_a_rig_outside_the_namespace_is_a_different_rig() -> None:
    """`/rig` must not be taken for `/here/rig`; then its commands would be reported as lost with a rig that is gone."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Client, isolated_domain

    with isolated_domain() as domain_id, Client(domain_id, "here") as client:
        say(client, "here/rig")
        check = client.given("a command")
        for other in ("rig", "there/rig", "hererig", "here2/rig"):
            say(client, other)
            check()
        assert client.figures("rig") == {"instance": "here/rig", "lifecycle": "active"}


@pytest.mark.ros
def test_an_empty_list_parameter_is_sent_as_an_empty_list() -> None:
    """ROS 2 cannot state the type of an empty list: the rig expects strings, and rclpy would send bytes."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from kits.nodes import host_rig

    from impact_rig.client import Client, isolated_domain

    with isolated_domain() as domain_id, Client(domain_id) as client:
        host_rig(client)
        client.wait_active("rig")
        name = "instruments.faults.planned"
        for lines in ([], ()):
            client.set_parameters("rig", {name: ["dropout channel=laser duration_s=1"]})
            assert client.get_parameters("rig", [name]) != {name: [""]}
            client.set_parameters("rig", {name: lines})
            assert client.get_parameters("rig", [name]) == {name: [""]}
        with pytest.raises(ConfigError, match=r"lacks at least one of the parameters barriers.gap_m, barriers.gap,"):
            client.get_parameters("rig", ["barriers.gap_m", "barriers.gap"])
