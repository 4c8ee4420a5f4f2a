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
"""Connection of the lab to one running rig over ROS: subscriptions to its topics, and the actions that pages request.

Actions are coroutines of one event loop, so STOP is sent even while another action waits. An action belongs to the
activation of the rig for which it was requested. If that rig is gone, the action is rejected.

Blocks of scans and joint states arrive hundreds of times per second. `take` fetches them in batches, and only while a
page is open. If a queue overflows between two batches, only pictures are lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import functools
import itertools
import time
from collections.abc import Awaitable, Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
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
from impact_rig_lab.theory import KIND

ANSWER_S = 30.0  # time limit of an answer: a busy machine answers late, and the control stays pending until then
TOLD_S = 1.5  # time limit within which the diagnostics of the rig must show the effect of an action
ECHO_S = 5.0  # time limit within which `rig/configuration` must show an accepted parameter
START_S = 60.0  # time limit within which a started node must report for the first time
AGAIN_S, ATTEMPTS = 0.5, 20  # interval and number of requests to a node that has just been started
MOST_FAULTS = 16  # largest number of planned faults; the oldest are dropped for a new one
SWEEPER = "stepped_sine"  # name of the node that makes sweeps
PROGRAMS = {SWEEPER: "impact_rig_studies"}
"""Python packages that contain the program of a node, for nodes that are not part of `impact_rig`."""
FREE = frozenset({"stop", "sweep_stop", "note", "record", "restart", "recover"})
"""Requests that are run for any rig, even if the rig has restarted since the page showed it.

