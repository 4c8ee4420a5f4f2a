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
"""Calls of the `ros2` command line, made through rclpy, and their deviations from the documentation.

`python -m qualification.ros2_calls` (a minute) starts two rigs in two namespaces as processes, one free-running and one
at half of real time, each with its own clock. It then starts a rig with all topics renamed. Each line names the command
that it replaces. The wheels contain no ros2cli, but list, info, echo, hz, param, lifecycle and service are only a few
lines on top of rclpy.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import yaml
from lifecycle_msgs.srv import GetAvailableTransitions, GetState
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters, SetParameters
from rclpy.parameter import parameter_dict_from_yaml_file, parameter_value_to_python

from impact_rig.client import Client, Processes, isolated_domain
from impact_rig.client.client import WaitTimeoutError, ros_parameters
from impact_rig.config.tree import nested
from impact_rig.graph import SERVICES
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.messages import TOPICS, nanoseconds
from impact_rig.nodes.plot_node import PlotDataNode
from impact_rig.nodes.rig_node import RigNode

NODES = ("rig", "analysis", "recorder", "plot")
MODES: dict[str, dict[str, Any]] = {
    "/one": {"time.mode": "free_running"},
    "/two": {"time.mode": "realtime", "time.factor": 0.5},
}
ECHOED = (
    "daq/scan",
    "daq/info",
    "laser",
    "accelerometer",
    "truth/joint_states",
    "robot_description",
    "rig/configuration",
)
HZ = {"daq/scan": 100.0, "laser": 50.0, "truth/joint_states": 50.0, "plot/envelope/laser": 50.0}
"""Rate of messages per second of rig time."""


class Calls:
    """Counter of calls, with a list of those that did not answer as documented.

    Args:
        say: function that receives a line for every call.
    """

    def __init__(self, say: Callable[[str], None] = lambda _line: None) -> None:
        self.count = 0
        self.wrong: list[str] = []
        self._say = say

    def hold(self, command: str, as_documented: object, found: object = "") -> None:
        """Count one call; `as_documented` is true if it answered as documented."""
        self.count += 1
        line = f"{'ok   ' if as_documented else 'WRONG'} {command}{f': {found}' if not as_documented else ''}"
        self._say(line)
        if not as_documented:
            self.wrong.append(line)


def topics(calls: Calls, client: Client, renamed: str = "") -> None:
    """Check `ros2 topic list` and `info` for every topic that rig and analysis publish, possibly under other names."""
    for topic in TOPICS:
        if topic.publisher not in ("rig", "analysis", "plot") or topic.name.startswith("/"):
            continue
        name = client.node.resolve_topic_name(renamed + topic.name)
        found = client.node.get_publishers_info_by_topic(name)
        right = len(found) == 1 and found[0].topic_type == topic.type_name and found[0].node_name == topic.publisher
        calls.hold(f"ros2 topic info -v {name}", right, found)


def echo_and_hz(calls: Calls, client: Client) -> None:
    """Check `ros2 topic echo --once` and `hz`, the latter by stamps, because the rate is one in rig time."""
    for name in ECHOED:
        heard = client.collect(name)
        client.wait_until(lambda heard=heard: heard.received, f"a message of {name}")
        calls.hold(f"ros2 topic echo --once {client.node.resolve_topic_name(name)}", heard.received)
    for name, rate in HZ.items():
        heard = client.collect(name)
        client.wait_until(lambda heard=heard: len(heard) >= 12, f"messages of {name}")
        messages = heard.tables() if name == "daq/scan" else heard.messages
        stamps = [one.stamp_ns if name == "daq/scan" else nanoseconds(one.header.stamp) for one in messages]
        steps = {after - before for before, after in itertools.pairwise(stamps)}
        calls.hold(f"ros2 topic hz {client.node.resolve_topic_name(name)}", steps == {round(1e9 / rate)}, steps)


def parameters(calls: Calls, client: Client, node: str, directory: Path) -> None:
    """Check `ros2 param list`, `describe`, `get`, `dump`, `load` and `dump` again, and `set` of an unknown name."""
    names = client.call(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
    calls.hold(f"ros2 param list {node}", names)
    request = DescribeParameters.Request(names=names)
    described = client.call(DescribeParameters, f"{node}/describe_parameters", request).descriptors
    own = [one for one in described if not one.name.startswith(("qos_overrides", "use_sim", "start_type"))]
    calls.hold(f"ros2 param describe {node}", all(one.description for one in own), own)
    paths = [directory / f"{node}_{number}.yaml" for number in range(2)]
    _dump(client, node, names, paths[0])
    calls.hold(f"ros2 param dump {node}", paths[0].stat().st_size)
    written = list(yaml.safe_load(paths[0].read_text(encoding="utf-8")))
    sent = list(parameter_dict_from_yaml_file(str(paths[0]), target_nodes=written).values())
    results = client.call(SetParameters, f"{node}/set_parameters", SetParameters.Request(parameters=sent)).results
    refused = [result.reason for result in results if not result.successful]
    calls.hold(f"ros2 param load {node}", not refused, refused)
    _dump(client, node, names, paths[1])
    calls.hold(f"ros2 param dump {node} (again)", paths[0].read_bytes() == paths[1].read_bytes())
    request = SetParameters.Request(parameters=[one.to_parameter_msg() for one in ros_parameters({"no_such": 1})])
    (result,) = client.call(SetParameters, f"{node}/set_parameters", request).results
    calls.hold(f"ros2 param set {node} no_such 1", not result.successful and "unknown key" in result.reason, result)


def _dump(client: Client, node: str, names: list[str], path: Path) -> None:
    answer = client.call(GetParameters, f"{node}/get_parameters", GetParameters.Request(names=names))
    values = {name: parameter_value_to_python(one) for name, one in zip(names, answer.values, strict=True)}
    tree = nested({name: list(x) if hasattr(x, "tolist") else x for name, x in sorted(values.items())}, dict)
    path.write_text(yaml.dump({f"/{node}": {"ros__parameters": tree}}, default_flow_style=False), encoding="utf-8")


def services(calls: Calls, client: Client, nodes: tuple[str, ...] = NODES) -> None:
    """Check `ros2 service list -t` for our services on each node."""
    expected = {
        client.node.resolve_topic_name(f"{row.node}/{row.name[2:]}"): (row.node, row.type_name)
        for row in SERVICES
        if row.node in nodes
    }

    def known(node: str) -> dict[str, list[str]]:
        return dict(client.node.get_service_names_and_types_by_node(node, client.node.get_namespace()))

    with contextlib.suppress(WaitTimeoutError):  # new parts of the graph become known after some time
        client.wait_until(lambda: expected.keys() <= {name for node in nodes for name in known(node)}, "services")
    for name, (node, type_name) in expected.items():
        found = known(node).get(name)
        calls.hold(f"ros2 service type {name}", found == [type_name], found)


def lifecycle(calls: Calls, client: Client, node: str) -> None:
    """Check `ros2 lifecycle get` and `list`."""
    state = client.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label
    calls.hold(f"ros2 lifecycle get {node}", state == "active", state)
    request = GetAvailableTransitions.Request()
    found = client.call(GetAvailableTransitions, f"{node}/get_available_transitions", request).available_transitions
    labels = {one.transition.label for one in found}
    calls.hold(f"ros2 lifecycle list {node}", labels == {"deactivate", "shutdown"}, labels)


def operation(calls: Calls, client: Client) -> None:
    """Check `ros2 service call` for an operator's actions, `ros2 param set` and `ros2 lifecycle set`."""
    client.command(frequency_hz=9.2, current_a=0.2)
    calls.hold("ros2 topic pub shaker/current", True)
    client.pause()
    calls.hold("ros2 service call rig/pause true", True)
    answer = client.trigger("rig/step")
    calls.hold("ros2 service call rig/step", answer.startswith("rig time "), answer)
    client.pause(False)
    calls.hold("ros2 service call rig/pause false", True)
    for name, text in (
        ("stop", "stays latched"),
        ("clear_trip", "latch released"),
        ("pluck", "locked"),
        ("reset", "scan 0"),
    ):
        answer = client.trigger(f"rig/{name}")
        calls.hold(f"ros2 service call rig/{name}", text in answer, answer)
    client.set_parameters("rig", {"barriers.gap_m": 0.01})
    gap = client.get_parameters("rig", ["barriers.gap_m"])
    calls.hold("ros2 param set rig barriers.gap_m 0.01", gap == {"barriers.gap_m": 0.01}, gap)
    for transition in ("deactivate", "activate"):
        calls.hold(f"ros2 lifecycle set rig {transition}", client.change_state("rig", transition))


