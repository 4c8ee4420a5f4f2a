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
"""`docs/reference/interface.md` agrees with the code, and the code with the running graph."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from rcl_interfaces.srv import DescribeParameters, ListParameters
from std_msgs.msg import Float64, Header
from std_srvs.srv import SetBool, Trigger

from impact_rig import graph, topics
from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.graph import Situation
from impact_rig.nodes import messages
from impact_rig.nodes.__main__ import NODES, show_help
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.nodes.messages import TOPICS, by_name
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig_studies.stepped_sine_node import SteppedSineNode
from tools.generate import figures, interface

pytestmark = pytest.mark.ros


@pytest.mark.parametrize("topic", TOPICS, ids=lambda topic: topic.name)
def test_every_field_of_a_message_has_unit_and_meaning_and_exists(topic: topics.Topic) -> None:
    assert topic.fields
    for field in topic.fields:
        assert field.doc.endswith(".")
        assert field.unit
    if topic.columns is not None:
        assert list(topic.columns.names or ()) == [field.name for field in topic.fields]
        return
    for field in topic.fields:
        value = messages.class_of(topic)()
        for part in re.sub(r"\[\d\]", "", field.name).split("."):
            value = value[0] if isinstance(value, list) and value else value
            if isinstance(value, list):  # an empty list of messages: use the type of its elements
                value = messages.class_of(by_name("/diagnostics"))
                continue
            assert hasattr(value, part), f"{topic.name}: {field.name}"
            value = getattr(value, part)


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Client, dict[str, object]]]:
    """All three nodes, running, after a step with impacts and a fault."""
    directory = tmp_path_factory.mktemp("runs")
    with isolated_domain() as domain_id, Client(domain_id) as client:
        nodes = {
            "analysis": client.host(AnalysisNode),
            "recorder": client.host(RecorderNode, parameter_overrides=ros_parameters({"directory": str(directory)})),
            "stepped_sine": client.host(SteppedSineNode),
            "rig": host_rig(client, time__peers=["analysis", "recorder"], drive__amplitude=0.52),
        }
        client.wait_active(*nodes)
        client.step(60)
        yield client, nodes


def test_the_page_lists_the_services_of_the_graph(running) -> None:
    client, nodes = running
    for name in nodes:
        found = dict(client.node.get_service_names_and_types_by_node(name, "/"))
        own = {f"~/{key.removeprefix(f'/{name}/')}": types for key, types in found.items()}
        expected = {row.name: [row.type_name] for row in graph.SERVICES if row.node == name}
        elsewhere = {*graph.ROS_SERVICES, *graph.SIMULATION_SERVICES.values()}  # those of a package, if it is there
        assert {key: types for key, types in own.items() if key not in elsewhere} == expected, name


def test_the_page_lists_the_parameters_of_the_graph_with_unit_and_range(running) -> None:
    """Compare with the output of `ros2 param list` and `ros2 param describe`."""
    client, nodes = running
    for node in nodes:
        listed = client.call(ListParameters, f"{node}/list_parameters", ListParameters.Request()).result.names
        own = [n for n in listed if not n.startswith(("qos_overrides", "use_sim_time", "start_type", "config_file"))]
        fields = {name: about for name, about, _ in interface.SCHEMAS[node].fields()}
        assert sorted(own) == sorted(fields), node
        request = DescribeParameters.Request(names=list(fields))
        found = client.call(DescribeParameters, f"{node}/describe_parameters", request).descriptors
        for descriptor, (name, about) in zip(found, fields.items(), strict=True):
            assert descriptor.name == name
            assert descriptor.read_only == about.read_only
            assert descriptor.description.startswith(about.doc)
            assert about.unit == "-" or f"[{about.unit}]" in descriptor.description
            ranges = [*descriptor.floating_point_range, *descriptor.integer_range]
            assert bool(ranges) == (about.low is not None or about.high is not None), name
            for limit in ranges:
                assert about.low is None or limit.from_value == about.low
                assert about.high is None or limit.to_value == about.high


def _pattern(figure: figures.Figure) -> str:
    return re.sub(r"<\w+>", r"[\\w/]+", figure.key.replace(".", r"\."))


def test_the_page_lists_the_figures_of_the_diagnostics(running) -> None:
    client, nodes = running
    client.diagnostics.clear()
    for name, node in nodes.items():
        node.report_now()
        client.wait_until(lambda name=name: client.figures(name), f"diagnostics of {name}")
    known = {name: (*figures.EVERY_NODE, *figures.FIGURES[name]) for name in nodes}
    for name in nodes:
        for key in client.figures(name):
            assert any(re.fullmatch(_pattern(figure), key) for figure in known[name]), f"{name} publishes {key}"
    published = client.figures("rig")
    # in real time, and where a peer has lost blocks
    only_elsewhere = {"lateness_median_ms", "lateness_p99_ms", "lateness_worst_ms", "lost.<peer>"}
    for figure in figures.RIG:
        found = any(re.fullmatch(_pattern(figure), key) for key in published)
        assert found or figure.key in only_elsewhere, f"the page promises {figure.key}"


# Programs


@pytest.mark.parametrize("node", [*NODES])
def test_the_help_of_a_node_prints_its_usage_and_starts_no_node(node: str) -> None:
    """`rig_node --help` must print its usage, and not start a rig."""
    module = "impact_rig_lab.node" if node == "lab" else "impact_rig.nodes.__main__"
    call = f"import sys, {module} as m; sys.argv[1:] = ['--help']; m.{'main' if node == 'lab' else node}(); "
    done = subprocess.run(
        [sys.executable, "-c", f"{call}assert 'rclpy' not in sys.modules"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith(f"usage: {node}_node [-h] [--ros-args")
    assert done.stderr == ""
    (name, value) = re.search(r"-p ([a-z_.]+):=(\S+)\n", done.stdout).groups()
    if node in interface.SCHEMAS:  # its example is a parameter of the node, with a value it takes
        tree = interface.SCHEMAS[node]
        assert tree.from_flat(tree.root(), {name: yaml.safe_load(value)}) != tree.root()


def test_a_help_option_among_the_ros_arguments_is_left_to_ros() -> None:
    assert not show_help("rig", NODES["rig"], ["--ros-args", "-p", "--help"])


# Commands and services in every situation


def bring_into(client: Client, situation: Situation) -> None:
    """Bring a rig that is unconfigured into a situation."""
    if situation is Situation.UNCONFIGURED:
        return
    assert client.change_state("rig", "configure")
    if situation is Situation.INACTIVE:
        return
    assert client.change_state("rig", "activate")
    if situation is Situation.PAUSED:
        client.pause()
    elif situation is Situation.LATCHED:
        client.trigger("rig/stop")
    elif situation is Situation.PLUCKED:
        client.trigger("rig/pluck")


def bring_back(client: Client) -> None:
    if client.state("rig") == "active":
        client.trigger("rig/clear_trip")  # a latch outlives the active state
        assert client.change_state("rig", "deactivate")
    if client.state("rig") == "inactive":
        assert client.change_state("rig", "cleanup")


@pytest.fixture(scope="module")
def mortal() -> Iterator[tuple[Client, RigNode]]:
    with isolated_domain() as domain_id, Client(domain_id) as client:
        yield client, host_rig(client, output__autostart=False)


@pytest.fixture(scope="module")
def finalized() -> Iterator[tuple[Client, RigNode]]:
    with isolated_domain() as domain_id, Client(domain_id) as client:
        node = host_rig(client, output__autostart=False)
        assert client.change_state("rig", "shutdown_unconfigured")
        yield client, node


@pytest.fixture
def situated(situation: Situation, mortal, finalized) -> Iterator[tuple[Client, RigNode]]:
    """Rig in the given situation."""
    if situation is Situation.FINALIZED:
        yield finalized
        return
    bring_into(mortal[0], situation)
    yield mortal
    bring_back(mortal[0])


@pytest.mark.parametrize("situation", Situation)
@pytest.mark.parametrize("row", [row for row in graph.SERVICES if row.node == "rig"], ids=lambda row: row.name)
def test_services_answer_in_each_situation_as_documented(situated, situation: Situation, row: graph.Input) -> None:
    client, node = situated
    before = node.refusals.counts.total()
    kind, request = (SetBool, SetBool.Request(data=True)) if row.name == "~/pause" else (Trigger, Trigger.Request())
    answer = client.call(kind, f"rig/{row.name[2:]}", request)
    assert answer.success == (situation in row.taken), answer.message
    assert answer.message
    assert node.refusals.counts.total() - before == (not answer.success), "each refusal is counted"
    if not answer.success:
        assert node.refusals.last[row.name[2:]] == answer.message


@pytest.mark.parametrize("situation", Situation)
@pytest.mark.parametrize("row", graph.COMMANDS, ids=lambda row: row.name)
def test_commands_are_accepted_or_rejected_in_each_situation_as_documented(
    situated, situation: Situation, row: graph.Input
) -> None:
    client, node = situated
    before, applied = node.refusals.counts.total(), len(client.applied)
    client.publish(by_name(row.name), Float64(data=10.0))

    def is_applied() -> bool:
        return any(table.rows[row.name[7:]][0] == 10.0 for table in client.applied.tables(applied))

    client.wait_until(lambda: node.refusals.counts.total() > before or is_applied(), "an answer")
    assert is_applied() == (situation in row.taken)
    assert node.refusals.counts.total() - before == (situation not in row.taken)


@pytest.mark.parametrize("situation", Situation)
def test_a_parameter_can_be_set_in_every_situation(situated, situation: Situation) -> None:
    client, node = situated
    for gap in (0.004, 0.006):
        client.set_parameters("rig", {"barriers.gap_m": gap})
        assert node.settings.barriers.gap_m == gap


# Readers of daq/scan


def test_the_rig_distinguishes_readers_by_their_acknowledgements(client: Client) -> None:
    """The rig publishes how far behind each peer is, and ignores unknown names."""
    node = host_rig(client, time__peers=[])
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.step(20)
    client.wait_until(lambda: len(scans) == 20, "the blocks")
    for number, name in ((4, "client"), (5, "client"), (9, "client"), (9, "nobody"), (9, "nob\u00f6dy")):
        header = Header(frame_id=name)
        header.stamp.nanosec = scans.tables()[number].stamp_ns
        client.publish(topics.ACK, header)

    def is_reported() -> bool:
        node.report_now()
        return client.figures("rig").get("other_acks") == "2"

    client.wait_until(is_reported, "the acknowledgements")
    found = client.figures("rig")
    assert found["behind.client"] == "10"
    assert int(found["subscribers"]) == 1
