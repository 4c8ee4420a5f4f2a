# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Displacement transmissibility DT = |X_1| / |X_b| at the drive frequency, its phase, and what both are worth.

X_1 and X_b are means of the cycles' fitted phasors, corrected for skew and sensor lag (`calibration`). The phase is
that of X_1 relative to X_b: negative = x_1 lags x_b. Combined standard uncertainty (GUM, relative for DT, rad for the
phase, sensitivities of the complex quotient D = X_1/X_b):

    u²(DT)/DT² = u_A² + u²(S_laser) + u²(S_base) + Σ (Re ∂lnL/∂ln τ · u_τ)² + max(Re²(bias/D) − u_A², 0)/3
    u²(phase)  = u_A² +                            Σ (Im ∂lnL/∂ln τ · u_τ)² + max(Im²(bias/D) − u_A², 0)/3

u_A: the larger of the fit's residual noise, taken as white, and the scatter of the cycles, correlation included; for a
response that is not periodic, the block bootstrap of the cycles instead. bias: what a dying transient may have left.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.analysis.channels import ACCELEROMETER, BASE, CHANNELS, CURRENT, LASER, status_of
from impact_rig.analysis.cycles import RANGE_BIT, Accumulator, Cycles, usable_harmonics
from impact_rig.analysis.impacts import MIN_RATE_HZ, ImpactDetector, counted
from impact_rig.analysis.regime import classify
from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.spread import block_length, bootstrap_means, by_class_removed, student_factor, variance_of_mean
from impact_rig.analysis.words import Method, Regime, Status

NAN = float("nan")
MIN_CYCLES = 4
SIGNAL_FACTOR = 5.0
"""An amplitude below this many standard uncertainties is silence."""
REFERENCE_FACTOR = 20.0
"""A channel's amplitude per cycle, in standard uncertainties, from which its phase can serve as reference."""
CONSTANT_FACTOR = 1e-13
"""Variance over squared mean that rounding of the sums alone can leave of a constant."""
SWAP_MATCH, SWAP_MISMATCH = 1.25, 1.5
"""Acceleration over ω² must match the base within the first factor and miss the laser by the second to call a swap."""
LEAD_LIMIT_RAD = math.radians(0.5)


@attrs.frozen(kw_only=True)
class Measurement:
    """One measured point; NaN where a value is not known. Units as in `blocks.TRANSMISSIBILITY`, u_: standard."""

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


def measure_record(
    rows: NDArray[np.void],
    info: NDArray[np.void],
    frequency_hz: float,
    settings: TrackerSettings | None = None,
    rng: np.random.Generator | None = None,
) -> Measurement:
    """Measure a whole record at one drive frequency: all its whole cycles, taken as settled.

    Args:
        rows: consecutive scans (`daq/scan`), shape (n,).
        info: rows of `daq/info`.
        frequency_hz: of the drive.
        settings: only harmonics, tolerance, lag and bootstrap settings are used.
        rng: draws of the block bootstrap, needed if the response may be other than periodic; seeded from the settings
            if None.
    """
    settings = settings or TrackerSettings()
    calibration = Calibration.from_info(info)
    harmonics = usable_harmonics(calibration.rate_hz, frequency_hz, settings.harmonics)
    if not harmonics:
        return Measurement(status=Status.NO_FREQUENCY, frequency_hz=frequency_hz)
    samples = np.stack([np.asarray(rows[name], dtype=np.float64) for name in CHANNELS])
    accumulator = Accumulator(calibration.rate_hz, frequency_hz, harmonics, 0, calibration.low, calibration.high)
    accumulator.add(samples, np.ascontiguousarray(status_of(rows)), 0, len(rows))
    if accumulator.pending_cycles < MIN_CYCLES:
        return Measurement(status=Status.TOO_FEW_CYCLES, frequency_hz=frequency_hz)
    cycles = accumulator.take(accumulator.pending_cycles)
    if calibration.rate_hz >= MIN_RATE_HZ:
        impacts = ImpactDetector(calibration).feed(samples[ACCELEROMETER])
        cycles = counted(cycles, impacts, 0, accumulator.period)
    return measure(cycles, calibration, frequency_hz, settings, rng or np.random.default_rng(settings.seed))


def interruption(flags: int, mean: Real) -> Status | None:
    """Return why cycles with these flags must not be averaged, or None; `mean` of any shape, channels last."""
    if not np.all(np.isfinite(mean[..., [LASER, BASE, CURRENT]])):
        return Status.NOT_FINITE
    displacements = (1 << LASER) | (1 << BASE) | (1 << CURRENT)
    return Status.OVER_RANGE if flags & (displacements | RANGE_BIT * displacements) else None


