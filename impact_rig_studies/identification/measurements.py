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
"""Measurements in the form in which `fit.identify` uses them: noise is separated from calibration errors.

Calibration errors are common to all points. Each sensor has one relative error of its gain. The laser and the base
sensor also have one nonlinearity (curve) each, see `analysis.calibration`. The fit treats these errors as nuisance
parameters (unknowns of no interest) with the standard uncertainties of the certificate. The remaining deviation of each
point is noise.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.analysis.calibration import U_CUBIC, Calibration, Real
from impact_rig.analysis.scans import BASE, CURRENT, LASER, Recent, samples_of
from impact_rig.driver import LocalRig
from impact_rig.errors import RecordingError
from impact_rig.recording import Run, is_measured
from impact_rig.rig import InputKind
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.runs import recorded_journal
from impact_rig.runs.excerpts import calibration_rows, last_record
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Regime
from impact_rig_studies.campaign.results import Curves, Point
from impact_rig_studies.decay import Decay, DecayMethod, fit_decay, measure_decay
from impact_rig_studies.identification import U_RESTITUTION
from impact_rig_studies.reduction import repeatability

LEAST_NOISE = 1e-4  # smallest relative standard uncertainty by noise that is assumed, even if the scatter is smaller
CALIBRATION = ("gain laser", "gain base", "gain current", "curve laser", "curve base")
NUISANCES = (*CALIBRATION, "DT without sphere")
"""Nuisance parameters: relative errors that several measured values share.

