# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Kelvin–Voigt contact: linear spring and damper, the textbook model with a closed form.

    F = k δ + c δ',   k = m (π² + ln²e) / t_c²,   c = −2 m ln(e) / t_c        m: effective mass, t_c: contact time

The force jumps to c v0 at the first touch and pulls just before the end. Released at zero indentation (as published)
it returns e; released at zero force it returns more.
"""

from __future__ import annotations

import math

import attrs

from impact_rig.arithmetic.scalars import PI, log
from impact_rig.config.fields import choice
from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force, contact_time_s


def _spring_damper(
    stiffness: float,
    factor: float,
    per_v0: float,  # noqa: ARG001  # this force knows neither the approach speed
    turned_at: float,  # noqa: ARG001  # nor its past
    w: float,
    speed: float,
) -> tuple[float, float, float, float, float]:
    """F = k w² + c δ'."""
    return stiffness * w * w, factor * speed, 0.5 * stiffness * w * w * w * w, 2.0 * stiffness * w, factor


@attrs.frozen
class KelvinVoigt(ContactLaw):
    """Linear contact with restitution e and contact time t_c [s]."""

    name = "kelvin_voigt"
    formula = "linear spring and damper, released at δ = 0; at F = 0 it returns 0.434"
    source = "Nagurka & Huang (2004), Proc. American Control Conference"
    returns = 0.350
    contact_time_s: float = contact_time_s()
    release: str = choice(
        "position", ("position", "force"), "kelvin_voigt lets go at zero indentation, or already at zero force."
    )

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""
        log_e = log(self.restitution)
        stiffness = pair.effective_mass * (PI * PI + log_e * log_e) / (self.contact_time_s * self.contact_time_s)
        damping = -2.0 * pair.effective_mass * log_e / self.contact_time_s
        return Force(_spring_damper, stiffness, damping, 1.0, self.restitution, clipped=self.release == "force")

    def realised_restitution(self) -> float:
        """Return e, or the larger value that release at zero force gives.

        With decay rate β = −ln(e)/t_c and ω_d = π/t_c, the force vanishes where tan(ω_d t) = −2 β ω_d / (ω_d² − β²).
        """
        if self.release == "position":
            return self.restitution
        beta, omega = -math.log(self.restitution), math.pi  # in units of 1 / t_c
        angle = math.pi - math.atan2(2.0 * beta * omega, omega**2 - beta**2)
        # speed of δ = (v0/ω) e^(−βt) sin ωt at the instant the force vanishes
        speed = math.exp(-beta * angle / omega) * (math.cos(angle) - beta / omega * math.sin(angle))
        return -speed
