# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Settings of the streaming measurement; each with its unit, range and reason, made like the rig's configuration."""

from __future__ import annotations

import attrs

from impact_rig.config.fields import integer, quantity
from impact_rig.errors import ConfigError


@attrs.frozen(kw_only=True)
class TrackerSettings:
    """How `Tracker` measures. The defaults suit the rig: 5 to 200 Hz, time constants of 0.3 to 4 s."""

    harmonics: int = integer(5, "-", "Harmonics in the fit, the drive included.", at_least=1, at_most=10)
    window_s: float = quantity(0.25, "s", "Shortest window; whole cycles, a multiple of 6.", above=0, at_most=100)
    windows: int = integer(8, "-", "Windows per measurement of a periodic response.", at_least=8, at_most=64)
    long_windows: int = integer(
        32, "-", "Windows per measurement of a response that is not periodic.", at_least=16, at_most=256
    )
    settle_tolerance: float = quantity(
        5e-4, "-", "Relative bias by a dying transient that a measurement may have.", above=0, at_most=0.1
    )
    periodic_tolerance: float = quantity(
        1e-3, "-", "Relative cycle-to-cycle spread up to which a response counts as periodic.", above=0, at_most=0.5
    )
    wait_limit_s: float = quantity(60.0, "s", "Bound of waiting for a settled response.", above=0, at_most=3600)
    slowest_speed: float = quantity(
        1e-4,
        "m/s",
        "Slowest drift that is waited for: a sphere without impacts rests once it would have crossed the gap so.",
        above=0,
        at_most=10,
    )
    hold_s: float = quantity(
        0.05, "s", "How long scans are held back for commands delivered after them.", at_least=0, at_most=1
    )
    lag_uncertainty: float = quantity(
        0.0, "-", "Relative standard uncertainty of the lags; daq/info states none.", at_least=0, at_most=1
    )
    worst_relative_uncertainty: float = quantity(
        0.2, "-", "Relative standard uncertainty of DT above which a row has no number.", above=0, at_most=1
    )

    def __attrs_post_init__(self) -> None:
        if self.windows > self.long_windows:
            raise ConfigError(f"windows must be <= long_windows = {self.long_windows}, got {self.windows}")


@attrs.frozen(kw_only=True)
class ImpactSettings:
    """How impacts are told from background, noise and the accelerometer's ringing."""

    corner_hz: float = quantity(1500.0, "Hz", "Corner of the high-pass that removes the vibration.", above=0)
    noise_factor: float = quantity(8.0, "-", "Threshold, times the rms of what the high-pass leaves.", above=1)
    threshold_m_s2: float = quantity(0.5, "m/s^2", "Lowest threshold.", above=0)
    ring_factor: float = quantity(
        2.0, "-", "Threshold right after an impact, times its peak: the sensor still rings.", at_least=0
    )
    ring_time_s: float = quantity(
        4e-4, "s", "Time constant of the ringing, Q / (π f) of the mounted sensor: 30 at 25 kHz.", above=0
    )