"DT without sphere" is the error by noise of the measurement to which all reductions refer.
"""
GAIN_CURRENT = NUISANCES.index("gain current")


@attrs.frozen(eq=False)
class SineData:
    """Amplitudes and phases of n points of a stepped sine without the sphere.

    x_1 is the displacement of the superior base, x_b that of the inferior base.
    """

    frequency_hz: Real  # drive frequency of each point, shape (n,), as all other fields
    dt: Real  # transmissibility |X_1 / X_b|
    phase_rad: Real  # phase of x_1 relative to x_b [rad]
    base_per_a: Real  # amplitude of x_b over amplitude of the current [m/A]
    laser_m: Real  # amplitude of x_1, peak [m]
    base_m: Real  # amplitude of x_b, peak [m]
    u_amplitude: Real  # relative standard uncertainty of dt and base_per_a, by noise alone
    u_phase: Real  # standard uncertainty of phase_rad [rad], by noise alone


@attrs.frozen(eq=False)
class Reduced:
    """Measured ratios of DT with the sphere to DT without the sphere, at one frequency and n gaps.

    DT is the transmissibility, the ratio of the amplitudes of superior and inferior base.
    """

    frequency_hz: float  # drive frequency
    current_a: Mapping[float, float]  # measured amplitude of the current with the sphere [A peak], by gap [m]
    ratio: Mapping[float, float]  # DT with the sphere / DT without, by gap [m]
    u: Real  # relative standard uncertainty due to the noise of DT with the sphere, shape (n,)
    u_without: float  # relative standard uncertainty due to the noise of DT without the sphere
    effects: Real
    """Derivatives of ln ratio by the nuisance parameters (`NUISANCES`), shape (n, 6).

    The effect of the gain of the current is left out, because it acts through the simulated motion.
    """
    regimes: Mapping[float, str]
    """Measured regime of the motion with the sphere, by gap [m]; `unknown` if impacts were not counted.

    A light sphere can strike irregularly at a constant amplitude of the base.
    """


@attrs.frozen(eq=False)
class Gains:
    """Calibration errors of the sensors: their standard uncertainties, and their effects on measured amplitudes."""

    u: Real  # relative standard uncertainty of each error in `CALIBRATION`, shape (5,)
    calibration: Calibration  # calibration of the sensors according to their certificate

    @classmethod
    def of(cls, info: NDArray[np.void]) -> Gains:
        """Read the calibration certificate of the sensors from rows of `daq/info`."""
        calibration = Calibration.from_info(info)
        halves = [(channel, _half_range(calibration, channel)) for channel in (LASER, BASE)]
        bent = [float(calibration.linearity[one]) / half if math.isfinite(half) else 0.0 for one, half in halves]
        curve = [U_CUBIC * one for one in bent]
        gains = [float(calibration.gain_uncertainty[channel]) for channel in (LASER, BASE, CURRENT)]
        # the certificate adds the slope of the curve at mid-range to the gain; here the curve is a parameter of its own
        for place, one in enumerate(curve):
            gains[place] = math.sqrt(max(gains[place] ** 2 - (1.5 * one) ** 2, 0.0))
        return cls(np.array([*gains, *curve]), calibration)

    def relative(self, channel: int, amplitude: Real, frequency_hz: Real | float) -> Real:
        """Return how much each relative error in `NUISANCES` changes a measured amplitude: d ln(amplitude) / d error.

        The derivative is 1 for the gain of the channel, and depends on the amplitude for the curve of the channel. It
        is 0 for all other errors.

        Args:
            channel: index of the channel, `LASER`, `BASE` or `CURRENT`.
            amplitude: amplitudes of a sinusoidal displacement [m], shape (n,); for the current only the shape is used.
            frequency_hz: frequency of all amplitudes, or one frequency for each amplitude.

        Returns:
            Derivatives in the order of `NUISANCES`, shape (n, 6).
        """
        effect = np.zeros((len(amplitude), len(NUISANCES)))
        effect[:, (LASER, BASE, CURRENT).index(channel)] = 1.0
        if channel != CURRENT:
            order = int(self.calibration.derivative[channel])
            reading = amplitude * (2.0 * np.pi * np.asarray(frequency_hz)) ** order
            share = reading / _half_range(self.calibration, channel)
            effect[:, 3 + (LASER, BASE).index(channel)] = np.where(np.isfinite(share), 1.875 * share**2 - 1.5, 0.0)
        return effect


def _half_range(calibration: Calibration, channel: int) -> float:
    return float(calibration.high[channel] - calibration.low[channel]) / 2.0


def sine_of(points: Sequence[Point], gains: Gains) -> SineData:
    """Return the points of a frequency curve without the sphere as `SineData`.

    All `points` are used, so they must be settled. A point with several measurements gives their mean, except for the
    phase, which is that of the first measurement. The uncertainties of the amplitudes are those of noise alone, without
    the calibration errors `gains`.
    """
    first = np.concatenate([point.rows[:1] for point in points])
    return SineData(
        frequency_hz=first["frequency"].copy(),
        dt=np.array([point.dt for point in points]),
        phase_rad=first["phase"].copy(),
        base_per_a=np.array([point.base_m / np.mean(point.rows["current_amplitude"]) for point in points]),
        laser_m=np.array([point.laser_m for point in points]),
        base_m=np.array([point.base_m for point in points]),
        u_amplitude=np.array([_noise(point, gains) for point in points]),
        u_phase=np.maximum(first["phase_uncertainty"], LEAST_NOISE),
    )


def reduced_of(curves: Curves, frequency_hz: float, gaps_m: Sequence[float], gains: Gains) -> Reduced | None:
    """Return the measured ratios of DT with the sphere to DT without it, at one frequency, for the gaps `gaps_m`.

    Gaps without a measured point are left out. Points at which no impact was counted are also left out; points without
    a count of impacts are used. The ratios are not corrected for the calibration errors `gains`; `Reduced.effects`
    states the effect of each error. The result is None if DT without the sphere was not measured at this frequency, or
    if no point with the sphere remains.
    """
    without = curves.at(NO_SPHERE, frequency_hz)
    at = [point for gap in gaps_m if (point := curves.at(gap, frequency_hz)) is not None]
    points = [point for point in at if point.impacts or not _counted(point)]
    if without is None or not points:
        return None
    effects = np.zeros((len(points), len(NUISANCES)))
    for sign, channel, column in ((1.0, LASER, "laser_m"), (-1.0, BASE, "base_m")):
        with_sphere = gains.relative(channel, np.array([getattr(point, column) for point in points]), frequency_hz)
        effects += sign * (with_sphere - gains.relative(channel, np.array([getattr(without, column)]), frequency_hz))
    effects[:, NUISANCES.index("DT without sphere")] = -1.0
    return Reduced(
        frequency_hz=frequency_hz,
        current_a={point.gap_m: _current(point) for point in points},
        ratio={point.gap_m: point.dt / without.dt for point in points},
        u=np.array([_noise(point, gains) for point in points]),
        u_without=_noise(without, gains),
        effects=effects,
        regimes={point.gap_m: point.regime if _counted(point) else Regime.UNKNOWN.value for point in points},
    )


def _current(point: Point) -> float:
    """Return the measured amplitude of the current of a point [A peak].

    If no positive amplitude was measured, return the commanded amplitude.
    """
    read = float(np.mean(point.rows["current_amplitude"]))
    return read if math.isfinite(read) and read > 0.0 else point.current_a


def _counted(point: Point) -> bool:
    return not math.isnan(point.impacts_per_cycle)


def _noise(point: Point, gains: Gains) -> float:
    """Return the relative standard uncertainty of the DT of a point by noise, at least `LEAST_NOISE`.

    The calibration errors (`gains`) are not included.
    """
    return max(repeatability(point.rows, gains.calibration), LEAST_NOISE)


@attrs.frozen(eq=False, kw_only=True)
class Measured:
    """All measurements of one rig from which its constants are identified; a measurement that was not made is None."""

    gains: Gains  # calibration errors of the sensors
    decay: Decay | None = None  # free decay without the sphere
    sine: SineData | None = None  # stepped sine without the sphere
    reduced: Reduced | None = None  # ratios of DT with the sphere to DT without it
    u_restitution: float = U_RESTITUTION  # standard uncertainty of the nominal e of the known rig; 0: exactly known


# --- The free decay with the base locked: measured on a rig in this process, or taken from a recorded run

DISPLACEMENT_M = 5e-3  # displacement from which the pluck releases the superior base
RECORD_S = 20.0  # length of a record of the decay: five time constants of the structure
SETTLE_S = 0.05  # time left out at the beginning, in which the laser's response to the release decays


def measured_decay(config: RigConfig, method: DecayMethod = fit_decay) -> Decay:
    """Simulate the free decay of a rig without its sphere, and return its natural frequency and damping ratio.

    `config` describes the rig. The superior base is released from the displacement `DISPLACEMENT_M`, and the inferior
    base is locked. `method` evaluates the scans.
    """
    config = from_flat(config, {"sphere.present": False, "daq.block_scans": min(config.daq.rate_hz, 10_000)})
    rig = LocalRig(config)
    rig.core.pluck(DISPLACEMENT_M)
    rig.run(RECORD_S)
    return measure_decay(rig.rows()[round(SETTLE_S * config.daq.rate_hz) :], rig.core.info().rows, method)


def recorded_decay(run: Run, method: DecayMethod = fit_decay) -> Decay:
    """Measure natural frequency and damping ratio from the free decay after the last pluck in a recorded run.

    The decay begins `SETTLE_S` after the pluck. It ends at a reset, at missing scans or at the end of the run. In an
    imported run, which has no record of plucks, the largest deviation of the superior base from its final position
    counts as the pluck.

    Raises:
        RecordingError: a recorded run contains no pluck, or no scans between `SETTLE_S` after it and a reset.
    """
    if not run.holds(topics.JOURNAL) and is_measured(run.provenance):
        record = last_record(run)
        x_1 = samples_of(record.rows, "laser")
        rest = x_1[-max(1, len(x_1) // 4) :].mean()
        begin = int(np.argmax(np.abs(x_1 - rest))) + round(SETTLE_S * record.rate_hz)
        return measure_decay(record.rows[begin:], calibration_rows(run), method)
    begin_ns: int | None = None
    end_ns = math.inf
    for entry in recorded_journal.of_run(run):
        if entry.kind is InputKind.PLUCK:
            begin_ns, end_ns = entry.stamp_ns, math.inf
        elif entry.kind is InputKind.RESET:
            end_ns = min(end_ns, entry.stamp_ns)
    if begin_ns is None:
        raise RecordingError(
            f"{run.path}: no pluck in this run (rig/pluck), so that it contains no free decay; record a run that "
            "begins before the pluck"
        )
    info = list(run.tables(topics.INFO.name, recorded_order=True))[-1]
    first = begin_ns + round(SETTLE_S * NS_PER_S)
    decay = Recent(float(info.rows["rate"][0]), sys.maxsize)
    for table in run.tables(topics.SCAN.name, recorded_order=True):
        if first <= table.stamp_ns < end_ns:
            if decay.count and not decay.follows(table):
                break
            decay.add(table)
    if not decay.count:
        raise RecordingError(
            f"{run.path}: no block of scans begins later than {SETTLE_S:g} s after the last pluck and before a reset, "
            f"so that the run contains no free decay; record about {RECORD_S:g} s after the pluck"
        )
    return measure_decay(decay.rows(), info.rows, method)