def measure(
    cycles: Cycles,
    calibration: Calibration,
    frequency_hz: float,
    settings: TrackerSettings,
    rng: np.random.Generator,
    bias: complex = 0j,
) -> Measurement:
    """Measure settled cycles.

    Args:
        cycles: consecutive whole cycles of one drive frequency.
        calibration: of the channels.
        frequency_hz: commanded.
        settings: tolerances and lag uncertainty.
        rng: draws of the block bootstrap.
        bias: of the complex transmissibility, by a transient not quite gone.
    """

    def refuse(status: Status) -> Measurement:
        return Measurement(status=status, frequency_hz=frequency_hz, cycles=len(cycles))

    if len(cycles) < MIN_CYCLES:
        return refuse(Status.TOO_FEW_CYCLES)
    flags = int(np.bitwise_or.reduce(cycles.flags))
    broken = interruption(flags, cycles.mean) or _stuck(cycles)
    if broken:
        return refuse(broken)
    noise = _noise_variance(cycles, calibration)
    phasors, deviation_hz = _derotated(cycles, calibration, noise)
    true = [phasors[:, c] / calibration.response(c, frequency_hz * harmonic_numbers(cycles)) for c in range(4)]
    x1, xb = true[LASER][:, 0], true[BASE][:, 0]
    mean1, mean_b = complex(x1.mean()), complex(xb.mean())
    floor1, floor_b = (_amplitude_u(x, 4.0 * noise[c] / cycles.samples.sum()) for x, c in ((x1, LASER), (xb, BASE)))
    if abs(mean_b) <= SIGNAL_FACTOR * floor_b or abs(mean1) <= SIGNAL_FACTOR * floor1:
        return refuse(Status.SILENCE)
    ratio = mean1 / mean_b
    influence = (x1 - ratio * xb) / mean_b * np.exp(-1j * np.angle(ratio))  # Re: of DT, Im / DT: of the phase
    crowded_noise = float(max(noise[LASER], calibration.noise[LASER] ** 2) * calibration.noise_crowding()[LASER])
    response = classify(
        x1 / mean1 - 1.0,
        4.0
        * crowded_noise
        / float(cycles.samples.mean())
        / abs(mean1 * complex(calibration.response(LASER, frequency_hz))) ** 2,
        settings.periodic_tolerance,
        cycles.strikes,
    )
    white = 2.0 * (noise[LASER] + abs(ratio) ** 2 * noise[BASE]) / cycles.samples.sum() / abs(mean1) ** 2
    if response.regime is Regime.PERIODIC:
        method = Method.GUM
        classes = round(response.period)
        left = by_class_removed(influence / abs(ratio), classes)
        freedom = (len(left) - 1.0) / (len(left) - classes)  # the mean of each class has been taken out, not just one
        spread = (
            freedom * student_factor(len(left)) * np.array([variance_of_mean(left.real), variance_of_mean(left.imag)])
        )
    else:
        method = Method.BLOCK_BOOTSTRAP
        length = max(block_length(influence.real), block_length(influence.imag))
        draws = bootstrap_means(np.stack([x1, xb], axis=1), length, settings.bootstrap_resamples, rng)
        logs = np.log(draws[:, 0] / draws[:, 1] / ratio)
        # resampled blocks are centred on this record's mean: short by the share of one block
        spread = np.array([np.var(logs.real), np.var(logs.imag)]) / (1.0 - length / len(cycles))
    variance = np.maximum(spread, white)
    u_amplitude, u_phase = _combined(
        variance, calibration, frequency_hz, settings.lag_uncertainty, bias / ratio, abs(mean1), abs(mean_b)
    )
    phase = float(np.angle(ratio))
    misplaced = _misplaced(true[ACCELEROMETER][:, 0], mean1, mean_b, frequency_hz, phase - 3.0 * u_phase)
    if misplaced:
        return refuse(misplaced)
    overtones = true[LASER][:, 1:].mean(axis=0)
    clipped = flags & ((1 | RANGE_BIT) << ACCELEROMETER)
    return Measurement(
        status=Status.ACCELEROMETER_OVER_RANGE if clipped else Status.OK,
        frequency_hz=frequency_hz,
        frequency_deviation_hz=deviation_hz,
        transmissibility=abs(ratio),
        phase_rad=phase,
        u_transmissibility=abs(ratio) * u_amplitude,
        u_phase_rad=u_phase,
        laser_m=abs(mean1),
        base_m=abs(mean_b),
        current_a=abs(complex(true[CURRENT][:, 0].mean())),
        thd=float(np.sqrt(np.sum(np.abs(overtones) ** 2))) / abs(mean1),
        impacts_per_cycle=float(cycles.impacts.mean()),
        cycles=len(cycles),
        regime=response.regime,
        period=response.period,
        spread=float(np.std(influence.real)),
        steady=response.steady,
        method=method,
    )


