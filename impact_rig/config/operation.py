# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration of how the rig runs: data acquisition, time, and what it publishes."""

from __future__ import annotations

import attrs

from impact_rig.config.fields import choice, integer, names, quantity, switch, text
from impact_rig.errors import ConfigError


@attrs.frozen(kw_only=True)
class Daq:
    """The scan clock of the data acquisition board."""

    rate_hz: int = integer(
        10_000, "Hz", "Scans per second, per channel.", at_least=100, at_most=250_000, read_only=True
    )
    block_scans: int = integer(100, "scans", "Scans per published block.", at_least=1, at_most=10_000, read_only=True)
    clock_error_ppm: float = quantity(
        0.0,
        "ppm",
        "DAQ clock error: rig time is DAQ time, so this scales the physics beneath it.",
        at_least=-1000,
        at_most=1000,
    )
    seed: int = integer(1, "-", "Seed of noise, calibration errors and random drive.", at_least=0, at_most=2**53)


@attrs.frozen(kw_only=True)
class Time:
    """How rig time passes."""

    mode: str = choice(
        "realtime",
        ("realtime", "freewheel", "stepped"),
        "Paced by the clock, as fast as the peers acknowledge, or by ~/step.",
        read_only=True,
    )
    factor: float = quantity(1.0, "-", "Speed of realtime, times real time.", above=0, at_most=1000)
    peers: tuple[str, ...] = names(
        (), "Peers whose daq/ack freewheel and stepped wait for; in realtime scan 0 waits for them."
    )
    ack_window: int = integer(
        16, "blocks", "How far freewheel runs ahead of the slowest peer.", at_least=1, at_most=1000
    )
    peer_timeout_s: float = quantity(3.0, "s", "A peer silent for this long pauses the rig.", above=0)
    start_wait_s: float = quantity(
        120.0, "s", "How long realtime waits before scan 0 for all peers to listen.", at_least=0, at_most=3600
    )
    publish_clock: str = choice(
        "auto",
        ("auto", "always", "never"),
        "Publish /clock; auto: whenever not in real time x 1.",
        switched={True: "always", False: "never"},
    )

    def __attrs_post_init__(self) -> None:
        if self.mode == "freewheel" and not self.peers:
            raise ConfigError("peers must name who follows in freewheel: without, every queue would overflow, got []")

    @property
    def is_simulated(self) -> bool:
        """Whether rig time is another time than everybody's: not in real time × 1."""
        return self.mode != "realtime" or self.factor != 1.0

    @property
    def publishes_clock(self) -> bool:
        """Whether the rig publishes /clock."""
        return self.is_simulated if self.publish_clock == "auto" else self.publish_clock == "always"


@attrs.frozen(kw_only=True)
class Step:
    """What ~/step does."""

    blocks: int = integer(1, "blocks", "Blocks by which ~/step advances.", at_least=1, at_most=1_000_000)


@attrs.frozen(kw_only=True)
class Pluck:
    """What ~/pluck does."""

    displacement_m: float = quantity(
        2e-3, "m", "Displacement of the superior base from which it is released.", at_least=-0.1, at_most=0.1
    )


@attrs.frozen(kw_only=True)
class Output:
    """What is published besides the scans."""

    monitor_rate_hz: float = quantity(
        50.0, "Hz", "Rate of the plotter-friendly monitor topics and truth/joint_states.", above=0, at_most=200
    )
    frame_prefix: str = text(
        "",
        "Put before the frames of monitor topics, as robot_state_publisher does with its own.",
        read_only=True,
        pattern=r"[A-Za-z0-9_/]{0,100}",
        means="letters, digits, _ and /",
    )
    truth_scan: bool = switch(False, "Publish truth/scan: the scans' instants without instruments.")
    autostart: bool = switch(True, "Configure and activate by itself at start.", read_only=True)
    command_timeout_s: float = quantity(
        0.0, "s", "Ramp to zero when no command came for this long in rig time; 0 = off.", at_least=0
    )
