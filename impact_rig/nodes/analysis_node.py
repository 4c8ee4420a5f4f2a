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
"""Analysis as a lifecycle node: it reads blocks of scans and publishes transmissibility and impacts.

The node handles topics and parameters; `impact_rig.analysis.tracker.Tracker` computes the results.
"""

from __future__ import annotations

import contextlib
import math
import time
from typing import Any  # rclpy messages

import attrs
from std_msgs.msg import Float64, String

from impact_rig import codec, states, topics
from impact_rig.analysis.blockwise import ANALYSES, Blockwise
from impact_rig.analysis.settings import TrackerSettings, parse_label, settings_table
from impact_rig.analysis.tracker import NOTHING, Findings, Tracker
from impact_rig.blocks import Table
from impact_rig.config.fields import quantity, switch
from impact_rig.config.tree import Tree
from impact_rig.errors import CodecError, ConfigError, ImpactRigError
from impact_rig.nodes.acknowledgements import Acknowledgements
from impact_rig.nodes.managed import Level, ManagedNode, NodeState
from impact_rig.nodes.messages import TOPICS
from impact_rig.simtime import NS_PER_S

PUBLISHED = [topic for topic in TOPICS if topic.publisher == "analysis"]
UNCALIBRATED = (
    "scans arrive without their calibration (daq/info), so nothing can be measured; a bag played with ros2 bag play "
    "--start-offset lacks it: play it from its start"
)
SILENCE_S = 2.0  # wall time without a block after which scans count as missing; a paused rig sends none either
UNKNOWN_GAP = -1.0


@attrs.frozen(kw_only=True)
class AnalysisSettings(TrackerSettings):
    """Parameters of the analysis node: those of `Tracker`, the operator's label of the gap, and `autostart`.

    The results contain the label. It also limits how long a row of the results waits for impacts.
    """

    gap_m: float = quantity(
        UNKNOWN_GAP,
        "m",
        "Operator's label of the measurements: total gap between the barriers; 0 = no sphere, -1 = unknown. A change "
        "applies from the newest scan on.",
        at_least=UNKNOWN_GAP,
        at_most=1,
    )
    autostart: bool = switch(True, "Configure and activate at start without a request.", read_only=True)

    def __attrs_post_init__(self) -> None:
        super().__attrs_post_init__()
        if UNKNOWN_GAP < self.gap_m < 0:
            raise ConfigError(f"gap_m must be > 0 and <= 1 m, 0 for no sphere, or -1 for unknown, got {self.gap_m!r} m")


