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
"""Accelerometer on the superior base: a lightly damped resonance, and a charge amplifier with high-pass and low-pass.

    charge · amplifier · ω_n² / (s² + s ω_n/quality + ω_n²) · s / (s + ω_h) · Butterworth_n(ω_l)  [V per m/s²]

with the charge in C per m/s² and the amplifier in V/C; ω_n is the mounted resonance, ω_h and ω_l the corners of
high-pass and low-pass, n the order of the latter.

A contact of 40 µs excites the 25 kHz resonance as much as it moves the structure. So the pulse in the reading is longer
and lower than the real one, and the reading rings after it. The amplifier clips after its filters.
"""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from impact_rig.blocks import Column
from impact_rig.config.fields import integer, quantity, switch
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.sensor import Sensor, butterworth, resonance
from impact_rig.topics import Qos, Topic

STANDARD_GRAVITY = 9.80665
UNKNOWN_VARIANCE = 1e9  # variance of an axis without a sensor, (m/s²)²
NOT_MEASURED = -1.0  # REP-145: first element of the covariance of a quantity the device does not measure at all


@attrs.frozen(kw_only=True)
class Accelerometer(Instrument):
    """Settings of the piezoelectric accelerometer (Endevco 2226C class) on the superior base, and of its amplifier."""

    name = "accelerometer"
    place = 0
    senses = "a_1"
    unit = "m/s^2"
    doc = "Acceleration of the superior base."
    monitor = Topic(
        "accelerometer",
        "sensor_msgs/msg/Imu",
        Qos.DATA,
        "rig",
        "The accelerometer at monitor rate, low-passed (x; REP-145: other quantities are marked as not measured).",
        (
            Column("linear_acceleration.x", "m/s^2", "Acceleration of the superior base."),
            Column("linear_acceleration_covariance", "(m/s^2)^2", "x: noise, squared; y and z, not measured: 1e9."),
            Column("orientation_covariance", "-", "[0] = -1: not measured (REP-145)."),
            Column("angular_velocity_covariance", "-", "[0] = -1: not measured (REP-145)."),
        ),
        frame_id="superior_base",
    )

    sensitivity_pc_g: float = quantity(2.8, "pC/g", "Charge sensitivity.", above=0)
    amplifier_mv_pc: float = quantity(10.0, "mV/pC", "Gain of the charge amplifier.", above=0)
    resonance_hz: float = quantity(25e3, "Hz", "Mounted resonance.", above=0)
    quality: float = quantity(30.0, "-", "Quality factor of the resonance.", at_least=0.51, at_most=1000)
    high_pass_hz: float = quantity(1.0, "Hz", "High-pass of the charge amplifier, first order.", above=0)
    low_pass_hz: float = quantity(10e3, "Hz", "Low-pass of the charge amplifier, Butterworth.", above=0)
    low_pass_order: int = integer(2, "-", "Order of the low-pass.", at_least=1, at_most=8)
    noise_v_rms: float = quantity(
        0.14e-3, "V", "Noise at the amplifier's output, rms within its bandwidth: 5 mg.", at_least=0, at_most=0.1
    )
    saturation_v: float = quantity(10.0, "V", "Magnitude of the output at which the amplifier clips.", above=0)
    gain_tolerance: float = quantity(0.02, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_v: float = quantity(2e-3, "V", "Limit of the amplifier's offset.", at_least=0, at_most=1)
    inverted: bool = switch(False, "Whether the sign is inverted by mistake; the calibration does not show it.")
    adc_range_v: float = quantity(5.0, "V", "Input range of the converter: ± this voltage.", above=0)

    def sensor(self) -> Sensor:
        """Return the model of accelerometer and charge amplifier, from the settings of `instruments.accelerometer`."""
        volt_per_unit = self.sensitivity_pc_g * self.amplifier_mv_pc * 1e-3 / STANDARD_GRAVITY
        full = self.saturation_v / volt_per_unit
        return Sensor(
            name=self.name,
            quantity=self.senses,
            unit=self.unit,
            low_pass=resonance(self.resonance_hz, self.quality) * butterworth(self.low_pass_order, self.low_pass_hz),
            high_pass_hz=self.high_pass_hz,
            lag_order=0,
            bandwidth_hz=self.low_pass_hz,
            volt_per_unit=volt_per_unit,
            low=-full,
            high=full,
            gain_tolerance=self.gain_tolerance,
            offset_tolerance=self.offset_tolerance_v / volt_per_unit,
            noise=self.noise_v_rms / volt_per_unit,
            adc_range_v=self.adc_range_v,
            inverted=self.inverted,
            starts_settled=False,
        )

    def message(self, reading: float, clipped: bool, noise: float) -> Mapping[str, object]:  # noqa: ARG002
        """Return the fields of an Imu message for one reading along x [m/s²].

        `noise` is the rms of the noise [m/s²]; its square is the variance in the message. `clipped` is ignored, because
        the message type Imu has no field for it.
        """
        unknown = [0.0, 0.0, 0.0, UNKNOWN_VARIANCE]
        return {
            "linear_acceleration.x": reading,
            "linear_acceleration_covariance": [noise * noise, *unknown, *unknown],
            "orientation_covariance": [NOT_MEASURED, *8 * [0.0]],
            "angular_velocity_covariance": [NOT_MEASURED, *8 * [0.0]],
        }
