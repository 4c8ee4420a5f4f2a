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
"""Recorder as a lifecycle node: it writes the raw bytes of every recorded topic into a run (an MCAP file).

The node handles topics, services and parameters; `impact_rig.recording.RunWriter` writes the file.
"""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import platform
import time
from collections import Counter, deque
from pathlib import Path
from typing import Any  # rclpy messages and handles

import attrs
import yaml
from std_msgs.msg import String
from std_srvs.srv import Trigger

import impact_rig
from impact_rig import states, topics
from impact_rig.blocks import Table
from impact_rig.config.fields import choice, integer, quantity, switch, text
from impact_rig.config.tree import Tree, parameters_in
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.names import FILE_NAME, FILE_NAME_MEANS, one_line
from impact_rig.nodes.acknowledgements import REPEATED_S, Acknowledgements
from impact_rig.nodes.managed import Done, Level, ManagedNode, NodeState, guarded
from impact_rig.nodes.messages import TOPICS
from impact_rig.recording import (
    CONFIGURATION,
    Account,
    Attachment,
    OfferedQos,
    Provenance,
    RunWriter,
    TopicDescription,
    schema_text,
)
from impact_rig.recording.losses import REPLACED
from impact_rig.simtime import NS_PER_S
from impact_rig.system.files import free_path
from impact_rig.system.machine import identity

FLUSH_S = 0.2
AWAITED = (topics.INFO, topics.APPLIED, topics.JOURNAL, topics.CONFIGURATION, topics.ANALYSIS_SETTINGS)
"""Latched topics that belong to every run; ~/start is answered when the recorder has received them."""
AWAIT_S = 2.0
RESULTS = frozenset({topics.TRANSMISSIBILITY_TABLE.name, topics.SWEEP.name})
"""Latched topics whose messages from before the start of a run are not recorded: they are earlier results."""
ONE_WRITER = {one.name for one in TOPICS if one.columns is not None} | {topics.CONFIGURATION.name, topics.JOURNAL.name}
"""Topics that only one node may publish: with two sources, a run could not be simulated or analysed again."""
QUIET_S = 0.1
"""Time [s] without a further configuration after which the last one counts as the active one.

A late subscriber receives all earlier configurations first.
"""
CALIBRATION = "calibration.yaml"
LATE_NS = NS_PER_S // 2  # a message that takes this long may have been lost and sent again
NEEDED = frozenset(topic.name for topic in TOPICS if topic.publisher == "rig" and topic.qos is not topics.Qos.LATCHED)
"""Topics of the rig of which every message counts; if the recorder loses one, it acknowledges no further block."""


@attrs.frozen(kw_only=True)
class RecorderSettings:
    """Parameters of the recorder node."""

    directory: str = text("runs", "Directory in which the directory of each run is created.")
    name: str = text(
        "",
        "Name of the run's directory; empty means run_, date and time, and a number if that name exists.",
        pattern=f"({FILE_NAME})?",
        means=FILE_NAME_MEANS,
    )
    record: bool = switch(
        True, "Whether recording starts at activation; otherwise it starts with ~/start.", read_only=True
    )
    compression: str = choice("zstd", ("none", "lz4", "zstd"), "Compression of the recorded data.")
    max_file_mb: int = integer(
        0, "MB", "Size at which a run continues in a further file; 0 = never.", at_least=0, at_most=1_000_000
    )
    configuration_wait_s: float = quantity(
        5.0, "s", "Longest wait for the rig's configuration, after which a run starts without it.", at_least=0
    )
    autostart: bool = switch(True, "Configure and activate at start without a request.", read_only=True)


