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
"""Lifecycle guards, parameter validator and diagnostics of a small node, on both executors."""

from __future__ import annotations

import gc
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import attrs
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from builtin_interfaces.msg import Time
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import Parameter as ParameterMessage
from rcl_interfaces.msg import ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters, SetParametersAtomically
from rclpy.parameter import Parameter
from rclpy.service import Service
from rosgraph_msgs.msg import Clock
from std_srvs.srv import Trigger

from impact_rig import states, topics
from impact_rig.client import Client, ServiceFailedError, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.config.fields import integer, names, quantity, switch
from impact_rig.config.tree import Tree
from impact_rig.errors import CommandError, ConfigError
from impact_rig.nodes import managed
from impact_rig.nodes.managed import Done, LateService, Level, ManagedNode, NodeState
from impact_rig.nodes.process import EXECUTOR_VARIABLE

pytestmark = pytest.mark.ros


@attrs.frozen(kw_only=True)
class Settings:
    speed_m_s: float = quantity(1.0, "m/s", "How fast.", above=0, at_most=10)
    count: int = integer(3, "-", "How many.", at_least=1)
    rate_hz: int = integer(10, "Hz", "Fixed.", at_least=1, read_only=True)
    words: tuple[str, ...] = names((), "Which.")
    fails: bool = switch(False, "Whether configure fails.")
    bugs: bool = switch(True, "Whether the timer has a bug.")

    def __attrs_post_init__(self) -> None:
        if self.speed_m_s > self.count:
            raise ConfigError(f"speed_m_s must be <= count = {self.count}, got {self.speed_m_s:g}")


class Small(ManagedNode[Settings]):
    """Node that makes every mistake a node can make."""

    STATES = states.RecorderWord

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("small", Tree(Settings), **kwargs)
        self.changes: list[dict[str, Any]] = []
        self.service(Trigger, "~/raise", self._raise)
        self.service(Trigger, "~/refuse", self._refuse)
        self.service(Trigger, "~/later", self._later)
        self.service(Trigger, "~/answer_and_raise", self._answer_and_raise)
        LateService(self, Trigger, "~/answer_twice", self._answer_twice)
        self.waiting: list[Done] = []
        self.ticks = 0

    def configure(self) -> None:
        if self.settings.fails:
            raise RuntimeError("a part is missing")
        self.steady_timer(0.01, self._tick)

    def settings_changed(self, settings: Settings, changes: dict[str, Any]) -> None:
        if settings.count == 13:
            raise CommandError("thirteen is refused by the node itself")
        self.changes.append(changes)

    def doing(self) -> NodeState:
        return NodeState(states.RecorderWord.IDLE)

    def health(self) -> tuple[Level, str]:
        return Level.OK, "fine"

    def figures(self) -> dict[str, object]:
        return {"ticks": self.ticks}

    def _tick(self) -> None:
        self.ticks += 1
        if self.ticks == 3 and self.settings.bugs:
            raise ZeroDivisionError("a bug in a timer")
        while self.waiting:
            self.waiting.pop()(True, "answered")

    def _later(self, _request: Any, done: Done) -> None:
        self.waiting.append(done)

    def _raise(self, _request: Any, _done: Done) -> None:
        raise KeyError("a bug in a service")

    def _answer_and_raise(self, _request: Any, done: Done) -> None:
        done(True, "answered")
        raise KeyError("a bug after the answer")

    def _answer_twice(self, _request: Any, _sent_ns: int, send: Callable[[Any], None]) -> None:
        send(Trigger.Response(success=True, message="answered"))
        send(Trigger.Response(success=False, message="answered again"))

    def _refuse(self, _request: Any, _done: Done) -> None:
        raise CommandError("not now")


