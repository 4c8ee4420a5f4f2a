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
"""Frequency response functions of sweeps and random excitation: H1, H2, Hv with coherence.

    H1 = S_xy / S_xx        unbiased by noise on the response
    H2 = S_yy / S_yx        unbiased by noise on the excitation
    Hv = [S_yy − κS_xx + √((S_yy − κS_xx)² + 4κ|S_xy|²)] / (2 S_yx)      total least squares, κ = S_noise,y / S_noise,x
    γ² = |S_xy|² / (S_xx S_yy),   u(|H|)/|H| = u(arg H) = √((1 − γ²) / (2 (n_d − 2) γ²))

S_xy = E[X* Y] is estimated by Welch's method (scipy.signal). Source: Shin & Hammond (2008), Fundamentals of Signal
Processing, 9.3; for the uncertainty Bendat & Piersol (2010), Random Data, 9.3. The uncertainty has 2 (n_d − 1) degrees
of freedom, so its variance is that of Student's t (GUM Supplement 1, 6.4.9). With two averages or fewer, it is unknown
and given as infinite.

If a segment is shorter than the ringing of the resonance, |H1| is too small at the peak. With σ = ζω_n and r(τ) the
normalised autocorrelation of the window, the true value exceeds the estimate by at most the share 2 (1/r(1/σ) − 1)
(`resolution_bias`). This bias decreases as σ²/(σ² + (ω − ω_n)²) away from the peak, and is a rectangular limit in the
uncertainty. The resonance is estimated from the whole record (`find_resonance`).
"""

from __future__ import annotations

import math
from collections.abc import Callable

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.analysis.scans import BASE, LASER

OVERLAP = 0.5
RESOLVED = 0.02  # target of `resolution_bias`: segments of 100 s for 9.1 Hz and a damping ratio of 0.0045
SEGMENTS = 2.5  # minimum number of segments in a record, by default: four with half an overlap
EXCITED = 1e-3  # share of the strongest line's power from which a line counts as excited
ABOVE_NOISE = 10.0  # minimum power of an excited line, in multiples of the sensor's noise density
REPEATS = 0.01
"""Relative rms change between segments up to which an excitation repeats in each: no power leaks between lines."""
FITS = 0.05  # relative residual up to which a single resonance describes a record
AROUND = 0.1  # relative half width of the band in which a resonance is refined
SHAPE = 8192  # points of a window of which only the shape matters


@attrs.frozen
class Resonance:
    """Resonance of a structure on a moving base: undamped natural frequency and damping ratio."""

    frequency_hz: float
    damping_ratio: float

    @property
    def width_hz(self) -> float:
        """Width of the resonance peak at half its power [Hz]."""
        return 2.0 * self.damping_ratio * self.frequency_hz

    @property
    def decay_per_s(self) -> float:
        """Rate σ = ζω_n at which a free vibration decays [1/s]."""
        return math.pi * self.width_hz


@attrs.frozen(eq=False, kw_only=True)
class Frf:
    """Estimated frequency response function y / x of two channels, with coherence and uncertainty.

    Attributes:
        u_relative: relative standard uncertainty of |H1|, and equally of its phase [rad], shape (n,). From `frf`, it
            contains the effect of noise only. From `transmissibility_frf`, it also contains the calibration and the
            error at the resonance due to the finite length of the segments (`resolution_bias`).
        resonance: resonance in the excited band; None if no single resonance fits. Only `transmissibility_frf` sets it.
    """

    frequency_hz: Real  # shape (n,)
    h1: Complex  # estimators, shape (n,); h2, hv likewise
    h2: Complex
    hv: Complex
    coherence: Real  # γ², shape (n,)
    u_relative: Real
    averages: float  # n_d, effective number of independent averages
    excitation: Real  # S_xx, shape (n,)
    excited: NDArray[np.intp]  # indices of the excited lines, shape (k,); for a sine, its single line
    sine: bool  # whether the excitation is a sine
    resonance: Resonance | None = None
    bias: float = 0.0  # `resolution_bias` at the peak; 0 without a resonance


