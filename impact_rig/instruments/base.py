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
"""Displacement sensor on the inferior base: a two-pole filter, behind which the output is proportional to x_b."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from impact_rig.blocks import Column
from impact_rig.config.fields import quantity, switch
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.sensor import Sensor, butterworth
from impact_rig.topics import Qos, Topic


@attrs.frozen(kw_only=True)
class Base(Instrument):
    """Settings of the inductive displacement sensor on the inferior base (Dornier IWA NT25 class)."""

    name = "base"
    place = 2
    senses = "x_b"
    unit = "m"
    doc = "Displacement x_b of the inferior base."
    monitor = Topic(
        "base_displacement",
        "geometry_msgs/msg/Vector3Stamped",
        Qos.DATA,
        "rig",
        "Displacement of the inferior base (x) at monitor rate, low-passed.",
        (Column("vector.x", "m", "Displacement x_b of the inferior base; y = z = 0."),),
        frame_id="base_sensor",
    )

    half_range_m: float = quantity(12.5e-3, "m", "Half of the measuring range.", above=0, at_most=5)
    output_v: float = quantity(10.0, "V", "Magnitude of the output at either end of the range.", above=0)
    bandwidth_hz: float = quantity(1e3, "Hz", "Corner of its two-pole (Butterworth) filter.", above=0)
    noise_m_rms: float = quantity(1e-6, "m", "Noise, rms within its bandwidth.", at_least=0, at_most=1e-4)
    linearity: float = quantity(
        0.0025, "-", "Limit of the departure from a straight line, relative to half_range_m.", at_least=0
    )
    gain_tolerance: float = quantity(0.002, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_m: float = quantity(10e-6, "m", "Limit of the zero error.", at_least=0, at_most=1e-3)
    inverted: bool = switch(False, "Whether the sign is inverted by mistake; the calibration does not show it.")
    adc_range_v: float = quantity(10.0, "V", "Input range of the converter: ± this voltage.", above=0)

    def sensor(self) -> Sensor:
        """Return the model of the inferior base's displacement sensor, from the settings of `instruments.base`."""
        return Sensor(
            name=self.name,
            quantity=self.senses,
            unit=self.unit,
            low_pass=butterworth(2, self.bandwidth_hz),
            lag_order=2,
            bandwidth_hz=self.bandwidth_hz,
            volt_per_unit=self.output_v / self.half_range_m,
            low=-self.half_range_m,
            high=self.half_range_m,
            gain_tolerance=self.gain_tolerance,
            offset_tolerance=self.offset_tolerance_m,
            linearity=self.linearity * self.half_range_m,
            noise=self.noise_m_rms,
            adc_range_v=self.adc_range_v,
            inverted=self.inverted,
        )

    def message(self, reading: float, clipped: bool, noise: float) -> Mapping[str, object]:  # noqa: ARG002
        """Return the fields of a Vector3Stamped message: `vector.x` is the displacement x_b of the inferior base [m].

        The message type has no field for clipping or noise, so `clipped` and `noise` are ignored.
        """
        return {"vector.x": reading}
