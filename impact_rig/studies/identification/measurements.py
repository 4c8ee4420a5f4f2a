# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What identification is given: results of the analysis, with noise kept apart from errors of calibration.

Errors of calibration are common to all points: one gain and one curve per sensor (`analysis.calibration`). They become
nuisance parameters with the certificate's standard uncertainties; what is left per point is noise.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.analysis.calibration import U_CUBIC, Calibration
from impact_rig.analysis.channels import BASE, CURRENT, LASER
from impact_rig.analysis.decay import Decay
from impact_rig.analysis.reduction import repeatability
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.campaign.results import Curves, Point
from impact_rig.studies.identification.fisher import Real

LEAST_NOISE = 1e-4
"""Relative; repeatability that is not claimed to be better, whatever a few seconds of signal suggest."""
CALIBRATION = ("gain laser", "gain base", "gain current", "curve laser", "curve base")
NUISANCES = (*CALIBRATION, "DT without sphere", "e")
"""Errors that several data share. "DT without sphere" is the noise of the point that all reductions are taken against,
e the error of the nominal restitution that is taken as known."""
RESTITUTION = NUISANCES.index("e")
U_RESTITUTION = 0.02
"""Standard uncertainty of the nominal e, unless a better one is given: the reductions tell more if they are several."""


@attrs.frozen(eq=False)
class SineData:
    """The stepped sine without sphere; arrays of shape (n,), u_: standard uncertainty by noise alone, relative or rad.

    Attributes:
        frequency_hz: of the points.
        dt: transmissibility.
        phase_rad: of x_1 to x_b.
        base_per_a: amplitude of the base over that of the current [m/A].
        laser_m, base_m: amplitudes.
        u_amplitude: relative, of dt and of base_per_a.
        u_phase: [rad].
    """

    frequency_hz: Real
    dt: Real
    phase_rad: Real
    base_per_a: Real
    laser_m: Real
    base_m: Real
    u_amplitude: Real
    u_phase: Real


@attrs.frozen(eq=False)
class Reduced:
    """DT with the sphere over DT without, at one frequency.

    Attributes:
        frequency_hz, current_a: of the drive.
        ratio: by gap [m].
        u: relative standard uncertainty by the noise of DT with the sphere, shape (n,).
        u_without: that of DT without.
        effects: d ln ratio / d nuisance, shape (n, 7); that of e is left to the simulation.
        regimes: what the motion with the sphere was measured to be, by gap.
    """

    frequency_hz: float
    current_a: float
    ratio: Mapping[float, float]
    u: Real
    u_without: float
    effects: Real
    regimes: Mapping[float, str]


@attrs.frozen(eq=False)
class Gains:
    """Errors of calibration: standard uncertainties and what they do.

    Attributes:
        u: of `CALIBRATION`, shape (5,).
        calibration: the certificate.
    """

    u: Real
    calibration: Calibration

    @classmethod
    def of(cls, info: NDArray[np.void]) -> Gains:
        """Read the certificate, rows of `daq/info`."""
        calibration = Calibration.from_info(info)
        curve = [U_CUBIC * _bend(calibration, channel) for channel in (LASER, BASE)]
        gains = [float(calibration.gain_uncertainty[channel]) for channel in (LASER, BASE, CURRENT)]
        # the certificate counts the curve's slope at mid-range among the gains; here the curve has a parameter itself
        for place, bent in enumerate(curve):
            gains[place] = math.sqrt(max(gains[place] ** 2 - (1.5 * bent) ** 2, 0.0))
        return cls(np.array([*gains, *curve]), calibration)

    def relative(self, channel: int, amplitude: Real) -> Real:
        """Return d ln(amplitude) / d nuisance for a channel, shape (n, 7)."""
        effect = np.zeros((len(amplitude), len(NUISANCES)))
        effect[:, (LASER, BASE, CURRENT).index(channel)] = 1.0
        if channel != CURRENT:
            share = amplitude / _half_range(self.calibration, channel)
            effect[:, 3 + (LASER, BASE).index(channel)] = np.where(np.isfinite(share), 1.875 * share**2 - 1.5, 0.0)
        return effect


def _half_range(calibration: Calibration, channel: int) -> float:
    return float(calibration.high[channel] - calibration.low[channel]) / 2.0


def _bend(calibration: Calibration, channel: int) -> float:
    half = _half_range(calibration, channel)
    return float(calibration.linearity[channel]) / half if math.isfinite(half) else 0.0


def sine_of(points: Sequence[Point], gains: Gains) -> SineData:
    """Return settled points without sphere as a stepped sine."""
    rows = np.concatenate([point.rows[:1] for point in points])
    u = np.array([_noise(point, gains) for point in points])
    return SineData(
        frequency_hz=rows["frequency"].copy(),
        dt=rows["transmissibility"].copy(),
        phase_rad=rows["phase"].copy(),
        base_per_a=rows["base_amplitude"] / rows["current_amplitude"],
        laser_m=rows["laser_amplitude"].copy(),
        base_m=rows["base_amplitude"].copy(),
        u_amplitude=u,
        u_phase=np.maximum(rows["phase_uncertainty"], LEAST_NOISE),
    )


def reduced_of(curves: Curves, frequency_hz: float, gaps_m: Sequence[float], gains: Gains) -> Reduced | None:
    """Return the ratios at one frequency, or None if there are none; only impacting orbits tell anything.

    Where no accelerometer was there, nobody counted: then the simulated motion says.
    """
    without = curves.at(NO_SPHERE, frequency_hz)
    points = [point for gap in gaps_m if (point := curves.at(gap, frequency_hz)) is not None and _may_impact(point)]
    if without is None or not points:
        return None
    effects = np.zeros((len(points), len(NUISANCES)))
    for sign, channel, column in ((1.0, LASER, "laser_m"), (-1.0, BASE, "base_m")):
        with_sphere = gains.relative(channel, np.array([getattr(point, column) for point in points]))
        effects += sign * (with_sphere - gains.relative(channel, np.array([getattr(without, column)])))
    effects[:, NUISANCES.index("DT without sphere")] = -1.0
    return Reduced(
        frequency_hz=frequency_hz,
        current_a=without.current_a,
        ratio={point.gap_m: point.dt / without.dt for point in points},
        u=np.array([_noise(point, gains) for point in points]),
        u_without=_noise(without, gains),
        effects=effects,
        regimes={point.gap_m: point.regime for point in points},
    )


def _may_impact(point: Point) -> bool:
    return point.impacts or math.isnan(point.impacts_per_cycle)


def _noise(point: Point, gains: Gains) -> float:
    """Return the relative standard uncertainty of DT less what the calibration contributes to it."""
    return max(repeatability(point.rows, gains.calibration), LEAST_NOISE)


@attrs.frozen(eq=False, kw_only=True)
class Measured:
    """Everything that was measured; None where it was not. `u_restitution`: how well the nominal e is known."""

    gains: Gains
    decay: Decay | None = None
    sine: SineData | None = None
    reduced: Reduced | None = None
    u_restitution: float = U_RESTITUTION
