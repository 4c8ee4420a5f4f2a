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
"""Comparison of a measured run with the simulated model, which gets the same drive and the same analysis as the run.

The drive is the measured coil current or base motion, corrected for the lag and skew of its sensor. The motion of the
model replaces the measured scans, and the same analysis measures it at the same times. The results of run and model
therefore differ only by the constants of the model and the errors of the sensors. The stated uncertainty u covers the
errors of the sensors.

The run is divided where scans are missing and where the label of the barriers' gap changes. Each part is simulated
separately. The drive before the first scan of a part is assumed: a sine if the structure moves steadily in the first
cycles, otherwise zero. If several steady motions of the sphere are possible, the model may settle in another motion
than the rig.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.calibration import Calibration, Real
from impact_rig.analysis.scans import BASE, CHANNELS, CURRENT, LASER, SCAN, samples_of
from impact_rig.blocks import Table
from impact_rig.drawing import MEASURED, MUTED, PREDICTED, WIDE_INCH, Drawn, Line, new_axes, style
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.physics import Simulation
from impact_rig.recording import CONFIGURATION, Run
from impact_rig.rig.config import RigConfig, from_flat, parse
from impact_rig.rig.core import new_generator
from impact_rig.rig.gaps import NO_SPHERE, gap_values
from impact_rig.runs import drawings, reanalysis
from impact_rig.runs.excerpts import Excerpt, calibration_rows, last_excerpt
from impact_rig.simtime import COMMAND_GRID_NS, NS_PER_S, stamp_ns
from impact_rig.system import budget
from impact_rig_studies.campaign.plan import RESET
from impact_rig_studies.campaign.results import Curves, Point
from impact_rig_studies.identification.fit import Identified, identify, logarithms
from impact_rig_studies.identification.measurements import Gains, Measured, reduced_of, sine_of

DRIVES = {"current": ("current", CURRENT), "base": ("prescribed", BASE)}
"""Measured quantity that can drive the model -> `drive.kind` of the model, and index of the quantity's channel."""
STREAM_HZ = 10_000
BAND_HZ, BAND_SHARE = 300.0, 0.4
"""Upper edge of the frequency band of a corrected channel: `BAND_HZ` [Hz] or `BAND_SHARE` of the scan rate.

The lower of the two counts. Components above the edge are noise of the sensor and are removed.
"""
FADE = 0.8  # fraction of the upper band edge from which components are attenuated, down to zero at the edge
# lower band edge of the motion from velocities and accelerations, as a fraction of the drive frequency
LOWEST_SHARE = 0.3
# length of a record that is mirrored at both ends, so that the correction of a lag has no edge effects
MIRRORED_S = 0.5
FORGOTTEN = 7.0  # time constants of the structure before the first scan: e⁻⁷ is 0.1 %
LONGEST_LEAD_S, RISE_S = 120.0, 1.0
FIRST_CYCLES, ALIKE = 4, 0.02
"""Number of drive cycles that are compared with as many following ones, and largest relative change of a steady motion.

The motion of the structure counts as steady from the first scan on if its phasor changes by at most this share.
"""
SHORTEST = 4  # fewest scans of a stretch that a cubic spline can interpolate; a shorter stretch is not simulated
TICKS_AT_ONCE = 50
PER_TICK = STREAM_HZ * COMMAND_GRID_NS // NS_PER_S
SCANS = 20_000_000  # limit for a compared run


@attrs.frozen
class ComparedPoint:
    """Measured result at one gap and drive frequency, and the model's result for the same drive."""

    gap_m: float  # label, NaN if unknown
    frequency_hz: float  # of the drive
    measured: np.void  # row of `transmissibility/table`
    model: np.void | None  # such a row of the model; None if the model did not settle
    more: np.void | None
    """Row of the model when the drive is larger by one standard uncertainty of the gain of the drive's sensor.

    None if the model did not settle with this drive, or without the sphere, where DT does not depend on the drive.
    """

    def off(self, column: str) -> float:
        """Return measured minus model of the column `transmissibility` or `phase`, divided by its standard uncertainty.

        The uncertainty of this difference comes from the uncertainties of both rows and from the gain of the drive's
        sensor. The result is NaN if the model did not settle.
        """
        if self.model is None:
            return math.nan
        by_drive = 0.0 if self.more is None else _less(self.more, self.model, column)
        own = (float(row[f"{column}_uncertainty"]) for row in (self.measured, self.model))
        return _less(self.measured, self.model, column) / math.hypot(*own, by_drive)


