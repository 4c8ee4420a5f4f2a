# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Configuration of the mechanics: structure, shaker, sphere, barriers and drive; the contact's is with its laws.

Defaults are the paper's rig; the paper leaves m1, k1, c1, amplitudes and the shaker's constants open, so each field
says where its value comes from. Ranges are wide enough for any rig of this kind and narrow enough to refuse a slip of
units: millimetres for metres, grams for kilograms, GPa for Pa.
"""

from __future__ import annotations

import attrs

from impact_rig.config.fields import Origin, choice, quantity, switch

FASTEST_HZ = 1e4
"""Far beyond any motion of this rig; at a hundred megahertz a tick would take minutes to simulate."""


@attrs.frozen(kw_only=True)
class Structure:
    """Superior base on its columns: one mode of mass m_1, k_1 = m_1 ω_n², c_1 = 2 ζ m_1 ω_n."""

    mass_kg: float = quantity(
        0.13, "kg", "Equivalent mass m_1 of the superior base.", Origin.IDENTIFIED, above=0, at_most=100
    )
    natural_frequency_hz: float = quantity(
        9.105, "Hz", "Natural frequency; the paper prints 9.1.", Origin.IDENTIFIED, above=0, at_most=FASTEST_HZ
    )
    damping_ratio: float = quantity(
        0.0044974,
        "-",
        "Damping ratio ζ = m / (1.8 m_1): only the product m_1 ζ is determined by the paper.",
        Origin.IDENTIFIED,
        at_least=1e-6,
        below=1,
    )


@attrs.frozen(kw_only=True)
class Shaker:
    """Electromagnetic shaker that carries the inferior base (B&K 4808 class)."""

    force_factor_n_a: float = quantity(
        5.3, "N/A", "Force per coil current K_f (= back-EMF per velocity, V s/m).", above=0
    )
    suspension_stiffness_n_m: float = quantity(6300.0, "N/m", "Table suspension k_f.", above=0)
    damping_n_s_m: float = quantity(90.0, "N s/m", "Table damping c_f.", Origin.IDENTIFIED, above=0)
    armature_mass_kg: float = quantity(0.16, "kg", "Moving element m_a.", above=0, at_most=100)
    base_mass_kg: float = quantity(1.84, "kg", "Inferior base m_b.", Origin.IDENTIFIED, above=0, at_most=100)
    coil_resistance_ohm: float = quantity(1.6, "ohm", "Coil resistance (voltage drive only).", above=0)
    coil_inductance_h: float = quantity(764e-6, "H", "Coil inductance (voltage drive only).", above=0, at_most=0.1)
    travel_limit_m: float = quantity(
        6.35e-3, "m", "Table travel limit, either side: beyond it the interlock trips.", above=0, at_most=1
    )
    current_limit_a_rms: float = quantity(15.0, "A", "Coil current limit, rms: larger commands are refused.", above=0)
    frequency_min_hz: float = quantity(5.0, "Hz", "Lowest accepted frequency command.", above=0)
    frequency_max_hz: float = quantity(200.0, "Hz", "Highest accepted frequency command.", above=0, at_most=FASTEST_HZ)
    ramp_s: float = quantity(
        0.1, "s", "Time in which the amplitude moves linearly to a new command.", at_least=0, at_most=60
    )


@attrs.frozen(kw_only=True)
class Drive:
    """What moves the base."""

    kind: str = choice(
        "current",
        ("current", "prescribed", "voltage"),
        "Constant-current shaker, prescribed base motion (paper's Eq. 3) or constant-voltage shaker.",
    )
    waveform: str = choice("sine", ("sine", "chirp", "random"), "Shape of the drive signal.")
    frequency_hz: float = quantity(
        9.1, "Hz", "Frequency before the first command.", Origin.PAPER, above=0, at_most=FASTEST_HZ
    )
    amplitude: float = quantity(
        0.0,
        "A, m or V",
        "Amplitude before the first command, peak (rms for random): ampere, metre or volt by kind.",
        at_least=0,
    )
    chirp_end_hz: float = quantity(
        12.0, "Hz", "Frequency at which a chirp ends and starts again.", above=0, at_most=FASTEST_HZ
    )
    chirp_s: float = quantity(60.0, "s", "Duration of one linear chirp.", above=0)
    random_low_hz: float = quantity(5.0, "Hz", "Lower edge of the random band.", above=0, at_most=FASTEST_HZ)
    random_high_hz: float = quantity(20.0, "Hz", "Upper edge of the random band.", above=0, at_most=FASTEST_HZ)


@attrs.frozen(kw_only=True)
class Sphere:
    """The loose steel sphere."""

    present: bool = switch(True, "Whether the sphere is on the rig.", Origin.PAPER)
    start: str = choice(
        "left",
        ("left", "centre", "right"),
        "Where the sphere rests after a reset or a gap change: decides the attractor.",
    )
    diameter_m: float = quantity(6.35e-3, "m", "Diameter.", Origin.PAPER, above=0, at_most=1)
    density_kg_m3: float = quantity(7850.0, "kg/m^3", "Density of steel: m = 1.052 g.", at_least=100, at_most=1e5)
    young_modulus_pa: float = quantity(210e9, "Pa", "Young's modulus of steel.", at_least=1e6, at_most=1e13)
    poisson_ratio: float = quantity(0.30, "-", "Poisson's ratio of steel.", at_least=0, at_most=0.5)
    guide_friction: float = quantity(
        0.0, "-", "Coulomb friction coefficient on the guide; the paper has none.", Origin.PAPER, at_least=0, at_most=2
    )


@attrs.frozen(kw_only=True)
class Barriers:
    """The two barriers on the superior base."""

    gap_m: float = quantity(
        6e-3, "m", "Total gap g: distance of the barriers less the sphere's diameter.", Origin.PAPER, above=0, at_most=1
    )
    young_modulus_pa: float = quantity(70e9, "Pa", "Young's modulus of aluminium.", at_least=1e6, at_most=1e13)
    poisson_ratio: float = quantity(0.33, "-", "Poisson's ratio of aluminium.", at_least=0, at_most=0.5)
