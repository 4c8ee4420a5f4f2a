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
"""Records of the kernels: parameters of the equations, state of the rig, and workspaces.

Each record has named fields in SI units. A field has one unit; if its meaning depends on the phase, the comment next to
it explains how. A record is an element of a recarray, so compiled code and plain Python both access a field as
`state.d_rate`.

A trajectory is the history of states at its events and at the steps of its contacts. Each state contains the phase of
the motion that starts there, which is enough to evaluate the motion up to the next state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_rig.kernels import with_fields
from impact_rig.physics.collocation import STAGES

PHASES = ("FREE", "CONTACT", "ATTACHED")
FREE, CONTACT, ATTACHED = range(3)
"""Phases of the motion: the sphere is loose (FREE), touches a wall that yields (CONTACT), or moves with the superior
base as one body (ATTACHED), which is a flight as well.
"""

NOTHING, SEPARATED, PAUSED, RELEASED, TURNED, RELOADED, FAILED, SETTLED, TOUCHED, STOPPED, PARTED = range(11)
"""Reasons why a step of a contact ends (TURNED, RELOADED; NOTHING if no event ends it, FAILED if it has no solution),
or why a phase of the motion ends (all others). After PAUSED the same phase continues.

See `contact_phase` and the table of `event_loop`.
"""

X1, V1, XB, VB, COIL = range(5)
"""Indices of a structural state y: position and velocity of the superior base [m], [m/s], those of the inferior base
[m], [m/s], current i of the coil [A].

A prescribed base has the first two only, a current drive the first four.
"""
STRUCTURE = 5
"""Number of entries of a structural state y."""

ORDERS = 6
"""Number of derivatives of x_1, counting x_1 itself as the zeroth, for which a flight stores terms. The derivatives
0 … 4 are evaluated; of the fifth only a bound is computed.
"""
STEP_TERMS = 12
"""Largest number of Taylor terms of the structure's motion within one step of a contact."""

STATE = np.dtype(
    [
        ("t", "f8"),  # time since the start of the drive segment [s]
        ("phase", "i8"),  # FREE, CONTACT or ATTACHED
        ("y", "f8", (STRUCTURE,)),  # x_1, v_1, x_b, v_b, i [m, m/s, m, m/s, A]; in a contact x_1* and v_1*, the pair's
        ("d", "f8"),  # x_2 − x_1 [m]; in a contact that at the touch
        ("d_rate", "f8"),  # rate of d [m/s]; 0 in a contact and while ATTACHED
        ("slide", "f8"),  # direction in which the sphere slides on a guide with friction, or parts at PARTED: −1, 0, 1
        ("side", "f8"),  # wall that is touched or presses: −1 left, 1 right, 0 none
        ("w", "f8"),  # in a contact √δ, the square root of the indentation [m^0.5]
        ("speed", "f8"),  # in a contact δ', the rate of the indentation [m/s], positive while it grows
        ("deepest_w", "f8"),  # in a contact the largest w so far [m^0.5]
        ("per_v0", "f8"),  # in a contact 1 over its approach speed, at most 1 over `speed_floor` [s/m]
        ("tabulated", "i8"),  # 1: from here to the next state the motion is one contact looked up in the table
        ("h", "f8"),  # length in χ of the contact's step that starts here [s/m^0.5], 0 where none does
        ("dent", "f8"),  # residual indentation where a wall let the sphere go, until the sphere has left it [m]
        ("dent_side", "f8"),  # wall with that residual indentation: −1 left, 1 right
        ("next_h", "f8"),  # length in χ that the step control proposes [s/m^0.5], 0 where a contact has just begun
        ("touch_tick", "i8"),  # number of the tick in which the contact began
        ("touch_offset", "f8"),  # when in that tick it began [s]
        ("approach", "f8"),  # δ' with which the contact began [m/s]
        ("elapsed", "f8"),  # duration of the contact so far [s]
        ("peak_force", "f8"),  # largest F of the contact so far [N]
        ("impulse", "f8"),  # ∫ F dt of the contact so far [N s]
        ("lost", "f8"),  # energy lost by the contact so far [J]
    ],
    align=True,
)

