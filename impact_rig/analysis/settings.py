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
"""Settings of the analysis, and the operator's label of the gap between the barriers.

The analysis does not read the gap that is configured for the rig, because it must measure without knowing the true
value. The operator labels the gap with a remark on the topic `notes`. The remark `gap_m=0.006 at 12500000` means a gap
of 6 mm from the rig time 12500000 ns on. Because of this time, live analysis and later analysis of the recorded run
apply the label from the same scan on.
"""

from __future__ import annotations

import re
from typing import Any

import attrs
import numpy as np

from impact_rig.blocks import SETTINGS, Table
from impact_rig.config.fields import describe_fields, integer, quantity
from impact_rig.errors import ConfigError
from impact_rig.system.machine import fingerprint


@describe_fields
@attrs.frozen(kw_only=True)
class TrackerSettings:
    """Settings of `Tracker`, which measures the transmissibility; also the parameters of the analysis node.

    The defaults suit vibrations of 5 to 200 Hz whose transients decay with time constants of 0.3 to 4 s.

    Raises:
        ConfigError: a value is out of range, or `windows` is greater than `long_windows`.

    See Also:
        - `LocalRig`, `RosRig`: their argument `analysis` takes these settings.
        - docs/reference/configuration.md: each setting with unit, range and default.
    """

    harmonics: int = integer(
        5, "-", "Number of harmonics fitted to each drive cycle, fundamental included.", at_least=1, at_most=10
    )
    window_s: float = quantity(
        0.25,
        "s",
        "Shortest window, the unit in which settling is judged; it is lengthened to a multiple of 6 drive cycles.",
        above=0,
        at_most=100,
    )
    windows: int = integer(8, "-", "Number of windows averaged to measure a periodic response.", at_least=8, at_most=64)
    long_windows: int = integer(
        32, "-", "Number of windows averaged to measure a response that is not periodic.", at_least=16, at_most=256
    )
    settle_tolerance: float = quantity(
        5e-4,
        "-",
        "Relative bias of DT due to a dying transient up to which the response counts as settled.",
        above=0,
        at_most=0.1,
    )
    periodic_tolerance: float = quantity(
        1e-3,
        "-",
        "Relative rms change of the structure's vibration between cycles up to which it counts as periodic.",
        above=0,
        at_most=0.5,
    )
    wait_limit_s: float = quantity(
        60.0,
        "s",
        "Longest wait for a settled response; then a row of status `not_settled` gives the present numbers.",
        above=0,
        at_most=3600,
    )
    slowest_speed: float = quantity(
        1e-4,
        "m/s",
        "Slowest sphere considered: a row without impacts waits until it would have crossed the gap.",
        above=0,
        at_most=10,
    )
    hold_s: float = quantity(
        0.05,
        "s",
        "Delay before scans are measured, so that a command or calibration that arrives after them still acts on them.",
        at_least=0,
        at_most=1,
    )
    lag_uncertainty: float = quantity(
        0.0,
        "-",
        "Relative standard uncertainty of the sensors' lags, which daq/info does not state.",
        at_least=0,
        at_most=1,
    )
    worst_relative_uncertainty: float = quantity(
        0.2,
        "-",
        "Relative standard uncertainty of DT above which a row has a reason instead of numbers.",
        above=0,
        at_most=1,
    )

    def __attrs_post_init__(self) -> None:
        if self.windows > self.long_windows:
            raise ConfigError(
                f"windows must be <= long_windows = {self.long_windows}, the number averaged if the response is "
                f"not periodic, got {self.windows}"
            )


@attrs.frozen(kw_only=True)
class ImpactSettings:
    """Settings of `ImpactDetector`, which distinguishes impacts from vibration, noise and ringing of the sensor."""

    corner_hz: float = quantity(
        1500.0, "Hz", "Corner of the high-pass that removes the vibration from the acceleration.", above=0
    )
    noise_factor: float = quantity(
        8.0, "-", "Threshold in multiples of the rms of the high-passed acceleration between impacts.", above=1
    )
    threshold_m_s2: float = quantity(
        0.5, "m/s^2", "Lowest threshold of the high-passed acceleration: lower pulses are no impacts.", above=0
    )
    ring_factor: float = quantity(
        2.0,
        "-",
        "Threshold right after an impact in multiples of the impact's peak, because the sensor still rings.",
        at_least=0,
    )
    ring_time_s: float = quantity(
        4e-4, "s", "Time constant of this ringing, Q / (π f) of the mounted sensor: Q = 30, f = 25 kHz.", above=0
    )


