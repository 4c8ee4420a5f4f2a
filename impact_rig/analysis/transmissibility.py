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
"""Displacement transmissibility DT = |X_1| / |X_b| at the drive frequency, its phase, and their uncertainties.

X_1 and X_b are means of the cycles' fitted phasors, corrected for skew and sensor lag (`calibration`). The phase is
that of X_1 relative to X_b; it is negative if x_1 lags x_b. The combined standard uncertainty (GUM, relative for DT,
rad for the phase) has the sensitivities of the complex quotient D = X_1/X_b:

    u²(DT)/DT² = u_A² + u²(S_laser) + u²(S_base) + u_Q² + Σ (Re ∂lnL/∂ln τ · u_τ)² + max(Re²(bias/D) − u_A², 0)/3
    u²(phase)  = u_A² +                            u_q² + Σ (Im ∂lnL/∂ln τ · u_τ)² + max(Im²(bias/D) − u_A², 0)/3

- u_A: the larger of the fit's residual noise, taken as white, and the scatter of the cycles including correlation. For
  a response that is not periodic, the scatter follows from batch means of the cycles.
- bias: possible remnant of a transient
- u_Q, u_q: effects of the steps of sensors and converter on amplitude and phase, if noise does not average them out
  (`calibration`; `_rounding`)

A result with u(DT)/DT above `worst_relative_uncertainty` has a status instead of numbers.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis import health
from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.analysis.cycles import RANGE_BIT, Accumulator, Cycles, distinct_phases, usable_harmonics
from impact_rig.analysis.health import REFERENCE_FACTOR, Amplitudes, Rejection
from impact_rig.analysis.impacts import MIN_RATE_HZ, ImpactDetector, counted
from impact_rig.analysis.scans import ACCELEROMETER, BASE, CHANNELS, CURRENT, LASER, samples_of, status_of
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.spread import batch_variance, by_class_removed, classify, student_factor, variance_of_mean
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.states import MEASURED, SETTLED, Method, Regime, Status

NAN = float("nan")
MIN_CYCLES = 4
BATCHES = (4, 6)
"""Numbers of batches of cycles with which the uncertainty of a non-periodic response is estimated; the larger counts.

