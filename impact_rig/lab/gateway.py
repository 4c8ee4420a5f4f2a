# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a page can ask of a live rig: each action goes through the topics, services and parameters that anybody has.

Actions are coroutines of the lab's one event loop: whatever one waits for, STOP is sent meanwhile. An action belongs to
the activation of the rig that it was asked of; when that is gone, it is refused and never reaches a later one.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any  # messages and values of parameters

import attrs
from rcl_interfaces.srv import SetParametersAtomically
from std_srvs.srv import SetBool, Trigger

from impact_rig import states, topics
from impact_rig.client.client import Client
from impact_rig.client.parameters import ros_parameters
from impact_rig.errors import ImpactRigError
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.lab.protocol import Request
from impact_rig.lab.source import Answer
from impact_rig.lab.state import PLANNED, Seen, figure
from impact_rig.lab.subscriptions import Subscriptions
from impact_rig.nodes import messages
from impact_rig.nodes.guard import describe
from impact_rig.rig.config import RigConfig, fields, from_flat, parameters_in, to_flat
from impact_rig.runs import recover

ANSWER_S = 30.0
"""A busy machine answers late: the knob stays pending until then."""
ECHO_S = 5.0
"""How long a parameter that was taken may need to be told as in force."""
EXPIRES_S = 2.0
"""A rig that has been silent for so long is sent nothing, and what waits for it is refused."""
START_S = 60.0
AGAIN_S, ATTEMPTS = 0.5, 20
"""How often a node that has just been started is asked to begin."""
MOST_FAULTS = 16
SWEEPER = "stepped_sine"
FREE = frozenset({"stop", "sweep_stop", "note", "record", "restart", "recover", "choose"})
"""Requests that belong to no activation of the rig: those that make safe, and those about something else."""
PREPARED = ("rig/stop", "rig/reset", "rig/pluck", "rig/clear_trip", "recorder/start", "recorder/stop")
"""Services whose clients are made early: they have been discovered when they are used."""


class Refused(ImpactRigError):  # noqa: N818  # a fact about a request, not a mistake of ours
    """What was asked is not done; the message is for the page."""


class Own:
    """The nodes that the lab itself has started, or is to start.

    Args:
        processes: of `impact_rig.client`.
        parameters: of each node, by its name.
    """

    def __init__(self, processes: Any, parameters: Mapping[str, Mapping[str, Any]]) -> None:
        self.processes, self.parameters = processes, parameters
        self._starter = ThreadPoolExecutor(1, thread_name_prefix="lab-starter")
        self._starter.submit(time.monotonic).result()  # its thread is not as gentle as those begun later, nor are nodes

    def start(self, node: str) -> None:
        """Start a node."""
        self._starter.submit(self.processes.start, node, self.parameters.get(node, {})).result()

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
    """An action under way.

    Attributes:
        answer: told when it has ended.
        instance: of the rig it belongs to; None: to none.
        task: what does it.
        why: why it was broken off.
    """

    answer: Answer
    instance: str | None
    task: asyncio.Task[str]
    why: str = ""


