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
"""Connection to one rig of the graph: subscriptions, and the actions requested by pages, in one event loop.

Actions are coroutines of that loop: STOP is sent even while another action waits. An action belongs to the activation
of the rig for which it was requested. If that rig is gone, the action is rejected and never reaches a later one.

Blocks and joint states arrive hundreds of times per second, without waking the loop for each. The drawing code takes
their bytes in batches, and only while a page is open. If a queue overflows meanwhile, only pictures are lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import itertools
import time
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any  # messages and values of parameters

import attrs
from rcl_interfaces.srv import SetParametersAtomically
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from std_srvs.srv import SetBool, Trigger

from impact_rig import states, topics
from impact_rig.client.client import Client, ros_parameters
from impact_rig.client.service_call import ServiceCall
from impact_rig.errors import ImpactRigError, reason_of
from impact_rig.instruments.fault import fault_line
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.nodes import messages
from impact_rig.nodes.rclpy_internals import take_messages
from impact_rig.nodes.session import EXPIRES_S
from impact_rig.rig.config import RigConfig, fields, from_flat, parameters_in, to_flat
from impact_rig.rig.gaps import case_of, gap_values
from impact_rig.rig.journal import PLANNED
from impact_rig.runs import recover
from impact_rig_lab.protocol import Request
from impact_rig_lab.record import RigView
from impact_rig_lab.state import DEAD_S, Answer, Seen

ANSWER_S = 30.0  # time limit of an answer: a busy machine answers late, and the control stays pending until then
TOLD_S = 1.5  # time limit within which diagnostics must report an action of the rig
ECHO_S = 5.0  # time limit within which an accepted parameter must be reported as active
START_S = 60.0
AGAIN_S, ATTEMPTS = 0.5, 20  # interval and number of requests to a node that has just been started
MOST_FAULTS = 16
SWEEPER = "stepped_sine"
PROGRAMS = {SWEEPER: "impact_rig_studies"}
"""Modules that run a node of another package, by node."""
FREE = frozenset({"stop", "sweep_stop", "note", "record", "restart", "recover"})
"""Requests that belong to no activation of the rig: those that make the rig safe, and those that do not concern it."""
COMMANDS = {"frequency": topics.FREQUENCY, "current": topics.CURRENT}
"""Commands, and the columns of `shaker/applied` that confirm them."""
TRIGGERS = {"reset": "rig/reset", "clear_trip": "rig/clear_trip", "sweep_stop": f"{SWEEPER}/stop"}
PARAMETERS = {
    "start": ("sphere.start", "sphere at {}"),
    "law": ("contact.law", "law {}"),
    "restitution": ("contact.restitution", "restitution {:g}"),
}
"""Requests that set one parameter of the rig, and their answers."""
PREPARED = (*TRIGGERS.values(), f"{SWEEPER}/start", "rig/stop", "rig/pluck", "recorder/start", "recorder/stop")
"""Services whose clients are created early, so that they are discovered by the time they are used."""
KEPT = (
    topics.INFO, topics.APPLIED, topics.JOURNAL, topics.FAULTS, topics.TRANSMISSIBILITY_TABLE, topics.CONFIGURATION,
    topics.NOTES,
)  # fmt: skip
"""Rare topics, of which no message may be lost."""
SCANS = (topics.STREAM, topics.WAVEFORM, topics.SCAN, topics.IMPACTS)
TRUTH = (topics.JOINT_STATES, topics.IMPACTS_TRUTH)  # drawn topics; commands that act on a scan are processed before it
MOST_PER_LOOK = 300  # maximum number of messages processed per topic at once, so that pictures are drawn in between
PICTURES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=256, reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)  # fmt: skip


class Refused(ImpactRigError):  # noqa: N818  # a property of a request, not an internal error
    """Rejection of a request; its message is shown on the page."""


class OwnedProcesses:
    """Nodes started by the lab itself."""

    def __init__(self, processes: Any, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        self.processes, self.parameters = processes, parameters
        self._starter = ThreadPoolExecutor(1, thread_name_prefix="lab-starter")
        # the thread that starts nodes does not have the lower priority of later threads, so nodes do not have it either
        self._starter.submit(time.monotonic).result()

    def start(self, node: str) -> None:
        """Start a node."""
        program, parameters = PROGRAMS.get(node, node), self.parameters.get(node, {})
        self._starter.submit(self.processes.start, program, parameters, name=node).result()

    def close(self) -> None:
        """Start no further nodes."""
        self._starter.shutdown()

    def ended(self, node: str) -> str:
        """Return how the process of a node has ended; empty if it is running, or was not started by the lab."""
        process = self.processes.running.get(node)
        code = None if process is None else process.exit_code
        return "" if code is None else f"its process ended with code {code}"


@attrs.define(eq=False)
class _Running:
    """Action in progress."""

    answer: Answer
    instance: str | None
    task: asyncio.Task[str]
    why: str = ""


class Gateway:
    """Subscriptions to one rig and actions on it, in the event loop that creates it.

    Without `own`, no nodes can be started.
    """

    def __init__(self, client: Client, record: RigView, own: OwnedProcesses | None) -> None:
        self.client, self.record, self._own = client, record, own
        self._heard_at: dict[str, tuple[Any, float]] = {}
        self._running: set[_Running] = set()
        self._actions: dict[str, Callable[..., Awaitable[str]]] = {
            name.removeprefix("do_"): getattr(self, name) for name in dir(self) if name.startswith("do_")
        }
        self._actions |= {do: functools.partial(self._trigger, name) for do, name in TRIGGERS.items()}
        self._actions |= {do: functools.partial(self._command, do) for do in COMMANDS}
        self._actions |= {do: functools.partial(self._parameter, *target) for do, target in PARAMETERS.items()}
        for name in PREPARED:
            client.prepare(Trigger, name)
        client.prepare(SetBool, "rig/pause")
        for node in ("rig", "analysis", SWEEPER):
            client.prepare(SetParametersAtomically, f"{node}/set_parameters_atomically")
        for topic in (*COMMANDS.values(), topics.NOTES):
            client.publisher(topic)
        for topic in KEPT:
            client.subscribe(topic, lambda data, _info, topic=topic: record.take(topic, data), raw=True)
        self._view = Node(  # its callbacks never run
            "lab_view", namespace=client.node.get_namespace(), context=client.context,
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
        self._samples: dict[topics.Topic, Any] = {}

    async def close(self, why: str) -> None:
        """Cancel all actions in progress, and unsubscribe from all topics."""
        self.end(why)
        await asyncio.sleep(0)
        self._view.destroy_node()

    # Subscriptions

    def listen(self, scans: bool, motion: bool) -> None:
        """Subscribe to scans and motion, or unsubscribe; without `motion`, drop the known motion."""
        wanted = {*(SCANS if scans else ()), *(TRUTH if scans and motion else ())}
        for topic in self._samples.keys() - wanted:
            self._view.destroy_subscription(self._samples.pop(topic))
            if topic is topics.JOINT_STATES and not motion:
                with self.record.lock:
                    self.record.forget_motion()
        for topic in [topic for topic in (*SCANS, *TRUTH) if topic in wanted and topic not in self._samples]:
            kind, never = messages.class_of(topic), lambda _message: None  # the callback never runs
            self._samples[topic] = self._view.create_subscription(kind, topic.name, never, PICTURES, raw=True)

    def take(self) -> bool:
        """Process the messages received since the last call; return whether there were any."""
        received = False
        for topic, subscription in self._samples.items():
            found = list(itertools.islice(take_messages(subscription, raw=True), MOST_PER_LOOK))
            received = received or bool(found)
            if self.record.since_ns() > self.record.start_ns:
                continue  # scan 0 of this rig is unknown: its data would be appended to those of the previous rig
            with self.record.lock:
                for data in found:
                    self.record.take(topic, data)
        return received

    def seen(self, node: str) -> Seen:
        """Return the last report of a node, and its age."""
        status = self.client.diagnostics.get(node)
        ended = self._own.ended(node) if self._own is not None else ""
        if status is None:
            return Seen(ended=ended)
        known = self._heard_at.get(node)
        if known is None or known[0] is not status:
            self._heard_at[node] = known = (status, time.monotonic())
        return Seen.of(node, self.client.figures(node), time.monotonic() - known[1], ended)

    # Actions

    def begin(self, request: Request, answer: Answer) -> None:
        """Start an action; reject it at once if its rig is gone."""
        action = self._actions.get(request.do)
        instance = None
        if request.do not in FREE:
            instance = self.seen("rig").instance if request.rig is None else request.rig
        if action is None:
            answer(False, f"{request.do}: a live rig cannot do that")
        elif why := self._gone(instance):
            answer(False, f"{why}: not sent")
        else:
            if request.do == "stop":
                self.end("an emergency stop was requested meanwhile", bound=True)
            running = _Running(answer, instance, asyncio.ensure_future(action(**request.values)))
            self._running.add(running)
            running.task.add_done_callback(lambda _task: self._done(running))

    def _done(self, running: _Running) -> None:
        """Report the result of an action to the page."""
        self._running.discard(running)
        error = None if running.task.cancelled() else running.task.exception()
        if running.task.cancelled():
            running.answer(False, running.why)
        elif error is None:
            running.answer(True, running.task.result())
        else:  # any exception: other actions and the page continue
            running.answer(False, reason_of(error))

    @property
    def is_busy(self) -> bool:
        """Return whether an action is in progress."""
        return bool(self._running)

    def watch(self) -> None:
        """Reject the actions that wait for a rig that is gone."""
        for running in list(self._running):
            if why := self._gone(running.instance):
                self._break_off(running, f"{why}: it did not accept this")

    def end(self, why: str, *, bound: bool = False) -> None:
        """Cancel all actions in progress, or those that belong to a rig."""
        for running in list(self._running):
            if not bound or running.instance is not None:
                self._break_off(running, why)

    def _break_off(self, running: _Running, why: str) -> None:
        running.why = why
        running.task.cancel()

    def _gone(self, instance: str | None) -> str:
        """Return why the rig of an action is gone; empty if the rig exists, or if the action belongs to no rig."""
        if instance is None:
            return ""
        rig = self.seen("rig")
        # a process of this lab is known to run or to have ended; on a busy machine its reports may be late
        silent_s = DEAD_S if self._own is not None and "rig" in self._own.processes.running else EXPIRES_S
        if rig.ended:
            return f"the rig is gone: {rig.ended}"
        if rig.age_s is None:
            return "there is no rig yet"
        if rig.age_s > silent_s:
            return f"no report from the rig for {rig.age_s:.1f} s"
        return "" if rig.instance == instance else "another rig has started since"

    # Access to the graph

    async def until(self, check: Callable[[], Any], what: str, timeout_s: float) -> Any:
        """Return the value of a check as soon as it is true; the check is evaluated once per turn of the loop.

        Raises:
            Refused: the value did not become true in time; the message names `what`.
        """
        deadline = time.monotonic() + timeout_s
        while not (found := check()):
            if time.monotonic() > deadline:
                raise Refused(f"timeout after {timeout_s:g} s: waiting for {what}")
            await asyncio.sleep(0)
        return found

    async def _call(self, service_type: Any, name: str, request: Any, timeout_s: float = ANSWER_S) -> str:
        client = self.client.prepare(service_type, name)
        await self.until(client.service_is_ready, f"the service {name}; is its node running?", timeout_s)
        with ServiceCall(client, request) as call:
            response = await self.until(call.response, f"an answer of {name}", timeout_s)
        result = getattr(response, "result", None)  # for set parameters
        done, words = (result.successful, result.reason) if result else (response.success, response.message)
        if not done:
            raise Refused(words)
        return str(words)

    async def _trigger(self, name: str, timeout_s: float = ANSWER_S) -> str:
        return await self._call(Trigger, name, Trigger.Request(), timeout_s)

    async def _set(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node; when this returns, those of the rig are active."""
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in ros_parameters(values)])
        await self._call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
        if node == "rig":
            target = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
            knobs = self.record.knobs
            await self.until(
                lambda: all(self.record.knobs.get(name) == value for name, value in target.items())
                or self.record.knobs is not knobs, "rig/configuration", ECHO_S,
            )  # fmt: skip

    async def _parameter(self, name: str, words: str, value: Any) -> str:
        await self._set("rig", {name: value})
        return words.format(value)

    def _publish(self, topic: topics.Topic, value: Any) -> None:
        publisher = self.client.publisher(topic)
        if not publisher.get_subscription_count():
            raise Refused(f"no subscriber on {topic.name}; is the rig running?")
        publisher.publish(publisher.msg_type(data=value))

    async def _command(self, column: str, value: float) -> str:
        """Publish a command and wait for its row in shaker/applied, or for the rejection."""
        record, topic = self.record, COMMANDS[column]
        before, refusal = record.changes, self.client.refusal(topic.name, "inactive")
        self._publish(topic, value)

        def is_answered() -> bool:
            new = list(record.applied)[-(record.changes - before) :] if record.changes > before else []
            if any(row[column] == value for _, row in new):
                return True
            if words := refusal():
                raise Refused(words)
            return False

        await self.until(is_answered, f"{column} {value:g} in shaker/applied", ANSWER_S)
        return f"{column} {value:g}"

    # The rig

    async def do_stop(self) -> str:
        """Ramp the current to zero and latch the shaker, in any state of the rig."""
        if gone := self.seen("rig").ended:
            raise Refused(f"there is no rig to stop: {gone}")
        asked_at = time.monotonic()

        def is_latched() -> bool:
            rig = self.seen("rig")
            return (rig.age_s or 0.0) < time.monotonic() - asked_at and bool(rig.figures.get("latched"))

        try:
            return await self._trigger("rig/stop")
        except Refused:  # with two rigs in the namespace, the one that has not started may answer first
            with contextlib.suppress(Refused):
                await self.until(is_latched, "the latch", TOLD_S)
                return "stopped; the rig confirms it"
            raise

    async def do_pluck(self, value: float) -> str:
        """Release the superior base from a displacement [m]."""
        await self._set("rig", {"pluck.displacement_m": value})
        return await self._trigger("rig/pluck")

    async def do_pause(self, value: bool) -> str:  # value of the request
        """Stop rig time, or resume it."""
        return await self._call(SetBool, "rig/pause", SetBool.Request(data=value))

    async def do_gap(self, value: float) -> str:
        """Set the gap of the rig and the label of the analysis together [m]; 0 removes the sphere."""
        if value < 0.0:
            raise Refused(f"a gap must be 0 (no sphere) or more, got {value * 1e3:g} mm")
        await self._set("rig", gap_values(value))
        return case_of(value) + await self._label(value)

    async def _label(self, gap_m: float) -> str:
        """Send the gap to the analysis as its label; return a remark to add to the answer."""
        if not self.seen("analysis").lives:
            return "; no analysis is running to be labelled"
        await self._set("analysis", {"gap_m": gap_m})
        return ""

    async def do_load(self, value: str) -> str:
        """Apply a ROS 2 parameter file: all its differences from the present values, or nothing."""
        wanted = to_flat(from_flat(RigConfig(), parameters_in(value)))
        present = to_flat(from_flat(RigConfig(), self.record.knobs))
        changes = {name: found for name, found in wanted.items() if found != present[name]}
        fixed = sorted(name for name, about, _ in fields() if about.read_only and name in changes)
        changes = {name: found for name, found in changes.items() if name not in fixed}
        if changes:
            await self._set("rig", changes)
        words = f"{len(changes)} settings changed" if changes else "these settings are active already"
        if {"barriers.gap_m", "sphere.present"} & changes.keys():
            words += await self._label(float(str(wanted["barriers.gap_m"])) if wanted["sphere.present"] else 0.0)
        return f"{words}; fixed while the rig runs: {', '.join(fixed)}" if fixed else words

    async def do_fault(self, kind: str, channel: str, value: float, duration: float, rate: float) -> str:
        """Add a line to the planned faults, so that a new fault starts now."""
        if kind not in FAULT_KINDS:
            raise Refused(f"unknown kind of fault {kind!r}")
        added = fault_line(kind, channel, duration_s=duration, value=value, rate_hz=rate)
        lines = [line for line in self.record.knobs.get(PLANNED) or () if line][-(MOST_FAULTS - 1) :]
        await self._set("rig", {PLANNED: [*lines, added]})
        return f"fault: {added}"

    async def do_clear_faults(self) -> str:
        """End every fault."""
        await self._set("rig", {PLANNED: [""]})
        return "faults cleared"

    # Other nodes

    async def do_sweep(self, frequencies: tuple[float, ...], direction: str, hold: str, target: float) -> str:
        """Start a stepped sine; start its node first if it is absent."""
        was_there = self.seen(SWEEPER).lives
        if not was_there:
            self._start(SWEEPER)
            await self.until(lambda: self.seen(SWEEPER).lives, f"the node {SWEEPER}", START_S)
        current = (self.record.drive or {"current": 0.0})["current"]
        plan = {
            "frequencies_hz": list(frequencies), "direction": direction, "current_a": current or 0.52, "hold": hold,
            **({"target": target} if hold in ("current", "base", "superior") else {}),
        }  # fmt: skip
        await self._set(SWEEPER, plan)
        attempts = 1 if was_there and hold != "phase" else ATTEMPTS
        while True:
            attempts -= 1
            try:
                return await self._trigger(f"{SWEEPER}/start")
            except Refused:  # a node that has just started may not have discovered the rig or its scans yet
                if not attempts:
                    raise
            await asyncio.sleep(AGAIN_S)

    async def do_note(self, value: str) -> str:
        """Record a remark."""
        recorder = self.seen("recorder")
        if not value.strip():
            raise Refused("a remark must not be empty")
        if not recorder.lives:
            raise Refused(
                f"no recorder is running, so the remark would be lost{f', {recorder.gone}' if recorder.gone else ''}"
            )
        self._publish(topics.NOTES, value)
        records = recorder.state not in (
            states.RecorderWord.INACTIVE,
            states.RecorderWord.FAILED,
            states.RecorderWord.IDLE,
        )
        return "noted" if records else "shown on the page; no recording is running"

    async def do_record(self, value: bool) -> str:  # value of the request
        """Start or stop a recording."""
        return await self._trigger("recorder/start" if value else "recorder/stop", 20.0)

    async def do_recover(self) -> str:
        """Recover the last recording."""
        recorder = self.seen("recorder")
        directory = recorder.figures.get("directory", "")
        if recorder.lives or not directory:
            raise Refused("the recorder is running: nothing to recover")
        target = Path(f"{directory}_recovered")
        report = await asyncio.to_thread(recover, directory, target)
        return f"recovered into {report.out.name if hasattr(report, 'out') else target.name}"

    async def do_restart(self) -> str:
        """Restart the nodes that have ended. A new rig is at rest, and the analysis receives its gap as label."""
        own = self._own
        if own is None:
            raise Refused("this lab did not start the rig: restart it where it was started")
        ended = [name for name in own.processes.running if own.ended(name)]
        if not ended:
            raise Refused("all processes are running")
        if "rig" in ended:
            self.record.knobs, self.record.configuration = {}, ""
        for name in ended:
            self._start(name)
        for name in ended:
            await self.until(lambda name=name: self.seen(name).lives, f"the node {name}", START_S)  # type: ignore[misc]
        knobs = await self.until(lambda: self.record.knobs, "rig/configuration", START_S)
        await self._label(knobs["barriers.gap_m"] if knobs["sphere.present"] else 0.0)
        return f"restarted: {', '.join(ended)}"

    def _start(self, node: str) -> None:
        """Start a node of this lab, and drop the last report of its previous process."""
        if self._own is None:
            raise Refused(
                f"the node {node} is not running: start it in the rig's namespace (ros2 run impact_rig {node}_node)"
            )
        if node in self._own.processes.running:
            self._own.processes.stop(node)
        self.client.diagnostics.pop(node, None)
        self._own.start(node)
