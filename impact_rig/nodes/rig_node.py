"""The rig as a lifecycle node: publishes what `Rig` measures when it is due and passes commands on; decides nothing."""

from __future__ import annotations

import time
from typing import Any  # rclpy messages and responses

import numpy as np
from rclpy.duration import Duration
from std_msgs.msg import Float64, Header, String
from std_srvs.srv import SetBool, Trigger

from impact_rig import codec
from impact_rig.blocks import SCAN, TRUTH_SCAN
from impact_rig.config import RigConfig, dump
from impact_rig.errors import CommandError, ConfigError, ImpactRigError
from impact_rig.nodes import process, topics
from impact_rig.nodes.convert import Monitors, clock_message
from impact_rig.nodes.deferred import DeferredTrigger
from impact_rig.nodes.diagnostics import Status
from impact_rig.nodes.guard import guarded
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.parameters import RigSchema
from impact_rig.nodes.peers import Peers
from impact_rig.nodes.rig_status import RigStatus
from impact_rig.nodes.stamps import nanoseconds
from impact_rig.nodes.work_timer import WorkTimer
from impact_rig.pacing import AckWindow, Pacer
from impact_rig.rig import Block, Rig
from impact_rig.simtime import NS_PER_S

PUBLISHED = [topic for topic in topics.TOPICS if topic.publisher == "rig" and not topic.name.startswith("/")]
LEAST_DEPTH = 100
"""Blocks kept for a slow subscriber: twice what comes in a second, but at least this."""
DELIVERY = Duration(seconds=0.2)
"""Longest wait for the delivery of a change; only a subscriber that died without a word takes so long."""
WORK_S = 0.02
"""Wall time one call of the work timer may fill before commands and services get their turn."""
SHORTEST_PERIOD_S, LONGEST_PERIOD_S = 0.001, 0.05
AHEAD_PERIOD_S = 0.005
"""Period of the work timer where acknowledgements drive the work."""
TURN_S = 0.02
"""How long after a call of the timer acknowledgements may drive the work: an executor that hands over the messages of
one subscription for as long as there are any would never come to services and timers."""
AWAY_S = 1.0
"""A gap this long between two calls of the work timer: this process was suspended, not the peers."""
WARM_UP_NS = 50_000_000
"""Simulated once while configuring, so that compiled code is loaded before the first block is due."""


