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
"""Model of a sensor: a transfer function, a calibration with tolerances, a range, and noise.

**Transfer functions** consist of poles, zeros and gain, and are simulated as partial fractions Σ r_k / (s − λ_k). Every
mode is one complex number that follows ψ' = λ_k ψ + S exactly, with S the sensor's input, however that input is cut
into pieces (see `response`). So there is no discretised filter and no sampling rate here: a 25 kHz resonance is the
same at 1 kS/s and at 250 kS/s.

Poles, zeros and residues have 70 digits and are rounded once, at the end, so every machine gets the same values.

    r_k = gain Π_j (λ_k − zero_j) / Π_{j≠k} (λ_k − λ_j) at distinct poles
    Butterworth: λ_k = ω e^{jπ(2k + n + 1)/2n}, k = 0 … n − 1, gain = ω^n
    resonance: λ = −ω/(2 quality) ± j ω √(1 − 1/(4 quality²)), gain = ω²
"""

from __future__ import annotations

import functools
import math
from decimal import Decimal

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.precise import ONE, TWO, ZERO, Complex, modulus, pi, product, unit, with_70_digits
from impact_rig.config.fields import choice, integer, quantity, switch

ADC_RANGES_V = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)  # input ranges of the board [± V]


@attrs.frozen(kw_only=True)
class Adc:
    """Multiplexed converter of the DAQ board (NI USB-6251 class)."""

    bits: int = integer(16, "bit", "Resolution.", at_least=8, at_most=24)
    noise_v_rms: float = quantity(
        280e-6, "V", "Noise with the range ± 10 V, rms; proportional to the range.", at_least=0, at_most=0.1
    )
    gain_tolerance: float = quantity(60e-6, "-", "Limit of the relative gain error.", at_least=0, below=1)
    offset_tolerance: float = quantity(
        20e-6, "-", "Limit of the offset, relative to the input range.", at_least=0, below=1
    )
    multiplexed: bool = switch(True, "One converter for all channels: these are converted one after another.")
    conversion_ns: int = integer(
        11_000,
        "ns",
        "Time from one channel's conversion to the next; at most the scan period over the number of channels.",
        at_least=1,
        at_most=10_000_000,
    )
    aggregate_limit_hz: float = quantity(1e6, "Hz", "Conversions per second, all channels together.", above=0)
    anti_alias: str = choice(
        "none", ("none", "butterworth"), "Anti-alias filter ahead of the converter.", switched={False: "none"}
    )
    anti_alias_hz: float = quantity(4e3, "Hz", "Corner of that filter; useful only below half the scan rate.", above=0)
    anti_alias_order: int = integer(4, "-", "Order of that filter.", at_least=1, at_most=8)


_DISTINCT = Decimal("1e-5")
"""Least relative distance of two poles of a sensor: closer ones are moved apart, because partial fractions need
distinct poles.
"""


@attrs.frozen(eq=False)
class SensorModes:
    """Transfer function of a sensor as partial fractions: the output is Σ Re(residue ψ), with ψ' = pole ψ + input.

    Each pole has its own ψ. The transfer function must be strictly proper: it has more poles than zeros.

    Attributes:
        poles: complex, shape (k,) [rad/s]; one of each conjugate pair, that with the imaginary part >= 0.
        residues: complex, shape (k,) [1/s]; doubled where a pole stands for a pair.
    """

    poles: NDArray[np.complex128]
    residues: NDArray[np.complex128]

    def same_as(self, other: SensorModes) -> bool:
        """Return whether both have the same poles and residues, bit for bit."""
        return np.array_equal(self.poles, other.poles) and np.array_equal(self.residues, other.residues)


