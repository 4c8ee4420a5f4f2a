# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Blocks as standard messages for plotters, as bytes: one template per topic, filled with what an instrument says.

Scans at 10 kS/s shown at 50 Hz would fold every pulse into nonsense, so readings go through a low-pass first: a
windowed sinc (Kaiser, beta 5; Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.5) as long as eight
monitor periods, centred at the scan whose stamp the message has: no phase is lost, and the message comes four periods
later. With f_m the monitor rate the gain is within 0.5 % of 1 up to 0.2 f_m and below 0.4 % from 0.6 f_m on, so that
nothing folds to below 0.4 f_m. The truth is never filtered.
"""

from __future__ import annotations

import functools
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping

import attrs
import numpy as np
from numpy.typing import NDArray
from rosgraph_msgs.msg import Clock

from impact_rig import topics
from impact_rig.instruments.instrument import Instrument
from impact_rig.nodes import messages
from impact_rig.nodes.messages import Template, put
from impact_rig.nodes.topics import MONITORS
from impact_rig.rig import Block
from impact_rig.rig.config import RigConfig
from impact_rig.rig.description import JOINTS
from impact_rig.rig.truth import monitor_step
from impact_rig.simtime import stamp_ns

Array = NDArray[np.float64]

HALF_PERIODS = 4
"""Half the filter's length, in monitor periods: how much later than its stamp a message comes."""
CUTOFF = 0.4
"""Middle of the transition, over the monitor rate."""
BETA = 5.0

_PLACES = [f"{name}.{joint}" for name in ("position", "velocity") for joint in range(3)] + ["effort.1", "effort.2"]

CLOCK = Template(Clock())
"""`/clock`: nothing but a stamp."""

Reading = Callable[[int, float, int], bytes]
"""Makes an instrument's message of (stamp [ns], reading, status bits)."""


@functools.lru_cache(maxsize=4)
def taps(step: int) -> Array:
    """Return the filter for a monitor of every `step`-th scan, shape (8 step + 1,), of sum 1."""
    if step == 1:
        return np.ones(1)
    offsets = np.arange(-HALF_PERIODS * step, HALF_PERIODS * step + 1)
    weights = np.sinc(2.0 * CUTOFF * offsets / step) * np.kaiser(len(offsets), BETA)
    found: Array = weights / weights.sum()
    return found


@attrs.frozen
class Smoothed:
    """A monitor instant: its scan since the start, the filtered channels, and the channels that were over range."""

    sample: int
    values: dict[str, float]
    status: int


class AntiAlias:
    """Filters a stream of scans at the monitor instants.

    Args:
        channels: columns that are wanted.
        step: scans per monitor period.
    """

    def __init__(self, channels: Iterable[str], step: int) -> None:
        self._channels = tuple(channels)
        self._step = step
        self._taps = taps(step)
        self._half = len(self._taps) // 2
        self._scans = np.zeros((len(self._channels), 0))
        self._status = np.zeros(0, np.uint8)
        self._first = self._next = 0  # numbers of the first scan that is kept, and of the one after the last
        self._due: deque[int] = deque()

    def feed(self, first: int, rows: NDArray[np.void], instants: Iterable[int]) -> Iterator[Smoothed]:
        """Yield the instants that a block completes; after a gap, as after a reset, a new stream begins.

        At the beginning of a stream the filter is cut where there are no scans, and weighs what there is.

        Args:
            first: number of the block's first scan.
            rows: of daq/scan.
            instants: monitor instants in the block, numbered like the scans.
        """
        if first != self._next:
            self._due.clear()
            self._first = self._next = first
        self._make_room(len(rows))
        begin, end = self._next - self._first, self._next - self._first + len(rows)
        for kept, name in zip(self._scans, self._channels, strict=True):
            kept[begin:end] = rows[name]
        self._status[begin:end] = rows["status"]
        self._next += len(rows)
        self._due.extend(instants)
        while self._due and self._due[0] + self._half < self._next:
            yield self._smoothed(self._due.popleft())

    def _make_room(self, count: int) -> None:
        """Forget what no instant needs any more, once the room for so many more scans is used up."""
        if self._next - self._first + count <= len(self._status):
            return
        oldest = (self._due[0] if self._due else self._next) - self._half - self._step
        used, begin = self._next - self._first, max(0, oldest - self._first)
        kept, flags = self._scans[:, begin:used], self._status[begin:used]
        room = 2 * (used - begin + count)
        self._scans, self._status = np.zeros((len(self._channels), room)), np.zeros(room, np.uint8)
        self._scans[:, : used - begin], self._status[: used - begin] = kept, flags
        self._first += begin

    def _smoothed(self, sample: int) -> Smoothed:
        centre = sample - self._first
        left = max(0, centre - self._half)
        weights = self._taps[left - centre + self._half :]
        sums = (self._scans[:, left : centre + self._half + 1] * weights).sum(axis=1) / weights.sum()
        near = self._status[max(0, centre - self._step + 1) : centre + self._step]
        return Smoothed(sample, dict(zip(self._channels, sums.tolist(), strict=True)), int(np.bitwise_or.reduce(near)))