class RigNode(ManagedNode[RigConfig]):
    """Publishes the rig's blocks; commands, services and parameters go to `Rig`.

    Args:
        kwargs: passed to rclpy's Node.
    """

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("rig", RigSchema(), **kwargs)
        self._rig: Rig | None = None
        self._outlets: dict[str, Any] = {}
        self._monitors: Monitors | None = None
        self._timer = WorkTimer(self, self._on_timer)
        self._pacer = Pacer(time.monotonic_ns)
        self._window = AckWindow((), 1, NS_PER_S, time.monotonic_ns)
        self._peers = Peers(self)
        self._paused = False
        self._steps_left = 0
        self._info = b""
        self._base_ns = 0
        self._worked_at = self._turn_began = 0.0
        self._figures = RigStatus()
        self._clock_outlet = self.create_publisher(
            topics.CLOCK.message_type(), topics.CLOCK.name, topics.CLOCK.qos.profile()
        )
        self.subscribe(topics.FREQUENCY, self._on_frequency)
        self.subscribe(topics.CURRENT, self._on_current)
        self.subscribe(topics.ACK, self._on_ack)
        self.service(SetBool, "~/pause", self._on_pause)
        self.service(Trigger, "~/reset", self._on_reset)
        self.service(Trigger, "~/stop", self._on_stop)
        self.service(Trigger, "~/clear_trip", self._on_clear_trip)
        self.service(Trigger, "~/pluck", self._on_pluck)
        self._step = DeferredTrigger(self, "~/step", self._on_step, guarded(self._work, self.report_failure))

    # Lifecycle

    def autostarts(self) -> bool:
        """Follow `output.autostart`."""
        return self.settings.output.autostart

    def configure(self) -> None:
        """Check that this rig can be built and published, load compiled code, create the publishers."""
        config = self.settings
        _check_message_size(config)
        Rig(config).advance(WARM_UP_NS)
        per_second = config.daq.rate_hz // config.daq.block_scans
        depth = max(LEAST_DEPTH, 2 * per_second)  # for a slow subscriber, without holding seconds of large blocks
        bulky = (topics.SCAN, topics.TRUTH_SCAN)
        self._outlets = {topic.name: self.publisher(topic, depth if topic in bulky else None) for topic in PUBLISHED}

    def activate(self) -> None:
        """Start a new rig: scan 0 is now in realtime, at 0 otherwise."""
        config = self.settings
        self._base_ns = time.time_ns() if config.time.mode == "realtime" else 0
        self._pacer = Pacer(time.monotonic_ns, config.time.factor)  # beside the stamp: both mean the same instant
        self._rig = Rig(config, self._base_ns)
        self._paused = False
        self._steps_left = 0
        self._figures = RigStatus()
        self._info = b""
        self._window = AckWindow(
            config.time.peers, config.time.ack_window, round(config.time.peer_timeout_s * NS_PER_S), time.monotonic_ns
        )
        self._peers.expect(config.time.peers)
        self._flush()
        self._publish_configuration()
        self._worked_at = time.monotonic()
        self._start_timer()

    def deactivate(self) -> None:
        """Stop the rig; what was not published is dropped."""
        self._timer.stop()
        self._rig = None
        self._step.reply(False, "the rig was deactivated")

    def cleanup(self) -> None:
        """Destroy the publishers."""
        self.deactivate()
        for outlet in self._outlets.values():
            self.destroy_publisher(outlet)
        self._outlets = {}

    def rig_time_ns(self) -> int:
        """Return the stamp of the next block: rig time; the system time while there is no rig in realtime."""
        if self._rig is not None:
            return self._rig.next_block_ns
        return time.time_ns() if self.settings.time.mode == "realtime" else 0

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
        self._turn_began = time.monotonic()
        if self._rig is not None and self.settings.time.mode == "realtime" and not self._paused:
            self._timer.keep_in_step(self._wait_s())

    def _work(self) -> None:
        rig, now = self._rig, time.monotonic()
        if now - self._worked_at > AWAY_S:
            self._window.excuse()
        self._worked_at = now
        if rig is None or self._paused:
            return
        try:
            if self.settings.time.mode == "realtime":
                self._publish(rig.advance(self._base_ns + self._pacer.due_ns(rig.next_block_ns - self._base_ns)))
            else:
                self._run_ahead(rig, now + WORK_S)
        except ImpactRigError as error:  # the model cannot go on: stop in order, and say why
            self.report_failure("simulation", str(error))
            self.trigger_deactivate()

    def _run_ahead(self, rig: Rig, deadline: float) -> None:
        """Publish as many blocks as the window (and a step) allows, until the deadline."""
        mode = self.settings.time.mode
        limit = self._steps_left if mode == "stepped" else self._window.window
        if limit <= 0 or self._window.silent():
            self._answer_step()
            return
        if self._peers.missing():
            if not self._peers.all_matched(self._outlets[topics.SCAN.name]):
                return
            for topic in (topics.INFO, topics.APPLIED, topics.JOURNAL):
                self._settle(topic)  # what was published before they came
        while limit > 0:
            room = min(self._window.room(), limit)
            if room < min(limit, (self._window.window + 1) // 2):
                break  # waiting for half a window makes batches worth their overhead
            blocks = rig.advance(rig.block_end_ns(room))
            self._publish(blocks)
            if mode == "stepped":
                self._steps_left -= len(blocks)
                limit = self._steps_left
            if time.monotonic() > deadline:
                break
        self._answer_step()

    def _answer_step(self) -> None:
        if self._step.waiting and self._steps_left <= 0 and self._window.outstanding() == 0:
            assert self._rig is not None
            self._step.reply(True, f"at {self._rig.next_block_ns / NS_PER_S:.9f} s")

    # Publishing

    def _publish(self, blocks: list[Block]) -> None:
        self._flush()  # what changed comes before the scans it acts on
        for block in blocks:
            if not block.lost:
                self._outlets[topics.SCAN.name].publish(codec.encode(block.scan))
                self._window.published(block.scan.stamp_ns)
            for topic, table in (
                (topics.IMPACTS_TRUTH, block.impacts),
                (topics.FAULTS, block.faults),
                (topics.TRUTH_SCAN, block.truth),
            ):
                if table is not None:
                    self._outlets[topic.name].publish(codec.encode(table))
            assert self._monitors is not None
            for topic, message in self._monitors.messages(block):
                self._outlets[topic.name].publish(message)
            self._pacer.published(block.end_ns - self._base_ns)
            self._figures.count(block)
        if blocks and self._publishes_clock():
            self._clock_outlet.publish(clock_message(blocks[-1].end_ns))

    def _flush(self) -> None:
        """Publish the new rows of shaker/applied and rig/journal."""
        assert self._rig is not None
        for topic, tables in (
            (topics.APPLIED, self._rig.take_applied()),
            (topics.JOURNAL, self._rig.take_journal()),
        ):
            for table in tables:
                self._outlets[topic.name].publish(codec.encode(table))
            if tables:
                self._settle(topic)

    def _settle(self, topic: topics.Topic) -> None:
        """Wait until every matched subscriber has what was published on a topic.

        Topics overtake each other. In realtime they do so by milliseconds, for which a measurement can wait; in the
        other modes that is many blocks, and results would depend on it.
        """
        if self.settings.time.mode != "realtime":
            self._outlets[topic.name].wait_for_all_acked(DELIVERY)

    def _publish_configuration(self) -> None:
        """Publish the configuration, and the calibration if it is another; take both for the monitors."""
        assert self._rig is not None
        info = self._rig.info()
        noise = dict(zip(info.rows["name"].astype(str).tolist(), info.rows["noise"].tolist(), strict=True))
        self._monitors = Monitors(self._rig.config, noise)
        self._figures.realised_restitution = self._rig.simulation.realised_restitution
        encoded = codec.encode(info)
        if encoded != self._info:
            self._info = encoded
            self._outlets[topics.INFO.name].publish(encoded)
            self._settle(topics.INFO)
        self._outlets[topics.CONFIGURATION.name].publish(String(data=dump(self._rig.config)))

    def _publishes_clock(self) -> bool:
        choice = self.settings.time.publish_clock
        if choice == "auto":
            return self.settings.time.mode != "realtime" or self.settings.time.factor != 1.0
        return choice == "on"

    # Commands

    def _on_frequency(self, message: Float64) -> None:
        self._command(topics.FREQUENCY.name, frequency_hz=message.data)

    def _on_current(self, message: Float64) -> None:
        self._command(topics.CURRENT.name, current_a=message.data)

    def _command(self, name: str, **values: float) -> None:
        if self._rig is None:
            self.refuse("inactive", f"{name} while the rig is {self.state}")
            return
        try:
            self._rig.command(**values)
        except CommandError as error:
            self.refuse(name, str(error))
            return
        self._flush()

    def _on_ack(self, message: Header) -> None:
        stamp = nanoseconds(message.stamp)
        if self._rig is None or message.frame_id not in self._window.peers:
            return  # every peer acknowledges, in every mode
        if not self._window.acknowledge(message.frame_id, stamp):
            self.refuse("daq/ack", f"{message.frame_id!r} acknowledged {stamp} ns, which was never published")
            return
        if self.settings.time.mode != "realtime" and time.monotonic() - self._turn_began < TURN_S:
            self._work()

    def _on_step(self) -> tuple[bool, str] | None:
        if self._rig is None:
            return False, f"cannot step while the rig is {self.state}"
        if self.settings.time.mode != "stepped":
            return False, f"time.mode must be stepped, it is {self.settings.time.mode}"
        if self._paused:
            return False, "the rig is paused"
        self._steps_left += self.settings.step.blocks
        return None

    def _on_pause(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        rig = self._running()
        if not request.data:
            self._window.forgive()
            self._pacer.rebase(rig.next_block_ns - self._base_ns)
            self._start_timer()
        self._paused = request.data
        response.success, response.message = True, "paused" if request.data else "running"
        return response

    def _on_reset(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._running().reset()
        self._flush()
        self._publish_configuration()
        return self._done(response, "reset: scan 0")

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._running().stop()
        self._flush()
        return self._done(response, "shaker ramps to zero and stays latched until ~/clear_trip")

    def _on_clear_trip(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._running().clear_trip()
        self._flush()
        return self._done(response, "latch released; current stays zero until the next command")

    def _on_pluck(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._running().pluck(self.settings.pluck.displacement_m)
        self._flush()
        return self._done(response, "base locked, structure released; ~/reset unlocks")

    def _running(self) -> Rig:
        if self._rig is None:
            raise CommandError(f"the rig is {self.state}, activate it first")
        return self._rig

    def _done(self, response: Trigger.Response, message: str) -> Trigger.Response:
        response.success, response.message = True, message
        return response

    # Parameters and diagnostics

    def settings_changed(self, settings: RigConfig, changes: dict[str, Any]) -> None:
        """Give the running rig what changed; the validator has already accepted it."""
        _check_message_size(settings)
        if self._rig is None:
            return
        self._rig.configure(changes)
        self._flush()
        if any(name.startswith(("time.peers", "time.ack_window", "time.peer_timeout")) for name in changes):
            self._window.set_peers(settings.time.peers)
            self._window.window = settings.time.ack_window
            self._window.timeout_ns = round(settings.time.peer_timeout_s * NS_PER_S)
            self._peers.expect(settings.time.peers)
        if "time.factor" in changes:
            self._pacer.rebase(self._rig.next_block_ns - self._base_ns, settings.time.factor)
        self._publish_configuration()

    def settings_in_force(self) -> None:
        """Pace the work by the new settings."""
        if self._rig is not None:
            self._start_timer()

    def status(self) -> Status:
        """Return mode, time, lateness, peers, shaker, over-ranges."""
        return self._figures.status(
            self.state, self._rig, self.settings, self._pacer, self._window, self._peers.missing(), self._paused
        )


def _check_message_size(config: RigConfig) -> None:
    """Refuse blocks that do not fit a shared-memory segment of DDS."""
    dtype = TRUTH_SCAN if config.output.truth_scan else SCAN
    most = (codec.MAX_MESSAGE_BYTES - 1000) // np.dtype(dtype).itemsize
    if config.daq.block_scans > most:
        why = "with output.truth_scan" if config.output.truth_scan else f"({codec.MAX_MESSAGE_BYTES} bytes per message)"
        raise ConfigError(f"daq.block_scans must be <= {most} {why}, got {config.daq.block_scans}")


def main() -> None:
    """Run the rig node."""
    process.main(RigNode)


if __name__ == "__main__":
    main()
