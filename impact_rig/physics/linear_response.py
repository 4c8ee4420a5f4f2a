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
"""Closed-form frequency responses without the sphere: superior over inferior base, inferior base over current."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.physics.linear import MechanicsSetup, constants


def transmissibility(config: MechanicsSetup, frequency_hz: NDArray[np.float64] | float) -> NDArray[np.complex128]:
    """Return the transmissibility X_1 / X_b of the rig without its sphere, in closed form.

    It is the displacement of the structure (superior base) divided by that of its base (inferior base):

        X_1 / X_b = (1 + 2iζr) / (1 − r² + 2iζr),   r = f / f_n

    This is the response of a base-excited oscillator. Source: S. S. Rao, Mechanical Vibrations, section 3.6.

    Args:
        config: configuration of the rig, of which `structure.natural_frequency_hz` f_n and `structure.damping_ratio` ζ
            are used.
        frequency_hz: frequencies f [Hz], a number or an array of any shape.

    Returns:
        Complex ratio of the displacement amplitudes, in the shape of `frequency_hz`. Its magnitude is the displacement
        transmissibility DT, its argument the phase of x_1 relative to x_b [rad].

    Examples:
        >>> import numpy as np, impact_rig
        >>> ratio = impact_rig.transmissibility(impact_rig.RigConfig(), np.array([5.0, 9.1, 20.0]))
        >>> print(np.abs(ratio).round(2))
        [  1.43 110.42   0.26]

    See Also:
        - `simulate`: measures DT, also with the sphere.
    """
    structure = config.structure
    r = np.asarray(frequency_hz, float) / structure.natural_frequency_hz
    loss = 2.0j * structure.damping_ratio * r
    ratio: NDArray[np.complex128] = (1.0 + loss) / (1.0 - r**2 + loss)
    return ratio


def base_per_ampere(config: MechanicsSetup, frequency_hz: NDArray[np.float64] | float) -> NDArray[np.complex128]:
    """Return the complex displacement X_b of the inferior base per ampere of coil current, without the sphere [m/A].

    X_b / I = K_f / [k_f − (m_a + m_b) ω² + iωc_f − m_1 ω² T], with T = X_1 / X_b from `transmissibility`. The last term
    is the force m_1 ω² X_1 of the structure on the base. The result has the shape of `frequency_hz`.
    """
    c = constants(config)
    omega = 2.0 * math.pi * np.asarray(frequency_hz, float)
    pushed_back = c.m_1 * omega**2 * transmissibility(config, frequency_hz)
    per_ampere: NDArray[np.complex128] = c.force_factor / (
        c.k_f - c.m_base * omega**2 + 1j * omega * c.c_f - pushed_back
    )
    return per_ampere