def _less(one: np.void, other: np.void, column: str) -> float:
    """Return the difference of a column between two rows: `one` minus `other`.

    For the column `phase`, the difference is wrapped into −π … π [rad].
    """
    difference = float(one[column] - other[column])
    return math.remainder(difference, 2.0 * math.pi) if column == "phase" else difference


@attrs.frozen(eq=False)
class Comparison:
    """Result of `compare`: DT and scans of a measured run, and those of the model.

    The model is driven by the measured coil current or base motion, sample by sample.
    """

    driven_by: str  # `current` or `base`
    config: RigConfig  # configuration of the model
    places: tuple[ComparedPoint, ...]  # results at each gap and frequency, ascending by gap, then frequency
    excerpt: Excerpt  # scans of the last settled measurement; laser, base and current are corrected for lag and skew
    model: NDArray[np.void]  # scans of the model at the times of the excerpt, shape of `excerpt.rows`
    constants: Identified | None
    """Constants of the rig that fit these measurements best; None if no fit was requested or something is `missing`."""
    missing: tuple[str, ...] = ()  # what a requested fit needs and the run lacks, such as "a measured current"

    @property
    def residual(self) -> Real:
        """Measured minus simulated x_1 (superior base) at each scan of the excerpt [m], each without its mean."""
        measured, model = (samples_of(rows, "laser") for rows in (self.excerpt.rows, self.model))
        return np.asarray((measured - measured.mean()) - (model - model.mean()))


def compare(
    run: Run,
    known: RigConfig | None = None,
    driven_by: str | None = None,
    *,
    fits: bool = True,
    on_step: Callable[[str], None] = lambda _: None,
) -> Comparison:
    """Analyse a run, simulate the model with the run's measured drive, and analyse the model in the same way.

    The newest settled measurement at each gap and frequency is compared.

    Args:
        run: an open run, recorded or imported.
        known: configuration of the model; None means the one stored in the run, or the default rig if there is none.
        driven_by: measured quantity that drives the model, a key of `DRIVES`; None means the current if it was
            measured, else the base.
        fits: whether to search for the constants with which the model fits best.
        on_step: receives a description of each step before it begins.

    Raises:
        ConfigError: the drive was not measured, or a gap or value of the configuration is invalid for the model.
        RecordingError: no measurement settled, a reading is not finite, or the rig was restarted during the run.
        BudgetError: the run has more than `SCANS` scans.
        SimulationError: the model's motion cannot be resolved.
    """
    info = calibration_rows(run)
    calibration = Calibration.from_info(info)
    chosen = driven_by or ("current" if calibration.present[CURRENT] else "base")
    kind, channel = DRIVES[chosen]
    if not calibration.present[channel]:
        other = "base" if chosen == "current" else "current"
        hint = (
            f"; use --drive {other}"
            if calibration.present[DRIVES[other][1]]
            else f"; {other} was not measured either: choose another run"
        )
        raise ConfigError(f"{run.path}: {chosen} was not measured, so it cannot drive the model{hint}")
    if known is None:
        attached = run.attachments().get(CONFIGURATION)
        try:
            known = RigConfig() if attached is None else parse(attached)
        except ConfigError as error:
            raise ConfigError(f"{error} ({CONFIGURATION} stored in {run.path})") from error
    on_step("measuring the run")
    found = list(reanalysis.analyze(run))
    measured = reanalysis.newest_settled(reanalysis.measurements(iter(found)))
    if not len(measured):
        raise RecordingError(
            f"{run.path}: no measurement of DT settled, so there is nothing to compare; "
            "`impact-rig analyze --all` shows the status of each measurement"
        )
    scans = _ModelledScans(run, calibration)

    def modelled(gain: float) -> NDArray[np.void]:
        for number, stretch in enumerate(scans.stretches, 1):
            on_step(f"driving the model by the measured {chosen}, part {number} of {len(scans.stretches)}")
            _drive(scans, stretch, known, kind, channel, gain)
        scans.begin = 0
        return reanalysis.newest_settled(reanalysis.measurements(reanalysis.analyze(run, instead=scans.instead)))

    gain = 1.0 + float(calibration.gain_uncertainty[channel])
    more = modelled(gain) if np.any(measured["gap"] != NO_SPHERE) else None
    model = modelled(1.0)
    places = tuple(
        ComparedPoint(
            float(row["gap"]),
            float(row["frequency"]),
            row,
            _same(row, model),
            None if more is None or row["gap"] == NO_SPHERE else _same(row, more),
        )
        for row in measured
    )
    excerpt = last_excerpt(run, found)
    own = scans.at(excerpt)
    constants, missing = None, _missing(measured, known) if fits else ()
    if fits and not missing:
        on_step("fitting the constants")
        constants = _constants(measured, Gains.of(info), known, on_step)
    return Comparison(
        chosen, known, places, attrs.evolve(excerpt, rows=scans.true[own]), scans.model[own], constants, missing
    )