class Monitors:
    """Turns blocks into the messages of the monitor topics.

    Args:
        config: configuration in force, for ranges and variances.
        noise: rms noise by channel name, in its unit, as in daq/info.
        before: the monitors of the configuration before; what they filter goes on where channels and rate are the same.
    """

    def __init__(self, config: RigConfig, noise: dict[str, float], before: Monitors | None = None) -> None:
        self._rate_hz = config.daq.rate_hz
        self._step = monitor_step(config.daq.rate_hz, config.output.monitor_rate_hz)
        self._readings: dict[str, tuple[topics.Topic, Reading]] = {}
        for bit, instrument in enumerate(config.instruments.fitted()):
            if instrument.name in MONITORS:
                topic = MONITORS[instrument.name]
                self._readings[instrument.name] = topic, _reading(config, instrument, 1 << bit, noise[instrument.name])
        self._joint_states = _joint_states(config)
        same = before is not None and (before._step, [*before._readings]) == (self._step, [*self._readings])
        self._filter: AntiAlias | None = before._filter if before is not None and same else None

    def messages(self, block: Block, wanted: Callable[[topics.Topic], bool]) -> Iterator[tuple[topics.Topic, bytes]]:
        """Yield the wanted monitor messages that a block completes, each topic in time order.

        Readings are filtered and come four monitor periods later; the truth is not, and comes at once.
        """
        start_ns = block.scan.stamp_ns - stamp_ns(block.first_sample, self._rate_hz)
        instants = (block.first_sample + block.monitor_scans).tolist()
        if wanted(topics.JOINT_STATES):
            for sample, truth in zip(instants, block.monitor, strict=True):
                yield topics.JOINT_STATES, self._joint_states(stamp_ns(sample, self._rate_hz, start_ns), truth)
        readings = {name: reading for name, reading in self._readings.items() if wanted(reading[0])}
        if not readings:
            self._filter = None
            return
        if self._filter is None:
            self._filter = AntiAlias(self._readings, self._step)
        for smoothed in self._filter.feed(block.first_sample, block.scan.rows, instants):
            stamp = stamp_ns(smoothed.sample, self._rate_hz, start_ns)
            for name, (topic, render) in readings.items():
                yield topic, render(stamp, smoothed.values[name], smoothed.status)


def _reading(config: RigConfig, instrument: Instrument, bit: int, noise: float) -> Reading:
    """Return the renderer of one instrument's message: its numbers change, its sequences do not."""
    fields = instrument.message(0.0, False, noise)
    changing = [path for path, value in fields.items() if isinstance(value, float)]
    template = _template(config, MONITORS[instrument.name], fields, changing)

    def render(stamp: int, reading: float, status: int) -> bytes:
        values = instrument.message(reading, bool(status & bit), noise)
        return template.render(stamp, *(values[path] for path in changing))

    return render


def _joint_states(config: RigConfig) -> Callable[[int, np.void], bytes]:
    """Return the renderer of the true state; effort is the contact force on each body, both walls push the sphere."""
    zeros = [0.0] * len(JOINTS)
    template = _template(
        config,
        topics.JOINT_STATES,
        {"name": list(JOINTS), "position": zeros, "velocity": zeros, "effort": zeros},
        _PLACES,
    )

    def render(stamp: int, truth: np.void) -> bytes:
        push = truth["force_left"] - truth["force_right"]
        moving = (truth[name] for name in ("x_b", "x_1", "x_2", "v_b", "v_1", "v_2"))
        return template.render(stamp, *moving, -push, push)

    return render


def _template(config: RigConfig, topic: topics.Topic, fields: Mapping[str, object], changing: list[str]) -> Template:
    message = messages.class_of(topic)()
    message.header.frame_id = config.output.frame_prefix + topic.frame_id
    for path, value in fields.items():
        put(message, path, value)
    return Template(message, *changing)
