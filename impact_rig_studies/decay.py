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
"""Natural frequency f_n and damping ratio ζ from a free decay; coefficient of restitution e from a drop test.

A free decay is evaluated by a least-squares fit or by the logarithmic decrement:

    y(t) = C + D t + e^{−λt} (A cos ω_d t + B sin ω_d t),   λ = ζω_n,   ω_d = ω_n √(1 − ζ²)
    ω_n = √(ω_d² + λ²),   ζ = λ/ω_n;      decrement per cycle δ = 2πλ/ω_d,   ζ = δ/√(4π² + δ²)

Gain, offset, skew and lag of the sensor change neither f_n nor ζ. A curved characteristic of the sensor changes ζ: a
gain that depends on the amplitude bends the envelope of the decay (`bent`). Therefore u(f_n) contains the noise (its
density near ω_d, as in `analysis.sine`) and the error of the clock. u(ζ) contains the noise and the curved
characteristic.

There is no ζ if the accelerometer shows impacts, because the sphere takes energy as long as it strikes. There is also
none if the two halves of the record decay at different rates. `measure_decay` returns a status for both cases.

A sphere dropped from the height H0 onto the fixed barrier rebounds to H1. The operator notes both heights as a remark
on the topic `notes`, like `drop h0_m=0.2 h1_m=0.0245`:

    e = √(H1/H0),   (u(e)/e)² = ¼ [(u(H1)/H1)² + (u(H0)/H0)²]
"""

from __future__ import annotations

import math
import re
from typing import Protocol

import attrs
import numpy as np
import scipy
from numpy.typing import NDArray

from impact_rig.analysis.calibration import Calibration, Complex, Real
from impact_rig.analysis.impacts import ImpactDetector
from impact_rig.analysis.scans import LASER, samples_of, status_of
from impact_rig.analysis.sine import least_squares, noise_density
from impact_rig.states import Status

MIN_CYCLES = 4
MIN_POINTS = 32
MIN_SAMPLES_FOR_HARMONICS = 20  # fewest scans per cycle with which the second and third harmonic are fitted as well
MIN_SAMPLES_PER_CYCLE = 5  # number of unknowns in the fit of one cycle without harmonics
LINE_FACTOR = 20.0  # factor by which a spectral line must exceed the largest expected noise line to be a vibration
SIGNAL_FACTOR = 10.0  # smallest amplitude of a cycle, in standard uncertainties, whose logarithm is used
DIFFERENT = 6.0
"""Largest accepted difference of the decay rates of a record's two halves, in standard uncertainties."""
ITERATIONS = 50
CONVERGED = 1e-10
REASONS = {
    Status.IMPACTS: "the accelerometer shows impacts: a free decay gives ζ of the structure alone, without the sphere "
    "(sphere.present: false) or with amplitudes at which it strikes no wall",
    Status.NOT_EXPONENTIAL: "the two halves of the record decay at different rates, so one ζ does not describe it",
}
"""Status of a free decay without f_n and ζ -> explanation for messages."""


@attrs.frozen(kw_only=True)
class Decay:
    """Natural frequency f_n and damping ratio ζ of a free decay; NaN if `status` is not `ok`.

    Fields with u_ are standard uncertainties.
    """

    status: Status
    natural_frequency_hz: float = math.nan
    damping_ratio: float = math.nan
    u_natural_frequency_hz: float = math.nan
    u_damping_ratio: float = math.nan
    amplitude: float = math.nan  # at the beginning of the record, in the unit of the record
    cycles: int = 0  # number of cycles evaluated


class DecayMethod(Protocol):
    """Interface of `fit_decay` and `log_decrement`, functions that compute f_n and ζ from a recorded free decay."""

    def __call__(self, y: Real, rate_hz: float, u_clock: float = 0.0) -> Decay:
        """Return natural frequency f_n and damping ratio ζ of a freely decaying displacement.

        If they cannot be determined, the `status` of the result is the reason.

        Args:
            y: samples of the displacement, shape (n,).
            rate_hz: samples per second.
            u_clock: relative standard uncertainty of the rate.
        """