@pytest.fixture(params=["events", "default"])
def user(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv(EXECUTOR_VARIABLE, request.param)
    with isolated_domain() as domain_id, Client(domain_id) as client:
        yield client


def test_a_node_survives_exceptions_in_callbacks_and_reports_them(user: Client) -> None:
    node = user.host(Small)
    user.wait_active("small")
    user.wait_until(lambda: node.ticks > 5, "the timer to go on after its exception")
    with pytest.raises(ServiceFailedError, match="KeyError: 'a bug in a service'"):
        user.trigger("small/raise")
    with pytest.raises(ServiceFailedError, match="not now"):
        user.trigger("small/refuse")
    user.wait_until(lambda: user.status("small").level == b"\2", "an error in diagnostics")
    assert node.refusals.counts == {"exception": 2, "refuse": 1}


def test_a_node_that_is_ending_reports_nothing_more(user: Client) -> None:
    """A rig that ends together with its analysis must not warn that the analysis is gone."""
    node = user.host(Small)
    user.wait_active("small")
    reports = user.listen("/diagnostics")
    user.wait_until(lambda: reports.messages, "a report")
    node.is_ending = lambda: True
    ticks = node.ticks
    node.health = lambda: (Level.ERROR, "a peer has ended")  # would be reported within 0.1 s
    user.wait_until(lambda: node.ticks > ticks + 100, "a second of its timer")
    assert not any("a peer has ended" in report.status[0].message for report in reports.messages)


def test_a_service_can_answer_later_with_every_executor(user: Client) -> None:
    user.host(Small)
    user.wait_active("small")
    assert user.trigger("small/later") == "answered"


@pytest.mark.parametrize("service", ["answer_and_raise", "answer_twice"])
def test_a_request_is_answered_once_even_if_its_callback_then_raises(
    user: Client, monkeypatch: pytest.MonkeyPatch, service: str
) -> None:
    sent: list[str] = []
    send = Service.send_response

    def count(service: Service, response: Any, header: Any) -> None:
        if isinstance(response, Trigger.Response):
            sent.append(response.message)
        send(service, response, header)

    monkeypatch.setattr(Service, "send_response", count)
    node = user.host(Small, parameter_overrides=ros_parameters({"bugs": False}))
    user.wait_active("small")
    assert user.trigger(f"small/{service}") == "answered"
    assert sent == ["answered"]
    assert node.refusals.counts == ({"exception": 1} if service == "answer_and_raise" else {})


def test_a_node_survives_invalid_transitions_and_can_be_restarted(user: Client) -> None:
    node = user.host(Small)
    user.wait_active("small")
    for transition in ("configure", "activate", "cleanup"):
        assert not user.change_state("small", transition)
        assert user.state("small") == "active"
    for transition in ("deactivate", "cleanup", "configure", "activate"):
        assert user.change_state("small", transition)
    assert node.refusals.counts["transition"] == 3
    request = ChangeState.Request(transition=Transition(label="no_such_transition"))
    assert not user.call(ChangeState, "small/change_state", request).success
    assert node.refusals.counts["transition"] == 4
    assert node.refusals.last["transition"] == (
        "transition 'no_such_transition' is not possible in lifecycle state 'active': `ros2 lifecycle list /small` "
        "shows those that are"
    )


def test_a_failed_configure_leaves_an_unconfigured_node_that_can_be_repaired(
    client: Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(managed, "ERROR_MEMORY_S", math.inf)
    client.host(Small, parameter_overrides=ros_parameters({"fails": True, "bugs": False}))
    client.wait_until(lambda: "a part is missing" in client.status("small").message, "the reason")
    assert client.state("small") == "unconfigured"
    with pytest.raises(ServiceFailedError):
        client.trigger("small/raise")
    client.wait_until(lambda: "a bug in a service" in client.status("small").message, "the later error")
    monkeypatch.setattr(managed, "ERROR_MEMORY_S", 0.0)
    client.wait_until(lambda: "a bug in a service" not in client.status("small").message, "its end")
    assert "a part is missing" in client.status("small").message
    assert "a part is missing" in client.figures("small")["reason"]
    client.set_parameters("small", {"fails": False})
    assert client.change_state("small", "configure")
    client.wait_until(lambda: client.status("small").message == "fine", "the error to be gone")


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"speed_m_s": 0.0}, "speed_m_s must be > 0 and <= 10, got 0.0 m/s"),
        ({"speed_m_s": float("nan")}, "speed_m_s must be > 0 and <= 10, got nan m/s"),
        ({"speed_m_s": "fast"}, "speed_m_s must be a number in m/s, got 'fast'"),
        ({"count": 2.5}, "count must be an integer, got 2.5"),
        ({"count": True}, "count must be an integer, got true"),
        ({"rate_hz": 20}, "rate_hz is read-only: set it when the node starts (parameter file or -p)"),
        ({"cuont": 4}, "unknown key 'cuont', did you mean 'count'?"),
        ({"speed_m_s": 4.0}, "speed_m_s must be <= count = 3, got 4"),
        ({"speed_m_s": 2.0, "count": 0}, "count must be >= 1, got 0"),
        ({"count": 13}, "thirteen is refused by the node itself"),
        ({"words": 3}, "words must be a list of texts, got 3"),
    ],
)
def test_an_invalid_value_is_rejected_with_the_message_of_the_validator(
    values: dict[str, Any], reason: str, lasting: Client
) -> None:
    with pytest.raises(ConfigError) as refusal:
        lasting.set_parameters("small", values)
    assert str(refusal.value) == reason
    assert lasting.get_parameters("small", ["speed_m_s", "count"]) == {"speed_m_s": 1.0, "count": 3}


