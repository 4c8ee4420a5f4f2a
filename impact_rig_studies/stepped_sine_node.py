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
"""ROS node that runs a sweep (measures a curve) or a phase lock (finds and holds a resonance) on a rig."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any  # rclpy messages

import attrs
from std_msgs.msg import Float64, String
from std_srvs.srv import Trigger

from impact_rig import codec, states, topics
from impact_rig.blocks import Table
from impact_rig.config.fields import choice, switch
from impact_rig.config.tree import Tree
from impact_rig.errors import CodecError, ConfigError, ImpactRigError
from impact_rig.names import one_line
from impact_rig.nodes.acknowledgements import Acknowledgements
from impact_rig.nodes.managed import Done, Level, ManagedNode, NodeState
from impact_rig.nodes.messages import MONITORS
from impact_rig.rig.journal import InputKind, JournalEntry
from impact_rig_studies.operate.operator import Applied, ControllerRun, Operator, Update
from impact_rig_studies.operate.phase_lock import LockedSine
from impact_rig_studies.operate.plans import Hold, HoldPlan, LockPlan, LockSettings, SweepPlan
from impact_rig_studies.operate.stepped_sine import ControlledSine, Setpoint, SteppedSine, SweepState

WATCH_S = 0.1  # interval at which the node checks for the rig while a sweep waits to start
STOPPING = {
    InputKind.TRIP: "tripped",
    InputKind.STOP: "was stopped",
    InputKind.TIMEOUT: "received no commands in time",
    InputKind.RESET: "was reset",
}
"""Kind of a journal entry that aborts a sweep -> verb that completes "the rig ..." in the reason."""
COMMAND, PHASE = "command", "phase"  # values of `hold` in addition to the amplitudes of `Hold`


@attrs.frozen(kw_only=True)
class SteppedSineSettings(SweepPlan, HoldPlan, LockSettings):
    """Parameters of the stepped-sine node: the points of a sweep, the quantity held constant, and when to begin."""

    hold: str = choice(
        COMMAND,
        (COMMAND, *Hold, PHASE),
        "Constant quantity: the commanded current, a measured amplitude (the current is adjusted), or the phase at -90 "
        "degrees (the frequency is adjusted, starting at the first point).",
    )
    begin: bool = switch(
        False, "Start the sweep as soon as the rig is running; false waits for the service ~/start.", read_only=True
    )
    autostart: bool = switch(True, "Configure and activate at start without a request.", read_only=True)

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        if self.hold == PHASE:
            first, lock = self.points()[0], LockPlan()
            if not lock.low_hz < first < lock.high_hz:
                raise ConfigError(
                    f"with hold: {PHASE}, the first frequency of the sweep (frequencies_hz, direction) must be > "
                    f"{lock.low_hz:g} and < {lock.high_hz:g} Hz, the fixed range of the phase lock, got {first:g}"
                )

    def lock_plan(self) -> LockPlan:
        """Return the plan of a phase lock whose search for the resonance begins at the first frequency of the sweep."""
        names = ("current_a", "superior_limit_m", *(attribute.name for attribute in attrs.fields(LockSettings)))
        return LockPlan(start_hz=self.points()[0], **{name: getattr(self, name) for name in names})

    def sweep(self) -> SteppedSine:
        """Return a new sweep with a constant current (`hold` is `command`) or with a controlled amplitude.

        Do not call this for a phase lock.
        """
        return SteppedSine(self) if self.hold == COMMAND else ControlledSine(self, self)


class SteppedSineNode(ManagedNode[SteppedSineSettings]):
    """Lifecycle node that runs a sweep or a phase lock on a rig, and publishes the measurements.

    For a phase lock, the node also subscribes to the scans. It acknowledges each block of scans, so that a rig in
    lockstep can wait for the node.
    """

    COMPONENT = "sweep"
    STATES = states.SteppedSineWord

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("stepped_sine", Tree(SteppedSineSettings), **kwargs)
        self._operator: Operator[ControllerRun] | None = None
        self._acknowledgements = Acknowledgements(self)
        self._pending = False  # a start was requested, but something is still missing (`_missing`)
        self._now_ns: int | None = None
        self._info: Table | None = None
        self._scans: Any = None  # subscription while the phase is held
        self._scans_heard = False
        self._began_ns = 0
        self._published = 0  # rows of the present run
        self.service(Trigger, "~/start", self._on_start)
        self.service(Trigger, "~/stop", self._on_stop)

    def configure(self) -> None:
        """Create the publishers of the commands (frequency, current), the measured sweep, and acknowledgements."""
        self.offer(topics.FREQUENCY, topics.CURRENT, topics.SWEEP, topics.ACK)

    def activate(self) -> None:
        """Subscribe to the topics of rig and analysis, and start a sweep if `begin` is set.

        The sweep starts as soon as everything that it needs is available, such as a running rig.
        """
        self._now_ns, self._pending = None, self.settings.begin
        self.until_deactivated(
            self.subscribe(MONITORS["base"], self._on_time, raw=True),
            self._follow(topics.APPLIED, self._on_applied),
            self.subscribe(topics.JOURNAL, self._on_journal),
            self._follow(topics.TRANSMISSIBILITY_TABLE, self._on_measurement),
            self.subscribe_table(topics.INFO, self._on_info),
        )
        self._listen(self.settings)
        self.every(WATCH_S, self._begin_when_ready)

    def deactivate(self) -> None:
        """Abort a running sweep, which commands zero current, and unsubscribe from the scans.

        All received blocks of scans are acknowledged. If ROS is shut down already, nothing is aborted or commanded.
        """
        if self._operator is not None and self.context.ok():
            self._operator.abort("the node was deactivated")
        self._acknowledgements.flush()
        if self._scans is not None:
            self.destroy_subscription(self._scans)
        self._scans = self._info = None

    def cleanup(self) -> None:
        """Discard the result of the last sweep."""
        self._operator = None

    def settings_changed(self, settings: SteppedSineSettings, changes: dict[str, Any]) -> None:
        """Apply changed parameters to the next sweep.

        An active node also subscribes to the scans if the next sweep is a phase lock, and unsubscribes otherwise.

        Raises:
            ConfigError: a sweep is running.
        """
        if self._running:
            raise ConfigError(f"cannot change {', '.join(sorted(changes))} while a sweep is running; call ~/stop first")
        if self.active:
            self._listen(settings)

    def _listen(self, settings: SteppedSineSettings) -> None:
        """Subscribe to the scans if these settings request a phase lock, and unsubscribe otherwise."""
        wanted = settings.hold == PHASE
        if wanted and self._scans is None:
            self._scans_heard = False
            self._scans = self.subscribe_table(topics.SCAN, self._on_scan)
        elif not wanted and self._scans is not None:
            self.destroy_subscription(self._scans)
            self._scans = None

    def rig_time_ns(self) -> int | None:
        """Return the rig time of the newest base displacement [ns]; None if none arrived since the activation."""
        return self._now_ns

    def doing(self) -> NodeState:
        """Return the state that the node publishes: idle, waiting, running, done or aborted.

        The states waiting and aborted have a reason.
        """
        words = states.SteppedSineWord
        if self._pending:
            return NodeState(words.WAITING, self._missing() or "about to begin")
        if self._operator is None:
            return NodeState(words.IDLE)
        sweep = self._operator.run
        if sweep.state is SweepState.ABORTED:
            return NodeState(words.ABORTED, sweep.reason)
        return NodeState(words.RUNNING if self._operator.busy else words.DONE)

    def health(self) -> tuple[Level, str]:
        """Return level and text for diagnostics: progress or abort of the sweep, or what prevents its start.

        If the node is not active, the text is the lifecycle state.
        """
        if self.state != "active":
            return Level.WARN, self.state
        if self._pending:
            return Level.WARN, self._missing() or "about to begin"
        if self._operator is None:
            return Level.OK, "idle"
        sweep = self._operator.run
        if sweep.state is SweepState.ABORTED:
            return Level.ERROR, f"aborted: {sweep.reason}"
        return Level.OK, sweep.describe()

    def figures(self) -> Mapping[str, object]:
        """Return numbers about the running or last sweep by name, for the diagnostics.

        The result is empty if the node is not active, has had no sweep, or waits to begin a sweep.
        """
        if self.state != "active" or self._pending or self._operator is None:
            return {}
        return self._operator.run.figures()

    # Start and stop

    def _on_start(self, _request: Trigger.Request, done: Done) -> None:
        if not self.active:  # without its publishers, which `_missing` asks
            raise ImpactRigError(f"the node is {self.why_not_active()}")
        if refusal := "a sweep is running already; call ~/stop first" if self._running else self._missing():
            raise ImpactRigError(refusal)
        self._begin()
        done(True, self._announced())

    def _on_stop(self, _request: Trigger.Request, done: Done) -> None:
        waited, self._pending = self._pending, False
        if self._operator is None or not self._operator.busy:
            done(True, "the sweep that waited to begin is cancelled" if waited else "no sweep is running")
            return
        self._operator.abort("stopped by the operator")
        done(True, "sweep stopped; the shaker ramps to rest")

    def _announced(self) -> str:
        points = self.settings.points()
        if self.settings.hold == PHASE:
            return f"started: searching for the resonance from {points[0]:g} Hz on"
        return f"sweep of {len(points)} points started"

    @property
    def _running(self) -> bool:
        return self._operator is not None and self._operator.busy

    def _missing(self) -> str:
        """Return why a sweep cannot start yet, as a text for the user; empty if it can start."""
        commands = topics.FREQUENCY.name, topics.CURRENT.name
        if silent := [name for name in commands if not self.outputs[name].get_subscription_count()]:
            return f"no rig subscribes to {' and '.join(silent)}: start a rig in the same namespace"
        if self.settings.hold == PHASE:
            if self._info is None or not self._scans_heard:
                topic = topics.SCAN if self._info is not None else topics.INFO
                return f"nothing received on {topic.name} yet: activate the rig if it is not running"
        elif not self.count_publishers(topics.TRANSMISSIBILITY_TABLE.name):
            return f"no publisher of {topics.TRANSMISSIBILITY_TABLE.name}: start and configure an analysis node"
        if self._now_ns is None:
            return f"nothing received on {MONITORS['base'].name} yet: activate the rig if it is not running"
        return ""

    def _begin_when_ready(self) -> None:
        if self._pending and not self._missing():
            self._begin()

    def _begin(self) -> None:
        self._pending = False
        self._began_ns, self._published = self.now_ns(), 0
        self._operator = Operator(self._new_run(), self._drive, self._publish_new_rows)
        self._operator.begin(self.now_ns())

    def _new_run(self) -> ControllerRun:
        settings = self.settings
        if settings.hold != PHASE:
            return settings.sweep()
        assert self._info is not None
        return LockedSine(settings.lock_plan(), self._info.rows, settings.accept_limit_s)

    # Interface of the operator

    def now_ns(self) -> int:
        """Return the rig time of the newest base displacement [ns]; 0 if none arrived since the activation."""
        return self._now_ns or 0

    def _drive(self, setpoint: Setpoint) -> None:
        """Publish frequency and current of a setpoint as commands for the rig.

        At the end of the sweep, publish zero current instead, and log the result or the reason of an abort.
        """
        assert self._operator is not None
        if self._operator.busy:
            self.send(topics.FREQUENCY, Float64(data=setpoint.frequency_hz))
            self.send(topics.CURRENT, Float64(data=setpoint.current_a))
            return
        self.send(topics.CURRENT, Float64(data=0.0))
        run = self._operator.run
        if run.state is SweepState.ABORTED:
            self.get_logger().error(one_line(f"sweep aborted: {run.reason}"))
        else:
            self.get_logger().info(f"sweep finished; measurements published on {topics.SWEEP.name}: {run.measured}")

    def _publish_new_rows(self, run: ControllerRun) -> None:
        if run.measured > self._published:
            self.send_table(topics.SWEEP, Table(self._began_ns, run.sweep_from(self._published)))
            self._published = run.measured

    # Messages

    def _follow(self, topic: topics.Topic, callback: Callable[[Operator[ControllerRun], Table], None]) -> Any:
        """Subscribe to a topic of tables for the running sweep, and return the subscription.

        `callback` receives the operator of the sweep, and each table. Tables are ignored while no sweep is running, and
        if their stamp is before the start of the sweep.
        """

        def take(table: Table) -> None:
            operator = self._operator
            if operator is not None and operator.busy and table.stamp_ns >= self._began_ns:
                callback(operator, table)

        return self.subscribe_table(topic, take)

    def _on_info(self, info: Table) -> None:
        self._info = info
        self.adopt_frame(info)

    def _on_scan(self, table: Table) -> None:
        self._scans_heard = True
        try:
            if self._operator is not None:
                self._operator.handle(Update(now_ns=self.now_ns(), scans=[table]))
        finally:  # a rig in lockstep must not be blocked
            self._acknowledgements.processed(table.stamp_ns)

    def _on_time(self, data: bytes) -> None:
        try:
            self._now_ns = codec.header_stamp_ns(data)
        except CodecError as error:
            self.refuse(MONITORS["base"].name, str(error))
            return
        if self._operator is not None:
            self._operator.handle(Update(now_ns=self._now_ns))

    def _on_applied(self, operator: Operator[ControllerRun], table: Table) -> None:
        operator.handle(Update(now_ns=self.now_ns(), applied=Applied.of(table)))

    def _on_journal(self, message: String) -> None:
        operator = self._operator
        try:
            entry = JournalEntry.from_line(message.data)
        except ConfigError as error:
            self.refuse(topics.JOURNAL.name, str(error))
            return
        concerns_sweep = operator is not None and operator.busy and entry.stamp_ns >= self._began_ns
        if operator is not None and concerns_sweep and entry.kind in STOPPING:
            operator.abort(f"the rig {STOPPING[entry.kind]}" + f" ({entry.name})" * bool(entry.name))

    def _on_measurement(self, operator: Operator[ControllerRun], table: Table) -> None:
        operator.handle(Update(now_ns=table.stamp_ns, rows=table.rows))


PROGRAM = SteppedSineNode
"""Class of the node that the console script of this module runs."""
