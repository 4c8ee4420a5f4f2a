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
"""Node for plotters: it publishes envelopes, spectra and the drive as small stamped messages of standard types.

Plotters cannot decode the tables of the other topics. The node subscribes to scans only while a plotter subscribes to a
topic that is computed from them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any  # rclpy handles

import attrs
import numpy as np

from impact_rig import codec, states, topics
from impact_rig.analysis.blockwise import EVERY_S, PULSES, WINDOW_S, HighPass, Intervals, amplitude_spectrum
from impact_rig.analysis.scans import Recent
from impact_rig.blocks import Table
from impact_rig.config.fields import switch
from impact_rig.config.tree import Tree
from impact_rig.nodes import messages
from impact_rig.nodes.managed import ManagedNode, NodeState
from impact_rig.nodes.messages import ENVELOPES, SPECTRA, TOPICS, Template
from impact_rig.topics import Topic

VECTOR = ("vector.x", "vector.y", "vector.z")
POLL_S = 0.1  # wall time between two checks for subscribers
PUBLISHED = [topic for topic in TOPICS if topic.publisher == "plot"]


@attrs.frozen(kw_only=True)
class PlotSettings:
    """Parameters of the plot node."""

    autostart: bool = switch(True, "Configure and activate at start without a request.", read_only=True)


class PlotDataNode(ManagedNode[PlotSettings]):
    """Lifecycle node that publishes the topics `plot/...`, computed from scans, drive and measurements."""

    COMPONENT = "plots"
    STATES = states.PlotWord

    def __init__(self, **kwargs: Any) -> None:
        super().__init__("plot", Tree(PlotSettings), **kwargs)
        self._plots: Plots | None = None
        self._scans: Any = None  # subscription to scans, while a plotter needs them

    def configure(self) -> None:
        """Create the publishers of the topics `plot/...`."""
        self.offer(*PUBLISHED)

    def activate(self) -> None:
        """Subscribe to calibration, drive and measurements.

        From now on, the node also subscribes to the scans while a plotter needs them.
        """
        self._plots = Plots(self.outputs, self.frame_prefix)
        self.until_deactivated(
            self.subscribe_table(topics.INFO, self._on_info),
            self.subscribe_table(topics.APPLIED, self._plots.on_applied),
            self.subscribe_table(topics.TRANSMISSIBILITY_TABLE, self._plots.measured),
        )
        self.every(POLL_S, self._poll)

    def deactivate(self) -> None:
        """Unsubscribe from the scans and drop what was computed; the base class ends the other subscriptions."""
        self._unfollow()
        self._plots = None

    def doing(self) -> NodeState:
        """Return the state: `plotting` while a plotter subscribes to a topic computed from scans, otherwise `idle`."""
        words = states.PlotWord
        return NodeState(words.IDLE if self._scans is None else words.PLOTTING)

    def _on_info(self, info: Table) -> None:
        self.adopt_frame(info)
        if self._plots is not None:
            self._plots.configure(info, self.frame_prefix)

    def _poll(self) -> None:
        if self._plots is None:
            return
        wanted = self._plots.poll()
        if wanted and self._scans is None:
            self._scans = self.subscribe_table(topics.SCAN, self._plots.feed)
        elif not wanted:
            self._unfollow()

    def _unfollow(self) -> None:
        if self._scans is not None:
            self.destroy_subscription(self._scans)
            self._scans = None


class Plots:
    """Computation of the messages for plotters from the tables of a rig.

    Messages that are computed from scans are published only on topics with a subscriber.

    Args:
        publishers: publisher by topic name.
        frame_prefix: prefix of the frame names in the messages, until `configure` gets another one.
    """

    def __init__(self, publishers: Mapping[str, Any], frame_prefix: str) -> None:
        self._publishers = publishers
        self._set_prefix(frame_prefix)
        self._rate_hz = 0.0
        self._intervals: Intervals | None = None
        self._pulses: tuple[HighPass, Intervals] | None = None
        self._recent: Recent | None = None
        self._since_spectrum = 0
        self._since_drive = 0
        self._drive: tuple[float, float] | None = None
        self._listened_to: set[str] = set()

    def _set_prefix(self, frame_prefix: str) -> None:
        self._prefix = frame_prefix
        self._vectors = {topic.name: _vector(topic, frame_prefix) for topic in (*ENVELOPES.values(), *_VECTORS)}

    def configure(self, info: Table, frame_prefix: str) -> None:
        """Adopt the scan rate of a `daq/info` table, and a prefix of the frame names in the messages.

        If the scan rate changes, unfinished envelopes, pulses and spectra are dropped and start again.
        """
        if frame_prefix != self._prefix:
            self._set_prefix(frame_prefix)
        rate = float(info.rows["rate"][0]) if len(info.rows) else 0.0
        if rate != self._rate_hz:
            self._rate_hz = rate
            self._intervals = self._pulses = self._recent = None

    def on_applied(self, applied: Table) -> None:
        """Publish frequency [Hz] and amplitude of each row of `shaker/applied` on `plot/drive`.

        The unit of the amplitude is A, m or V, depending on the kind of drive.
        """
        for row in applied.rows:
            self._drive = float(row["frequency"]), float(row["current"])
            self._send(topics.PLOT_DRIVE, applied.stamp_ns, *self._drive, 0.0)
        self._since_drive = 0

    def measured(self, table: Table) -> None:
        """Publish the settled rows of a `transmissibility/table` on `plot/transmissibility`."""
        for row in table.rows[table.rows["settled"] == 1]:
            values = (row["transmissibility"], row["transmissibility_uncertainty"], row["phase"])
            self._send(topics.PLOT_TRANSMISSIBILITY, table.stamp_ns, *map(float, values))

    def poll(self) -> bool:
        """Store which topics computed from scans have subscribers, for `feed`; return whether at least one has."""
        self._listened_to = {topic.name for topic in _FOLLOWED if self._publishers[topic.name].get_subscription_count()}
        return bool(self._listened_to)

    def feed(self, scan: Table) -> None:
        """Publish the envelopes, spectra, pulses and drive that become due with this block of `daq/scan`.

        Only topics that had subscribers at the last `poll` are published. Before `configure`, nothing is published.
        """
        if not self._rate_hz or not len(scan.rows):
            return
        self._since_drive += len(scan.rows)
        if self._drive is not None and self._since_drive >= self._rate_hz * EVERY_S and self._heard(topics.PLOT_DRIVE):
            self._send(topics.PLOT_DRIVE, scan.stamp_ns, *self._drive, 0.0)
            self._since_drive = 0
        self._envelopes(scan)
        self._high_passed(scan)
        self._spectra(scan)

    def _envelopes(self, scan: Table) -> None:
        wanted = self._wanted(ENVELOPES, scan)
        if not wanted:
            self._intervals = None
            return
        self._intervals = self._intervals or Intervals(self._rate_hz)
        for interval in self._intervals.feed(scan):
            for channel, topic in wanted.items():
                self._send(topic, interval.stamp_ns, *interval.extremes(channel))

    def _high_passed(self, scan: Table) -> None:
        if not self._wanted({ACCELEROMETER: topics.PLOT_PULSES}, scan):
            self._pulses = None
            return
        if self._pulses is None:
            self._pulses = HighPass(self._rate_hz, ACCELEROMETER), Intervals(self._rate_hz)
        high_pass, intervals = self._pulses
        if not intervals.follows(scan):
            high_pass.restart()
        for interval in intervals.feed(high_pass.feed(scan)):
            self._send(topics.PLOT_PULSES, interval.stamp_ns, *interval.extremes(PULSES))

    def _spectra(self, scan: Table) -> None:
        wanted = self._wanted(SPECTRA, scan)
        if not wanted:
            self._recent = None
            return
        length = round(WINDOW_S * self._rate_hz)
        if self._recent is None:
            self._recent, self._since_spectrum = Recent(self._rate_hz, length), 0
        self._recent.add(scan)
        self._since_spectrum += len(scan.rows)
        if self._recent.count < length or self._since_spectrum < EVERY_S * self._rate_hz:
            return
        self._since_spectrum = 0
        rows = self._recent.rows()[-length:]
        for channel, topic in wanted.items():
            frequencies, amplitudes = amplitude_spectrum(rows[channel], self._rate_hz)
            points = np.column_stack((frequencies, amplitudes, np.zeros(len(frequencies))))
            stamp = self._recent.stamp_ns(self._recent.count - 1)
            self._publishers[topic.name].publish(codec.encode_polygon(stamp, self._prefix + topic.frame_id, points))

    def _wanted(self, by_channel: Mapping[str, Topic], scan: Table) -> dict[str, Topic]:
        names = scan.rows.dtype.names or ()
        return {channel: topic for channel, topic in by_channel.items() if channel in names and self._heard(topic)}

    def _heard(self, topic: Topic) -> bool:
        return topic.name in self._listened_to

    def _send(self, topic: Topic, stamp_ns: int, *values: float) -> None:
        self._publishers[topic.name].publish(self._vectors[topic.name].render(stamp_ns, *values))


ACCELEROMETER = "accelerometer"
_VECTORS = (topics.PLOT_TRANSMISSIBILITY, topics.PLOT_DRIVE, topics.PLOT_PULSES)
_FOLLOWED = (topics.PLOT_DRIVE, topics.PLOT_PULSES, *ENVELOPES.values(), *SPECTRA.values())
"""Topics that are computed from scans, and therefore need a subscription to scans while a plotter reads them."""


def _vector(topic: Topic, frame_prefix: str) -> Template:
    message = messages.class_of(topic)()
    message.header.frame_id = frame_prefix + topic.frame_id
    return Template(message, *VECTOR)


PROGRAM = PlotDataNode
"""Factory of the node for the program `plot_node`."""