class RecorderNode(ManagedNode[RecorderSettings]):
    """Lifecycle node that writes runs and acknowledges blocks of scans.

    While the node records, it acknowledges a block only after writing the block to the file. An acknowledgement covers
    all earlier blocks on all topics. Therefore the node sends none after it has lost a message of the rig, until ~/stop
    is called. After a failed recording, it sends none until ~/start or ~/stop is called. A rig that waits for this
    recorder then stops.
    """

    COMPONENT = "recording"
    STATES = states.RecorderWord

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", Tree(RecorderSettings), **kwargs)
        self._writer: RunWriter | None = None
        self._failure = ""
        self._configuration: str | None = None
        self._configured_at = math.inf
        self._waiting = False
        self._deadline = math.inf
        self._resolved: dict[str, str] = {}
        self._added: dict[str, str] = {}
        self._account = Account()
        self._refused: Counter[str] = Counter()
        self._newest_ns: int | None = None
        self._certificates = 0
        self._awaited: set[str] = set()
        self._opened_at = 0.0
        self._opened_ns = 0
        self._emptied_at = time.monotonic()  # time at which the inbox was last emptied
        self._late_at = -math.inf  # last time at which a block, or the emptying of the inbox, was late
        self._scans: Any = None
        self._recorded: list[Any] = []
        self._inbox: deque[tuple[topics.Topic, bytes, dict[str, Any]]] = deque()  # received and not processed yet
        self._acknowledgements = Acknowledgements(self, self._secured, self._take_all)
        self._starting: list[Done] = []
        self.service(Trigger, "~/start", self._on_start)
        self.service(Trigger, "~/stop", self._on_stop)

    def configure(self) -> None:
        """Check that all recorded message types have a definition to store; create the publisher of `daq/ack`."""
        for type_name in {topic.type_name for topic in TOPICS if topic.recorded}:
            schema_text(type_name)
        environment()  # cached here, while no rig waits
        self.offer(topics.ACK)

    def activate(self) -> None:
        """Subscribe to the configuration of the rig, and request a run if the parameter `record` is set.

        If `record` is not set, the node subscribes to the scans and acknowledges them. It records nothing until the
        service ~/start is called.
        """
        self._failure = ""
        self._configuration, self._configured_at = None, math.inf
        self._newest_ns = None
        self._emptied_at = time.monotonic()
        self.until_deactivated(self.subscribe(topics.CONFIGURATION, self._on_configuration))
        self.every(FLUSH_S, self._on_timer)
        if self.settings.record:
            self._start(patiently=True)
        else:
            self._follow_scans()

    def deactivate(self) -> None:
        """Write and acknowledge the messages that have arrived, and close the run."""
        self._take_all()
        self._acknowledgements.flush()
        self._finish()
        self._scans = None

    def rig_time_ns(self) -> int | None:
        """Return the stamp of the newest block of scans [ns of rig time], for diagnostics; None before the first."""
        return self._newest_ns

    def doing(self) -> NodeState:
        """Return the state of the recording, with a problem (failed, two sources, lost messages) as the reason."""
        words, lost = states.RecorderWord, self._lost()
        if self._failure:
            return NodeState(words.FAILED, self._failure)
        if self._writer is not None and self._mixed():
            return NodeState(words.RIVAL, self._mixed())
        if self._writer is not None and (lost or self._refused):
            missing = [f"{count} messages on {self._added[name]} lost" for name, count in lost.items()]
            missing += [f"{count} invalid messages on {name} not recorded" for name, count in self._refused.items()]
            return NodeState(words.LOSING, ", ".join(missing))
        if self._waiting:
            return NodeState(words.WAITING, "waiting for the rig's configuration")
        if self._awaited:
            return NodeState(words.WAITING, f"waiting for {', '.join(sorted(self._awaited))}")
        if self._writer is not None:
            return NodeState(words.RECORDING)
        return NodeState(words.IDLE, "messages of the last recording were lost" if lost else "")

    def health(self) -> tuple[Level, str]:
        """Return level and message of diagnostics: a problem of the newest recording, or whether the node records.

        The most important problem is shown. The order is: failure, several publishers of a topic, lost messages,
        invalid messages. Lost messages are always an error, and are shown in addition to several publishers.
        """
        if self.state != "active":
            return Level.WARN, self.state
        if self._failure:
            return Level.ERROR, f"{self._failure}; no block is acknowledged until ~/start or ~/stop"
        mixed, lost = self._mixed(), ""
        if self._lost():
            held = "; no block is acknowledged until ~/stop" if self._lacks_messages() else ""
            lost = f"messages were lost before they reached the recorder (values lost.TOPIC){held}"
        if mixed:
            shown = f"this run cannot be verified: {mixed}; end all but one, and start a new run"
            return (Level.ERROR, f"{shown}; {lost}") if lost else (Level.WARN, shown)
        if lost:
            return Level.ERROR, lost
        if self._writer is not None and self._refused:
            return Level.WARN, f"recording, but not the invalid messages on {', '.join(sorted(self._refused))}"
        if self._waiting:
            return Level.OK, "waiting for the rig's configuration"
        if self._awaited:
            return Level.OK, f"recording, waiting for {', '.join(sorted(self._awaited))}"
        return Level.OK, "recording" if self._writer is not None else "not recording"

    def figures(self) -> dict[str, object]:
        """Return values for diagnostics.

        The values are the number of lost messages of the newest run by topic (`lost.TOPIC`), if any. During a run, its
        directory, number of messages and size [MB] are added. If several nodes have published a topic of the run that
        only one node may publish, `other_publishers` names the nodes, also after the run.
        """
        values: dict[str, object] = {f"lost.{self._added[name]}": n for name, n in self._lost().items()}
        if self._writer is not None:
            values |= {
                "directory": str(self._writer.directory),
                "messages": self._writer.message_count,
                "megabytes": self._writer.bytes_written / 1e6,
            }
        if self.active and not self._failure and (mixed := self._mixed()):
            values["other_publishers"] = mixed
        return values

    def _mixed(self) -> str:
        """Return which nodes have published the same topic of this run although only one may; empty if none have."""
        found = {topic: self._account.writers(name) for name, topic in self._added.items() if topic in ONE_WRITER}
        return "; ".join(f"{' and '.join(names)} publish {topic}" for topic, names in found.items() if len(names) > 1)

    # Start and stop

    def _on_start(self, _request: Trigger.Request, done: Done) -> None:
        if not self.active:
            raise RecordingError(f"cannot start a recording: the recorder is {self.why_not_active()}")
        if self._writer is not None:
            raise RecordingError(f"already recording {self._writer.directory}: call ~/stop first")
        if self._waiting:
            raise RecordingError(
                "a recording is already requested, and waits for the rig's configuration: call ~/stop to cancel it"
            )
        self._take_all()
        self._starting.append(done)
        self._start()
        self._answer_start()

    def _answer_start(self) -> None:
        """Answer waiting ~/start requests if the run has failed, or if it is open and waits for no message."""
        if self._writer is not None and not self._awaited:
            self._answer(True, str(self._writer.directory))
        elif self._failure:
            self._answer(False, self._failure)

    def _answer(self, success: bool, message: str) -> None:
        while self._starting:
            self._starting.pop()(success, message)

    def _on_stop(self, _request: Trigger.Request, done: Done) -> None:
        directory = self._writer.directory if self._writer else None
        self._failure = ""
        self._take_all()  # failures are reported now
        self._finish()
        if self.active:
            self._follow_scans()
        stopped = str(directory) if directory else "nothing to stop: the recorder is not recording"
        done(not self._failure, self._failure or stopped)

    def _start(self, patiently: bool = False) -> None:
        """Request a run, which is opened when the newest configuration of the rig is `QUIET_S` seconds old.

        If no configuration arrives within `configuration_wait_s`, the run is opened without a configuration. This time
        counts from now. If `patiently`, it counts from the appearance of a publisher of scans, and the recorder waits
        for that publisher without a limit.
        """
        self._failure = ""
        self._waiting = True
        self._deadline = math.inf if patiently else time.monotonic() + self.settings.configuration_wait_s
        self._open_when_ready()

    def _open_when_ready(self) -> None:
        now = time.monotonic()
        in_force = now - self._configured_at >= QUIET_S
        if not self._waiting or not (in_force or now >= self._deadline):
            return
        self._waiting = False
        if self._configuration is None:
            waited = f"within {self.settings.configuration_wait_s:g} s"
            self.get_logger().warning(
                f"no message received on rig/configuration {waited}: the run begins without a configuration; "
                "check that the rig runs in the namespace of the recorder"
            )
        try:
            self._writer = self._open(self._configuration)
        except RecordingError as error:
            self._fail(error)
            return
        self._certificates = 0
        # new subscriptions for each run: transient-local topics (journal, calibration, ...) then belong to every run
        self._recorded = [self._listen(topic) for topic in TOPICS if topic.recorded and topic is not topics.SCAN]
        self._awaited = {topic.name for topic in AWAITED if self.count_publishers(topic.name)}
        self._opened_at = time.monotonic()
        self._follow_scans()  # last: a rig that waits for this subscription finds the run open
        self.get_logger().info(one_line(f"recording {self._writer.directory}"))

    def _follow_scans(self) -> None:
        if self._scans is None:
            self._scans = self._listen(topics.SCAN)
            self.until_deactivated(self._scans)

    def _listen(self, topic: topics.Topic) -> Any:
        """Subscribe to a topic for recording, with a queue long enough for a burst of messages."""
        depth = None if topic in topics.BULKY else topics.HISTORY_DEPTH
        return self.subscribe(topic, functools.partial(self._on_message, topic), raw=True, depth=depth)

    def _open(self, configuration: str | None) -> RunWriter:
        settings = self.settings
        directory = run_directory(settings.directory)
        name = settings.name or free_path(directory / time.strftime("run_%Y%m%d_%H%M%S")).name
        values: dict[str, Any] = {}
        with contextlib.suppress(ConfigError):  # received from the network
            values = parameters_in(configuration or "")
        mode, seed = str(values.get("time.mode", "unknown")), values.get("daq.seed")
        attachments = [Attachment("environment.json", environment(), "application/json")]
        if configuration is not None:
            attachments.append(Attachment(CONFIGURATION, configuration.encode(), "application/yaml"))
        self._added, self._account, self._refused = {}, Account(self._publishing), Counter()
        self._opened_ns = time.time_ns()
        return RunWriter(
            directory / name,
            provenance=Provenance(
                version=impact_rig.__version__,
                seed=seed if isinstance(seed, int) else -1,
                wall_start_ns=self._opened_ns,
                extra={"mode": mode, "namespace": self.get_namespace()},
            ),
            attachments=tuple(attachments),
            account=self._account,
            clock=time.monotonic,
            compression=settings.compression,
            max_file_bytes=settings.max_file_mb * 1_000_000,
            tail=True,
        )

    def _finish(self) -> None:
        """Close the run, or cancel a run that is requested and not open yet."""
        self._waiting = False
        writer = self._leave_run()
        self._answer(False, "the recording was stopped before it had fully started")
        if writer is None:
            return
        try:
            writer.finish()
        except RecordingError as error:
            self._fail(error)
            return
        self.get_logger().info(one_line(f"finished recording {writer.directory}: {writer.message_count} messages"))

    def _fail(self, error: RecordingError) -> None:
        """Stop recording because of an error, close the run, and show the error in diagnostics until ~/start or ~/stop.

        Until then no block is acknowledged, so a rig that waits for this recorder stops.
        """
        self._failure = f"recording stopped: {error}"
        self.report_change()
        self.get_logger().error(one_line(self._failure))
        writer = self._leave_run()
        if writer is not None and not writer.closed:
            writer.finish()

    def _leave_run(self) -> RunWriter | None:
        """End the subscriptions of the current run; return its writer, which the caller must close.

        The result is None if no run is open. The subscription to scans stays, because scans are acknowledged between
        runs, too.
        """
        self._awaited = set()
        for subscription in self._recorded:
            self.destroy_subscription(subscription)
        self._recorded = []
        writer, self._writer = self._writer, None
        return writer

    # Messages

    def _publishing(self, name: str) -> dict[str, str]:
        """Return the present publishers of a topic from the ROS graph: endpoint identifier -> full node name."""
        return {
            bytes(found.endpoint_gid).hex(): f"{found.node_namespace.rstrip('/')}/{found.node_name}"
            for found in self.get_publishers_info_by_topic(name)
        }

    def _on_configuration(self, message: String) -> None:
        self._take_all()
        self._configuration, self._configured_at = message.data, time.monotonic()
        if self._writer is not None:  # a further file of a split run begins with the configuration active at that time
            self._writer.supersede(Attachment(CONFIGURATION, message.data.encode(), "application/yaml"))

    def _on_timer(self) -> None:
        self._take_all()
        if self._waiting and math.isinf(self._deadline) and self.count_publishers(topics.SCAN.name):
            # the rig is running and has not sent its configuration
            self._deadline = time.monotonic() + self.settings.configuration_wait_s
        self._open_when_ready()
        came_late = self._starting or self._newest_ns is not None  # otherwise the rig has not started
        if self._awaited and came_late and time.monotonic() - self._opened_at > AWAIT_S:
            names = ", ".join(sorted(self._awaited))
            self.get_logger().warning(
                f"no message on {names} more than {AWAIT_S:g} s after the recording began: ~/start and the "
                "diagnostics no longer wait for them; check the nodes that publish them"
            )
            self._awaited = set()
        if self._writer is not None:
            try:
                self._writer.flush_due()
            except RecordingError as error:
                self._fail(error)
        self._answer_start()

    def _on_message(self, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
        """Queue a received message during a run of a rig in real time; otherwise process it at once.

        A timer processes the queued messages together, because this needs half the processor time. It then acknowledges
        their blocks.
        """
        self._inbox.append((topic, data, info))
        if self._writer is None or not self._acknowledgements.is_timed:
            self._take_all()

    def _take_all(self) -> None:
        now = time.monotonic()
        if now - self._emptied_at > LATE_NS / NS_PER_S:  # the timer is faster, unless this process did not run
            self._late_at = now
        self._emptied_at = now
        take = guarded(self._take, self.report_failure)  # one by one: an invalid message must not affect the others
        while self._inbox:
            take(*self._inbox.popleft())

    def _take(self, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
        table = None
        if topic.columns is not None:
            table = self.table(topic, data)
            if table is None:  # from an unknown node: readers of the run could not decode it
                self._refused[topic.name] += 1
                return
        if self._writer is not None:
            try:
                self._write(self._writer, topic, data, info, table)
                if table is not None and topic is topics.INFO:
                    self._attach_calibration(self._writer, table)
            except RecordingError as error:
                self._fail(error)
        if table is not None and topic is topics.SCAN and not self._failure:
            self._newest_ns = table.stamp_ns
            sent_ns, received_ns = int(info["source_timestamp"]), int(info["received_timestamp"])
            if received_ns - sent_ns > LATE_NS:
                self._late_at = time.monotonic()
            self._acknowledgements.processed(table.stamp_ns)

    def _write(
        self, writer: RunWriter, topic: topics.Topic, data: bytes, info: dict[str, Any], table: Table | None
    ) -> None:
        if topic.name in RESULTS and int(info["source_timestamp"]) < self._opened_ns:
            return
        name = self._resolved.get(topic.name)
        if name is None:
            name = self._resolved[topic.name] = self.resolve_topic_name(topic.name)
        if name not in self._added:
            self._added[name] = topic.name
            writer.add_topic(self._describe(topic, name))
        writer.write(name, data, int(info["source_timestamp"]), int(info["publication_sequence_number"]), table)
        if topic.name in self._awaited:
            self._awaited.discard(topic.name)
            self._answer_start()

    def _attach_calibration(self, writer: RunWriter, info: Table) -> None:
        """Attach a calibration (`daq/info`) to the recording as a YAML file for human readers.

        Every calibration received during the run gets an attachment of its own.
        """
        self._certificates += 1
        name = CALIBRATION if self._certificates == 1 else f"calibration_{self._certificates}.yaml"
        writer.attach(Attachment(name, calibration_yaml(info).encode(), "application/yaml"), instead_of=CALIBRATION)

    def _describe(self, topic: topics.Topic, name: str) -> TopicDescription:
        publishers = self.get_publishers_info_by_topic(name)
        type_hash = str(publishers[0].topic_type_hash) if publishers else ""
        return TopicDescription(
            name=name,
            type_name=topic.type_name,
            type_hash=type_hash,
            offered_qos=tuple(qos(publisher.qos_profile) for publisher in publishers),
        )

    def _secured(self) -> bool:
        """Write the received data to the file, so they survive this process; return whether they may be acknowledged.

        The result is False if the run has failed, as by an error of this write, or has lost a message of the rig. It is
        also False in real time for `REPEATED_S` seconds after this process was suspended or too slow. In this time, the
        middleware may send messages again that did not arrive.
        """
        if self._writer is not None:
            try:
                self._writer.secure()
            except RecordingError as error:
                self._fail(error)
        may_come = self._acknowledgements.is_timed and time.monotonic() - self._late_at < REPEATED_S
        may_lack = self._writer is not None and (self._lacks_messages() or may_come)
        return not self._failure and not may_lack

    def _lost(self) -> dict[str, int]:
        """Return how many messages of this run were sent and never arrived, by full topic name.

        Topics without losses are left out. So are topics of which only the newest message matters (`REPLACED`).
        """
        return {name: n for name, n in self._account.lost().items() if self._added[name] not in REPLACED}

    def _lacks_messages(self) -> bool:
        """Return whether the run has lost a message of a rig's topic of which no message may be missing (`NEEDED`)."""
        return self._writer is not None and any(self._added[name] in NEEDED for name in self._lost())


def run_directory(text: str) -> Path:
    """Return the path for the parameter `directory` of the recorder, with `~` replaced by the home directory.

    A relative path stays relative to the working directory of the node. An empty text means the working directory. The
    directory is not created.

    Raises:
        RecordingError: the path begins with the home directory of an unknown user.
    """
    try:
        return Path(text).expanduser()
    except RuntimeError as error:  # an unknown user, as in ~unknown
        raise RecordingError(
            f"directory {text!r} cannot be used: the home directory of its user is unknown; write its path without ~"
        ) from error


def calibration_yaml(info: Table) -> str:
    """Return a `daq/info` table as YAML: the time from which it applies (stamp_ns), and a mapping for each channel."""
    channels: dict[str, dict[str, str | float]] = {}
    for row in info.rows:
        values = {name: row[name] for name in info.rows.dtype.names or ()}
        plain = {
            name: value.decode(errors="replace") if isinstance(value, bytes) else float(value)
            for name, value in values.items()
        }
        channels[str(plain.pop("name", len(channels)))] = plain
    text: str = yaml.safe_dump({"stamp_ns": info.stamp_ns, "channels": channels}, sort_keys=False)
    return text


def qos(profile: Any) -> OfferedQos:
    """Return a quality-of-service profile of rclpy in the notation of rosbag2, for the metadata of a run."""
    return OfferedQos(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_ns=profile.liveliness_lease_duration.nanoseconds,
    )


def environment() -> bytes:
    """Return a JSON description of the software that records: versions, machine, system and ROS distribution."""
    return json.dumps(
        {
            "impact_rig": impact_rig.__version__,
            **identity(),
            "machine": platform.machine(),
            "system": platform.platform(),
            "ros_distro": os.environ.get("ROS_DISTRO", ""),
        },
        indent=1,
    ).encode()


PROGRAM = RecorderNode
"""Factory of the node for the program `recorder_node`."""
