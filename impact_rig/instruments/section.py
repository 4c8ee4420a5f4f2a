"""Configuration of the instruments: catalogue values of the paper's sensors and of the DAQ board.

Tolerances are limits: the rig draws its errors once per seed, evenly within them; the analysis knows only the limits.
"""

from __future__ import annotations

import attrs

from impact_rig.blocks import CHANNELS
from impact_rig.config.faults import Faults
from impact_rig.config.fields import choice, integer, quantity, switch
from impact_rig.errors import ConfigError

ADC_RANGES_V = (10.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
"""Input ranges of the board [± V]."""


@attrs.frozen(kw_only=True)
class Accelerometer:
    """Piezoelectric accelerometer and charge amplifier on the superior base (Endevco 2226C class)."""

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
    saturation_v: float = quantity(10.0, "V", "The amplifier's output clips here, either side.", above=0)
    gain_tolerance: float = quantity(0.02, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_v: float = quantity(2e-3, "V", "Limit of the amplifier's offset.", at_least=0, at_most=1)
    inverted: bool = switch(False, "Wired the wrong way round; the calibration does not know.")
    adc_range_v: float = quantity(5.0, "V", "Input range of the converter, either side.", above=0)


@attrs.frozen(kw_only=True)
class Laser:
    """Laser triangulation sensor on the superior base (Wenglor YP06MGVL80 class), 0 V at the near end."""

    distance_m: float = quantity(50e-3, "m", "Distance at x_1 = 0.", above=0, at_most=10)
    half_range_m: float = quantity(10e-3, "m", "Half of the measuring range.", above=0, at_most=5)
    output_v: float = quantity(10.0, "V", "Output at the far end of the range.", above=0)
    lag_s: float = quantity(0.7e-3, "s", "Time constant of its first-order lag.", above=0, at_most=0.1)
    resolution_m: float = quantity(8e-6, "m", "Step of its digital output stage.", at_least=0, at_most=1e-3)
    noise_m_rms: float = quantity(2e-6, "m", "Noise ahead of that step, rms.", at_least=0, at_most=1e-3)
    linearity_m: float = quantity(30e-6, "m", "Limit of the departure from a straight line.", at_least=0, at_most=1e-2)
    gain_tolerance: float = quantity(0.002, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_m: float = quantity(50e-6, "m", "Limit of the zero error.", at_least=0, at_most=1e-2)
    inverted: bool = switch(False, "Wired the wrong way round; the calibration does not know.")
    adc_range_v: float = quantity(10.0, "V", "Input range of the converter, either side.", above=0)

    def __attrs_post_init__(self) -> None:
        if self.half_range_m >= self.distance_m:
            raise ConfigError(f"half_range_m must be < distance_m = {self.distance_m:g} m, got {self.half_range_m:g} m")


@attrs.frozen(kw_only=True)
class Base:
    """Inductive displacement sensor on the inferior base (Dornier IWA NT25 class)."""

    half_range_m: float = quantity(12.5e-3, "m", "Half of the measuring range.", above=0, at_most=5)
    output_v: float = quantity(10.0, "V", "Output at the end of the range.", above=0)
    bandwidth_hz: float = quantity(1e3, "Hz", "Corner of its two-pole (Butterworth) filter.", above=0)
    noise_m_rms: float = quantity(1e-6, "m", "Noise, rms within its bandwidth.", at_least=0, at_most=1e-4)
    linearity: float = quantity(
        0.0025, "-", "Limit of the departure from a straight line, of half_range_m.", at_least=0
    )
    gain_tolerance: float = quantity(0.002, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_m: float = quantity(10e-6, "m", "Limit of the zero error.", at_least=0, at_most=1e-3)
    inverted: bool = switch(False, "Wired the wrong way round; the calibration does not know.")
    adc_range_v: float = quantity(10.0, "V", "Input range of the converter, either side.", above=0)


@attrs.frozen(kw_only=True)
class Current:
    """Coil current monitor of the power amplifier, the phase reference."""

    sensitivity_a_v: float = quantity(5.0, "A/V", "Current per output voltage.", above=0)
    bandwidth_hz: float = quantity(20e3, "Hz", "Corner of its first-order low-pass.", above=0)
    noise_a_rms: float = quantity(2e-3, "A", "Noise, rms within its bandwidth.", at_least=0, at_most=1)
    saturation_v: float = quantity(10.0, "V", "Its output clips here, either side.", above=0)
    gain_tolerance: float = quantity(0.005, "-", "Limit of the relative error of the sensitivity.", at_least=0, below=1)
    offset_tolerance_a: float = quantity(5e-3, "A", "Limit of the zero error.", at_least=0, at_most=1)
    inverted: bool = switch(False, "Wired the wrong way round; the calibration does not know.")
    adc_range_v: float = quantity(5.0, "V", "Input range of the converter, either side.", above=0)


@attrs.frozen(kw_only=True)
class Adc:
    """Multiplexed converter of the DAQ board (NI USB-6251 class)."""

    bits: int = integer(16, "bit", "Resolution.", at_least=8, at_most=24)
    noise_v_rms: float = quantity(
        280e-6, "V", "Noise at ± 10 V, rms; proportional to the range.", at_least=0, at_most=0.1
    )
    gain_tolerance: float = quantity(60e-6, "-", "Limit of the relative gain error.", at_least=0, below=1)
    offset_tolerance: float = quantity(20e-6, "-", "Limit of the offset, of the range.", at_least=0, below=1)
    multiplexed: bool = switch(True, "One converter for all channels: they are converted one after another.")
    conversion_ns: int = integer(
        11_000, "ns", "Conversion interval; shorter when the scan period is.", at_least=1, at_most=10_000_000
    )
    aggregate_limit_hz: float = quantity(1e6, "Hz", "Conversions per second, all channels together.", above=0)
    anti_alias: str = choice("off", ("off", "butterworth"), "Anti-alias filter ahead of the converter.")
    anti_alias_hz: float = quantity(4e3, "Hz", "Its corner; below half the scan rate to be of use.", above=0)
    anti_alias_order: int = integer(4, "-", "Its order.", at_least=1, at_most=8)


@attrs.frozen(kw_only=True)
class Instruments:
    """All instruments of the rig."""

    ideal: bool = switch(False, "Ideal instruments: no noise, calibration error, lag, skew, quantisation or range.")
    accelerometer: Accelerometer = attrs.field(factory=Accelerometer)
    laser: Laser = attrs.field(factory=Laser)
    base: Base = attrs.field(factory=Base)
    current: Current = attrs.field(factory=Current)
    adc: Adc = attrs.field(factory=Adc)
    faults: Faults = attrs.field(factory=Faults)

    def __attrs_post_init__(self) -> None:
        for name in CHANNELS:
            chosen = getattr(self, name).adc_range_v
            if chosen not in ADC_RANGES_V:
                ranges = ", ".join(f"{volt:g}" for volt in ADC_RANGES_V)
                raise ConfigError(f"{name}.adc_range_v must be one of {ranges} V, got {chosen:g} V")
