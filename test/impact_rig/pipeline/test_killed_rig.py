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
"""Commands for a rig that is killed or suspended: neither the next rig nor the resumed one executes them."""

from __future__ import annotations

import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from std_srvs.srv import Trigger

from impact_rig.client import Client, Processes, RigGoneError, isolated_domain

pytestmark = [pytest.mark.ros, pytest.mark.pipeline]
AT_ONCE_S = 1.0


def drive(client: Client, current_a: float) -> None:
    """Drive the rig until it reports so: only then does a client know which activation it addresses."""
    client.command(current_a=current_a)
    client.wait_until(lambda: client.figures("rig").get("state") == "driving", "the rig to drive")


@pytest.fixture
def driven(tmp_path: Path) -> Iterator[tuple[Client, Processes]]:
    """Rig in real time that was driven, and has been killed."""
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs") as processes:
        processes.start("rig")
        with Client(domain_id) as client:  # without knowledge of the processes: it knows the graph alone
            client.wait_active("rig")
            client.wait_until(lambda: client.figures("rig").get("state") == "at_rest", "the rig")
            drive(client, 0.3)
            processes.running["rig"].signal(signal.SIGKILL)
            processes.stop("rig")
            yield client, processes


def test_a_command_to_a_dead_rig_fails_and_does_not_move_a_later_rig(driven: tuple[Client, Processes]) -> None:
    client, processes = driven
    began = time.monotonic()
    with pytest.raises(RigGoneError, match=r"shaker/current = 0\.5: the rig is gone: no report"):
        client.command(current_a=0.5)
    assert 2.0 <= time.monotonic() - began < 2.0 + 2.0 * AT_ONCE_S
    began = time.monotonic()
    with pytest.raises(RigGoneError):
        client.command(current_a=0.7)
    with pytest.raises(RigGoneError, match="rig/reset"):
        client.trigger("rig/reset")
    assert time.monotonic() - began < AT_ONCE_S, "the second time it is known"

    processes.start("rig")
    client.wait_active("rig")
    journal = client.collect("rig/journal")
    found = client.wait_until(
        lambda: (f := client.figures("rig")).get("state") == "at_rest" and float(f["rig_time_s"]) > 1.0 and f, "the rig"
    )
    assert found["current_a"] == "0"
    client.wait_until(lambda: len(journal) > 0, "the journal")
    assert [entry.kind.value for entry in journal.entries()] == ["start"]
    assert client.command(current_a=0.2)["current"] == 0.2, "and this one is its own"


def test_a_client_that_waits_while_another_rig_starts_gets_an_error(driven: tuple[Client, Processes]) -> None:
    """The rig is replaced within two seconds: the command belongs to the first rig, and its sender gets an error."""
    client, processes = driven
    client.given("nothing")  # the rig was alive a moment ago
    processes.start("rig")
    with pytest.raises(RigGoneError, match=r"is gone: no report|has ended or was activated again"):
        client.command(current_a=0.5)
    client.wait_active("rig")
    client.wait_until(lambda: client.figures("rig").get("state") == "at_rest", "the rig")
    assert client.figures("rig")["current_a"] == "0"


def test_a_rig_drops_old_commands_when_it_resumes_after_a_suspension(tmp_path: Path) -> None:
    """The command waits in the rig's queues, while its sender learns that the rig is gone. STOP works however late."""
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs") as processes:
        processes.start("rig")
        with Client(domain_id) as client:
            client.wait_active("rig")
            drive(client, 0.1)
            journal = client.collect("rig/journal")
            currents = lambda: [entry.value for entry in journal.entries() if entry.name == "current"]  # noqa: E731
            client.wait_until(lambda: currents() == [0.1], "the journal, which goes its own way")
            rig = processes.running["rig"]
            rig.signal(signal.SIGSTOP)
            suspended = time.monotonic()
            with pytest.raises(RigGoneError):
                client.command(current_a=0.5)
            pluck = client.prepare(Trigger, "rig/pluck").call_async(Trigger.Request())
            client.wait_until(lambda: time.monotonic() > suspended + 5.0, "more than the two seconds that both have")
            rig.signal(signal.SIGCONT)
            client.wait_until(pluck.done, "the answer")
            assert not pluck.result().success
            assert re.fullmatch(
                r"the command was sent [2-9]\.\d s before the process of this rig, .* ran again: send it again",
                pluck.result().message,
            )
            found = client.wait_until(
                lambda: "refused.shaker/current" in (f := client.figures("rig")) and f, "the count"
            )
            assert "which had been stopped, ran again" in found["last_refused.shaker/current"]
            assert (found["current_a"], found["state"]) == ("0.1", "driving")
            client.wait_active("rig")
            assert client.command(current_a=0.2)["current"] == 0.2, "it accepts present commands"
            client.wait_until(lambda: len(currents()) > 1, "the journal")
            assert currents() == [0.1, 0.2]
            rig.signal(signal.SIGSTOP)
            stopped = time.monotonic()
            stop = client.prepare(Trigger, "rig/stop").call_async(Trigger.Request())
            client.wait_until(lambda: time.monotonic() > stopped + 3.0, "more than two seconds")
            rig.signal(signal.SIGCONT)
            client.wait_until(stop.done, "the answer")
            assert stop.result().success
