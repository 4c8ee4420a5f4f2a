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
"""Calibration of the channels according to `daq/info`, and the correction of phasors with it.

A channel converts its value at a time `skew` after the scan clock, from a sensor with a lag. The measured phasor is

    Y(ω) = X(ω) · (iω)ⁿ · L(ω) · P(ω) · e^{iω·skew},    P = iω / (ω_h + iω)

X is the phasor of a displacement, also for a channel that measures velocity (n = 1) or acceleration (n = 2). P is the
high-pass of a sensor that does not measure down to 0 Hz, with its corner ω_h; P is 1 for all others.

`lag` is the sensor's group delay at low frequency; `lag_order` names its model:

    0    pure delay, for unknown poles                           L = e^{−iω·lag}
    1    first order with the time constant lag                  L = 1 / (1 + iω·lag)
    2    two-pole Butterworth of that group delay                L = 1 / (1 + i√2 Ω − Ω²),  Ω = ω·lag/√2

`linearity` L bounds a smooth curve L (c_2 P_2(u) + c_3 P_3(u)) with Legendre polynomials of the position u = −1 … 1 in
the range of half width R. The pair (c_2, c_3) is uniform in |c_2| + |c_3| <= 1, so that u(c_3) = 1/√6. For a sine of
amplitude a·R about mid-range, the gain changes by c_3 (L/R) (1.875 a² − 1.5), the first harmonic of P_3.

A reading has been rounded twice: to steps r of the sensor's output, after its noise σ_r, and to steps q of the
converter, after its own noise σ_q. The error of rounding is a sum of sines of the value. For a sine of amplitude A
about d, each of them has the first harmonic 2 J_1 (W. R. Bennett 1948, Bell Syst. Tech. J. 27, 446–472; N. M. Blachman
1985, IEEE Trans. ASSP 33, 1417–1426), which noise reduces (B. Widrow & I. Kollár 2008, Quantization Noise, ch. 4). With
a = 2π (k/q + l/r) and the remainder of the first rounding,

    ∆A = Σ 2 c_kl J_1(aA) cos(ad + φ_kl),   c_kl = q/(πk) |sinc(kr/q + l)| e^{−a²σ_r²/2 − 2π²k²σ_q²/q²},   k = 1, 2, …
                                            c_0l = r/(πl) e^{−2π²l²σ_r²/r²},                                l = 1, 2, …

The position of the sine between the steps is unknown, so u²(A) = Σ 2 c² J_1², with the largest J_1² within A ± 2u. Such
an error is bounded by 2u and the same in all cycles, so averaging does not reduce it. It is in phase with the sine and
does not change the phase, unless overtones move the sine across other steps.

Readings of other programs also have steps, but are not necessarily rounded to the nearest one. A program that truncates
towards zero subtracts half a step times sign(sine), whose first harmonic is 2q/π. Therefore, if a certificate gives one
`resolution` for all steps of a channel, u²(A) also contains (2q/π)²/3: uniform between ± 2q/π.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.scans import ACCELEROMETER, CHANNELS, CURRENT, PUBLISHER_REMEDY
from impact_rig.blocks import MOST_HZ
from impact_rig.errors import ConfigError

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


LAG_MODELS: dict[int, Callable[[Real], NDArray[np.complexfloating]]] = {
    0: lambda omega_lag: np.exp(-1j * omega_lag),
    1: lambda omega_lag: 1.0 / (1.0 + 1j * omega_lag),
    2: lambda omega_lag: 1.0 / (1.0 + 1j * omega_lag - omega_lag**2 / 2.0),
}
"""Frequency response L of a sensor with a lag, as a function of ω·lag, by the `lag_order` in `daq/info`.