LEDGER = np.dtype(
    [
        ("work", "f8"),  # work of the drive [J]
        ("columns", "f8"),  # lost in the columns' damping [J]
        ("shaker", "f8"),  # lost in the damping of the inferior base's suspension and in the coil [J]
        ("contact", "f8"),  # lost in contacts, less what raising a speed to `touch_speed` added [J]
        ("friction", "f8"),  # lost by friction of the guide [J]
    ]
)
"""Record of the energies since the account began, see `simulation.EnergyAccount`."""

IMPACT = np.dtype(
    [
        ("tick", "i8"),  # number of the tick in which the contact began
        ("offset", "f8"),  # when in that tick it began [s]
        ("wall", "i1"),  # which wall: −1 left, 1 right
        ("approach_speed", "f8"),  # δ' with which it began [m/s]
        ("separation_speed", "f8"),  # −δ' with which it ended [m/s]
        ("peak_force", "f8"),  # largest F [N]
        ("peak_indentation", "f8"),  # largest δ [m]
        ("impulse", "f8"),  # ∫ F dt [N s]
        ("duration", "f8"),  # from the touch to its end [s]
        ("energy_lost", "f8"),  # energy lost in it [J]
    ]
)
"""Record of one finished contact. Contacts with a rigid wall that were slower than `touch_speed` get none.

The fields are the columns of `blocks.IMPACTS`, with the instant of the touch as tick and offset.
"""

COUNTS = np.dtype(
    [
        ("states", "i8"),  # rows of the history that are filled
        ("impacts", "i8"),  # rows of the impacts that are filled
        ("segments", "i8"),  # segments that have begun
        ("ticks", "i8"),  # ticks that have begun
    ]
)
"""Record of how much of a workspace has been filled since the present call of `Simulation.advance` began."""

FLIGHT = np.dtype(
    [
        ("omega", "f8"),  # frequency of the drive that the answers H and G belong to [rad/s]
        ("system", "i8"),  # linear system they belong to: SPHERE_LOOSE or SPHERE_ATTACHED
        ("interval", "f8"),  # length of the intervals that have a Taylor polynomial each, about their middle [s]
        ("answer", "c16", (STRUCTURE,)),  # H, answer to a drive of constant amplitude [y per u]
        ("growth_answer", "c16", (STRUCTURE,)),  # G, answer to a drive whose amplitude grows [y s per u]
        ("steady", "c16", (STRUCTURE,)),  # P of y_p(t) = Im[(P + Q t) exp(jωt)] [as y]
        ("growing", "c16", (STRUCTURE,)),  # Q of y_p [as y, per s]
        ("forced", "c16", (ORDERS,)),  # P of the k-th derivative of x_1 [m/s^k]
        ("forced_growing", "c16", (ORDERS,)),  # Q of the k-th derivative of x_1 [m/s^(k+1)]
        ("forced_size", "f8", (ORDERS,)),  # bound on that derivative's part in y_p within the segment [m/s^k]
        ("t_b", "f8"),  # when the flight began, since the start of the segment [s]
        ("friction_force", "f8"),  # constant force of the guide's friction on the structure [N]
        ("modal", "c16", (STRUCTURE,)),  # C_n, amplitude of mode n at t_b [of the place of y where Γ_n is 1]
        ("wave", "c16", (ORDERS, STRUCTURE)),  # part of mode n in the k-th derivative of x_1 at t_b [m/s^k]
        ("wave_size", "f8", (ORDERS, STRUCTURE)),  # modulus of that part [m/s^k]
        ("x_1", "f8", (ORDERS,)),  # k-th derivative of x_1 where it was evaluated last [m/s^k]
        ("bound", "f8"),  # bound, from there to the segment's end, on the first derivative not evaluated [m/s^k]
        ("y", "f8", (STRUCTURE,)),  # structural state where `structure_at` evaluated it last, scratch before [as y]
    ],
    align=True,
)
"""Record of the current flight: its closed form, and the values at the instant at which that was evaluated last."""

