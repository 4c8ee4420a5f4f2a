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
"""Detection of impacts in the stream of the accelerometer: causal, in constant memory.

A second-order Butterworth high-pass removes the vibration (up to 20 m/s² near 9 Hz). A contact of 40 to 80 µs leaves a
pulse, followed by the sensor's ringing (25 kHz behind a 10 kHz low-pass). An impact is a crossing of

    threshold = max(threshold_m_s2, noise_factor · rms,  ring_factor · peak · e^{−since/ring_time})

Here rms is the tracked rms of the quiet signal, peak is the largest magnitude of either sign during the previous
impact, and since is the time since the previous impact. The time of an impact is the instant at which the pulse passes
the fraction `ONSET` of its peak, minus the sensor's lag. It is within 10 µs of the first touch at 50 kS/s.
"""

from __future__ import annotations

import bisect
import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Real
from impact_rig.analysis.cycles import PHASE_BINS, Cycles
from impact_rig.analysis.scans import ACCELEROMETER
from impact_rig.analysis.settings import ImpactSettings
from impact_rig.arithmetic.elementary import PI, exp, power, sincos
from impact_rig.blocks import DETECTED_IMPACTS, Table
from impact_rig.kernels import INTEGERS, REALS, REALS_2D, entry
from impact_rig.simtime import COMMAND_GRID_NS, COMMAND_GRID_S

ONSET = 0.45
LOOK_AHEAD_S = 150e-6
"""Time after the crossing of the threshold within which the pulse of an impact has its peak."""
LOOK_AHEAD_SCANS = 6
"""Least number of scans in which that peak is sought, even if they take longer than `LOOK_AHEAD_S`.

At low scan rates, most of a pulse may fall between the scans, and its aliased ringing is higher.
"""
FILTER_SETTLING_S = 0.01
"""Settling time of the high-pass after a start or a gap, in which no impacts are detected."""
RMS_TIME_S = 0.1
RMS_CLIP, RMS_CLIP_RINGING = 9.0, 2.0
"""Factors that limit by how much one sample can raise the tracked variance: in quiet, and soon after an impact.

The square of a sample counts at most this many times the present variance. Impacts that follow each other quickly must
not make the detector insensitive, but a vibration that has become stronger must.
"""
QUIET_RING_TIMES = 8.0
"""Time since the last impact after which the signal counts as quiet, in time constants of the ringing."""
MOST_CALIBRATIONS = 64  # number of calibrations kept: impacts are reported within a second of their scan
RING_SCANS = 8
"""Least time constant of the ringing that is assumed after an impact, in scans.

Below 20 kS/s, the pulse falls between the scans, and the high-pass rings longer than the sensor.
"""
FORERUNNER = 4.0
"""Factor by which a swing to the other side must exceed the first one to count as the pulse of the impact.

The first swing, which crossed the threshold, is then only its precursor or flank.
"""
HISTORY_MASK = 511  # an onset is searched as far back as twice the look-ahead: 300 scans at the highest rate
MIN_RATE_HZ = 2_000
"""Least scan rate at which impacts are detected: below it, contacts fall between the scans."""


IMPACT = np.dtype([("scan", "f8"), ("peak", "f8"), ("sign", "f8")])
"""Row type of detected impacts: instant of first touch in scans since scan 0, fractions included, peak and sign.

The peak of the high-passed acceleration [m/s²] is positive. The sign is +1 if the sphere strikes the right wall.
"""
NO_IMPACTS = np.zeros(0, IMPACT)


def counted(cycles: Cycles, impacts: NDArray[np.void], origin: int, period: float) -> Cycles:
    """Return a copy of drive cycles with the detected impacts filled in.

    The field `impacts` becomes the number of impacts in each cycle. The field `strikes` becomes 1 for each part of a
    cycle that has an impact, else 0, shape (n, PHASE_BINS). The argument `impacts` (`IMPACT`) may contain impacts
    outside the cycles. `origin` is the first scan of cycle 0, and `period` the number of scans per cycle.
    """
    edges = np.append(cycles.first, cycles.first[-1] + cycles.samples[-1])
    place = np.searchsorted(edges, impacts["scan"], side="right") - 1
    inside = (place >= 0) & (place < len(cycles))
    count = np.bincount(place[inside], minlength=len(cycles))
    turns = (impacts["scan"][inside] - origin) / period
    strikes = np.zeros((len(cycles), PHASE_BINS), dtype=np.uint8)
    strikes[place[inside], np.floor((turns - np.floor(turns)) * PHASE_BINS).astype(np.int64) % PHASE_BINS] = 1
    return attrs.evolve(cycles, impacts=count.astype(np.float64), strikes=strikes)


