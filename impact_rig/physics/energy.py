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
"""Work of the drive and losses during a flight, by Gauss–Legendre quadrature of its closed form.

A flight is the motion between contacts. `contact_phase.account_step` does the same for contacts, and `event_loop` adds
the losses of the contacts themselves. The index 1 marks the superior base on its columns, and b the inferior base. c_f
is the damping of the suspension of the inferior base. K_f, R, i and U are force factor, resistance, current and voltage
of the coil.

columns  ∫ c_1 (v_1 − v_b)² dt        shaker  ∫ c_f v_b² + R i² dt        friction  force times the distance slid
work     ∫ K_f i v_b dt (current),  ∫ U i dt (voltage),  ∫ [k_1 (x_b − x_1) − c_1 (v_1 − v_b)] v_b dt (prescribed)
"""

from __future__ import annotations

import math

import numpy as np

from impact_rig.arithmetic.elementary import modulus
from impact_rig.kernels import Reals, Record, kernel
from impact_rig.physics.collocation import GAUSS_NODES, GAUSS_WEIGHTS
from impact_rig.physics.flight import DriveSegment, drive, structure_at
from impact_rig.physics.state import COIL, PRESCRIBED, V1, VB, VOLTAGE, X1, XB

_PANEL = 1.0  # radians (or e-foldings) of the fastest motion per quadrature panel: eight points leave 1e-14
_SHORT = 0.02  # of such a panel: for an interval of a stream's samples, three points have an error of 2e-15
_SHORT_NODES = np.array([-0.7745966692414834, 0.0, 0.7745966692414834])
_SHORT_WEIGHTS = np.array([0.5555555555555556, 0.8888888888888888, 0.5555555555555556])
_FORGOTTEN = 50.0  # e-foldings after which a mode needs no panels of its own


@kernel
def add_powers(p: Record, f: DriveSegment, y: Reals, t: float, weight: float, ledger: Record) -> None:
    """Add the powers of drive, columns and shaker at one instant, times `weight` [s], to the energies in `ledger` [J].

    A quadrature calls this function for each of its points. t is the instant, in seconds since the start of the drive
    segment f, and y the structural state at t. The motion of a prescribed base is computed from the drive, not read
    from y.
    """
    u, u_rate = drive(f, t)
    x_b, v_b = (u, u_rate) if p.drive_kind == PRESCRIBED else (y[XB], y[VB])
    v_rel = y[V1] - v_b
    ledger.columns += weight * p.c_1 * v_rel * v_rel
    if p.drive_kind == PRESCRIBED:
        ledger.work += weight * (p.k_1 * (x_b - y[X1]) - p.c_1 * v_rel) * v_b
        return
    ledger.shaker += weight * p.c_f * v_b * v_b
    if p.drive_kind == VOLTAGE:
        ledger.work += weight * u * y[COIL]
        ledger.shaker += weight * p.resistance * y[COIL] * y[COIL]
    else:
        ledger.work += weight * p.force_factor * u * v_b


@kernel
def account_flight(p: Record, system: Record, f: DriveSegment, flight: Record, end: float, ledger: Record) -> None:
    """Add the drive's work and the losses in columns and shaker during a flight to `ledger` [J].

    The flight lasts from `flight.t_b` to `end`. Both times count from the start of the drive segment [s]. The loss by
    friction of the guide is not included.
    """
    duration, done = end - flight.t_b, 0.0
    while done < duration:
        fastest = f.omega
        for n in range(system.modes):
            if -system.rate[n].real * done < _FORGOTTEN:
                fastest = max(fastest, modulus(system.rate[n]))
        time_left = duration - done
        panel = time_left / max(1, math.ceil(time_left * fastest / _PANEL))
        nodes, weights = GAUSS_NODES, GAUSS_WEIGHTS
        if panel * fastest < _SHORT:
            nodes, weights = _SHORT_NODES, _SHORT_WEIGHTS
        for point in range(len(nodes)):
            t = flight.t_b + done + 0.5 * panel * (1.0 + nodes[point])
            structure_at(system, f, flight, t)
            add_powers(p, f, flight.y, t, 0.5 * panel * weights[point], ledger)
        done += panel
