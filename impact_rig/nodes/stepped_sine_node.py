# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A sweep or a phase lock through the topics: the operator's loop, fed by a node's callbacks; it is the apparatus."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any  # rclpy messages

from std_msgs.msg import Float64
from std_srvs.srv import Trigger

from impact_rig import codec, states, topics
from impact_rig.blocks import Table
from impact_rig.errors import CodecError, ConfigError
from impact_rig.nodes import process
from impact_rig.nodes.acknowledgements import Acknowledgements
from impact_rig.nodes.diagnostics import Health, Level, State
from impact_rig.nodes.managed import ManagedNode
from impact_rig.nodes.parameters import SectionSchema
from impact_rig.nodes.settings import PHASE, SteppedSineSettings
from impact_rig.nodes.topics import MONITORS
from impact_rig.operate.operator import Applied, News, Operator
from impact_rig.operate.phase_lock import LockedSine
from impact_rig.operate.plan import Setpoint
from impact_rig.operate.stepped_sine import ControlledSine, SteppedSine
from impact_rig.operate.stepped_sine import State as Progress
from impact_rig.system.endings import Ending

WATCH_S = 0.1
"""How often the node looks for the rig, while a sweep waits to begin."""
STOPPING = {b"trip": "tripped", b"stop": "was stopped", b"timeout": "missed commands", b"reset": "was reset"}
"""Kinds of journal entries that end a sweep, and what the rig did then."""


Walk = SteppedSine | LockedSine


