"""Blocks as standard messages for plotters, as bytes: one template per topic, filled with what an instrument says."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np
from rosgraph_msgs.msg import Clock

from impact_rig import topics
from impact_rig.instruments.instrument import Instrument
from impact_rig.nodes import messages
from impact_rig.nodes.template import Template, put
from impact_rig.nodes.topics import MONITORS
from impact_rig.rig import Block
from impact_rig.rig.config import RigConfig
from impact_rig.rig.description import JOINTS
from impact_rig.simtime import stamp_ns

_PLACES = [f"{name}.{joint}" for name in ("position", "velocity") for joint in range(3)] + ["effort.1", "effort.2"]

CLOCK = Template(Clock())
"""`/clock`: nothing but a stamp."""

Renderer = Callable[[int, np.void, np.void], bytes]
"""Makes the message of (stamp [ns], row of daq/scan, row of truth/scan)."""


class Monitors:
    """Turns blocks into the messages of the monitor topics.

    Args:
        config: configuration in force, for ranges and variances.
        noise: rms noise by channel name, in its unit, as in daq/info.
    """

    def __init__(self, config: RigConfig, noise: dict[str, float]) -> None:
        self._rate_hz = config.daq.rate_hz
        self._renderers: dict[str, tuple[topics.Topic, Renderer]] = {}
        for bit, instrument in enumerate(config.instruments.fitted()):
            if instrument.name in MONITORS:
                topic = MONITORS[instrument.name]
                self._renderers[topic.name] = topic, _reading(instrument, topic, 1 << bit, noise[instrument.name])
        self._renderers[topics.JOINT_STATES.name] = topics.JOINT_STATES, _joint_states()

    def messages(self, block: Block, wanted: Callable[[topics.Topic], bool]) -> Iterator[tuple[topics.Topic, bytes]]:
        """Yield the wanted monitor messages of a block, in time order."""
        renderers = [(topic, render) for topic, render in self._renderers.values() if wanted(topic)]
        if not renderers:
            return
        start_ns = block.scan.stamp_ns - stamp_ns(block.first_sample, self._rate_hz)
        for scan, truth in zip(block.monitor_scans.tolist(), block.monitor, strict=True):
            row = block.scan.rows[scan]
            stamp = stamp_ns(block.first_sample + scan, self._rate_hz, start_ns)
            for topic, render in renderers:
                yield topic, render(stamp, row, truth)


def _reading(instrument: Instrument, topic: topics.Topic, bit: int, noise: float) -> Renderer:
    """Return the renderer of one instrument's message: its numbers change, its sequences do not."""
    fields = instrument.message(0.0, False, noise)
    changing = [path for path, value in fields.items() if isinstance(value, float)]
    template = _template(topic, fields, changing)

    def render(stamp: int, row: np.void, _truth: np.void) -> bytes:
        values = instrument.message(float(row[instrument.name]), bool(int(row["status"]) & bit), noise)
        return template.render(stamp, *(values[path] for path in changing))

    return render


def _joint_states() -> Renderer:
    """Return the renderer of the true state; effort is the contact force on each body, both walls push the sphere."""
    zeros = [0.0] * len(JOINTS)
    template = _template(
        topics.JOINT_STATES, {"name": list(JOINTS), "position": zeros, "velocity": zeros, "effort": zeros}, _PLACES
    )

    def render(stamp: int, _row: np.void, truth: np.void) -> bytes:
        push = truth["force_left"] - truth["force_right"]
        moving = (truth[name] for name in ("x_b", "x_1", "x_2", "v_b", "v_1", "v_2"))
        return template.render(stamp, *moving, -push, push)

    return render


def _template(topic: topics.Topic, fields: Mapping[str, object], changing: list[str]) -> Template:
    message = messages.class_of(topic)()
    message.header.frame_id = topic.frame_id
    for path, value in fields.items():
        put(message, path, value)
    return Template(message, *changing)