def _high_pass(corner_hz: float, rate_hz: float) -> NDArray[np.float64]:
    """Return the coefficients (b_0, b_1, b_2, a_1, a_2) of a digital Butterworth high-pass of second order.

    The filter is s^2 / (s^2 + sqrt(2) s + 1) through the bilinear transform, pre-warped so that the corner is exact
    (Oppenheim and Schafer, Discrete-Time Signal Processing, section 7.1.2). `scipy.signal.butter` is not used because
    its import takes 60 MB of memory.
    """
    sine, cosine = sincos(PI * corner_hz / rate_hz)
    k = sine / cosine
    b = 1.0 / (1.0 + math.sqrt(2.0) * k + k * k)
    return np.array([b, -2.0 * b, b, 2.0 * b * (k * k - 1.0), b * (1.0 - math.sqrt(2.0) * k + k * k)])


class ImpactDetector:
    """Detector of impacts in the stream of the accelerometer.

    The result does not depend on the division of the stream into blocks.
    """

    def __init__(self, calibration: Calibration, settings: ImpactSettings | None = None) -> None:
        settings = settings or ImpactSettings()
        rate = calibration.rate_hz
        self._rate = rate
        corner = min(settings.corner_hz, rate / 10.0)
        ring_time = max(settings.ring_time_s, RING_SCANS / rate)
        self._filter = _high_pass(corner, rate)
        decay, forget = exp(-1.0 / (ring_time * rate)), 1.0 / (RMS_TIME_S * rate)
        self._limits = np.array([
            settings.threshold_m_s2, settings.noise_factor, settings.ring_factor, decay, forget,
        ])  # fmt: skip
        look_ahead = max(LOOK_AHEAD_SCANS, math.ceil(LOOK_AHEAD_S * rate))
        self._times = np.array(
            [look_ahead, round(FILTER_SETTLING_S * rate), round(QUIET_RING_TIMES * ring_time * rate)]
        )
        self.behind = 0
        """Largest delay of the detector: an impact is found at most this many scans after it happened."""
        self._sensors: list[tuple[float, float, float]] = []  # first scan of its validity, lag [scans], noise [m/s²]
        self.recalibrate(-math.inf, calibration)
        self._history = np.zeros(HISTORY_MASK + 1)
        self._state = np.zeros(7)
        self._place = np.zeros(6, dtype=np.int64)
        self._out = np.zeros((256, 3))
        self.restart(0)

    def restart(self, scan: int) -> None:
        """Reset the detector at the start of the stream or after a gap; the next sample belongs to scan `scan`."""
        noise = self._sensors[self._sensor_at(scan)][2]
        self._state[:] = (0.0, 0.0, noise * noise, 0.0, 0.0, 0.0, 0.0)
        self._place[:] = (scan, 0, 0, 1, 0, 0)
        self._history[:] = 0.0

    def recalibrate(self, scan: float, calibration: Calibration) -> None:
        """Use the accelerometer's lag, skew and noise of a new calibration from the scan with index `scan` on.

        The noise takes effect only at a `restart` at that scan or later. The scan rate must be the same as before.
        """
        noise = max(float(calibration.noise[ACCELEROMETER]), 1e-9)
        lag = (float(calibration.lag[ACCELEROMETER]) - float(calibration.skew[ACCELEROMETER])) * self._rate
        self._sensors.append((scan, lag, noise))
        self._sensors = sorted(self._sensors, key=lambda sensor: sensor[0])[-MOST_CALIBRATIONS:]
        self.behind = max(self.behind, int(2 * self._times[0]) + math.ceil(max(lag, 0.0)))

    def _sensor_at(self, scan: float) -> int:
        return max(0, bisect.bisect_right(self._sensors, scan, key=lambda sensor: sensor[0]) - 1)

    def feed(self, acceleration: Real) -> NDArray[np.void]:
        """Process the next samples, and return the impacts (`IMPACT`) that are recognised in them.

        The samples are the acceleration [m/s²] of consecutive scans, shape (n,). An impact is recognised at most
        `behind` scans after it happened, so it may have happened in an earlier call.
        """
        return self.timed(self.find(acceleration))

    def timed(self, onsets: NDArray[np.void]) -> NDArray[np.void]:
        """Return a copy of impacts from `find`, corrected to the instants of first touch.

        The correction subtracts the sensor's lag from the scans and adds its skew.
        """
        impacts = onsets.copy()
        for impact in impacts:
            impact["scan"] -= self._sensors[self._sensor_at(impact["scan"])][1]
        return impacts

    def find(self, acceleration: Real) -> NDArray[np.void]:
        """Process the next samples and return impacts like `feed`, but without correction for lag and skew.

        `timed` applies this correction. The result is empty if the scan rate is below `MIN_RATE_HZ`.
        """
        if self._rate < MIN_RATE_HZ:
            return NO_IMPACTS
        found: list[Real] = []
        begin = 0
        while begin < len(acceleration):
            count, begin = _detect(
                acceleration, begin, self._filter, self._limits, self._times, self._state, self._place, self._history,
                self._out,
            )  # fmt: skip
            if count:
                found.append(self._out[:count].copy())
        if not found:
            return NO_IMPACTS
        impacts: NDArray[np.void] = (found[0] if len(found) == 1 else np.concatenate(found)).view(IMPACT)[:, 0]
        return impacts


