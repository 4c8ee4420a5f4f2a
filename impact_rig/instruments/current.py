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
"""Coil current monitor of the power amplifier.

If its signal is clear, this channel is the phase reference of the other channels. The dynamics of the monitor are a
first-order low-pass with a corner far above the drive frequency.
"""

from __future__ import annotations

import attrs

from impact_rig.arithmetic.elementary import TWO_PI
from impact_rig.config.fields import quantity, switch
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.sensor import Sensor, lag


@attrs.frozen(kw_only=True)
class Current(Instrument):
    """Settings of the coil current monitor of the power amplifier.

    If its signal is clear, this channel is the phase reference of the other channels.
    """

    name = "current"
    place = 3
    senses = "current"
    unit = "A"
    doc = "Coil current."

    sensitivity_a_v: float = quantity(5.0, "A/V", "Current per output voltage.", above=0)
    bandwidth_hz: float = quantity(20e3, "Hz", "Corner of its first-order low-pass.", above=0)
    noise_a_rms: float = quantity(2e-3, "A", "Noise, rms within its bandwidth.", at_least=0, at_most=1)
    saturation_v: float = quantity(10.0, "V", "Magnitude of the output at which it clips.", above=0)
    gain_tolerance: float = quantity(0.005, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_a: float = quantity(5e-3, "A", "Limit of the zero error.", at_least=0, at_most=1)
    inverted: bool = switch(False, "Whether the sign is inverted by mistake; the calibration does not show it.")
    adc_range_v: float = quantity(5.0, "V", "Input range of the converter: ± this voltage.", above=0)

    def sensor(self) -> Sensor:
        """Return the model of the coil current monitor, from the settings of `instruments.current`."""
        full = self.saturation_v * self.sensitivity_a_v
        return Sensor(
            name=self.name,
            quantity=self.senses,
            unit=self.unit,
            low_pass=lag(1.0 / (TWO_PI * self.bandwidth_hz)),
            lag_order=1,
            bandwidth_hz=self.bandwidth_hz,
            volt_per_unit=1.0 / self.sensitivity_a_v,
            low=-full,
            high=full,
            gain_tolerance=self.gain_tolerance,
            offset_tolerance=self.offset_tolerance_a,
            noise=self.noise_a_rms,
            adc_range_v=self.adc_range_v,
            inverted=self.inverted,
        )
