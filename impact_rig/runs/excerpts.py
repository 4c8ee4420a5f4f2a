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
"""Frequency response and fitted sines of an excerpt of a recorded run, which the live analysis does not compute.

An excerpt is a series of contiguous scans that is drawn, or measured as one record.
"""

from __future__ import annotations

import math
import sys
from collections import deque
from collections.abc import Iterable, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.frf import Frf, transmissibility_frf
from impact_rig.analysis.sine import SineFit, fit_sine, fit_sine_frequency
from impact_rig.analysis.tracker import Findings
from impact_rig.analysis.transmissibility import Measurement, measure_record
from impact_rig.blocks import Table
from impact_rig.errors import RecordingError
from impact_rig.instruments.section import SCAN, channels_of
from impact_rig.recording import Run
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Status

UNSETTLED_S, UNSETTLED_CYCLES, UNSETTLED_SCANS = 5.0, 24, 200
"""Length of the excerpt of a run without a settled measurement: these seconds, drive cycles or scans, the longest."""
FEWEST_DRAWN = 16  # minimum number of scans of a drawing or a fit
HELD_S = 0.5  # the analysis publishes a measurement at most this time after its last scan [s]
FEWEST_SCANS = 100
MOST_SCANS = 20_000_000  # maximum number of scans of a record; they need 740 MB


@attrs.frozen(eq=False)
class Excerpt:
    """Contiguous scans of a run that are drawn or measured as one record, with drive frequency and detected impacts."""

    rows: NDArray[np.void]
    """Scans (`daq/scan`), shape (n,). Their `time` [s] counts from the first scan of the run, or from the first one
    after the stamps last went back.
    """
    rate_hz: float  # scans per second
    drive_hz: float  # drive frequency, 0 if unknown
    impact_times: NDArray[np.float64]  # times of the impacts detected in it [s, as the rows' time], shape (k,)
    settled: bool  # whether these are the scans of a settled measurement; otherwise they are the last ones of the run

    def newest(self, cycles: int) -> Excerpt:
        """Return the last `cycles` drive cycles (at least one) of this excerpt.

        The result is the whole excerpt if it is shorter or the drive frequency is unknown.
        """
        scans = round(cycles / self.drive_hz * self.rate_hz) if self.drive_hz else len(self.rows)
        rows = self.rows[-scans:]
        return attrs.evolve(self, rows=rows, impact_times=self.impact_times[self.impact_times >= rows["time"][0]])

    def __str__(self) -> str:
        """Return the first and last time of these scans and why they were chosen, as text for titles and messages.

        Times are in seconds, counted as in `rows`.
        """
        where = "of the last settled measurement" if self.settled else "of the end of the run, as nothing settled"
        return f"{self.rows['time'][0]:.2f} s to {self.rows['time'][-1]:.2f} s, {where}"


def last_excerpt(run: Run, found: Sequence[Findings]) -> Excerpt:
    """Return the scans of the last settled measurement of a run; without a settled one, those at the end of the run.

    Scans at the end of the run last for `UNSETTLED_S`, `UNSETTLED_CYCLES` or `UNSETTLED_SCANS`, whichever is longest,
    or less if scans are missing there. `found` are the findings of `reanalysis.analyze`, one for each block of scans.

    Raises:
        RecordingError: the run has no calibration, or the excerpt has fewer than `FEWEST_DRAWN` contiguous scans.
    """
    settled = [
        (number, table)
        for number, one in enumerate(found)
        for table in one.measurements
        if table.rows["settled"][0] == 1.0
    ]
    rate_hz = float(calibration_rows(run)["rate"][0])
    if settled:
        last, measured = settled[-1][0], settled[-1][1]
        drive_hz, end_ns = float(measured.rows["frequency"][0]), measured.stamp_ns
        span_s = float(measured.rows["cycles"][0]) / drive_hz
    else:
        drive = [table.rows["frequency"][-1] for table in run.tables(topics.APPLIED.name, recorded_order=True)]
        last, drive_hz, end_ns = sys.maxsize, float(drive[-1]) if drive else 0.0, None
        cycles_s = UNSETTLED_CYCLES / drive_hz if drive_hz > 0.0 else 0.0
        span_s = max(UNSETTLED_S, cycles_s, UNSETTLED_SCANS / rate_hz)
    first, origin_ns, rows = _newest_scans(run, last, span_s + HELD_S, rate_hz)
    if not len(rows):
        raise RecordingError(f"{run.path} holds no scans to draw: choose a run with scans")
    end_s = rows["time"][-1] if end_ns is None else (end_ns - origin_ns) / NS_PER_S
    within = (rows["time"] > end_s - span_s) & (rows["time"] < end_s + 0.5 / rate_hz)
    if np.count_nonzero(within) < FEWEST_DRAWN:
        where = "of its last settled measurement" if settled else "at its end"
        raise RecordingError(
            f"{run.path}: the {np.count_nonzero(within)} contiguous scans {where} are too few to draw or fit; at least "
            f"{FEWEST_DRAWN} are needed: record a longer run without lost scans"
        )
    rows = rows[within]
    impacts = [_joined(one.impacts, origin_ns)["time"] for one in found[first : last + 1] if one.impacts]
    times = np.concatenate(impacts) if impacts else np.empty(0)
    times = times[(times >= rows["time"][0]) & (times <= rows["time"][-1])]
    return Excerpt(rows, rate_hz, drive_hz, times, settled=bool(settled))


