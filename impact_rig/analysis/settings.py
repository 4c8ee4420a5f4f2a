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
"""What the operator tells: settings of the measurement, and the gap as a remark on `notes`, `gap_m=0.006 at 12500000`.

The rig does not tell the analysis its gap: it must measure without seeing the truth. A label carries the instant it
holds from, so that the live analysis and a later one of the recorded run apply it to the same scan.
"""

from __future__ import annotations

import re
from typing import Any

import attrs
import numpy as np

from impact_rig.blocks import SETTINGS, Table
from impact_rig.config.fields import integer, quantity
from impact_rig.errors import ConfigError
from impact_rig.system.machine import fingerprint


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
        "Slowest sphere that is waited for, at most for `wait_limit_s`, before a row without impacts is given.",
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


_PATTERN = re.compile(r"\s*gap_m\s*=\s*(?P<gap>nan|[0-9.eE+-]+)\s+at\s+(?P<stamp>[0-9]{1,19})\s*")
_END_NS = 2**31 * 1_000_000_000  # a ROS stamp carries no later instant


@attrs.frozen
class GapLabel:
    """A gap [m] (0 = no sphere, NaN = unknown) from an instant of rig time on."""

    gap_m: float
    stamp_ns: int

    def text(self) -> str:
        """Return the remark; `parse_label` reads it back exactly."""
        return f"gap_m={self.gap_m!r} at {self.stamp_ns}"


def parse_label(remark: str) -> GapLabel | None:
    """Return the label in a remark, or None if it is any other remark."""
    match = _PATTERN.fullmatch(remark)
    if match is None:
        return None
    try:
        gap, stamp = float(match["gap"]), int(match["stamp"])
    except ValueError:
        return None
    if gap < 0 or gap > 1 or stamp >= _END_NS:
        return None
    return GapLabel(gap, stamp)


MACHINE = "machine"
STARTED = "started"
GAP = "gap_m"
RETIRED = ("bootstrap_resamples", "seed")  # settings that earlier versions had: of resampling, which is no longer done


def settings_table(settings: TrackerSettings, gap_m: float, stamp_ns: int, started_s: float = 0.0) -> Table:
    """Return `analysis/settings`: settings and the operator's label from an instant on, and which analysis says so.

    Its machine and when it was started [s, Unix] tell one analysis from another in the same run.
    """
    values = {attribute.name: getattr(settings, attribute.name) for attribute in attrs.fields(TrackerSettings)}
    rows = [*values.items(), (GAP, gap_m), (MACHINE, fingerprint()), (STARTED, started_s)]
    return Table(stamp_ns, np.array(rows, dtype=SETTINGS))


def read_settings(table: Table) -> tuple[TrackerSettings, float]:
    """Return settings and label of `analysis/settings`; what the table does not name has its default.

    Raises:
        ConfigError: a key is unknown, or a value out of range.
    """
    values = dict(zip(table.rows["key"].astype(str).tolist(), table.rows["value"].tolist(), strict=True))
    gap_m = float(values.pop(GAP, np.nan))
    for key in (MACHINE, STARTED, *RETIRED):
        values.pop(key, None)
    defaults = TrackerSettings()
    unknown = sorted(set(values) - {attribute.name for attribute in attrs.fields(TrackerSettings)})
    if unknown:
        raise ConfigError(f"analysis/settings has an unknown key: {', '.join(unknown)}")
    return TrackerSettings(**{key: _as_set(getattr(defaults, key), value) for key, value in values.items()}), gap_m


def machine_of(table: Table) -> int | None:
    """Return the fingerprint in `analysis/settings` of the machine that analyses, see `machine`; None without."""
    found = _value(table, MACHINE)
    return None if found is None else int(found)


def started_of(table: Table) -> float | None:
    """Return when the analysis that `analysis/settings` is of was started [s, Unix]; None: it does not say."""
    return _value(table, STARTED)


def _value(table: Table, key: str) -> float | None:
    found = table.rows["value"][table.rows["key"] == key.encode()]
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None


def _as_set(default: float, value: float) -> Any:  # int or float, as the setting is; the validator decides
    """Return a setting as its type; what is no whole number where it should be is left for the validator to refuse."""
    return int(value) if isinstance(default, int) and np.isfinite(value) and value == int(value) else value
