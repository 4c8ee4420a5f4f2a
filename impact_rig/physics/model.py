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
"""`Model`: the numbers that the compiled event loop needs, built once from a configuration.

It also sets the default tolerance with which contacts are integrated, `CONTACT_RTOL`.
"""

from __future__ import annotations

from functools import lru_cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic.elementary import power
from impact_rig.kernels import Fields, with_fields
from impact_rig.physics import contact as contact_laws
from impact_rig.physics.contact import ContactPair, Force
from impact_rig.physics.contact.law import FORCE, CompiledForce, compiled_force
from impact_rig.physics.flight import bound_omega
from impact_rig.physics.linear import (
    Constants,
    MechanicsSetup,
    constants,
    effective_mass_kg,
    hertz_stiffness_n_m32,
    input_vectors,
    modes,
    sphere_mass_kg,
    state_matrix,
    static_answer,
)
from impact_rig.physics.outcome import TABLE, tabulate
from impact_rig.physics.state import DRIVES, PARAMETERS, PRESCRIBED, SYSTEM, V1, record

STANDARD_GRAVITY = 9.80665
CONTACT_RTOL = 1e-9
"""Default relative tolerance of each integration step of a contact."""


class Model(NamedTuple):
    """Constants of a simulation in the form that kernels use, valid until the configuration of the mechanics changes.

    Attributes:
        parameters: one record of PARAMETERS: the numbers of the equations of motion.
        systems: two records of SYSTEM: the linear systems with the sphere loose and attached.
        table: one record of `outcome.TABLE`: outcomes of fast contacts. If none are tabulated, its field `high` is 0,
            and contacts are integrated.
        law: the contact law's compiled force.
    """

    parameters: NDArray[np.void]
    systems: NDArray[np.void]
    table: NDArray[np.void]
    law: CompiledForce


MODEL = Fields(Model, (PARAMETERS, SYSTEM, TABLE, FORCE))


def build(config: MechanicsSetup, rtol: float = CONTACT_RTOL, kind: str | None = None) -> Model:
    """Return the model of a configuration; `kind`, if given, replaces its `drive.kind`.

    `rtol` is the relative tolerance of each integration step of a contact. The outcomes of contacts are tabulated only
    if `rtol` is at least `CONTACT_RTOL` and the contact law is scale-free. Otherwise every contact is integrated,
    except at a rigid wall, where a contact takes no time.

    Raises:
        ConfigError: structure and shaker have no usable modes or no position of rest.
    """
    c, kind = constants(config), kind or config.drive.kind
    mass = sphere_mass_kg(config.sphere)
    m_eff = effective_mass_kg(c.m_1, mass)
    law = contact_laws.from_config(config.contact)
    force = law.force(ContactPair(hertz_stiffness_n_m32(config.sphere, config.barriers), m_eff))
    systems, fastest = _systems(c, kind, mass)
    p = SimpleNamespace()  # setting one field of a record takes as long as setting all of these
    p.drive_kind, p.sphere_present = DRIVES.index(kind), config.sphere.present
    p.m_1, p.c_1, p.k_1, p.m_base, p.c_f, p.k_f = c.m_1, c.c_1, c.k_1, c.m_base, c.c_f, c.k_f
    p.force_factor, p.resistance, p.per_inductance = c.force_factor, c.resistance, 1.0 / c.inductance
    p.m, p.m_eff, p.per_m_eff, p.per_m_1 = mass, m_eff, 1.0 / m_eff, 1.0 / c.m_1
    p.per_m_pair, p.share = 1.0 / (c.m_1 + mass), mass / (c.m_1 + mass)
    p.per_m_base = 0.0 if p.drive_kind == PRESCRIBED else 1.0 / c.m_base  # nothing moves a prescribed base
    p.slowing_by_depth, p.slowing_by_speed = p.share * c.k_1 / c.m_1, p.share * c.c_1 / c.m_1
    p.half_gap = config.barriers.gap_m / 2.0
    p.friction_acceleration = config.sphere.guide_friction * STANDARD_GRAVITY
    _set_force(p, force, m_eff)
    p.speed_floor = config.contact.speed_floor_m_s
    p.touch_speed = 1e-6 * p.speed_floor
    p.fastest, p.rtol = fastest, rtol
    tabulated = force.scale_free and rtol >= CONTACT_RTOL
    table = _table(force._replace(stiffness=1.0)).copy() if tabulated else record(TABLE)
    return Model(_parameters(p), systems, with_fields(table), compiled_force(force.function))


def _parameters(p: SimpleNamespace) -> Any:
    """Return one record of PARAMETERS with the attributes of `p`; fields that `p` does not set are zero.

    Raises:
        AttributeError: PARAMETERS has no field for an attribute of `p`.
    """
    names = PARAMETERS.names or ()
    if unknown := vars(p).keys() - set(names):
        raise AttributeError(f"PARAMETERS has no {', '.join(sorted(unknown))}")
    rows = np.zeros(1, PARAMETERS)
    rows[0] = tuple(getattr(p, name, 0) for name in names)
    return with_fields(rows)


def _set_force(p: SimpleNamespace, force: Force, m_eff: float) -> None:
    """Set the attributes of `p` that depend on the contact law, for a pair of bodies of effective mass `m_eff` [kg]."""
    p.stiffness, p.factor, p.restitution = force.stiffness, force.factor, force.restitution
    p.rigid, p.lets_go, p.remembers = force.rigid, force.lets_go, force.remembers
    if not force.rigid:
        p.time_scale = power(m_eff / force.stiffness, 1.0 / (force.exponent + 1.0))
        p.time_power = (1.0 - force.exponent) / (1.0 + force.exponent)


@lru_cache(maxsize=32)
def _table(force: Force) -> Any:
    """Return the table of contact outcomes of a force in dimensionless units, in which all masses are 1.

    The stiffness of `force` must be 1 as well.
    """
    return tabulate(unit_parameters(force), compiled_force(force.function))


def unit_parameters(force: Force) -> Any:
    """Return one record of PARAMETERS for contacts of a force in dimensionless units, in which all masses are 1.

    The stiffness is that of `force`, so the caller must pass a force whose stiffness is 1 as well.
    """
    p = SimpleNamespace(m=1.0, m_1=1.0, m_eff=1.0, per_m_eff=1.0, speed_floor=1.0)
    _set_force(p, force, 1.0)
    return _parameters(p)


@lru_cache(maxsize=32)
def _systems(c: Constants, kind: str, sphere_kg: float) -> Any:
    """Return the linear systems with the sphere loose and attached, and the rate of the fastest mode of both [1/s].

    The result is cached. It does not depend on gap and contact law, so a change of these does not compute the modes
    again.
    """
    systems = record(SYSTEM, 2)
    for system, mass in zip(systems, (c.m_1, c.m_1 + sphere_kg), strict=True):
        matrix = state_matrix(c, kind, mass)
        b_0, b_1 = input_vectors(c, kind, mass)
        found, n = modes(matrix), len(b_0)
        kept = len(found.rate)
        unit_force = np.zeros(n)
        unit_force[V1] = 1.0 / mass
        system.states, system.modes = n, kept
        system.rate[:kept] = found.rate
        system.right[:kept, :n], system.left[:kept, :n] = found.right, found.left
        system.b_0[:n], system.b_1[:n] = b_0, b_1
        system.static[:n] = static_answer(matrix, unit_force)
    return systems, max(bound_omega(system, 0.0) for system in systems)
