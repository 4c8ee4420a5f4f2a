# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What `daq/info` says about the channels, and how a phasor is corrected with it.

A channel converts its value `skew` after the scan clock, from a sensor that lags: the measured phasor is

    Y(ω) = X(ω) · L(ω) · e^{iω·skew}

`lag` is the sensor's group delay at low frequency; `lag_order` names its model:

    0    pure delay                                              L = e^{−iω·lag}
    1    first order with the time constant lag                  L = 1 / (1 + iω·lag)
    2    two-pole Butterworth of that group delay                L = 1 / (1 + i√2 Ω − Ω²),  Ω = ω·lag/√2

`linearity` L bounds a smooth curve: L (c_2 P_2(u) + c_3 P_3(u)), Legendre polynomials of the place u = −1 … 1 in the
range of half width R, |c_2| + |c_3| <= 1 evenly, so that u(c_3) = 1/√6. A sine of amplitude a·R about mid-range finds
the gain changed by c_3 (L/R) (1.875 a² − 1.5): first harmonic of P_3.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.channels import CHANNELS
from impact_rig.blocks import MOST_HZ
from impact_rig.errors import ConfigError

Complex = NDArray[np.complex128]
Real = NDArray[np.float64]


def pure_delay(omega_lag: Real) -> Complex:
    """Return L of a sensor that only delays; `omega_lag` = ω·lag, dimensionless."""
    return np.asarray(np.exp(-1j * omega_lag), dtype=np.complex128)


def first_order(omega_lag: Real) -> Complex:
    """Return L of a first-order sensor."""
    return np.asarray(1.0 / (1.0 + 1j * omega_lag), dtype=np.complex128)


def two_pole(omega_lag: Real) -> Complex:
    """Return L of a Butterworth two-pole sensor; equals a pure delay to second order in ω·lag."""
    scaled = omega_lag / math.sqrt(2.0)
    return np.asarray(1.0 / (1.0 + 1j * math.sqrt(2.0) * scaled - scaled**2), dtype=np.complex128)


LAG_MODELS: dict[int, Callable[[Real], Complex]] = {0: pure_delay, 1: first_order, 2: two_pole}
"""`lag_order` to model."""

U_CUBIC = 1.0 / math.sqrt(6.0)
"""Standard uncertainty of the share c that the cubic has in a sensor's curve."""

TWO_POLE_NOISE = 1.11
"""Noise bandwidth of a Butterworth two-pole filter over its corner."""

COLUMNS = (
    "range_low",
    "range_high",
    "resolution",
    "noise",
    "sensitivity_uncertainty",
    "lag",
    "skew",
    "lag_order",
    "bandwidth",
    "linearity",
)


LARGEST = 1e100
"""Of any figure: its square is a number."""