def frf(
    x: Real,
    y: Real,
    rate_hz: float,
    segment: int,
    *,
    overlap: float = OVERLAP,
    window: str = "hann",
    noise_ratio: float = 1.0,
    x_noise: float = 0.0,
) -> Frf:
    """Estimate the frequency response y / x of a record x (excitation) and a record y (response).

    Args:
        x: samples of the excitation, shape (n,).
        y: samples of the response, shape (n,).
        rate_hz: samples per second.
        segment: length of a segment in samples; one period for a periodic excitation, with the window `boxcar`.
        overlap: share of a segment that is also part of the next one.
        window: name of the window for `scipy.signal`.
        noise_ratio: κ of Hv, the noise power of y divided by that of x.
        x_noise: rms of the noise of x, assumed white [unit of x]. `Frf.excited` lists only lines with at least
            `ABOVE_NOISE` times the power of this noise. The result still has values at all other lines.

    Raises:
        ValueError: x or y is not one-dimensional, or their lengths differ; values are not finite, a channel is
            constant, `segment` is below 8 or above n, or `overlap` is negative or not below 1.
    """
    if x.shape != y.shape or x.ndim != 1:
        raise ValueError(f"x and y must be one-dimensional and of equal length, got {x.shape} and {y.shape}")
    if len(x) < 8:
        raise ValueError(f"x and y must have at least 8 samples, got {len(x)}")
    if not 8 <= segment <= len(x):
        raise ValueError(
            f"segment must be 8 to {len(x)} samples ({8 / rate_hz:g} to {len(x) / rate_hz:g} s), got {segment} "
            f"({segment / rate_hz:g} s)"
        )
    if not 0.0 <= overlap < 1.0:
        raise ValueError(f"overlap must be >= 0 and < 1, got {overlap}")
    for name, values in (("x (excitation)", x), ("y (response)", y)):
        if not np.all(np.isfinite(values)):
            wrong = int(np.argmin(np.isfinite(values)))
            raise ValueError(f"{name} must be finite, got {values[wrong]} in sample {wrong}, counted from 0")
        if np.ptp(values) == 0.0:
            raise ValueError(
                f"{name} must not be constant, got {values[0]:g} in all samples: check the drive and this channel"
            )
    shared = int(overlap * segment)
    options = {"fs": rate_hz, "window": window, "nperseg": segment, "noverlap": shared}
    frequency, s_xx = scipy.signal.welch(x, **options)
    _, s_yy = scipy.signal.welch(y, **options)
    _, s_xy = scipy.signal.csd(x, y, **options)
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = s_yy - noise_ratio * s_xx
        root = np.sqrt(difference**2 + 4.0 * noise_ratio * np.abs(s_xy) ** 2)
        coherence = np.clip(np.abs(s_xy) ** 2 / (s_xx * s_yy), 0.0, 1.0)
        excited, sine = _excited(s_xx, 2.0 * x_noise**2 / rate_hz, window)
        averages = _effective_averages(len(x), segment, shared, window)
        return Frf(
            frequency_hz=frequency,
            h1=s_xy / s_xx,
            h2=s_yy / np.conj(s_xy),
            hv=(difference + root) / (2.0 * np.conj(s_xy)),
            coherence=coherence,
            u_relative=np.sqrt((1.0 - coherence) / (2.0 * max(averages - 2.0, 0.0) * coherence)),
            averages=averages,
            excitation=s_xx,
            excited=excited,
            sine=sine,
        )


def _excited(s_xx: Real, floor: float, window: str) -> tuple[NDArray[np.intp], bool]:
    """Return the indices of the excited lines of a power spectrum, and whether the excitation is a sine.

    An excited line has at least `EXCITED` times the power of the strongest line, and `ABOVE_NOISE` times the noise
    density `floor`. Index 0 never counts. If the window alone explains the width of all excited lines, the excitation
    is a sine. Then only the index of the strongest line is returned. Without an excited line, the result is (empty
    array, False).
    """
    power = s_xx[1:]
    peak = int(np.argmax(power))
    lines = np.flatnonzero((power >= EXCITED * power[peak]) & (power >= ABOVE_NOISE * floor))
    shape, fine = scipy.signal.get_window(window, 256), 16
    lobe = np.abs(np.fft.rfft(shape, 256 * fine)) ** 2
    wide = math.ceil((np.flatnonzero(lobe >= EXCITED * lobe[0])[-1] + 1) / fine) + 1
    sine = len(lines) > 0 and int(np.abs(lines - peak).max()) <= wide
    return (np.array([peak]) if sine else lines) + 1, sine


