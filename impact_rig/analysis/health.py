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
"""Is what a channel says believable? Judged by its own samples, by the other channels, and by what it said before.

By itself: not finite, at the end of its range, constant, jumps between two scans that neither the vibration nor its
noise makes (spikes, a step of the zero), noise far above that of the calibration. By the others: the accelerometer
sits where the laser looks, so its amplitude is ω² times the laser's, whatever the motion; a passive structure cannot
lead its base. By before: while the drive stays as it is, a sensor that changes alone has changed its gain, as laser and
accelerometer see one motion, and the base follows from coil current and superior base.

A gain that was wrong from the first row of a setting on, by less than the accelerometer can tell, shows in no reading.
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
CONSTANT_FACTOR = 1e-13  # variance over squared mean that rounding of the sums alone can leave of a constant
SIGNAL_FACTOR = 5.0  # an amplitude below this many standard uncertainties is silence
SMOOTH_FACTOR = 2.0
"""The largest change from scan to scan of the fitted sine and its overtones, times this, is vibration."""
PEAK_FACTOR = 9.0  # noise changes by less from scan to scan than this many times its rms: 6.4 σ√2, once in 10^10
NOISE_FACTOR = 10.0  # noise of this many times the calibration's is another channel's than the calibration is of
REFERENCE_FACTOR = 20.0
"""A channel's amplitude per cycle, in standard uncertainties, from which its phase can serve as reference."""
SWAP_MATCH, SWAP_MISMATCH = 1.25, 1.5
"""Acceleration over ω² must match the base within the first factor and miss the laser by the second to call a swap."""
LEAD_LIMIT_RAD = math.radians(0.5)
CERTAIN = 0.1  # relative uncertainty of DT up to which wiring is judged from it: 1.25 and 1.5 are then told apart
ACCELERATION_LIMIT = 0.04
"""Relative departure of the acceleration from ω² times the laser's amplitude that is always allowed: mounting and
transverse sensitivity stand in no calibration."""
ACCELEROMETER_HIGH_PASS_HZ = 1.0  # corner that a charge amplifier may have and `daq/info` does not tell
ALONE = 0.003  # relative change of an amplitude that counts, beyond its noise
NOISES = 5.0  # standard uncertainties of a change that may be chance
FOLLOWS = 50.0
"""The base may change by this many times the relative change of current and superior base: at resonance it is what two
almost equal forces leave."""


@attrs.frozen
class Rejection:
    """What is wrong, and with which channel, if with one in particular."""

    status: Status
    channel: str = ""


def unsound(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> Rejection | None:
    """Return why cycles must not be averaged, or None."""
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
    """Return whether laser and base, in this order, show no vibration: neither (silence), or one of them alone.

    A channel that falls silent while it is measured is found earlier: `settling`.
    """
    still = [amplitude <= SIGNAL_FACTOR * floor for amplitude, floor in zip(amplitudes, floors, strict=True)]
    return _still(still, Status.NO_SIGNAL)


def _still(still: list[bool], alone: Status) -> Rejection | None:
    """Return silence where laser and base, in this order, are both still, and `alone` where one of them is."""
    if all(still):
        return Rejection(Status.SILENCE)
    return Rejection(alone, CHANNELS[(LASER, BASE)[still.index(True)]]) if any(still) else None


def _constant(cycles: Cycles) -> NDArray[np.bool_]:
    """Return which channels are constant in a cycle, shape (4,)."""
    with np.errstate(over="ignore"):
        return np.asarray((cycles.variance <= CONSTANT_FACTOR * cycles.mean**2).any(axis=0), dtype=np.bool_)


def _medians(values: Real) -> list[float]:
    """Return what `numpy.median` does for each column, which takes ten times longer for the cycles of a window."""
    ordered = np.sort(values, axis=0)  # NaN last
    middle = 0.5 * (ordered[(len(ordered) - 1) // 2] + ordered[len(ordered) // 2])
    medians: list[float] = np.where(np.isnan(ordered[-1]), np.nan, middle).tolist()
    return medians


def _rough(cycles: Cycles, calibration: Calibration, frequency_hz: float) -> list[Status | None]:
    """Return what the largest change from scan to scan of each channel gives away, or None."""
    harmonics = np.arange(1.0, cycles.phasors.shape[2] + 1.0)
    turn = 2.0 * np.pi * frequency_hz / calibration.rate_hz
    with np.errstate(over="ignore", invalid="ignore"):  # an accelerometer may say anything
        smooth = SMOOTH_FACTOR * turn * (np.abs(cycles.phasors) @ harmonics).max(axis=0)
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
    """Amplitudes of a measurement with the standard uncertainty that scatter, noise and steps give each.

    Attributes:
        calibrated: relative departure of acceleration over ω² from X_1 that the calibrations allow.
    """

    size: Real  # by `scans.CHANNELS`; acceleration over ω² [m], X_1 [m], X_b [m], current [A]
    u: Real  # of each, in its unit
    frequency_hz: float  # of the drive
    calibrated: float = ACCELERATION_LIMIT

    @property
    def relative(self) -> Real:
        """Relative u, infinite where there is no signal."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.size > 0.0, self.u / self.size, np.inf)


def amplitudes(
    true: list[Complex], noise: Real, cycles: Cycles, calibration: Calibration, frequency_hz: float
) -> Amplitudes:
    """Return the amplitudes of a measurement.

    An acceleration of less than a step of the converter may come out as anything from none to several times its size.
    What the steps do is told of the amplitude that the laser says: of a reading of 0 they would do nothing. `true` are
    the corrected phasors of the cycles by channel, shape (n, H) each; `noise` the variance per scan in their units,
    shape (4,).
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
    """Tell whether laser and base have changed places, or one of them is wired the wrong way round.

    Of a DT uncertain by more than `CERTAIN` nothing is told. The phase is that of X_1 / X_b, ± π far above resonance.
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
    """Return whether the accelerometer contradicts the laser, or is dead: then impacts cannot be believed, or DT.

    A dead accelerometer leaves the displacements sound; of one that moves, but not as the laser says, it is not known
    which of the two is wrong, unless the laser says what it did before.
    """
    u, expected = found.u, found.size[LASER]
    if not math.isfinite(found.size[ACCELEROMETER]):
        return Rejection(Status.ACCELEROMETER_UNSOUND, CHANNELS[ACCELEROMETER])
    if found.size[ACCELEROMETER] <= SIGNAL_FACTOR * u[ACCELEROMETER]:
        dead = expected > REFERENCE_FACTOR * u[ACCELEROMETER]  # the motion is one that it would show
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
    """Return whether the coil current is not to be believed: stuck, disturbed, or changed alone; DT is sound without.

    Stuck is what varies less than its own noise. A current that is there from the start is not held against the
    command: of a prescribed base or a voltage there need be none.
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
    """Return the logarithms of the ratios of the amplitudes to those of an earlier row, and how much may be chance."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.log(now.size / before.size), NOISES * np.hypot(before.relative, now.relative)


def changed_alone(before: Amplitudes, now: Amplitudes) -> Rejection | None:
    """Return which channel has changed by itself since an earlier row of the same setting, or None."""
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