_PATTERN = re.compile(r"\s*gap_m\s*=\s*(?P<gap>nan|[0-9.eE+-]+)\s+at\s+(?P<stamp>[0-9]{1,19})\s*")
_END_NS = 2**31 * 1_000_000_000  # the latest instant of a ROS stamp


@attrs.frozen
class GapLabel:
    """Operator's label of the gap [m], valid from the rig time `stamp_ns` [ns] on.

    A gap of 0 means no sphere, and NaN means unknown.
    """

    gap_m: float
    stamp_ns: int

    def text(self) -> str:
        """Return the label as a remark for the topic `notes`, such as `gap_m=0.006 at 12500000`.

        `parse_label` reads the remark. An unknown gap is written as `nan`.
        """
        return f"gap_m={self.gap_m!r} at {self.stamp_ns}"


def parse_label(remark: str) -> GapLabel | None:
    """Return the gap label in an operator's remark such as `gap_m=0.006 at 12500000`, or None for any other remark.

    The gap is in m: 0 means no sphere, and `nan` means unknown. The number after `at` is the rig time [ns] from which
    the label applies. The result is also None if the gap is not from 0 to 1 m, or the time is beyond the range of ROS
    stamps.
    """
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
RETIRED = ("bootstrap_resamples", "seed")  # settings of resampling in recordings of earlier versions; they are ignored


def settings_table(settings: TrackerSettings, gap_m: float, stamp_ns: int, started_s: float = 0.0) -> Table:
    """Return the table `analysis/settings` with the settings and the gap label, stamped with the rig time `stamp_ns`.

    `gap_m` is the gap label [m]. The table also contains the fingerprint of this machine, and `started_s`, the time at
    which the analysis started [s since 1970]. These two values distinguish several analyses in one run.
    """
    values = {attribute.name: getattr(settings, attribute.name) for attribute in attrs.fields(TrackerSettings)}
    rows = [*values.items(), (GAP, gap_m), (MACHINE, fingerprint()), (STARTED, started_s)]
    return Table(stamp_ns, np.array(rows, dtype=SETTINGS))


def read_settings(table: Table) -> tuple[TrackerSettings, float]:
    """Return the settings and the gap label [m] in a table `analysis/settings`.

    A setting that is missing in the table has its default. A missing gap label is NaN.

    Raises:
        ConfigError: the table has an unknown key, or a value out of range.
    """
    values = dict(zip(table.rows["key"].astype(str).tolist(), table.rows["value"].tolist(), strict=True))
    gap_m = float(values.pop(GAP, np.nan))
    for key in (MACHINE, STARTED, *RETIRED):
        values.pop(key, None)
    defaults = TrackerSettings()
    unknown = sorted(set(values) - {attribute.name for attribute in attrs.fields(TrackerSettings)})
    if unknown:
        raise ConfigError(
            f"analysis/settings has an unknown key: {', '.join(unknown)}; if a later version of this package published "
            "it, install that version"
        )
    return TrackerSettings(**{key: _as_set(getattr(defaults, key), value) for key, value in values.items()}), gap_m


def machine_of(table: Table) -> int | None:
    """Return the fingerprint of the machine that made a table `analysis/settings`, or None if the table lacks it.

    Machines with equal fingerprints (`machine.fingerprint`) compute equal bits with the same code.
    """
    found = _value(table, MACHINE)
    return None if found is None else int(found)


def started_of(table: Table) -> float | None:
    """Return the start time [s since 1970] of the analysis that made a table `analysis/settings`; None if unknown."""
    return _value(table, STARTED)


def _value(table: Table, key: str) -> float | None:
    found = table.rows["value"][table.rows["key"] == key.encode()]
    return float(found[0]) if len(found) and np.isfinite(found[0]) else None


def _as_set(default: float, value: float) -> Any:  # int or float, as the setting is; the validator decides
    """Convert a setting from a table, where all values are floats, to an int if its default is an int.

    A value that is not a whole number stays a float, so that the validator of the setting rejects it.
    """
    return int(value) if isinstance(default, int) and np.isfinite(value) and value == int(value) else value