class Gateway:
    """Does what pages ask for, in the event loop that creates it.

    Args:
        client: of the graph.
        heard: what the rig publishes.
        seen: returns what is known of a node.
        own: nodes that can be started; None: those of others are only looked at.
        choose: called with the name of another rig to look at.
    """

    def __init__(
        self, client: Client, heard: Subscriptions, seen: Callable[[str], Seen], own: Own | None,
        choose: Callable[[str], None],
    ) -> None:  # fmt: skip
        self._client, self._heard, self._seen, self._own, self._choose = client, heard, seen, own, choose
        self._running: set[_Running] = set()
        for name in PREPARED:
            client.prepare(Trigger, name)
        client.prepare(SetBool, "rig/pause")
        for node in ("rig", "analysis"):
            client.prepare(SetParametersAtomically, f"{node}/set_parameters_atomically")
        self._publishers = {
            topic.name: client.node.create_publisher(messages.class_of(topic), topic.name, messages.profile(topic.qos))
            for topic in (topics.FREQUENCY, topics.CURRENT, topics.NOTES)
        }

    def __len__(self) -> int:
        return len(self._running)

    def begin(self, request: Request, answer: Answer) -> None:
        """Begin an action; one for a rig that is gone is refused at once."""
        action = getattr(self, f"do_{request.do}", None)
        bound = request.do not in FREE
        rig = self._seen("rig")
        given = (rig.instance if request.rig is None else request.rig) if bound else None
        if action is None:
            answer(False, f"{request.do}: a live rig cannot do that")
        elif why := self._gone(given):
            answer(False, f"{why}: not sent")
        else:
            if request.do == "stop":
                self.end("the emergency stop came first", bound=True)
            task = asyncio.create_task(action(**request.values))
            running = _Running(answer, given, task)
            self._running.add(running)
            task.add_done_callback(lambda _task: self._done(running))

    def _done(self, running: _Running) -> None:
        """Tell the page how an action has ended."""
        self._running.discard(running)
        if running.task.cancelled():
            running.answer(False, running.why)
            return
        error = running.task.exception()
        if error is None:
            running.answer(True, running.task.result())
        else:  # of whatever kind: the others go on, and so does the page
            running.answer(False, str(error) if isinstance(error, ImpactRigError) else describe(error))

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
        rig = self._seen("rig")
        silent_s = math.inf if self._own is not None and "rig" in self._own.processes.running else EXPIRES_S
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

    async def _call(self, service_type: Any, name: str, request: Any, timeout_s: float = ANSWER_S) -> Any:
        client = self._client.prepare(service_type, name)
        await self.until(client.service_is_ready, f"the service {name}: is its node there?", timeout_s)
        future = client.call_async(request)
        try:
            await self.until(future.done, f"an answer of {name}", timeout_s)
        finally:
            if not future.done():
                client.remove_pending_request(future)
        return future.result()

    async def _trigger(self, name: str, timeout_s: float = ANSWER_S) -> str:
        response = await self._call(Trigger, name, Trigger.Request(), timeout_s)
        if not response.success:
            raise Refused(response.message)
        return str(response.message)

    async def _set(self, node: str, values: Mapping[str, Any]) -> None:
        """Set parameters of a node; those of the rig are in force when this returns."""
        request = SetParametersAtomically.Request(parameters=[one.to_parameter_msg() for one in ros_parameters(values)])
        response = await self._call(SetParametersAtomically, f"{node}/set_parameters_atomically", request)
        if not response.result.successful:
            raise Refused(response.result.reason)
        if node == "rig":
            told = {name: list(value) if isinstance(value, tuple) else value for name, value in values.items()}
            knobs = self._heard.knobs
            await self.until(
                lambda: all(self._heard.knobs.get(name) == value for name, value in told.items())
                or self._heard.knobs is not knobs, "rig/configuration", ECHO_S,
            )  # fmt: skip

    def _publish(self, topic: topics.Topic, value: Any) -> None:
        publisher = self._publishers[topic.name]
        if not publisher.get_subscription_count():
            raise Refused(f"nobody listens to {topic.name}: is the rig there?")
        publisher.publish(publisher.msg_type(data=value))

    # Drive

    async def do_frequency(self, value: float) -> str:
        """Command the frequency [Hz]."""
        return await self._command(topics.FREQUENCY, "frequency", value)

    async def do_current(self, value: float) -> str:
        """Command the current, peak [A]."""
        return await self._command(topics.CURRENT, "current", value)

    async def _command(self, topic: topics.Topic, column: str, value: float) -> str:
        """Publish a command and wait for its row in shaker/applied, or for the refusal."""
        heard, before, refused = self._heard, self._heard.changes, self._refusals(topic.name)
        self._publish(topic, value)

        def is_answered() -> bool:
            new = heard.applied[-(heard.changes - before) :] if heard.changes > before else []
            if any(row[column] == value for row in new):
                return True
            for reason, (count, words) in self._refusals(topic.name).items():
                if count > refused.get(reason, (0.0, ""))[0]:
                    raise Refused(words)
            return False

        await self.until(is_answered, f"{column} {value:g} in shaker/applied", ANSWER_S)
        return f"{column} {value:g}"

    def _refusals(self, topic: str) -> dict[str, tuple[float, str]]:
        figures = self._seen("rig").figures
        return {
            reason: (figure(figures.get(f"refused.{reason}")) or 0.0, figures.get(f"last_refused.{reason}", ""))
            for reason in (topic, "inactive")
        }

    async def do_stop(self) -> str:
        """Ramp the current to zero and latch it, whatever is known of the rig."""
        if gone := self._seen("rig").ended:
            raise Refused(f"there is no rig to stop, {gone}")
        return await self._trigger("rig/stop")

    async def do_clear_trip(self) -> str:
        """Release the latch."""
        return await self._trigger("rig/clear_trip")

    async def do_reset(self) -> str:
        """Begin again at scan 0."""
        return await self._trigger("rig/reset")

    async def do_pluck(self, value: float) -> str:
        """Release the superior base from a displacement [m]."""
        await self._set("rig", {"pluck.displacement_m": value})
        return await self._trigger("rig/pluck")

    async def do_pause(self, value: bool) -> str:  # as the request has it
        """Let rig time stand still, or go on."""
        response = await self._call(SetBool, "rig/pause", SetBool.Request(data=value))
        if not response.success:
            raise Refused(response.message)
        return str(response.message)

    # Parameters

    async def do_gap(self, value: float) -> str:
        """Set the gap of the rig and the label of the analysis together [m]; 0 takes the sphere away."""
        if value < 0.0:
            raise Refused(f"a gap is 0 (no sphere) or more, got {value * 1e3:g} mm")
        await self._set(
            "rig", {"sphere.present": True, "barriers.gap_m": value} if value else {"sphere.present": False}
        )
        words = f"gap {value * 1e3:g} mm" if value else "no sphere"
        return words + await self._label(value)

    async def do_present(self, value: bool) -> str:  # as the request has it
        """Put the sphere in, or take it away."""
        return await self.do_gap(float(self._heard.knobs.get("barriers.gap_m", math.nan)) if value else 0.0)

    async def _label(self, gap_m: float) -> str:
        """Tell the analysis the gap; return what to add to an answer."""
        if not self._seen("analysis").lives:
            return "; there is no analysis to be told"
        await self._set("analysis", {"gap_m": gap_m})
        return ""

    async def do_start(self, value: str) -> str:
        """Set where the sphere starts."""
        await self._set("rig", {"sphere.start": value})
        return f"sphere at {value}"

    async def do_law(self, value: str) -> str:
        """Set the contact law."""
        await self._set("rig", {"contact.law": value})
        return f"law {value}"

    async def do_restitution(self, value: float) -> str:
        """Set the restitution."""
        await self._set("rig", {"contact.restitution": value})
        return f"restitution {value:g}"

    async def do_load(self, value: str) -> str:
        """Put a ROS 2 parameter file in force: what differs from now, all of it or nothing."""
        wanted = to_flat(from_flat(RigConfig(), parameters_in(value)))
        present = to_flat(from_flat(RigConfig(), self._heard.knobs))
        changes = {name: found for name, found in wanted.items() if found != present[name]}
        fixed = sorted(name for name, about, _ in fields() if about.read_only and name in changes)
        changes = {name: found if found != () else ("",) for name, found in changes.items() if name not in fixed}
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
        words = [kind, f"channel={channel}"] if channel else [kind]
        words += [f"duration_s={duration:g}", f"value={value!r}", f"rate_hz={rate:g}"]
        lines = [line for line in self._heard.knobs.get(PLANNED) or () if line][-(MOST_FAULTS - 1) :]
        await self._set("rig", {PLANNED: [*lines, " ".join(words)]})
        return f"fault: {' '.join(words)}"

    async def do_clear_faults(self) -> str:
        """End every fault."""
        await self._set("rig", {PLANNED: [""]})
        return "faults cleared"

    # Other nodes

    async def do_sweep(self, frequencies: tuple[float, ...], direction: str, hold: str, target: float) -> str:
        """Start a stepped sine, and its node if it is not there."""
        was_there = self._seen(SWEEPER).lives
        if not was_there:
            self._start(SWEEPER)
            await self.until(lambda: self._seen(SWEEPER).lives, f"the node {SWEEPER}", START_S)
        current = self._heard.applied[-1]["current"] if self._heard.applied else 0.0
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

    async def do_sweep_stop(self) -> str:
        """End the stepped sine."""
        return await self._trigger(f"{SWEEPER}/stop")

    async def do_note(self, value: str) -> str:
        """Record a remark."""
        recorder = self._seen("recorder")
        if not value.strip():
            raise Refused("a remark has words")
        if not recorder.lives:
            raise Refused(f"there is no recorder to keep it{f', {recorder.gone}' if recorder.gone else ''}")
        self._publish(topics.NOTES, value)
        records = recorder.state not in (states.Recorder.INACTIVE, states.Recorder.FAILED, states.Recorder.IDLE)
        return "noted" if records else "noted on the page; nothing is being recorded"

    async def do_record(self, value: bool) -> str:  # as the request has it
        """Begin or end a recording."""
        return await self._trigger("recorder/start" if value else "recorder/stop", 20.0)

    async def do_recover(self) -> str:
        """Recover the last recording."""
        recorder = self._seen("recorder")
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
            self._heard.knobs, self._heard.configuration = {}, ""
        for name in ended:
            self._start(name)
        for name in ended:
            await self.until(lambda name=name: self._seen(name).lives, f"the node {name}", START_S)  # type: ignore[misc]
        knobs = await self.until(lambda: self._heard.knobs, "rig/configuration", START_S)
        await self._label(knobs["barriers.gap_m"] if knobs["sphere.present"] else 0.0)
        return f"started again: {', '.join(ended)}"

    def _start(self, node: str) -> None:
        """Start a node of this lab; what its last process said is forgotten."""
        if self._own is None:
            raise Refused(f"there is no node {node}: start it beside the rig (ros2 run impact_rig {node}_node)")
        if node in self._own.processes.running:
            self._own.processes.stop(node)
        self._client.diagnostics.pop(node, None)
        self._own.start(node)

    async def do_choose(self, value: str) -> str:
        """Look at another rig."""
        self._choose(value)
        return f"looking at {value}"
