# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Blocks as standard messages for plotters, as bytes: one template per topic, filled with what an instrument says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from rosgraph_msgs.msg import Clock

from impact_rig import topics
from impact_rig.instruments.instrument import Instrument
from impact_rig.nodes import messages
from impact_rig.nodes.anti_alias import AntiAlias
from impact_rig.nodes.template import Template, put
from impact_rig.nodes.topics import MONITORS
from impact_rig.rig import Block
from impact_rig.rig.config import RigConfig
from impact_rig.rig.description import JOINTS
from impact_rig.rig.truth import monitor_step
from impact_rig.simtime import stamp_ns

_PLACES = [f"{name}.{joint}" for name in ("position", "velocity") for joint in range(3)] + ["effort.1", "effort.2"]

CLOCK = Template(Clock())
"""`/clock`: nothing but a stamp."""

Reading = Callable[[int, float, int], bytes]
"""Makes an instrument's message of (stamp [ns], reading, status bits)."""


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