def measure_decay(
    rows: NDArray[np.void], info: NDArray[np.void], method: DecayMethod | None = None, u_clock: float = 0.0
) -> Decay:
    """Measure f_n and ζ from the free decay of the superior base while the inferior base is locked.

    The status is `over_range` if the laser was clipped, `impacts` if the accelerometer shows an impact, and
    `not_exponential` if the halves of the record decay at different rates. Otherwise it is that of `method`.

    Args:
        rows: consecutive scans (`daq/scan`) that begin after the release, shape (n,).
        info: rows of `daq/info`, which describe the instruments.
        method: `fit_decay` (None) or `log_decrement`.
        u_clock: relative standard uncertainty of the scan rate.

    Raises:
        ConfigError: `info` does not describe the channels.
    """
    calibration = Calibration.from_info(info)
    y = np.asarray(rows["laser"], dtype=np.float64)
    with np.errstate(invalid="ignore"):
        clipped = np.any((y <= calibration.low[LASER]) | (y >= calibration.high[LASER]))
    if clipped or np.any(status_of(rows) & (1 << LASER)):
        return Decay(status=Status.OVER_RANGE)
    found = (method or fit_decay)(y, calibration.rate_hz, u_clock)
    if len(ImpactDetector(calibration).feed(samples_of(rows, "accelerometer"))):
        return Decay(status=Status.IMPACTS)
    if found.status is not Status.OK:
        return found
    seconds = len(y) / calibration.rate_hz
    share = bent(2.0 * math.pi * found.natural_frequency_hz * found.damping_ratio, seconds)
    bend = calibration.curvature_uncertainty(LASER, found.amplitude)
    if not _one_rate(y, calibration.rate_hz, 2.0 * math.pi * found.natural_frequency_hz, bend):
        return Decay(status=Status.NOT_EXPONENTIAL)
    curve = share * bend
    return attrs.evolve(found, u_damping_ratio=math.hypot(found.u_damping_ratio, curve * found.damping_ratio))


def _one_rate(y: Real, rate_hz: float, omega: float, bend: float) -> bool:
    """Return whether both halves of a record decay at the same rate, as an exponential decay does.

    A difference up to `DIFFERENT` standard uncertainties counts as the same rate. The uncertainty comes from the
    scatter of the cycles and the curved (nonlinear) characteristic of the sensor. With too few cycles to decide, the
    result is true.

    Args:
        y: samples of the displacement, shape (n,).
        rate_hz: samples per second.
        omega: angular frequency of the decay [rad/s].
        bend: relative standard uncertainty of the amplitude due to the curved characteristic.
    """
    phasors, middles, noise = _cycle_phasors(y, rate_hz, omega)
    half = _strong(phasors, noise) // 2
    if half < MIN_CYCLES:
        return True  # too few cycles to decide
    rates, uncertainty = [], 0.0
    for part in (slice(0, half), slice(half, 2 * half)):
        slope, left, weights = _straight_line(phasors[part], middles[part])
        rates.append(slope.real)
        uncertainty += float(weights @ left.real**2) / (half - 2) + (2.0 * bend * slope.real) ** 2
    return abs(rates[0] - rates[1]) <= DIFFERENT * math.sqrt(uncertainty)


def bent(decay_per_s: float, seconds: float) -> float:
    """Return (Δζ/ζ)/κ, the relative error of ζ divided by κ, for a sensor with a curved characteristic.

    The gain of this sensor depends on the amplitude a as 1 + κ (a/a_0)². a_0 is the amplitude at the beginning of the
    record. ζ is fitted to ln a with the weights a². The result is 1/2 for a record that contains the whole decay, and
    more for a shorter record, up to 2.

    Args:
        decay_per_s: rate λ of the decay [1/s].
        seconds: length of the record.
    """
    k = 2.0 * decay_per_s * seconds
    weight, first, second = _moments(k)
    middle = first / weight
    bend, bend_first, _ = _moments(2.0 * k)
    return (middle * bend - bend_first) / (k / 2.0 * (second - middle * first))


def _moments(k: float) -> tuple[float, float, float]:
    """Return ∫ sⁿ e^{−ks} ds over 0 … 1 for n = 0, 1, 2; k must not be 0."""
    end = math.exp(-k)
    zeroth = -math.expm1(-k) / k
    first = (zeroth - end) / k
    return zeroth, first, (2.0 * first - end) / k


