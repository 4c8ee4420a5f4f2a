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
"""Settled motion of a simulated rig with its sphere, and derivatives of its DT by the rig's constants, for the fit.

If the motion repeats, the derivatives follow from the stroboscopic map (`Stroboscope.slopes`). If the motion does not
repeat, DT is the ratio of mean amplitudes over many cycles. The scatter of batches of cycles then gives its standard
uncertainty. The derivatives are the slopes of a plane that is fitted to values of DT for slightly changed parameters.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from impact_rig.analysis.calibration import Real
from impact_rig.errors import SimulationError
from impact_rig.physics.linear_response import base_per_ampere, transmissibility
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.states import Regime
from impact_rig_studies.dynamics.orbits import STEP
from impact_rig_studies.dynamics.stroboscope import Place, Stroboscope
from impact_rig_studies.maps.measure import FAILED, MapRig, Settings
from impact_rig_studies.maps.plan import CURRENT

SETTLED = Settings(settle_tolerance=1e-6, settle_cycles=288, cycles=48)  # stricter than for maps: for derivatives
REPEATS = 1e-5  # relative change of DT between the halves of a record up to which a periodic motion repeats
BATCHES, BATCH_CYCLES = 10, 48  # number of batches over which an irregular motion is averaged, and cycles in each
AROUND = 0.01 * np.array([-1.0, -2 / 3, -1 / 3, 1 / 3, 2 / 3, 1.0])
"""Changes of a parameter at which an irregular motion is simulated to fit its derivatives.

There are six of them because their scatter gives the roughness (`SettledRig.slopes`), which is often far too small with
fewer.
"""


class SettledMotion(NamedTuple):
    """Settled motion of a simulated rig with its sphere: ln(DT with the sphere / DT without), regime and period."""

    log_ratio: float  # ln(DT with sphere / DT without)
    u: float  # standard uncertainty of log_ratio as the mean of an irregular motion; 0 for a motion that repeats
    regime: str  # regime of the simulated motion: periodic, modulated, chaotic or intermittent
    seen: str  # regime that a measurement would report: a chaotic motion whose changes are small looks periodic
    period: float  # number of drive cycles after which the motion repeats; NaN if it does not
    impacts: float  # number of impacts in a period; NaN if the motion does not repeat

    @property
    def repeats(self) -> bool:
        """Return whether the motion repeats exactly, so that `log_ratio` has no uncertainty."""
        return self.regime == Regime.PERIODIC.value and not self.u


def place_of(config: RigConfig, gap_m: float, frequency_hz: float, current_a: float) -> Place:
    """Return a rig with its sphere at a gap [m], together with its sinusoidal drive.

    The drive is the current `current_a` [A peak] at `frequency_hz`.
    """
    own = {"sphere.present": True, "barriers.gap_m": gap_m, "drive.kind": CURRENT_DRIVE}
    return Place(from_flat(config, own), frequency_hz, current_a)


CURRENT_DRIVE = "current"  # value of `drive.kind`


def simulated(config: RigConfig, gap_m: float, frequency_hz: float, current_a: float) -> SettledMotion:
    """Simulate a rig with its sphere from rest until its motion has settled, and return this motion.

    `config` describes the rig, `current_a` is the amplitude of the sinusoidal drive current [A peak]. The DT of an
    irregular motion is a mean over many cycles, with an uncertainty.

    Raises:
        SimulationError: the motion cannot be simulated.
    """
    return SettledRig(place_of(config, gap_m, frequency_hz, current_a)).motion


class SettledRig:
    """Simulated rig with its sphere in settled motion, which computes derivatives of its DT by parameters.

    Args:
        place: configuration of the rig, with frequency and amplitude of its drive.

    Raises:
        SimulationError: the motion cannot be simulated.
    """

    def __init__(self, place: Place) -> None:
        self.place = place
        self._rig = rig = MapRig(place.config, SETTLED)
        self._reading = found = rig.measure(place.frequency_hz, place.amplitude)
        if found.regime == FAILED or not found.dt > 0.0:
            gap_mm = place.config.barriers.gap_m * 1e3
            raise SimulationError(
                f"the motion of the sphere cannot be simulated at gap {gap_mm:g} mm, {place.frequency_hz:g} Hz and "
                f"{place.amplitude:g} A peak: check sphere, contact law and current"
            )
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
        self, neighbour: Callable[[int, float], Place], count: int, amplitude: int, others: Sequence[int]
    ) -> tuple[Real, float]:
        """Return the derivatives of `motion.log_ratio` by parameters, and the roughness of this function.

        The log ratio is ln(DT with the sphere / DT without). For an irregular motion it jumps under small changes of
        the parameters, so it scatters about a linear dependence. The roughness is √2 times the standard deviation of
        this scatter, because both the measured and the simulated motion scatter. It is 0 for a stable periodic orbit.
        The call advances the simulated rig.

        Args:
            neighbour: `neighbour(i, step)` returns the rig with the i-th parameter changed by `step`.
            count: number of parameters.
            amplitude: index of the parameter that multiplies the current.
            others: indices of the parameters that affect the motion of the sphere not only through the amplitude of the
                inferior base.

        Returns:
            The derivatives, shape (count,), and the roughness.

        Raises:
            SimulationError: the motion of a neighbour cannot be simulated.
        """
        if self.motion.repeats:
            strobe = Stroboscope(self.place, CURRENT, self.place.amplitude)
            try:
                found = strobe.slopes(strobe.seen(self._rig, 1.0, self._reading), 1.0, neighbour, count)
            except SimulationError:  # the sphere is never free of the walls
                found = None
            if found is not None and found.stable:
                return found.by - _closed_form(neighbour, self.place, count, _log_dt), 0.0
        # Mean of an irregular motion: a plane through the values at its neighbours.
        changed = [amplitude, *others]
        steps = np.vstack([np.zeros(len(changed)), *(step * np.eye(len(changed)) for step in AROUND)])
        near = [SettledRig(neighbour(i, step)).motion.log_ratio for step in AROUND for i in changed]
        plane = np.column_stack([steps, np.ones(len(steps))])
        slopes, squares, _, _ = np.linalg.lstsq(plane, np.array([self.motion.log_ratio, *near]))
        by = slopes[0] * _closed_form(neighbour, self.place, count, _log_base)
        by[list(others)] = slopes[1:-1]
        return np.asarray(by), math.sqrt(2.0 * float(squares[0]) / (len(plane) - plane.shape[1]))


def _closed_form(
    neighbour: Callable[[int, float], Place], place: Place, count: int, of: Callable[[Place], float]
) -> Real:
    """Return the derivatives of the function `of` by `count` parameters, as forward differences; shape (count,).

    `of` needs no simulation. `neighbour(i, step)` returns `place` with the i-th parameter increased by `step`.
    """
    here = of(place)
    return np.array([(of(neighbour(i, STEP)) - here) / STEP for i in range(count)])


def _log_dt(place: Place) -> float:
    return math.log(abs(complex(transmissibility(place.config, place.frequency_hz))))


def _log_base(place: Place) -> float:
    return math.log(abs(complex(base_per_ampere(place.config, place.frequency_hz))) * place.amplitude)
