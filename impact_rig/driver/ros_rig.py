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
"""`RosRig`: a rig reached over ROS topics, newly started on its own ROS domain or already running.

A started rig is in lockstep unless its configuration says otherwise: it advances only on request. `step` returns when
every peer has processed the last block of scans; the peers are this program, the recorder, the analysis and each node
under test. A rig in another time mode runs by itself, and `step` waits for its blocks.

The rig learns in one of three ways that a node under test has processed a block. If the node is hosted in this process,
the return of its callback counts. If it is started with `output`, each message that it publishes on that topic counts.
Otherwise, the node itself acknowledges each block on `daq/ack`.
"""

from __future__ import annotations

import contextlib
import shutil
import tempfile
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any  # rclpy nodes and messages

import attrs
import numpy as np
from numpy.typing import NDArray
from std_srvs.srv import Trigger

from impact_rig import codec, topics
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.blocks import Table
from impact_rig.client.client import Client, Collector, Received, WaitTimeoutError, ros_parameters, subscribers
from impact_rig.client.processes import ParameterValue, Processes, domain_of_environment, isolated_domain
from impact_rig.driver.driver import (
    ESSENTIAL,
    SCANS,
    STEP_TIMEOUT_S,
    TOPICS,
    RigDriver,
    StreamLevel,
    check_topics,
    configured,
)
from impact_rig.errors import CommandError, ConfigError, ImpactRigError, RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.nodes.messages import header_stamp_ns
from impact_rig.nodes.process import DISCOVERY_S
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.rig.config import RigConfig, differences, from_flat, to_flat
from impact_rig.rig.core import EMERGENCY
from impact_rig.rig.interlock import OVER_TRAVEL, Trip
from impact_rig.rig.journal import InputKind, JournalEntry
from impact_rig.simtime import NS_PER_S, first_scan_at, stamp_ns

NODE_TIMEOUT_S = 30.0  # time limit for a node under test to subscribe
ACK_WINDOW, WINDOW_S = 8, 0.1
"""Limits of how far a started rig may run ahead of its peers: number of blocks, and rig time [s].

Fewer blocks than the 10 messages that most nodes keep, so a slow node loses none. So little rig time that the
middleware can hold the messages of the monitors.
"""
LOCKSTEP = "lockstep"
RUN = "run"
CLIENT, CONTROLLER = "client", "controller"
"""Node name of this program: CLIENT for a rig that it starts, CONTROLLER for a running one.

A running rig that shall wait for this program lists `controller` in `time.peers`.
"""
REALTIME_LEAD_S = 0.2
GRACE_S = 0.005  # wall time to wait for measurements that were published before the answer to a step
FIXED = ("time.", "step.", "daq.rate_hz", "daq.block_scans", "output.autostart")
"""Parameters, by the beginning of their names, that `restart` leaves unchanged.

They are read-only, or define how this program drives the rig.
"""


