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
"""Table of the ROS topics: name, type, quality of service, publisher and content of each topic.

Publishers, subscribers, recordings, the analysis of runs and `docs/reference/interface.md` use this table. It needs no
ROS: `impact_rig.nodes.messages` converts it for rclpy. The names are relative to a rig's namespace, except
`/diagnostics` and `/clock`. The queue length of the topics in `BULKY` depends on the configuration of the rig.
"""

from __future__ import annotations

import enum

import attrs
import numpy as np

from impact_rig import blocks
from impact_rig.blocks import NUMBER, Column, row_type

DATA_DEPTH = 1000  # messages that a data topic keeps: 10 s of 10 ms blocks, 1 s of 1 ms blocks
HISTORY_DEPTH = 5000
"""Number of entries that a late subscriber of the journal receives; a gap in `sequence` shows missing entries."""


class Qos(enum.Enum):
    """Qualities of service of the topics: messages kept, and whether late subscribers receive them.

    All are reliable with KEEP_LAST.
    """

    DATA = (DATA_DEPTH, False)
    STATE = (DATA_DEPTH, True)  # every change is delivered, and a late subscriber receives the last ones
    HISTORY = (HISTORY_DEPTH, True)
    LATCHED = (1, True)  # only the newest message matters
    EVENT = (10, False)  # commands, remarks, diagnostics

    @property
    def depth(self) -> int:
        """Number of messages kept for a slow subscriber, or for a late subscriber of a `transient_local` topic."""
        return self.value[0]

    @property
    def transient_local(self) -> bool:
        """Return whether a late subscriber receives the last `depth` messages published before it subscribed."""
        return self.value[1]


@attrs.frozen(eq=False)
class Topic:
    """Description of one topic: name, type, quality of service, publisher and content.

    Attributes:
        name: topic name, relative to the rig's namespace, or absolute by convention (`/clock`).
        type_name: ROS interface, `package/msg/Type`.
        qos: quality of service.
        publisher: node that publishes it; or `client`, `peers` or `every node`.
        doc: content of a message.
        fields: columns of a table, or the fields that are filled in another message.
        columns: row type of a table, made from `fields`; None for a topic without tables.
        frame_id: frame of the messages.
        recorded: whether the recorder writes it to every run. Topics for plotters are not recorded, because their data
            can be derived from the recorded ones; neither is `daq/ack`.
        further: numpy type that columns of a table must have which are not in `fields`. Empty means any type, because a
            later version may add columns.
    """

    name: str
    type_name: str
    qos: Qos
    publisher: str
    doc: str
    fields: tuple[Column, ...]
    columns: np.dtype[np.void] | None = None
    frame_id: str = ""
    recorded: bool = True
    further: str = ""


TABLE = "sensor_msgs/msg/PointCloud2"  # type of every table


def _table(name: str, qos: Qos, publisher: str, fields: tuple[Column, ...], doc: str) -> Topic:
    return Topic(name, TABLE, qos, publisher, doc, fields, row_type(fields), blocks.FRAME_DAQ)


def former_table(name: str, fields: tuple[Column, ...]) -> Topic:
    """Return the description of a former table topic, which only recordings of an earlier version contain."""
    return _table(name, Qos.HISTORY, "rig", fields, "")


