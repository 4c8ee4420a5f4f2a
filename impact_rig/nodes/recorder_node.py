"""The recorder as a lifecycle node: raw bytes of every topic of the table into a run; `RunWriter` does the work."""

from __future__ import annotations

import functools
import json
import math
import os
import platform
import time
from collections import Counter
from pathlib import Path
from typing import Any  # rclpy messages and handles

import numpy as np
import yaml
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

import impact_rig
from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.endings import Ending
from impact_rig.errors import CodecError, RecordingError
from impact_rig.nodes import process, topics
from impact_rig.nodes.deferred import Answer, DeferredService
from impact_rig.nodes.diagnostics import Level, Status
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.parameters import SectionSchema
from impact_rig.nodes.settings import RecorderSettings
from impact_rig.nodes.stamps import time_message
from impact_rig.recording import CONFIGURATION, Attachment, Provenance, Qos, RunWriter, Topic, schema_text

FLUSH_S = 0.2
AWAITED = (topics.INFO, topics.APPLIED, topics.JOURNAL, topics.CONFIGURATION, topics.ANALYSIS_SETTINGS)
"""What was published before and belongs to every run; ~/start is answered when it has arrived."""
AWAIT_S = 2.0
SINGLE_PUBLISHERS = ("rig", "analysis")
"""Topics of these nodes have one publisher: a gap in its sequence numbers is a loss."""


