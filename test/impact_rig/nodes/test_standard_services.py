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
"""Services of simulation_interfaces, with stand-ins for its messages: the index of wheels lacks the package.

The stand-ins have the fields and constants of version 2.0.0, as in its msg and srv files at
https://docs.ros.org/en/jazzy/p/simulation_interfaces/. Types and transport of ROS are not tested here: a call passes
the request to the callback, and takes the response where rclpy would send it.
"""

from __future__ import annotations

import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import attrs
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig

from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.nodes import process
from impact_rig.nodes.rig_node import RigNode

pytestmark = pytest.mark.ros


@attrs.define
class Result:
    result: int = 0
    error_message: str = ""
    RESULT_FEATURE_UNSUPPORTED, RESULT_OK, RESULT_NOT_FOUND, RESULT_INCORRECT_STATE, RESULT_OPERATION_FAILED = range(5)


@attrs.define
class SimulationState:
    state: int = 0
    STATE_STOPPED, STATE_PLAYING, STATE_PAUSED, STATE_QUITTING = range(4)


@attrs.define
class SimulatorFeatures:
    features: list[int] = attrs.Factory(list)
    spawn_formats: list[str] = attrs.Factory(list)
    custom_info: str = ""
    SIMULATION_RESET, SIMULATION_RESET_TIME, SIMULATION_RESET_STATE, SIMULATION_RESET_SPAWNED = range(20, 24)
    SIMULATION_STATE_GETTING, SIMULATION_STATE_SETTING, SIMULATION_STATE_PAUSE = range(24, 27)
    STEP_SIMULATION_SINGLE, STEP_SIMULATION_MULTIPLE, STEP_SIMULATION_ACTION = range(31, 34)


@attrs.define
class Empty:
    pass


@attrs.define
class ResultOnly:
    result: Result = attrs.Factory(Result)


@attrs.define
class FeaturesResponse:
    features: SimulatorFeatures = attrs.Factory(SimulatorFeatures)


@attrs.define
class StateResponse:
    state: SimulationState = attrs.Factory(SimulationState)
    result: Result = attrs.Factory(Result)


@attrs.define
class SetRequest:
    state: SimulationState = attrs.Factory(SimulationState)


@attrs.define
class SetResponse:
    result: Result = attrs.Factory(Result)
    ALREADY_IN_TARGET_STATE, STATE_TRANSITION_ERROR, INCORRECT_TRANSITION = 101, 102, 103


@attrs.define
class StepRequest:
    steps: int = 1


@attrs.define
class ResetRequest:
    scope: int = 0
    SCOPE_DEFAULT, SCOPE_TIME, SCOPE_STATE, SCOPE_SPAWNED, SCOPE_ALL = 0, 1, 2, 4, 255


SERVICES = {
    "GetSimulatorFeatures": SimpleNamespace(Request=Empty, Response=FeaturesResponse),
    "GetSimulationState": SimpleNamespace(Request=Empty, Response=StateResponse),
    "SetSimulationState": SimpleNamespace(Request=SetRequest, Response=SetResponse),
    "StepSimulation": SimpleNamespace(Request=StepRequest, Response=ResultOnly),
    "ResetSimulation": SimpleNamespace(Request=ResetRequest, Response=ResultOnly),
}
STOPPED, PLAYING, PAUSED, QUITTING = range(4)


@attrs.define
class StandIn:
    """Service in one process, as rclpy makes it."""

    callback: Any
    send_response: Any = None


@attrs.define
class User:
    """Client that calls the stand-ins of a rig."""

    client: Client
    offered: dict[str, StandIn] = attrs.Factory(dict)

    def begin(self, name: str, request: Any) -> list[Any]:
        """Call a service; its answer is appended to the list."""
        service, answers = self.offered[f"~/{name}"], []
        response = service.callback(request, None)
        service.send_response(response, answers)
        return answers

    def call(self, name: str, request: Any = None) -> Any:
        answers = self.begin(name, request or Empty())
        self.client.wait_until(lambda: answers, f"the answer of {name}")
        assert len(answers) == 1
        return answers[0]

    def set(self, state: int) -> tuple[int, str]:
        result = self.call("set_simulation_state", SetRequest(SimulationState(state))).result
        return result.result, result.error_message

    @property
    def state(self) -> int:
        response = self.call("get_simulation_state")
        assert response.result.result == Result.RESULT_OK
        return response.state.state


