"""Laser displacement sensor on the superior base: a first-order lag, a digital output stage, an end of range.

It measures the distance d = d_0 − x_1, 0 V at the near end: V = V_max (d − d_0 + R) / 2R, so that its sensitivity to
x_1 is negative. Out of range it holds the end it left by, and says so.
"""

from __future__ import annotations

from impact_rig.arithmetic.scalars import TWO_PI
from impact_rig.config.instruments import Laser
from impact_rig.instruments.sensor import Sensor
from impact_rig.instruments.transfer import lag


def sensor(config: Laser) -> Sensor:
    """Return the laser of a configuration."""
    return Sensor(
        name="laser",
        quantity="x_1",
        unit="m",
        low_pass=lag(config.lag_s),
        lag_order=1,
        bandwidth_hz=1.0 / (TWO_PI * config.lag_s),
        volt_per_unit=-config.output_v / (2.0 * config.half_range_m),
        offset_v=0.5 * config.output_v,
        low=-config.half_range_m,
        high=config.half_range_m,
        gain_tolerance=config.gain_tolerance,
        offset_tolerance=config.offset_tolerance_m,
        linearity=config.linearity_m,
        noise=config.noise_m_rms,
        resolution=config.resolution_m,
        adc_range_v=config.adc_range_v,
        inverted=config.inverted,
    )
