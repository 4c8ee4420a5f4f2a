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
"""Plausibility of channels, judged by their own samples, by the other channels, and by earlier values.

By its own samples, a channel is unsound if its values are not finite, at the end of the range, or constant. It is also
unsound if it jumps between two scans (spikes, a step of the zero), or if its noise is far above that of the
calibration.

By the other channels: the accelerometer is mounted where the laser measures, so its amplitude is ω² times that of the
laser. A passive structure cannot lead its base.

By earlier values: while the drive is unchanged, a sensor whose amplitude changes alone has changed its gain. Laser and
accelerometer measure the same motion. The motion of the base follows from coil current and superior base.

A gain error that exists from the first row of a setting is not detected if it is below the accuracy of the
accelerometer.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.analysis.cycles import RANGE_BIT, Cycles
from impact_rig.analysis.scans import ACCELEROMETER, BASE, CHANNELS, CURRENT, LASER
from impact_rig.states import Status

DISPLACEMENTS = (LASER, BASE, CURRENT)
CONSTANT_FACTOR = 1e-13  # variance over squared mean of a constant, caused by rounding of the sums alone
SIGNAL_FACTOR = 5.0  # an amplitude below this many standard uncertainties counts as no signal
SMOOTH_FACTOR = 2.0
"""Change from scan to scan that still counts as vibration, as a multiple of that of the fitted sine and overtones."""
PEAK_FACTOR = 9.0  # noise changes by less from scan to scan than this many times its rms: 6.4 σ√2, once in 10^10
# noise of this many times the calibration's indicates that the calibration belongs to another channel
NOISE_FACTOR = 10.0
REFERENCE_FACTOR = 20.0
"""Amplitude, in standard uncertainties, from which a channel has a clear signal: it can serve as a reference."""
SWAP_MATCH, SWAP_MISMATCH = 1.25, 1.5
"""Factors for detecting that laser and base are exchanged.

The amplitude of acceleration over ω² then agrees with that of the base within the first factor, and differs from that
of the laser by more than the second.
"""
LEAD_LIMIT_RAD = math.radians(0.5)
CERTAIN = 0.1  # relative uncertainty of DT up to which wiring is judged from it: 1.25 and 1.5 can then be distinguished
ACCELERATION_LIMIT = 0.04
"""Relative deviation of the acceleration from ω² times the laser's amplitude that is always allowed.

It allows for mounting and transverse sensitivity, which no calibration contains.
"""
ACCELEROMETER_HIGH_PASS_HZ = 1.0  # corner frequency that a charge amplifier may have, which `daq/info` does not contain
ALONE = 0.003  # smallest relevant relative change of an amplitude, in addition to its noise
NOISES = 5.0  # standard uncertainties of a change that may be chance
FOLLOWS = 50.0
"""Largest relative change of the base's amplitude, as a multiple of that of coil current plus that of structure.

