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
"""Sections of a configuration: mechanics, acquisition, time and output.

The sections of contact laws and instruments are in `impact_rig.physics.contact` and `impact_rig.instruments`.

The defaults are the paper's rig. The paper does not give m1, k1, c1, amplitudes and the shaker's constants, so each
field states the origin of its value. Ranges are some decades wide on both sides: wide enough for any rig of this kind,
and narrow enough to reject a wrong unit (millimetres for metres, grams for kilograms, GPa for Pa). The energy balance
holds for any configuration within them, which `qualification/legal_configurations.py` tests.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from impact_rig.config.fields import Origin, choice, integer, names, quantity, switch, text
from impact_rig.errors import ConfigError

FASTEST_HZ = 1e4  # far above any motion of this rig; at a hundred megahertz a tick would take minutes to simulate
SLOWEST_HZ = 0.1
"""Lowest drive frequency that a configuration may have, lower than that of any shaker.

Columns with the highest natural frequency, 10⁴ times as high, then bend by 10⁻⁸ of the base's motion. This deflection
is a difference of two positions, so half of its digits are lost.
"""
SLOWEST_NOISE_HZ = 1.0
"""Lowest frequency of a random drive, above `SLOWEST_HZ`.

A random drive moves a prescribed base in straight lines between ticks, which costs further digits of the deflection.
"""


@attrs.frozen(kw_only=True)
class Structure:
    """Superior base on its columns: one mode of mass m_1, k_1 = m_1 ω_n², c_1 = 2 ζ m_1 ω_n."""

    mass_kg: float = quantity(
        0.13, "kg", "Equivalent mass m_1 of the superior base.", Origin.IDENTIFIED, at_least=1e-3, at_most=100
    )
    natural_frequency_hz: float = quantity(
        9.105,
        "Hz",
        "Natural frequency f_n of the superior base on its columns; the paper prints 9.1.",
        Origin.IDENTIFIED,
        at_least=0.1,
        at_most=1000,
    )
    damping_ratio: float = quantity(
        0.0044974,
        "-",
        "Damping ratio ζ of the structure; m / (1.8 m_1) with the sphere's mass m, as the paper determines only m_1 ζ.",
        Origin.IDENTIFIED,
        at_least=1e-6,
        below=1,
    )


@attrs.frozen(kw_only=True)
class Shaker:
    """Electromagnetic shaker that carries the inferior base (B&K 4808 class)."""

    force_factor_n_a: float = quantity(
        5.3, "N/A", "Force per coil current K_f (= back-EMF per velocity, V s/m).", at_least=1e-3, at_most=1e4
    )
    suspension_stiffness_n_m: float = quantity(
        6300.0, "N/m", "Stiffness k_f of the table's suspension.", at_least=1, at_most=1e8
    )
    damping_n_s_m: float = quantity(
        90.0, "N s/m", "Damping c_f of the table's suspension.", Origin.IDENTIFIED, at_least=1e-3, at_most=1e5
    )
    armature_mass_kg: float = quantity(
        0.16, "kg", "Mass m_a of the shaker's moving element.", at_least=1e-3, at_most=100
    )
    base_mass_kg: float = quantity(
        1.84, "kg", "Mass m_b of the inferior base; 0: the bare table.", Origin.IDENTIFIED, at_least=0, at_most=100
    )
    coil_resistance_ohm: float = quantity(
        1.6, "ohm", "Coil resistance (voltage drive only).", at_least=1e-3, at_most=1e4
    )
    coil_inductance_h: float = quantity(
        764e-6, "H", "Coil inductance (voltage drive only).", at_least=1e-7, at_most=0.1
    )
    travel_limit_m: float = quantity(
        6.35e-3,
        "m",
        "Largest travel of the table to either side; beyond it the interlock trips.",
        at_least=1e-6,
        at_most=1,
    )
    current_limit_a_rms: float = quantity(
        15.0, "A", "Largest coil current, rms; larger commands are rejected.", at_least=1e-3, at_most=1e4
    )
    frequency_min_hz: float = quantity(
        5.0, "Hz", "Lowest accepted frequency command.", at_least=SLOWEST_HZ, at_most=FASTEST_HZ
    )
    frequency_max_hz: float = quantity(
        200.0, "Hz", "Highest accepted frequency command.", at_least=SLOWEST_HZ, at_most=FASTEST_HZ
    )
    ramp_s: float = quantity(
        0.1, "s", "Time in which the amplitude moves linearly to a new command.", at_least=0, at_most=60
    )
    stop_ramp_s: float = quantity(
        0.1, "s", "Time in which a stop or a trip takes the amplitude to zero.", at_least=0, at_most=0.3
    )


DRIVE_UNITS: Mapping[str, str] = {"current": "A", "prescribed": "m", "voltage": "V"}
"""Unit of the drive's amplitude by `drive.kind`."""


