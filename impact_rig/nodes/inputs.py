# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a rig is told: the commands of frequency and current, its services, pauses and steps."""

from __future__ import annotations

import time
from collections.abc import Callable

from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from impact_rig import topics
from impact_rig.blocks import Table
from impact_rig.errors import CommandError
from impact_rig.nodes.managed import Answer, DeferredService, Done
from impact_rig.nodes.session import Session
from impact_rig.rig import Rig
from impact_rig.simtime import NS_PER_S

IDLE_S = 1.0
"""Who steps in turns asks more often than this: a rig between two steps of a series is not paused."""


class Steps:
    """The service ~/step and the blocks it still owes, answered when the last of them is out and acknowledged.

    Args:
        session: of the rig.
        work: called once a step is asked for.
    """

    def __init__(self, session: Session, work: Callable[[], None]) -> None:
        self._session = session
        self._service = DeferredService(session.node, Trigger, "~/step", self._on_step, work)
        self._asked_at = -IDLE_S
        self.left = 0
        """Blocks not published yet."""

    @property
    def waiting(self) -> bool:
        """Whether somebody waits for an answer."""
        return bool(self._service.waiting)

    @property
    def is_idle(self) -> bool:
        """Whether nothing is owed, and for a while nobody has asked for a step."""
        return self.left <= 0 and time.monotonic() - self._asked_at > IDLE_S

    def take(self, steps: int, done: Done) -> None:
        """Take so many steps, as a request does that is not refused; `done` is called when that one is answered."""
        self._owe(steps)
        self._service.wait(done)

    def refuse(self, message: str) -> None:
        """Answer what waits with a refusal; what is left is dropped."""
        self.left = 0
        self._service.reply(False, message)

    def refuse_without_peers(self) -> None:
        """Refuse when a peer has not been there for too long."""
        readers, patience_s = self._session.readers, self._session.node.settings.time.peer_timeout_s
        if readers is None or not self._service.waiting or not readers.overdue(patience_s):
            return
        if time.monotonic() - self._asked_at > patience_s:
            self.refuse(f"peer {', '.join(readers.missing())} is not there")

    def answer(self) -> None:
        """Answer when all is out and acknowledged, with the rig time, or when a peer has fallen silent."""
        if not self._service.waiting:
            return
        silent = self._session.window.silent()
        if self._session.starving():
            self.refuse(f"{self._session.controllers()} sends no samples on {topics.WAVEFORM.name}")
        elif silent:
            self.refuse(f"peer {', '.join(silent)} does not acknowledge")
        elif self.left <= 0 and self._session.window.outstanding() == 0:
            self._service.reply(True, f"at {self._session.running().next_block_ns / NS_PER_S:.9f} s")

    def _on_step(self, _request: Trigger.Request) -> Answer | None:
        mode = self._session.node.settings.time.mode
        self._session.running()
        if mode != "stepped" and not self._session.paused:
            return False, f"the rig runs in {mode}: pause it first (~/pause), or set time.mode to stepped"
        self._owe(1)
        return None

    def _owe(self, steps: int) -> None:
        self.left += steps * self._session.node.settings.step.blocks
        self._asked_at = time.monotonic()


class Pause:
    """The service ~/pause: answered when the peers have processed all that was out.

    Args:
        session: of the rig, which is paused or not.
        steps: of which those that wait are refused when the rig goes on.
        go_on: called when the rig has been told to go on.
    """

    def __init__(self, session: Session, steps: Steps, go_on: Callable[[], None]) -> None:
        self._session, self._steps = session, steps
        self._go_on = go_on
        self._service = DeferredService(session.node, SetBool, "~/pause", self._on_request, self.answer)
        self.blocks_steps = False
        """Whether rig time stands still altogether: since the pause no step has been asked for."""

    def end(self, message: str) -> None:
        """Be paused no more, because there is no rig any more; whoever waits is told why."""
        self._session.paused = self.blocks_steps = False
        self._service.reply(False, message)

    def answer(self) -> None:
        """Answer when all that is out has been processed, or will not be."""
        window = self._session.window
        if self._service.waiting and (window.outstanding() == 0 or window.silent()):
            self._service.reply(True, "paused")

    def begin(self, done: Done) -> None:
        """Pause the rig there is; `done` is called when the peers have processed all that was out."""
        self._session.paused = self.blocks_steps = True
        self._service.wait(done)
        self._session.node.report_change()

    def resume(self) -> str:
        """Go on, without what a silent peer has missed; returns the answer."""
        session = self._session
        starving = session.starving()
        if session.paused or session.window.silent() or starving:  # else it was running: nothing is given up
            session.paused = self.blocks_steps = False
            self._service.reply(False, "told to go on")
            if session.node.settings.time.mode != "stepped":
                self._steps.refuse("told to go on")
            session.window.forgive()
            if starving:
                stream = session.running().stream
                session.running().feed(stream.played + stream.buffered(), ())
            session.pacer.rebase(session.running().next_block_ns - session.base_ns)
            self._go_on()
            session.node.report_change()
        return "running"

    def _on_request(self, request: SetBool.Request) -> Answer | None:
        self._session.running()
        if not request.data:
            return True, self.resume()
        self._session.paused = self.blocks_steps = True
        self._session.node.report_change()
        return None


