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
"""Sine fits of IEEE Std 1057, with a known frequency (three parameters) or with a refined frequency (four parameters).

The numbers of parameters are those for a single harmonic; more harmonics can be fitted.

    y_k = C + Σ_h (A_h cos hωt_k + B_h sin hωt_k) = C + Re Σ_h Y_h e^{ihωt_k},   t_k = k / rate,   Y_h = A_h − iB_h

Standard uncertainties follow from the residual's spectral density *near each harmonic* times the inverse normal matrix.
They are also right for coloured noise, because the fit is only sensitive to noise near the harmonic.
"""

from __future__ import annotations

import math

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Complex, Real
from impact_rig.states import Status

MIN_CYCLES = 1.5  # below this number of cycles, noise prevents the separation of offset, amplitude and phase
MIN_POINTS = 8
NEAR_BINS = 16  # spectral lines of the residual on either side of a harmonic that give its noise density
SKIP_BINS = 2  # lines next to the harmonic that the fit itself has emptied
ITERATIONS = 30
CONVERGED_RAD = 1e-10  # phase change at the end of the record by the last frequency step, at convergence


@attrs.frozen(eq=False)
class SineFit:
    """Result of fitting a sine and its harmonics to samples y.

    If the fit was impossible, all numbers except the given frequency are NaN, and `status` says why.
    """

    status: Status  # `ok`, or why there is no fit
    frequency_hz: float  # given or refined
    offset: float  # C [unit of y]
    phasors: Complex  # Y_h, shape (H,)
    residual_rms: float  # root mean square of the residual, per degree of freedom
    u_offset: float  # standard uncertainty of C
    u_amplitudes: Real  # of |Y_h|, shape (H,)
    u_phases_rad: Real  # of arg Y_h, shape (H,)
    u_frequency_hz: float  # 0 for a given frequency

    @property
    def amplitude(self) -> float:
        """Amplitude of the fundamental (peak, in the unit of the samples)."""
        return abs(complex(self.phasors[0]))

    @property
    def phase_rad(self) -> float:
        """Phase of the fundamental at the first sample [rad]: 0 is a cosine, −π/2 a sine."""
        return float(np.angle(self.phasors[0]))

    def values(self, time: Real) -> Real:
        """Return the fitted offset plus all fitted harmonics at `time` [s since the first sample], shape (n,)."""
        order = np.arange(1, len(self.phasors) + 1)
        turns = np.exp(2j * math.pi * self.frequency_hz * time[:, None] * order)
        return np.asarray(self.offset + (turns @ self.phasors).real)


def fit_sine(y: Real, rate_hz: float, frequency_hz: float, harmonics: int = 1) -> SineFit:
    """Fit an offset and the harmonics of a known frequency to samples (three parameters if `harmonics` is 1).

    `y` has shape (n,). `harmonics` is the number of harmonics, fundamental included. If y cannot be fitted, the status
    of the result is the reason:

    - `no_frequency`: a harmonic is not between 0 and rate / 2.
    - `too_few_cycles`: the record has too few cycles or too few samples.
    - `not_finite`: a sample is not finite.
    - `constant`: all samples are equal.
    """
    refusal = _refusal(y, rate_hz, frequency_hz, harmonics)
    if refusal:
        return _no_fit(refusal, frequency_hz, harmonics)
    design = _design(len(y), rate_hz, frequency_hz, harmonics)
    solution, normal = least_squares(design, y)
    return _finished(y, rate_hz, frequency_hz, design, normal, solution, harmonics, 1.0)


def fit_sine_frequency(y: Real, rate_hz: float, frequency_hz: float, harmonics: int = 1) -> SineFit:
    """Fit an offset, harmonics and their fundamental frequency to samples (four parameters if `harmonics` is 1).

    The fit is a Gauss–Newton iteration that starts at `frequency_hz`. This start value must be right to within about
    half a cycle over the record. If the data cannot be fitted, the status is that of `fit_sine`. If the iteration does
    not converge, the status is `no_fit`.
    """
    refusal = _refusal(y, rate_hz, frequency_hz, harmonics)
    if refusal:
        return _no_fit(refusal, frequency_hz, harmonics)
    time = np.arange(len(y)) / rate_hz
    middle = time[-1] / 2.0
    scale = float(np.ptp(y)) / 2.0  # scales all columns of the fit to similar size
    y = y / scale
    frequency = frequency_hz
    for _ in range(ITERATIONS):
        design = _design(len(y), rate_hz, frequency, harmonics)
        linear = least_squares(design, y)[0]
        order = np.repeat(np.arange(1, harmonics + 1), 2)
        # d/dω of A cos + B sin is t (B cos − A sin); relative to the middle it is nearly orthogonal to the rest
        turned = np.stack([linear[2::2], -linear[1::2]], axis=1).reshape(-1)
        slope = (time - middle) * (design[:, 1:] @ (turned * order))
        full = np.column_stack([design, slope])
        solution, normal = least_squares(full, y)
        step = float(solution[-1])
        frequency += step / (2.0 * math.pi)
        if not _usable(rate_hz, frequency, harmonics):
            return _no_fit(Status.NO_FIT, frequency_hz, harmonics)
        if abs(step) * time[-1] < CONVERGED_RAD:
            return _finished(y, rate_hz, frequency, full, normal, solution, harmonics, scale, middle)
    return _no_fit(Status.NO_FIT, frequency_hz, harmonics)