def last_record(run: Run) -> Excerpt:
    """Return the last contiguous scans of a run, at most about `MOST_SCANS`, without drive frequency and impacts.

    The drive may change within them.

    Raises:
        RecordingError: the run has no calibration, or fewer than `FEWEST_SCANS` contiguous scans at its end.
    """
    rate_hz = float(calibration_rows(run)["rate"][0])
    _, _, rows = _newest_scans(run, sys.maxsize, MOST_SCANS / rate_hz, rate_hz)
    if len(rows) < FEWEST_SCANS:
        raise RecordingError(
            f"{run.path} ends with {len(rows)} contiguous scans, too few for a frequency response or a decay; at least "
            f"{FEWEST_SCANS} are needed: record a longer run without lost scans"
        )
    return Excerpt(rows, rate_hz, 0.0, np.empty(0), settled=False)


def calibration_rows(run: Run) -> NDArray[np.void]:
    """Return the rows of the newest calibration of a run (`daq/info`).

    Raises:
        RecordingError: the run holds no calibration.
    """
    tables = list(run.tables(topics.INFO.name))
    if not tables:
        raise RecordingError(
            f"{run.path} holds no calibration (daq/info), so the rate and units of its scans are unknown: choose "
            "a run with a calibration"
        )
    return tables[-1].rows


def _newest_scans(run: Run, last: int, span_s: float, rate_hz: float) -> tuple[int, int, NDArray[np.void]]:
    """Return the newest contiguous scans up to the end of block `last` (from 0), at most about `span_s` seconds.

    Returns:
        The number of the block from which times count: the first block of the run, or the first one after its stamps
        last went back. Then the stamp of this block [ns], and the rows, whose `time` [s] counts from this stamp.
    """
    kept: deque[Table] = deque()
    first, origin_ns = 0, 0
    for number, table in enumerate(run.tables(topics.SCAN.name, recorded_order=True)):
        if number > last:
            break
        expected_ns = kept[-1].stamp_ns + len(kept[-1].rows) * NS_PER_S / rate_hz if kept else -math.inf
        if abs(table.stamp_ns - expected_ns) > 0.5 * NS_PER_S / rate_hz:
            if not kept or table.stamp_ns < kept[-1].stamp_ns:
                first, origin_ns = number, table.stamp_ns
            kept.clear()
        kept.append(table)
        while table.stamp_ns - kept[0].stamp_ns > span_s * NS_PER_S:
            kept.popleft()
    return first, origin_ns, _joined(kept, origin_ns) if kept else np.empty(0, SCAN)


def _joined(tables: Iterable[Table], origin_ns: int) -> NDArray[np.void]:
    """Return the rows of all tables as one array, with `time` [s] counted from the rig time `origin_ns` [ns]."""
    parts = []
    for table in tables:
        rows = table.rows.copy()
        rows["time"] += (table.stamp_ns - origin_ns) / NS_PER_S
        parts.append(rows)
    return np.concatenate(parts)


# the first of these channels that was measured is the reference of phases and frequency
REFERENCES = ("current", "base", "laser", "accelerometer")
COHERENT = 0.9  # coherence of base and laser that at least one excited frequency must have


