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
"""What any plotter draws without knowing our tables: small stamped messages, made only where somebody listens."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any  # rclpy publishers, message classes

import numpy as np

from impact_rig import codec, topics
from impact_rig.analysis.blockwise import EVERY_S, PULSES, WINDOW_S, HighPass, Intervals, amplitude_spectrum
from impact_rig.analysis.scans import Recent
from impact_rig.blocks import MOST_HZ, Table
from impact_rig.nodes import messages
from impact_rig.nodes.messages import ENVELOPES, SPECTRA, Template
from impact_rig.topics import Topic

VECTOR = ("vector.x", "vector.y", "vector.z")
LOOK_S = 0.1  # time of the rig between two looks who listens to what


class Plots:
    """Makes the plot topics of the analysis node.

    Args:
        publishers: publisher by topic name; topics without one are left out.
        frame_prefix: text in front of the frames.
    """

    def __init__(self, publishers: Mapping[str, Any], frame_prefix: str = "") -> None:
        self._publishers = publishers
        self._set_prefix(frame_prefix)
        self._rate_hz = 0.0
        self._intervals: Intervals | None = None
        self._pulses: tuple[HighPass, Intervals] | None = None
        self._recent: Recent | None = None
        self._since_spectrum = 0
        self._since_drive = 0
        self._drive: tuple[float, float] | None = None
        self._followed = [topic.name for topic in _FOLLOWED if topic.name in publishers]
        self._listened_to: set[str] = set()
        self._until_look = 0

    def _set_prefix(self, frame_prefix: str) -> None:
        self._prefix = frame_prefix
        self._vectors = {topic.name: _vector(topic, frame_prefix) for topic in (*ENVELOPES.values(), *_VECTORS)}

    def configure(self, info: Table, frame_prefix: str = "") -> None:
        """Take the rate of the scans from daq/info, and the prefix of their frame."""
        if frame_prefix != self._prefix:
            self._set_prefix(frame_prefix)
        rates = info.rows["rate"]
        rate = float(rates[0]) if len(rates) else 0.0
        if rate != self._rate_hz and 0.0 < rate <= MOST_HZ:
            self._rate_hz = rate
            self._intervals = self._pulses = self._recent = None

    def on_applied(self, applied: Table) -> None:
        """Publish what the shaker does now."""
        for row in applied.rows:
            self._drive = float(row["frequency"]), float(row["current"])
            self._send(topics.PLOT_DRIVE, applied.stamp_ns, *self._drive, 0.0)
        self._since_drive = 0

    def measured(self, stamp_ns: int, row: np.void) -> None:
        """Publish a settled measurement, a row of transmissibility/table."""
        values = (row["transmissibility"], row["transmissibility_uncertainty"], row["phase"])
        self._send(topics.PLOT_TRANSMISSIBILITY, stamp_ns, *map(float, values))

    def feed(self, scan: Table) -> None:
        """Publish what a block of daq/scan completes, as far as anybody listens."""
        if not self._rate_hz or not len(scan.rows):
            return
        self._until_look -= len(scan.rows)
        if self._until_look < 0:
            self._look()
        self._since_drive += len(scan.rows)
        if not self._listened_to:
            self._intervals = self._pulses = self._recent = None
            return
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

    def _look(self) -> None:
        """Look who listens, ten times a second: to ask for each block costs as much as to measure it."""
        self._listened_to = {name for name in self._followed if self._publishers[name].get_subscription_count()}
        self._until_look = round(LOOK_S * self._rate_hz)

    def _heard(self, topic: Topic) -> bool:
        return topic.name in self._listened_to

    def _send(self, topic: Topic, stamp_ns: int, *values: float) -> None:
        self._publishers[topic.name].publish(self._vectors[topic.name].render(stamp_ns, *values))


ACCELEROMETER = "accelerometer"
_VECTORS = (topics.PLOT_TRANSMISSIBILITY, topics.PLOT_DRIVE, topics.PLOT_PULSES)
_FOLLOWED = (topics.PLOT_DRIVE, topics.PLOT_PULSES, *ENVELOPES.values(), *SPECTRA.values())
"""Made only where somebody listens; the others are rare."""


def _vector(topic: Topic, frame_prefix: str) -> Template:
    message = messages.class_of(topic)()
    message.header.frame_id = frame_prefix + topic.frame_id
    return Template(message, *VECTOR)
