# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What kernels work on: the parameters of the equations, the state of the rig, and their workspaces.

Everything is a record with named fields, SI units, and one meaning of a field in every phase. A record is an element of
a recarray: compiled code and plain Python both read and write `state.d_rate`.

A trajectory is the history of states at its events and at the steps of its contacts. Each state says which phase of
motion goes on from there, which is enough to evaluate the motion up to the next one.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from impact_rig.kernels import with_fields
from impact_rig.physics.collocation import STAGES

FREE, CONTACT, ATTACHED = range(3)
"""Phases: in flight; touching a wall that yields; one body with the superior base."""

NOTHING, LEFT, TIME, RELEASED, TURNED, RELOADED, FAILED, SETTLED, TOUCHED, STOPPED, PARTED = range(11)
"""What ends a step, a phase or a flight; see `contact_phase` and the table of `event_loop`."""

X1, V1, XB, VB, COIL = range(5)
"""Places in a structural state y: superior base [m], [m/s], inferior base [m], [m/s], coil current [A].

A prescribed base has the first two only, a current drive the first four.
"""
STRUCTURE = 5

ORDERS = 6
"""Derivatives of x_1 that a flight evaluates: 0 … 5."""
STEP_TERMS = 12
"""Taylor terms of the structure's motion within one step of a contact."""

STATE = np.dtype(
    [
        ("t", "f8"),  # time since the start of the drive segment [s]
        ("phase", "i8"),
        ("y", "f8", (STRUCTURE,)),  # structure; in a contact of the pair: x_1*, v_1*, see `contact_step`
        ("d", "f8"),  # flight: sphere relative to the superior base, x_2 − x_1 [m]; contact: the same where it touched
        ("d_rate", "f8"),  # its rate [m/s]
        ("slide", "f8"),  # flight: which way the sphere slides on a guide with friction, −1, 0 or 1
        ("side", "f8"),  # wall that is touched or presses, −1 left, 1 right, 0 none
        ("w", "f8"),  # contact: square root of the indentation [m^0.5]
        ("speed", "f8"),  # contact: rate of the indentation δ' [m/s], positive while it grows
        ("deepest", "f8"),  # contact: the largest w so far [m^0.5]
        ("per_v0", "f8"),  # contact: 1 over the approach speed, floored [s/m]
        ("tabulated", "i8"),  # contact: from here to the next state it is one tabulated outcome
        ("h", "f8"),  # contact: length of the step that starts here [s/m^0.5], 0 where none does
        ("released", "f8"),  # indentation at which a wall let the sphere go, until it is out of there [m]
        ("released_side", "f8"),  # which wall that is
        ("next_h", "f8"),  # contact: what the step control proposes [s/m^0.5]
        ("begin_tick", "i8"),  # contact: the tick in which it began,
        ("begin_t", "f8"),  # the time since the start of that tick [s],
        ("approach", "f8"),  # the speed δ' [m/s]; and of the contact so far
        ("elapsed", "f8"),  # its duration [s],
        ("peak_force", "f8"),  # [N],
        ("impulse", "f8"),  # ∫ F dt [N s],
        ("lost", "f8"),  # the energy lost [J]
        ("begin_d", "f8"),  # flight: d where it began [m]
    ],
    align=True,
)

LEDGER = np.dtype([(name, "f8") for name in ("work", "columns", "shaker", "contact", "friction")])
"""Energies since the reset [J]: work of the drive, losses by place."""

IMPACT_COLUMNS = (
    "tick",
    "offset",
    "wall",
    "approach_speed",
    "separation_speed",
    "peak_force",
    "peak_indentation",
    "impulse",
    "duration",
    "energy_lost",
)
IMPACT = np.dtype([(name, "i8" if name == "tick" else "i1" if name == "wall" else "f8") for name in IMPACT_COLUMNS])
"""One row per finished contact: `tick` and `offset` [s] of its start; see `blocks.IMPACTS` for the rest."""

LOG = np.dtype([("states", "i8"), ("impacts", "i8")])
"""How many rows of the history and of the impacts are filled."""

