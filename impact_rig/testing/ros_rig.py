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
"""The rig as a ROS 2 node on a domain of its own, in lockstep with the nodes under test.

The rig advances only when told to, and the call returns when every peer has processed the last block: the test itself,
the recorder, and each node under test. A node under test becomes a peer in one of three ways: hosted in the test's
process (its callback's return is the acknowledgement), by an output of its own that answers each block, or by sending
`daq/ack` itself.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any  # rclpy nodes and messages

import attrs
from std_srvs.srv import Trigger

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.client.client import START_TIMEOUT_S, Client, Collector, Received, ros_parameters, subscribers
from impact_rig.client.processes import ParameterValue, Processes, isolated_domain
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.instruments.fault import Fault
from impact_rig.nodes.messages import header_stamp_ns
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import JournalEntry
from impact_rig.testing.virtual_rig import SCANS, TOPICS, SteppedRig, configured

NODE_TIMEOUT_S = 30.0  # how long a node under test may take to subscribe
ACK_WINDOW = 8
"""Blocks out and not acknowledged: less than the 10 messages most nodes keep, so that a slow one loses none."""
RUN = "run"


class RosRig(SteppedRig):
    """A rig and a recorder as processes, and a client that plays the operator.

    Args:
        directory: for logs and the recording; made if missing.
        parameters: configuration values, `section.key` -> value, as in docs/interface.md.
        name: what reports call it.
        hosted: run rig and recorder in the test's process as well: starts in a tenth of the time, still real DDS.

    Raises:
        ConfigError: unknown key, bad value or fault.
    """

    def __init__(
        self,
        directory: Path,
        parameters: Mapping[str, ParameterValue] | None = None,
        faults: Iterable[Fault] = (),
        name: str = "rig",
        hosted: bool = False,
    ) -> None:
        super().__init__(name, configured({"time.ack_window": ACK_WINDOW, **(parameters or {})}, faults))
        if self.config.time.mode != "stepped":
            raise ConfigError(f"time.mode of a rig in lockstep is stepped, got {self.config.time.mode}")
        self._directory = directory
        self._peers = ["client", "recorder"]
        self._injected: list[tuple[str, Fault]] = []
        self._stack = contextlib.ExitStack()
        self._recorder: RecorderNode | None = None  # where it is hosted
        self._step_blocks = self.config.step.blocks
        with contextlib.ExitStack() as stack:
            domain_id = stack.enter_context(isolated_domain())
            self.processes = stack.enter_context(Processes(domain_id, directory / "logs"))
            """The node processes, to stop, kill or suspend one."""
            self.client = stack.enter_context(Client(domain_id, processes=self.processes))
            """The operator: parameters, services, topics."""
            for service in ("rig/step", "recorder/stop"):
                self.client.prepare(Trigger, service)
            self._start(
                "rig",
                {
                    "time.ack_window": ACK_WINDOW,
                    **(parameters or {}),
                    "instruments.faults.planned": list(self.config.instruments.faults.planned) or [""],
                    "time.mode": "stepped",
                    "time.peers": self._peers,
                },
                hosted=hosted,
            )
            self._start("recorder", {"directory": str(directory), "name": RUN}, hosted=hosted)
            self.client.wait_active("rig", "recorder")
            self._collectors = {topic: self.client.collect(topic, acknowledge=topic == SCANS) for topic in TOPICS}
            self._stack = stack.pop_all()

    def _start(self, node: str, parameters: Mapping[str, ParameterValue], *, hosted: bool) -> None:
        if not hosted:
            self.processes.start(node, parameters)
            return
        make_node = {"rig": RigNode, "recorder": RecorderNode}[node]
        hosted_node = self.client.host(make_node, parameter_overrides=ros_parameters(parameters))
        if node == "recorder":
            self._recorder = hosted_node

    # The pipeline under test

    def host(self, make_node: Callable[..., Any], **kwargs: Any) -> Any:
        """Run a node under test in this process and return it: in lockstep without a word about it in its code.

        Raises:
            ConfigError: it does not subscribe to daq/scan.
        """
        node = self.client.host(make_node, **kwargs)
        if not self.client.acknowledge_callbacks(node):
            raise ConfigError(f"node {node.get_name()!r} does not subscribe to {SCANS}")
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
        """Start a node under test as a process.

        Args:
            command: program and arguments; `--ros-args -r __node:=NAME …` is appended.
            name: its node name.
            parameters: its ROS parameters.
            output: a topic on which it answers every block; a header's stamp says which, without one they are counted.
                None: the node sends `daq/ack` itself, with its name as `frame_id`.
            timeout_s: how long it may take to subscribe to daq/scan.

        Returns:
            What arrives on `output`.
        """
        self.processes.start(name, parameters, name=name, command=command)
        return self.follow(name, output, timeout_s)

    def follow(self, name: str, output: str | None = None, timeout_s: float = NODE_TIMEOUT_S) -> Collector | None:
        """Keep step with a node that somebody else has started; see `start_node`."""
        node = self.client.node
        self.client.wait_until(lambda: name in subscribers(node, SCANS), f"node {name} to subscribe {SCANS}", timeout_s)
        found = None if output is None else self._acknowledge_answers(name, output, timeout_s)
        self._add_peer(name)
        return found

    def listen(self, topic: str) -> Collector:
        """Keep everything that arrives on any topic; a publisher must be there."""
        return self.client.listen(topic)

    # SteppedRig

    def step(self, blocks: int = 1) -> None:
        """Advance by whole blocks.

        Raises:
            ServiceFailedError: a peer does not acknowledge; names it.
            ProcessDiedError: a node process ended; its last words.
        """
        if blocks < 1:
            return
        if blocks != self._step_blocks:
            self.client.set_parameters("rig", {"step.blocks": blocks})
            self._step_blocks = blocks
        # silent for seconds it may be where the machine is busy; whether it lives is known of its process
        before = len(self._collectors[SCANS])
        try:
            self.client.trigger("rig/step", START_TIMEOUT_S, may_be_silent=True)
        except Exception:
            self.sample += (len(self._collectors[SCANS]) - before) * self.block_scans  # so far it came
            raise
        self.sample += blocks * self.block_scans

    def journal(self) -> list[JournalEntry]:
        """Return the entries of the journal that arrived, oldest first."""
        return self._collectors["rig/journal"].entries()

    def tables(self, topic: str = SCANS) -> list[Table]:
        """Return what arrived on a table topic, see `TOPICS`, oldest first.

        Scans, commands and journal are complete when a step returns; `truth/...` of the last blocks may come later.
        """
        return self._collectors[topic].tables()

    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change parameters of the rig's node; see `SteppedRig`."""
        self.client.set_parameters("rig", changes)
        self.config = from_flat(self.config, changes)
        self._step_blocks = changes.get("step.blocks", self._step_blocks)
        return self.config

    def inject(self, fault: Fault) -> int:
        """Start a fault by a further line of `instruments.faults.planned`; see `SteppedRig`."""
        since = attrs.evolve(fault, start_sample=fault.start_sample - self.frontier_sample)
        line = since.line(self.rate_hz)
        planned = [*self.config.instruments.faults.planned, line]
        self.configure({"instruments.faults.planned": planned})
        self._injected.append((line, fault))
        return len(planned)

    @property
    def faults(self) -> list[Fault]:
        """The faults that were planned or injected; the lines of these count from when they were added."""
        injected = {line for line, _ in self._injected}
        planned = zip(self.config.instruments.faults.planned, super().faults, strict=True)
        return [fault for line, fault in planned if line not in injected] + [fault for _, fault in self._injected]

    def save(self, directory: Path) -> Path:
        """Finish the recording and copy it, the logs beside it; the rig cannot go on after that.

        Raises:
            RecordingError: there is no recording, or it cannot be copied.
        """
        try:
            self.client.trigger("recorder/stop")
        except (
            Exception
        ):  # a process is gone or hangs, or a node hosted beside it raises: a recorder that ends finishes
            self.processes.stop(*({"recorder"} & set(self.processes.running)))
            if self._recorder is not None and self._recorder.active:
                self._recorder.trigger_deactivate()
        try:
            shutil.copytree(self._directory / RUN, directory)
            shutil.copytree(self._directory / "logs", directory / "logs")
        except OSError as error:
            raise RecordingError(f"the run cannot be copied to {directory}: {error}") from error
        return directory

    def close(self) -> None:
        """End client and processes, and remove the recording."""
        super().close()
        self._stack.close()
        shutil.rmtree(self._directory, ignore_errors=True)

    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        return int(self.client.command(frequency_hz, current_a)["sample"])

    def _add_peer(self, name: str) -> None:
        self._peers.append(name)
        self.client.set_parameters("rig", {"time.peers": self._peers})

    def _acknowledge_answers(self, name: str, output: str, timeout_s: float) -> Collector:
        """Acknowledge for a node whenever its output answers a block."""
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
            """Outputs are counted, and may overtake the blocks they answer."""
            known = min(answered, len(scans))
            if known > begin:
                self.client.acknowledge_for(name, codec.header_stamp_ns(scans.received[known - 1].data))

        scans.then(on_scan)
        return self.client.listen(output, on_output, timeout_s)