The two poles of order 2 are a pure delay to second order in ω·lag.
"""

DERIVATIVES = {b"m": 0, b"m/s": 1, b"m/s^2": 2}  # n of a channel by its unit in `daq/info`

J_1_MOST, J_1_TAIL = 0.5819, 0.684  # largest J_1(x), and largest x J_1²(x)
J_1_NODES = 64
ACROSS = np.linspace(-1.0, 1.0, 9)


def bessel_j_1(x: Real) -> Real:
    """Return the Bessel function J_1 of each element of `x`.

    The method is the mean of cos(θ − x sin θ) over θ. The error is below 1e-12 for |x| <= J_1_NODES / 2.
    `scipy.special.j1` is not used because its import takes 60 MB of memory.
    """
    angle = 2.0 * np.pi * np.arange(J_1_NODES) / J_1_NODES
    return np.asarray(np.cos(angle - x[..., None] * np.sin(angle)).mean(axis=-1))


U_CUBIC = 1.0 / math.sqrt(6.0)  # standard uncertainty of the share c of the cubic in a sensor's curve

TWO_POLE_NOISE = 1.11  # noise bandwidth of a Butterworth two-pole filter relative to its corner

STEPS = ("output_step", "output_noise", "converter_step", "converter_noise")
U_TRUNCATED = 2.0 / math.pi / math.sqrt(3.0)  # standard uncertainty in steps if the rounding rule is unknown
TERMS = 12  # of the sum over the harmonics of a step, which fall with their cube where no noise reduces them

COLUMNS = (
    "range_low", "range_high", "resolution", "noise", "sensitivity_uncertainty", "lag", "skew", "lag_order",
    "bandwidth", "linearity", *STEPS, "high_pass",
)  # fmt: skip
LARGEST = 1e100  # limit of every figure, so that its square does not overflow


@attrs.frozen(eq=False)
class Calibration:
    """Calibration of the channels: one array per column of `daq/info`, in the order of `scans.CHANNELS`.

    A channel that `daq/info` does not list is not `present`. Its range is infinite, and its other figures are zero.
    """

    rate_hz: float  # scans per second; an int if it is an integer
    low: Real  # lower end of the range [SI unit of the channel]; high: upper end
    high: Real
    resolution: Real  # 1 LSB [unit]; 0 where unknown
    noise: Real  # rms [unit]
    gain_uncertainty: Real  # relative standard uncertainty of the sensitivity
    lag: Real  # group delay at low frequency [s]
    skew: Real  # conversion time after the scan clock [s]
    lag_order: Real  # key into `LAG_MODELS`
    bandwidth: Real  # corner of the sensor and its noise [Hz]; 0 where unknown
    linearity: Real  # limit of the departure from a straight line [unit]
    output_step: Real  # step of the sensor's output [unit], 0 for none; output_noise: rms before it
    output_noise: Real
    converter_step: Real  # step of the converter [unit]; converter_noise: rms before it
    converter_noise: Real
    high_pass: Real  # corner of a first-order high-pass [Hz]; 0 for none
    truncates: NDArray[np.bool_] = attrs.field(factory=lambda: np.zeros(len(CHANNELS), np.bool_), kw_only=True)
    """Mask of the channels whose converter may truncate instead of round.

    That is unknown for a channel whose certificate gives one `resolution` for all its steps.
    """
    present: NDArray[np.bool_] = attrs.field(factory=lambda: np.ones(len(CHANNELS), np.bool_), kw_only=True)  # measured
    derivative: NDArray[np.int64] = attrs.field(factory=lambda: np.zeros(len(CHANNELS), np.int64), kw_only=True)
    """Derivative n of the displacement that each channel measures: 0 displacement, 1 velocity, 2 acceleration.

    It is 0 for accelerometer and current, whose phasors are not converted to displacements.
    """

    @classmethod
    def from_info(cls, rows: NDArray[np.void]) -> Calibration:
        """Return the calibration in the rows of a `daq/info` table, in any order.

        A channel without a row is not `present`. NaN (unknown) becomes 0, but is an error in rate, range and lag order.

        Raises:
            ConfigError: no row is of a known channel, or a known channel has several rows. The rates differ, are not
                positive or are too high. A range is empty, a lag order is unknown, or a finite figure is beyond
                ±`LARGEST`.
        """
        names = [bytes(name).decode(errors="replace") for name in rows["name"]]
        counts = np.array([names.count(channel) for channel in CHANNELS])
        if counts.max() != 1:
            raise ConfigError(
                f"daq/info must list one or more of the channels {', '.join(CHANNELS)}, each once, and may list "
                f"others, got {', '.join(names) or 'no rows'}; {PUBLISHER_REMEDY}"
            )
        present = counts == 1
        measured = [names.index(channel) for channel in CHANNELS if channel in names]
        ordered = np.zeros(len(CHANNELS), rows.dtype)
        ordered["rate"], ordered["range_low"], ordered["range_high"] = rows["rate"][measured[0]], -math.inf, math.inf
        ordered[present] = rows[measured]
        rate = float(ordered["rate"][0])
        if not (np.all(ordered["rate"] == rate) and 0 < rate <= MOST_HZ):
            rule = "the same for all channels" if 0 < rate <= MOST_HZ else f"> 0 and <= {MOST_HZ:g} Hz"
            raise ConfigError(
                f"daq/info: rate must be {rule}, got {_by_channel(ordered['rate'], present)} Hz; {PUBLISHER_REMEDY}"
            )
        empty = ~(ordered["range_low"] < ordered["range_high"])
        if np.any(empty):
            raise ConfigError(
                f"daq/info: range_low must be < range_high, got range_low {_by_channel(ordered['range_low'], empty)} "
                f"and range_high {_by_channel(ordered['range_high'], empty)}; {PUBLISHER_REMEDY}"
            )
        unknown = ~np.isin(ordered["lag_order"], list(LAG_MODELS))
        if np.any(unknown):
            raise ConfigError(
                f"daq/info: lag_order must be one of 0, 1, 2, got {_by_channel(ordered['lag_order'], unknown)}; "
                f"{PUBLISHER_REMEDY}"
            )
        known = {name: ordered[name] for name in COLUMNS if name in (ordered.dtype.names or ())}
        is_own = bool(set(STEPS) - set(known))  # written by this package before it had these columns: its steps round
        none = np.zeros(len(CHANNELS))
        steps = np.array([known.get(name, none) for name in STEPS])
        untold = ~steps.any(axis=0)  # if the certificate does not separate the steps: one step, after all the noise
        known |= dict(
            zip(STEPS, np.where(untold, [none, known["noise"], known["resolution"], none], steps), strict=True)
        )
        for name, values in known.items():
            sizes = np.abs(values)
            large = (sizes > LARGEST) & np.isfinite(sizes)
            if np.any(large):
                raise ConfigError(
                    f"daq/info: {name} must be within ±{LARGEST:g}, infinite, or NaN if unknown, got "
                    f"{_by_channel(values, large)}; {PUBLISHER_REMEDY}"
                )
        figures = [_finite(known[name]) for name in COLUMNS]
        derivative = np.array([DERIVATIVES.get(bytes(unit), 0) for unit in ordered["unit"]])
        derivative[[ACCELEROMETER, CURRENT]] = 0
        whole = round(rate)
        return cls(
            whole if whole == rate else rate,
            *figures,
            truncates=np.asarray(untold & (not is_own)),
            present=present,
            derivative=derivative,
        )

    @functools.cached_property
    def absent(self) -> tuple[str, ...]:
        """Names of the channels of `scans.CHANNELS` that `daq/info` does not list, so they are not measured."""
        return tuple(name for name, there in zip(CHANNELS, self.present.tolist(), strict=True) if not there)

    def response(self, channel: int, frequency_hz: Real | float) -> Complex:
        """Return the complex frequency response of a channel, (iω)ⁿ·L(ω)·P(ω)·e^{iω·skew}.

        The result has the shape of `frequency_hz`. Divide a measured phasor by the response to correct the phasor. L is
        the sensor's lag and P its high-pass (module docstring).

        For laser and base, the response is the measured phasor [unit of the channel] divided by the phasor of the
        displacement [m]. The exponent n is 1 for a channel that measures velocity, 2 for acceleration, and otherwise 0.
        For accelerometer and current, n is 0, and the response is the measured phasor divided by the true phasor.
        """
        omega = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
        lag = LAG_MODELS[int(self.lag_order[channel])](omega * self.lag[channel])
        response = np.asarray(lag * np.exp(1j * omega * self.skew[channel]), dtype=np.complex128)
        corner = 2.0 * np.pi * float(self.high_pass[channel])
        if corner:
            response = response * (1j * omega / (corner + 1j * omega))
        order = int(self.derivative[channel])
        return response * (1j * omega) ** order if order else response

    def scale(self, channel: int, frequency_hz: float) -> float:
        """Return the factor ωⁿ by which a channel's amplitude [its unit] is larger than that of the displacement [m].

        ω is 2π `frequency_hz`, and n is the channel's `derivative`: 0 for displacement, 1 for velocity, 2 for
        acceleration. For accelerometer and current the result is 1, because their readings are not converted to
        displacements.
        """
        return float((2.0 * math.pi * frequency_hz) ** int(self.derivative[channel]))

    def scales(self, frequency_hz: float) -> Real:
        """Return the factor ωⁿ of every channel (see `scale`), shape (4,)."""
        return np.array([self.scale(channel, frequency_hz) for channel in range(len(CHANNELS))])

    def gain_uncertainty_at(self, channel: int, amplitude: float) -> float:
        """Return the relative standard uncertainty of a channel's gain for a vibration about mid-range.

        `amplitude` is the amplitude of the vibration [unit of the channel]. The uncertainty depends on the amplitude
        because the sensor is not linear. The field `gain_uncertainty` applies to small vibrations. For an amplitude
        a·R, its term 1.5 u(c_3) L/R is replaced by (1.5 − 1.875 a²) u(c_3) L/R. R is half the range, L the `linearity`,
        and c_3 the unknown cubic share of the sensor's curve (module docstring).
        """
        half_range = float(self.high[channel] - self.low[channel]) / 2.0
        curve = float(self.linearity[channel]) / half_range * U_CUBIC
        small = float(self.gain_uncertainty[channel]) ** 2
        share = amplitude / half_range
        return math.sqrt(max(small - (1.5 * curve) ** 2, 0.0) + ((1.5 - 1.875 * share**2) * curve) ** 2)

    def curvature_uncertainty(self, channel: int, amplitude: float) -> float:
        """Return the uncertainty of the ratio of a channel's gains at two amplitudes, because the sensor is not linear.

        The ratio is the gain for a vibration of `amplitude` [unit of the channel] divided by the gain for a very small
        vibration. The result is a relative standard uncertainty.
        """
        half_range = float(self.high[channel] - self.low[channel]) / 2.0
        return float(self.linearity[channel]) / half_range * U_CUBIC * 1.875 * (amplitude / half_range) ** 2

    def steps_uncertainty(self, channel: int, amplitude: float) -> float:
        """Return the standard uncertainty of a measured amplitude due to the steps of sensor and converter.

        Result and `amplitude` are in the unit of the channel.
        """
        place, weight = self._roundings[channel]
        power = np.minimum(
            (place * amplitude) ** 2 / 4.0, np.minimum(J_1_MOST**2, J_1_TAIL / (place * amplitude + 1e-300))
        )
        u = math.sqrt(2.0 * float(weight**2 @ power))
        x = place[:, None] * np.maximum(amplitude + 2.0 * u * ACROSS, 0.0)
        known = x[:, -1] <= J_1_NODES / 2.0
        if known.any():
            power[known] = np.minimum(power[known], (bessel_j_1(x[known]) ** 2).max(axis=1))
        truncated = U_TRUNCATED * float(self.converter_step[channel]) if self.truncates[channel] else 0.0
        return math.hypot(math.sqrt(2.0 * float(weight**2 @ power)), truncated)

    def steps_variance(self, channel: int) -> float:
        """Return the variance [unit²] of the part of a channel's rounding error that noise does not average out.

        The variance is at most r²/12 + q²/12, where r is the step of the sensor and q the step of the converter.
        """
        return 0.5 * float(np.sum(self._roundings[channel][1] ** 2))

    @functools.cached_property
    def _roundings(self) -> list[tuple[Real, Real]]:
        return [self._rounding(channel) for channel in range(len(CHANNELS))]

    def _rounding(self, channel: int) -> tuple[Real, Real]:
        """Return the sines c sin(a·value) whose sum is the rounding error of a channel.

        The result is (a [1/unit], c [unit]), each of shape (n,). A channel without steps has n = 0.
        """
        r, q = float(self.output_step[channel]), float(self.converter_step[channel])
        blur_r, blur_q = float(self.output_noise[channel]), float(self.converter_noise[channel])
        order = np.arange(1.0, TERMS + 1.0)
        places: list[Real] = [np.zeros(0)]
        weights: list[Real] = [np.zeros(0)]
        if r > 0.0:
            places.append(2.0 * np.pi * order / r)
            weights.append(r / (np.pi * order) * np.exp(-0.5 * (places[-1] * blur_r) ** 2))
        if q > 0.0:
            k, near = order[:, None], np.arange(-TERMS, TERMS + 1.0)
            l = near - np.round(k * r / q) if r > 0.0 else np.zeros((TERMS, 1))  # noqa: E741  # as in the formula
            place = 2.0 * np.pi * (k / q + (l / r if r > 0.0 else 0.0))
            weight = q / (np.pi * k) * np.abs(np.sinc(k * r / q + l))
            places.append(np.abs(place).ravel())
            weights.append(
                (weight * np.exp(-0.5 * (place * blur_r) ** 2 - 2.0 * (np.pi * k * blur_q / q) ** 2)).ravel()
            )
        return np.concatenate(places), np.concatenate(weights)

    def noise_crowding(self) -> Real:
        """Return the noise power density of each channel at low frequencies, relative to white noise of the same rms.

        The shape is (4,). The result is 1 for noise that fills the band up to rate / 2. It is above 1 if the sensor
        limits the noise to a narrower band.
        """
        noise_band = TWO_POLE_NOISE * np.where(self.bandwidth > 0.0, self.bandwidth, np.inf)
        return np.asarray(np.maximum(1.0, self.rate_hz / (2.0 * noise_band)), dtype=np.float64)

    def lag_uncertainties(self, channel: int, frequency_hz: float, lag_uncertainty: float) -> tuple[float, float]:
        """Return the standard uncertainties of a channel's amplitude (relative) and phase [rad] due to its lag.

        `lag_uncertainty` is the relative standard uncertainty of the lag. If the lag is modelled as a pure delay
        (`lag_order` 0), the model omits the attenuation by the sensor's low-pass. The amplitude then has an additional
        uncertainty, unless `bandwidth` is 0 (unknown). The omitted attenuation is assumed to be uniformly distributed
        between 0 and 1 − 1/√(1 + (f/bandwidth)⁴), the value of a two-pole low-pass.
        """
        slope = self.lag_sensitivity(channel, frequency_hz) * lag_uncertainty
        left_out = 0.0
        if self.lag_order[channel] == 0 and self.bandwidth[channel] > 0.0:
            left_out = (1.0 - 1.0 / math.hypot(1.0, (frequency_hz / self.bandwidth[channel]) ** 2)) / math.sqrt(3.0)
        return math.hypot(slope.real, left_out), abs(slope.imag)

    def lag_sensitivity(self, channel: int, frequency_hz: float) -> complex:
        """Return d ln L / d ln lag, the relative change of the response L per relative change of the sensor's lag.

        L is the response in `LAG_MODELS` for the channel's `lag_order`. The real part of the result is the relative
        change of the amplitude. The imaginary part is the change of the phase [rad].
        """
        omega_lag = np.asarray(2.0 * np.pi * frequency_hz * self.lag[channel])
        model = LAG_MODELS[int(self.lag_order[channel])]
        step = 1e-6
        return complex(np.log(model(omega_lag * (1 + step)) / model(omega_lag * (1 - step))) / (2 * step))


def _by_channel(column: NDArray[np.float64], chosen: NDArray[np.bool_]) -> str:
    """Return the values of the chosen channels as text for an error message, each with the name of its channel."""
    found = zip(CHANNELS, column.tolist(), chosen.tolist(), strict=True)
    return ", ".join(f"{value!r} ({name})" for name, value, is_chosen in found if is_chosen)


def _finite(column: NDArray[np.float64]) -> Real:
    """Return a copy of a column of `daq/info` in which NaN (unknown) is replaced with 0; infinity is kept."""
    values = np.array(column, dtype=np.float64)
    values[np.isnan(values)] = 0.0
    return values
