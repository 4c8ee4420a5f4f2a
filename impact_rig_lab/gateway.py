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
"""The way to one rig of the graph: what is heard of it, and what pages ask of it, in one event loop.

Actions are coroutines of that loop: whatever one waits for, STOP is sent meanwhile. An action belongs to the activation
of the rig that it was asked of; when that is gone, it is refused and never reaches a later one.

Blocks and joint states come by the hundred per second: nobody is woken for them. They are taken in their bytes, some
at a time, by whoever draws, and only while somebody looks. A queue that overflows meanwhile loses pictures only.
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
from impact_rig.errors import ImpactRigError, in_words
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

ANSWER_S = 30.0  # a busy machine answers late: the knob stays pending until then
TOLD_S = 1.5  # how long what a rig has done may need to be told by its diagnostics
ECHO_S = 5.0  # how long a parameter that was taken may need to be told as in force
START_S = 60.0
AGAIN_S, ATTEMPTS = 0.5, 20  # how often a node that has just been started is asked to begin
MOST_FAULTS = 16
SWEEPER = "stepped_sine"
PROGRAMS = {SWEEPER: "impact_rig_studies"}
"""Modules that run a node of another package, by node."""
FREE = frozenset({"stop", "sweep_stop", "note", "record", "restart", "recover"})
"""Requests that belong to no activation of the rig: those that make safe, and those about something else."""
COMMANDS = {"frequency": topics.FREQUENCY, "current": topics.CURRENT}
"""Commands, and the columns of `shaker/applied` that tell them back."""
TRIGGERS = {"reset": "rig/reset", "clear_trip": "rig/clear_trip", "sweep_stop": f"{SWEEPER}/stop"}
PARAMETERS = {
    "start": ("sphere.start", "sphere at {}"),
    "law": ("contact.law", "law {}"),
    "restitution": ("contact.restitution", "restitution {:g}"),
}
"""Requests that set one parameter of the rig, and what is answered."""
PREPARED = (*TRIGGERS.values(), "rig/stop", "rig/pluck", "recorder/start", "recorder/stop")
"""Services whose clients are made early: they have been discovered when they are used."""
KEPT = (
    topics.INFO, topics.APPLIED, topics.JOURNAL, topics.FAULTS, topics.TRANSMISSIBILITY_TABLE, topics.CONFIGURATION,
    topics.NOTES,
)  # fmt: skip
"""What is rare and must not be lost."""
SCANS = (topics.STREAM, topics.WAVEFORM, topics.SCAN, topics.IMPACTS)
TRUTH = (topics.JOINT_STATES, topics.IMPACTS_TRUTH)  # what is drawn; what a scan was told is taken before it
MOST_PER_LOOK = 300  # messages taken of one topic at once: a picture must come out between
PICTURES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST, depth=256, reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)  # fmt: skip


class Refused(ImpactRigError):  # noqa: N818  # a fact about a request, not a mistake of ours
    """What was asked is not done; the message is for the page."""


class Own:
    """The nodes that the lab itself has started, or is to start."""

    def __init__(self, processes: Any, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        self.processes, self.parameters = processes, parameters
        self._starter = ThreadPoolExecutor(1, thread_name_prefix="lab-starter")
        self._starter.submit(time.monotonic).result()  # its thread is not as gentle as those begun later, nor are nodes

    def start(self, node: str) -> None:
        """Start a node."""
        program, parameters = PROGRAMS.get(node, node), self.parameters.get(node, {})
        self._starter.submit(self.processes.start, program, parameters, name=node).result()

    def close(self) -> None:
        """Start nothing more."""
        self._starter.shutdown()

    def ended(self, node: str) -> str:
        """Return how the process of a node has ended; empty: it runs, or is not ours."""
        process = self.processes.running.get(node)
        code = None if process is None else process.exit_code
        return "" if code is None else f"its process ended with code {code}"


@attrs.define(eq=False)
class _Running:
    """An action under way."""

    answer: Answer
    instance: str | None
    task: asyncio.Task[str]
    why: str = ""


class Gateway:
    """Hears one rig and does what pages ask for, in the event loop that creates it; without `own` it only looks."""

    def __init__(self, client: Client, record: RigView, own: Own | None) -> None:
        self.client, self.record, self._own = client, record, own
        self._heard_at: dict[str, tuple[Any, float]] = {}
        self._running: set[_Running] = set()
        self._actions: dict[str, Callable[..., Awaitable[str]]] = {
            name.removeprefix("do_"): getattr(self, name) for name in dir(self) if name.startswith("do_")
        }
        self._actions |= {do: functools.partial(self._trigger, name) for do, name in TRIGGERS.items()}
        self._actions |= {do: functools.partial(self._command, do) for do in COMMANDS}
        self._actions |= {do: functools.partial(self._parameter, *told) for do, told in PARAMETERS.items()}
        for name in PREPARED:
            client.prepare(Trigger, name)
        client.prepare(SetBool, "rig/pause")
        for node in ("rig", "analysis"):
            client.prepare(SetParametersAtomically, f"{node}/set_parameters_atomically")
        for topic in (*COMMANDS.values(), topics.NOTES):
            client.publisher(topic)
        for topic in KEPT:
            client.subscribe(topic, lambda data, _info, topic=topic: record.take(topic, data), raw=True)
        self._view = Node(  # spun by nobody
            "lab_view", namespace=client.node.get_namespace(), context=client.context,
            use_global_arguments=False, enable_rosout=False, start_parameter_services=False,
        )  # fmt: skip
        self._looks: dict[topics.Topic, Any] = {}

    async def close(self, why: str) -> None:
        """Break off everything under way, and hear nothing more."""
        self.end(why)
        await asyncio.sleep(0)
        self._view.destroy_node()

    # What is heard

    def listen(self, scans: bool, motion: bool) -> None:
        """Hear from now on scans and motion, or not; without `motion`, what was known of that is forgotten."""
        wanted = {*(SCANS if scans else ()), *(TRUTH if scans and motion else ())}
        for topic in self._looks.keys() - wanted:
            self._view.destroy_subscription(self._looks.pop(topic))
            if topic is topics.JOINT_STATES and not motion:
                with self.record.lock:
                    self.record.forget_motion()
        for topic in [topic for topic in (*SCANS, *TRUTH) if topic in wanted and topic not in self._looks]:
            kind, never = messages.class_of(topic), lambda _message: None  # nobody spins its node
            self._looks[topic] = self._view.create_subscription(kind, topic.name, never, PICTURES, raw=True)

    def take(self) -> bool:
        """Take what has come since the last time; return whether anything has."""
        came = False
        for topic, subscription in self._looks.items():
            found = list(itertools.islice(take_messages(subscription, raw=True), MOST_PER_LOOK))
            came = came or bool(found)
            if self.record.since_ns() > self.record.start_ns:
                continue  # of a rig whose scan 0 is not known yet: it would go on where the one before has ended
            with self.record.lock:
                for data in found:
                    self.record.take(topic, data)
        return came

    def seen(self, node: str) -> Seen:
        """Return what a node has said last, and how long ago."""
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
        """Begin an action; one for a rig that is gone is refused at once."""
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
                self.end("the emergency stop came first", bound=True)
            running = _Running(answer, instance, asyncio.ensure_future(action(**request.values)))
            self._running.add(running)
            running.task.add_done_callback(lambda _task: self._done(running))

    def _done(self, running: _Running) -> None:
        """Tell the page how an action has ended."""
        self._running.discard(running)
        error = None if running.task.cancelled() else running.task.exception()
        if running.task.cancelled():
            running.answer(False, running.why)
        elif error is None:
            running.answer(True, running.task.result())
        else:  # of whatever kind: the others go on, and so does the page
            running.answer(False, in_words(error))

    @property
    def is_busy(self) -> bool:
        """Whether an action is under way."""
        return bool(self._running)

    def watch(self) -> None:
        """Refuse what waits for a rig that is gone."""
        for running in list(self._running):
            if why := self._gone(running.instance):
                self._break_off(running, f"{why}: it did not take this")

    def end(self, why: str, *, bound: bool = False) -> None:
        """Break off everything under way, or what belongs to a rig."""
        for running in list(self._running):
            if not bound or running.instance is not None:
                self._break_off(running, why)

    def _break_off(self, running: _Running, why: str) -> None:
        running.why = why
        running.task.cancel()

    def _gone(self, instance: str | None) -> str:
        """Return why the rig of an action is gone; empty: it is there, or the action belongs to none."""
        if instance is None:
            return ""
        rig = self.seen("rig")
        # of our own it is known whether its process has ended, and on a busy machine it may be late
        silent_s = DEAD_S if self._own is not None and "rig" in self._own.processes.running else EXPIRES_S
        if rig.ended:
            return f"the rig is gone, {rig.ended}"
        if rig.age_s is None:
            return "there is no rig yet"
        if rig.age_s > silent_s:
            return f"nothing was heard of the rig for {rig.age_s:.1f} s"
        return "" if rig.instance == instance else "another rig has begun since"

    # Ways to the graph

    async def until(self, check: Callable[[], Any], what: str, timeout_s: float) -> Any:
        """Return what a check gives as soon as it is true; it is asked once a turn of the loop.

        Raises:
            Refused: it did not become true in time; names `what`.
        """
        deadline = time.monotonic() + timeout_s
        while not (found := check()):
            if time.monotonic() > deadline:
                raise Refused(f"waited {timeout_s:g} s in vain for {what}")
            await asyncio.sleep(0)
        return found

    async def _call(self, service_type: Any, name: str, request: Any, timeout_s: float = ANSWER_S) -> str:
        client = self.client.prepare(service_type, name)
        await self.until(client.service_is_ready, f"the service {name}: is its node there?", timeout_s)
        future = client.call_async(request)
        try:
            await self.until(future.done, f"an answer of {name}", timeout_s)
        finally:
            if not future.done():
                client.remove_pending_request(future)
        response = future.result()
        result = getattr(response, "result", None)  # of parameters that were set
        done, words = (result.successful, result.reason) if result else (response.success, response.message)
        if not done:
            raise Refused(words)
        return str(words)

    async def _trigger(self, name: str, timeout_s: float = ANSWER_S) -> str:
        return await self._call(Trigger, name, Trigger.Request(), timeout_s)

    async def _set(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node; those of the rig are in force when this returns."""
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in ros_parameters(values)])
        await self._call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
        if node == "rig":
            told = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
            knobs = self.record.knobs
            await self.until(
                lambda: all(self.record.knobs.get(name) == value for name, value in told.items())
                or self.record.knobs is not knobs, "rig/configuration", ECHO_S,
            )  # fmt: skip

    async def _parameter(self, name: str, words: str, value: Any) -> str:
        await self._set("rig", {name: value})
        return words.format(value)

    def _publish(self, topic: topics.Topic, value: Any) -> None:
        publisher = self.client.publisher(topic)
        if not publisher.get_subscription_count():
            raise Refused(f"nobody listens to {topic.name}: is the rig there?")
        publisher.publish(publisher.msg_type(data=value))

    async def _command(self, column: str, value: float) -> str:
        """Publish a command and wait for its row in shaker/applied, or for the refusal."""
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
        """Ramp the current to zero and latch it, whatever is known of the rig."""
        if gone := self.seen("rig").ended:
            raise Refused(f"there is no rig to stop, {gone}")
        asked_at = time.monotonic()

        def is_latched() -> bool:
            rig = self.seen("rig")
            return (rig.age_s or 0.0) < time.monotonic() - asked_at and bool(rig.figures.get("latched"))

        try:
            return await self._trigger("rig/stop")
        except Refused:  # where two rigs are in the namespace, the one that has not begun may answer first
            with contextlib.suppress(Refused):
                await self.until(is_latched, "the latch", TOLD_S)
                return "stopped, as the rig says"
            raise

    async def do_pluck(self, value: float) -> str:
        """Release the superior base from a displacement [m]."""
        await self._set("rig", {"pluck.displacement_m": value})
        return await self._trigger("rig/pluck")

    async def do_pause(self, value: bool) -> str:  # as the request has it
        """Let rig time stand still, or go on."""
        return await self._call(SetBool, "rig/pause", SetBool.Request(data=value))

    async def do_gap(self, value: float) -> str:
        """Set the gap of the rig and the label of the analysis together [m]; 0 takes the sphere away."""
        if value < 0.0:
            raise Refused(f"a gap is 0 (no sphere) or more, got {value * 1e3:g} mm")
        await self._set("rig", gap_values(value))
        return case_of(value) + await self._label(value)

    async def _label(self, gap_m: float) -> str:
        """Tell the analysis the gap; return what to add to an answer."""
        if not self.seen("analysis").lives:
            return "; there is no analysis to be told"
        await self._set("analysis", {"gap_m": gap_m})
        return ""

    async def do_load(self, value: str) -> str:
        """Put a ROS 2 parameter file in force: what differs from now, all of it or nothing."""
        wanted = to_flat(from_flat(RigConfig(), parameters_in(value)))
        present = to_flat(from_flat(RigConfig(), self.record.knobs))
        changes = {name: found for name, found in wanted.items() if found != present[name]}
        fixed = sorted(name for name, about, _ in fields() if about.read_only and name in changes)
        changes = {name: found for name, found in changes.items() if name not in fixed}
        if changes:
            await self._set("rig", changes)
        words = f"{len(changes)} settings changed" if changes else "these settings are in force already"
        if {"barriers.gap_m", "sphere.present"} & changes.keys():
            words += await self._label(float(str(wanted["barriers.gap_m"])) if wanted["sphere.present"] else 0.0)
        return f"{words}; fixed while the rig runs: {', '.join(fixed)}" if fixed else words

    async def do_fault(self, kind: str, channel: str, value: float, duration: float, rate: float) -> str:
        """Add a line to the planned faults: a new one begins now."""
        if kind not in FAULT_KINDS:
            raise Refused(f"there is no fault {kind!r}")
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
        """Start a stepped sine, and its node if it is not there."""
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
            except Refused:  # a node that has just begun has not heard of the rig yet, or of its scans
                if not attempts:
                    raise
            await asyncio.sleep(AGAIN_S)

    async def do_note(self, value: str) -> str:
        """Record a remark."""
        recorder = self.seen("recorder")
        if not value.strip():
            raise Refused("a remark has words")
        if not recorder.lives:
            raise Refused(f"there is no recorder to keep it{f', {recorder.gone}' if recorder.gone else ''}")
        self._publish(topics.NOTES, value)
        records = recorder.state not in (
            states.RecorderWord.INACTIVE,
            states.RecorderWord.FAILED,
            states.RecorderWord.IDLE,
        )
        return "noted" if records else "noted on the page; nothing is being recorded"

    async def do_record(self, value: bool) -> str:  # as the request has it
        """Begin or end a recording."""
        return await self._trigger("recorder/start" if value else "recorder/stop", 20.0)

    async def do_recover(self) -> str:
        """Recover the last recording."""
        recorder = self.seen("recorder")
        directory = recorder.figures.get("directory", "")
        if recorder.lives or not directory:
            raise Refused("the recorder is there: nothing needs to be recovered")
        target = Path(f"{directory}_recovered")
        report = await asyncio.to_thread(recover, directory, target)
        return f"recovered into {report.out.name if hasattr(report, 'out') else target.name}"

    async def do_restart(self) -> str:
        """Start again what has ended; a new rig is at rest, and the analysis is told its gap."""
        own = self._own
        if own is None:
            raise Refused("this lab has not started the rig: start it where it was started")
        ended = [name for name in own.processes.running if own.ended(name)]
        if not ended:
            raise Refused("every process runs")
        if "rig" in ended:
            self.record.knobs, self.record.configuration = {}, ""
        for name in ended:
            self._start(name)
        for name in ended:
            await self.until(lambda name=name: self.seen(name).lives, f"the node {name}", START_S)  # type: ignore[misc]
        knobs = await self.until(lambda: self.record.knobs, "rig/configuration", START_S)
        await self._label(knobs["barriers.gap_m"] if knobs["sphere.present"] else 0.0)
        return f"started again: {', '.join(ended)}"

    def _start(self, node: str) -> None:
        """Start a node of this lab; what its last process said is forgotten."""
        if self._own is None:
            raise Refused(f"there is no node {node}: start it beside the rig (ros2 run impact_rig {node}_node)")
        if node in self._own.processes.running:
            self._own.processes.stop(node)
        self.client.diagnostics.pop(node, None)
        self._own.start(node)