def fit_decay(y: Real, rate_hz: float, u_clock: float = 0.0) -> Decay:
    """Return f_n and ζ of a free decay by a least-squares fit of a decaying sine and a drift to all samples.

    The arguments are those of `DecayMethod`.
    """
    start = _start(y, rate_hz)
    if isinstance(start, Status):
        return Decay(status=start)
    omega, decay = start
    scale = float(np.ptp(y)) / 2.0  # scales all columns of the fit to similar size
    y = y / scale
    time = np.arange(len(y)) / rate_hz
    previous = math.inf
    for _ in range(ITERATIONS):
        design, envelope = _design(time, omega, decay)
        linear = least_squares(design, y)[0]
        residual = y - design @ linear
        oscillation = linear[2] * envelope.real + linear[3] * envelope.imag
        across = linear[3] * envelope.real - linear[2] * envelope.imag
        full = np.column_stack([design, -time * oscillation, time * across])
        change, covariance = least_squares(full, residual)
        size = max(abs(change[4]), abs(change[5])) / omega
        decay, omega = decay + float(change[4]), omega + float(change[5])
        if not (omega > 0.0 and abs(decay) < omega) or not math.isfinite(omega):
            return Decay(status=Status.NO_FIT)
        if size < CONVERGED or (size < 1e-7 and size >= previous):  # the second: down to rounding
            return _result(residual, rate_hz, omega, decay, covariance, linear, u_clock, scale)
        previous = size
    return Decay(status=Status.NO_FIT)


def log_decrement(y: Real, rate_hz: float, u_clock: float = 0.0) -> Decay:
    """Return f_n and ζ of a free decay from the amplitudes and phases of its successive cycles.

    Straight lines over the time are fitted to the logarithm of the amplitude and to the phase. Their slopes, the decay
    rate and the damped frequency, give ζ and f_n. Cycles from the first weak cycle on are left out. The uncertainties
    come from the scatter about the lines and, for f_n, from `u_clock`. The arguments are those of `DecayMethod`.
    """
    start = _start(y, rate_hz)
    if isinstance(start, Status):
        return Decay(status=start)
    phasors, middles, noise = _cycle_phasors(y, rate_hz, start[0])
    used = _strong(phasors, noise)
    if used < MIN_CYCLES:
        return Decay(status=Status.TOO_FEW_CYCLES)
    slope, left, weights = _straight_line(phasors[:used], middles[:used])
    if slope.real >= 0.0:
        return Decay(status=Status.NO_FIT)
    omega = start[0] + slope.imag
    cycle = 2.0 * math.pi / omega
    u_decay, u_turn = (math.sqrt(float(weights @ part**2) / (used - 2)) for part in (left.real, left.imag))
    decrement = -slope.real * cycle
    root = math.hypot(2.0 * math.pi, decrement)
    natural = math.hypot(omega, slope.real) / (2.0 * math.pi)
    return Decay(
        status=Status.OK,
        natural_frequency_hz=natural,
        damping_ratio=decrement / root,
        u_natural_frequency_hz=math.hypot(u_turn / (2.0 * math.pi), natural * u_clock),
        u_damping_ratio=u_decay * cycle * 4.0 * math.pi**2 / root**3,
        amplitude=abs(complex(phasors[0])),
        cycles=used,
    )


def _start(y: Real, rate_hz: float) -> tuple[float, float] | Status:
    """Return initial values of ω_d [rad/s] and λ [1/s] for the fit of a decay, or a status if it cannot be fitted."""
    if not np.all(np.isfinite(y)):
        return Status.NOT_FINITE
    if len(y) < MIN_POINTS:
        return Status.TOO_FEW_CYCLES
    if np.ptp(y) == 0.0:
        return Status.CONSTANT
    number = np.arange(len(y))
    level = y - np.polyval(np.polyfit(number, y, 1), number)
    padded = 4 * len(y)
    power = np.abs(scipy.fft.rfft(level, padded)) ** 2
    peak = int(np.argmax(power[1:-1])) + 1
    if peak * len(y) / padded < MIN_CYCLES:
        return Status.TOO_FEW_CYCLES
    if power[peak] < LINE_FACTOR * np.median(power[1:-1]) * math.log(len(power)):
        return Status.SILENCE  # no line exceeds the noise
    if padded < MIN_SAMPLES_PER_CYCLE * (peak + 1):  # the refined frequency may be almost that of the next line
        return Status.NO_FIT
    omega = 2.0 * math.pi * peak * rate_hz / padded
    phasors, middles, noise = _cycle_phasors(level, rate_hz, omega)
    used = _strong(phasors, noise)
    if used < 2:
        return Status.TOO_FEW_CYCLES
    slope, *_ = _straight_line(phasors[:used], middles[:used])
    return omega + slope.imag, max(-slope.real, 1e-6 * omega)


