# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What every sensor is made of: a transfer function, a calibration with its tolerances, a range, noise."""

from __future__ import annotations

import math

import attrs

from impact_rig.instruments.adc import Adc
from impact_rig.instruments.transfer import Transfer, butterworth


@attrs.frozen(eq=False, kw_only=True)
class Sensor:
    """One sensor with its conditioning, up to the volts at the converter's input.

    Attributes:
        name: channel.
        quantity: the motion's quantity it senses.
        unit: its unit.
        low_pass: everything that limits its band from above, unit gain at zero frequency.
        high_pass: what limits it from below, or None.
        lag_order: 1 when it is a first-order lag in the rig's band, 0 when it is a delay.
        bandwidth_hz: −3 dB corner of the sensor, and of its noise.
        volt_per_unit: nominal sensitivity, with its sign [V/unit].
        offset_v: nominal output at zero [V].
        low: smallest value it can put out [unit].
        high: largest [unit].
        gain_tolerance: limit of the relative error of the sensitivity.
        offset_tolerance: limit of the zero error [unit].
        linearity: limit of the departure from a straight line [unit].
        noise: rms within the bandwidth [unit].
        resolution: step of its own output, 0 for none [unit].
        adc_range_v: input range of the converter, either side [V].
        inverted: wired the wrong way round.
        settled: whether it has watched the motion's first value for ever when the rig starts, or zero.
    """

    name: str
    quantity: str
    unit: str
    low_pass: Transfer
    high_pass: Transfer | None = None
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
    settled: bool = True

    @property
    def transfer(self) -> Transfer:
        """The whole chain."""
        return self.low_pass if self.high_pass is None else self.low_pass * self.high_pass

    @property
    def half_range(self) -> float:
        """Half of the measuring range [unit]."""
        return 0.5 * (self.high - self.low)

    @property
    def middle(self) -> float:
        """Middle of the measuring range [unit]."""
        return 0.5 * (self.high + self.low)

    def converter_range(self) -> tuple[float, float]:
        """Return what the converter's input range means in the sensor's unit: (low, high)."""
        ends = [(volt - self.offset_v) / self.volt_per_unit for volt in (-self.adc_range_v, self.adc_range_v)]
        return min(ends), max(ends)

    def measuring_range(self) -> tuple[float, float]:
        """Return the range in which neither sensor nor converter clips: (low, high) [unit]."""
        low, high = self.converter_range()
        return max(low, self.low), min(high, self.high)

    def behind(self, adc: Adc) -> Sensor:
        """Return the sensor with the board's anti-alias filter behind it, if there is one."""
        if adc.anti_alias == "none":
            return self
        filtered = self.low_pass * butterworth(adc.anti_alias_order, adc.anti_alias_hz)
        # a delay comes on top of whatever the sensor is: only a lag that clearly dominates is still one
        dominant = self.lag_order == 1 and self.low_pass.delay_s() > 0.7 * filtered.delay_s()
        return attrs.evolve(
            self,
            low_pass=filtered,
            lag_order=1 if dominant else 0,
            bandwidth_hz=min(self.bandwidth_hz, adc.anti_alias_hz),
            noise=self.noise * math.sqrt(min(1.0, adc.anti_alias_hz / self.bandwidth_hz)),
        )
