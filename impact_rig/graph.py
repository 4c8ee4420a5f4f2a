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
"""Description of a rig's ROS graph: nodes with their topics, services and clock, and names that a launch file remaps.

`docs/reference/interface.md`, `interface.json`, the SROS2 policy, the picture of the nodes and the remappings of the
launch files derive from this module and `impact_rig.topics`. Tests compare both with the running nodes and call every
service in every situation. The module works without ROS.
"""

from __future__ import annotations

import enum
from collections.abc import Iterable

import attrs

from impact_rig import topics

TRIGGER, SET_BOOL = "std_srvs/srv/Trigger", "std_srvs/srv/SetBool"


def resolve(name: str, namespace: str = "/", node: str = "") -> str:
    """Return the full name of a topic or service, as ROS resolves it for a node.

    Args:
        name: absolute, relative, or private (`~/name`).
        namespace: namespace of the node.
        node: name of the node, for private names.
    """
    if name.startswith("/"):
        return name
    inner = node + name[1:] if name.startswith("~") else name
    return "/" + "/".join(part for part in f"{namespace}/{inner}".split("/") if part)


def frame_prefix(namespace: str, given: str = "") -> str:
    """Return the prefix for the names of a rig's tf frames, so that several rigs can share one tf tree.

    Args:
        namespace: namespace of the rig node; `/left/rig` gives `left/rig/`.
        given: configuration value `output.frame_prefix`. Unless empty, it replaces the namespace, and is returned
            without leading slashes, which tf2 does not accept. So `/` gives no prefix. No slash is appended to it.
    """
    if given:
        return given.lstrip("/")
    inner = namespace.strip("/")
    return f"{inner}/" if inner else ""


def clock_remapping(clock: str) -> tuple[str, str]:
    """Return the remapping (from, to) by which a node publishes or follows the topic `clock` instead of `/clock`.

    ROS has one global `/clock`, but the rig times of two rigs differ. With the relative name `clock`, each namespace
    has its own clock topic.
    """
    return topics.CLOCK.name, clock


STATE_PUBLISHER_REMAPPINGS = (
    (topics.JOINT_STATES.name.rpartition("/")[2], topics.JOINT_STATES.name),
    # the rig publishes its description again when its gap changes: there must be no second one under that name
    (topics.ROBOT_DESCRIPTION.name, f"robot_state_publisher/{topics.ROBOT_DESCRIPTION.name}"),
)
"""Remappings (from, to) of robot_state_publisher, with which it reads the true joint positions of a rig.

The description that robot_state_publisher itself publishes gets another name, so that only the rig publishes
`robot_description`.
"""


class Situation(enum.StrEnum):
    """Situation of a node, which decides the inputs that the node accepts.

    It is the lifecycle state of the node. For the rig node, the state `active` is divided into `RUNNING`, `PAUSED`,
    `LATCHED` (the shaker is stopped until `~/clear_trip`) and `PLUCKED` (the base is locked).
    """

    UNCONFIGURED = "unconfigured"
    INACTIVE = "inactive"
    RUNNING = "active"
    PAUSED = "active, paused"
    LATCHED = "active, latched"  # by ~/stop or the interlock
    PLUCKED = "active, plucked"  # the base is locked
    FINALIZED = "finalized"


_ACTIVE = frozenset({Situation.RUNNING, Situation.PAUSED, Situation.LATCHED, Situation.PLUCKED})
_ANY = frozenset(Situation)


@attrs.frozen
class Input:
    """Service or command topic of a node, with the situations in which the node accepts it.

    Attributes:
        name: topic, or private service name.
        type_name: ROS interface; empty for a topic, whose type is in `impact_rig.topics`.
        node: node that accepts it.
        doc: its effect.
        taken: values of `Situation` in which the node accepts it; in all others the node rejects it with a message,
            and counts the rejection.
    """

    name: str
    type_name: str
    node: str
    doc: str
    taken: frozenset[Situation]


COMMANDS = (
    Input(topics.FREQUENCY.name, "", "rig", "Drive frequency.", frozenset({Situation.RUNNING, Situation.PAUSED})),
    Input(topics.CURRENT.name, "", "rig", "Drive amplitude.", frozenset({Situation.RUNNING, Situation.PAUSED})),
)

SERVICES = (
    Input(
        "~/pause",
        SET_BOOL,
        "rig",
        "true: pause rig time; answered when the peers have processed all published blocks, or when one of them is "
        "silent. false: continue, without waiting for the blocks that a silent peer missed; if other peers are left, "
        "without waiting for that peer at all until it acknowledges again.",
        _ACTIVE,
    ),
    Input(
        "~/step",
        TRIGGER,
        "rig",
        "Advance rig time by `step.blocks` blocks, while paused or with `time.mode: lockstep`; answered when the last "
        "block is published and acknowledged by all `time.peers`. A paused rig stays paused.",
        _ACTIVE,
    ),
    Input(
        "~/reset",
        TRIGGER,
        "rig",
        "Start the simulation again with the present configuration: scan 0, everything at rest; stamps continue, a new "
        "journal begins.",
        _ACTIVE - {Situation.LATCHED},
    ),
    Input(
        "~/stop",
        TRIGGER,
        "rig",
        "Emergency stop: ramp the drive amplitude to zero within `shaker.stop_ramp_s`, and latch: reject commands "
        "until `~/clear_trip`, also after the node was deactivated.",
        _ACTIVE,
    ),
    Input(
        "~/clear_trip",
        TRIGGER,
        "rig",
        "Release the latch of ~/stop or of the interlock; the amplitude stays zero until the next command.",
        _ACTIVE,
    ),
    Input(
        "~/pluck",
        TRIGGER,
        "rig",
        "Lock the inferior base and release the superior base from x_1 = `pluck.displacement_m`: free decay until "
        "~/reset.",
        _ACTIVE,
    ),
    Input(
        "~/start",
        TRIGGER,
        "recorder",
        "Start a recording; answered with its directory once it contains calibration, configuration, present "
        "command and journal. Rejected while one is running.",
        frozenset({Situation.RUNNING}),
    ),
    Input(
        "~/start",
        TRIGGER,
        "stepped_sine",
        "Start a sweep, or the search for a resonance. Rejected while one is running, or while rig or analysis "
        "are absent.",
        frozenset({Situation.RUNNING}),
    ),
    Input("~/stop", TRIGGER, "stepped_sine", "Abort the sweep or the phase lock, and ramp the shaker to rest.", _ANY),
    Input("~/stop", TRIGGER, "recorder", "Finish the recording, if any; answered with its directory.", _ANY),
)
"""All services except those of ROS itself (parameters, lifecycle)."""