def _strong(phasors: Complex, noise: float) -> int:
    """Return the number of leading cycles whose amplitude is at least `SIGNAL_FACTOR` times `noise`.

    `noise` is the standard uncertainty of an amplitude. Cycles from the first weaker one on are too uncertain for a
    logarithm.
    """
    weak = np.flatnonzero(np.abs(phasors) < SIGNAL_FACTOR * noise)
    return int(weak[0]) if len(weak) else len(phasors)


def _straight_line(phasors: Complex, middles: Real) -> tuple[complex, Complex, Real]:
    """Fit a straight line over the time to the complex logarithm of the cycles' phasors (ln amplitude + i phase).

    The weights w are the squared amplitudes.

    Returns:
        (slope [1/s], residuals of the logarithms, w / Σ w (t − mean)²). For phasors at ω, the slope is −λ + i(ω_d − ω).
        The last result and the residuals give the variance of the slope.
    """
    weights = np.abs(phasors) ** 2
    logs = np.log(np.abs(phasors)) + 1j * np.unwrap(np.angle(phasors))
    time = middles - float(weights @ middles) / float(weights.sum())
    spread = float(weights @ time**2)
    slope = complex(np.sum(weights * time * logs)) / spread
    middle = complex(np.sum(weights * logs)) / float(weights.sum())
    return slope, logs - middle - slope * time, weights / spread


def _cycle_phasors(y: Real, rate_hz: float, omega: float) -> tuple[Complex, Real, float]:
    """Return the complex amplitudes (phasors) of the complete cycles of y at the angular frequency `omega` [rad/s].

    Returns:
        (phasors, times of the middles of their cycles [s], both of shape (cycles,), standard uncertainty of an
        amplitude).
    """
    period = 2.0 * math.pi * rate_hz / omega
    edges = np.ceil(np.arange(int(len(y) / period) + 1) * period).astype(np.int64)
    samples = np.diff(edges)
    place = np.arange(int(samples.max()))
    inside = place < samples[:, None]
    index = np.minimum(edges[:-1, None] + place, len(y) - 1)
    angle = omega / rate_hz * index
    ramp = 2.0 * place / samples[:, None] - 1.0  # the decay within the cycle, to first order
    cosine, sine = np.cos(angle), np.sin(angle)
    columns = [np.ones_like(angle), cosine, sine, ramp * cosine, ramp * sine]
    if period >= MIN_SAMPLES_FOR_HARMONICS:  # a curved sensor adds them, and they would affect the ramps
        columns += [f(h * angle) for h in (2, 3) for f in (np.cos, np.sin)]
    design = np.stack(columns, axis=2) * inside[:, :, None]
    part = y[index] * inside
    transposed = np.swapaxes(design, 1, 2)
    solution = np.linalg.solve(transposed @ design, transposed @ part[:, :, None])
    residual = part - (design @ solution)[:, :, 0]
    freedom = max(int(np.sum(samples - design.shape[2])), 1)
    noise = math.sqrt(2.0 * float(np.sum(residual**2)) / freedom / period)
    phasors = np.asarray(solution[:, 1, 0] - 1j * solution[:, 2, 0], dtype=np.complex128)
    return phasors, (edges[1:] + edges[:-1] - 1) / 2.0 / rate_hz, noise


def _design(time: Real, omega: float, decay: float) -> tuple[Real, Complex]:
    envelope = np.exp((-decay + 1j * omega) * time)
    return np.column_stack([np.ones_like(time), time, envelope.real, envelope.imag]), envelope


def _result(
    residual: Real, rate_hz: float, omega: float, decay: float, normal: Real, linear: Real, u_clock: float, scale: float
) -> Decay:
    natural = math.hypot(omega, decay)
    zeta = decay / natural
    density = noise_density(residual, omega / (2.0 * math.pi), rate_hz) * len(residual) / (len(residual) - 6)
    covariance = density * normal[4:, 4:]
    to_natural = np.array([decay, omega]) / natural
    to_zeta = np.array([omega**2, -decay * omega]) / natural**3
    amplitude = math.hypot(float(linear[2]), float(linear[3]))
    if zeta <= 0.0 or amplitude == 0.0:
        return Decay(status=Status.NO_FIT)
    u_natural = math.sqrt(to_natural @ covariance @ to_natural) / (2.0 * math.pi)
    return Decay(
        status=Status.OK,
        natural_frequency_hz=natural / (2.0 * math.pi),
        damping_ratio=zeta,
        u_natural_frequency_hz=math.hypot(u_natural, natural / (2.0 * math.pi) * u_clock),
        u_damping_ratio=math.sqrt(to_zeta @ covariance @ to_zeta),
        amplitude=scale * amplitude,
        cycles=int(len(residual) / rate_hz * omega / (2.0 * math.pi)),
    )


