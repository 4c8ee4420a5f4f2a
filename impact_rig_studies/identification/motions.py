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
"""Simulated reductions for identification: the settled motion of the rig with its sphere, and its derivatives.

If the motion repeats, its slopes follow from the stroboscopic map (`Stroboscope.slopes`). Then single returns to the
map suffice, and the multipliers show whether the orbit is stable. If the motion does not repeat, its mean over many
cycles is compared with a measurement. The mean has a standard uncertainty, from the scatter of batches, and its slopes
are coarse differences.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from impact_rig.analysis.calibration import Real
from impact_rig.errors import SimulationError
from impact_rig.physics.linear_response import base_per_ampere, transmissibility
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.states import Regime
from impact_rig_studies.dynamics.stroboscope import Place, Stroboscope
from impact_rig_studies.maps.measure import FAILED, MapRig, Settings
from impact_rig_studies.maps.plan import CURRENT

SETTLED = Settings(settle_tolerance=1e-6, settle_cycles=288, cycles=48)
REPEATS = 1e-5  # relative change of DT between the halves of a record up to which a periodic motion repeats
BATCHES, BATCH_CYCLES = 10, 48  # number and length of the batches over which an irregular motion is averaged
COARSE = 0.01  # relative step of the differences for such a motion


class SettledMotion(NamedTuple):
    """Settled motion of the rig with its sphere, as a measurement of DT would describe it."""

    log_ratio: float  # ln(DT with sphere / DT without)
    u: float  # standard uncertainty of the mean of log_ratio for an irregular motion; 0 for a repeating one
    regime: str  # periodic, modulated, chaotic or intermittent
    seen: str  # regime that a measurement reports: a chaotic motion whose changes are small looks periodic
    period: float  # number of drive cycles after which it repeats; NaN if it does not
    impacts: float  # number of impacts in a period

    @property
    def repeats(self) -> bool:
        """Return whether the motion is a periodic orbit."""
        return self.regime == Regime.PERIODIC.value and not self.u


def place_of(config: RigConfig, gap_m: float, frequency_hz: float, current_a: float) -> Place:
    """Return a rig with its sphere and a gap, driven by a sine of current [A peak]."""
    own = {"sphere.present": True, "barriers.gap_m": gap_m, "drive.kind": CURRENT_DRIVE}
    return Place(from_flat(config, own), frequency_hz, current_a)


CURRENT_DRIVE = "current"


def simulated(config: RigConfig, gap_m: float, frequency_hz: float, current_a: float) -> SettledMotion:
    """Return the settled motion of a rig after a reset; the DT without the sphere, for its ratio, is the closed form.

    Raises:
        SimulationError: the motion cannot be resolved.
    """
    return SettledRig(place_of(config, gap_m, frequency_hz, current_a)).motion


class SettledRig:
    """Settled rig, with its motion.

    Raises:
        SimulationError: the motion cannot be resolved.
    """

    def __init__(self, place: Place) -> None:
        self.place = place
        self._rig = rig = MapRig(place.config, SETTLED)
        self._reading = found = rig.measure(place.frequency_hz, place.amplitude)
        if found.regime == FAILED or not found.dt > 0.0:
            gap_mm = place.config.barriers.gap_m * 1e3
            raise SimulationError(f"gap {gap_mm:g} mm, {place.frequency_hz:g} Hz: the motion cannot be resolved")
        u, dt, seen = 0.0, found.dt, found.regime
        if not (math.isfinite(found.period) and found.drift <= REPEATS):
            means = []
            for _ in range(BATCHES):
                cycles = rig.run_cycles(place.frequency_hz, place.amplitude, BATCH_CYCLES).cycles()
                means.append((cycles["x_1"].mean(), cycles["x_b"].mean()))
            superior, base = np.array(means).T
            dt = float(abs(superior.mean() / base.mean()))
            u = float(np.std(np.log(np.abs(superior / base)), ddof=1)) / math.sqrt(BATCHES)
            seen = rig.behaviour(place.frequency_hz, place.amplitude, BATCH_CYCLES).regime.value
        impacts = found.impacts_per_cycle * found.period
        self.motion = SettledMotion(math.log(dt) - _log_dt(place), u, found.regime, seen, found.period, impacts)

    def slopes(
        self, neighbour: Callable[[int, float], Place], count: int, amplitude: int, mass: int
    ) -> tuple[Real, float]:
        """Return the derivatives of `motion.log_ratio` by parameters, shape (count,), and its roughness.

        The mean of an irregular motion changes by jumps with any parameter, from window to window of its regimes. The
        roughness is the standard deviation about the slope of such changes; it is 0 for a stable orbit. This advances
        the rig.

        Args:
            neighbour: returns the rig with the i-th parameter changed by a small step.
            count: number of parameters.
            amplitude: index of the parameter that multiplies the current.
            mass: index of the parameter that multiplies the mass of the structure.

        Raises:
            SimulationError: the motion of a neighbour cannot be resolved.
        """
        if self.motion.repeats:
            strobe = Stroboscope(self.place, CURRENT, self.place.amplitude)
            try:
                found = strobe.slopes(strobe.seen(self._rig, 1.0, self._reading), 1.0, neighbour, count)
            except SimulationError:  # the sphere is never free of the walls
                found = None
            if found is not None and found.stable:
                return found.by - _closed_form(neighbour, self.place, count, _log_dt), 0.0
        # Mean of an irregular motion: by amplitude and mass, through which the other constants act.
        around = np.array(
            [[SettledRig(neighbour(i, step)).motion.log_ratio for step in (COARSE, -COARSE)] for i in (amplitude, mass)]
        )
        by_amplitude, by_mass = (around[:, 0] - around[:, 1]) / (2.0 * COARSE)
        by = by_amplitude * _closed_form(neighbour, self.place, count, _log_base)
        by[mass] = by_mass
        off = around.mean(axis=1) - self.motion.log_ratio  # of variance 3/2 if all three values scatter alike
        return np.asarray(by), math.sqrt(float(np.mean(off**2)) / 1.5)


_STEP = 1e-6


def _closed_form(
    neighbour: Callable[[int, float], Place], place: Place, count: int, of: Callable[[Place], float]
) -> Real:
    """Return the derivatives of a closed form, by parameters."""
    here = of(place)
    return np.array([(of(neighbour(i, _STEP)) - here) / _STEP for i in range(count)])


def _log_dt(place: Place) -> float:
    return math.log(abs(complex(transmissibility(place.config, place.frequency_hz))))


def _log_base(place: Place) -> float:
    return math.log(abs(complex(base_per_ampere(place.config, place.frequency_hz))) * place.amplitude)