SIMULATION_PACKAGE = "simulation_interfaces"
SIMULATION_SERVICES = {
    "GetSimulatorFeatures": "~/get_simulator_features",
    "GetSimulationState": "~/get_simulation_state",
    "SetSimulationState": "~/set_simulation_state",
    "StepSimulation": "~/step_simulation",
    "ResetSimulation": "~/reset_simulation",
}
"""Services that the rig offers if the package `simulation_interfaces` is installed: type and name."""

ROS_SERVICES = (
    "~/change_state", "~/describe_parameters", "~/get_available_states", "~/get_available_transitions",
    "~/get_parameter_types", "~/get_parameters", "~/get_state", "~/get_transition_graph", "~/get_type_description",
    "~/list_parameters", "~/set_parameters", "~/set_parameters_atomically",
)  # fmt: skip
"""Services that every lifecycle node of ROS has."""
ROS_TOPICS = ("/parameter_events", "/rosout", "~/transition_event")
"""Topics that every lifecycle node of ROS publishes."""


@attrs.frozen
class Node:
    """Topics and clock of one node; the services are those of its name in `SERVICES`.

    Attributes:
        name: name of the node.
        program: program that runs it.
        publishes: topics that it publishes although `impact_rig.topics` names another publisher for them.
        subscribes: topics that it subscribes to.
        subscribes_recorded: whether it also subscribes to all topics with `Topic.recorded`.
        makes_time: whether it publishes the clock; other nodes follow it if rig time is not the system time.
    """

    name: str
    program: str
    publishes: tuple[str, ...] = ()
    subscribes: tuple[str, ...] = ()
    subscribes_recorded: bool = False
    makes_time: bool = False

    def published(self, table: Iterable[topics.Topic]) -> list[str]:
        """Return the names of the topics of `table` that the node publishes, as in `impact_rig.topics`.

        The result contains `/diagnostics`, but not the topics of `ROS_TOPICS`.
        """
        own = [topic.name for topic in table if topic.publisher in (self.name, topics.DIAGNOSTICS.publisher)]
        return [*own, *self.publishes]

    def subscribed(self, table: Iterable[topics.Topic]) -> list[str]:
        """Return the names of the topics that the node subscribes to, as in `impact_rig.topics`.

        The result contains `/clock`, unless the node makes the time itself.

        Args:
            table: all topics, of which a node with `subscribes_recorded` subscribes to the recorded ones.
        """
        recorded = [topic.name for topic in table if topic.recorded] if self.subscribes_recorded else []
        clock = [] if self.makes_time else [topics.CLOCK.name]
        return list(dict.fromkeys((*self.subscribes, *recorded, *clock)))

    def services(self) -> list[str]:
        """Return the services of the node as private names (`~/name`), without those of `ROS_SERVICES`.

        The services of the rig node include those of `SIMULATION_SERVICES`.
        """
        own = [service.name for service in SERVICES if service.node == self.name]
        return [*own, *(SIMULATION_SERVICES.values() if self.makes_time else ())]


NODES = (
    Node(
        "rig",
        "rig_node",
        subscribes=(topics.FREQUENCY.name, topics.CURRENT.name, topics.WAVEFORM.name, topics.ACK.name),
        makes_time=True,
    ),
    Node(
        "analysis",
        "analysis_node",
        publishes=(topics.ACK.name,),
        subscribes=(topics.INFO.name, topics.SCAN.name, topics.NOTES.name, topics.APPLIED.name),
    ),
    Node(
        "plot",
        "plot_node",
        subscribes=(topics.INFO.name, topics.SCAN.name, topics.APPLIED.name, topics.TRANSMISSIBILITY_TABLE.name),
    ),
    Node("recorder", "recorder_node", publishes=(topics.ACK.name,), subscribes_recorded=True),
    Node(
        "stepped_sine",
        "stepped_sine_node",
        publishes=(topics.ACK.name, topics.FREQUENCY.name, topics.CURRENT.name),
        subscribes=(
            topics.INFO.name,
            topics.SCAN.name,
            topics.JOURNAL.name,
            topics.APPLIED.name,
            topics.TRANSMISSIBILITY_TABLE.name,
            "base_displacement",
        ),
    ),
)
"""Nodes whose interface is described; the page of the lab is a client like a user's own node."""
