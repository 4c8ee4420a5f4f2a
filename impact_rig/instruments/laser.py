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
"""Laser displacement sensor on the superior base: a first-order lag, a digital output stage, and a limited range.

It measures the distance `distance_m` − x_1. Its output is `output_v` (1 − x_1/`half_range_m`) / 2, which is 0 V at the
near end of the range. The sensitivity to x_1 is therefore negative. Out of range, the output stays at the near or far
end of the range, and the status of the scan marks the channel.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import attrs

from impact_rig.arithmetic.elementary import TWO_PI
from impact_rig.blocks import Column
from impact_rig.config.fields import quantity, switch
from impact_rig.errors import ConfigError
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.sensor import Sensor, lag
from impact_rig.topics import Qos, Topic

CONE_RAD = 1e-3
INFRARED = 1  # `Range.INFRARED`


@attrs.frozen(kw_only=True)
class Laser(Instrument):
    """Settings of the laser displacement sensor on the superior base (Wenglor YP06MGVL80 class).

    Its output is 0 V at the near end of its range, where x_1 > 0.
    """

    name = "laser"
    place = 1
    senses = "x_1"
    unit = "m"
    doc = "Displacement x_1 of the superior base."
    monitor = Topic(
        "laser",
        "sensor_msgs/msg/Range",
        Qos.DATA,
        "rig",
        "Distance of the superior base, low-passed; -Inf or +Inf if out of range (REP-117).",
        (
            Column("range", "m", "instruments.laser.distance_m - x_1; -Inf: too near, +Inf: too far, or no reading."),
            Column("min_range", "m", "Near end of the measuring range."),
            Column("max_range", "m", "Far end of the measuring range."),
            Column("variance", "m^2", "Noise, squared."),
            Column("field_of_view", "rad", "Divergence of the beam."),
        ),
        frame_id="laser",
    )

    distance_m: float = quantity(50e-3, "m", "Distance to the superior base at x_1 = 0.", above=0, at_most=10)
    half_range_m: float = quantity(10e-3, "m", "Half of the measuring range.", above=0, at_most=5)
    output_v: float = quantity(10.0, "V", "Output at the far end of the range.", above=0)
    lag_s: float = quantity(0.7e-3, "s", "Time constant of its first-order lag.", above=0, at_most=0.1)
    resolution_m: float = quantity(8e-6, "m", "Step of its digital output stage.", at_least=0, at_most=1e-3)
    noise_m_rms: float = quantity(2e-6, "m", "Noise ahead of the digital output stage, rms.", at_least=0, at_most=1e-3)
    linearity_m: float = quantity(30e-6, "m", "Limit of the departure from a straight line.", at_least=0, at_most=1e-2)
    gain_tolerance: float = quantity(0.002, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_m: float = quantity(50e-6, "m", "Limit of the zero error.", at_least=0, at_most=1e-2)
    inverted: bool = switch(False, "Whether the sign is inverted by mistake; the calibration does not show it.")
    adc_range_v: float = quantity(10.0, "V", "Input range of the converter: ± this voltage.", above=0)

    def __attrs_post_init__(self) -> None:
        if self.half_range_m >= self.distance_m:
            raise ConfigError(f"half_range_m must be < distance_m = {self.distance_m:g} m, got {self.half_range_m:g} m")

    def sensor(self) -> Sensor:
        """Return the model of the laser displacement sensor, from the settings of `instruments.laser`."""
        return Sensor(
            name=self.name,
            quantity=self.senses,
            unit=self.unit,
            low_pass=lag(self.lag_s),
            lag_order=1,
            bandwidth_hz=1.0 / (TWO_PI * self.lag_s),
            volt_per_unit=-self.output_v / (2.0 * self.half_range_m),
            offset_v=0.5 * self.output_v,
            low=-self.half_range_m,
            high=self.half_range_m,
            gain_tolerance=self.gain_tolerance,
            offset_tolerance=self.offset_tolerance_m,
            linearity=self.linearity_m,
            noise=self.noise_m_rms,
            resolution=self.resolution_m,
            adc_range_v=self.adc_range_v,
            inverted=self.inverted,
        )

    def message(self, reading: float, clipped: bool, noise: float) -> Mapping[str, object]:
        """Return the fields of a `sensor_msgs/msg/Range` message for one reading of x_1 [m].

        The field `range` is the distance `distance_m` − x_1 [m]. If the reading is clipped or out of range, `range` is
        −Inf on the near side and +Inf on the far side (REP-117). The field `variance` is `noise` squared [m²].
        """
        nearest, farthest = self.distance_m - self.half_range_m, self.distance_m + self.half_range_m
        distance = self.distance_m - reading
        if clipped or not nearest <= distance <= farthest:
            distance = math.inf if distance > self.distance_m else -math.inf
        return {
            "radiation_type": INFRARED,
            "field_of_view": CONE_RAD,
            "min_range": nearest,
            "max_range": farthest,
            "range": distance,
            "variance": noise * noise,
        }