They make a rig safe, or do not change it.
"""
COMMANDS = {"frequency": topics.FREQUENCY, "current": topics.CURRENT}
"""Topics of the commands; the request of a command is also the column of `shaker/applied` that confirms it."""
TRIGGERS = {"reset": "rig/reset", "clear_trip": "rig/clear_trip", "sweep_stop": f"{SWEEPER}/stop"}
"""Requests that only call a service without arguments, and the service of each."""
PARAMETERS = {
    "start": ("sphere.start", "sphere at {}"),
    "law": ("contact.law", "law {}"),
    "restitution": ("contact.restitution", "restitution {:g}"),
}
"""Requests that set one parameter of the rig: its name, and the text of the answer on success."""
PREPARED = (*TRIGGERS.values(), f"{SWEEPER}/start", "rig/stop", "rig/pluck", "recorder/start", "recorder/stop")
"""Services whose clients are created at the start, because ROS needs time to discover a service."""
KEPT = (
    topics.INFO, topics.APPLIED, topics.JOURNAL, topics.FAULTS, topics.TRANSMISSIBILITY_TABLE, topics.CONFIGURATION,
    topics.NOTES,
)  # fmt: skip
"""Topics with rare messages, none of which may be lost; the lab subscribes to them all the time."""
SCANS = (topics.STREAM, topics.WAVEFORM, topics.SCAN, topics.IMPACTS)
"""Topics that are drawn as scans, in the order of processing: commanded samples before the scans they act on."""
TRUTH = (topics.JOINT_STATES, topics.IMPACTS_TRUTH)  # topics that are drawn as true motion
MOST_PER_LOOK = 300  # largest number of messages processed per topic at once, so that pictures are drawn in between
PICTURES = QoSProfile(
    history=HistoryPolicy.KEEP_LAST,
    depth=256,
    reliability=ReliabilityPolicy.BEST_EFFORT,
    durability=DurabilityPolicy.VOLATILE,
)


class Refused(ImpactRigError):  # noqa: N818  # a property of a request, not an internal error
    """Error of a request of a page that was rejected or has failed; the page shows the message to the user."""


class OwnedProcesses:
    """Node processes that the lab starts itself, and restarts on request of a page.

    Args:
        processes: the processes (`Processes`).
        parameters: ROS parameters of each node at every start, by node and name.
    """

    def __init__(self, processes: Any, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        self.processes, self.parameters = processes, parameters
        self._starts: dict[str, Future[None]] = {}  # the last start of each node
        self._starter = ThreadPoolExecutor(1, thread_name_prefix="lab-starter")
        # the thread that starts nodes does not have the lower priority of later threads, so nodes do not have it either
        self._starter.submit(time.monotonic).result()

    def start(self, node: str) -> Future[None]:
        """Start or restart the process of a node with its parameters, without waiting for it.

        If a start of this node is in progress, no second one begins.

        Args:
            node: name of the node, such as "rig".

        Returns:
            Future that is done when the new process is created. The end of a previous one may take 20 s.
        """
        if node not in self._starts or self._starts[node].done():
            self._starts[node] = self._starter.submit(self._start, node)
        return self._starts[node]

    def _start(self, node: str) -> None:
        if node in self.processes.running:
            self.processes.stop(node)
        self.processes.start(PROGRAMS.get(node, node), self.parameters.get(node, {}), name=node)

    def close(self) -> None:
        """Wait for the requested starts of nodes, and end the thread for them; running nodes continue."""
        self._starter.shutdown()

    def ended(self, node: str) -> str:
        """Return how the process of a node has ended, as text.

        The text is empty if the process is running, or if the lab did not start it.
        """
        process = self.processes.running.get(node)
        code = None if process is None else process.exit_code
        return "" if code is None else f"its process ended with code {code}"


@attrs.define(eq=False)
class _Running:
    """Request of a page that is being carried out."""

    answer: Answer  # function that reports the result to the page
    instance: str | None  # activation of the rig for which it was requested; None if it is one of `FREE`
    task: asyncio.Task[str]  # task that runs the action
    why: str = ""  # reason for the page if the task is cancelled


class Gateway:
    """Connection of the lab to one rig: it passes the rig's messages to `record`, and runs the actions of pages.

    A gateway may be used only in the event loop in which it was created.

    Args:
        client: ROS client in the namespace of the rig.
        record: state of the rig, which receives the messages.
        own: nodes that the lab starts itself; None means that no node can be started.
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
            "lab_view",
            namespace=client.node.get_namespace(),
            context=client.context,
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._samples: dict[topics.Topic, Any] = {}

    async def close(self, why: str) -> None:
        """Cancel all actions in progress, and unsubscribe from scans and motion; `client` remains open.

        Args:
            why: reason that the pages of these actions receive.
        """
        self.end(why)
        await asyncio.sleep(0)
        self._view.destroy_node()

    # Subscriptions

    def listen(self, scans: bool, motion: bool) -> None:
        """Subscribe to the topics that are drawn, or unsubscribe from them.

        Args:
            scans: whether to receive scans, commanded samples and detected impacts.
            motion: whether to receive the true motion as well; this requires `scans`. A change from true to false also
                discards the motion received so far.
        """
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
        """Pass the scans and motion received since the last call to the record; return whether there were any.

        A call processes at most `MOST_PER_LOOK` messages per topic. Further messages remain for the next call. While
        the stamp of scan 0 of a new rig is unknown, messages are dropped, but count as received.
        """
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
        """Return the last report of a node in the diagnostics, with its age, and how its process has ended.

        If the node has not reported yet, the age is None.
        """
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
        """Start the action that a page requests, or reject it at once if it is unknown or its rig is gone.

        An emergency stop cancels all other actions in progress except those in `FREE`.

        Args:
            request: the request.
            answer: function that reports the result to the page, at once or when the action has ended.
        """
        action = self._actions.get(request.do)
        instance = None
        if request.do not in FREE:
            instance = self.seen("rig").instance if request.rig is None else request.rig
        if action is None:
            answer(False, f"{request.do}: a live rig cannot do that, only a recorded run")
        elif why := self._gone(instance):
            answer(False, f"{why}; the request was not sent")
        else:
            if request.do == "stop":
                self.end("cancelled, because an emergency stop was requested", bound=True)
            running = _Running(answer, instance, asyncio.ensure_future(action(**request.values)))
            self._running.add(running)
            running.task.add_done_callback(lambda _task: self._done(running))

    def _done(self, running: _Running) -> None:
        """Report the result of an ended action to its page: success, failure or reason of the cancellation."""
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
        """Return whether any action of a page is in progress."""
        return bool(self._running)

    def watch(self) -> None:
        """Cancel the actions in progress whose rig is gone, so that their pages receive the reason as the answer."""
        for running in list(self._running):
            if why := self._gone(running.instance):
                self._break_off(running, f"{why}: the request was not confirmed")

    def end(self, why: str, *, bound: bool = False) -> None:
        """Cancel actions in progress.

        Args:
            why: reason that their pages receive.
            bound: whether to cancel only the actions that were requested for the present rig; those that are allowed
                for any rig (`FREE`), such as a stop, then continue.
        """
        for running in list(self._running):
            if not bound or running.instance is not None:
                self._break_off(running, why)

    def _break_off(self, running: _Running, why: str) -> None:
        running.why = why
        running.task.cancel()

    def _gone(self, instance: str | None) -> str:
        """Return the reason why the rig of an action is gone; empty if the rig is there.

        Args:
            instance: identifier of the activation of the rig for which the action was requested; None means any rig,
                and the result is empty.
        """
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
        """Wait until a condition is fulfilled, and return its value.

        Args:
            check: condition, evaluated once per turn of the event loop; any true value fulfils it.
            what: what is waited for, for the message.
            timeout_s: longest wait [s], by the clock of this machine.

        Raises:
            Refused: the condition is not fulfilled in time; the message names `what`.
        """
        deadline = time.monotonic() + timeout_s
        while not (found := check()):
            if time.monotonic() > deadline:
                raise Refused(f"timeout after {timeout_s:g} s of wall time: waiting for {what}")
            await asyncio.sleep(0)
        return found

    async def _call(self, service_type: Any, name: str, request: Any, timeout_s: float = ANSWER_S) -> str:
        client = self.client.prepare(service_type, name)
        await self.until(client.service_is_ready, f"the service {name}; is its node running?", timeout_s)
        with ServiceCall(client, request) as call:
            what = f"an answer of {name}; repeat the request if it had no effect"
            response = await self.until(call.response, what, timeout_s)
        result = getattr(response, "result", None)  # for set parameters
        done, words = (result.successful, result.reason) if result else (response.success, response.message)
        if not done:
            raise Refused(words)
        return str(words)

    async def _trigger(self, name: str, timeout_s: float = ANSWER_S) -> str:
        return await self._call(Trigger, name, Trigger.Request(), timeout_s)

    async def _set(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node, all or none, and wait until the node has accepted them.

        For the rig, wait also until `rig/configuration` shows these values or another new configuration.

        Raises:
            Refused: the node rejects the parameters, or its answer or the configuration does not arrive in time.
        """
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in ros_parameters(values)])
        await self._call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
        if node == "rig":
            target = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
            knobs = self.record.knobs
            await self.until(
                lambda: (
                    all(self.record.knobs.get(name) == value for name, value in target.items())
                    or self.record.knobs is not knobs
                ),
                "the rig to publish the accepted values on rig/configuration; repeat the request",
                ECHO_S,
            )

    async def _parameter(self, name: str, words: str, value: Any) -> str:
        await self._set("rig", {name: value})
        return words.format(value)

    def _publish(self, topic: topics.Topic, value: Any) -> None:
        publisher = self.client.publisher(topic)
        if not publisher.get_subscription_count():
            raise Refused(f"no subscriber on {topic.name}; is the rig running?")
        publisher.publish(publisher.msg_type(data=value))

    async def _command(self, column: str, value: float) -> str:
        """Publish a command, and wait until the rig has accepted it.

        Args:
            column: name of the request, and of the column of `shaker/applied` that confirms it: frequency or current.
            value: commanded value [Hz; or A, m or V by `drive.kind`].

        Returns:
            Answer for the page.

        Raises:
            Refused: no node subscribes to the command, or the rig rejects it or does not confirm it in time.
        """
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

        what = f"the rig to publish {column} {value:g} on shaker/applied; repeat the request"
        await self.until(is_answered, what, ANSWER_S)
        return f"{column} {value:g}"

    # The rig

    async def do_stop(self) -> str:
        """Request an emergency stop: the rig ramps its drive to zero and latches its shaker, in any state.

        Returns:
            Answer for the page, when the rig has confirmed it.

        Raises:
            Refused: the rig is gone, or does not confirm the stop in time.
        """
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
        """Pluck the rig: the rig locks the inferior base, and releases the superior base from a displacement [m].

        The inferior base stays locked, and the rig rejects commands, until the next reset.

        Raises:
            Refused: the rig rejects the displacement or the pluck, or does not answer in time.
        """
        await self._set("rig", {"pluck.displacement_m": value})
        return await self._trigger("rig/pluck")

    async def do_pause(self, value: bool) -> str:  # value of the request
        """Pause rig time if `value` is true, otherwise resume it."""
        return await self._call(SetBool, "rig/pause", SetBool.Request(data=value))

    async def do_gap(self, value: float) -> str:
        """Set the gap of the rig [m], and the same gap as label of the analysis; 0 removes the sphere.

        If no analysis is running, the answer says so.

        Raises:
            Refused: the gap is negative, the rig or the analysis rejects it, or one of them does not answer in time. If
                it is the analysis, the rig has the new gap already.
        """
        if value < 0.0:
            raise Refused(f"a gap must be > 0 mm, or 0 for a rig without the sphere, got {value * 1e3:g} mm")
        await self._set("rig", gap_values(value))
        return case_of(value) + await self._label(value)

    async def _label(self, gap_m: float) -> str:
        """Set the gap [m] with which the analysis labels its measurements, and return an addition to the answer.

        The addition is empty, or says that no analysis is running.
        """
        if not self.seen("analysis").lives:
            return "; no analysis is running, so that no measurement is labelled with this gap"
        await self._set("analysis", {"gap_m": gap_m})
        return ""

    def _published_knobs(self) -> dict[str, Any]:
        """Return the parameters of the active configuration by name.

        Raises:
            Refused: the rig has not published its configuration yet, so that changes cannot be compared with it.
        """
        if not self.record.knobs:
            raise Refused(
                "the rig has not published its configuration yet: repeat this when the page shows its settings"
            )
        return self.record.knobs

    async def do_load(self, value: str) -> str:
        """Apply a configuration: set all parameters of the rig that differ from it, all at once or none.

        A parameter that is missing in the file gets its default value. Parameters that cannot change while the rig runs
        are left out, and named in the answer. A changed gap also becomes the label of the analysis.

        Args:
            value: content of a ROS 2 parameter file.

        Raises:
            ImpactRigError: the file is invalid, or the rig rejects the changes.
        """
        wanted = to_flat(from_flat(RigConfig(), parameters_in(value)))
        present = to_flat(from_flat(RigConfig(), self._published_knobs()))
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
        """Start a simulated instrument fault now, by adding it to the planned faults of the rig.

        Of more than `MOST_FAULTS` planned faults, the oldest are dropped.

        Args:
            kind: kind of fault, a key of `FAULT_KINDS`.
            channel: channel that it affects; empty for the whole board.
            value: size of the fault, as `FAULT_KINDS` defines it for the kind; ignored if the kind has no size.
            duration: duration of the fault [s of rig time]; 0 means until the faults are cleared.
            rate: mean rate of the fault [Hz]; ignored if the kind has none.

        Raises:
            Refused: the kind is unknown, or the rig rejects the fault.
        """
        if kind not in FAULT_KINDS:
            raise Refused(f"unknown kind of fault {kind!r}, known: {', '.join(FAULT_KINDS)}")
        added = fault_line(kind, channel, duration_s=duration, value=value, rate_hz=rate)
        lines = [line for line in self._published_knobs().get(PLANNED) or () if line][-(MOST_FAULTS - 1) :]
        await self._set("rig", {PLANNED: [*lines, added]})
        return f"fault: {added}"

    async def do_clear_faults(self) -> str:
        """End all simulated instrument faults that are active, and cancel those that are planned.

        Raises:
            Refused: the rig does not answer in time.
        """
        await self._set("rig", {PLANNED: [""]})
        return "faults cleared"

    # Other nodes

    async def do_sweep(self, frequencies: tuple[float, ...], direction: str, hold: str, target: float) -> str:
        """Start a stepped sine or a phase lock on the rig with the present amplitude of its drive.

        If the amplitude of a current drive is 0 or unknown, the sweep uses 0.52 A. If the stepped-sine node is absent,
        a lab that has started the rig starts this node first.

        Args:
            frequencies: frequencies of the points [Hz], in any order. A phase lock uses only the lowest (the highest if
                `direction` is down), at which its search begins.
            direction: order of the points: up, down or up_down.
            hold: quantity that is kept constant: command, current, base or superior; phase means a phase lock.
            target: peak amplitude to which current, base or superior is controlled [A or m]; ignored for command and
                phase.

        Raises:
            Refused: the node is absent and cannot be started, or rejects the plan or the start; or the rig is at rest
                and is not driven by a current.
        """
        amplitude = (self.record.drive or {"current": 0.0})["current"]
        if not amplitude and (kind := self._published_knobs()[KIND]) != "current":
            raise Refused(
                f"{KIND} is {kind}, for which a sweep has no default amplitude: set the amplitude "
                "first, then start the sweep"
            )
        was_there = self.seen(SWEEPER).lives
        if not was_there:
            await self._start(SWEEPER)
            await self.until(lambda: self.seen(SWEEPER).lives, f"the node {SWEEPER}", START_S)
        plan = {
            "frequencies_hz": list(frequencies),
            "direction": direction,
            "current_a": amplitude or 0.52,
            "hold": hold,
            **({"target": target} if hold in ("current", "base", "superior") else {}),
        }
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
        """Publish a remark of the operator, so that it is recorded with the run and shown on the pages.

        If the recorder is not recording, the remark is only shown, and the answer says so.

        Raises:
            Refused: the remark is empty, or no recorder is running, so that the remark would be lost.
        """
        recorder = self.seen("recorder")
        if not value.strip():
            raise Refused("a remark must not be empty")
        if not recorder.lives:
            raise Refused(
                f"no recorder is running{f' ({recorder.gone})' if recorder.gone else ''}, so the remark would be lost: "
                "start the recorder, then repeat the remark"
            )
        self._publish(topics.NOTES, value)
        records = recorder.state not in (
            states.RecorderWord.INACTIVE,
            states.RecorderWord.FAILED,
            states.RecorderWord.IDLE,
        )
        return "remark recorded" if records else "remark shown on the page, but no recording is running"

    async def do_record(self, value: bool) -> str:  # value of the request
        """Start a new recording if `value` is true, otherwise stop the present one, if there is one.

        Raises:
            Refused: a recording is in progress or requested already, it cannot be written, or the recorder does not
                answer in time.
        """
        return await self._trigger("recorder/start" if value else "recorder/stop", 20.0)

    async def do_recover(self) -> str:
        """Recover the last recording of a recorder that has died, into a directory of its own next to the recording.

        Raises:
            Refused: the recorder has not died, or no recording is known.
            RecordingError: nothing can be recovered, or the directory contains a recording already.
        """
        recorder = self.seen("recorder")
        directory = recorder.figures.get("directory", "")
        if recorder.lives:
            raise Refused("the recorder has not died, so its recording needs no recovery")
        if not directory:
            raise Refused(
                "the recorder has reported no recording, so there is nothing to recover here; recover an older one "
                "with impact-rig recover"
            )
        target = Path(f"{directory}_recovered")
        await asyncio.to_thread(recover, directory, target)
        return f"recovered into {target.name}"

    async def do_restart(self) -> str:
        """Restart the nodes of this lab whose processes have ended, and label the analysis with the gap of the rig.

        A restarted rig is at rest and has its initial configuration. A restarted recorder starts a new recording,
        unless the lab was started with `--no-record`.

        Raises:
            Refused: the lab did not start the rig, no process has ended, or a node does not report within `START_S`.
        """
        own = self._own
        if own is None:
            raise Refused(
                "this lab did not start the rig, so it cannot restart it: restart the rig where it was started"
            )
        ended = [name for name in list(own.processes.running) if own.ended(name)]
        if not ended:
            raise Refused(
                "all processes of this lab are running, so there is none to restart; a reset brings the rig to rest"
            )
        if "rig" in ended:
            self.record.knobs, self.record.configuration = {}, ""
        for name in ended:
            await self._start(name)
        for name in ended:
            await self.until(lambda name=name: self.seen(name).lives, f"the node {name}", START_S)  # type: ignore[misc]
        knobs = await self.until(lambda: self.record.knobs, "the rig to publish rig/configuration", START_S)
        await self._label(knobs["barriers.gap_m"] if knobs["sphere.present"] else 0.0)
        return f"restarted: {', '.join(ended)}"

    async def _start(self, node: str) -> None:
        """Start or restart a node of this lab, and wait until the new process is created.

        The last report of its previous process is discarded. If the action is cancelled, the node is started anyway.

        Raises:
            Refused: this lab does not start nodes.
        """
        if self._own is None:
            raise Refused(
                f"the node {node} is not running, and this lab starts no nodes: start it in the rig's namespace (ros2 "
                f"run impact_rig {node}_node --ros-args -r __ns:={self.client.node.get_namespace()})"
            )
        await asyncio.shield(asyncio.wrap_future(self._own.start(node)))
        self.client.diagnostics.pop(node, None)