def clocks(calls: Calls, clients: dict[str, Client]) -> None:
    """Check that two rigs have two clocks, and that the global one has no publisher."""
    for namespace, client in clients.items():
        found = client.node.get_publishers_info_by_topic(f"{namespace}/clock")
        owners = [f"{one.node_namespace}/{one.node_name}" for one in found]
        calls.hold(f"ros2 topic info {namespace}/clock", owners == [f"{namespace}/rig"], owners)
    count = next(iter(clients.values())).node.count_publishers("/clock")
    calls.hold("ros2 topic info /clock", count == 0, count)


def renamed(calls: Calls) -> None:
    """Check `--ros-args -r TOPIC:=renamed/TOPIC` for every topic of rig and analysis."""
    rules = [f"{topic.name}:=renamed/{topic.name}" for topic in TOPICS if not topic.name.startswith("/")]
    arguments = ["--ros-args", *itertools.chain.from_iterable(("-r", rule) for rule in rules)]
    with isolated_domain() as domain_id, Client(domain_id) as client:
        client.host(AnalysisNode, cli_args=arguments)
        client.host(PlotDataNode, cli_args=arguments)
        parameters = ros_parameters({"time.mode": "lockstep"})
        client.host(RigNode, parameter_overrides=parameters, cli_args=arguments)
        client.wait_active("rig", "analysis", "plot")
        topics(calls, client, "renamed/")


