"""Coil current monitor of the power amplifier, the phase reference: a first-order low-pass far above the drive."""

from __future__ import annotations

from impact_rig.arithmetic.scalars import TWO_PI
from impact_rig.config.instruments import Current
from impact_rig.instruments.sensor import Sensor
from impact_rig.instruments.transfer import lag


def sensor(config: Current) -> Sensor:
    """Return the current monitor of a configuration."""
    full = config.saturation_v * config.sensitivity_a_v
    return Sensor(
        name="current",
        quantity="current",
        unit="A",
        low_pass=lag(1.0 / (TWO_PI * config.bandwidth_hz)),
        lag_order=1,
        bandwidth_hz=config.bandwidth_hz,
        volt_per_unit=1.0 / config.sensitivity_a_v,
        low=-full,
        high=full,
        gain_tolerance=config.gain_tolerance,
        offset_tolerance=config.offset_tolerance_a,
        noise=config.noise_a_rms,
        adc_range_v=config.adc_range_v,
        inverted=config.inverted,
    )