@pytest.fixture
def user(client: Client, monkeypatch: pytest.MonkeyPatch) -> User:
    """User of rigs on a machine that has the package."""
    user = User(client)
    for name, content in {
        "simulation_interfaces": {},
        "simulation_interfaces.msg": {kind.__name__: kind for kind in (Result, SimulationState, SimulatorFeatures)},
        "simulation_interfaces.srv": SERVICES,
    }.items():
        module = ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)
    create = RigNode.create_service

    def create_service(node: RigNode, service_type: Any, name: str, callback: Any, **options: Any) -> Any:
        if service_type not in SERVICES.values():
            return create(node, service_type, name, callback, **options)
        user.offered[name] = StandIn(callback, lambda response, answers: answers.append(response))
        return user.offered[name]

    monkeypatch.setattr(RigNode, "create_service", create_service)
    return user


def test_no_standard_service_is_offered_without_the_interface_package(client: Client) -> None:
    node = host_rig(client)
    types = {kind for _name, kinds in node.get_service_names_and_types_by_node("rig", "/") for kind in kinds}
    assert "std_srvs/srv/Trigger" in types
    assert not any(kind.startswith("simulation_interfaces") for kind in types)


@pytest.mark.parametrize(
    ("absent", "features"), [("", [20, 22, 24, 25, 26, 31, 32]), ("StepSimulation", range(20, 27))]
)
def test_the_offered_features_are_listed(
    user: User, monkeypatch: pytest.MonkeyPatch, absent: str, features: Any
) -> None:
    if absent:
        monkeypatch.delattr(sys.modules["simulation_interfaces.srv"], absent)
    host_rig(user.client)
    said = user.call("get_simulator_features").features
    assert sorted(said.features) == [number for number in features if number not in {21, 23}]
    assert said.spawn_formats == []
    assert "a step is step.blocks blocks" in said.custom_info
    assert ("~/step_simulation" in user.offered) == (not absent)


@pytest.mark.parametrize("mode", ["realtime", "free_running"])
def test_a_rig_can_be_paused_stepped_stopped_and_played(user: User, mode: str) -> None:
    client = user.client
    node = host_rig(client, mode, time__peers=["client"])
    assert user.state == STOPPED, "it has not started"
    assert user.set(PLAYING)[0] == SetResponse.STATE_TRANSITION_ERROR
    scans, journal = (client.collect(name, acknowledge=name == "daq/scan") for name in ("daq/scan", "rig/journal"))
    client.wait_active("rig")
    client.wait_until(lambda: len(scans) > 3, "the first blocks")
    assert user.state == PLAYING
    assert user.set(PLAYING) == (SetResponse.ALREADY_IN_TARGET_STATE, "")
    running = user.call("step_simulation", StepRequest(1)).result
    assert running == Result(
        Result.RESULT_OPERATION_FAILED, "a step needs the simulation state PAUSED: set that state first"
    )

    assert user.set(PAUSED) == (Result.RESULT_OK, "")
    assert user.state == PAUSED
    before = len(scans)
    assert user.call("step_simulation", StepRequest(7)).result.result == Result.RESULT_OK
    client.wait_until(lambda: len(scans) == before + 7, "the blocks of the steps")
    assert user.state == PAUSED

    assert user.set(STOPPED) == (Result.RESULT_OK, "")
    assert user.state == STOPPED
    assert user.call("step_simulation", StepRequest(1)).result.result == Result.RESULT_OPERATION_FAILED
    assert user.set(PAUSED) == (Result.RESULT_OK, "")
    assert user.state == PAUSED
    assert len(scans) == before + 7
    assert user.set(PLAYING) == (Result.RESULT_OK, "")
    client.wait_until(lambda: len(scans) > before + 10, "rig time to go on")
    stamps = [table.stamp_ns for table in scans.tables()]
    assert stamps == sorted(set(stamps)), "a reset turns no time back"
    assert [entry.kind.value for entry in journal.entries()].count("reset") == 1
    assert node.refusals.counts["step_simulation"] == 2
    assert node.refusals.counts["exception"] == 0


