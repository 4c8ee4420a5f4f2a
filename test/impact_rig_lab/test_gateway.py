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
"""The lab in the graph, without a browser."""

from __future__ import annotations

import asyncio
import contextlib
import queue
import threading
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.browser import PATIENCE_S

from impact_rig import topics
from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.errors import ImpactRigError
from impact_rig.nodes.session import EXPIRES_S
from impact_rig_lab.gateway import KEPT, SWEEPER, Gateway, OwnedProcesses
from impact_rig_lab.live import LiveSource
from impact_rig_lab.protocol import Request
from impact_rig_lab.record import RigView
from impact_rig_lab.state import DEAD_S, Answer, Seen

pytestmark = pytest.mark.ros


def test_the_lab_subscribes_once_to_every_topic() -> None:
    """One list of applied commands is enough: a second one without a reader would grow forever."""
    with isolated_domain() as domain_id, Client(domain_id, "rig", name="observer") as observer:

        def times(topic: topics.Topic) -> int:
            name = observer.node.resolve_topic_name(topic.name)
            return [info.node_name for info in observer.node.get_subscriptions_info_by_topic(name)].count("lab")

        with LiveSource(domain_id, "/rig"):
            observer.wait_until(lambda: times(KEPT[-1]), "the lab", PATIENCE_S)
            assert {topic.name: times(topic) for topic in KEPT} == {topic.name: 1 for topic in KEPT}


def test_the_rig_of_another_user_counts_as_gone_earlier_than_our_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another user's rig may have ended unnoticed; our own may be late on a busy machine."""
    with (
        isolated_domain() as domain_id,
        Client(domain_id, "rig") as client,
        Processes(domain_id, tmp_path) as processes,
        contextlib.closing(OwnedProcesses(processes, {})) as own,
    ):
        processes.start("rig")
        for owner, silent_s in ((None, EXPIRES_S), (own, DEAD_S)):
            gateway = Gateway(client, RigView(), owner)
            for age_s, said in ((silent_s - 0.1, ""), (silent_s + 0.1, "no report from the rig")):
                monkeypatch.setattr(gateway, "seen", lambda _, age_s=age_s: Seen(instance="1", age_s=age_s))
                why = gateway._gone("1")
                assert why.startswith(said), age_s
                assert bool(why) is bool(said), (why, age_s)


def test_a_stop_is_reported_as_done_whichever_of_two_rigs_answers_first(tmp_path: Path) -> None:
    """The rig that waits to be alone may answer first, but the other one stops: the answer is no error."""
    with (
        isolated_domain() as domain_id,
        Client(domain_id, "rig", name="lab") as client,
        Processes(domain_id, tmp_path / "one", "/rig") as one,
        Processes(domain_id, tmp_path / "two", "/rig") as two,
    ):
        one.start("rig", {"time.start_wait_s": 0.0})
        client.wait_until(lambda: "rig_time_s" in client.figures("rig"), "the first rig", PATIENCE_S)
        two.start("rig")
        client.wait_until(
            lambda: "until the other rig has ended" in client.status("rig").message, "the second to wait", PATIENCE_S
        )

        async def stop() -> str:
            gateway = Gateway(client, RigView(), None)
            stopping = asyncio.ensure_future(gateway.do_stop())
            while not stopping.done():
                client.executor.spin_once(timeout_sec=0.05)
                await asyncio.sleep(0)
            await gateway.close("the test is over")
            return stopping.result()

        for _ in range(6):
            assert asyncio.run(stop())
        client.wait_until(lambda: client.figures("rig").get("latched"), "the latch", PATIENCE_S)


def answers_of(client: Client, gateway: Gateway, *requests: Request) -> Iterator[tuple[str, bool, str]]:
    """Run requests of a page in one event loop, and yield their answers in the order of arrival."""
    answers: queue.SimpleQueue[tuple[str, bool, str]] = queue.SimpleQueue()

    def answer_to(do: str) -> Answer:
        return lambda ok, text: answers.put((do, ok, text))

    async def talk() -> None:
        for request in requests:
            gateway.begin(request, answer_to(request.do))
        while gateway.is_busy:
            client.executor.spin_once(timeout_sec=0.01)
            await asyncio.sleep(0)

    asyncio.run(talk())
    while not answers.empty():
        yield answers.get()


class HungProcesses:
    """Group with one process that ends only when another action has been answered, or after 10 s."""

    def __init__(self) -> None:
        self.running = {SWEEPER: SimpleNamespace(exit_code=None)}
        self.answered = threading.Event()

    def stop(self, node: str) -> None:
        assert self.answered.wait(10.0), "the loop has waited for the end of the process"
        del self.running[node]

    def start(self, *_: object, name: str) -> None:
        raise ImpactRigError(f"no program of {name} here")


def test_other_actions_are_not_delayed_while_a_process_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """A node that does not end takes 17 s, during which STOP must be sent."""
    processes = HungProcesses()
    with (
        isolated_domain() as domain_id,
        Client(domain_id, "rig", name="lab") as client,
        contextlib.closing(OwnedProcesses(processes, {})) as own,
    ):
        gateway = Gateway(client, RigView(), own)
        gateway.record.knobs = {"drive.kind": "current"}
        monkeypatch.setattr(gateway, "_gone", lambda _: "")

        async def answer() -> str:
            processes.answered.set()
            return "answered"

        monkeypatch.setitem(gateway._actions, "note", answer)
        plan = {"frequencies": (9.0,), "direction": "up", "hold": "command", "target": 0.0}
        answers = list(answers_of(client, gateway, Request(1, "sweep", plan), Request(2, "note", {})))
        assert answers == [("note", True, "answered"), ("sweep", False, f"no program of {SWEEPER} here")]


@pytest.mark.parametrize(("kind", "words"), [("current", "starts no nodes"), ("voltage", "set the amplitude first")])
def test_a_sweep_has_a_default_amplitude_only_for_a_current(
    monkeypatch: pytest.MonkeyPatch, kind: str, words: str
) -> None:
    with isolated_domain() as domain_id, Client(domain_id, "rig", name="lab") as client:
        gateway = Gateway(client, RigView(), None)
        gateway.record.knobs = {"drive.kind": kind}
        monkeypatch.setattr(gateway, "_gone", lambda _: "")
        plan = {"frequencies": (9.0,), "direction": "up", "hold": "command", "target": 0.0}
        ((_, done, text),) = answers_of(client, gateway, Request(1, "sweep", plan))
        assert not done
        assert words in text


@pytest.mark.parametrize(
    ("action", "values"),
    [
        ("load", {"value": "barriers: {gap_m: 0.006}"}),
        ("sweep", {"frequencies": (9.0,), "direction": "up", "hold": "command", "target": 0.0}),
        ("fault", {"kind": "stuck", "channel": "laser", "value": 0.0, "duration": 0.0, "rate": 0.0}),
    ],
)
def test_settings_are_not_compared_with_a_configuration_that_is_not_known_yet(
    monkeypatch: pytest.MonkeyPatch, action: str, values: dict[str, Any]
) -> None:
    """Before, equal defaults would not be sent, and the planned faults of the rig would be replaced."""
    with isolated_domain() as domain_id, Client(domain_id, "rig", name="lab") as client:
        gateway = Gateway(client, RigView(), None)
        monkeypatch.setattr(gateway, "_gone", lambda _: "")
        ((_, done, text),) = answers_of(client, gateway, Request(1, action, values))
        assert not done
        assert "has not published its configuration yet" in text