def find_resonance(
    x: Real,
    y: Real,
    rate_hz: float,
    low_hz: float,
    high_hz: float,
    corrected: Callable[[Real], Complex | float] = lambda _: 1.0,
) -> Resonance | None:
    """Return the resonance of a structure (displacement y) that its moving base (displacement x) excites, or None.

        (s² + 2ζω_n s + ω_n²) Y − (2ζω_n s + ω_n²) X = a + b s,   s = iω

    This equation is fitted to the spectral lines of the whole record; a and b describe its two ends. Source: Pintelon &
    Schoukens (2012), System Identification, 2.6.

    `x` and `y` have shape (n,). The resonance is sought from `low_hz` to `high_hz`, where x must excite the structure,
    and then again within ±10 % (`AROUND`) of the first result. `corrected(frequency_hz)` returns the factor that
    corrects Y for the sensors' lag and skew.

    The result is None if a single resonance in the band does not describe the lines (relative residual above `FITS`),
    or if the band has fewer than 8 lines in one of the two fits.
    """
    frequency = np.asarray(np.fft.rfftfreq(len(x), 1.0 / rate_hz), dtype=np.float64)
    moved, stirred = np.fft.rfft(y - y.mean()), np.fft.rfft(x - x.mean())
    found: Resonance | None = None
    for _ in range(2):  # the whole band, then the neighbourhood of the result, where noise matters least
        if found is not None:
            low_hz = max(low_hz, found.frequency_hz * (1.0 - AROUND))
            high_hz = min(high_hz, found.frequency_hz * (1.0 + AROUND))
        inside = (frequency >= low_hz) & (frequency <= high_hz) & (frequency > 0.0)
        if np.count_nonzero(inside) < 8:
            return None
        s, response = 2j * np.pi * frequency[inside], moved[inside] * corrected(frequency[inside])
        apart = response - stirred[inside]
        columns = np.column_stack([-s * apart, -apart, np.ones_like(s), s])
        matrix, wanted = np.concatenate([columns.real, columns.imag]), s**2 * response
        target = np.concatenate([wanted.real, wanted.imag])
        size = np.linalg.norm(matrix, axis=0)
        if not (size.all() and target.any()):
            return None
        solution = np.linalg.lstsq(matrix / size, target, rcond=None)[0]
        left = np.linalg.norm(target - matrix / size @ solution) / np.linalg.norm(target)
        damping, stiffness = solution[:2] / size[:2]
        if left > FITS or stiffness <= 0.0 or not 0.0 < damping < math.sqrt(stiffness):
            return None
        found = Resonance(math.sqrt(stiffness) / (2.0 * math.pi), damping / (2.0 * math.sqrt(stiffness)))
        if not low_hz <= found.frequency_hz <= high_hz:
            return None
    return found


def resolution_bias(window: str, segment: int, decay_per_sample: float) -> float:
    """Return the largest share by which the true |H| may exceed its estimate at a resonance peak.

    `segment` is the length of a segment in samples. `decay_per_sample` is the decay rate σ of the resonance per sample.
    The bound is 2 (1/r − 1), where r is the normalised autocorrelation of the window at the decay time 1/σ. The bound
    is infinite if the decay time is longer than a segment. It holds to first order in 1/(σ · segment), for the worst
    case that x has an antiresonance at the peak of y, as under current drive.
    """
    shape = scipy.signal.get_window(window, SHAPE)
    lag = round(min(SHAPE / (decay_per_sample * segment), SHAPE))
    kept = float(shape[lag:] @ shape[: SHAPE - lag]) / float(shape @ shape)
    return max(2.0 / kept - 2.0, 0.0) if kept > 0.0 else math.inf


def resolving_s(resonance: Resonance, window: str) -> float:
    """Return the shortest segment length [s], within 1 %, at which `resolution_bias` is at most `RESOLVED`."""
    low, high = 1.0, 1e4  # in decay times
    while high - low > 0.01 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if resolution_bias(window, 1, middle) <= RESOLVED else (middle, high)
    return high / resonance.decay_per_s