FLIGHT = np.dtype(
    [
        ("omega", "f8"),  # the drive that both answers belong to [rad/s]
        ("system", "i8"),  # the linear system they belong to
        ("validity", "f8"),  # time for which a Taylor polynomial holds [s]
        ("answer", "c16", (STRUCTURE,)),  # H: to a drive of constant amplitude [y per u]
        ("growth_answer", "c16", (STRUCTURE,)),  # G: to one whose amplitude grows [y s per u]
        ("steady", "c16", (STRUCTURE,)),  # P [as y] and Q [as y, per s] of y_p(t) = Im[(P + Q t) exp(jωt)]
        ("growing", "c16", (STRUCTURE,)),
        ("forced", "c16", (ORDERS,)),  # P and Q of x_1 and its derivatives
        ("forced_growing", "c16", (ORDERS,)),
        ("forced_size", "f8", (ORDERS,)),  # a bound on each within the segment
        ("begin", "f8"),  # t_b: when the flight began [s]
        ("friction_force", "f8"),  # constant force on the structure [N]: guide friction
        ("modal", "c16", (STRUCTURE,)),  # C_n: amplitude of each mode at `begin`
        ("wave", "c16", (ORDERS, STRUCTURE)),  # its part in x_1 and its derivatives then
        ("wave_size", "f8", (ORDERS, STRUCTURE)),
        ("x_1", "f8", (ORDERS,)),  # x_1[k] is the k-th derivative of x_1 where it was evaluated last [m/s^k];
        ("bound", "f8"),  # a bound on the first one that was not evaluated, from there on
        ("y", "f8", (STRUCTURE,)),  # the structure's state where it was evaluated last
    ],
    align=True,
)
"""What is known of the flight under way."""

CONTACT_STEP = np.dtype(
    [
        ("path", "f8", (STRUCTURE, STEP_TERMS)),  # Taylor polynomials of the pair's y about the start of the step
        (
            "acceleration",
            "f8",
            (STEP_TERMS,),
        ),  # of a_r, relative, pressing sphere and wall together [m/s²]
        ("w", "f8", (STAGES,)),  # at the stages: sqrt of the indentation [m^0.5],
        ("speed", "f8", (STAGES,)),  # δ' [m/s],
        ("since", "f8", (STAGES,)),  # time since the start of the step [s],
        ("acceleration_at", "f8", (STAGES,)),  # the relative acceleration, correction included [m/s²],
        ("force", "f8", (STAGES,)),  # F [N],
        ("lossy", "f8", (STAGES,)),  # the part of it that dissipates [N],
        ("force_by_w", "f8", (STAGES,)),  # ∂F/∂w,
        ("force_by_speed", "f8", (STAGES,)),  # ∂F/∂δ',
        ("speed_slope", "f8", (STAGES,)),  # dδ'/dχ [m^1.5/s²],
        ("speed_slope_by_w", "f8", (STAGES,)),  # its derivatives
        ("speed_slope_by_speed", "f8", (STAGES,)),
        ("correction", "f8", (STRUCTURE, STAGES)),  # z, what the indentation moves the pair by, over side · σ,
        ("correction_slope", "f8", (STRUCTURE, STAGES)),  # and dz/dχ
        ("newton", "f8", (STAGES, STAGES)),  # what Newton's method multiplies the residuals of the equations with
        ("residual", "f8", (STAGES,)),
        ("dense", "f8", (STAGES + 1,)),  # coefficients of the dense output δ'(x), see `contact_step` [m/s],
        ("dense_length", "f8"),  # the length of the step it belongs to, 0 where none is known [s/m^0.5],
        ("dense_since", "f8"),  # and how far from its start the next one starts [s/m^0.5]
        ("fastest_time", "f8"),  # time in which the fastest motion of structure or drive goes one radian [s]
        ("radian", "f8"),  # time in which the contact itself goes one radian [s]
        ("turned_at", "f8"),  # the branch of the law that the step is on, see `contact.law` [m^0.5]
        ("start_speed_slope", "f8"),  # dδ'/dχ at the start of the step [m^1.5/s²]
        ("start_force", "f8"),  # F there [N]
        ("tolerance", "f8"),  # how wrong the step's speeds may be [m/s],
        ("goal", "f8"),  # and how near Newton's method must come to what the step says [m/s]
        ("terms", "i8"),  # Taylor terms that suffice for the step
        ("validity", "f8"),  # time for which they hold [s]
        ("rest", "f8"),  # time left to the end of the drive segment [s]
        ("y", "f8", (STRUCTURE,)),  # the pair's state where it was evaluated last
    ],
    align=True,
)
"""One step of a contact."""