class SteppedSineNode(ManagedNode[SteppedSineSettings]):
    """Sets one frequency after the other, waits for the analysis, and publishes the curve; or locks on a resonance.

    Where the phase is held it looks at the scans itself, and acknowledges them, so that it can be a peer.

    Args:
        kwargs: passed to rclpy's Node.
    """

    COMPONENT = "sweep"
    STATES = states.SteppedSine

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("stepped_sine", SectionSchema(SteppedSineSettings), **kwargs)
        self._operator: Operator[Walk] | None = None
        self._outputs: dict[str, Any] = {}
        self._acknowledgements: Acknowledgements | None = None
        self._heard: list[Any] = []
        self._timer: Any = None
        self._pending = False  # wanted, but the rig is not there yet
        self._now_ns: int | None = None
        self._info: Table | None = None
        self._scans: Any = None  # subscription, while the phase is what is held
        self._scans_heard = False
        self._began_ns = 0
        self.service(Trigger, "~/start", self._on_start)
        self.service(Trigger, "~/stop", self._on_stop)

    def autostarts(self) -> bool:
        """Follow `autostart`."""
        return self.settings.autostart

    def configure(self) -> None:
        """Create the publishers."""
        chosen = (topics.FREQUENCY, topics.CURRENT, topics.CURVE, topics.HELD, topics.LOCKED)
        self._outputs = {topic.name: self.publisher(topic) for topic in chosen}
        self._acknowledgements = Acknowledgements(self)

    def activate(self) -> None:
        """Listen; begin the sweep as soon as the rig is there if `begin` says so."""
        self._now_ns, self._pending = None, self.settings.begin
        self._heard = [
            self.subscribe(MONITORS["base"], self._on_time, raw=True),
            self._follow(topics.APPLIED, self._on_applied),
            self._follow(topics.JOURNAL, self._on_journal),
            self._follow(topics.TRANSMISSIBILITY_TABLE, self._on_measurement),
            self.subscribe_table(topics.INFO, self._on_info),
        ]
        self._listen()
        self._timer = self.steady_timer(WATCH_S, self._begin_when_ready)

    def deactivate(self) -> None:
        """Abort a running sweep, the shaker at rest, and stop listening."""
        if self._operator is not None and self.context.ok():
            self._operator.abort("the node was deactivated")
        if self._timer is not None:
            self.destroy_timer(self._timer)
            self._timer = None
        for subscription in [*self._heard, *([self._scans] if self._scans is not None else [])]:
            self.destroy_subscription(subscription)
        self._heard, self._scans, self._info = [], None, None

    def cleanup(self) -> None:
        """Destroy the publishers."""
        self.deactivate()
        self._operator = None
        for publisher in self._outputs.values():
            self.destroy_publisher(publisher)
        self._outputs = {}
        if self._acknowledgements is not None:
            self._acknowledgements.destroy()
            self._acknowledgements = None

    def settings_changed(self, _settings: SteppedSineSettings, changes: dict[str, Any]) -> None:
        """Refuse to change a sweep under way; the next one takes the new plan."""
        if self._running:
            raise ConfigError(f"{', '.join(sorted(changes))}: a sweep is under way, call ~/stop first")

    def settings_in_force(self) -> None:
        """Listen to the scans where the phase is held, and to none otherwise."""
        if self.active:
            self._listen()

    def _listen(self) -> None:
        wanted = self.settings.hold == PHASE
        if wanted and self._scans is None:
            self._scans_heard = False
            self._scans = self.subscribe_table(topics.SCAN, self._on_scan)
        elif not wanted and self._scans is not None:
            self.destroy_subscription(self._scans)
            self._scans = None

    def rig_time_ns(self) -> int | None:
        """Return the newest instant heard of."""
        return self._now_ns

    def doing(self) -> State:
        """Return how the last sweep is."""
        words = states.SteppedSine
        if self._pending:
            return State(words.WAITING, self._missing() or "about to begin")
        if self._operator is None:
            return State(words.IDLE)
        sweep = self._operator.sweep
        if sweep.state is Progress.ABORTED:
            return State(words.ABORTED, sweep.reason)
        return State(words.RUNNING if self._operator.busy else words.DONE)

    def status(self) -> Health:
        """Return how far the sweep is."""
        if self.state != "active":
            return Health(Level.WARN, self.state, {})
        if self._pending:
            return Health(Level.WARN, self._missing() or "about to begin", {})
        if self._operator is None:
            return Health(Level.OK, "idle", {})
        sweep = self._operator.sweep
        if sweep.state is Progress.ABORTED:
            return Health(Level.ERROR, f"aborted: {sweep.reason}", sweep.figures())
        return Health(Level.OK, sweep.describe(), sweep.figures())

    # Start and stop

    def _on_start(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        missing = self._missing()
        if not self.active:
            response.message = f"the node is {self.state}, activate it first"
        elif self._running:
            response.message = "a sweep is under way already"
        elif missing:
            response.message = missing
        else:
            self._begin()
            response.success, response.message = True, self._announced()
        return response

    def _on_stop(self, _request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success, response.message = True, "the shaker is told to rest"
        self._pending = False
        if self._operator is not None and self._operator.busy:
            self._operator.abort("stopped by the operator")
        else:
            response.message = "no sweep is under way"
        return response

    def _announced(self) -> str:
        points = self.settings.plan().points()
        return (
            f"the resonance is sought from {points[0]:g} Hz" if self.settings.hold == PHASE else f"{len(points)} points"
        )

    @property
    def _running(self) -> bool:
        return self._operator is not None and self._operator.busy

    def _missing(self) -> str:
        """Return who is not there yet; empty when a sweep can begin."""
        if any(not self._outputs[topic.name].get_subscription_count() for topic in (topics.FREQUENCY, topics.CURRENT)):
            return "no rig listens to the shaker's topics"
        if self.settings.hold == PHASE:
            if self._info is None or not self._scans_heard:
                return f"nothing was heard on {topics.SCAN.name if self._info is not None else topics.INFO.name} yet"
        elif not self.count_publishers(topics.TRANSMISSIBILITY_TABLE.name):
            return f"nobody publishes {topics.TRANSMISSIBILITY_TABLE.name}"
        return "" if self._now_ns is not None else "nothing was heard of the rig yet"

    def _begin_when_ready(self) -> None:
        if self._pending and not self._missing():
            self._begin()

    def _begin(self) -> None:
        self._pending = False
        self._began_ns = self.now_ns()
        self._operator = Operator(self._walk(), self, self._publish_curve)
        self._operator.begin()

    def _walk(self) -> Walk:
        settings = self.settings
        if settings.hold != PHASE:
            return settings.sweep()
        assert self._info is not None
        return LockedSine(settings.lock_plan(), self._info.rows, settings.accept_limit_s)

    # What the operator's loop asks of an apparatus

    def now_ns(self) -> int:
        """Return the newest instant heard of."""
        return self._now_ns or 0

    def set(self, setpoint: Setpoint) -> None:
        """Send frequency and current; `shaker/applied` tells that they are in force."""
        self._outputs[topics.FREQUENCY.name].publish(Float64(data=setpoint.frequency_hz))
        self._outputs[topics.CURRENT.name].publish(Float64(data=setpoint.current_a))

    def rest(self) -> None:
        """Set the current to zero, and say why."""
        assert self._operator is not None
        self._outputs[topics.CURRENT.name].publish(Float64(data=0.0))
        sweep = self._operator.sweep
        if sweep.state is Progress.ABORTED:
            self.get_logger().error(f"sweep aborted: {sweep.reason}")
        else:
            self.get_logger().info(f"sweep finished: {sweep.measured} measurements")

    def _publish_curve(self, sweep: Walk) -> None:
        if isinstance(sweep, LockedSine):
            if sweep.measured:
                self._outputs[topics.LOCKED.name].publish(codec.encode(Table(self._began_ns, sweep.newest)))
            return
        if sweep.measured:
            self._outputs[topics.CURVE.name].publish(codec.encode(Table(self._began_ns, sweep.rows)))
        if sweep.measured and isinstance(sweep, ControlledSine):
            self._outputs[topics.HELD.name].publish(codec.encode(Table(self._began_ns, sweep.held)))

    # Messages

    def _follow(self, topic: topics.Topic, callback: Callable[[Operator[Walk], Table], None]) -> Any:
        """Subscribe to a table topic; `callback` gets the operator, and tables newer than the sweep's begin."""

        def take(table: Table) -> None:
            operator = self._operator
            if operator is not None and operator.busy and table.stamp_ns >= self._began_ns:
                callback(operator, table)

        return self.subscribe_table(topic, take)

    def _on_info(self, info: Table) -> None:
        self._info = info

    def _on_scan(self, table: Table) -> None:
        self._scans_heard = True
        try:
            if self._operator is not None:
                self._operator.hear(News(now_ns=self.now_ns(), scans=[table]))
        finally:  # a rig that waits for us must not be held up
            assert self._acknowledgements is not None
            self._acknowledgements.processed(table.stamp_ns)

    def _on_time(self, data: bytes) -> None:
        try:
            self._now_ns = codec.header_stamp_ns(data)
        except CodecError as error:
            self.refuse(MONITORS["base"].name, str(error))
            return
        if self._operator is not None:
            self._operator.hear(News(now_ns=self._now_ns))

    def _on_applied(self, operator: Operator[Walk], table: Table) -> None:
        operator.hear(News(now_ns=self.now_ns(), applied=Applied.of(table)))

    def _on_journal(self, operator: Operator[Walk], table: Table) -> None:
        for row in table.rows:
            if bytes(row["kind"]) in STOPPING:
                cause = f" ({bytes(row['key']).decode(errors='replace')})" if row["key"] else ""
                operator.abort(f"the rig {STOPPING[bytes(row['kind'])]}{cause}")

    def _on_measurement(self, operator: Operator[Walk], table: Table) -> None:
        operator.hear(News(now_ns=table.stamp_ns, rows=table.rows))


def main(ending: Ending) -> None:
    """Run the stepped-sine node."""
    process.main(SteppedSineNode, ending)