@attrs.frozen(eq=False)
class Calibration:
    """The columns of `daq/info` as arrays over `channels.CHANNELS`.

    Attributes:
        rate_hz: scans per second.
        low: lower end of the range [SI unit of the channel]; high: upper end.
        resolution: 1 LSB [unit]; 0 where unknown.
        noise: rms [unit].
        gain_uncertainty: relative standard uncertainty of the sensitivity.
        lag: group delay at low frequency [s].
        skew: conversion after the scan clock [s].
        lag_order: key into `LAG_MODELS`.
        bandwidth: corner of the sensor and its noise [Hz]; 0 where unknown.
        linearity: limit of the departure from a straight line [unit].
    """

    rate_hz: int
    low: Real
    high: Real
    resolution: Real
    noise: Real
    gain_uncertainty: Real
    lag: Real
    skew: Real
    lag_order: Real
    bandwidth: Real
    linearity: Real

    @classmethod
    def from_info(cls, rows: NDArray[np.void]) -> Calibration:
        """Return the calibration in the rows of a `daq/info` table, in any order.

        Raises:
            ConfigError: a channel is missing or twice there, the rates differ or are no positive whole number, a range
                is empty, a lag order is unknown, or a figure is beyond all measure.
        """
        names = [bytes(name).decode(errors="replace") for name in rows["name"]]
        if any(names.count(channel) != 1 for channel in CHANNELS):
            raise ConfigError(f"daq/info must have one row for each of {', '.join(CHANNELS)}, got {', '.join(names)}")
        ordered = rows[[names.index(channel) for channel in CHANNELS]]
        rate = float(ordered["rate"][0])
        if not (np.all(ordered["rate"] == rate) and 0 < rate <= MOST_HZ and rate == round(rate)):
            raise ConfigError(
                f"daq/info: rate must be one positive whole number of Hz, at most {MOST_HZ:g}, "
                f"got {ordered['rate'].tolist()}"
            )
        if not np.all(ordered["range_low"] < ordered["range_high"]):
            raise ConfigError("daq/info: range_low must be < range_high in every row")
        if not set(ordered["lag_order"].tolist()) <= set(LAG_MODELS):
            raise ConfigError(f"daq/info: lag_order must be one of 0, 1, 2, got {ordered['lag_order'].tolist()}")
        for name in COLUMNS:
            sizes = np.abs(ordered[name])
            if np.any((sizes > LARGEST) & np.isfinite(sizes)):
                raise ConfigError(
                    f"daq/info: {name} must be infinite or at most {LARGEST:g}, got {ordered[name].tolist()}"
                )
        return cls(round(rate), *(_finite(ordered[name]) for name in COLUMNS))

    def response(self, channel: int, frequency_hz: Real | float) -> Complex:
        """Return L(ω)·e^{iω·skew} of a channel: measured over true phasor, shape of `frequency_hz`."""
        omega = 2.0 * np.pi * np.asarray(frequency_hz, dtype=np.float64)
        lag = LAG_MODELS[int(self.lag_order[channel])](omega * self.lag[channel])
        return np.asarray(lag * np.exp(1j * omega * self.skew[channel]), dtype=np.complex128)

    def gain_uncertainty_at(self, channel: int, amplitude: float) -> float:
        """Return the relative standard uncertainty of the amplitude of a vibration about mid-range.

        `gain_uncertainty` holds for a small one, the slope 1.5 c L/R of the sensor's curve at mid-range included; a
        vibration of amplitude a·R sees (1.5 − 1.875 a²) c L/R of it (module docstring).
        """
        half_range = float(self.high[channel] - self.low[channel]) / 2.0
        curve = float(self.linearity[channel]) / half_range * U_CUBIC
        small = float(self.gain_uncertainty[channel]) ** 2
        share = amplitude / half_range
        return math.sqrt(max(small - (1.5 * curve) ** 2, 0.0) + ((1.5 - 1.875 * share**2) * curve) ** 2)

    def curvature_uncertainty(self, channel: int, amplitude: float) -> float:
        """Return the standard uncertainty of the relative change of gain from a small vibration to this amplitude."""
        half_range = float(self.high[channel] - self.low[channel]) / 2.0
        return float(self.linearity[channel]) / half_range * U_CUBIC * 1.875 * (amplitude / half_range) ** 2

    def noise_crowding(self) -> Real:
        """Return how much denser the noise is at the drive than if it filled the band up to rate / 2, shape (4,)."""
        noise_band = TWO_POLE_NOISE * np.where(self.bandwidth > 0.0, self.bandwidth, np.inf)
        return np.asarray(np.maximum(1.0, self.rate_hz / (2.0 * noise_band)), dtype=np.float64)

    def lag_sensitivity(self, channel: int, frequency_hz: float) -> complex:
        """Return d ln L / d ln lag: real part for the amplitude, imaginary part for the phase, per relative change."""
        omega_lag = np.asarray(2.0 * np.pi * frequency_hz * self.lag[channel])
        model = LAG_MODELS[int(self.lag_order[channel])]
        step = 1e-6
        return complex(np.log(model(omega_lag * (1 + step)) / model(omega_lag * (1 - step))) / (2 * step))


def _finite(column: NDArray[np.float64]) -> Real:
    """Keep infinite values (unlimited ranges) and read NaN (unknown figures) as 0."""
    values = np.array(column, dtype=np.float64)
    values[np.isnan(values)] = 0.0
    return values
