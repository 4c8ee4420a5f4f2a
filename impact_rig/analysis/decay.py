"""Free decay → natural frequency f_n and damping ratio ζ, by logarithmic decrement and by a fit of the whole record.

    y(t) = C + D t + e^{−λt} (A cos ω_d t + B sin ω_d t),   λ = ζω_n,   ω_d = ω_n √(1 − ζ²)
    ω_n = √(ω_d² + λ²),   ζ = λ/ω_n;      decrement per cycle δ = 2πλ/ω_d,   ζ = δ/√(4π² + δ²)

Gain, offset, skew and lag of the sensor scale and shift the decay without changing either value, so the uncertainty is
that of the noise (density near ω_d, as in `sine`) and of the clock.
"""

from __future__ import annotations

import math

import attrs
import numpy as np

from impact_rig.analysis.calibration import Complex, Real
from impact_rig.analysis.sine import noise_density
from impact_rig.analysis.words import Status

MIN_CYCLES = 4.0
SIGNAL_FACTOR = 10.0
"""A cycle's amplitude in standard uncertainties from which its logarithm is used."""
ITERATIONS = 50
CONVERGED = 1e-10


@attrs.frozen(kw_only=True)
class Decay:
    """Result; NaN everywhere but in `status` where there is none. u_: standard uncertainties."""

    status: Status
    natural_frequency_hz: float = math.nan
    damping_ratio: float = math.nan
    u_natural_frequency_hz: float = math.nan
    u_damping_ratio: float = math.nan
    amplitude: float = math.nan
    cycles: int = 0


def fit_decay(y: Real, rate_hz: float, u_clock: float = 0.0) -> Decay:
    """Fit a free decay, from its first sample to its last.

    Args:
        y: displacement [any unit], shape (n,).
        rate_hz: samples per second.
        u_clock: relative standard uncertainty of the rate.
    """
    start = _start(y, rate_hz)
    if isinstance(start, Status):
        return Decay(status=start)
    omega, decay = start
    time = np.arange(len(y)) / rate_hz
    previous = math.inf
    for _ in range(ITERATIONS):
        design, envelope = _design(time, omega, decay)
        linear = np.asarray(np.linalg.lstsq(design, y, rcond=None)[0], dtype=np.float64)
        oscillation = linear[2] * envelope.real + linear[3] * envelope.imag
        across = linear[3] * envelope.real - linear[2] * envelope.imag
        full = np.column_stack([design, -time * oscillation, time * across])
        normal = np.asarray(np.linalg.pinv(full.T @ full), dtype=np.float64)
        change = normal @ (full.T @ (y - design @ linear))
        size = max(abs(change[4]), abs(change[5])) / omega
        decay, omega = decay + float(change[4]), omega + float(change[5])
        if not (omega > 0.0 and abs(decay) < omega) or not math.isfinite(omega):
            return Decay(status=Status.NO_FIT)
        if size < CONVERGED or (size < 1e-7 and size >= previous):  # the second: down to rounding
            return _result(y - design @ linear, rate_hz, omega, decay, normal, linear, u_clock)
        previous = size
    return Decay(status=Status.NO_FIT)


def log_decrement(y: Real, rate_hz: float, u_clock: float = 0.0) -> Decay:
    """Return f_n and ζ from the amplitudes of successive cycles: slope of their logarithm and of their phase.

    Amplitude and phase of each cycle come from a fit over that cycle, with weights as their squared amplitudes; the
    uncertainties come from the scatter about the straight lines.

    Args:
        y: displacement, shape (n,).
        rate_hz: samples per second.
        u_clock: relative standard uncertainty of the rate.
    """
    start = _start(y, rate_hz)
    if isinstance(start, Status):
        return Decay(status=start)
    omega, _ = start
    phasors, middles, noise = _cycle_phasors(y, rate_hz, omega)
    amplitude = np.abs(phasors)
    weak = np.flatnonzero(amplitude < SIGNAL_FACTOR * noise)
    used = int(weak[0]) if len(weak) else len(phasors)
    if used < MIN_CYCLES:
        return Decay(status=Status.TOO_FEW_CYCLES)
    weights = amplitude[:used] ** 2
    logs = np.log(amplitude[:used]) + 1j * np.unwrap(np.angle(phasors[:used]))
    time = middles[:used] - float(weights @ middles[:used]) / float(weights.sum())
    spread = float(weights @ time**2)
    slope = complex(np.sum(weights * time * logs)) / spread
    middle = complex(np.sum(weights * logs)) / float(weights.sum())
    left = logs - middle - slope * time
    u_decay = math.sqrt(float(weights @ left.real**2) / (used - 2) / spread)
    u_turn = math.sqrt(float(weights @ left.imag**2) / (used - 2) / spread)
    true_omega = omega + slope.imag
    cycle = 2.0 * math.pi / true_omega
    decrement = -slope.real * cycle
    root = math.sqrt(4.0 * math.pi**2 + decrement**2)
    natural = math.hypot(true_omega, slope.real) / (2.0 * math.pi)
    return Decay(
        status=Status.OK if decrement > 0.0 else Status.NO_FIT,
        natural_frequency_hz=natural,
        damping_ratio=decrement / root,
        u_natural_frequency_hz=math.hypot(u_turn / (2.0 * math.pi), natural * u_clock),
        u_damping_ratio=u_decay * cycle * 4.0 * math.pi**2 / root**3,
        amplitude=float(amplitude[0]),
        cycles=used,
    )