@attrs.frozen(kw_only=True)
class Drive:
    """Drive of the inferior base: quantity (coil current, base motion or voltage), waveform and first command."""

    kind: str = choice(
        "current",
        tuple(DRIVE_UNITS),
        "Quantity that a command sets: coil current, base motion (prescribed, paper's Eq. 3) or coil voltage.",
    )
    waveform: str = choice("sine", ("sine", "chirp", "random", "stream"), "Shape of the drive signal.")
    frequency_hz: float = quantity(
        9.1,
        "Hz",
        "Drive frequency before the first command; a chirp starts there.",
        Origin.PAPER,
        at_least=SLOWEST_HZ,
        at_most=FASTEST_HZ,
    )
    amplitude: float = quantity(
        0.0,
        "A, m or V",
        "Drive amplitude before the first command, peak (rms for random): ampere, metre or volt by `drive.kind`.",
        at_least=0,
    )
    chirp_end_hz: float = quantity(
        12.0,
        "Hz",
        "Frequency at which a chirp ends; the next one then starts at `drive.frequency_hz`.",
        at_least=SLOWEST_HZ,
        at_most=FASTEST_HZ,
    )
    chirp_s: float = quantity(60.0, "s", "Duration of one linear chirp.", at_least=0.01, at_most=1e5)
    random_low_hz: float = quantity(
        5.0, "Hz", "Lower edge of the random band.", at_least=SLOWEST_NOISE_HZ, at_most=FASTEST_HZ
    )
    random_high_hz: float = quantity(
        20.0, "Hz", "Upper edge of the random band.", at_least=SLOWEST_NOISE_HZ, at_most=FASTEST_HZ
    )
    stream_rate_hz: int = integer(10_000, "Hz", "Samples per second of a stream.", at_least=1, at_most=50_000)
    stream_hold: str = choice(
        "first_order",
        ("first_order", "zero_order"),
        "Drive between two samples of a stream: the straight line between them, or the earlier sample.",
    )
    stream_buffer_s: float = quantity(2.0, "s", "Length of the buffer for stream samples.", at_least=0.02, at_most=60)
    stream_wait: bool = switch(True, "Whether rig time waits for the next stream samples in free_running and lockstep.")
    on_underrun: str = choice(
        "ramp",
        ("ramp", "hold", "trip"),
        "Action at missing samples of a stream: ramp to zero within shaker.ramp_s, keep the last one, or trip.",
    )


@attrs.frozen(kw_only=True)
class Sphere:
    """Loose steel sphere between the barriers: its size, material, friction and start position."""

    present: bool = switch(True, "Whether the sphere is on the rig.", Origin.PAPER)
    start: str = choice(
        "left",
        ("left", "centre", "right"),
        "Position of the sphere after a reset or a change of the mechanics; the steady response can depend on it.",
    )
    diameter_m: float = quantity(6.35e-3, "m", "Diameter of the sphere.", Origin.PAPER, at_least=1e-4, at_most=1)
    density_kg_m3: float = quantity(
        7850.0, "kg/m^3", "Density of the sphere; that of steel gives a mass of 1.052 g.", at_least=100, at_most=1e5
    )
    young_modulus_pa: float = quantity(
        210e9, "Pa", "Young's modulus of the sphere (steel).", at_least=1e6, at_most=1e13
    )
    poisson_ratio: float = quantity(0.30, "-", "Poisson's ratio of the sphere (steel).", at_least=0, at_most=0.5)
    guide_friction: float = quantity(
        0.0,
        "-",
        "Coulomb friction coefficient of the sphere on its guide; the paper has no friction.",
        Origin.PAPER,
        at_least=0,
        at_most=2,
    )


@attrs.frozen(kw_only=True)
class Barriers:
    """Two barriers on the superior base, between which the sphere moves."""

    gap_m: float = quantity(
        6e-3,
        "m",
        "Total gap g: distance of the barriers minus the sphere's diameter.",
        Origin.PAPER,
        at_least=1e-6,
        at_most=1,
    )
    young_modulus_pa: float = quantity(
        70e9, "Pa", "Young's modulus of the barriers (aluminium).", at_least=1e6, at_most=1e13
    )
    poisson_ratio: float = quantity(0.33, "-", "Poisson's ratio of the barriers (aluminium).", at_least=0, at_most=0.5)


