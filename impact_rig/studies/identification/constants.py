# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The constants that are identified, as logarithms, and the rig that they make."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from impact_rig.config.tree import Value
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.studies.identification.fisher import Real

NAMES = ("f_n", "ζ", "m_1", "K_f", "k_f", "M", "c_f")
"""Structure: natural frequency, damping ratio, mass. Shaker: force factor, suspension, mass m_a + m_b, damping."""
UNITS = ("Hz", "-", "kg", "N/A", "N/m", "kg", "N s/m")
SCALED = ("m_1", "K_f", "k_f", "M", "c_f")
"""Forces and masses: multiplied by one factor they give the same motion, unless something of known mass takes part."""
SCALE = np.array([float(name in SCALED) for name in NAMES])
"""The direction of that factor."""


START = np.log([9.0, 0.005, 0.2, 6.0, 8000.0, 2.5, 60.0])
"""Where a fit begins: round numbers in the right order of magnitude."""


def logarithms(config: RigConfig) -> Real:
    """Return the logarithms of a rig's constants, in the order of `NAMES`."""
    structure, shaker = config.structure, config.shaker
    return np.log([
        structure.natural_frequency_hz, structure.damping_ratio, structure.mass_kg, shaker.force_factor_n_a,
        shaker.suspension_stiffness_n_m, shaker.armature_mass_kg + shaker.base_mass_kg, shaker.damping_n_s_m,
    ])  # fmt: skip


def rig(base: RigConfig, log_constants: Real) -> RigConfig:
    """Return `base` with these constants; the share of the armature in the moving mass stays.

    Raises:
        ConfigError: they make no rig.
    """
    values = dict(zip(NAMES, (float(value) for value in np.exp(log_constants)), strict=True))
    moving = base.shaker.armature_mass_kg + base.shaker.base_mass_kg
    changes: Mapping[str, Value] = {
        "structure.natural_frequency_hz": values["f_n"],
        "structure.damping_ratio": values["ζ"],
        "structure.mass_kg": values["m_1"],
        "shaker.force_factor_n_a": values["K_f"],
        "shaker.suspension_stiffness_n_m": values["k_f"],
        "shaker.armature_mass_kg": base.shaker.armature_mass_kg * values["M"] / moving,
        "shaker.base_mass_kg": base.shaker.base_mass_kg * values["M"] / moving,
        "shaker.damping_n_s_m": values["c_f"],
    }
    return from_flat(base, changes)