def complex_transmissibility(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> complex:
    """Return X_1 / X_b of some cycles; NaN if the base stands still. The cheap value that settling is judged on."""
    base = complex(cycles.phasors[:, BASE, 0].mean())
    if base == 0.0 or not np.isfinite(base):
        return complex(NAN, NAN)
    lag = calibration.response(BASE, frequency_hz) / calibration.response(LASER, frequency_hz)
    return complex(cycles.phasors[:, LASER, 0].mean() / base * lag)


def harmonic_numbers(cycles: Cycles) -> Real:
    """Return 1 … H."""
    return np.arange(1.0, cycles.phasors.shape[2] + 1.0)


def _stuck(cycles: Cycles) -> Status | None:
    """Tell a stuck channel (CONSTANT) from a rig at rest (SILENCE)."""
    constant = cycles.variance <= CONSTANT_FACTOR * cycles.mean**2
    laser, base = bool(constant[:, LASER].any()), bool(constant[:, BASE].any())
    if laser and base:
        return Status.SILENCE
    return Status.CONSTANT if laser or base else None


def _noise_variance(cycles: Cycles, calibration: Calibration) -> Real:
    """Return the variance per sample that the fits leave, at least that of the quantisation, shape (4,)."""
    residual = cycles.residual.sum(axis=0) / cycles.degrees_of_freedom
    return np.asarray(np.maximum(residual, calibration.resolution**2 / 12.0), dtype=np.float64)


def _derotated(cycles: Cycles, calibration: Calibration, noise: Real) -> tuple[Complex, float]:
    """Turn the phasors back by the drift of the reference's phase; return them and the frequency deviation [Hz].

    The reference is the current where there is one, else the base. The fourth parameter of IEEE Std 1057, found from
    the cycles: a DAQ clock that is off by some ppm must not smear the amplitudes.
    """
    time = (cycles.first + (cycles.samples - 1) / 2.0) / calibration.rate_hz
    time -= time.mean()
    for channel in (CURRENT, BASE):
        reference = cycles.phasors[:, channel, 0]
        limit = REFERENCE_FACTOR * math.sqrt(4.0 * noise[channel] / cycles.samples.mean())
        if np.abs(reference).min() > limit:
            phase = np.unwrap(np.angle(reference))
            omega = float(time @ (phase - phase.mean()) / (time @ time))
            turn = np.exp(-1j * omega * time[:, None, None] * harmonic_numbers(cycles))
            return cycles.phasors * turn, omega / (2.0 * math.pi)
    return cycles.phasors, NAN


def _amplitude_u(phasors: Complex, white: float) -> float:
    """Return the standard uncertainty of |mean phasor|: scatter of the cycles or white noise, whichever is larger."""
    n = len(phasors)
    scatter = float(np.sum(np.abs(phasors - phasors.mean()) ** 2)) / (n * (n - 1))
    return math.sqrt(max(scatter, white) / 2.0)


def _combined(
    variance: Real,
    calibration: Calibration,
    frequency_hz: float,
    lag_uncertainty: float,
    bias: complex,
    laser_m: float,
    base_m: float,
) -> tuple[float, float]:
    """Return the combined relative uncertainty of the amplitude ratio and that of the phase [rad]."""
    components = np.array([bias.real, bias.imag])
    # an extrapolated bias carries the noise of the windows, which counts already: only what exceeds it is a bias
    amplitude, phase = (float(v) for v in variance + np.maximum(components**2 - variance, 0.0) / 3.0)
    for channel, level in ((LASER, laser_m), (BASE, base_m)):
        slope = calibration.lag_sensitivity(channel, frequency_hz) * lag_uncertainty
        amplitude += calibration.gain_uncertainty_at(channel, level) ** 2 + slope.real**2
        phase += slope.imag**2
    return math.sqrt(amplitude), math.sqrt(phase)


def _misplaced(
    acceleration: Complex, laser: complex, base: complex, frequency_hz: float, lead_rad: float
) -> Status | None:
    """Tell whether laser and base have changed places, or one of them is wired the wrong way round.

    The accelerometer sits on the superior base: its amplitude over ω² belongs to the laser, not to the base channel.
    And a passive structure cannot lead its base: `lead_rad` is the least phase within three standard uncertainties.
    """
    mean = abs(complex(acceleration.mean()))
    fits_laser = False
    if mean > REFERENCE_FACTOR * _amplitude_u(acceleration, 0.0):
        displacement = mean / (2.0 * math.pi * frequency_hz) ** 2
        fits_base = 1.0 / SWAP_MATCH < displacement / abs(base) < SWAP_MATCH
        fits_laser = 1.0 / SWAP_MISMATCH < displacement / abs(laser) < SWAP_MISMATCH
        if fits_base and not fits_laser:
            return Status.SWAPPED_CHANNELS
    if LEAD_LIMIT_RAD < lead_rad < math.pi - LEAD_LIMIT_RAD:
        return Status.INVERTED_CHANNEL if fits_laser else Status.SWAPPED_CHANNELS
    return None