def transmissibility_frf(
    rows: NDArray[np.void],
    info: NDArray[np.void],
    segment: int | None = None,
    *,
    overlap: float | None = None,
    window: str = "hann",
    damping_ratio: float | None = None,
) -> Frf:
    """Return the frequency response x_1 / x_b of a sweep or random record, corrected for the sensors' skew and lag.

    Args:
        rows: consecutive scans, with the channels `base` (x_b) and `laser` (x_1). A channel that measures velocity or
            acceleration, by its unit in `info`, is converted to displacement.
        info: rows of `daq/info`.
        segment: length of a segment in samples. None means 1 / `SEGMENTS` of the record, or less if a shorter segment
            resolves the resonance that is found.
        overlap: share of a segment that is also part of the next one. None means a half, or 0 with the window `boxcar`,
            which suits an excitation that repeats from segment to segment.
        window: name of the window for `scipy.signal`.
        damping_ratio: damping ratio of the resonance, if it is known. It replaces the estimated damping ratio.

    Returns:
        The frequency response; its `u_relative` includes calibration and resolution.

    Raises:
        ConfigError: `info` does not describe the channels.
        ValueError: as for `frf`.
    """
    calibration = Calibration.from_info(info)
    rate_hz = calibration.rate_hz
    x, y = (np.asarray(rows[name], dtype=np.float64) for name in ("base", "laser"))
    shared = overlap if overlap is not None else 0.0 if window == "boxcar" else OVERLAP
    x_noise = float(calibration.noise[BASE] * np.sqrt(calibration.noise_crowding()[BASE]))
    most = max(8, int(len(x) / SEGMENTS))
    first = frf(x, y, rate_hz, most, overlap=shared, window=window, x_noise=x_noise)

    def corrected(frequency_hz: Real) -> Complex:
        with np.errstate(
            divide="ignore", invalid="ignore"
        ):  # the mean of a velocity or acceleration is not that of a displacement
            return calibration.response(BASE, frequency_hz) / calibration.response(LASER, frequency_hz)

    resonance = None
    if len(first.excited) and not first.sine:
        band = first.frequency_hz[first.excited]
        resonance = find_resonance(x, y, rate_hz, float(band[0]), float(band[-1]), corrected)
        if resonance is not None and damping_ratio is not None:
            resonance = attrs.evolve(resonance, damping_ratio=damping_ratio)
    if segment is not None:
        length = segment
    elif resonance is None:
        length = most
    else:
        length = min(most, max(8, round(resolving_s(resonance, window) * rate_hz)))
    raw = frf(x, y, rate_hz, length, overlap=shared, window=window, x_noise=x_noise)
    lag = corrected(raw.frequency_hz)
    gain = np.hypot(calibration.gain_uncertainty[LASER], calibration.gain_uncertainty[BASE])
    bias, biases = 0.0, np.zeros(len(lag))
    if resonance is not None and not _periodic(x, length):
        bias = resolution_bias(window, length, resonance.decay_per_s / rate_hz)
        off = 2.0 * math.pi * (raw.frequency_hz - resonance.frequency_hz)
        biases = bias / (1.0 + (off / resonance.decay_per_s) ** 2)
    return attrs.evolve(
        raw,
        h1=raw.h1 * lag,
        h2=raw.h2 * lag,
        hv=raw.hv * lag,
        u_relative=np.sqrt(raw.u_relative**2 + gain**2 + biases**2 / 3.0),
        resonance=resonance,
        bias=bias,
    )


def _periodic(x: Real, segment: int) -> bool:
    """Return whether an excitation repeats from segment to segment, so that no power leaks between lines.

    The result is False for a record of less than two segments.
    """
    if 2 * segment > len(x):
        return False
    return bool(np.std(x[segment:] - x[:-segment]) <= REPEATS * np.std(x))


def _effective_averages(n: int, segment: int, shared: int, window: str) -> float:
    """Return the effective number of averages over n samples.

    Overlapping segments correlate, so the number is less than the number of segments (Welch 1967, Eq. 12). `shared` is
    the number of samples by which neighbouring segments overlap.
    """
    step = segment - shared
    count = (n - shared) // step
    shape = scipy.signal.get_window(window, segment)
    power = float(shape @ shape)
    correlation = 0.0
    for lag in range(1, min(count, -(-segment // step))):
        overlap = float(shape[lag * step :] @ shape[: segment - lag * step]) / power
        correlation += 2.0 * (1.0 - lag / count) * overlap**2
    return count / (1.0 + correlation)