@pytest.fixture(scope="module")
def lasting():
    """One node for all rejections, which must not change it."""
    with isolated_domain() as domain_id, Client(domain_id) as client:
        client.host(Small)
        client.wait_active("small")
        yield client


def test_valid_values_are_set_together(client: Client) -> None:
    node = client.host(Small)
    client.wait_active("small")
    client.set_parameters("small", {"speed_m_s": 5, "count": 7, "words": ["a", "b"]})
    assert node.settings == Settings(speed_m_s=5.0, count=7, words=("a", "b"))
    assert node.changes == [{"speed_m_s": 5.0, "count": 7, "words": ("a", "b")}]
    assert client.get_parameters("small", ["speed_m_s"])["speed_m_s"] == 5.0
    client.set_parameters("small", {"words": [""]})
    assert node.settings.words == ()
    assert not node.set_parameters([Parameter("count", value=-1)])[0].successful


def test_parameter_descriptors_contain_unit_range_and_whether_read_only(lasting: Client) -> None:
    request = DescribeParameters.Request(names=["speed_m_s", "count", "rate_hz"])
    speed, count, rate = lasting.call(DescribeParameters, "small/describe_parameters", request).descriptors
    assert speed.description == "How fast. [m/s]"
    assert speed.additional_constraints == "> 0 and <= 10"
    assert (speed.floating_point_range[0].from_value, speed.floating_point_range[0].to_value) == (0.0, 10.0)
    assert count.integer_range[0].from_value == 1
    assert rate.read_only
    assert not speed.read_only


@pytest.mark.parametrize("values", [{"speed_m_s": -1.0}, {"cuont": 1}, {"config_file": "/nowhere.yaml"}])
def test_a_node_with_invalid_start_values_is_not_configured(client: Client, values: dict[str, Any]) -> None:
    client.host(Small, parameter_overrides=ros_parameters(values))
    word = {"config_file": "cannot read configuration"}.get(*values, *values)
    client.wait_until(lambda: word in client.status("small").message, "the reason")
    assert client.state("small") == "unconfigured"


def test_every_node_can_start_from_a_configuration_file(client: Client, tmp_path: Path) -> None:
    path = tmp_path / "small.yaml"
    path.write_text("/**:\n  ros__parameters:\n    count: 7\n    speed_m_s: 5.0\n", encoding="utf-8")
    values = {"config_file": str(path), "speed_m_s": 6.0, "bugs": False}
    node = client.host(Small, parameter_overrides=ros_parameters(values))
    client.wait_active("small")
    assert (node.settings.count, node.settings.speed_m_s) == (7, 6.0)


def test_a_parameter_of_an_unknown_type_is_rejected(user: Client) -> None:
    """An unknown parameter type raises inside rclpy's own parameter services, which must not end the process."""
    node = user.host(Small)
    user.wait_active("small")
    odd = ParameterMessage(name="count", value=ParameterValue(type=10))
    fine = Parameter("count", value=4).to_parameter_msg()
    request = SetParameters.Request(parameters=[fine, odd])
    first, second = user.call(SetParameters, "small/set_parameters", request).results
    assert first.successful
    assert "10 is not a valid" in second.reason
    whole = SetParametersAtomically.Request(parameters=[odd])
    assert not user.call(SetParametersAtomically, "small/set_parameters_atomically", whole).result.successful
    assert node.refusals.counts["parameter"] == 2
    assert user.get_parameters("small", ["count"]) == {"count": 4}


def test_a_node_in_simulated_time_survives_a_clock_before_1970(user: Client) -> None:
    """A clock before 1970 raises inside rclpy's own subscription to /clock, which must not end the process."""
    node = user.host(Small, parameter_overrides=ros_parameters({"use_sim_time": True, "bugs": False}))
    user.wait_active("small")
    user.publish(topics.CLOCK, Clock(clock=Time(sec=-5)))
    user.wait_until(lambda: node.refusals.counts["exception"] == 1, "the exception to be caught")
    assert "must not be negative" in node.refusals.last["exception"]
    assert user.state("small") == "active"


def test_a_node_that_is_destroyed_leaves_the_graph_before_garbage_is_collected() -> None:
    gc.disable()
    try:
        with isolated_domain() as domain_id, Client(domain_id, name="observer") as observer:
            with Client(domain_id) as owner:
                owner.host(Small)
                observer.wait_until(lambda: "small" in observer.node.get_node_names(), "the node in the graph")
            observer.wait_until(lambda: "small" not in observer.node.get_node_names(), "the node to leave the graph")
    finally:
        gc.enable()