At resonance, the difference of two almost equal forces moves the base, so small changes of them change it much.
"""


@attrs.frozen
class Rejection:
    """Reason why a measurement is rejected or doubtful, with the channel concerned.

    The channel is empty if the reason does not concern a single channel.
    """

    status: Status
    channel: str = ""


def unsound(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> Rejection | None:
    """Return the reason why drive cycles must not be averaged, or None if they may be averaged.

    Laser, base and current must be finite and within their range. Laser and base must not be constant, jump from scan
    to scan, or be far noisier than their calibration states. Jumps and noise are judged only in a channel that measures
    displacement, because an impact makes a velocity or an acceleration jump.
    """
    flags = int(np.bitwise_or.reduce(cycles.flags))
    finite = np.logical_and.reduce(np.isfinite(cycles.mean)).tolist()
    for channel in DISPLACEMENTS:
        if not finite[channel]:
            return Rejection(Status.NOT_FINITE, CHANNELS[channel])
        if flags & ((1 | RANGE_BIT) << channel):
            return Rejection(Status.OVER_RANGE, CHANNELS[channel])
    still = _still(_constant(cycles)[[LASER, BASE]].tolist(), Status.CONSTANT)
    if still is not None:
        return still
    rough = _rough(cycles, calibration, frequency_hz)
    for channel in (LASER, BASE):
        why = rough[channel]
        if (
            why and not calibration.derivative[channel]
        ):  # an impact makes a pulse in an acceleration, a step in a velocity
            return Rejection(why, CHANNELS[channel])
    return None


def silent(amplitudes: tuple[float, float], floors: tuple[float, float]) -> Rejection | None:
    """Return a rejection if laser, base or both show no vibration; else None.

    `amplitudes` are the amplitudes of (laser, base), and `floors` their standard uncertainties. An amplitude of at most
    `SIGNAL_FACTOR` times its standard uncertainty counts as no vibration. The status is `silence` if both channels show
    no vibration, and `no_signal` with the name of the channel if only one does.
    """
    still = [amplitude <= SIGNAL_FACTOR * floor for amplitude, floor in zip(amplitudes, floors, strict=True)]
    return _still(still, Status.NO_SIGNAL)


def _still(still: list[bool], alone: Status) -> Rejection | None:
    """Return a rejection if laser, base or both stand still; else None.

    `still` says for (laser, base) whether the channel stands still. The status is `silence` if both do. If only one
    does, the status is `alone`, and the rejection names the channel.
    """
    if all(still):
        return Rejection(Status.SILENCE)
    return Rejection(alone, CHANNELS[(LASER, BASE)[still.index(True)]]) if any(still) else None


def _constant(cycles: Cycles) -> NDArray[np.bool_]:
    """Return which channels are constant throughout at least one cycle, shape (4,)."""
    with np.errstate(over="ignore"):
        return np.asarray((cycles.variance <= CONSTANT_FACTOR * cycles.mean**2).any(axis=0), dtype=np.bool_)


def _medians(values: Real) -> list[float]:
    """Return the median of each column, or NaN for a column that contains NaN.

    This is ten times faster than `numpy.median`.
    """
    ordered = np.sort(values, axis=0)  # NaN last
    middle = 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
    medians: list[float] = np.where(np.isnan(ordered[-1]), np.nan, middle).tolist()
    return medians


def _rough(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> list[Status | None]:
    """Return for each channel the fault that its changes from scan to scan show, or None.

    The faults are `noisy` (changes far above the calibrated noise), `level_jump` (the level stays after a large change)
    and `spikes` (the level returns after it).
    """
    turn = 2.0 * np.pi * frequency_hz / calibration.rate_hz
    with np.errstate(over="ignore", invalid="ignore"):  # an accelerometer may read anything
        smooth = SMOOTH_FACTOR * turn * (np.abs(cycles.phasors) @ cycles.harmonics).max(axis=0)
    limits = (smooth + 2.0 * (calibration.output_step + calibration.converter_step)).tolist()
    freedom = np.maximum(cycles.samples - 2 * cycles.phasors.shape[2] - 1, 1)
    variances, jumps = _medians(cycles.residual / freedom[:, None]), _medians(cycles.jump)
    largest = cycles.jump.max(axis=0).tolist()
    first, last = cycles.mean[0].tolist(), cycles.mean[-1].tolist()
    found: list[Status | None] = []
    for channel, known in enumerate(calibration.noise.tolist()):
        limit = limits[channel]
        if known > 0.0 and jumps[channel] > limit + NOISE_FACTOR * PEAK_FACTOR * known / 2.0:
            found.append(Status.NOISY)
        elif largest[channel] <= limit + PEAK_FACTOR * max(known, math.sqrt(variances[channel])):
            found.append(None)
        else:
            shifted = abs(last[channel] - first[channel]) > largest[channel] / 2.0
            found.append(Status.LEVEL_JUMP if shifted else Status.SPIKES)
    return found


@attrs.frozen(eq=False)
class Amplitudes:
    """Amplitudes of the channels in a measurement, with standard uncertainties due to scatter, noise and steps.

    The amplitudes of laser, base and accelerometer are displacements [m]; that of the accelerometer is acceleration /
    ω². The amplitude of the current is in amperes.

    Attributes:
        calibrated: largest allowed relative difference between acceleration / ω² and X_1. It is the difference that the
            calibrations of the two sensors explain, but at least `ACCELERATION_LIMIT`.
    """

    size: Real  # by `scans.CHANNELS`; acceleration over ω² [m], X_1 [m], X_b [m], current [A]
    u: Real  # standard uncertainty of each, in its unit
    frequency_hz: float  # drive frequency
    calibrated: float = ACCELERATION_LIMIT

    @property
    def relative(self) -> Real:
        """Relative standard uncertainties of the amplitudes, shape (4,); infinite for an amplitude of 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.size > 0.0, self.u / self.size, np.inf)