def least_squares(design: Real, y: Real) -> tuple[Real, Real]:
    """Solve design · solution ≈ y by least squares, and return (solution, inverse of the normal matrix).

    `design` has shape (n, p) and linearly independent columns, and `y` has shape (n,). The solution has shape (p,), and
    the inverse has shape (p, p). The method is fast for n much larger than p.
    """
    normal = design.T @ design
    size = np.sqrt(np.diagonal(normal))
    inverse = np.linalg.inv(normal / np.outer(size, size)) / np.outer(size, size)
    return np.asarray(inverse @ (design.T @ y), dtype=np.float64), np.asarray(inverse, dtype=np.float64)


def noise_density(residual: Real, frequency_hz: float, rate_hz: float) -> float:
    """Return the variance per sample of the white noise that has the spectral density of a residual near a frequency.

    If the record is too short for `NEAR_BINS` spectral lines near the frequency, the result is the variance of the
    residual.
    """
    power = np.abs(np.fft.rfft(residual)) ** 2 / len(residual)
    middle = round(frequency_hz / rate_hz * len(residual))
    apart = np.arange(SKIP_BINS + 1, SKIP_BINS + NEAR_BINS + 1)
    near = np.concatenate([middle - apart[::-1], middle + apart])
    near = near[(near > 0) & (near < len(power))]
    return float(power[near].mean()) if len(near) >= NEAR_BINS else float(np.var(residual))


def _usable(rate_hz: float, frequency_hz: float, harmonics: int) -> bool:
    return math.isfinite(frequency_hz) and 0.0 < frequency_hz * harmonics < rate_hz / 2.0


def _refusal(y: Real, rate_hz: float, frequency_hz: float, harmonics: int) -> Status | None:
    if not _usable(rate_hz, frequency_hz, harmonics):
        return Status.NO_FREQUENCY
    if len(y) < max(MIN_POINTS, 2 * (2 * harmonics + 2)) or len(y) * frequency_hz / rate_hz < MIN_CYCLES:
        return Status.TOO_FEW_CYCLES
    if not np.all(np.isfinite(y)):
        return Status.NOT_FINITE
    return Status.CONSTANT if np.ptp(y) == 0.0 else None


def _design(n: int, rate_hz: float, frequency_hz: float, harmonics: int) -> Real:
    angle = 2.0 * math.pi * frequency_hz / rate_hz * np.arange(n)
    columns = [np.ones(n)]
    for h in range(1, harmonics + 1):
        columns += [np.cos(h * angle), np.sin(h * angle)]
    return np.stack(columns, axis=1)


def _finished(
    y: Real, rate_hz: float, frequency_hz: float, design: Real, normal: Real, solution: Real, harmonics: int,
    scale: float, middle_s: float | None = None,
) -> SineFit:  # fmt: skip
    """Return the result of a fit: the least-squares solution as phasors with uncertainties.

    `y` are the samples divided by `scale`. `normal` is the inverse of the normal matrix of `design`. If the frequency
    was fitted, the last column of `design` belongs to the frequency, and `middle_s` is the time from the first sample
    to the middle of the record [s]. Otherwise `middle_s` is None.
    """
    residual = y - design @ solution
    freedom = len(y) - design.shape[1]
    inflation = len(y) / freedom
    a, b = solution[1 : 2 * harmonics : 2], solution[2 : 2 * harmonics + 1 : 2]
    amplitude = np.hypot(a, b)
    u_amplitude, u_phase = np.empty(harmonics), np.empty(harmonics)
    with np.errstate(divide="ignore", invalid="ignore"):
        for h in range(harmonics):
            variance = inflation * noise_density(residual, (h + 1) * frequency_hz, rate_hz)
            part = variance * normal[2 * h + 1 : 2 * h + 3, 2 * h + 1 : 2 * h + 3]
            radial = np.array([a[h], b[h]]) / amplitude[h]
            across = np.array([-b[h], a[h]]) / amplitude[h]
            u_amplitude[h] = math.sqrt(radial @ part @ radial)
            u_phase[h] = math.sqrt(across @ part @ across) / amplitude[h]
        u_frequency = 0.0
        if middle_s is not None:
            density = inflation * noise_density(residual, frequency_hz, rate_hz)
            u_omega = math.sqrt(density * normal[-1, -1])
            u_frequency = u_omega / (2.0 * math.pi)
            # the phase is that at t = 0, but the frequency is relative to the middle of the record
            u_phase = np.hypot(u_phase, np.arange(1, harmonics + 1) * middle_s * u_omega)
    return SineFit(
        status=Status.OK,
        frequency_hz=frequency_hz,
        offset=scale * float(solution[0]),
        phasors=np.asarray(scale * (a - 1j * b), dtype=np.complex128),
        residual_rms=scale * math.sqrt(float(residual @ residual) / freedom),
        u_offset=scale * math.sqrt(inflation * noise_density(residual, 0.0, rate_hz) * normal[0, 0]),
        u_amplitudes=scale * u_amplitude,
        u_phases_rad=u_phase,
        u_frequency_hz=u_frequency,
    )


def _no_fit(status: Status, frequency_hz: float, harmonics: int) -> SineFit:
    unknown: NDArray[np.float64] = np.full(harmonics, np.nan)
    phasors = unknown.astype(np.complex128)
    return SineFit(status, frequency_hz, math.nan, phasors, math.nan, math.nan, unknown, unknown, math.nan)