def _start(y: Real, rate_hz: float) -> tuple[float, float] | Status:
    """Return first guesses of ω_d [rad/s] and λ [1/s], or why there are none."""
    if not np.all(np.isfinite(y)):
        return Status.NOT_FINITE
    if len(y) < 32:
        return Status.TOO_FEW_CYCLES
    if np.ptp(y) == 0.0:
        return Status.CONSTANT
    line = np.polyfit(np.arange(len(y)), y, 1)
    level = y - np.polyval(line, np.arange(len(y)))
    padded = 4 * len(y)
    power = np.abs(np.fft.rfft(level * np.hanning(len(y)), padded)) ** 2
    peak = int(np.argmax(power[1:-1])) + 1
    if peak * len(y) / padded < MIN_CYCLES:
        return Status.TOO_FEW_CYCLES
    if power[peak] < 20.0 * np.median(power[1:-1]) * math.log(len(power)):
        return Status.SILENCE  # no line stands out of the noise
    omega = 2.0 * math.pi * peak * rate_hz / padded
    phasors, _, noise = _cycle_phasors(level, rate_hz, omega)
    strong = phasors[: max(2, int(np.argmax(np.append(np.abs(phasors) < 5.0 * noise, True))))]
    third = max(1, len(strong) // 3)
    early, late = np.abs(strong[:third]).mean(), np.abs(strong[-third:]).mean()
    period = 2.0 * math.pi / omega
    decay = math.log(early / late) / ((len(strong) - third) * period) if late > 0.0 and len(strong) > third else 0.0
    return omega, max(decay, 1e-6 * omega)


def _cycle_phasors(y: Real, rate_hz: float, omega: float) -> tuple[Complex, Real, float]:
    """Return every whole cycle's phasor at ω, its middle [s], both of shape (cycles,), and u of the amplitudes."""
    period = 2.0 * math.pi * rate_hz / omega
    edges = np.ceil(np.arange(int(len(y) / period) + 1) * period).astype(np.int64)
    phasors = np.empty(len(edges) - 1, dtype=np.complex128)
    left, freedom = 0.0, 0
    for k in range(len(phasors)):
        angle = omega / rate_hz * np.arange(edges[k], edges[k + 1])
        ramp = np.linspace(-1.0, 1.0, len(angle))
        design = np.stack(
            [np.ones_like(angle), np.cos(angle), np.sin(angle), ramp * np.cos(angle), ramp * np.sin(angle)]
        )
        part = y[edges[k] : edges[k + 1]]
        solution = np.linalg.solve(design @ design.T, design @ part)
        residual = part - solution @ design
        phasors[k] = solution[1] - 1j * solution[2]
        left += float(residual @ residual)
        freedom += len(part) - 5
    return phasors, (edges[1:] + edges[:-1] - 1) / 2.0 / rate_hz, math.sqrt(2.0 * left / max(freedom, 1) / period)


def _design(time: Real, omega: float, decay: float) -> tuple[Real, Complex]:
    envelope = np.exp((-decay + 1j * omega) * time)
    return np.column_stack([np.ones_like(time), time, envelope.real, envelope.imag]), envelope


def _result(
    residual: Real, rate_hz: float, omega: float, decay: float, normal: Real, linear: Real, u_clock: float
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
        amplitude=amplitude,
        cycles=int(len(residual) / rate_hz * omega / (2.0 * math.pi)),
    )