def amplitudes(
    true: list[Complex], noise: Real, cycles: Cycles, calibration: Calibration, frequency_hz: float
) -> Amplitudes:
    """Return the amplitudes of all channels at the drive frequency, with their uncertainties.

    `true` are the corrected phasors of the cycles for each channel, each of shape (n, H). `noise` are the variances per
    scan in the squared units of these phasors, shape (4,). The effect of the accelerometer's steps is computed for the
    acceleration that follows from the laser's amplitude.
    """
    square = (2.0 * math.pi * frequency_hz) ** 2
    size, u = np.zeros(4), np.zeros(4)
    for channel, phasors in enumerate(true):
        size[channel] = abs(complex(phasors[:, 0].mean()))
    expected = size.copy()
    expected[ACCELEROMETER] = square * size[LASER]
    for channel, phasors in enumerate(true):
        white = 2.0 * float(noise[channel]) / float(cycles.samples.sum())
        random = max(float(np.var(np.abs(phasors[:, 0]))) / len(phasors), white)
        scale = calibration.scale(channel, frequency_hz)
        steps = calibration.steps_uncertainty(channel, float(expected[channel]) * scale) / scale
        u[channel] = math.hypot(math.sqrt(random), steps)
    for of in (size, u):
        of[ACCELEROMETER] /= square
    sensitivities = math.sqrt(3.0) * float(calibration.gain_uncertainty[[ACCELEROMETER, LASER]].sum())
    return Amplitudes(size, u, frequency_hz, max(ACCELERATION_LIMIT, sensitivities))


def misplaced(found: Amplitudes, u_relative: float, phase_rad: float, u_phase_rad: float) -> Rejection | None:
    """Return a rejection if laser and base seem exchanged, or one of them seems to have the wrong polarity; else None.

    `phase_rad` is the phase of X_1 / X_b, and `u_phase_rad` its standard uncertainty. `u_relative` is the relative
    standard uncertainty of DT; above `CERTAIN`, the result is None.

    Laser and base seem exchanged if the acceleration fits the base and not the laser. A structure that leads its base
    is also implausible: one polarity is wrong if the acceleration fits the laser, otherwise laser and base are
    exchanged.
    """
    if u_relative > CERTAIN:
        return None
    fits_laser = False
    if found.relative[ACCELEROMETER] < 1.0 / REFERENCE_FACTOR:
        displacement = found.size[ACCELEROMETER]
        fits_base = 1.0 / SWAP_MATCH < displacement / found.size[BASE] < SWAP_MATCH
        fits_laser = bool(1.0 / SWAP_MISMATCH < displacement / found.size[LASER] < SWAP_MISMATCH)
        if fits_base and not fits_laser:
            return Rejection(Status.SWAPPED_CHANNELS)
    doubt = LEAD_LIMIT_RAD + 3.0 * u_phase_rad
    if doubt < phase_rad < math.pi - doubt:
        return Rejection(Status.INVERTED_CHANNEL if fits_laser else Status.SWAPPED_CHANNELS)
    return None