POINT = 5  # values that a contact law returns for one point
CONTACT_STEP = np.dtype(
    [
        ("path", "f8", (STRUCTURE, STEP_TERMS)),  # Taylor coefficients of the pair's y about the step's start [y/s^n]
        ("acceleration", "f8", (STEP_TERMS,)),  # Taylor coefficients of a_r about it [m/s^(n+2)]
        ("w", "f8", (STAGES,)),  # √δ at the stages [m^0.5]
        ("speed", "f8", (STAGES,)),  # δ' at the stages [m/s]
        ("since", "f8", (STAGES,)),  # time from the step's start to the stages [s]
        ("acceleration_at", "f8", (STAGES,)),  # a_r at the stages, with what the correction z adds [m/s²]
        ("force", "f8", (STAGES,)),  # F at the stages [N]
        ("lossy", "f8", (STAGES,)),  # part of F at the stages that dissipates [N]
        ("force_by_w", "f8", (STAGES,)),  # ∂F/∂w at the stages [N/m^0.5]
        ("force_by_speed", "f8", (STAGES,)),  # ∂F/∂δ' at the stages [N s/m]
        ("speed_slope", "f8", (STAGES,)),  # dδ'/dχ at the stages [m^1.5/s²]
        ("speed_slope_by_w", "f8", (STAGES,)),  # ∂(dδ'/dχ)/∂w at the stages [m/s²]
        ("speed_slope_by_speed", "f8", (STAGES,)),  # ∂(dδ'/dχ)/∂δ' at the stages [m^0.5/s]
        ("correction", "f8", (STRUCTURE, STAGES)),  # z at the stages: what δ moves y by, over side · σ [as y]
        ("correction_slope", "f8", (STRUCTURE, STAGES)),  # dz/dχ at the stages [m^0.5/s, times y]
        ("newton", "f8", (STAGES, STAGES)),  # matrix of Newton's method for the stages' δ', then its inverse [-]
        ("residual", "f8", (STAGES,)),  # right-hand side of Newton's method: −MATRIX⁻¹ times the step's residuals [m/s]
        ("dense", "f8", (STAGES + 1,)),  # coefficients of the dense output δ'(x), x = 0 … 1 [m/s]
        ("dense_length", "f8"),  # length in χ of the step it belongs to [s/m^0.5], 0 where none is known
        ("dense_since", "f8"),  # how far in χ from that step's start the next one starts [s/m^0.5]
        ("fastest_time_scale", "f8"),  # time in which the fastest motion of structure or drive goes one radian [s]
        ("contact_time_scale", "f8"),  # time in which the contact's own vibration goes one radian [s]
        ("turned_at", "f8"),  # w from which the law unloads, 0 while it loads: see `contact.law` [m^0.5]
        ("start_speed_slope", "f8"),  # dδ'/dχ at the step's start [m^1.5/s²]
        ("start_force", "f8"),  # F at the step's start [N]
        ("tolerance", "f8"),  # how wrong the step's speeds may be [m/s]
        ("goal", "f8"),  # how near to the solution of the step's equations Newton's method must bring them [m/s]
        ("terms", "i8"),  # how many Taylor terms suffice for the step
        ("valid_for", "f8"),  # time from the step's start for which they hold [s]
        ("time_left", "f8"),  # time from the step's start to the end of the drive segment [s]
        ("y", "f8", (STRUCTURE,)),  # scratch: a state of the pair, or of the structure [as y]
        ("point", "f8", (POINT,)),  # what a law returned last, in the order of `contact.law` [N, N, J, N/m^0.5, N s/m]
    ],
    align=True,
)
"""Record of one integration step of a contact: its Taylor polynomials, stages, Newton matrix and dense output."""


def record(kind: np.dtype[np.void], rows: int = 1) -> Any:
    """Return zeroed records of the type `kind`, shape (rows,), whose fields are attributes as in kernels."""
    return with_fields(np.zeros(rows, kind))


PRESCRIBED, CURRENT, VOLTAGE = range(3)
DRIVES = ("prescribed", "current", "voltage")
SPHERE_LOOSE, SPHERE_ATTACHED = range(2)
"""Indices of the linear systems: the superior base alone (mass m_1), and in phase ATTACHED with the sphere (m_1 + m).
"""