@entry(REALS, int, REALS, REALS, INTEGERS, REALS, INTEGERS, REALS, REALS_2D, returns=(int, int))
def _detect(
    acceleration: Real, begin: int, coefficients: Real, limits: Real, times: NDArray[np.int64], state: Real,
    place: NDArray[np.int64], history: Real, out: Real,
) -> tuple[int, int]:  # fmt: skip
    """Filter the samples from index `begin` on, and write the impacts found in them to `out`.

    The function stops early if `out` is full. The result is (number of impacts found, index of the next sample to
    process). A sample that is not finite ends the search for a peak, and the filter starts again after it.

    `state` = [filter memory 1, filter memory 2, variance, threshold of the ringing, peak, sign, swing].
    `place` = [scan, samples left while the filter settles, samples left of the search for the peak (`hunting`),
    1 if the filter is to be started, scan of the peak, scans since the last impact].
    `limits` = [lowest threshold, noise factor, ringing factor, decay and forgetting per sample].
    `times` = [samples of the search, samples in which the filter settles, samples in which the sensor rings].

    The peak is the largest value with the sign of the crossing, or with the other sign if that is more than
    `FORERUNNER` times as large. The swing is the largest value of either sign; it determines the threshold of the
    ringing.
    """
    in_0, in_1, in_2, out_1, out_2 = coefficients
    floor, noise_factor, ring_factor, decay, forget = limits
    keep = 1.0 - forget
    most_quiet, most_ringing = keep + forget * RMS_CLIP, keep + forget * RMS_CLIP_RINGING
    look_ahead, blank_time, quiet_time = times
    memory_1, memory_2, variance, ring, peak, sign, swing = state
    scan, blank, hunting, fresh, peak_at, since = place
    count = 0
    i = begin
    while i < len(acceleration) and count < len(out):
        value = acceleration[i]
        i += 1
        if not math.isfinite(value):
            fresh, hunting = 1, 0
            scan += 1
            continue
        if fresh:  # the filter starts in the steady state of the first value
            fresh, blank = 0, blank_time
            memory_1, memory_2 = -in_0 * value, in_2 * value
        passed = in_0 * value + memory_1
        memory_1 = (in_1 * value + memory_2) - out_1 * passed
        memory_2 = in_2 * value - out_2 * passed
        history[scan & HISTORY_MASK] = passed
        ring = ring * decay if ring > floor else 0.0  # avoid denormal numbers, which are slow
        since += 1
        if hunting > 0:
            if sign * passed > peak:
                peak, peak_at = sign * passed, scan
            elif -sign * passed > FORERUNNER * peak:
                sign, peak, peak_at = -sign, -sign * passed, scan
            swing = max(swing, abs(passed))
            hunting -= 1
            if hunting == 0:
                level = ONSET * peak
                k = peak_at
                while k > peak_at - look_ahead and sign * history[(k - 1) & HISTORY_MASK] > level:
                    k -= 1
                after, before = sign * history[k & HISTORY_MASK], sign * history[(k - 1) & HISTORY_MASK]
                out[count, 0] = k - (after - level) / (after - before)
                out[count, 1], out[count, 2] = peak, sign
                count += 1
                ring = ring_factor * swing * power(decay, scan - peak_at)
                since = scan - peak_at
        elif blank > 0:
            blank -= 1
            if 2 * blank < blank_time:  # the filter has settled: learn the noise
                variance += 4.0 / blank_time * (passed * passed - variance)
        elif abs(passed) > floor and abs(passed) > ring and passed * passed > noise_factor * noise_factor * variance:
            hunting = look_ahead
            sign = 1.0 if passed > 0.0 else -1.0
            peak, peak_at = sign * passed, scan
            swing = peak
        else:
            learnt, most = keep * variance + forget * (passed * passed), most_ringing * variance
            if since > quiet_time:
                most = most_quiet * variance
            variance = learnt if learnt < most else most
        scan += 1
    state[0], state[1], state[2], state[3] = memory_1, memory_2, variance, ring
    state[4], state[5], state[6] = peak, sign, swing
    place[0], place[1], place[2], place[3], place[4], place[5] = scan, blank, hunting, fresh, peak_at, since
    return count, i


def impact_tables(found: NDArray[np.void], rate_hz: float, start_ns: int) -> list[Table]:
    """Return detected impacts (`IMPACT`) as tables `impacts`, one per tick (10 ms) that has impacts.

    Each table is stamped with the beginning of its tick. Stamps and times therefore do not depend on the length of the
    blocks. `start_ns` is the rig time of scan 0 [ns].
    """
    rows: dict[int, list[tuple[float, float, float]]] = {}
    for scan, peak, sign in found.tolist():  # usually a single one, for which NumPy is slow
        seconds = scan / rate_hz
        cell = math.floor(seconds / COMMAND_GRID_S)
        rows.setdefault(cell, []).append((seconds - cell * COMMAND_GRID_S, peak, sign))
    return [
        Table(start_ns + cell * COMMAND_GRID_NS, np.array(rows[cell], dtype=DETECTED_IMPACTS)) for cell in sorted(rows)
    ]