class Inputs:
    """The inputs of a rig, and what each of them does to it; what it refuses is told and counted.

    Args:
        session: of the rig.
        work: called once a step is asked for.
        go_on: called when a paused rig has been told to go on.
        work_on: called when samples have come that a rig ahead of time may have waited for.
    """

    def __init__(
        self, session: Session, work: Callable[[], None], go_on: Callable[[], None], work_on: Callable[[], None]
    ) -> None:
        self.session = session
        node = session.node
        self._commands = [
            node.subscribe(topics.FREQUENCY, self._on_frequency),
            node.subscribe(topics.CURRENT, self._on_current),
            node.subscribe_table(topics.WAVEFORM, self._on_waveform),
        ]
        self.steps = Steps(session, work)
        self.pause = Pause(session, self.steps, go_on)
        self._go_on_with_samples = work_on
        node.service(Trigger, "~/reset", self._on_reset)
        node.service(Trigger, "~/stop", self._on_stop)
        node.service(Trigger, "~/clear_trip", self._on_clear_trip)
        node.service(Trigger, "~/pluck", self._on_pluck)

    def drop_commands(self) -> None:
        """Refuse commands that came and were not looked at yet: they were given to no rig, or to the one before."""
        for subscription in self._commands:
            with subscription.handle:
                while subscription.handle.take_message(subscription.msg_type, False) is not None:
                    self.session.node.refuse("inactive", f"{subscription.topic_name}: it came before this rig began")

    def end(self, message: str) -> None:
        """Tell whoever waits that there is no rig any more, and why."""
        self.steps.refuse(message)
        self.pause.end(message)

    def reset(self) -> str:
        """Begin again from scan 0; returns the answer. CommandError: it cannot be now."""
        session = self.session
        session.running().reset()
        session.flush()
        session.counts.faults.clear()  # planned ones begin anew, and say so
        session.publish_configuration()
        session.node.get_logger().info("reset: scan 0")
        return "reset: scan 0"

    def _on_frequency(self, message: Float64) -> None:
        self._accept(topics.FREQUENCY.name, frequency_hz=message.data)

    def _on_current(self, message: Float64) -> None:
        self._accept(topics.CURRENT.name, current_a=message.data)

    def _on_waveform(self, table: Table) -> None:
        session = self.session
        try:
            rig = session.running()
        except CommandError as error:
            session.node.refuse("inactive", f"{topics.WAVEFORM.name}: {error}")
            return
        try:
            rig.feed(rig.sample_at(table.stamp_ns), table.rows["value"])
        finally:
            if not session.is_realtime:  # in real time the next block says it
                session.publishers.stream(rig)
        if not session.is_realtime:
            self._go_on_with_samples()

    def _accept(self, name: str, **values: float) -> None:
        node = self.session.node
        try:
            rig = self.session.running()
        except CommandError as error:
            node.refuse("inactive", f"{name}: {error}")
            return
        was_driven = rig.amplitude != 0.0
        try:
            rig.accept(**values)
        except CommandError as error:
            node.refuse(name, str(error))
            return
        told = ", ".join(f"{key} = {value:g}" for key, value in values.items())
        node.get_logger().debug(f"accepted: {told}")
        self.session.flush()
        if was_driven != (rig.amplitude != 0.0):
            node.report_change()

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, self.reset()
        return response

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._act(response, Rig.stop, "shaker ramps to zero and stays latched until ~/clear_trip")

    def _on_clear_trip(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        return self._act(response, Rig.clear_trip, "latch released; current stays zero until the next command")

    def _on_pluck(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        displacement_m = self.session.node.settings.pluck.displacement_m
        return self._act(
            response, lambda rig: rig.pluck(displacement_m), "base locked, structure released; ~/reset unlocks"
        )

    def _act(self, response: Trigger.Response, action: Callable[[Rig], None], done: str) -> Trigger.Response:
        action(self.session.running())
        self.session.flush()
        response.success, response.message = True, done
        return response