PARAMETERS = np.dtype(
    [
        ("drive_kind", "i8"),  # PRESCRIBED, CURRENT or VOLTAGE
        ("sphere_present", "i8"),  # 0 where there is no sphere
        ("m_1", "f8"),  # mass of the superior base [kg]
        ("c_1", "f8"),  # damping of the columns [N s/m]
        ("k_1", "f8"),  # stiffness of the columns [N/m]
        ("m_base", "f8"),  # m_a + m_b: armature and inferior base [kg]
        ("c_f", "f8"),  # damping of the inferior base's suspension [N s/m]
        ("k_f", "f8"),  # stiffness of that suspension [N/m]
        ("force_factor", "f8"),  # K_f of the coil [N/A]
        ("resistance", "f8"),  # R of the coil [Ω]
        ("per_inductance", "f8"),  # 1/L of the coil [1/H]
        ("m", "f8"),  # mass of the sphere [kg]
        ("m_eff", "f8"),  # m m_1 / (m + m_1) [kg]
        ("per_m_eff", "f8"),  # 1/m_eff [1/kg]: reciprocals, because a division costs as much as the rest of a line
        ("per_m_1", "f8"),  # 1/m_1 [1/kg]
        ("per_m_pair", "f8"),  # 1/(m_1 + m) [1/kg]
        ("per_m_base", "f8"),  # 1/m_base [1/kg]
        ("share", "f8"),  # σ = m / (m_1 + m), the structure's part in a relative motion [-]
        ("slowing_by_depth", "f8"),  # σ k_1 / m_1, what the columns take off δ'' per δ [1/s²]
        ("slowing_by_speed", "f8"),  # σ c_1 / m_1, what they take off it per δ' [1/s]
        ("half_gap", "f8"),  # g/2 [m]
        ("friction_acceleration", "f8"),  # μ g_0 of the guide [m/s²]
        ("stiffness", "f8"),  # the contact law's first number, K of F ~ K δ^b [N/m^b]
        ("factor", "f8"),  # its second number, by law: a [-], c [N s/m] or e² [-]; see `contact.law.Force`
        ("restitution", "f8"),  # restitution e of a rigid law [-]
        ("rigid", "i8"),  # 1 where a contact takes no time
        ("lets_go", "i8"),  # 1 where a contact ends as soon as its force would pull
        ("remembers", "i8"),  # 1 where the force depends on where the indentation turned
        ("time_scale", "f8"),  # of t_0 = time_scale v0^time_power, in s for v0 in m/s
        ("time_power", "f8"),  # exponent in it [-]
        ("speed_floor", "f8"),  # least v0 that a law uses, as in c = a K / v0 [m/s]
        ("touch_speed", "f8"),  # least speed with which a contact begins or a sphere parts [m/s]
        ("fastest", "f8"),  # rate of the fastest mode [1/s]
        ("rtol", "f8"),  # relative tolerance of a contact's step [-]
    ],
    align=True,
)
"""Record of the constants of the equations of motion, SI; `model.build` computes it from a configuration."""

SYSTEM = np.dtype(
    [
        ("states", "i8"),  # how many places of y there are: 2, 4 or 5, by drive
        ("modes", "i8"),  # how many modes are kept: one of each conjugate pair
        ("rate", "c16", (STRUCTURE,)),  # λ_n [1/s]
        ("right", "c16", (STRUCTURE, STRUCTURE)),  # Φ_n by place of y, doubled where a pair is kept once [y per C_n]
        ("left", "c16", (STRUCTURE, STRUCTURE)),  # Γ_n by place of y, 1 at one of them [C_n per y]
        ("b_0", "f8", (STRUCTURE,)),  # how u enters [y/s per u]
        ("b_1", "f8", (STRUCTURE,)),  # how u' enters [y per u]
        ("static", "f8", (STRUCTURE,)),  # answer to a constant unit force on the superior base [y per N]
    ],
    align=True,
)
"""Record of one linear system y' = M y + b_0 u + b_1 u', by its modes; see `linear`."""
