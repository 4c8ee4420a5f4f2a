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
"""Simulation of a run in one call, without ROS: simulate the rig, read its instruments, measure DT, draw it.

The analysis uses only what the rig publishes (calibration, accepted commands and scans), never the truth.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.drawings import time_traces
from impact_rig.analysis.tracker import TrackerState
from impact_rig.analysis.uncertainty_budget import plus_minus
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.driver import LocalRig
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LONGEST_S = 3600.0  # all scans are kept in memory: 2 GB at 10 kS/s
DRAWN_S = 0.5
DRIVE_A = 0.52  # peak, as in the paper's measurements


@attrs.frozen(eq=False, repr=False)
class Record:
    """Readings of a simulated rig, and the results derived from them; `simulate` returns it.

    Times count from the start of the run, except those of `measurements`, which count from the end of each measurement
    and are therefore 0. docs/reference/interface.md describes every column.

    Attributes:
        config: configuration of the rig.
        scans: readings, a structured array of shape (n,): `time` [s], `accelerometer` [m/s²], `laser` [m] (absolute
            displacement of the structure), `base` [m] (that of its base), `current` [A] and `status` (bits of channels
            over range). Scans withheld by a `lost_block` fault are missing.
        state: state of the measurement at the end. `state.word` is settling, measuring, ...; `state.reason` says why
            there is no DT.
        measurements: rows of `transmissibility/table`, shape (m,), the newest last: `transmissibility`, `phase` [rad],
            their standard uncertainties, `impacts_per_cycle` and more. It is empty before the first measurement, which
            takes about 12 s; `transmissibility` of the record is then NaN.
        impact_times: times [s] of the impacts that the analysis found in the acceleration, shape (k,).
        truth: true impacts, shape (j,), rows of `truth/impacts`: `time` [s], `approach_speed` [m/s], `peak_force` [N]
            and more. The analysis does not see them.

    Examples:
        >>> import impact_rig
        >>> record = impact_rig.simulate(20.0)
        >>> dt, standard_uncertainty = record.transmissibility
        >>> print(f"{dt:.2f}, standard uncertainty {standard_uncertainty:.2f}")
        63.57, standard uncertainty 0.16
        >>> record.scans["laser"].shape
        (200000,)
        >>> record.impact_times.shape
        (704,)
        >>> figure = record.plot("traces.png")

    See Also:
        - `simulate`: returns a record.
        - `open_run`: reads a recorded run.
    """

    config: RigConfig
    scans: NDArray[np.void]
    state: TrackerState
    measurements: NDArray[np.void]
    impact_times: NDArray[np.float64]
    truth: NDArray[np.void]

    @property
    def transmissibility(self) -> tuple[float, float]:
        """DT and its standard uncertainty, without unit, of the newest measurement; NaN if none or it failed."""
        row = self.measurements[-1] if len(self.measurements) else np.full((), np.nan, TRANSMISSIBILITY)
        return float(row["transmissibility"]), float(row["transmissibility_uncertainty"])

    def __str__(self) -> str:
        value, u = self.transmissibility
        if not math.isfinite(value):
            return f"no DT: {' '.join((self.state.word, self.state.reason)).strip()}"
        return f"DT {plus_minus(value, u)} (2u) at {self.measurements[-1]['frequency']:g} Hz"

    def plot(self, path: Path | str | None = None) -> Figure:
        """Draw the last half second of base, laser and accelerometer readings against time, with detected impacts.

        Args:
            path: file to write as well, or None. Its suffix (.png, .svg, .pdf, …) selects the format. An existing file
                is replaced.

        Returns:
            The figure.

        Raises:
            ValueError: matplotlib does not know the suffix.
        """
        times = self.scans["time"]
        # a fault may withhold some scans, or all
        rows = self.scans[times > times[-1] - DRAWN_S] if len(times) else self.scans
        begin = rows["time"][0] if len(rows) else math.inf
        figure = time_traces(rows, self.impact_times[self.impact_times >= begin])
        figure.axes[0].set_title(str(self), loc="left", fontsize=9.5, pad=11.0)
        if path is not None:
            figure.savefig(path)
        return figure


def simulate(seconds: float, parameters: Mapping[str, object] | None = None) -> Record:
    """Simulate a rig from rest, and measure its displacement transmissibility DT.

    DT is the amplitude of the structure divided by that of its base, both at the drive frequency. It is measured from
    the readings of the simulated instruments, as on a real rig. The rig is that of the paper: M. Vieira de Albuquerque
    and R. Pederiva, "Modeling of an impact damper submitted to forced vibration from a nonlinear contact force model".
    The same arguments give the same readings, bit for bit, on every machine. The last digits of the measurements may
    differ between machines.

    Args:
        seconds: rig time [s], from one block of scans (10 ms) to 3600, rounded down to whole blocks. The first
            measurement ends after about 12 s; a shorter run has no DT.
        parameters: configuration values that differ from the paper's rig, `section.key` -> value, as in
            docs/reference/configuration.md. Without values of the section `drive`, the drive is that of the paper: a
            sine of 9.1 Hz and 0.52 A peak. If you give any value of this section, also give `drive.amplitude`, because
            it is 0 by default.

    Returns:
        The readings and the measurements. `record.transmissibility` is DT with its standard uncertainty; both are NaN
            if there is no DT.

    Raises:
        ConfigError: a key is unknown, or a value or the duration is out of range.

    Examples:
        The paper's rig with a gap of 6 mm (the default) between sphere and barriers, and without the sphere:

        >>> import impact_rig
        >>> print(impact_rig.simulate(20.0, {"barriers.gap_m": 0.006}))
        DT 63.57 ± 0.32 (2u) at 9.1 Hz
        >>> print(impact_rig.simulate(20.0, {"sphere.present": False}))
        DT 110.71 ± 0.55 (2u) at 9.1 Hz

        Another frequency and current:

        >>> print(impact_rig.simulate(20.0, {"drive.frequency_hz": 8.0, "drive.amplitude": 0.3}))
        DT 4.520 ± 0.026 (2u) at 8 Hz

    See Also:
        - `LocalRig`: accepts commands while the rig runs.
        - `transmissibility`: DT without the sphere, in closed form.
    """
    if not 0.0 < seconds <= LONGEST_S:
        raise ConfigError(f"seconds must be above 0 and at most {LONGEST_S:g} s of rig time, got {seconds!r}")
    given = dict(parameters or {})
    if not any(name.startswith("drive.") for name in given):
        given["drive.amplitude"] = DRIVE_A
    config = from_flat(RigConfig(), given)
    least_s = config.daq.block_scans / config.daq.rate_hz
    if seconds < least_s:
        raise ConfigError(f"seconds must be at least {least_s:g} s, one block of scans, got {seconds!r}")
    rig = LocalRig(config, analysis={}, kept_bytes=None)
    rig.step(math.floor(seconds * rig.rate_hz / rig.block_scans + 1e-9))
    assert rig.tracker is not None
    return Record(
        config=config,
        scans=_since_start(rig, topics.SCAN),
        state=rig.tracker.state,
        measurements=rig.rows(topics.TRANSMISSIBILITY_TABLE.name),
        impact_times=_since_start(rig, topics.IMPACTS)["time"],
        truth=_since_start(rig, topics.IMPACTS_TRUTH),
    )


def _since_start(rig: LocalRig, topic: topics.Topic) -> NDArray[np.void]:
    """Return all rows that a rig has published on a table topic, with `time` in seconds since rig time 0."""
    rows = rig.rows(topic.name)
    tables = rig.tables(topic.name)
    rows["time"] += np.repeat([table.stamp_ns / NS_PER_S for table in tables], [len(table.rows) for table in tables])
    return rows