class AnalysisNode(ManagedNode[AnalysisSettings]):
    """Lifecycle node that passes scans to `Tracker`, publishes the results and acknowledges every block of scans."""

    COMPONENT = "measurement"
    STATES = states.AnalysisWord

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("analysis", Tree(AnalysisSettings), **kwargs)
        self._tracker: Tracker | None = None
        self._blockwise: list[Blockwise] = []
        self._acknowledgements = Acknowledgements(self)
        self._newest: Table | None = None
        self._heard_at = self._started_s = 0.0
        self._latest = math.nan

    def configure(self) -> None:
        """Create the publishers of the results and of the acknowledgements (`daq/ack`)."""
        self.offer(*PUBLISHED, topics.ACK)

    def activate(self) -> None:
        """Start a new measurement with the present settings; subscribe to scans, calibration, drive and gap labels."""
        names = [name for name, _, _ in Tree(TrackerSettings).fields()]
        self._tracker = Tracker(TrackerSettings(**{name: getattr(self.settings, name) for name in names}))
        self._blockwise = [analysis() for analysis in ANALYSES]
        self._newest = None
        self._started_s = time.time()
        self._label(_gap(self.settings), 0)
        # subscribe to calibration and active command first: both are latched, and arrive although published long ago
        self.until_deactivated(
            self.subscribe_table(topics.INFO, self._on_info),
            self.subscribe_table(topics.APPLIED, self._on_applied),
            self.subscribe(topics.NOTES, self._on_note),
            self.subscribe(topics.SCAN, self._on_scan, raw=True),
        )

    def deactivate(self) -> None:
        """Publish the last results (`Tracker.flush`), and acknowledge the last processed blocks of scans.

        The last results include delayed rows, but no extra row for a response that is still settling.
        """
        tracker, self._tracker = self._tracker, None
        try:
            if tracker is not None and self.context.ok():
                self._publish(tracker.flush())
        finally:  # otherwise the next activation would use a timer that does not run
            self._acknowledgements.flush()

    def settings_changed(self, settings: AnalysisSettings, changes: dict[str, Any]) -> None:
        """Apply a new gap label from the newest scan received on; an inactive node only stores its settings.

        Raises:
            ConfigError: another setting would change while the node is active; deactivate it first.
        """
        fixed = sorted(set(changes) - {"gap_m"})
        if self._tracker is None:
            return
        if fixed:
            raise ConfigError(f"cannot change {', '.join(fixed)} while the analysis is active; deactivate it first")
        if "gap_m" in changes:
            self._label(_gap(settings), self.rig_time_ns() or 0)

    def rig_time_ns(self) -> int | None:
        """Return the rig time of the newest scan received [ns], for the stamp of diagnostics; None before the first."""
        if self._newest is None:
            return None
        last_s = float(self._newest.rows["time"][-1]) if len(self._newest.rows) else 0.0
        return self._newest.stamp_ns + round(last_s * NS_PER_S)

    def doing(self) -> NodeState:
        """Return the state of the measurement.

        The state is `no_scans` before the first block of scans, and if no block has arrived for 2 s of wall time.
        """
        words = states.AnalysisWord
        if self._tracker is None or self._newest is None:
            return NodeState(words.NO_SCANS, "no scans received yet")
        silent_s = time.monotonic() - self._heard_at
        if silent_s > SILENCE_S:
            return NodeState(words.NO_SCANS, f"no scans received for {SILENCE_S:g} s")
        found = self._tracker.state
        return NodeState(words(found.word), self._waiting() or found.reason, found.since_ns)

    def health(self) -> tuple[Level, str]:
        """Return level and message of diagnostics.

        The level is a warning if the node is inactive, if scans arrive without calibration, or if scans were lost since
        the activation. Otherwise it is OK, also if the displacement transmissibility (DT) cannot be measured.
        """
        if self._tracker is None:
            return Level.WARN, self.state
        if self._newest is None:
            return Level.OK, "waiting for the first scans on daq/scan"
        if not self._tracker.is_calibrated:
            return Level.WARN, UNCALIBRATED
        if self._tracker.counters.lost_scans:
            return Level.WARN, "some scans were lost since the activation: the value lost_scans is their number"
        why = self._waiting()
        return Level.OK, self._tracker.state.word.replace("_", " ") + (f": {why}" if why else "")

    def figures(self) -> dict[str, object]:
        """Return values for diagnostics: newest settled transmissibility, gap label, counters, progress of settling.

        The transmissibility is NaN until a response settles for the first time since the node started, and is kept when
        the node is activated again. An inactive node has no values.
        """
        tracker = self._tracker
        if tracker is None:
            return {}
        values: dict[str, object] = {"transmissibility": self._latest, "gap_m": self.settings.gap_m}
        values |= attrs.asdict(tracker.counters)
        progress = tracker.progress
        if progress is not None:
            values |= {
                "settling_windows": progress.windows,
                "settling_windows_needed": progress.needed,
                "settling_remnant": progress.remnant,
                "no_impact_s": progress.quiet.since_s if progress.reason else 0.0,
                "no_impact_limit_s": progress.quiet.bound_s if progress.reason else 0.0,
            }
        return values

    def _waiting(self) -> str:
        """Return why the next row of `transmissibility/table` is delayed.

        The text is empty if no row is delayed, or if the row only waits for the transient of the response.
        """
        progress = None if self._tracker is None else self._tracker.progress
        return "" if progress is None else progress.reason

    def _label(self, gap_m: float, stamp_ns: int) -> None:
        """Label the scans from rig time `stamp_ns` on with a gap [m], and publish the label on `analysis/settings`."""
        assert self._tracker is not None
        self._tracker.label(gap_m, stamp_ns)
        table = settings_table(self.settings, gap_m, stamp_ns, self._started_s)
        self.send_table(topics.ANALYSIS_SETTINGS, table)

    # Messages

    def _on_info(self, info: Table) -> None:
        if self._tracker is not None:
            self._tracker.configure(info)
            self.adopt_frame(info)

    def _on_applied(self, applied: Table) -> None:
        if self._tracker is not None:
            self._tracker.on_applied(applied)

    def _on_note(self, message: String) -> None:
        label = parse_label(message.data)
        if label is not None and self._tracker is not None:
            self._label(label.gap_m, label.stamp_ns)

    def _on_scan(self, data: bytes) -> None:
        scan = self.table(topics.SCAN, data)
        if self._tracker is None:
            return
        if scan is None:  # a rig in lockstep must not be blocked by invalid scans
            with contextlib.suppress(CodecError):  # logged already
                self._acknowledgements.processed(codec.header_stamp_ns(data))
            return
        try:
            before = self._tracker.state
            found = self._tracker.feed(scan)
            if found is not NOTHING:
                self._publish(found)
            if self._tracker.state.word != before.word:
                self.report_change()
            if self._blockwise:
                self._analyse(scan)
        except ImpactRigError as error:
            self.refuse(topics.SCAN.name, str(error))
        finally:
            self._newest, self._heard_at = scan, time.monotonic()
            self._acknowledgements.processed(scan.stamp_ns)

    def _publish(self, findings: Findings) -> None:
        for table in findings.impacts:
            self.send_table(topics.IMPACTS, table)
        for table in findings.measurements:
            self.send_table(topics.TRANSMISSIBILITY_TABLE, table)
            for row in table.rows:
                if row["settled"] == 1:
                    self._latest = float(row["transmissibility"])
                    self.send(topics.TRANSMISSIBILITY, Float64(data=self._latest))

    def _analyse(self, scan: Table) -> None:
        """Pass a block of scans to each of the `ANALYSES` whose channels it contains, and publish their results.

        The analyses also get the blocks that arrive before the calibration.
        """
        for analysis in self._blockwise:
            if set(analysis.needs) <= set(scan.rows.dtype.names or ()):
                table = analysis.feed(scan)
                if table is not None:
                    self.send_table(analysis.topic, table)


def _gap(settings: AnalysisSettings) -> float:
    return math.nan if settings.gap_m == UNKNOWN_GAP else settings.gap_m


PROGRAM = AnalysisNode
"""Factory of the node for the program `analysis_node`."""
