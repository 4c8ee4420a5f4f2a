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
"""Contact laws with a linear spring, whose stiffness follows from a contact time t_c and a restitution e.

**Kelvin–Voigt**: linear spring and damper, the textbook model with a closed form.

    F = k δ + c δ',   k = m (π² + ln²e) / t_c²,   c = −2 m ln(e) / t_c        m: effective mass, t_c: contact time

δ is the indentation and v0 the approach speed. The force jumps to c v0 at the first touch and pulls just before the
end. If the sphere is released at zero indentation (as published), the restitution is e; if it is released at zero
force, the restitution is larger.

**Walton–Braun**: loading along one line, unloading along a steeper one. Plastic yielding, not damping, causes the loss.

    loading    F = k_1 δ
    unloading  F = k_2 (δ − δ_p),   k_2 = k_1 / e²,   δ_p = (1 − e²) δ_max        below the largest indentation δ_max

The restitution is e whatever the speed, because the areas under the two lines are as 1 : e². The sphere is released at
δ_p, where the force vanishes, and flies on from there. The residual indentation δ_p lasts for one contact only. k_1
follows from the contact time, a quarter period on each line: t_c = (π/2) (1 + e) √(m_eff / k_1).

A pressed sphere would ring on the unloading line for ever. Below `contact.speed_floor_m_s` the ringing is averaged: the
sphere moves with the superior base as one body, and the energy of the ringing is counted as lost.
"""

from __future__ import annotations

import math
from typing import Any

import attrs

from impact_rig.arithmetic.elementary import PI, log
from impact_rig.config.fields import choice, quantity
from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force


def contact_time_s() -> Any:
    """Return a new attrs field for the setting `contact_time_s`: the contact time t_c of a linear law, 1 µs … 10 ms."""
    return quantity(45e-6, "s", "Contact time that gives a linear law its stiffness.", at_least=1e-6, at_most=0.01)


def _spring_damper(
    stiffness: float,
    factor: float,
    per_v0: float,  # noqa: ARG001  # this force depends neither on the approach speed
    turned_at: float,  # noqa: ARG001  # nor on the past
    w: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """Compute the Kelvin–Voigt force F = k δ + c δ' and its derivatives, in the form that `contact.law` describes.

    `stiffness` is k, `factor` is c, `w` is √δ, and `speed` is δ'. The results are the elastic and the lossy part of F
    [N], the stored energy [J], ∂F/∂w and ∂F/∂δ'.
    """
    return stiffness * w * w, factor * speed, 0.5 * stiffness * w * w * w * w, 2.0 * stiffness * w, factor


@attrs.frozen
class KelvinVoigt(ContactLaw):
    """Contact law of a linear spring and damper, for a given restitution e and contact time t_c [s].

    With `release: position` (the default), a contact ends at zero indentation and has exactly e and t_c. With `release:
    force`, a contact ends at zero force. It is then shorter, and its restitution is larger unless e = 1.
    """

    name = "kelvin_voigt"
    formula = "linear spring and damper, released at δ = 0; at F = 0 it returns 0.434"
    source = "Nagurka & Huang (2004), Proc. American Control Conference"
    returns = 0.350
    contact_time_s: float = contact_time_s()
    release: str = choice(
        "position",
        ("position", "force"),
        "End of a contact of kelvin_voigt: at zero indentation, or already at zero force.",
    )

    def force(self, pair: ContactPair) -> Force:
        """Return the force function of spring and damper, with constants for the effective mass of `pair`."""
        log_e = float(log(self.restitution))
        stiffness = pair.effective_mass * (PI * PI + log_e * log_e) / (self.contact_time_s * self.contact_time_s)
        damping = -2.0 * pair.effective_mass * log_e / self.contact_time_s
        return Force(_spring_damper, stiffness, damping, 1.0, self.restitution, lets_go=self.release == "force")

    def realised_restitution(self) -> float:
        """Return the restitution that a contact really has.

        It is e if `release` is `position`. If `release` is `force`, it is larger unless e = 1. With decay rate β =
        −ln(e)/t_c and ω_d = π/t_c, the force vanishes where tan(ω_d t) = −2 β ω_d / (ω_d² − β²).
        """
        if self.release == "position":
            return self.restitution
        beta, omega = -math.log(self.restitution), math.pi  # in units of 1 / t_c
        angle = math.pi - math.atan2(2.0 * beta * omega, omega * omega - beta * beta)
        # speed of δ = (v0/ω) e^(−βt) sin ωt at the instant the force vanishes
        speed = math.exp(-beta * angle / omega) * (math.cos(angle) - beta / omega * math.sin(angle))
        return -speed


def _elastoplastic(
    stiffness: float,
    factor: float,
    per_v0: float,  # noqa: ARG001  # this force does not depend on the speed
    turned_at: float,
    w: float,
    speed: float,  # noqa: ARG001  # as above
) -> tuple[float, float, float, float, float]:
    """Compute the Walton–Braun force F and its derivatives, in the form that `contact.law` describes.

    `stiffness` is the loading stiffness k_1 and `factor` is e². With `turned_at` = 0 the contact loads, otherwise it
    unloads from the indentation turned_at². The results are the elastic and the lossy part of F [N], the stored energy
    [J], ∂F/∂w and ∂F/∂δ'.
    """
    if turned_at == 0.0:
        force = stiffness * w * w
        return factor * force, (1.0 - factor) * force, 0.5 * factor * force * w * w, 2.0 * stiffness * w, 0.0
    unloading = stiffness / factor
    pressed = w * w - (1.0 - factor) * turned_at * turned_at
    return unloading * pressed, 0.0, 0.5 * unloading * pressed * pressed, 2.0 * unloading * w, 0.0


@attrs.frozen
class WaltonBraun(ContactLaw):
    """Elastoplastic contact law: loading along a straight line, unloading along a steeper one, without damping.

    It has the restitution e and the contact time t_c [s].
    """

    name = "walton_braun"
    formula = "loading along k δ, unloading along k/e² (δ − δ_p), no damping"
    source = "Walton & Braun (1986), J. Rheology 30, 949–980"
    returns = 0.350
    contact_time_s: float = contact_time_s()

    def loading_stiffness(self, pair: ContactPair) -> float:
        """Return the loading stiffness k_1 [N/m] that gives the contact time t_c for the effective mass of `pair`."""
        time_scale = 2.0 * self.contact_time_s / (PI * (1.0 + self.restitution))
        return pair.effective_mass / (time_scale * time_scale)

    def force(self, pair: ContactPair) -> Force:
        """Return the force function with the loading stiffness k_1 for the effective mass of `pair`."""
        squared = self.restitution * self.restitution
        return Force(_elastoplastic, self.loading_stiffness(pair), squared, 1.0, self.restitution, remembers=True)

    def realised_restitution(self) -> float:
        """Return the nominal restitution e, which the two lines give exactly at every speed."""
        return self.restitution