SCAN = attrs.evolve(
    _table("daq/scan", Qos.DATA, "rig", blocks.SCAN_COMMON_COLUMNS, "One block of scans; stamp = first scan."),
    further=NUMBER,
)
INFO = _table(
    "daq/info",
    Qos.STATE,
    "rig",
    blocks.DAQ_INFO_COLUMNS,
    "Calibration, one row per channel; stamp = start of its validity.",
)
APPLIED = _table(
    "shaker/applied",
    Qos.STATE,
    "rig",
    blocks.APPLIED_COLUMNS,
    "Drive of the shaker from a sample on; one row per accepted change, published on acceptance.",
)
JOURNAL = Topic(
    "rig/journal",
    "std_msgs/msg/String",
    Qos.HISTORY,
    "rig",
    "Every state-changing input with its sample index, from the last `start` or `reset` on (sequence 0).",
    (Column("data", "-", "One JSON object, see Entries of rig/journal."),),
)
CONFIGURATION = Topic(
    "rig/configuration",
    "std_msgs/msg/String",
    Qos.STATE,
    "rig",
    "The complete current configuration, as a ROS 2 parameter file.",
    (Column("data", "-", "YAML for `--params-file` and `impact-rig check`."),),
)
ROBOT_DESCRIPTION = Topic(
    "robot_description",
    "std_msgs/msg/String",
    Qos.LATCHED,
    "rig",
    "The rig as URDF, for RViz and robot_state_publisher; published again when it changes.",
    (Column("data", "-", "URDF; its joints are those of truth/joint_states, its frames those of the headers."),),
)
JOINT_STATES = Topic(
    "truth/joint_states",
    "sensor_msgs/msg/JointState",
    Qos.DATA,
    "rig",
    "True positions and velocities of base, structure and sphere at monitor rate; effort = contact force on it.",
    (
        Column("name", "-", "base, structure, sphere: the order of the other members."),
        Column("position", "m", "x_b, x_1, x_2."),
        Column("velocity", "m/s", "v_b, v_1, v_2."),
        Column("effort", "N", "Contact force on each body, positive to the right."),
    ),
    frame_id="rig",
)
IMPACTS_TRUTH = _table(
    "truth/impacts", Qos.DATA, "rig", blocks.IMPACTS_COLUMNS, "The contacts that ended in a block; time = their start."
)
TRUTH_SCAN = _table(
    "truth/scan",
    Qos.DATA,
    "rig",
    blocks.TRUTH_SCAN_COLUMNS,
    "The instants of daq/scan without instruments (output.truth_scan).",
)
FAULTS = _table("truth/faults", Qos.STATE, "rig", blocks.FAULTS_COLUMNS, "Instrument faults as they start and end.")
TRANSMISSIBILITY = Topic(
    "transmissibility",
    "std_msgs/msg/Float64",
    Qos.DATA,
    "analysis",
    "Last settled transmissibility, for plotters.",
    (Column("data", "-", "Value as in transmissibility/table."),),
)
TRANSMISSIBILITY_TABLE = _table(
    "transmissibility/table", Qos.STATE, "analysis", blocks.TRANSMISSIBILITY_COLUMNS, "One row per measurement."
)
ANALYSIS_SETTINGS = _table(
    "analysis/settings",
    Qos.STATE,
    "analysis",
    blocks.SETTINGS_COLUMNS,
    "Settings of the measurement and the operator's gap label, when they change; stamp = start of their validity.",
)
SWEEP = _table(
    "sweep/table",
    Qos.STATE,
    "stepped_sine",
    blocks.SWEEP_COLUMNS,
    "Measurements of a sweep, or samples of a phase lock, as they are made; stamp = start of the sweep.",
)
IMPACTS = _table(
    "impacts", Qos.DATA, "analysis", blocks.DETECTED_IMPACTS_COLUMNS, "Impacts detected from the accelerometer alone."
)
FREQUENCY = Topic(
    "shaker/frequency",
    "std_msgs/msg/Float64",
    Qos.EVENT,
    "client",
    "Command: drive frequency of a sine.",
    (Column("data", "Hz", "Within shaker.frequency_min_hz and shaker.frequency_max_hz."),),
)
CURRENT = Topic(
    "shaker/current",
    "std_msgs/msg/Float64",
    Qos.EVENT,
    "client",
    "Command: drive amplitude.",
    (
        Column(
            "data", "A", "Peak (rms for random); its rms is at most shaker.current_limit_a_rms. m or V by drive.kind."
        ),
    ),
)
WAVEFORM = _table(
    "shaker/waveform",
    Qos.DATA,
    "client",
    blocks.WAVEFORM_COLUMNS,
    "Command: samples of the drive (drive.waveform: stream); stamp = first sample. No rows end the stream there.",
)
STREAM = _table(
    "shaker/stream",
    Qos.LATCHED,
    "rig",
    blocks.STREAM_COLUMNS,
    "State of the stream of samples after each block: the sample needed next, and counters.",
)
NOTES = Topic(
    "notes",
    "std_msgs/msg/String",
    Qos.EVENT,
    "client",
    "Operator's remarks, recorded with the run.",
    (Column("data", "-", "Any text; `gap_m=0.006 at 1000000000` labels the gap from that rig time [ns] on."),),
)
ACK = Topic(
    "daq/ack",
    "std_msgs/msg/Header",
    Qos.DATA,
    "peers",
    "A peer (frame_id) has processed daq/scan up to the block with this stamp: one block, or several.",
    (Column("stamp", "-", "Stamp of the block."), Column("frame_id", "-", "Node name of the peer.")),
    recorded=False,
)


