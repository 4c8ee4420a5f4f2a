# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig as a lifecycle node: publishes what `Rig` measures when it is due and passes inputs on; decides nothing."""

from __future__ import annotations

import functools
import time
from typing import Any  # rclpy messages

from impact_rig import states, topics
from impact_rig.nodes import process
from impact_rig.nodes.diagnostics import Health, State
from impact_rig.nodes.guard import describe, guarded
from impact_rig.nodes.inputs import Inputs
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.pacing import WorkTimer
from impact_rig.nodes.parameters import RigSchema
from impact_rig.nodes.rig_state import RigState
from impact_rig.nodes.session import Session
from impact_rig.nodes.standard_services import StandardServices
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S
from impact_rig.system.endings import Ending

WORK_S = 0.02
"""Wall time one call of the work timer may fill before commands and services are looked at."""
LARGEST_BATCH_S = 0.2
"""Rig time simulated at once, for the same reason."""
SMALLEST_BATCH_NS = 50_000_000
"""Rig time caught up at once in realtime: a rig that is slower than real time must still answer."""
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 0.001, 0.05
AHEAD_PERIOD_S = 0.005
"""Period of the work timer where acknowledgements drive the work."""
SLICE_S = 0.02
"""How long after a call of the timer acknowledgements may drive the work: an executor that hands over the messages of
one subscription for as long as there are any would never come to services and timers."""
AWAY_S = 1.0
"""A gap this long between two calls of the work timer: this process was suspended, not the peers."""
DISCOVERY_S = 3.5
"""How long rigs of other machines are looked for: an announcement that a new process misses comes again 3 s later
(tools/discovery.py)."""
WARM_UP_NS = 50_000_000
"""Simulated once while configuring, so that compiled code is loaded before the first block is due."""