def contradiction(found: Amplitudes, before: Amplitudes | None = None) -> Rejection | None:
    """Return a rejection if the accelerometer shows no signal or contradicts the laser; else None.

    If the motion is too small for a comparison, the result is None. An accelerometer without a finite signal is
    rejected (`accelerometer_unsound`). If the accelerometer contradicts the laser, either may be wrong. The
    accelerometer is rejected if the laser still has its amplitude in `before`, an earlier row of the same setting.
    Otherwise, or without `before`, the laser is rejected (`implausible`).
    """
    u, expected = found.u, found.size[LASER]
    if not math.isfinite(found.size[ACCELEROMETER]):
        return Rejection(Status.ACCELEROMETER_UNSOUND, CHANNELS[ACCELEROMETER])
    if found.size[ACCELEROMETER] <= SIGNAL_FACTOR * u[ACCELEROMETER]:
        dead = expected > REFERENCE_FACTOR * u[ACCELEROMETER]  # a motion that it would show
        return Rejection(Status.ACCELEROMETER_UNSOUND, CHANNELS[ACCELEROMETER]) if dead else None
    low = expected / math.hypot(1.0, ACCELEROMETER_HIGH_PASS_HZ / found.frequency_hz)
    allowed = found.calibrated * expected + 3.0 * math.hypot(u[ACCELEROMETER], u[LASER])
    if low - allowed <= found.size[ACCELEROMETER] <= expected + allowed:
        return None
    if before is not None:
        laser, noise = (
            found.size[LASER] / before.size[LASER] - 1.0,
            math.hypot(found.relative[LASER], before.relative[LASER]),
        )
        if abs(laser) <= ALONE + NOISES * noise:
            return Rejection(Status.ACCELEROMETER_UNSOUND, CHANNELS[ACCELEROMETER])
    return Rejection(Status.IMPLAUSIBLE, CHANNELS[LASER])


def current_unsound(
    cycles: Cycles, calibration: Calibration, found: Amplitudes, before: Amplitudes | None = None
) -> bool:
    """Return whether the measured coil current is unreliable: stuck, disturbed, or changed alone since an earlier row.

    `before` are the amplitudes of an earlier row of the same setting; None skips this comparison. A constant current
    counts as stuck only if the noise of the channel exceeds a step of the converter.
    """
    stuck = calibration.noise[CURRENT] > calibration.converter_step[CURRENT] and _constant(cycles)[CURRENT]
    if stuck or _rough(cycles, calibration, found.frequency_hz)[CURRENT]:
        return True
    if before is None or before.relative[CURRENT] > 1.0 / REFERENCE_FACTOR:
        return False
    change, chance = _changes(before, found)
    moved = np.maximum(np.abs(change) - chance, 0.0)
    return bool(moved[CURRENT] > ALONE + FOLLOWS * (moved[LASER] + moved[BASE]))


def _changes(before: Amplitudes, now: Amplitudes) -> tuple[Real, Real]:
    """Return ln(now / before) of the amplitude of each channel, and the largest change that noise explains.

    Both have shape (4,). The second is `NOISES` standard uncertainties of the ratio.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(now.size / before.size), NOISES * np.hypot(before.relative, now.relative)


def changed_alone(before: Amplitudes, now: Amplitudes) -> Rejection | None:
    """Return a rejection (`implausible`) that names laser or base if this channel alone has changed; else None.

    `before` is an earlier row of the same drive setting. The laser has changed alone if its amplitude has changed more
    than that of the accelerometer, beyond noise. The base has changed alone if the changes of laser and current do not
    explain the change of the base.
    """
    change, noise = _changes(before, now)
    size = np.nan_to_num(np.abs(change), posinf=math.inf)
    least = np.maximum(ALONE, noise)
    apart = abs(change[LASER] - change[ACCELEROMETER])
    if apart > ALONE + math.hypot(noise[LASER], noise[ACCELEROMETER]) and size[LASER] > size[ACCELEROMETER]:
        return Rejection(Status.IMPLAUSIBLE, CHANNELS[LASER])
    still = size[LASER] + (size[CURRENT] if math.isfinite(noise[CURRENT]) else 0.0)
    if size[BASE] > least[BASE] + FOLLOWS * still:
        return Rejection(Status.IMPLAUSIBLE, CHANNELS[BASE])
    return None
