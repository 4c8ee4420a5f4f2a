# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The scan clock: when each channel is converted, in exact integers.

Instants are counted in clock units, 1 ns divided by the number `rate_hz` · channels, in which a scan period, a skew and
a 10 ms tick are all whole numbers: no scan ever drifts, and no result depends on where a block or a call begins.
"""

from __future__ import annotations

import attrs

from impact_rig.errors import ConfigError
from impact_rig.instruments.section import Setup
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S


@attrs.frozen
class ScanClock:
    """Conversion times of a multiplexed converter."""

    rate_hz: int  # scans per second
    period: int  # from one scan to the next, in clock units
    tick: int  # one tick of 10 ms, in clock units
    skews: tuple[int, ...]  # conversion of each channel after the scan clock, in clock units

    def skew_s(self, channel: int) -> float:
        """Return how long after the scan clock `channel` is converted [s]."""
        return self.skews[channel] / self.tick * COMMAND_GRID_NS / NS_PER_S

    def scans_per_tick(self) -> int:
        """Return the largest number of scans in one tick."""
        return -(-self.tick // self.period)


def scan_clock(config: Setup) -> ScanClock:
    """Return the clock of a configuration.

    Raises:
        ConfigError: more conversions per second than the converter can do.
    """
    rate, adc, channels = config.daq.rate_hz, config.instruments.adc, len(config.instruments.fitted())
    if rate * channels > adc.aggregate_limit_hz:
        raise ConfigError(
            f"daq.rate_hz must be <= {int(adc.aggregate_limit_hz) // channels} Hz: {channels} channels share"
            f" instruments.adc.aggregate_limit_hz = {adc.aggregate_limit_hz:g} Hz, got {rate} Hz"
        )
    unit = rate * channels  # clock units per nanosecond
    interval = min(adc.conversion_ns * unit, NS_PER_S)  # the smaller of the board's and period / channels
    apart = adc.multiplexed and not config.instruments.ideal
    return ScanClock(
        rate_hz=rate,
        period=NS_PER_S * channels,
        tick=COMMAND_GRID_NS * unit,
        skews=tuple(channel * interval * apart for channel in range(channels)),
    )