def two_rigs(calls: Calls, directory: Path) -> None:
    """Make all calls for two rigs at once."""
    with isolated_domain() as domain_id:
        started = {name: Processes(domain_id, directory / name.strip("/"), name) for name in MODES}
        clients: dict[str, Client] = {}
        try:
            for namespace, processes in started.items():
                for node in NODES:
                    more = {"rig": {**MODES[namespace], "time.peers": ["analysis", "recorder"]}}
                    more["recorder"] = {"directory": str(directory / "runs" / namespace.strip("/"))}
                    follow = {} if node == "rig" else {"use_sim_time": True}
                    program = [sys.executable, "-m", "impact_rig.nodes", node, "--ros-args", "-r", "/clock:=clock"]
                    processes.start(node, {**more.get(node, {}), **follow}, command=program)
                clients[namespace] = Client(domain_id, namespace, processes)
            for client in clients.values():
                client.wait_active(*NODES)
                found = {
                    name
                    for name, space in client.node.get_node_names_and_namespaces()
                    if space == client.node.get_namespace()
                }
                calls.hold(f"ros2 node list {client.node.get_namespace()}", set(NODES) <= found, found)
                topics(calls, client)
                echo_and_hz(calls, client)
                services(calls, client)
                for node in NODES:
                    lifecycle(calls, client, node)
                    parameters(calls, client, node, directory)
                operation(calls, client)
            clocks(calls, clients)
        finally:
            for namespace, processes in started.items():
                if namespace in clients:
                    clients[namespace].close()
                codes = processes.stop()
                calls.hold(f"Ctrl-C {namespace}", set(codes.values()) == {0}, codes)


def main() -> int:
    """Make every call; return 0 if all answered as documented."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    calls = Calls(print)
    with tempfile.TemporaryDirectory() as directory:
        two_rigs(calls, Path(directory))
    renamed(calls)
    print(f"{calls.count} calls, {len(calls.wrong)} not as documented", *calls.wrong, sep="\n")  # noqa: T201  # a tool
    return 1 if calls.wrong else 0


if __name__ == "__main__":
    sys.exit(main())