@attrs.frozen
class Transfer:
    """Transfer function H(s) = gain Π(s − zero) / Π(s − pole); the product of two is the cascade of both filters.

    Attributes:
        zeros: numbers of 70 digits [rad/s].
        poles: numbers of 70 digits, both of a conjugate pair [rad/s].
        gain: leading coefficient.
    """

    zeros: tuple[Complex, ...]
    poles: tuple[Complex, ...]
    gain: Decimal

    @with_70_digits
    def __mul__(self, other: Transfer) -> Transfer:
        return Transfer(self.zeros + other.zeros, self.poles + other.poles, self.gain * other.gain)

    def response(self, frequency_hz: NDArray[np.float64] | float) -> NDArray[np.complex128]:
        """Return the frequency response H(j 2π f), in the shape of the frequencies."""
        s = 2j * np.pi * np.asarray(frequency_hz, dtype=np.float64)[..., None]
        above, below = (np.array([complex(place) for place in places]) for places in (self.zeros, self.poles))
        ratio = float(self.gain) * np.prod(s - above, axis=-1) / np.prod(s - below, axis=-1)
        return np.asarray(ratio, dtype=np.complex128)

    @with_70_digits
    def delay_s(self) -> float:
        """Return the delay at low frequency [s], −Σ Re(1/p) over the poles p.

        The result is correct only for a low-pass without zeros. This is not checked.
        """
        return float(sum((-pole.real / pole.square() for pole in self.poles), ZERO))

    def modes(self) -> SensorModes:
        """Return the partial fractions of the transfer function.

        Poles that are equal or nearly equal are moved apart. There must be more poles than zeros, which is not checked.
        """
        return _modes(self)


@functools.lru_cache(maxsize=64)  # a change that keeps a sensor's dynamics recomputes nothing
@with_70_digits
def _modes(transfer: Transfer) -> SensorModes:
    upper = _distinct(transfer.poles)
    poles = [*upper, *(pole.conjugate() for pole in upper if pole.imag)]
    residues = []
    for k, pole in enumerate(upper):
        above = product(pole - zero for zero in transfer.zeros)
        below = product(pole - other for j, other in enumerate(poles) if j != k)
        weight = TWO if pole.imag else ONE  # the part of the conjugate is the conjugate of this part
        residues.append(Complex(weight * transfer.gain) * above / below)
    return SensorModes(np.array([complex(p) for p in upper]), np.array([complex(r) for r in residues]))


def _distinct(poles: tuple[Complex, ...]) -> list[Complex]:
    """Return the poles with imaginary part >= 0, moved apart where they are equal or nearly equal.

    Their relative distances are then at least `_DISTINCT`.
    """
    upper: list[Complex] = []
    for pole in poles:
        if pole.imag < 0:
            continue
        moved = pole
        while any(modulus(moved - other) < _DISTINCT * modulus(other) for other in upper):
            moved = moved * Complex(ONE + TWO * _DISTINCT)
        upper.append(moved)
    return upper


@functools.lru_cache
@with_70_digits
def lag(time_constant_s: float) -> Transfer:
    """Return the transfer function 1 / (1 + τ s) of a first-order lag, with τ = `time_constant_s` > 0."""
    rate = ONE / Decimal(time_constant_s)
    return Transfer((), (Complex(-rate),), rate)


@functools.lru_cache
@with_70_digits
def high_pass(corner_hz: float) -> Transfer:
    """Return the transfer function s / (s + ω) of a first-order high-pass, with ω = 2π `corner_hz`."""
    return Transfer((Complex(ZERO),), (Complex(-TWO * pi() * Decimal(corner_hz)),), ONE)


