# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Every topic of the graph: those of the table at the ground, monitors of instruments, and analyses of blocks."""

from __future__ import annotations

from impact_rig import topics
from impact_rig.analysis.blockwise import ANALYSES
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.topics import Topic

MONITORS = {name: instrument.monitor for name, instrument in INSTRUMENTS.items() if instrument.monitor is not None}
"""The topic of each instrument that has one, by channel."""

ENVELOPES = {name: topics.envelope(name, kind.unit) for name, kind in INSTRUMENTS.items()}
"""The envelope of each channel."""
SPECTRA = {name: topics.spectrum(name, INSTRUMENTS[name].unit) for name in ("laser", "accelerometer")}
"""The amplitude spectrum of each channel that has one."""

_MONITORS_FROM = topics.TOPICS.index(topics.INFO) + 1
_ANALYSES_FROM = topics.TOPICS.index(topics.IMPACTS) + 1
_PLOTS_FROM = topics.TOPICS.index(topics.PLOT_PULSES) + 1

TOPICS: tuple[Topic, ...] = (
    *topics.TOPICS[:_MONITORS_FROM],
    *MONITORS.values(),
    *topics.TOPICS[_MONITORS_FROM:_ANALYSES_FROM],
    *(analysis.topic for analysis in ANALYSES),
    *topics.TOPICS[_ANALYSES_FROM:_PLOTS_FROM],
    *SPECTRA.values(),
    *ENVELOPES.values(),
    *topics.TOPICS[_PLOTS_FROM:],
)
"""Every topic of the interface, in the order of the documentation."""


def by_name(name: str) -> Topic:
    """Return the topic of this (relative or absolute) name.

    Raises:
        KeyError: there is none.
    """
    return _BY_NAME[name]


_BY_NAME = {topic.name: topic for topic in TOPICS}