def test_a_reset_supports_only_the_scope_of_the_state(user: User) -> None:
    client = user.client
    host_rig(client, "lockstep", time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    assert user.state == PAUSED, "it moves by steps only"
    assert user.set(PLAYING) == (
        SetResponse.STATE_TRANSITION_ERROR,
        "time.mode is lockstep: the rig advances by steps only, so it cannot play",
    )
    user.call("step_simulation", StepRequest(3))
    for scope in (ResetRequest.SCOPE_DEFAULT, ResetRequest.SCOPE_ALL, ResetRequest.SCOPE_TIME, 3, 4, 6, 8, 10, 254):
        refused = user.call("reset_simulation", ResetRequest(scope)).result
        assert refused.result == Result.RESULT_FEATURE_UNSUPPORTED
        assert "time continues" in refused.error_message
        assert "SCOPE_STATE (2)" in refused.error_message
    for _ in range(3):
        done = user.call("reset_simulation", ResetRequest(ResetRequest.SCOPE_STATE)).result
        assert done == Result(Result.RESULT_OK, "")
    user.call("step_simulation", StepRequest(1))
    client.wait_until(lambda: len(scans) == 4, "the blocks of the steps")
    first, *_, last = scans.tables()
    assert last.stamp_ns > first.stamp_ns

    client.trigger("rig/stop")
    refused = user.call("reset_simulation", ResetRequest(ResetRequest.SCOPE_STATE)).result
    assert (refused.result, "latched" in refused.error_message) == (Result.RESULT_OPERATION_FAILED, True)
    assert user.set(STOPPED)[0] == SetResponse.STATE_TRANSITION_ERROR
    assert user.set(17)[0] == Result.RESULT_FEATURE_UNSUPPORTED


def test_a_restarted_rig_is_not_reported_as_stopped(user: User) -> None:
    """A new rig, paused at the time at which the previous one was stopped, does not report STOPPED, and takes steps."""
    client = user.client
    host_rig(client, "lockstep", time__peers=["client"])
    client.wait_active("rig")
    client.collect("daq/scan", acknowledge=True)
    user.call("step_simulation", StepRequest(5))
    assert user.set(STOPPED) == (Result.RESULT_OK, "")
    assert user.state == STOPPED
    for transition in ("deactivate", "activate"):
        assert client.change_state("rig", transition)
    client.pause()
    for _ in range(2):
        assert user.call("step_simulation", StepRequest(5)).result == Result(Result.RESULT_OK, "")
        assert user.state == PAUSED


def test_a_pause_is_answered_when_the_peers_have_acknowledged(user: User) -> None:
    client = user.client
    host_rig(client, "free_running", time__peers=["client"])
    scans = client.collect("daq/scan")
    client.wait_active("rig")
    client.wait_until(lambda: len(scans) > 3, "blocks without an acknowledgement")
    answers = user.begin("set_simulation_state", SetRequest(SimulationState(PAUSED)))
    assert (answers, user.state) == ([], PAUSED)
    client.acknowledge_for("client", scans.tables()[-1].stamp_ns)
    client.wait_until(lambda: answers, "the answer")
    assert answers[0].result.result == Result.RESULT_OK


def test_a_stop_whose_reset_is_impossible_is_answered_with_the_reason(user: User) -> None:
    client = user.client
    host_rig(client, "free_running", time__peers=["client"], drive__amplitude=0.5)
    scans = client.collect("daq/scan")
    client.wait_active("rig")
    client.wait_until(lambda: len(scans) > 3, "blocks without an acknowledgement")
    client.set_parameters("rig", {"shaker.current_limit_a_rms": 0.1})
    answers = user.begin("set_simulation_state", SetRequest(SimulationState(STOPPED)))
    client.acknowledge_for("client", scans.tables()[-1].stamp_ns)
    client.wait_until(lambda: answers, "the answer")
    assert answers[0].result.result == SetResponse.STATE_TRANSITION_ERROR
    assert "drive.amplitude" in answers[0].result.error_message


def test_a_rig_that_is_asked_to_quit_reports_it(user: User) -> None:
    node = host_rig(user.client)
    assert user.set(QUITTING) == (Result.RESULT_OK, "")
    assert user.state == QUITTING
    assert user.set(PLAYING) == (SetResponse.INCORRECT_TRANSITION, "the state cannot change: the rig is quitting")
    assert node.quitting


def test_a_node_that_quits_ends_its_process(monkeypatch: pytest.MonkeyPatch) -> None:
    ending = SimpleNamespace(received=0)
    made = []

    def make_node() -> RigNode:
        node = RigNode(parameter_overrides=ros_parameters({"output.autostart": False}))
        node.quitting = True
        node.steady_timer(5.0, lambda: setattr(ending, "received", 1))
        made.append(node)
        return node

    with isolated_domain() as domain_id:
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        assert process.run(make_node, ending) == 0
    assert (len(made), ending.received) == (1, 0)
