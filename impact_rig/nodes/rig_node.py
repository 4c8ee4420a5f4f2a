# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig as a lifecycle node: publishes what `Rig` measures when it is due and passes commands on; decides nothing."""

from __future__ import annotations

import functools
import time
from typing import Any  # rclpy messages and responses

from impact_rig import codec, states, topics
from impact_rig.errors import CodecError, CommandError
from impact_rig.nodes import process
from impact_rig.nodes.beginning import Beginning, Rivals
from impact_rig.nodes.diagnostics import Health, Level, State
from impact_rig.nodes.guard import describe, guarded
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.outlets import Outlets
from impact_rig.nodes.pacing import AckWindow, Pacer
from impact_rig.nodes.parameters import RigSchema
from impact_rig.nodes.pausing import Pause
from impact_rig.nodes.place import Place
from impact_rig.nodes.readers import Readers
from impact_rig.nodes.rig_commands import RigCommands
from impact_rig.nodes.rig_news import RigNews
from impact_rig.nodes.rig_services import RigServices
from impact_rig.nodes.rig_status import RigStatus
from impact_rig.nodes.standard_services import StandardServices
from impact_rig.nodes.steps import StepRequests
from impact_rig.nodes.work_timer import WorkTimer
from impact_rig.rig import Block, Rig, warm_up
from impact_rig.rig.config import RigConfig
from impact_rig.simtime import NS_PER_S
from impact_rig.system.endings import Ending
from impact_rig.system.lean_numba import go_without_blas

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
    """Publishes the rig's blocks; commands, services and parameters go to `Rig`.

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
        self._rig: Rig | None = None
        self._outlets: Outlets | None = None
        self._timer = WorkTimer(self, self._on_timer)
        self._pacer = Pacer(time.monotonic_ns)
        self._window = AckWindow((), 1, NS_PER_S, time.monotonic_ns)
        self._readers: Readers | None = None
        self._place = Place(self)
        self._rivals: Rivals | None = None
        self._beginning: Beginning | None = None
        self._history_settled = False
        self._base_ns = self._clock_offset_ns = 0
        self._worked_at = self._slice_began = 0.0
        self._figures = RigStatus()
        self._commands = RigCommands(self, self._running, self._flush)
        self.subscribe(topics.ACK, self._on_ack, raw=True)
        self._pause = Pause(self, self._no_rig, lambda: self._window, self._go_on)
        self._news = RigNews(self)
        self._at_once = RigServices(self, self._running, self._flush, self._was_reset)
        step = guarded(self._on_step, self.report_failure)
        self._steps = StepRequests(self, self._no_step, lambda: self.settings.step.blocks, step)
        self._standard = StandardServices(
            self, lambda: self._rig, self._why_not, self._pause, self._steps, self._at_once.reset
        )

    # Lifecycle

    def autostarts(self) -> bool:
        """Follow `output.autostart`."""
        return self.settings.output.autostart

    def configure(self) -> None:
        """Check that this rig can be built and published, load compiled code, create the publishers."""
        self.compile_ahead(warm_up.TASKS)
        Rig(self.settings).advance(WARM_UP_NS)
        self._outlets = Outlets(self, self.settings)
        if not self._place.decides:  # waited for here: who finds the node active may command it at once
            time.sleep(max(0.0, self._discovered_at - time.monotonic()))

    def activate(self) -> None:
        """Begin, once nobody else publishes here; in realtime also once the peers listen, or after `start_wait_s`."""
        config = self.settings
        realtime = config.time.mode == "realtime"
        assert self._outlets is not None
        self._readers = Readers(self, self._outlets.scan)
        self._readers.expect(config.time.peers)
        self._rivals = Rivals(self, self._outlets.names)
        readers = self._readers if realtime else None
        self._beginning = Beginning(self, self._place, self._rivals, readers, config.time.start_wait_s)
        self._outlets.forget()
        self._history_settled = False
        self._steps.left = 0
        self._figures = RigStatus()
        self._timer.start(AHEAD_PERIOD_S, 0.0)
        self._begin_if_possible()
        if self._rig is None:
            self._outlets.announce(config)

    def _begin_if_possible(self) -> None:
        """Start a new rig: scan 0 is now in realtime, at 0 otherwise."""
        if self._beginning is None or self._beginning.obstacle() is not None:
            return
        config = self.settings
        realtime = config.time.mode == "realtime"
        self._news.begun(config, ", ".join(self._readers.missing()) if self._readers and realtime else "")
        self._clock_offset_ns = time.time_ns() - time.monotonic_ns()
        self._base_ns = time.time_ns() if realtime else 0
        self._pacer = Pacer(time.monotonic_ns, config.time.factor)  # beside the stamp: both mean the same instant
        self._commands.drop()
        self._rig = Rig(config, self._base_ns)
        self._beginning = None
        self._window = AckWindow(
            config.time.peers, config.time.ack_window, round(config.time.peer_timeout_s * NS_PER_S), time.monotonic_ns
        )
        assert self._outlets is not None
        self._flush(self._rig)
        self._publish_configuration(self._rig)
        if config.time.peers and realtime:
            self._outlets.settle_history()
        self._worked_at = time.monotonic()
        self._start_timer()

    def deactivate(self) -> None:
        """Stop the rig; what was not published is dropped."""
        self._timer.stop()
        self._rig = self._readers = self._rivals = self._beginning = None
        self._place.leave()
        self._steps.refuse("the rig was deactivated")
        self._pause.end("the rig was deactivated")

    def cleanup(self) -> None:
        """Destroy the publishers."""
        self.deactivate()
        if self._outlets is not None:
            self._outlets.destroy()
            self._outlets = None

    def rig_time_ns(self) -> int | None:
        """Return the stamp of the next block: rig time; the system time while there is no rig in realtime."""
        if self._rig is not None:
            return self._rig.next_block_ns
        return time.time_ns() if self.settings.time.mode == "realtime" else None

    # Time

    def _period_s(self) -> float:
        config = self.settings
        if config.time.mode != "realtime":
            return AHEAD_PERIOD_S
        block_s = config.daq.block_scans / config.daq.rate_hz / config.time.factor
        return min(max(block_s, SHORTEST_PERIOD_S), LONGEST_PERIOD_S)

    def _start_timer(self) -> None:
        self._timer.start(self._period_s(), self._wait_s() if self.settings.time.mode == "realtime" else 0.0)

    def _wait_s(self) -> float:
        """Return the time until the next block is due."""
        assert self._rig is not None
        return self._pacer.wait_ns(self._rig.block_end_ns(1) - self._base_ns) / NS_PER_S

    def _on_timer(self) -> None:
        self._work()
        self._pause.answer()
        self._slice_began = time.monotonic()
        if self._rig is not None and self.settings.time.mode == "realtime" and not self._pause.on:
            self._timer.keep_in_step(self._wait_s())

    def _work(self) -> None:
        rig, now = self._rig, time.monotonic()
        if now - self._worked_at > AWAY_S:
            self._window.excuse()
        self._worked_at = now
        if self._pause.held or (self._pause.on and not self._steps.waiting):
            return
        try:
            if rig is None:
                self._begin_if_possible()
            elif self.settings.time.mode == "realtime" and not self._pause.on:
                self._catch_up(rig, now + WORK_S)
            else:
                self._run_ahead(rig, now + WORK_S)
        except Exception as error:  # the model cannot go on: stop in order, and say why
            self.report_failure("simulation", describe(error))
            self.trigger_deactivate()

    def _catch_up(self, rig: Rig, deadline: float) -> None:
        """Publish what is due, or as much of it as the deadline allows: the next call goes on."""
        due_ns = self._base_ns + self._pacer.due_ns(rig.next_block_ns - self._base_ns)
        while True:
            until_ns = min(due_ns, rig.frontier_ns + SMALLEST_BATCH_NS)
            self._publish(rig, rig.advance(until_ns))
            if until_ns == due_ns or time.monotonic() > deadline:
                return

    def _batch(self) -> int:
        """Return how many blocks are simulated at once."""
        return max(1, round(LARGEST_BATCH_S * self.settings.daq.rate_hz / self.settings.daq.block_scans))

    def _run_ahead(self, rig: Rig, deadline: float) -> None:
        """Publish as many blocks as the window (and a step) allows, until the deadline."""
        by_steps = self._pause.on or self.settings.time.mode == "stepped"
        limit = self._steps.left if by_steps else self._window.window
        assert self._outlets is not None
        assert self._readers is not None
        if not self._readers.all_matched():
            self._steps.refuse_without(self._readers, self.settings.time.peer_timeout_s)
            return
        if not self._history_settled:
            self._outlets.settle_history()
            self._history_settled = True
        batch = self._batch()
        while limit > 0 and not self._window.silent():
            room = min(self._window.room(), limit, batch)
            if room < min(limit, batch, (self._window.window + 1) // 2):
                break  # waiting for half a window makes batches worth their overhead
            blocks = rig.advance(rig.block_end_ns(room))
            self._publish(rig, blocks)
            if by_steps:
                self._steps.left -= len(blocks)
                limit = self._steps.left
            if time.monotonic() > deadline:
                break
        self._steps.answer(self._window, rig.next_block_ns / NS_PER_S)

    # Publishing

    def _publish(self, rig: Rig, blocks: list[Block]) -> None:
        assert self._outlets is not None
        if self._outlets.changes(rig):  # they come before the scans they act on
            self.report_change()  # a trip, for one
        if blocks:
            self._outlets.look()
        for block in blocks:
            self._outlets.block(block)
            if not block.lost:
                self._window.published(block.scan.stamp_ns)
            if not self._pause.on:
                self._pacer.published(block.end_ns - self._base_ns)
            self._figures.count(block)
        if blocks and self.settings.time.publishes_clock:
            self._outlets.clock(blocks[-1].end_ns)

    def _flush(self, rig: Rig) -> None:
        """Publish what an input has changed."""
        assert self._outlets is not None
        self._outlets.changes(rig)
        self.report_change()

    def _publish_configuration(self, rig: Rig) -> None:
        assert self._outlets is not None
        self._outlets.configuration(rig)
        self._figures.realised_restitution = rig.simulation.realised_restitution

    # Peers and steps

    def _on_ack(self, data: bytes) -> None:
        """Take an acknowledgement: every reader of daq/scan may send them, in every mode."""
        if self._readers is None:
            return
        try:
            stamp, name = codec.header(data)
        except CodecError as error:
            self.refuse(topics.ACK.name, str(error))
            return
        window = self._window
        if window.newest_ns is None or stamp > window.newest_ns:
            self.refuse(topics.ACK.name, f"{name!r} acknowledged {stamp} ns, which was never published")
            return
        if name not in window.readers:
            if not self._readers.knows(name):
                self._figures.other_acks += 1
                return
            window.watch(name)
        window.acknowledge(name, stamp)
        if name in window.peers:
            self._pause.answer()
            if self.settings.time.mode != "realtime" and time.monotonic() - self._slice_began < SLICE_S:
                self._work()

    def _on_step(self) -> None:
        self._pause.held = False  # who steps a paused rig wants what was left of steps before, too
        self._work()

    def _no_rig(self) -> str:
        """Return why there is no rig, or nothing."""
        return self._why_not() if self._rig is None else ""

    def _no_step(self) -> str:
        """Return why there can be no step now, or nothing."""
        if self._rig is None:
            return self._why_not()
        if self.settings.time.mode != "stepped" and not self._pause.on:
            return f"the rig runs in {self.settings.time.mode}: pause it first (~/pause), or set time.mode to stepped"
        return ""

    def _go_on(self) -> None:
        """Leave a pause."""
        if self.settings.time.mode != "stepped":
            self._steps.refuse("told to go on")
        self._window.forgive()
        self._pacer.rebase(self._running().next_block_ns - self._base_ns)
        self._start_timer()

    def _was_reset(self, rig: Rig) -> None:
        self._figures.faults.clear()  # planned ones begin anew, and say so
        self._publish_configuration(rig)

    def _running(self) -> Rig:
        if self._rig is None:
            raise CommandError(self._why_not())
        return self._rig

    def _why_not(self) -> str:
        """Return why there is no rig to talk to."""
        obstacle = self._beginning.obstacle() if self._beginning is not None else None
        return (
            f"the rig has not begun, {obstacle.reason}" if obstacle else f"the rig is {self.state}, activate it first"
        )

    # Parameters and diagnostics

    def settings_changed(self, settings: RigConfig, changes: dict[str, Any]) -> None:
        """Give the running rig what changed; the validator has already accepted it."""
        if self._readers is None:
            return
        if "time.peers" in changes:
            self._readers.expect(settings.time.peers)
            self._history_settled = False
        if self._rig is None:
            return
        self._rig.configure(changes)
        self._flush(self._rig)
        if any(name.startswith(("time.peers", "time.ack_window", "time.peer_timeout")) for name in changes):
            self._window.set_peers(settings.time.peers)
            self._window.window = settings.time.ack_window
            self._window.timeout_ns = round(settings.time.peer_timeout_s * NS_PER_S)
        if "time.factor" in changes:
            self._pacer.rebase(self._rig.next_block_ns - self._base_ns, settings.time.factor)
        self._publish_configuration(self._rig)

    def settings_in_force(self) -> None:
        """Pace the work by the new settings."""
        if self._rig is not None:
            self._start_timer()

    def doing(self) -> State:
        """Return what the rig does: what keeps it from beginning or from going on, what holds the shaker, its drive."""
        obstacle = self._beginning.obstacle() if self._beginning is not None else None
        if obstacle is not None:
            return obstacle
        rig, word = self._rig, states.Rig
        if rig is None or self._readers is None or self._rivals is None:  # between two callbacks only
            return State(word.INACTIVE, self.state)
        config, others = self.settings.time, self._rivals.sentence()
        missing = () if self._readers.all_matched() else self._readers.missing()
        silent = () if config.mode == "realtime" else self._window.silent()
        if others:
            return State(word.RIVAL, others)
        if missing and config.mode != "realtime":
            return State(word.NO_PEER, f"waiting for peer {', '.join(missing)}")
        if silent:
            return State(word.SILENT_PEER, f"peer {', '.join(silent)} silent for {config.peer_timeout_s:g} s")
        if rig.latched is not None:
            return State(word.TRIPPED, rig.latched)
        if self._pause.on:
            return State(word.PAUSED, "~/pause")
        if config.mode == "stepped" and self._steps.is_idle:
            return State(word.PAUSED, "no step is asked for")
        if rig.plucked:
            return State(word.PLUCKED)
        without = f"without peer {', '.join(missing)}" if missing else ""
        return State(word.DRIVING if rig.amplitude else word.AT_REST, without)

    def status(self) -> Health:
        """Return mode, time, lateness, peers, shaker, over-ranges; or why the rig has not begun."""
        obstacle = self._beginning.obstacle() if self._beginning is not None else None
        if obstacle is not None:
            level = Level.ERROR if obstacle.word is states.Rig.RIVAL else Level.WARN
            return Health(level, obstacle.reason, {"mode": self.settings.time.mode})
        if self._rig is not None and self._readers is not None:
            self._news.look(self._rig, self._figures, self._window, self._readers)
        return self._figures.status(
            self.state,
            self._rig,
            self.settings,
            self._pacer,
            self._window,
            self._readers,
            self._rivals,
            self._pause.on,
            (time.time_ns() - time.monotonic_ns() - self._clock_offset_ns) / NS_PER_S,
        )


def main(ending: Ending) -> None:
    """Run the rig node."""
    go_without_blas()
    process.main(functools.partial(RigNode, discovery_s=DISCOVERY_S), ending)
