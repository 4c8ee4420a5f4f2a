"""Displacement sensor on the inferior base: a two-pole filter, V = V_max x_b / R."""

from __future__ import annotations

from impact_rig.config.instruments import Base
from impact_rig.instruments.sensor import Sensor
from impact_rig.instruments.transfer import butterworth


def sensor(config: Base) -> Sensor:
    """Return the base sensor of a configuration."""
    return Sensor(
        name="base",
        quantity="x_b",
        unit="m",
        low_pass=butterworth(2, config.bandwidth_hz),
        lag_order=0,
        bandwidth_hz=config.bandwidth_hz,
        volt_per_unit=config.output_v / config.half_range_m,
        low=-config.half_range_m,
        high=config.half_range_m,
        gain_tolerance=config.gain_tolerance,
        offset_tolerance=config.offset_tolerance_m,
        linearity=config.linearity * config.half_range_m,
        noise=config.noise_m_rms,
        adc_range_v=config.adc_range_v,
        inverted=config.inverted,
    )