_NUMBER = r"[0-9.eE+-]{1,32}"
_PATTERN = re.compile(rf"\s*drop\s+h0_m\s*=\s*(?P<h0>{_NUMBER})\s+h1_m\s*=\s*(?P<h1>{_NUMBER})\s*")


@attrs.frozen
class DropHeights:
    """Heights of one drop above the barrier [m]: `h0_m` at the release, `h1_m` after the rebound."""

    h0_m: float
    h1_m: float

    def text(self) -> str:
        """Return the remark that states this drop on the topic `notes`; `parse_drop` reads it back exactly."""
        return f"drop h0_m={self.h0_m!r} h1_m={self.h1_m!r}"


def parse_drop(remark: str) -> DropHeights | None:
    """Return the heights in a remark like `drop h0_m=0.2 h1_m=0.0245`; None for any other remark."""
    match = _PATTERN.fullmatch(remark)
    if match is None:
        return None
    try:
        return DropHeights(float(match["h0"]), float(match["h1"]))
    except ValueError:
        return None


@attrs.frozen(kw_only=True)
class DropTest:
    """Mean coefficient of restitution of `drops` drops, with its standard uncertainty.

    Both are NaN if `status` is not `ok`, because of an invalid height or uncertainty. The uncertainty is also NaN for a
    single drop whose heights have no uncertainty.
    """

    status: Status
    restitution: float = math.nan
    u_restitution: float = math.nan
    drops: int = 0


def restitution_of_drops(h0_m: Real, h1_m: Real, u_h0_m: float, u_h1_m: float) -> DropTest:
    """Return the mean coefficient of restitution e of repeated drops, with its standard uncertainty.

    The errors of the heights are independent from drop to drop. If the values of e scatter more than these errors
    explain, the uncertainty is that of the scatter. It is NaN if the heights have no uncertainty and e does not
    scatter, as for a single drop.

    Args:
        h0_m: heights of the releases [m], shape (n,).
        h1_m: heights of the rebounds [m], shape (n,).
        u_h0_m: standard uncertainty of each height of release [m].
        u_h1_m: standard uncertainty of each height of rebound [m].

    Returns:
        The result, with the status `ok`. The status is `not_finite` if a value is not finite. It is `no_fit` if a
        height is not positive, an uncertainty negative, or a rebound higher than its drop by more than three standard
        uncertainties.

    Raises:
        ValueError: the arrays of heights are empty, not one-dimensional, or of different length.
    """
    if h0_m.shape != h1_m.shape or h0_m.ndim != 1 or not len(h0_m):
        raise ValueError(
            "heights of drops h0_m and of rebounds h1_m must be one-dimensional, not empty and of equal length, got "
            f"{h0_m.shape} and {h1_m.shape}"
        )
    if not (np.all(np.isfinite(h0_m)) and np.all(np.isfinite(h1_m)) and math.isfinite(u_h0_m + u_h1_m)):
        return DropTest(status=Status.NOT_FINITE)
    higher = h1_m - h0_m > 3.0 * math.hypot(u_h0_m, u_h1_m)
    if min(u_h0_m, u_h1_m) < 0.0 or np.any(h0_m <= 0.0) or np.any(h1_m <= 0.0) or np.any(higher):
        return DropTest(status=Status.NO_FIT)
    each = np.sqrt(h1_m / h0_m)
    n = len(each)
    explained = float(np.sum(each**2 * ((u_h1_m / h1_m) ** 2 + (u_h0_m / h0_m) ** 2) / 4.0)) / n**2
    scatter = float(np.var(each, ddof=1)) / n if n > 1 else 0.0
    u = math.sqrt(max(explained, scatter)) or math.nan
    return DropTest(status=Status.OK, restitution=float(each.mean()), u_restitution=u, drops=n)