class RecorderNode(ManagedNode[RecorderSettings]):
    """Writes what it receives, and acknowledges every block, recording or not.

    Args:
        kwargs: passed to rclpy's Node.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("recorder", SectionSchema(RecorderSettings), **kwargs)
        self._writer: RunWriter | None = None
        self._failure = ""
        self._configuration: str | None = None
        self._waiting = False
        self._deadline = math.inf
        self._added: set[str] = set()
        self._sequences: dict[str, int] = {}
        self._lost: Counter[str] = Counter()
        self._newest_ns = 0
        self._certificates = 0
        self._awaited: set[str] = set()
        self._opened_at = 0.0
        self._permanent: list[Any] = []
        self._recorded: list[Any] = []
        self._ack: Any = None
        self._timer: Any = None
        self._begin = DeferredService(self, Trigger, "~/start", self._on_start, self._answer_start)
        self.service(Trigger, "~/stop", self._on_stop)

    def autostarts(self) -> bool:
        """Follow `autostart`."""
        return self.settings.autostart

    def configure(self) -> None:
        """Check that the interfaces are installed; create the acknowledgement's publisher."""
        for type_name in {topic.type_name for topic in topics.TOPICS}:
            schema_text(type_name)
        self._ack = self.publisher(topics.ACK)

    def activate(self) -> None:
        """Listen for the configuration and the scans; start recording if `record` says so."""
        self._failure = ""
        self._configuration = None
        self._newest_ns = 0
        self._permanent = [
            self.subscribe(topics.CONFIGURATION, self._on_configuration),
            self.subscribe(topics.SCAN, functools.partial(self._on_message, topics.SCAN), raw=True),
        ]
        self._timer = self.steady_timer(FLUSH_S, self._on_timer)
        if self.settings.record:
            self._start(patiently=True)

    def deactivate(self) -> None:
        """Finish the run and stop listening."""
        self._finish()
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        for inlet in self._permanent:
            self.destroy_subscription(inlet)
        self._permanent = []

    def cleanup(self) -> None:
        """Destroy the publisher."""
        self.deactivate()
        if self._ack is not None:
            self.destroy_publisher(self._ack)
            self._ack = None

    def rig_time_ns(self) -> int:
        """Return the stamp of the newest block; 0 (a stamp nobody filled in) before the first."""
        return self._newest_ns

    def status(self) -> Status:
        """Return what is being written, and what was lost."""
        writer = self._writer
        values: dict[str, object] = {f"lost.{name}": count for name, count in self._lost.items() if count}
        if writer is not None:
            values |= {
                "directory": str(writer.directory),
                "messages": writer.message_count,
                "megabytes": writer.bytes_written / 1e6,
            }
        if self.state != "active":
            return Status(Level.WARN, self.state, values)
        if self._failure:
            return Status(Level.ERROR, self._failure, values)
        if any(self._lost.values()):
            return Status(Level.ERROR, "messages were lost before they reached the recorder", values)
        if self._waiting:
            return Status(Level.OK, "waiting for the rig's configuration", values)
        if self._awaited:
            return Status(Level.OK, f"recording, waiting for {', '.join(sorted(self._awaited))}", values)
        return Status(Level.OK, "recording" if writer is not None else "not recording", values)

    # Start and stop

    def _on_start(self, _request: Trigger.Request) -> Answer | None:
        if not self.active:
            return False, f"the recorder is {self.state}, activate it first"
        if self._writer is not None or self._waiting:
            return False, f"already recording {self._writer.directory if self._writer else ''}"
        self._start()
        return (False, self._failure) if self._failure else None

    def _answer_start(self) -> None:
        """Answer ~/start once the run is open and holds what was published before it."""
        if self._writer is not None and not self._awaited:
            self._begin.reply(True, str(self._writer.directory))
        elif self._failure:
            self._begin.reply(False, self._failure)

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        directory = self._writer.directory if self._writer else None
        self._finish()
        response.success, response.message = True, str(directory) if directory else "nothing was being recorded"
        return response

    def _start(self, patiently: bool = False) -> None:
        """Open the run, or wait for the configuration that belongs into it; patiently: however late the rig starts."""
        self._failure = ""
        self._waiting = True
        self._deadline = math.inf if patiently else time.monotonic() + self.settings.configuration_wait_s
        self._open_when_ready()

    def _open_when_ready(self) -> None:
        if not self._waiting or (self._configuration is None and time.monotonic() < self._deadline):
            return
        self._waiting = False
        if self._configuration is None:
            self.get_logger().warning("no rig/configuration was heard: the run has none attached")
        try:
            self._writer = self._open(self._configuration)
        except RecordingError as error:
            self._fail(error)
            return
        self._added, self._sequences, self._lost = set(), {}, Counter()
        self._certificates = 0
        # subscribed anew for each run: what is transient-local (journal, calibration, ...) then belongs to every run
        self._recorded = [
            self.subscribe(topic, functools.partial(self._on_message, topic), raw=True)
            for topic in topics.TOPICS
            if topic is not topics.SCAN
        ]
        self._awaited = {topic.name for topic in AWAITED if self.count_publishers(topic.name)}
        self._opened_at = time.monotonic()
        self.get_logger().info(f"recording {self._writer.directory}")

    def _open(self, configuration: str | None) -> RunWriter:
        settings = self.settings
        name = settings.name or time.strftime("run_%Y%m%d_%H%M%S")
        values = _parameters(configuration)
        mode = str(values.get("time", {}).get("mode", "unknown"))
        attachments = [Attachment("environment.json", _environment(), "application/json")]
        if configuration is not None:
            attachments.append(Attachment(CONFIGURATION, configuration.encode(), "application/yaml"))
        return RunWriter(
            _directory(settings.directory) / name,
            provenance=Provenance(
                version=impact_rig.__version__,
                seed=int(values.get("daq", {}).get("seed", -1)),
                wall_start_ns=time.time_ns(),
                extra={"mode": mode, "namespace": self.get_namespace()},
            ),
            attachments=tuple(attachments),
            clock=time.monotonic,
            compression=settings.compression,
            max_file_bytes=settings.max_file_mb * 1_000_000,
            rig_start_ns=None if mode in ("realtime", "unknown") else 0,
            tail=True,
        )

    def _finish(self) -> None:
        """Close the run; nothing is lost that has arrived."""
        self._waiting = False
        self._awaited = set()
        for inlet in self._recorded:
            self.destroy_subscription(inlet)
        self._recorded = []
        writer, self._writer = self._writer, None
        self._begin.reply(False, "recording was stopped")
        if writer is None:
            return
        try:
            writer.finish()
        except RecordingError as error:
            self._fail(error)
            return
        self.get_logger().info(f"finished {writer.directory}: {writer.message_count} messages")

    def _fail(self, error: RecordingError) -> None:
        """Stop recording, say why, and let the rig go on."""
        self._failure, self._awaited = f"recording stopped: {error}", set()
        self.get_logger().error(self._failure)
        writer, self._writer = self._writer, None
        for inlet in self._recorded:
            self.destroy_subscription(inlet)
        self._recorded = []
        if writer is not None and not writer.closed:
            writer.finish()

    # Messages

    def _on_configuration(self, message: String) -> None:
        self._configuration = message.data
        self._open_when_ready()

    def _on_timer(self) -> None:
        self._open_when_ready()
        if self._awaited and time.monotonic() - self._opened_at > AWAIT_S:
            self.get_logger().warning(f"nothing was heard on {', '.join(sorted(self._awaited))}")
            self._awaited = set()
        if self._writer is not None:
            try:
                self._writer.flush_due()
            except RecordingError as error:
                self._fail(error)
        self._answer_start()

    def _on_message(self, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
        if self._writer is not None:
            try:
                self._write(self._writer, topic, data, info)
                if topic is topics.SCAN:
                    self._writer.secure()  # what is acknowledged outlives this process
            except RecordingError as error:
                self._fail(error)
        if topic is topics.SCAN:
            self._acknowledge(data)
            if self._waiting:  # a rig that runs and does not say what it is
                self._deadline = min(self._deadline, time.monotonic() + self.settings.configuration_wait_s)

    def _write(self, writer: RunWriter, topic: topics.Topic, data: bytes, info: dict[str, Any]) -> None:
        sequence = int(info["publication_sequence_number"])
        name = self.resolve_topic_name(topic.name)
        if name not in self._added:
            self._added.add(name)
            writer.add_topic(self._describe(topic, name))
        if topic.publisher in SINGLE_PUBLISHERS:
            before = self._sequences.get(name)
            if before is not None and sequence > before + 1:
                self._lost[topic.name] += sequence - before - 1
            self._sequences[name] = sequence
        writer.write(name, data, int(info["source_timestamp"]), sequence)
        if topic is topics.INFO:
            self._attach_calibration(writer, data)
        if topic.name in self._awaited:
            self._awaited.discard(topic.name)
            self._answer_start()

    def _attach_calibration(self, writer: RunWriter, data: bytes) -> None:
        """Keep the certificate as a file too, for people: one per recalibration."""
        try:
            text = calibration_yaml(codec.decode(data))
        except CodecError as error:
            self.refuse(topics.INFO.name, str(error))
            return
        self._certificates += 1
        number = "" if self._certificates == 1 else f"_{self._certificates}"
        writer.attach(Attachment(f"calibration{number}.yaml", text.encode(), "application/yaml"))

    def _describe(self, topic: topics.Topic, name: str) -> Topic:
        publishers = self.get_publishers_info_by_topic(name)
        type_hash = str(publishers[0].topic_type_hash) if publishers else ""
        return Topic(
            name=name,
            type_name=topic.type_name,
            schema=schema_text(topic.type_name),
            type_hash=type_hash,
            offered_qos=tuple(_qos(publisher.qos_profile) for publisher in publishers),
        )

    def _acknowledge(self, data: bytes) -> None:
        try:
            stamp = codec.header_stamp_ns(data)
        except CodecError as error:
            self.refuse(topics.SCAN.name, str(error))
            return
        self._newest_ns = stamp
        self._ack.publish(Header(stamp=time_message(stamp), frame_id=self.get_name()))


def _directory(text: str) -> Path:
    try:
        return Path(text).expanduser()
    except RuntimeError as error:  # ~nobody
        raise RecordingError(f"directory {text!r} cannot be used: {error}") from error


def calibration_yaml(info: Table) -> str:
    """Return daq/info as YAML: one mapping per channel, and the instant from which it holds."""
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


def _qos(profile: Any) -> Qos:
    return Qos(
        history=profile.history.name.lower(),
        depth=profile.depth,
        reliability=profile.reliability.name.lower(),
        durability=profile.durability.name.lower(),
        deadline_ns=profile.deadline.nanoseconds,
        lifespan_ns=profile.lifespan.nanoseconds,
        liveliness=profile.liveliness.name.lower(),
        liveliness_lease_ns=profile.liveliness_lease_duration.nanoseconds,
    )


def _parameters(configuration: str | None) -> dict[str, Any]:
    """Return the nested values of a rig's configuration; empty if it is none (it comes from the network)."""
    try:
        document = yaml.safe_load(configuration or "")
        values = document["/**"]["ros__parameters"]
    except (yaml.YAMLError, KeyError, TypeError, ValueError, RecursionError):  # a date that is none, nesting
        return {}
    sections = values if isinstance(values, dict) else {}
    return {name: section for name, section in sections.items() if isinstance(section, dict)}


def _environment() -> bytes:
    """Return what the run depended on, as JSON."""
    return json.dumps(
        {
            "impact_rig": impact_rig.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": platform.machine(),
            "system": platform.platform(),
            "ros_distro": os.environ.get("ROS_DISTRO", ""),
        },
        indent=1,
    ).encode()


def main(ending: Ending) -> None:
    """Run the recorder node."""
    process.main(RecorderNode, ending)