class RigNode(ManagedNode[RigConfig]):
    """Parameters, publishers, inputs, and the work: one call into `Rig` for the blocks that are due.

    Args:
        discovery_s: how old the node must be before it looks who else is there; a new process finds others by and by.
        kwargs: passed to rclpy's Node.
    """

    COMPONENT = "simulation"
    STATES = states.Rig
    MAKES_TIME = True

    def __init__(self, discovery_s: float = 0.0, **kwargs: Any) -> None:
        self._discovered_at = time.monotonic() + discovery_s
        super().__init__("rig", RigSchema(), **kwargs)
        self._session = Session(self)
        self._timer = WorkTimer(self, self._on_timer)
        self._worked_at = self._slice_began = 0.0
        self._inputs = Inputs(
            self._session, guarded(self._on_step, self.report_failure), self._start_timer, self._on_samples
        )
        self._state = RigState(self._inputs)
        self._standard = StandardServices(self._inputs)
        self.subscribe(topics.ACK, self._on_ack, raw=True)

    # Lifecycle

    def autostarts(self) -> bool:
        """Follow `output.autostart`."""
        return self.settings.output.autostart

    def configure(self) -> None:
        """Check that this rig can be built and published, load compiled code, create the publishers."""
        Rig(self.settings).advance(WARM_UP_NS)
        self._session.configure()
        if not self._session.lock.decides:  # waited for here: who finds the node active may command it at once
            time.sleep(max(0.0, self._discovered_at - time.monotonic()))

    def activate(self) -> None:
        """Begin, once nobody else publishes here; in realtime also once the peers listen, or after `start_wait_s`."""
        self._session.activate()
        self._inputs.steps.left = 0
        self._timer.start(AHEAD_PERIOD_S, 0.0)
        self._begin_if_possible()
        if self._session.rig is None:
            self._session.publishers.announce(self.settings)

    def _begin_if_possible(self) -> None:
        session = self._session
        if session.gate is None or session.gate.obstacle() is not None:
            return
        self._state.begun(", ".join(session.readers.missing()) if session.readers and session.is_realtime else "")
        self._inputs.drop_commands()
        session.begin()
        self._worked_at = time.monotonic()
        self._start_timer()

    def deactivate(self) -> None:
        """Stop the rig; what was not published is dropped."""
        self._timer.stop()
        self._session.deactivate()
        self._inputs.end("the rig was deactivated")

    def cleanup(self) -> None:
        """Destroy the publishers."""
        self.deactivate()
        self._session.cleanup()

    def settings_changed(self, settings: RigConfig, changes: dict[str, Any]) -> None:
        """Give the running rig what changed; the validator has already accepted it."""
        self._session.change(settings, changes)

    def settings_in_force(self) -> None:
        """Pace the work by the new settings."""
        if self._session.rig is not None:
            self._start_timer()

    def rig_time_ns(self) -> int | None:
        """Return the stamp of the next block: rig time; the system time while there is no rig in realtime."""
        if self._session.rig is not None:
            return self._session.rig.next_block_ns
        return time.time_ns() if self._session.is_realtime else None

    def doing(self) -> State:
        """Return what the rig does."""
        return self._state.word()

    def status(self) -> Health:
        """Return how the rig is, and tell the log what is new."""
        self._state.look()
        return self._state.health()

    # Work

    def _period_s(self) -> float:
        config = self.settings
        if not self._session.is_realtime:
            return AHEAD_PERIOD_S
        block_s = config.daq.block_scans / config.daq.rate_hz / config.time.factor
        return min(max(block_s, SHORTEST_PERIOD_S), LONGEST_PERIOD_S)

    def _start_timer(self) -> None:
        self._timer.start(self._period_s(), self._wait_s() if self._session.is_realtime else 0.0)

    def _wait_s(self) -> float:
        """Return the time until the next block is due."""
        session = self._session
        return session.pacer.wait_ns(session.running().block_end_ns(1) - session.base_ns) / NS_PER_S

    def _on_timer(self) -> None:
        self._work()
        self._inputs.pause.answer()
        self._slice_began = time.monotonic()
        if self._session.rig is not None and self._session.is_realtime and not self._session.paused:
            self._timer.keep_in_step(self._wait_s())

    def _on_step(self) -> None:
        self._inputs.pause.blocks_steps = False  # who steps a paused rig wants what was left of steps before, too
        self._work()

    def _on_ack(self, data: bytes) -> None:
        if self._session.acknowledged(data):
            self._inputs.pause.answer()
            if not self._session.is_realtime and time.monotonic() - self._slice_began < SLICE_S:
                self._work()

    def _on_samples(self) -> None:
        if self._session.starved_at is not None:
            self._work()

    def _work(self) -> None:
        session, pause, now = self._session, self._inputs.pause, time.monotonic()
        if now - self._worked_at > AWAY_S:
            session.window.excuse()
        self._worked_at = now
        if pause.blocks_steps or (session.paused and not self._inputs.steps.waiting):
            return
        try:
            if session.rig is None:
                self._begin_if_possible()
            elif session.is_realtime and not session.paused:
                self._catch_up(session.rig, now + WORK_S)
            else:
                self._run_ahead(session.rig, now + WORK_S)
        except Exception as error:  # the model cannot go on: stop in order, and say why
            self.report_failure("simulation", describe(error))
            self.trigger_deactivate()

    def _catch_up(self, rig: Rig, deadline: float) -> None:
        """Publish what is due, or as much of it as the deadline allows: the next call goes on."""
        session = self._session
        due_ns = session.base_ns + session.pacer.due_ns(rig.next_block_ns - session.base_ns)
        while True:
            until_ns = min(due_ns, rig.frontier_ns + SMALLEST_BATCH_NS)
            session.publish(rig.advance(until_ns))
            if until_ns == due_ns or time.monotonic() > deadline:
                return

    def _run_ahead(self, rig: Rig, deadline: float) -> None:
        """Publish as many blocks as the window (and a step) allows, until the deadline."""
        session, steps, window = self._session, self._inputs.steps, self._session.window
        by_steps = session.paused or self.settings.time.mode == "stepped"
        limit = steps.left if by_steps else window.window
        assert session.readers is not None
        if not session.readers.all_matched():
            steps.refuse_without_peers()
            return
        if not session.history_settled:
            session.publishers.settle_history()
            session.history_settled = True
        now = time.monotonic()
        batch = max(1, round(LARGEST_BATCH_S * self.settings.daq.rate_hz / self.settings.daq.block_scans))
        while limit > 0 and not window.silent():
            room = min(window.room(), limit, batch)
            if room < min(limit, batch, (window.window + 1) // 2):
                break  # waiting for half a window makes batches worth their overhead
            room = rig.blocks_with_samples(room)
            if room == 0:
                session.starved_at = session.starved_at or now
                break
            blocks = rig.advance(rig.block_end_ns(room))
            session.publish(blocks)
            if by_steps:
                steps.left -= len(blocks)
                limit = steps.left
            if time.monotonic() > deadline:
                break
        steps.answer()


def main(ending: Ending) -> None:
    """Run the rig node."""
    process.main(functools.partial(RigNode, discovery_s=DISCOVERY_S), ending)