Batches are few and long, because a motion that alternates between impacts and rest is correlated for seconds.
"""


@attrs.frozen(kw_only=True)
class Measurement:
    """Measured transmissibility at one drive frequency, or the status that says why there is none.

    Unknown values are NaN. Units are those of `blocks.TRANSMISSIBILITY`; the prefix u_ means standard uncertainty.
    """

    status: Status
    frequency_hz: float
    frequency_deviation_hz: float = NAN
    transmissibility: float = NAN
    phase_rad: float = NAN
    u_transmissibility: float = NAN
    u_phase_rad: float = NAN
    laser_m: float = NAN
    base_m: float = NAN
    current_a: float = NAN
    thd: float = NAN
    impacts_per_cycle: float = NAN
    cycles: int = 0
    regime: Regime = Regime.UNKNOWN
    period: float = NAN
    spread: float = NAN
    steady: bool = False
    method: Method = Method.NONE
    channel: str = ""
    largest: str = ""
    largest_share: float = NAN
    u_steps: float = NAN
    impact_age_s: float = NAN
    amplitudes: Amplitudes | None = None


def counts_impacts(calibration: Calibration) -> bool:
    """Return whether impacts can be counted: an accelerometer was measured, at `MIN_RATE_HZ` or more scans/s."""
    return calibration.rate_hz >= MIN_RATE_HZ and bool(calibration.present[ACCELEROMETER])


def measure_record(
    rows: NDArray[np.void], info: NDArray[np.void], frequency_hz: float, settings: TrackerSettings | None = None
) -> Measurement:
    """Measure the transmissibility from all complete drive cycles of a record; the response is assumed to be settled.

    If the measurement is impossible, the result has no numbers, and its status is the reason.

    `rows` are consecutive scans (`daq/scan`), shape (n,); `info` are the rows of `daq/info`. Of the settings, only
    those of harmonics, periodicity and uncertainty are used.

    Raises:
        ConfigError: `info` does not describe the channels.
    """
    settings = settings or TrackerSettings()
    calibration = Calibration.from_info(info)
    harmonics = usable_harmonics(calibration.rate_hz, frequency_hz, settings.harmonics)
    if not harmonics:
        return Measurement(status=Status.NO_FREQUENCY, frequency_hz=frequency_hz)
    samples = np.stack([samples_of(rows, name) for name in CHANNELS])
    accumulator = Accumulator(calibration.rate_hz, frequency_hz, harmonics, 0, calibration.low, calibration.high)
    accumulator.add(samples, np.ascontiguousarray(status_of(rows)), 0, len(rows))
    if accumulator.pending_cycles < MIN_CYCLES:
        return Measurement(status=Status.TOO_FEW_CYCLES, frequency_hz=frequency_hz)
    cycles = accumulator.take(accumulator.pending_cycles)
    if counts_impacts(calibration):
        impacts = ImpactDetector(calibration).feed(samples[ACCELEROMETER])
        cycles = counted(cycles, impacts, 0, accumulator.period)
    return measure(cycles, calibration, frequency_hz, settings)


def measure(
    cycles: Cycles,
    calibration: Calibration,
    frequency_hz: float,
    settings: TrackerSettings,
    bias: complex = 0j,
    before: Amplitudes | None = None,
    worst: float | None = None,
) -> Measurement:
    """Measure the transmissibility from settled, consecutive cycles of one commanded frequency.

    If the measurement is impossible, the result has no numbers, and its status is the reason. `bias` is the possible
    error of the complex transmissibility due to a remaining transient. `before` are the amplitudes of an earlier
    measurement of the same drive setting, with which the channels are compared; None skips the comparison. `worst` is
    the largest relative standard uncertainty of DT for which the result has numbers. None means
    `worst_relative_uncertainty` of the settings.
    """

    def refuse(why: Rejection, largest: str = "") -> Measurement:
        return Measurement(
            status=why.status, channel=why.channel, frequency_hz=frequency_hz, cycles=len(cycles), largest=largest
        )

    if len(cycles) < MIN_CYCLES:
        return refuse(Rejection(Status.TOO_FEW_CYCLES))
    flags = int(np.bitwise_or.reduce(cycles.flags))
    broken = health.unsound(cycles, calibration, frequency_hz)
    if broken:
        return refuse(broken)
    # variance per sample of the residual of the fits, at least that of the quantisation
    noise = np.asarray(np.maximum(cycles.residual_variance, calibration.resolution**2 / 12.0), dtype=np.float64)
    phasors, deviation_hz = _derotated(cycles, calibration, noise)
    true = [phasors[:, c] / calibration.response(c, frequency_hz * cycles.harmonics) for c in range(4)]
    x1, xb = true[LASER][:, 0], true[BASE][:, 0]
    mean1, mean_b = complex(x1.mean()), complex(xb.mean())
    moved = noise / calibration.scales(frequency_hz) ** 2  # noise as displacement
    floor1, floor_b = (_amplitude_u(x, 4.0 * moved[c] / cycles.samples.sum()) for x, c in ((x1, LASER), (xb, BASE)))
    still = health.silent((abs(mean1), abs(mean_b)), (floor1, floor_b))
    if still:
        return refuse(still)
    ratio = mean1 / mean_b
    sizes = health.amplitudes(true, moved, cycles, calibration, frequency_hz)
    contradicted = health.contradiction(sizes, before) if calibration.present[ACCELEROMETER] else None
    influence = (x1 - ratio * xb) / mean_b * np.exp(-1j * np.angle(ratio))  # Re: of DT, Im / DT: of the phase
    crowded_noise = float(max(noise[LASER], calibration.noise[LASER] ** 2) * calibration.noise_crowding()[LASER])
    response = classify(
        x1 / mean1 - 1.0,
        4.0
        * crowded_noise
        / float(cycles.samples.mean())
        / abs(mean1 * complex(calibration.response(LASER, frequency_hz))) ** 2,
        settings.periodic_tolerance,
        np.zeros_like(cycles.strikes) if contradicted else cycles.strikes,
    )
    white = 2.0 * (moved[LASER] + abs(ratio) ** 2 * moved[BASE]) / cycles.samples.sum() / abs(mean1) ** 2
    if response.regime is Regime.PERIODIC:
        method = Method.GUM
        classes = round(response.period)
        left = by_class_removed(influence / abs(ratio), classes)
        freedom = (len(left) - 1.0) / (len(left) - classes)  # the mean of each class has been removed, not just one
        spread = (
            freedom * student_factor(len(left)) * np.array([variance_of_mean(left.real), variance_of_mean(left.imag)])
        )
    else:
        method = Method.BATCH_MEANS
        spread = np.maximum(*(batch_variance(influence / abs(ratio), min(few, len(cycles))) for few in BATCHES))
    variance = np.maximum(spread, white)
    parts = _parts(variance, calibration, frequency_hz, settings.lag_uncertainty, bias / ratio, abs(mean1), abs(mean_b))
    parts += _rounding(cycles, calibration, frequency_hz)
    u_amplitude, u_phase = (math.sqrt(sum(getattr(part, of) for part in parts)) for of in ("amplitude", "phase"))
    steps = sum(part.amplitude for part in parts if part.what == STEPS)
    most = max(parts, key=lambda part: part.amplitude)
    if u_amplitude > (settings.worst_relative_uncertainty if worst is None else worst):
        small = 2.0 * steps > u_amplitude**2
        return refuse(Rejection(Status.BELOW_RESOLUTION if small else Status.TOO_UNCERTAIN, most.channel), most.what)
    phase = float(np.angle(ratio))
    wrong = health.misplaced(sizes, u_amplitude, phase, u_phase) or contradicted
    if wrong and wrong.status not in MEASURED:
        return refuse(wrong)
    no_current = calibration.present[CURRENT] and health.current_unsound(cycles, calibration, sizes, before)
    unsound = wrong.status if wrong else Status.CURRENT_UNSOUND if no_current else Status.OK
    # irregular impacts may be missed; and without any, an irregular response is a transient
    struck = bool(cycles.impacts.any())  # also where they were not counted
    is_unknown = (wrong is not None) if response.regime is Regime.PERIODIC else not struck
    overtones = true[LASER][:, 1:].mean(axis=0)
    clipped = flags & ((1 | RANGE_BIT) << ACCELEROMETER)
    has_current = not no_current and sizes.size[CURRENT] > health.SIGNAL_FACTOR * sizes.u[CURRENT]
    return Measurement(
        status=Status.ACCELEROMETER_OVER_RANGE if clipped else unsound,
        frequency_hz=frequency_hz,
        frequency_deviation_hz=deviation_hz,
        transmissibility=abs(ratio),
        phase_rad=phase,
        u_transmissibility=abs(ratio) * u_amplitude,
        u_phase_rad=u_phase,
        laser_m=abs(mean1),
        base_m=abs(mean_b),
        current_a=float(sizes.size[CURRENT]) if calibration.present[CURRENT] and has_current else NAN,
        thd=float(np.sqrt(np.sum(np.abs(overtones) ** 2))) / abs(mean1),
        impacts_per_cycle=NAN if wrong else float(cycles.impacts.mean()),
        cycles=len(cycles),
        regime=Regime.UNKNOWN if is_unknown else response.regime,
        period=NAN if is_unknown else response.period,
        spread=float(np.std(influence.real)),
        steady=response.steady,
        method=method,
        channel=most.channel,
        largest=most.what,
        largest_share=most.amplitude / u_amplitude**2 if u_amplitude else NAN,
        u_steps=abs(ratio) * math.sqrt(steps),
        amplitudes=sizes,
    )


def complex_transmissibility(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> complex:
    """Return X_1 / X_b of the mean phasors of some cycles, corrected for lags; NaN if the base does not move.

    Settling is judged by this value, because it is faster to compute than a measurement.
    """
    base = complex(cycles.phasors[:, BASE, 0].mean())
    if base == 0.0 or not np.isfinite(base):
        return complex(NAN, NAN)
    lag = calibration.response(BASE, frequency_hz) / calibration.response(LASER, frequency_hz)
    return complex(cycles.phasors[:, LASER, 0].mean() / base * lag)


def _derotated(cycles: Cycles, calibration: Calibration, noise: Real) -> tuple[Complex, float]:
    """Remove the linear phase drift of a reference channel from all phasors.

    A DAQ clock that is off by some ppm makes the phases drift from cycle to cycle, which would reduce the mean
    amplitudes. The reference is the current if it has a clear signal, else the base. Without a clear signal, nothing is
    removed. `noise` is the variance of a sample of each channel [unit²], shape (4,).

    Returns:
        The phasors, shape (n, 4, H) as in `cycles`, and the measured minus the commanded drive frequency [Hz] (the
        fourth parameter of IEEE Std 1057), NaN if nothing was removed.
    """
    time = (cycles.first + (cycles.samples - 1) / 2.0) / calibration.rate_hz
    time -= time.mean()
    for channel in (CURRENT, BASE):
        reference = cycles.phasors[:, channel, 0]
        limit = REFERENCE_FACTOR * math.sqrt(4.0 * noise[channel] / cycles.samples.mean())
        if np.abs(reference).min() > limit:
            phase = np.unwrap(np.angle(reference))
            omega = float(time @ (phase - phase.mean()) / (time @ time))
            turn = np.exp(-1j * omega * time[:, None, None] * cycles.harmonics)
            return cycles.phasors * turn, omega / (2.0 * math.pi)
    return cycles.phasors, NAN


def _amplitude_u(phasors: Complex, white: float) -> float:
    """Return the standard uncertainty of the amplitude of the mean of some phasors.

    The uncertainty follows from the scatter of the phasors, or from `white` if that is larger. `white` is the mean
    square error of the mean due to white noise.
    """
    n = len(phasors)
    scatter = float(np.sum(np.abs(phasors - phasors.mean()) ** 2)) / (n * (n - 1))
    return math.sqrt(max(scatter, white) / 2.0)


STEPS, MEASUREMENT = "steps", "measurement"
"""Names in `_Part`: `what` of the steps of a channel, and `channel` of contributions that belong to no channel."""


@attrs.frozen
class _Part:
    """Contribution to the uncertainty of a measurement: variances of ln DT (`amplitude`) and of the phase [rad²]."""

    channel: str
    what: str
    amplitude: float
    phase: float


def _parts(
    variance: Real,
    calibration: Calibration,
    frequency_hz: float,
    lag_uncertainty: float,
    bias: complex,
    laser_m: float,
    base_m: float,
) -> list[_Part]:
    """Return the contributions to the uncertainty of DT and phase by scatter, transient, sensitivities and lags.

    `variance` are the variances of the means of ln DT and of the phase, shape (2,). `lag_uncertainty` is the relative
    standard uncertainty of every lag. `bias` is the bias due to a transient, divided by the complex transmissibility.
    `laser_m` and `base_m` are the amplitudes |X_1| and |X_b|.
    """
    # an extrapolated bias contains the noise of the windows, which is already counted: only the excess is a bias
    left = np.maximum(np.array([bias.real, bias.imag]) ** 2 - variance, 0.0) / 3.0
    parts = [
        _Part(MEASUREMENT, "noise, scatter", float(variance[0]), float(variance[1])),
        _Part(MEASUREMENT, "transient", float(left[0]), float(left[1])),
    ]
    for channel, level in ((LASER, laser_m), (BASE, base_m)):
        amplitude_u, phase_u = calibration.lag_uncertainties(channel, frequency_hz, lag_uncertainty)
        name, reading = CHANNELS[channel], level * calibration.scale(channel, frequency_hz)
        parts += [
            _Part(name, "sensitivity", calibration.gain_uncertainty_at(channel, reading) ** 2, 0.0),
            _Part(name, "lag", amplitude_u**2, phase_u**2),
        ]
    return parts


def _rounding(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> list[_Part]:
    """Return the contributions of the resolution steps of laser and base to the uncertainty of DT and phase.

    For a pure sine, the rounding error changes only the amplitude (`calibration`). Overtones of at least one step make
    the error of the phase as large. If the n samples fall on only N different drive phases, the rounding errors do not
    average out. They add the variance 2 v / N, where v is the channel's `steps_variance`, less the 2 v / n that the
    scatter of the cycles already contains.
    """
    n = int(cycles.samples.sum())
    phases = distinct_phases(n, calibration.rate_hz / frequency_hz)
    parts = []
    for channel in (LASER, BASE):
        mean = cycles.phasors[:, channel].mean(axis=0)
        amplitude = abs(complex(mean[0]))
        step = float(max(calibration.output_step[channel], calibration.converter_step[channel]))
        if not step or not amplitude:
            continue
        size = (calibration.steps_uncertainty(channel, amplitude) / amplitude) ** 2
        overtones = float(np.sqrt(np.sum(np.abs(mean[1:]) ** 2)))
        recurring = 2.0 * calibration.steps_variance(channel) * (1.0 / phases - 1.0 / n) / amplitude**2
        turned = size * min(1.0, (overtones / step) ** 2)
        parts.append(_Part(CHANNELS[channel], STEPS, size + recurring, turned + recurring))
    return parts


def note_on(row: np.void | NDArray[np.void]) -> str:
    """Return a remark on a row of `transmissibility/table` with the status `no_impacts`; empty for other rows.

    The remark says how long there was no impact (the shorter of `impact_age` and `waited`), and that a slow sphere
    could still strike. If the gap is labelled, it also states the speed of a sphere that crosses the gap in this time.
    """
    if row["status"] != Status.NO_IMPACTS.value.encode():
        return ""
    quiet_s = float(np.fmin(row["waited"], row["impact_age"]))
    known = row["gap"] > 0.0 and quiet_s > 0.0
    slow = f"a sphere slower than {1e3 * row['gap'] / quiet_s:.2g} mm/s" if known else "a slower sphere"
    return f"no impacts for {quiet_s:.0f} s; {slow} could still strike"


def measurement_table(found: Measurement, stamp_ns: int, gap_m: float, waited_s: float) -> Table:
    """Return a measurement as a table `transmissibility/table` of one row.

    `stamp_ns` is the stamp of the last measured scan. `gap_m` is the operator's label of the gap [m], NaN if unknown.
    `waited_s` is the time [s] since drive, label or calibration last changed, scans were lost, or the record began.
    """
    row = np.zeros(1, dtype=TRANSMISSIBILITY)
    for column, value in {
        "frequency": found.frequency_hz, "transmissibility": found.transmissibility, "phase": found.phase_rad,
        "transmissibility_uncertainty": found.u_transmissibility, "phase_uncertainty": found.u_phase_rad,
        "laser_amplitude": found.laser_m, "base_amplitude": found.base_m, "current_amplitude": found.current_a,
        "thd": found.thd, "impacts_per_cycle": found.impacts_per_cycle, "settled": found.status in SETTLED,
        "cycles": found.cycles, "gap": gap_m, "frequency_deviation": found.frequency_deviation_hz,
        "spread": found.spread, "period": found.period, "waited": waited_s, "regime": found.regime.value,
        "method": found.method.value, "status": found.status.value, "channel": found.channel, "largest": found.largest,
        "largest_share": found.largest_share, "steps_uncertainty": found.u_steps, "impact_age": found.impact_age_s,
    }.items():  # fmt: skip
        row[column] = value
    return Table(stamp_ns, row)