def response_of(
    run: Run, segment_s: float | None = None, window: str = "hann", damping_ratio: float | None = None
) -> Frf:
    """Return the frequency response x_1 / x_b (laser / base) of the last contiguous scans of a run.

    Args:
        run: an open run.
        segment_s: length of the segments over which spectra are averaged [s]: frequencies are 1 / segment_s apart. None
            selects a length that resolves the resonance.
        window: name of a window of `analysis.frf`.
        damping_ratio: damping ratio of the resonance, which affects the selected segment length and the uncertainty;
            None means the estimated one.

    Raises:
        RecordingError: the scans are too few, lack laser, base or a calibration, an argument is invalid, or no excited
            frequency has a coherence of at least `COHERENT`.
    """
    excerpt = last_record(run)
    need_motions(run, excerpt.rows)
    segment = None if segment_s is None else round(segment_s * excerpt.rate_hz)
    try:
        found = transmissibility_frf(
            excerpt.rows, calibration_rows(run), segment, window=window, damping_ratio=damping_ratio
        )
    except ValueError as error:  # ConfigError is one
        seconds = len(excerpt.rows) / excerpt.rate_hz
        raise RecordingError(
            f"{run.path}: its last contiguous scans ({seconds:g} s) give no frequency response of base (x) and laser "
            f"(y): {error}"
        ) from error
    if not np.any(np.nan_to_num(found.coherence[found.excited]) >= COHERENT):
        raise RecordingError(
            f"{run.path}: the coherence of base and laser is below {COHERENT} at all excited frequencies: record a run "
            "with drive.waveform chirp or random, or choose longer segments (--segment S)"
        )
    return found


def need_motions(run: Run, rows: NDArray[np.void]) -> None:
    """Check that scans of a run contain the channels `laser` (x_1) and `base` (x_b), whose ratio is measured.

    Raises:
        RecordingError: a channel is missing; the message names it.
    """
    missing = [name for name in ("laser", "base") if name not in channels_of(rows)]
    if missing:
        raise RecordingError(
            f"{run.path} has no channel {' and no channel '.join(missing)}: x_1/x_b needs laser and base; "
            "choose a run with both"
        )


@attrs.frozen(eq=False)
class Sines:
    """Sines fitted to all channels of an excerpt at one frequency, which is fitted to a reference channel first."""

    reference: SineFit
    """Fit of the reference channel, including its frequency, which all other fits use.

    The reference is the first of current, base, laser and accelerometer that was measured.
    """
    reference_name: str
    fits: dict[str, SineFit]  # fit of every channel at the frequency of the reference, by name
    measured: Measurement | None
    """Transmissibility of the whole excerpt at the commanded frequency; None if laser or base was not measured."""
    excerpt: Excerpt


def sines_of(run: Run, excerpt: Excerpt) -> Sines:
    """Fit sines of one frequency to all channels of an excerpt of a run.

    The frequency is that of the reference channel (`Sines.reference`), searched near the drive frequency.

    Raises:
        RecordingError: the drive frequency is unknown, or the reference channel has no sine near that frequency.
    """
    if not excerpt.drive_hz > 0.0:
        raise RecordingError(
            f"{run.path} holds no drive frequency (shaker/applied) for the scans {excerpt}: choose a run with a "
            "drive of one frequency"
        )
    samples = {name: np.asarray(excerpt.rows[name], dtype=np.float64) for name in channels_of(excerpt.rows)}
    name = next(name for name in REFERENCES if name in samples)
    reference = fit_sine_frequency(samples[name], excerpt.rate_hz, excerpt.drive_hz)
    if reference.status is not Status.OK:
        raise RecordingError(
            f"{run.path}: the channel {name} is not a sine of the drive frequency {excerpt.drive_hz:g} Hz in the scans "
            f"{excerpt}; its fit gives {reference.status.value} ({reference.status.doc}); "
            "choose a run with a sine drive"
        )
    return Sines(
        reference=reference,
        reference_name=name,
        fits={name: fit_sine(y, excerpt.rate_hz, reference.frequency_hz) for name, y in samples.items()},
        measured=measure_record(excerpt.rows, calibration_rows(run), excerpt.drive_hz)
        if {"laser", "base"} <= set(samples)
        else None,
        excerpt=excerpt,
    )