@functools.lru_cache
@with_70_digits
def butterworth(order: int, corner_hz: float) -> Transfer:
    """Return the transfer function of a Butterworth low-pass, order >= 1: gain 1 at 0 Hz, −3 dB at the corner."""
    omega = TWO * pi() * Decimal(corner_hz)
    upper = [unit(pi() * (2 * k + order + 1) / (2 * order)) for k in range(order // 2)]
    poles = [Complex(omega) * pole for one in upper for pole in (one, one.conjugate())]
    if order % 2:
        poles.append(Complex(-omega))
    return Transfer((), tuple(poles), omega**order)


@functools.lru_cache
@with_70_digits
def resonance(frequency_hz: float, quality: float) -> Transfer:
    """Return the transfer function ω² / (s² + s ω/quality + ω²) of a sensor with a mounted resonance, quality > 1/2.

    ω is 2π `frequency_hz`; far below it the gain is 1.
    """
    omega = TWO * pi() * Decimal(frequency_hz)
    damping = omega / (TWO * Decimal(quality))
    damped = (omega * omega - damping * damping).sqrt()
    pole = Complex(-damping, damped)
    return Transfer((), (pole, pole.conjugate()), omega * omega)


@attrs.frozen(eq=False, kw_only=True)
class Sensor:
    """Model of one sensor with its conditioning, up to the volts at the converter's input.

    Attributes:
        name: name of the channel.
        quantity: quantity of the motion that it senses, one of `physics.sampling.QUANTITIES`.
        unit: unit of that quantity.
        low_pass: all dynamics that limit its band from above, with unit gain at zero frequency.
        high_pass_hz: corner of the first-order high-pass that limits its band from below, 0 for none.
        lag_order: simple model by which an analysis corrects the effect of `low_pass` at the frequencies of the rig's
            motion: 1 first-order lag, 2 two-pole Butterworth, 0 pure delay.
        bandwidth_hz: −3 dB corner of the sensor, and of its noise.
        volt_per_unit: nominal sensitivity, signed [V/unit].
        offset_v: nominal output at zero [V].
        low: smallest output [unit]; below, the output clips.
        high: largest output [unit]; above, the output clips.
        gain_tolerance: limit of the relative error of the sensitivity.
        offset_tolerance: limit of the zero error [unit].
        linearity: limit of the departure from a straight line [unit].
        noise: rms within the bandwidth [unit].
        resolution: step of the sensor's own output, 0 for none [unit].
        adc_range_v: input range of the converter, either side of 0 V.
        inverted: whether it is wired the wrong way round, which the calibration does not show.
        starts_settled: whether it starts as if the motion's first value had been constant before; otherwise its
            dynamics start at zero.
    """

    name: str
    quantity: str
    unit: str
    low_pass: Transfer
    high_pass_hz: float = 0.0
    lag_order: int
    bandwidth_hz: float
    volt_per_unit: float
    offset_v: float = 0.0
    low: float
    high: float
    gain_tolerance: float
    offset_tolerance: float
    linearity: float = 0.0
    noise: float
    resolution: float = 0.0
    adc_range_v: float
    inverted: bool
    starts_settled: bool = True

    @property
    def transfer(self) -> Transfer:
        """Transfer function of all dynamics, low-pass and high-pass, without the sensitivity."""
        return self.low_pass * high_pass(self.high_pass_hz) if self.high_pass_hz else self.low_pass

    @property
    def half_range(self) -> float:
        """Half the distance from `low` to `high` [unit]."""
        return 0.5 * (self.high - self.low)

    @property
    def middle(self) -> float:
        """Middle between `low` and `high` [unit]."""
        return 0.5 * (self.high + self.low)

    def measuring_range(self) -> tuple[float, float]:
        """Return the nominal range (low, high) in which neither sensor nor converter clips [unit of the sensor]."""
        ends = [(volt - self.offset_v) / self.volt_per_unit for volt in (-self.adc_range_v, self.adc_range_v)]
        return max(min(ends), self.low), min(max(ends), self.high)

    def behind(self, adc: Adc) -> Sensor:
        """Return this sensor combined with the anti-alias filter of the board `adc`; unchanged if the board has none.

        The filter becomes part of the sensor's dynamics, so linearity error, resolution and range limits apply after
        the filter. The noise keeps its density up to the lower of the two corner frequencies.
        """
        if adc.anti_alias == "none":
            return self
        filtered = self.low_pass * butterworth(adc.anti_alias_order, adc.anti_alias_hz)
        # a delay is added to the sensor's own: only poles that clearly dominate still describe it
        dominates = self.low_pass.delay_s() > 0.7 * filtered.delay_s()
        return attrs.evolve(
            self,
            low_pass=filtered,
            lag_order=self.lag_order if dominates else 0,
            bandwidth_hz=min(self.bandwidth_hz, adc.anti_alias_hz),
            noise=self.noise * math.sqrt(min(1.0, adc.anti_alias_hz / self.bandwidth_hz)),
        )