@attrs.frozen(kw_only=True)
class Daq:
    """Scan clock of the data acquisition board (rate, blocks, clock error), and the seed of all random numbers."""

    rate_hz: int = integer(
        10_000, "Hz", "Scans per second, per channel.", at_least=100, at_most=250_000, read_only=True
    )
    block_scans: int = integer(100, "scans", "Scans per published block.", at_least=1, at_most=10_000, read_only=True)
    clock_error_ppm: float = quantity(
        0.0,
        "ppm",
        "Error of the DAQ clock, > 0: slow. In one second of rig time, which this clock counts, the motion advances by "
        "1 + error seconds.",
        at_least=-1000,
        at_most=1000,
    )
    seed: int = integer(1, "-", "Seed of noise, calibration errors and random drive.", at_least=0, at_most=2**53)


@attrs.frozen(kw_only=True)
class Time:
    """Pace of rig time, and the nodes (peers) that the rig waits for.

    The rig waits for the peers' acknowledgements of its blocks. In `realtime`, it waits only before scan 0, until all
    peers have subscribed.
    """

    mode: str = choice(
        "realtime",
        ("realtime", "free_running", "lockstep"),
        "What advances rig time: the system clock, the acknowledgements of the peers, or calls of ~/step.",
        read_only=True,
        formerly={"freewheel": "free_running", "stepped": "lockstep"},
    )
    factor: float = quantity(1.0, "-", "Speed of realtime as a multiple of real time.", above=0, at_most=1000)
    peers: tuple[str, ...] = names(
        (),
        "Nodes whose acknowledgement (daq/ack) of each block the rig waits for in free_running and lockstep; in "
        "realtime, it waits before scan 0 until they have subscribed.",
    )
    ack_window: int = integer(
        16,
        "blocks",
        "Blocks by which a rig may be ahead of its slowest peer, free-running or within a step.",
        at_least=1,
        at_most=1000,
    )
    peer_timeout_s: float = quantity(
        3.0, "s", "Time without acknowledgement after which a peer counts as silent and rig time stops.", above=0
    )
    start_wait_s: float = quantity(
        120.0, "s", "Longest wait of realtime before scan 0 until all peers have subscribed.", at_least=0, at_most=3600
    )
    publish_clock: str = choice(
        "auto",
        ("auto", "always", "never"),
        "Whether to publish /clock; auto: always, except in realtime with factor 1.",
        switched={True: "always", False: "never"},
    )

    def __attrs_post_init__(self) -> None:
        if self.mode == "free_running" and not self.peers:
            raise ConfigError(
                "peers must name the nodes whose acknowledgements pace the rig if time.mode is free_running, got none"
            )

    @property
    def is_simulated(self) -> bool:
        """Return whether rig time differs from wall time: always, except in `realtime` with factor 1."""
        return self.mode != "realtime" or self.factor != 1.0

    @property
    def publishes_clock(self) -> bool:
        """Return whether the rig publishes /clock: as `publish_clock` says or, for `auto`, if `is_simulated`."""
        return self.is_simulated if self.publish_clock == "auto" else self.publish_clock == "always"


@attrs.frozen(kw_only=True)
class Step:
    """Number of blocks by which one call of ~/step advances the rig."""

    blocks: int = integer(1, "blocks", "Blocks by which one call of ~/step advances.", at_least=1, at_most=1_000_000)


@attrs.frozen(kw_only=True)
class Pluck:
    """Pluck test: free decay of the structure from ~/pluck until ~/reset."""

    displacement_m: float = quantity(
        2e-3, "m", "Displacement x_1 from which ~/pluck releases the superior base.", at_least=-0.1, at_most=0.1
    )


@attrs.frozen(kw_only=True)
class Output:
    """Outputs of the rig node in addition to the scans, and its behaviour at start and without commands.

    At start, the node can activate itself. After some time without a command, the drive can ramp to zero.
    """

    monitor_rate_hz: float = quantity(
        50.0, "Hz", "Message rate of the monitor topics, for plotters, and of truth/joint_states.", above=0, at_most=200
    )
    frame_prefix: str = text(
        "",
        "Prefix of all tf frames, as in robot_state_publisher; empty: the namespace of the node, /: none.",
        read_only=True,
        pattern=r"[A-Za-z0-9_/]{0,100}",
        means="letters, digits, _ and /",
    )
    truth_scan: bool = switch(False, "Publish truth/scan: the true motion at the instants of daq/scan.")
    autostart: bool = switch(True, "Whether the node configures and activates itself at start.", read_only=True)
    command_timeout_s: float = quantity(
        0.0, "s", "Time without a command [rig time] after which the drive ramps to zero; 0 = off.", at_least=0
    )
