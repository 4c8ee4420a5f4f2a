"""`Model`: the numbers the compiled event loop needs, built once from a configuration."""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from impact_rig.config import RigConfig
from impact_rig.physics import contact as contact_laws
from impact_rig.physics.contact import ContactPair, ForceModel
from impact_rig.physics.linear import Constants, Modes, constants, input_vectors, modes, state_matrix, static_answer
from impact_rig.physics.properties import effective_mass_kg, hertz_stiffness_n_m32, sphere_mass_kg

STANDARD_GRAVITY = 9.80665
CONTACT_RTOL = 1e-9
"""Default relative tolerance of the contact integrators, of each step."""

PRESCRIBED, CURRENT, VOLTAGE = range(3)
DRIVES = ("prescribed", "current", "voltage")


class LinearSystem(NamedTuple):
    """One linear system (sphere loose or attached): modes, inputs and the static answer to a unit force on x_1."""

    modes: Modes
    b0: NDArray[np.float64]
    b1: NDArray[np.float64]
    static: NDArray[np.float64]


class Parameters(NamedTuple):
    """The scalars of the equations of motion; SI. Kept apart from arrays: compiled calls copy it for free."""

    c: Constants
    drive: int
    sphere_present: bool
    m: float
    m_eff: float
    per_m_eff: float  # reciprocals, because a division costs as much as the rest of a stage
    per_m_1: float
    per_m_pair: float
    per_m_base: float
    share: float  # m / (m_1 + m): the structure's part in a relative motion
    half_gap: float
    force: ForceModel
    speed_floor: float
    touch_speed: float  # the least approach speed a contact can start with
    friction: float  # μ g [m/s^2]
    rtol: float


class Model(NamedTuple):
    """Everything constant between two changes of the configuration."""

    p: Parameters
    loose: LinearSystem
    attached: LinearSystem


def build(config: RigConfig, rtol: float = CONTACT_RTOL) -> Model:
    """Return the model of a configuration.

    Raises:
        ConfigError: the masses and stiffnesses have no usable modes.
    """
    c = constants(config)
    kind = config.drive.kind
    mass = sphere_mass_kg(config.sphere)
    m_eff = effective_mass_kg(c.m_1, mass)
    pair = ContactPair(hertz_stiffness_n_m32(config.sphere, config.barriers), m_eff)
    force = contact_laws.from_config(config.contact).force_model(pair)
    floor = config.contact.speed_floor_m_s
    parameters = Parameters(
        c=c,
        drive=DRIVES.index(kind),
        sphere_present=config.sphere.present,
        m=mass,
        m_eff=m_eff,
        per_m_eff=1.0 / m_eff,
        per_m_1=1.0 / c.m_1,
        per_m_pair=1.0 / (c.m_1 + mass),
        per_m_base=1.0 / c.m_base,
        share=mass / (c.m_1 + mass),
        half_gap=config.barriers.gap_m / 2.0,
        force=force._replace(kind=int(force.kind)),
        speed_floor=floor,
        touch_speed=1e-6 * floor,
        friction=config.sphere.guide_friction * STANDARD_GRAVITY,
        rtol=rtol,
    )
    return Model(parameters, _system(c, kind, c.m_1), _system(c, kind, c.m_1 + mass))


@lru_cache(maxsize=64)  # a change of gap or law leaves both systems as they are
def _system(c: Constants, kind: str, mass: float) -> LinearSystem:
    matrix = state_matrix(c, kind, mass)
    b0, b1 = input_vectors(c, kind, mass)
    push = np.zeros(len(b0))
    push[1] = 1.0 / mass
    return LinearSystem(modes(matrix), b0, b1, static_answer(matrix, push))
