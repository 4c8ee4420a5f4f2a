"""Accelerometer on the superior base: a lightly damped resonance, a charge amplifier with its high-pass and low-pass.

    V/a = S A ω_n² / (s² + s ω_n/Q + ω_n²) · s / (s + ω_h) · Butterworth_n(ω_l)        S in C per m/s², A in V/C

A contact of 40 µs shakes the 25 kHz resonance as much as it moves the structure: its pulse is longer, lower and rings.
The amplifier clips behind its filters.
"""

from __future__ import annotations

from impact_rig.config.instruments import Accelerometer
from impact_rig.instruments.sensor import Sensor
from impact_rig.instruments.transfer import butterworth, high_pass, resonance

STANDARD_GRAVITY = 9.80665


def sensor(config: Accelerometer) -> Sensor:
    """Return the accelerometer of a configuration."""
    volt_per_unit = config.sensitivity_pc_g * config.amplifier_mv_pc * 1e-3 / STANDARD_GRAVITY
    full = config.saturation_v / volt_per_unit
    return Sensor(
        name="accelerometer",
        quantity="a_1",
        unit="m/s^2",
        low_pass=resonance(config.resonance_hz, config.quality)
        * butterworth(config.low_pass_order, config.low_pass_hz),
        high_pass=high_pass(config.high_pass_hz),
        lag_order=0,
        bandwidth_hz=config.low_pass_hz,
        volt_per_unit=volt_per_unit,
        low=-full,
        high=full,
        gain_tolerance=config.gain_tolerance,
        offset_tolerance=config.offset_tolerance_v / volt_per_unit,
        noise=config.noise_v_rms / volt_per_unit,
        adc_range_v=config.adc_range_v,
        inverted=config.inverted,
        settled=False,
    )
