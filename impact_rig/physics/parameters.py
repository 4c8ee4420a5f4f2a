# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The numbers of the equations of motion as the kernels use them: records with named fields, SI."""

from __future__ import annotations

import numpy as np

from impact_rig.physics.state import STRUCTURE

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
        ("c_f", "f8"),  # table [N s/m]
        ("k_f", "f8"),  # [N/m]
        ("force_factor", "f8"),  # [N/A]
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
        ("time_scale", "f8"),  # t_0 = time_scale v^time_power
        ("time_power", "f8"),
        ("speed_floor", "f8"),  # of the approach speed in c = a K / v [m/s]
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
        ("rate", "c16", (STRUCTURE,)),  # λ_k [1/s]
        ("right", "c16", (STRUCTURE, STRUCTURE)),  # R[k, state], doubled where a pair is kept once
        ("left", "c16", (STRUCTURE, STRUCTURE)),  # L[k, state]
        ("b_0", "f8", (STRUCTURE,)),
        ("b_1", "f8", (STRUCTURE,)),
        ("static", "f8", (STRUCTURE,)),  # answer to a constant unit force on the superior base
    ],
    align=True,
)
"""One linear system y' = M y + b_0 u + b_1 u', by its modes; see `linear`."""