class RosRig(RigDriver):
    """Rig reached over ROS topics, newly started on a ROS domain of its own or already running.

    It has the methods of `LocalRig` except `reset`. Its `client` sends commands and calls services like an operator's
    program. Use it to test ROS 2 nodes: `host` runs a node in this process, `start_node` starts one as a process, and
    each step of a lockstep rig waits until the node has processed its scans. Used as a context manager, it ends
    everything that it has started. It needs ROS 2.

    Args:
        config: the configuration, or the values that differ from the defaults of a lockstep rig, `section.key` ->
            value, as in docs/reference/configuration.md. For a running rig, the values that it must have; of a
            `RigConfig`, only those that differ from the defaults are checked.
        faults: instrument faults to plan, in addition to those of the configuration; only for a new rig.
        name: name of the rig in reports and error messages; the node is always named `rig`. A recorder for a running
            rig is the node `NAME_recorder`.
        directory: folder of the logs, which is kept; None means a temporary one that `close` removes.
        analysis: fields of `TrackerSettings` that differ from their defaults, and `gap_m`, as for `LocalRig`. They
            become parameters of an analysis node. None means no analysis, {} one with the defaults.
        record: directory of a run that a recorder writes; True means one in `directory`, which `renew` replaces.
        also: further topics whose tables are kept until `clear`, such as `truth/scan`.
        mode: `time.mode` of a new rig; a running rig keeps its own. `lockstep`, the default, advances only on request;
            `realtime` and `free_running` rigs run by themselves, and `step` waits for their scans.
        hosted: whether to run a new rig and its recorder in this process instead of processes of their own. They start
            ten times faster and still use real DDS.
        namespace: namespace of a running rig in this environment's domain, which is driven instead of a new one.

    Attributes:
        config (RigConfig): present configuration.
        sample (int): number of the first scan of the next block.
        client: client that acts as the operator: parameters, services, topics.
        processes: the node processes, to stop, kill or suspend one.

    Raises:
        ConfigError: a key or topic is unknown, a value or fault is invalid, a running rig has other values, or `faults`
            or `hosted` is given for one.
        GoneError: a node ended before it was ready; the message quotes the end of its log.
        TimeoutError: a node was not ready in time.

    Examples:
        >>> import impact_rig
        >>> with impact_rig.RosRig({"barriers.gap_m": 0.006}, hosted=True) as rig:
        ...     first_scan = rig.command(frequency_hz=9.1, current_a=0.52)
        ...     rig.run(seconds=0.5)
        ...     rig.rows("daq/scan")["laser"].shape
        (5000,)

    See Also:
        - `LocalRig`: the same calls without ROS.
        - `Client`: the ROS node behind this class.
        - docs/how-to/testing.md: pytest fixtures that start such a rig.
    """

    def __init__(
        self,
        config: RigConfig | Mapping[str, Any] | None = None,
        faults: Iterable[Fault] = (),
        name: str = "rig",
        *,
        directory: str | Path | None = None,
        analysis: Mapping[str, ParameterValue] | None = None,
        record: str | Path | bool = False,
        also: Collection[str] = (),
        mode: str = LOCKSTEP,
        hosted: bool = False,
        namespace: str | None = None,
    ) -> None:
        running, required, faults = namespace is not None, config, list(faults)
        if running and (faults or hosted):
            refused, remedy = ("faults", ", and plan each fault with inject") if faults else ("hosted", "")
            raise ConfigError(
                f"{refused} is only for a new rig, but namespace={namespace!r} names a running one: omit it{remedy}"
            )
        check_topics(also)
        base = config if isinstance(config, RigConfig) and not running else RigConfig()
        given = {} if running or isinstance(config, RigConfig) else dict(config or {})
        if not running:
            given = {"time.mode": mode, "time.peers": [CLIENT], **given}
            daq = from_flat(base, given).daq
            window = round(WINDOW_S * daq.rate_hz / daq.block_scans)
            given = {"time.ack_window": max(1, min(ACK_WINDOW, window)), **given}
        super().__init__(name, configured(from_flat(base, given), faults))
        self._peers = [CLIENT]
        self._injected: list[tuple[str, Fault]] = []
        self._stack = contextlib.ExitStack()
        self._hosted_recorder: RecorderNode | None = None
        self._recorder = f"{name}_recorder" if running else "recorder"
        self._stopped, self._journal_read = "", 0
        self._stream: Collector | None = None
        self._sent_to = 0  # number of the sample after the last one sent
        with contextlib.ExitStack() as stack:
            if directory is None:
                temporary = tempfile.TemporaryDirectory(prefix="impact_rig_", ignore_cleanup_errors=True)
                directory = stack.enter_context(temporary)
            self.directory = directory = Path(directory)
            self._run = directory / RUN if record is True else Path(record) if record else None
            domain_id = domain_of_environment() if running else stack.enter_context(isolated_domain())
            self.processes: Processes = stack.enter_context(Processes(domain_id, directory / "logs", namespace or ""))
            self.client: Client = stack.enter_context(
                Client(domain_id, namespace or "", self.processes, CONTROLLER if running else CLIENT)
            )
            for service in ("rig/step", f"{self._recorder}/stop"):
                self.client.prepare(Trigger, service)
            if not running:
                self._peers += [*(["recorder"] if self._run else []), *(["analysis"] if analysis is not None else [])]
                self._start("rig", {**differences(self.config), "time.peers": self._peers}, hosted=hosted)
            if analysis is not None:
                self._start("analysis", analysis)
            self.client.wait_active("rig")
            if running:
                self.config = self._running_config(required or {})
                self._peers = [*self.config.time.peers]
            self._joined = running
            if self._run:
                where = {"directory": str(self._run.parent), "name": self._run.name}
                self._start("recorder", where, hosted=hosted)
                self.client.wait_active(self._recorder)
            if analysis is not None:
                self.client.wait_active("analysis")
            self.runs_by_itself = self.config.time.mode != LOCKSTEP
            self.lead_s = REALTIME_LEAD_S if self.config.time.mode == "realtime" else 0.0
            self._step_blocks = self.config.step.blocks
            self._measurements = topics.TRANSMISSIBILITY_TABLE.name if analysis is not None else ""
            names = dict.fromkeys((*TOPICS, *also, *([self._measurements] if self._measurements else [])))
            self._collectors = {topic: self.client.collect(topic, acknowledge=topic == SCANS) for topic in names}
            self._collectors[SCANS].then(self._hand_over)
            self._own = {*self._peers}, {*self.processes.running}, {*self.client.node.subscriptions}
            if self.config.drive.waveform == "stream":
                self._connect_stream()
            if running or self.config.time.mode == "realtime":
                self._join()
            self._analysis, self._records_temporarily = analysis, record is True
            self._tested: list[Any] = []
            if running:  # an earlier stop is irrelevant
                self._journal_read = len(self._collectors[topics.JOURNAL.name])
            self._stack = stack.pop_all()

    def _start(self, node: str, parameters: Mapping[str, ParameterValue], *, hosted: bool = False) -> None:
        if not hosted:
            self.processes.start(node, parameters, name=self._recorder if node == "recorder" else node)
            return
        make_node = {"rig": RigNode, "recorder": RecorderNode}[node]
        hosted_node = self.client.host(make_node, parameter_overrides=ros_parameters(parameters))
        if node == "recorder":
            self._hosted_recorder = hosted_node

    def _running_config(self, required: RigConfig | Mapping[str, Any]) -> RigConfig:
        config = from_flat(self.config, self.client.get_parameters("rig", list(to_flat(self.config))))
        values = to_flat(config)
        for key, value in (differences(required) if isinstance(required, RigConfig) else required).items():
            if values[key] != value:
                raise ConfigError(
                    f"the running rig has {key}: {values[key]}, but {value} is required; start a rig with that value, "
                    "or set the parameter if it can change while the rig runs, and reset the rig"
                )
        return config

    def _connect_stream(self) -> None:
        """Subscribe to the state of the drive's stream, and wait until this program has found all readers of the rig.

        Otherwise, a recorder that connects late would lose the first samples. After `DISCOVERY_S` seconds, the program
        continues without the missing readers.
        """
        self.client.publisher(topics.WAVEFORM)
        self._stream = Collector(topics.STREAM)
        self._own[2].add(self.client.subscribe(topics.STREAM, self._stream.take, raw=True))
        self.client.wait_until(self._stream.last, f"{topics.STREAM.name} (drive.waveform: stream)")
        with contextlib.suppress(WaitTimeoutError):  # a process has ended, or a peer is absent
            self.client.wait_until(self._finds_readers, "all nodes that read the rig", DISCOVERY_S)

    def _finds_readers(self) -> bool:
        """Return whether this program has discovered all nodes that read scans according to the rig's diagnostics.

        Nodes are compared by name without namespace. The result is False until diagnostics have arrived.
        """
        figures = self.client.figures("rig")
        names = {key.removeprefix("behind.") for key in figures if key.startswith("behind.")}
        return bool(figures) and names <= subscribers(self.client.node, topics.SCAN.name)

    def _join(self) -> None:
        """Set the stamp of scan 0 and the number of the next scan from what the rig publishes.

        The newest block gives the number of the next scan. A rig in lockstep publishes no block until it is stepped, so
        its diagnostics give that number instead.
        """
        info = self.client.wait_until(self._collectors[topics.INFO.name].last, topics.INFO.name)
        self._start_ns = info.stamp_ns - round(float(info.rows["since_start"][0]) * NS_PER_S)
        if self.runs_by_itself:
            first = self.client.wait_until(self._collectors[SCANS].last, "a block of scans", STEP_TIMEOUT_S)
            self._kept_from = self.first_scan(first)
            self.sample = self._kept_from + len(first.rows)  # the newest block is not one that `step` waits for
            return
        reported_ns = self.client.reported_ns
        reported_ns.pop("rig", None)  # may be older than the last step of another client
        self.client.wait_until(lambda: "rig" in reported_ns, "the rig's diagnostics")
        self.sample = first_scan_at(reported_ns["rig"], self.rate_hz, self._start_ns)
        self.sample = self._kept_from = self._received_to()

    def _hand_over(self, message: Received) -> None:
        for listener in self._listeners:
            listener(message.table or codec.decode(message.data))

    # The pipeline under test

    def host(self, make_node: Callable[..., Any], **kwargs: Any) -> Any:
        """Create a node under test in this process, and make the rig wait for its callbacks.

        In lockstep, `step` returns when the callbacks have processed all blocks of the step. During a step, and in
        `free_running`, the rig is at most `time.ack_window` blocks ahead of them. A `realtime` rig does not wait.

        The node's code need not be changed. Its callbacks run in this thread while this object waits, without a time
        limit.

        Args:
            make_node: class or function that creates the node.
            kwargs: its arguments.

        Returns:
            The node.

        Raises:
            ConfigError: the node does not subscribe to daq/scan when it is created.
        """
        node = self.client.host(make_node, **kwargs)
        if not self.client.acknowledge_callbacks(node):
            resolved = self.client.node.resolve_topic_name(SCANS)
            raise ConfigError(
                f"hosted node {node.get_name()!r} does not subscribe to {SCANS} ({resolved}): subscribe to it when the "
                "node is created"
            )
        self._tested.append(node)
        self._add_peer(node.get_name())
        return node

    def start_node(
        self,
        command: Sequence[str],
        name: str,
        parameters: Mapping[str, ParameterValue] | None = None,
        output: str | None = None,
        timeout_s: float = NODE_TIMEOUT_S,
    ) -> Collector | None:
        """Start a node under test as a process, and make the rig wait for it as for a node of `host`.

        Args:
            command: program and arguments; `--ros-args -r __node:=NAME …` is appended.
            name: node name of the node.
            parameters: ROS parameters of the node.
            output: topic on which the node answers every block. The stamp in an answer's header identifies the block;
                answers without a header are counted. None: the node sends `daq/ack` itself, with its name as
                `frame_id`.
            timeout_s: time limit for the node to subscribe to daq/scan, and then for a publisher of `output` to appear
                [s], by default 30 each.

        Returns:
            The messages on `output` as they arrive (`messages`, `tables()`, `last()`); None without `output`.

        Raises:
            TimeoutError: the node did not subscribe, or has no publisher on `output`, in time; its process goes on.
            GoneError: its process ended; the message quotes the end of its log.
            ImpactRigError: a process of this name is running.
            OSError: the program is missing or cannot be started.
        """
        self.processes.start(name, parameters, name=name, command=command)
        return self.follow(name, output, timeout_s)

    def follow(self, name: str, output: str | None = None, timeout_s: float = NODE_TIMEOUT_S) -> Collector | None:
        """Make the rig wait for a node that another program has started, as for a node of `host`.

        Args:
            name: node name of the node.
            output: topic on which the node answers every block, as for `start_node`. None: the node sends `daq/ack`
                itself.
            timeout_s: time limit for the node to subscribe to daq/scan, and then for a publisher of `output` to appear
                [s], by default 30 each.

        Returns:
            The messages on `output` as they arrive (`messages`, `tables()`, `last()`); None without `output`.

        Raises:
            TimeoutError: the node did not subscribe, or has no publisher on `output`, in time.
        """
        node = self.client.node
        self.client.wait_until(
            lambda: name in subscribers(node, SCANS), f"node {name} to subscribe to {SCANS}", timeout_s
        )
        found = None if output is None else self._acknowledge_answers(name, output, timeout_s)
        self._add_peer(name)
        return found

    def listen(self, topic: str) -> Collector:
        """Collect all messages of a topic from now on; any topic with a publisher is allowed.

        Args:
            topic: name of the topic, relative to the rig's namespace or absolute.

        Returns:
            The messages as they arrive (`messages`, `tables()`, `last()`).

        Raises:
            TimeoutError: no publisher appeared within 10 s.
        """
        return self.client.listen(topic)

    # RigDriver

    def step(self, blocks: int = 1, timeout_s: float = STEP_TIMEOUT_S) -> None:
        """Advance by whole blocks of scans; return when every peer has processed them.

        The peers of a new rig are this program, recorder, analysis and the nodes under test. The peers of a running rig
        are in its parameter `time.peers`. A rig that runs by itself is not advanced: the call returns when that many
        further blocks have arrived.

        Args:
            blocks: number of blocks.
            timeout_s: limit of wall time [s], by default 240: the first step may have to compile the physics.

        Raises:
            TimeoutError: the blocks did not arrive in time.
            GoneError: a node process ended; the message quotes the end of its log.
            ImpactRigError: a peer does not acknowledge, or this machine is too busy for lockstep with an analysis.
        """
        if blocks < 1:
            return
        if not self.runs_by_itself:
            self._step(blocks, timeout_s)
            return
        end, what = self.sample + blocks * self.block_scans, f"{blocks} blocks of scans"
        try:
            check = self.client.given(f"waiting for {what}")
            self.client.wait_until(lambda: self._received_to() >= end, what, timeout_s, check)
        finally:
            self.sample = self._received_to()

    def _step(self, blocks: int, timeout_s: float) -> None:
        if blocks != self._step_blocks:
            self.client.set_parameters("rig", {"step.blocks": blocks})
            self._step_blocks = blocks
        scans, before_ns = self._collectors[SCANS], self.now_ns
        before, measured = len(scans), len(self._collectors[self._measurements]) if self._measurements else 0
        try:
            # on a busy machine the rig may be silent for seconds; its process shows whether it is alive
            self.client.trigger("rig/step", timeout_s, may_be_silent=True)
        except Exception:
            self.sample += (len(scans) - before) * self.block_scans  # the blocks that arrived
            raise
        self.sample += blocks * self.block_scans
        if self._measurements:
            self.client.spin_for(GRACE_S)
            held_ns = round(TrackerSettings().hold_s * NS_PER_S) + stamp_ns(self.block_scans, self.rate_hz)
            found = self._collectors[self._measurements].tables(measured)
            if any(table.stamp_ns - self._start_ns + held_ns < before_ns for table in found):
                raise ImpactRigError(
                    "a measurement arrived one step late: this machine is too busy for an analysis in lockstep; end "
                    "other programs, or use mode='free_running'"
                )

    def _received_to(self) -> int:
        """Return the number of the scan after the last one that has arrived, but at least `sample`."""
        table = self._collectors[SCANS].last()
        return self.sample if table is None else max(self.sample, self.first_scan(table) + len(table.rows))

    def tables(self, topic: str = SCANS) -> list[Table]:
        """Return the tables of a topic that arrived and are still kept, oldest first.

        Scans, commands and journal are complete when a step returns; `truth/...` of the last blocks may arrive later.

        Args:
            topic: name of the topic; by default `daq/scan`, with one table per block.

        Raises:
            ConfigError: the rig keeps no tables of this topic; the argument `also` of the rig adds topics.
        """
        return self._kept_of(topic, self._collectors).tables()

    def journal(self) -> list[JournalEntry]:
        """Return the journal entries that have arrived, oldest first: every input that changed the rig's state.

        A reset drops none of them; `restart` and `renew` drop all.
        """
        return self._collectors[topics.JOURNAL.name].entries()

    def newest(self, topic: str, count: int) -> NDArray[np.void]:
        """Return the newest rows of the tables of a topic, waiting until so many have arrived.

        Args:
            topic: name of the topic, such as `daq/scan`.
            count: number of rows.

        Returns:
            Rows, shape (count,), oldest first.

        Raises:
            ConfigError: the rig keeps no tables of this topic; the argument `also` of the rig adds topics.
            TimeoutError: so many rows did not arrive within 10 s; this call does not advance a rig in lockstep.
        """
        self.client.wait_until(lambda: len(self.rows(topic)) >= count, f"{count} rows of {topic}")
        return super().newest(topic, count)

    def _forget(self) -> None:
        if self.runs_by_itself:
            self.sample = self._received_to()
        for topic, collector in self._collectors.items():
            if topic not in ESSENTIAL:
                collector.clear()

    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change parameters of the rig's node from the first scan that is not measured yet.

        Values of `drive` and the seed apply only from the next reset. A change of the mechanics puts the sphere back to
        `sphere.start`.

        Args:
            changes: new values, `section.key` -> value, as in docs/reference/configuration.md.

        Returns:
            The new configuration.

        Raises:
            ConfigError: the node rejected the values; nothing is changed.
        """
        self.client.set_parameters("rig", changes)
        self.config = from_flat(self.config, changes)
        self._step_blocks = changes.get("step.blocks", self._step_blocks)
        return self.config

    def inject(self, fault: Fault) -> int:
        """Add an instrument fault, as a further line of `instruments.faults.planned`.

        Args:
            fault: the fault; its `start_sample` must be at least `frontier_sample`, so set it: the default is 0.

        Returns:
            Number of the fault among the planned ones, from 1.

        Raises:
            CommandError: `start_sample` is too small.
            ConfigError: the node rejected the fault.
        """
        if fault.start_sample < self.frontier_sample:
            raise CommandError(
                f"start_sample of a fault must be >= {self.frontier_sample}, the first scan not yet measured, "
                f"got {fault.start_sample}"
            )
        since = attrs.evolve(fault, start_sample=fault.start_sample - self.frontier_sample)
        line = since.line(self.rate_hz)
        planned = [*self.config.instruments.faults.planned, line]
        self.configure({"instruments.faults.planned": planned})
        self._injected.append((line, fault))
        return len(super().faults)

    @property
    def faults(self) -> list[Fault]:
        """Instrument faults: the planned ones, and those injected since the last `restart` or `renew`.

        Faults that have ended or were removed are listed, too. `start_sample` of an injected fault is the scan number
        given to `inject`, counted from scan 0.
        """
        lines = [line for line in self.config.instruments.faults.planned if line.split()]  # no fault on an empty one
        planned = list(zip(lines, super().faults, strict=True))
        for line, _ in self._injected:
            if line in lines:  # a line may occur several times: the last of them were injected
                last = len(lines) - 1 - lines[::-1].index(line)
                del lines[last], planned[last]
        return [fault for _, fault in planned] + [fault for _, fault in self._injected]

    def poll(self) -> None:
        """Process the messages that have arrived, without waiting or checking whether the nodes still run."""
        self.client.spin_pending()

    @property
    def step_delivers(self) -> bool:
        """Return whether all blocks of a step that are not withheld have arrived when `step` returns.

        The rig must advance only in `step`, and wait for the acknowledgements of this program.
        """
        return not self.runs_by_itself and self.client.name in self._peers

    def watch(self) -> Callable[[], None]:
        """Return a function that raises a GoneError once the rig that runs now is gone or replaced.

        Raises:
            GoneError: the rig is gone already.
        """
        return self.client.given("use of the running rig")

    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Send samples of the stream that drives the rig (`drive.waveform: stream`), on `shaker/waveform`.

        The rig's node checks the samples later. It drops samples that arrive too late (`late` of `stream_level`). It
        rejects all samples of the call, and logs a warning, if a sample is not finite or exceeds shaker or buffer, or
        if a pluck has locked the base.

        Args:
            first: number of the first of these samples, counted from scan 0 at `stream_rate_hz`.
            samples: samples [A, m or V by `drive.kind`], shape (n,); an empty array ends the stream there.

        Raises:
            CommandError: the rig was not started or restarted with a stream as its drive, or the shaker is stopped.
            TimeoutError: the rig does not subscribe to the topic.
        """
        self._published_states()
        if stopped := self.stopped:
            raise CommandError(stopped)
        self.client.publish(topics.WAVEFORM, codec.encode(self._samples(first, samples)), listener="rig")
        self._sent_to = first + len(samples)

    def stream_level(self) -> StreamLevel:
        """Return the last published state of the buffer that holds the samples of the drive.

        Returns:
            Numbers of samples: `sample` (the next to play), `buffered`, `capacity`, `late` and `missing`. Samples that
            this program has sent since the state was published count as buffered.

        Raises:
            CommandError: the rig was not started or restarted with a stream as its drive.
        """
        states = self._published_states()
        table = states.last()
        assert table is not None
        del states.received[:-1]
        row = table.rows[0]
        sample = int(row["wanted"])
        buffered = max(int(row["buffered"]), self._sent_to - sample)
        return StreamLevel(sample, buffered, *(int(row[name]) for name in ("capacity", "late", "missing")))

    @property
    def stream_rate_hz(self) -> int:
        """Samples per second of the stream that drives the rig; a new `drive.stream_rate_hz` counts from a reset on."""
        state = self._stream.last() if self._stream and self.config.drive.waveform == "stream" else None
        return super().stream_rate_hz if state is None else int(state.rows["rate"][0])

    def _published_states(self) -> Collector:
        """Return the collector of the stream's states (`shaker/stream`).

        Raises:
            CommandError: the drive is not a stream.
        """
        if self._stream is None or self.config.drive.waveform != "stream":
            waveform = self.config.drive.waveform
            wrong = "not yet a stream" if waveform == "stream" else f"{waveform}, not a stream"
            raise CommandError(f"the drive is {wrong}: start the rig with drive.waveform: stream")
        return self._stream

    @property
    def stopped(self) -> str:
        """Reason why the shaker is stopped by a trip or emergency stop, from the journal; empty if it is not stopped.

        The shaker stays stopped, and the rig cannot be reset, until the service `rig/clear_trip`. A stop before this
        object joined a running rig is not reported.
        """
        for entry in self._collectors[topics.JOURNAL.name].entries(self._journal_read):
            self._journal_read += 1
            if entry.kind is InputKind.TRIP:
                shaker = self.config.shaker
                limit = shaker.travel_limit_m if entry.name == OVER_TRAVEL else shaker.current_limit_a_rms
                self._stopped = f"the rig tripped: {Trip(0, entry.name, entry.number, limit).message()}"
            elif entry.kind is InputKind.STOP:
                self._stopped = f"the rig tripped: {EMERGENCY}"
            elif entry.kind is InputKind.CLEAR_TRIP:
                self._stopped = ""
        return self._stopped

    def renew(self, config: RigConfig) -> None:
        """Restart rig, analysis and recorder with another configuration, in the same processes.

        Nodes of `host` and `start_node` are ended, and the rig no longer waits for nodes of `follow`. With
        `record=True`, a new recording replaces the old one. A recording in another directory is finished, and no new
        recording begins.

        Args:
            config: new configuration of the rig; settings that `restart` leaves unchanged are not applied.

        Raises:
            ImpactRigError: a node of the rig has ended or does not answer.
        """
        peers, processes, subscriptions = self._own
        self._listeners.clear()
        while self._tested:
            self.client.evict(self._tested.pop())
        if own := set(self.processes.running) - processes:
            self.processes.stop(*own)
        for subscription in set(self.client.node.subscriptions) - subscriptions:
            self.client.node.destroy_subscription(subscription)
        self._peers = [peer for peer in self._peers if peer in peers]
        self.scenario = ""
        before, record = self._run, None
        if self._records_temporarily:
            record = Path(tempfile.mkdtemp(dir=self.directory)) / RUN
        self.restart(config, self._analysis or {}, record)
        if before is not None and self._records_temporarily:
            shutil.rmtree(before, ignore_errors=True)

    def restart(
        self, config: RigConfig, analysis: Mapping[str, ParameterValue], record: str | Path | None = None
    ) -> RosRig:
        """Restart the nodes with another configuration, in the same processes; return this rig.

        Scan rate, block length and the settings of `time` and `step` stay as they are (`FIXED`).

        Args:
            config: new configuration of the rig; its values of the settings in `FIXED` are not applied.
            analysis: parameters of the analysis to set, if the rig has one; other parameters stay as they are.
            record: directory of the run that the recorder writes from now on; None means no recording.

        Raises:
            ImpactRigError: a node rejected its parameters or a transition.
        """
        client = self.client
        self.stop_recording()
        if record is not None and self._hosted_recorder is None and self._recorder not in self.processes.running:
            self._start("recorder", {"record": False})
            client.wait_active(self._recorder)
            self._peers.append(self._recorder)
        if self.stopped:  # the latch survives the transitions
            client.trigger("rig/clear_trip")
        if self._measurements:
            client.change_state("analysis", "deactivate")
        client.change_state("rig", "deactivate")
        client.change_state("rig", "cleanup")  # its publishers take their history with them
        client.spin_pending()
        for collector in (*self._collectors.values(), *([self._stream] if self._stream else [])):
            collector.clear()
        values = {name: value for name, value in to_flat(config).items() if not name.startswith(FIXED)}
        client.set_parameters("rig", {**values, "time.peers": self._peers})
        transitions = [("rig", "configure"), ("rig", "activate")]
        if self._measurements:
            client.set_parameters("analysis", analysis)
            transitions.append(("analysis", "activate"))
        for node, transition in transitions:
            if not client.change_state(node, transition):
                why = client.status(node).message or "no reason was reported, see the log of this node"
                raise ImpactRigError(f"{node} did not {transition}: {why}")
        client.wait_active(*(node for node, transition in transitions if transition == "activate"))
        if record is not None:
            run = Path(record)
            client.set_parameters(self._recorder, {"directory": str(run.parent), "name": run.name})
            client.trigger(f"{self._recorder}/start")
            self._run = run
        self.config, self.sample = from_flat(self.config, values), 0
        self._injected.clear()
        if config.drive.waveform == "stream":
            if self._stream is None:
                self._connect_stream()
            else:
                client.wait_until(self._stream.last, topics.STREAM.name)
        self._sent_to = 0
        self._kept_from = self._lost_before = self._journal_read = 0
        self._stopped = ""
        return self

    def stop_recording(self) -> None:
        """Finish the run that the recorder is writing, if there is one."""
        if self._run is not None:
            self._run = None
            self.client.trigger(f"{self._recorder}/stop")

    def save(self, directory: str | Path) -> Path:
        """Finish the recording, and copy it with the logs of the nodes; nothing is recorded after that.

        Args:
            directory: directory of the copy, which must not exist yet.

        Returns:
            The directory.

        Raises:
            RecordingError: there is no recording, or it cannot be copied.
        """
        directory, run = Path(directory), self._run
        if run is None:
            raise RecordingError(
                "there is no recording to save: start the rig with `record`, and call `save` only once, instead of "
                "`stop_recording`"
            )
        try:
            self.stop_recording()
        # a process has ended or hangs, or a hosted node raises: a recorder finishes its run as it ends
        except Exception:
            self.processes.stop(*({self._recorder} & set(self.processes.running)))
            if self._hosted_recorder is not None and self._hosted_recorder.active:
                self._hosted_recorder.trigger_deactivate()
        try:
            shutil.copytree(run, directory)
            if any((self.directory / "logs").iterdir()):  # hosted nodes write none
                shutil.copytree(self.directory / "logs", directory / "logs")
        except OSError as error:
            self._run = run  # so that another directory can be tried
            raise RecordingError(
                f"the run cannot be copied to {directory}: {error.strerror or error}; save it to another directory, or "
                f"copy it from {run} before the rig is closed"
            ) from error
        return directory

    def close(self) -> None:
        """End all node processes and nodes that this object started, which finishes its recording.

        A temporary `directory` is removed with its logs and recording. A rig that another program started continues. It
        no longer waits for the nodes of `host`, `start_node` and `follow`.
        """
        super().close()
        kept = [peer for peer in self._peers if peer in self._own[0]]
        if self._joined and kept != self._peers:
            self._peers = kept
            with contextlib.suppress(ImpactRigError, TimeoutError):  # the rig may be gone
                self.client.set_parameters("rig", {"time.peers": self._peers})
        self._stack.close()

    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        return int(self.client.command(frequency_hz, current_a)["sample"])

    def _add_peer(self, name: str) -> None:
        self._peers.append(name)
        self.client.set_parameters("rig", {"time.peers": self._peers})

    def _acknowledge_answers(self, name: str, output: str, timeout_s: float) -> Collector:
        """Acknowledge blocks of scans for the node `name`, which answers each block by a message on `output`.

        A message with a header acknowledges the block with the same stamp, a message without a header the next block in
        order. `timeout_s` is the time limit for a publisher of `output` to appear [s].

        Returns:
            Collector of the messages on `output`.
        """
        scans = self._collectors[SCANS]
        begin = answered = len(scans)

        def on_output(message: Received) -> None:
            nonlocal answered
            stamp = header_stamp_ns(message.data)
            if stamp is not None:
                self.client.acknowledge_for(name, stamp)
            else:
                answered += 1
                on_scan(message)

        def on_scan(_message: Received) -> None:
            """Acknowledge the blocks that have arrived and that the node has answered on `output`.

            It is called for every block, and for every answer without a stamp, which may arrive before its block.
            """
            known = min(answered, len(scans))
            if known > begin:
                self.client.acknowledge_for(name, codec.header_stamp_ns(scans.received[known - 1].data))

        scans.then(on_scan)
        return self.client.listen(output, on_output, timeout_s)
