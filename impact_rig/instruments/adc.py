# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The multiplexed converter of the DAQ board."""

from __future__ import annotations

import attrs

from impact_rig.config.fields import choice, integer, quantity, switch

ADC_RANGES_V = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
"""Input ranges of the board [± V]."""


@attrs.frozen(kw_only=True)
class Adc:
    """Multiplexed converter of the DAQ board (NI USB-6251 class)."""

    bits: int = integer(16, "bit", "Resolution.", at_least=8, at_most=24)
    noise_v_rms: float = quantity(
        280e-6, "V", "Noise at ± 10 V, rms; proportional to the range.", at_least=0, at_most=0.1
    )
    gain_tolerance: float = quantity(60e-6, "-", "Limit of the relative gain error.", at_least=0, below=1)
    offset_tolerance: float = quantity(20e-6, "-", "Limit of the offset, of the range.", at_least=0, below=1)
    multiplexed: bool = switch(True, "One converter for all channels: they are converted one after another.")
    conversion_ns: int = integer(
        11_000, "ns", "Conversion interval; shorter when the scan period is.", at_least=1, at_most=10_000_000
    )
    aggregate_limit_hz: float = quantity(1e6, "Hz", "Conversions per second, all channels together.", above=0)
    anti_alias: str = choice(
        "none", ("none", "butterworth"), "Anti-alias filter ahead of the converter.", switched={False: "none"}
    )
    anti_alias_hz: float = quantity(4e3, "Hz", "Its corner; below half the scan rate to be of use.", above=0)
    anti_alias_order: int = integer(4, "-", "Its order.", at_least=1, at_most=8)
