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
"""Description of the graph: nodes with their topics, services and clock, and the names that a launch file remaps.

With `impact_rig.topics` it is the one source of `docs/reference/interface.md`, `interface.json`, the SROS2 policy, the
picture of the nodes and the remappings of the launch files. Tests compare it with the running nodes and ask every
service in every situation. It needs no ROS.
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
    """Return the text in front of the frames of a rig, which keeps those of two rigs apart.

    Args:
        namespace: namespace of the node; `/left/rig` gives `left/rig/`.
        given: `output.frame_prefix`, which replaces it unless empty; `/` gives none, as tf2 takes no leading slash.
    """
    if given:
        return given.lstrip("/")
    inner = namespace.strip("/")
    return f"{inner}/" if inner else ""


def clock_remapping(clock: str) -> tuple[str, str]:
    """Return the remapping that gives a node its clock.

    ROS has one global `/clock`; the rig time of two rigs is two times. A relative name gives each namespace its own.
    """
    return topics.CLOCK.name, clock


STATE_PUBLISHER_REMAPPINGS = (
    (topics.JOINT_STATES.name.rpartition("/")[2], topics.JOINT_STATES.name),
    # the description of the rig follows its gap, so this node must not publish another one under that name
    (topics.ROBOT_DESCRIPTION.name, f"robot_state_publisher/{topics.ROBOT_DESCRIPTION.name}"),
)
"""Remappings of robot_state_publisher: it reads the true joint positions."""


class Situation(enum.StrEnum):
    """What a node can be in the middle of: a lifecycle state, and within `active` what matters to its inputs."""

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
    """One row: a service, or the topic of a command."""

    name: str  # topic, or private service name
    type_name: str  # ROS interface; empty for a topic, whose type the table of topics has
    node: str  # node that takes it
    doc: str  # what it does
    taken: frozenset[Situation]
    """The situations in which it is taken; in the others it is refused with a message and counted."""


COMMANDS = (
    Input(topics.FREQUENCY.name, "", "rig", "Drive frequency.", frozenset({Situation.RUNNING, Situation.PAUSED})),
    Input(topics.CURRENT.name, "", "rig", "Drive amplitude.", frozenset({Situation.RUNNING, Situation.PAUSED})),
)

SERVICES = (
    Input(
        "~/pause",
        SET_BOOL,
        "rig",
        "true: hold rig time; answered when the peers have processed all that is out. false: go on, without what a "
        "silent peer missed, and where others are followed without that peer until it acknowledges again.",
        _ACTIVE,
    ),
    Input(
        "~/step",
        TRIGGER,
        "rig",
        "Advance by `step.blocks`, while paused or with `time.mode: lockstep`; answered when the last block is out and "
        "acknowledged by all `time.peers`. A paused rig stays paused.",
        _ACTIVE,
    ),
    Input(
        "~/reset",
        TRIGGER,
        "rig",
        "Begin again with the present configuration: scan 0, everything at rest; stamps go on, a new journal begins.",
        _ACTIVE - {Situation.LATCHED},
    ),
    Input(
        "~/stop",
        TRIGGER,
        "rig",
        "Emergency stop: ramp to zero within `shaker.stop_ramp_s`, and latch until `~/clear_trip`, also across "
        "deactivation.",
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
        "Lock the base and release x_1 from `pluck.displacement_m`: free decay until ~/reset.",
        _ACTIVE,
    ),
    Input(
        "~/start",
        TRIGGER,
        "recorder",
        "Start a recording; answered with its directory once it holds calibration, configuration, present command and "
        "journal. Refused while there is one.",
        frozenset({Situation.RUNNING}),
    ),
    Input(
        "~/start",
        TRIGGER,
        "stepped_sine",
        "Begin a sweep, or the search for a resonance. Refused while one is under way, or while rig or analysis are "
        "not there.",
        frozenset({Situation.RUNNING}),
    ),
    Input("~/stop", TRIGGER, "stepped_sine", "Abort the sweep or the lock, the shaker at rest.", _ANY),
    Input("~/stop", TRIGGER, "recorder", "Finish the recording; answered with its directory.", _ANY),
)
"""Every service besides those of ROS itself (parameters, lifecycle)."""

SIMULATION_PACKAGE = "simulation_interfaces"
SIMULATION_SERVICES = {
    "GetSimulatorFeatures": "~/get_simulator_features",
    "GetSimulationState": "~/get_simulation_state",
    "SetSimulationState": "~/set_simulation_state",
    "StepSimulation": "~/step_simulation",
    "ResetSimulation": "~/reset_simulation",
}
"""Services that the rig offers where the package `simulation_interfaces` is installed: type and name."""

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
    """Topics and clock of one node; the services are those of its name in `SERVICES`."""

    name: str
    program: str
    publishes: tuple[str, ...] = ()  # in addition to the topics whose publisher it is
    subscribes: tuple[str, ...] = ()
    subscribes_recorded: bool = False  # every topic that belongs into a run
    makes_time: bool = False  # publishes the clock; other nodes follow it where rig time is not the system time

    def published(self, table: Iterable[topics.Topic]) -> list[str]:
        """Return the topics that it publishes, relative names, without those of ROS itself."""
        own = [topic.name for topic in table if topic.publisher in (self.name, topics.DIAGNOSTICS.publisher)]
        return [*own, *self.publishes]

    def subscribed(self, table: Iterable[topics.Topic]) -> list[str]:
        """Return the topics that it subscribes to, relative names; the clock where it follows it."""
        recorded = [topic.name for topic in table if topic.recorded] if self.subscribes_recorded else []
        clock = [] if self.makes_time else [topics.CLOCK.name]
        return list(dict.fromkeys((*self.subscribes, *recorded, *clock)))

    def services(self) -> list[str]:
        """Return its services, private names, without those of ROS itself."""
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
            topics.INFO.name, topics.SCAN.name, topics.JOURNAL.name, topics.APPLIED.name,
            topics.TRANSMISSIBILITY_TABLE.name, "base_displacement",
        ),
    ),
)  # fmt: skip
"""The nodes whose interface is described; the page of the lab is a client like a user's own node."""