def _same(row: np.void, rows: NDArray[np.void]) -> np.void | None:
    """Return the first row of `rows` with exactly the gap and frequency of `row`; None if there is none.

    Two unknown gaps count as equal.
    """
    same = (rows["frequency"] == row["frequency"]) & (
        (rows["gap"] == row["gap"]) | (np.isnan(rows["gap"]) & np.isnan(row["gap"]))
    )
    return rows[same][0] if same.any() else None


@attrs.frozen
class _Stretch:
    """Part of a run without missing scans, with one label of the barriers' gap.

    It consists of the scans `first` … `last` − 1. `gap_m` is the label, NaN if unknown. `drive_hz` is the drive
    frequency at the first scan, 0 if unknown.
    """

    first: int
    last: int
    gap_m: float
    drive_hz: float


class _ModelledScans:
    """All scans of a run (`true`), and the scans of the model (`model`) at the same times.

    In `true`, laser, base and current are corrected for the lag and skew of their sensors. Laser and base are
    displacements [m], whatever their sensors measure. The scans are simulated in stretches, which end where scans are
    missing or the label of the gap changes. In `model`, stretches that have not been simulated yet are zero.
    """

    def __init__(self, run: Run, calibration: Calibration) -> None:
        tables = list(run.tables(topics.SCAN.name, recorded_order=True))
        budget.allow("scans of a run that is compared", sum(len(table.rows) for table in tables), SCANS)
        self.calibration, self.rate_hz = calibration, calibration.rate_hz
        measured = np.concatenate([table.rows for table in tables])
        self.stamps = np.concatenate(
            [table.stamp_ns + np.arange(len(table.rows)) * NS_PER_S // self.rate_hz for table in tables]
        )
        if any(after.stamp_ns <= before.stamp_ns for before, after in itertools.pairwise(tables)):
            raise RecordingError(
                f"{run.path}: the stamps of its scans go back, as after a restart of the rig; only a run without a "
                "restart can be compared: record one"
            )
        self.true = np.zeros(len(measured), SCAN)
        for name in CHANNELS:
            self.true[name] = samples_of(measured, name)
        wrong = next((name for name in CHANNELS if not np.all(np.isfinite(self.true[name]))), None)
        if wrong is not None:
            count = np.count_nonzero(~np.isfinite(self.true[wrong]))
            raise RecordingError(
                f"{run.path}: {count} readings of the channel {wrong} are not finite, so the run cannot be compared: "
                "measure again, or repair the data and import them again"
            )
        self.stretches = list(self._stretches(run))
        for stretch in self.stretches:
            for channel in (LASER, BASE, CURRENT):
                part = self.true[CHANNELS[channel]][stretch.first : stretch.last]
                part[:] = undone(part, calibration, channel, stretch.drive_hz)
        self.model = np.zeros(len(measured), SCAN)
        self.begin = 0  # index of the first scan in the table that `instead` replaces next

    def _stretches(self, run: Run) -> Iterator[_Stretch]:
        labels = sorted(reanalysis.as_set_live(run)[1], key=lambda label: label.stamp_ns)
        drives = [(table.stamp_ns, float(table.rows["frequency"][-1])) for table in run.tables(topics.APPLIED.name)]
        gaps = np.flatnonzero(np.abs(np.diff(self.stamps) * self.rate_hz / NS_PER_S - 1.0) > 0.5) + 1
        changes = np.searchsorted(self.stamps, [label.stamp_ns for label in labels])
        cuts = sorted({0, *gaps.tolist(), *changes.tolist(), len(self.stamps)})
        for first, last in itertools.pairwise(cuts):
            at = self.stamps[first]
            gap = next((label.gap_m for label in reversed(labels) if label.stamp_ns <= at), math.nan)
            drive = next((hz for stamp, hz in reversed(drives) if stamp <= at), 0.0)
            yield _Stretch(first, last, gap, drive)

    def instead(self, topic: topics.Topic, table: Table) -> Table:
        """Return a table of the model in place of a measured table, so that the analysis measures the model.

        A table of `daq/info` is replaced by a calibration without errors. A table of `daq/scan` is replaced by the
        model's scans at the same times. Tables of `daq/scan` must be passed in the order of the run, and other topics
        not at all.
        """
        if topic is topics.INFO:
            rows = table.rows.copy()
            rows["unit"][np.isin(rows["name"], [b"laser", b"base"])] = b"m"  # independent of the sensors
            for name in set(rows.dtype.names or ()) - {"name", "unit", "rate", "since_start"}:
                rows[name] = {"range_low": -math.inf, "range_high": math.inf, "sensitivity": 1.0}.get(name, 0.0)
            return Table(table.stamp_ns, rows)
        rows = table.rows.copy()
        here = slice(self.begin, self.begin + len(rows))
        self.begin += len(rows)
        for name in CHANNELS:
            if name in (rows.dtype.names or ()):
                rows[name] = self.model[name][here]
        rows["status"] = 0
        return Table(table.stamp_ns, rows)

    def at(self, excerpt: Excerpt) -> slice:
        """Return the index range of an excerpt's scans in `true` and `model`.

        As a side effect, the column `time` of both is filled with the seconds since the first scan of the run.
        """
        # the time of an excerpt counts from the first scan
        offsets = np.round((self.stamps - self.stamps[0]) / NS_PER_S * self.rate_hz)
        first = int(np.searchsorted(offsets, round(float(excerpt.rows["time"][0]) * self.rate_hz)))
        self.true["time"] = self.model["time"] = (self.stamps - self.stamps[0]) / NS_PER_S
        return slice(first, first + len(excerpt.rows))


def undone(values: Real, calibration: Calibration, channel: int, drive_hz: float) -> Real:
    """Correct a channel's readings for the lag and skew of the sensor, and return the true quantity, shape (n,).

    Components above the frequency band (`BAND_HZ`, `BAND_SHARE`) are removed as noise. Velocities and accelerations are
    integrated to displacements [m].

    Args:
        values: contiguous readings in the unit of the channel, shape (n,).
        calibration: calibration of the instruments.
        channel: index of the channel in `scans.CHANNELS`.
        drive_hz: frequency of the drive, 0 if unknown. If readings are integrated, slow components are removed as
            drift. These are components below `LOWEST_SHARE` of the drive frequency, or with less than one cycle in the
            readings.
    """
    rate = calibration.rate_hz
    around = min(round(MIRRORED_S * rate), len(values) - 1)
    is_integrated = bool(calibration.derivative[channel])
    if is_integrated:
        fade = np.sin(0.5 * np.pi * np.arange(around) / max(around, 1)) ** 2
        values = values - values.mean()
        before = _continued(values[::-1], drive_hz / rate, around)[::-1]
        mirrored = np.concatenate([fade * before, values, fade[::-1] * _continued(values, drive_hz / rate, around)])
    else:
        mirrored = np.pad(values, around, mode="reflect", reflect_type="odd")
    frequency = np.fft.rfftfreq(len(mirrored), 1.0 / rate)
    top = min(BAND_HZ, BAND_SHARE * rate)
    edge = np.sin(0.5 * np.pi * np.clip((top - frequency) / ((1.0 - FADE) * top), 0.0, 1.0)) ** 2
    if is_integrated:
        edge[frequency < max(LOWEST_SHARE * drive_hz, rate / len(values))] = 0.0
    inside = edge > 0.0
    spectrum = np.fft.rfft(mirrored) * edge
    spectrum[inside] /= calibration.response(channel, frequency[inside])
    found: Real = np.fft.irfft(spectrum, len(mirrored))[around : around + len(values)]
    return found


def _continued(values: Real, turns: float, count: int) -> Real:
    """Return `count` values that continue `values` by the sine fitted to their last `FIRST_CYCLES` cycles.

    `turns` is the drive frequency in cycles per sample; 0 means unknown, and the result is then zero.
    """
    if not turns > 0.0:
        return np.zeros(count)
    newest = values[-min(len(values), round(FIRST_CYCLES / turns)) :]
    angle = 2.0 * np.pi * turns * np.arange(len(newest) + count)
    sines = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(sines[len(newest) :] @ np.linalg.lstsq(sines[: len(newest)], newest, rcond=None)[0])


def _drive(scans: _ModelledScans, stretch: _Stretch, config: RigConfig, kind: str, channel: int, gain: float) -> None:
    """Simulate one stretch of the run with the measured drive times `gain`, and store its scans in `scans.model`.

    A stretch of fewer than `SHORTEST` scans is not simulated: its scans stay zero.
    """
    rate, own = scans.rate_hz, slice(stretch.first, stretch.last)
    measured = gain * scans.true[CHANNELS[channel]][own]
    if len(measured) < SHORTEST:
        return
    if kind == "prescribed":
        measured -= measured.mean()
    config = _model(config, stretch.gap_m, kind)
    structure = config.structure
    forgets_s = FORGOTTEN / (2.0 * math.pi * structure.natural_frequency_hz * structure.damping_ratio)
    lead_s = math.ceil(min(forgets_s, LONGEST_LEAD_S))
    before_s = np.arange(-lead_s * STREAM_HZ, 0) / STREAM_HZ
    lead = _lead(measured, scans.true["laser"][own], rate, stretch.drive_hz, before_s)
    n = len(measured)
    samples = np.arange(math.ceil((n - 1) / rate * STREAM_HZ) + 1) / STREAM_HZ
    curve = scipy.interpolate.CubicSpline(np.arange(n) / rate, measured)
    drive = np.concatenate([lead, curve(np.minimum(samples, (n - 1) / rate))])
    drive = np.append(drive, np.full(2 * PER_TICK, drive[-1]))
    instants = np.array([stamp_ns(scan, rate) for scan in range(n)]) + lead_s * NS_PER_S
    ticks, offsets = np.divmod(instants, COMMAND_GRID_NS)
    simulation, source = Simulation(config), new_generator(config)
    assert source.stream is not None
    for tick in range(0, int(ticks[-1]) + 1, TICKS_AT_ONCE):
        count = min(TICKS_AT_ONCE, int(ticks[-1]) + 1 - tick)
        first = source.stream.played
        source.stream.put(first, drive[first : (tick + count) * PER_TICK + 2])
        motion = simulation.advance(source.segments(count))
        here = slice(*np.searchsorted(ticks, [tick, tick + count]))
        if here.start < here.stop:
            found = motion.quantities(("a_1", "x_1", "x_b"), ticks[here], offsets[here] / NS_PER_S)
            rows = slice(stretch.first + here.start, stretch.first + here.stop)
            for name, values in zip(CHANNELS, found, strict=False):
                scans.model[name][rows] = values
    scans.model["current"][own] = scans.true["current"][own]


def _model(config: RigConfig, gap_m: float, kind: str) -> RigConfig:
    """Return `config` with a drive `kind` by streamed samples, and with the gap `gap_m` unless that is NaN."""
    changes: dict[str, object] = {
        "drive.kind": kind,
        "drive.waveform": "stream",
        "drive.stream_hold": "first_order",
        "drive.amplitude": 0.0,
        "drive.stream_rate_hz": STREAM_HZ,
    }
    if not math.isnan(gap_m):
        changes |= gap_values(gap_m)
    return from_flat(config, changes)


def _lead(measured: Real, structure: Real, rate_hz: float, drive_hz: float, time_s: Real) -> Real:
    """Return an assumed drive at the times `time_s` before the first scan (< 0, relative to the first scan [s]).

    If the measured motion `structure` is steady from the first scan on, the drive is the sine of the first cycles of
    the measured drive, which rises from zero. Otherwise, or if this cannot be decided, the drive is zero.
    """
    count = round(FIRST_CYCLES / drive_hz * rate_hz) if drive_hz > 0.0 else 0
    if not 0 < 2 * count <= len(measured):
        return np.zeros(len(time_s))
    turn = 2.0 * np.exp(-2j * np.pi * drive_hz * np.arange(2 * count) / rate_hz) / count
    first, next_ones = (structure[part] @ turn[part] for part in (slice(count), slice(count, 2 * count)))
    if not 0.0 < abs(next_ones - first) <= ALIKE * abs(first):
        return np.zeros(len(time_s))
    phasor = np.sum(measured[:count] * turn[:count])
    rise = np.clip((time_s - time_s[0]) / RISE_S, 0.0, 1.0)
    return np.asarray(rise * (phasor * np.exp(2j * np.pi * drive_hz * time_s)).real)


def _gaps(rows: NDArray[np.void], known: RigConfig) -> Real:
    """Return the gap [m] of each measurement; 0 means that there is no sphere.

    An unknown gap is replaced by the gap of the model `known`.
    """
    return np.asarray(np.nan_to_num(rows["gap"], nan=known.barriers.gap_m if known.sphere.present else NO_SPHERE))


def _missing(rows: NDArray[np.void], known: RigConfig) -> tuple[str, ...]:
    """Return, as texts for the user, the data that the fit of the constants needs and these measurements lack.

    A measurement of unknown gap counts as one at the gap of the model `known`.
    """
    free = _gaps(rows, known) == NO_SPHERE
    has_current = np.any(rows["current_amplitude"][free if free.any() else slice(None)] > 0.0)
    needs = {"DT without the sphere": free.any(), "a measured current": has_current}
    return tuple(what for what, there in needs.items() if not there)


def _constants(rows: NDArray[np.void], gains: Gains, known: RigConfig, on_step: Callable[[str], None]) -> Identified:
    """Fit the constants jointly to DT without the sphere and to the sphere's reductions of DT at one frequency.

    Of the frequencies measured without the sphere, it is the frequency with the most gaps. Rows without a measured
    current are left out. `gains` are the uncertainties of the sensors' calibration.
    """
    points = [
        Point(
            study="compare", axes={}, reference=True, frequency_hz=float(row["frequency"]),
            gap_m=float(gap),
            current_a=float(row["current_amplitude"]), direction=RESET, rows=row.reshape(1), failure="", key="",
        )
        for row, gap in zip(rows, _gaps(rows, known), strict=True)
        if row["current_amplitude"] > 0.0
    ]  # fmt: skip
    curves = Curves.of(points)
    frequencies = curves.frequencies(NO_SPHERE)
    sine = sine_of([point for f in frequencies if (point := curves.at(NO_SPHERE, f)) is not None], gains)
    gaps = tuple(curves.gaps())
    at_hz = max(frequencies, key=lambda f: sum(curves.at(gap, f) is not None for gap in gaps))
    return identify(
        Measured(gains=gains, sine=sine, reduced=reduced_of(curves, at_hz, gaps, gains)),
        known,
        logarithms(known),
        on_step,
    )


TRACED_CYCLES = 6  # number of drive cycles whose motion is drawn


@style()
def drawn(found: Comparison, name: str) -> Drawn:
    """Draw a comparison in three panels; `name` is the run's name in the title.

    The first panel shows measured minus model in standard uncertainties. The second panel shows the motion of the
    structure in the last cycles. The third panel shows the spectra of the measured motion and of its difference from
    the model.
    """
    figure, (apart, traces, lines) = new_axes(7.5, (1.0, 1.0, 1.0), WIDE_INCH, share=False)
    rate, drive = found.excerpt.rate_hz, found.excerpt.drive_hz
    numbers: list[Line] = []
    apart.axhspan(-2.0, 2.0, color=MUTED, alpha=0.15, linewidth=0.0)
    for gap in dict.fromkeys(str(one.gap_m) for one in found.places):
        own = [one for one in found.places if str(one.gap_m) == gap]
        label = "gap unknown" if gap == "nan" else f"gap {1e3 * float(gap):g} mm" if float(gap) else "no sphere"
        frequency = [one.frequency_hz for one in own]
        dt, phase = ([one.off(column) for one in own] for column in ("transmissibility", "phase"))
        (line,) = apart.plot(frequency, dt, "o", label=f"DT, {label}")
        apart.plot(frequency, phase, "o", fillstyle="none", color=line.get_color(), label=f"phase, {label}")
        numbers.append(Line(label, {"frequency_hz": frequency, "dt_off_u": dt, "phase_off_u": phase}))
    apart.set(xlabel="frequency (Hz)", ylabel="measured − model (u)", title=f"{name}: driven by the {found.driven_by}")
    apart.set_yscale("symlog", linthresh=10.0)
    apart.margins(0.15)
    apart.legend(ncols=2)
    cycles = round(TRACED_CYCLES / drive * rate) if drive else len(found.model)
    newest = slice(max(0, len(found.model) - cycles), None)
    time = found.excerpt.rows["time"][newest]
    measured, model = (samples_of(rows, "laser")[newest] for rows in (found.excerpt.rows, found.model))
    residual = found.residual
    traces.plot(time, 1e3 * (measured - measured.mean()), color=MEASURED, label="$x_1$ measured")
    traces.plot(time, 1e3 * (model - model.mean()), "--", color=PREDICTED, label="$x_1$ model")
    traces.plot(time, 1e3 * residual[newest], color=MUTED, linewidth=0.8, label="difference")
    traces.set(xlabel="time (s)", ylabel="motion (mm)")
    traces.legend(ncols=3, loc="lower right", bbox_to_anchor=(1.0, 1.0))
    for y, colour, label in (
        (samples_of(found.excerpt.rows, "laser"), MEASURED, "$x_1$ measured"),
        (residual, MUTED, "difference"),
    ):
        frequency_hz, power = scipy.signal.periodogram(
            y, rate, window="flattop", scaling="spectrum", detrend="constant"
        )
        shown = (frequency_hz > 0.0) & (frequency_hz <= min(drawings.HARMONICS * drive or math.inf, rate / 2.0))
        amplitude = 1e3 * np.sqrt(2.0 * power[shown])
        lines.semilogy(frequency_hz[shown], amplitude, color=colour, linewidth=0.8, label=label)
        numbers.append(Line(label, {"frequency_hz": frequency_hz[shown].tolist(), "amplitude_mm": amplitude.tolist()}))
    lines.set(xlabel="frequency (Hz)", ylabel="amplitude (mm)")
    lines.legend()
    return Drawn("comparison", figure, f"{name}: measured and model, {found.excerpt}; the band is ± 2u.", numbers)