def _plotted(name: str, qos: Qos, doc: str, *fields: Column) -> Topic:
    return Topic(
        f"plot/{name}", "geometry_msgs/msg/Vector3Stamped", qos, "plot", f"For plotters: {doc}", fields,
        frame_id=blocks.FRAME_DAQ, recorded=False,
    )  # fmt: skip


def _extremes(name: str, unit: str, doc: str) -> Topic:
    least, most = Column("vector.x", unit, "Least value."), Column("vector.y", unit, "Largest value.")
    return _plotted(f"envelope/{name}", Qos.DATA, doc, least, most, Column("vector.z", unit, "Root mean square."))


PLOT_TRANSMISSIBILITY = _plotted(
    "transmissibility",
    Qos.LATCHED,
    "last settled transmissibility; stamp = last scan measured.",
    Column("vector.x", "-", "Transmissibility."),
    Column("vector.y", "-", "Standard uncertainty of the transmissibility."),
    Column("vector.z", "rad", "Phase of x_1 relative to x_b."),
)
PLOT_DRIVE = _plotted(
    "drive",
    Qos.LATCHED,
    "the newest shaker/applied, at each change and once a second.",
    Column("vector.x", "Hz", "Drive frequency."),
    Column("vector.y", "A", "Amplitude commanded (m or V by `drive.kind`)."),
)
PLOT_PULSES = _extremes(
    "pulses", "m/s^2", "the accelerometer above 500 Hz, every scan of an interval of 20 ms in three numbers."
)


def envelope(channel: str, unit: str) -> Topic:
    """Return the topic of a channel's envelope, for plotters.

    A message has the least, largest and rms value of the channel in 20 ms. Its stamp is that of the first scan.
    """
    return _extremes(channel, unit, "every scan of an interval of 20 ms in three numbers; stamp = its first scan.")


def spectrum(channel: str, unit: str) -> Topic:
    """Return the topic of a channel's amplitude spectrum, for plotters.

    Once a second, a message has the peak amplitudes of the last 4 s, up to 250 Hz. Its stamp is that of its last scan.
    """
    return Topic(
        f"plot/spectrum/{channel}",
        "geometry_msgs/msg/PolygonStamped",
        Qos.DATA,
        "plot",
        "For plotters: amplitudes of the last 4 s, flat-top window, bins of 0.25 Hz, once a second; stamp = last scan.",
        (Column("polygon.points", f"Hz, {unit}", "x: frequency, up to 250 Hz; y: amplitude of the line there, peak."),),
        frame_id=blocks.FRAME_DAQ,
        recorded=False,
    )


DIAGNOSTICS = Topic(
    "/diagnostics",
    "diagnostic_msgs/msg/DiagnosticArray",
    Qos.EVENT,
    "every node",
    "State of each node, at 1 Hz and on change.",
    (
        Column("header.stamp", "-", "Rig time in nodes that follow it."),
        Column("status[0].name", "-", "`NODE: COMPONENT`, the node's name with its namespace."),
        Column("status[0].hardware_id", "-", "`impact_rig` and the namespace: one per rig."),
        Column("status[0].level", "-", "0 OK, 1 WARN, 2 ERROR."),
        Column("status[0].message", "-", "Description of the state, in one sentence."),
        Column("status[0].values", "-", "See Diagnostics."),
    ),
)
CLOCK = Topic(
    "/clock",
    "rosgraph_msgs/msg/Clock",
    Qos.DATA,
    "rig",
    "Rig time; by default it is published unless the rig runs in real time x 1 (time.publish_clock).",
    (Column("clock", "-", "Rig time at the end of the newest block."),),
)

COMMON = (
    SCAN, INFO, APPLIED, JOURNAL, CONFIGURATION, ROBOT_DESCRIPTION, JOINT_STATES, IMPACTS_TRUTH, TRUTH_SCAN, FAULTS,
    TRANSMISSIBILITY, TRANSMISSIBILITY_TABLE, ANALYSIS_SETTINGS, SWEEP, IMPACTS, PLOT_TRANSMISSIBILITY,
    PLOT_DRIVE, PLOT_PULSES, FREQUENCY, CURRENT, WAVEFORM, STREAM, NOTES, ACK, DIAGNOSTICS, CLOCK,
)  # fmt: skip
"""All topics that do not depend on the instruments; `nodes.messages.TOPICS` adds those of the instruments' monitors."""
BULKY = (SCAN, TRUTH_SCAN)
"""Topics of which a rig keeps a number of messages that depends on the length of its blocks."""