def record(kind: np.dtype[np.void], rows: int = 1) -> Any:
    """Return zeroed rows of a record type, shape (rows,), whose elements have named fields in plain Python too."""
    return with_fields(np.zeros(rows, kind))


PRESCRIBED, CURRENT, VOLTAGE = range(3)
DRIVES = ("prescribed", "current", "voltage")
LOOSE, HELD = range(2)
"""The linear systems: with the sphere loose (mass m_1), and held by the superior base (m_1 + m)."""

PARAMETERS = np.dtype(
    [
        ("drive", "i8"),  # PRESCRIBED, CURRENT or VOLTAGE
        ("sphere_present", "i8"),
        ("m_1", "f8"),  # superior base [kg]
        ("c_1", "f8"),  # columns [N s/m]
        ("k_1", "f8"),  # [N/m]
        ("m_base", "f8"),  # armature and inferior base [kg]
        ("c_f", "f8"),  # suspension of the inferior base [N s/m]
        ("k_f", "f8"),  # [N/m]
        ("force_factor", "f8"),  # K_f of the coil [N/A]
        ("resistance", "f8"),  # coil [Ω]
        ("per_inductance", "f8"),  # [1/H]
        ("m", "f8"),  # sphere [kg]
        ("m_eff", "f8"),  # m m_1 / (m + m_1) [kg]
        ("per_m_eff", "f8"),  # reciprocals, because a division costs as much as the rest of a line
        ("per_m_1", "f8"),
        ("per_m_pair", "f8"),
        ("per_m_base", "f8"),
        ("share", "f8"),  # σ = m / (m_1 + m): the structure's part in a relative motion
        ("pair_stiffness", "f8"),  # σ k_1 / m_1 [1/s²]: what the columns do to the indentation
        ("pair_damping", "f8"),  # σ c_1 / m_1 [1/s]
        ("half_gap", "f8"),  # [m]
        ("friction", "f8"),  # μ g [m/s²]
        ("stiffness", "f8"),  # the contact law's numbers, see `contact.law.Force`
        ("factor", "f8"),
        ("restitution", "f8"),
        ("rigid", "i8"),
        ("clipped", "i8"),
        ("remembers", "i8"),
        ("time_scale", "f8"),  # t_0 = time_scale v0^time_power
        ("time_power", "f8"),
        ("speed_floor", "f8"),  # of the approach speed in c = a K / v0 [m/s]
        ("touch_speed", "f8"),  # the least approach speed a contact can start with [m/s]
        ("fastest", "f8"),  # rate of the fastest mode [1/s]
        ("rtol", "f8"),
    ],
    align=True,
)
"""The scalars of the equations of motion, SI."""

SYSTEM = np.dtype(
    [
        ("states", "i8"),
        ("modes", "i8"),
        ("rate", "c16", (STRUCTURE,)),  # λ_n [1/s]
        ("right", "c16", (STRUCTURE, STRUCTURE)),  # Φ[n, state], doubled where a pair is kept once
        ("left", "c16", (STRUCTURE, STRUCTURE)),  # Γ[n, state]
        ("b_0", "f8", (STRUCTURE,)),
        ("b_1", "f8", (STRUCTURE,)),
        ("static", "f8", (STRUCTURE,)),  # answer to a constant unit force on the superior base
    ],
    align=True,
)
"""One linear system y' = M y + b_0 u + b_1 u', by its modes; see `linear`."""
