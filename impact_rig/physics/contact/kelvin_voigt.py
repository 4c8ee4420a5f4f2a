"""Kelvin–Voigt contact: linear spring and damper, the textbook model with a closed form.

    F = k δ + c δ',   k = m (π² + ln²e) / t_c²,   c = −2 m ln(e) / t_c        m: effective mass, t_c: contact time

Source: Nagurka & Huang (2004), A mass-spring-damper model of a bouncing ball, Proc. American Control Conference.
The force jumps to c v0 at the first touch and pulls just before the end. Released at zero indentation (as published)
it returns e;
released at zero force it returns more: 0.434 for e = 0.35.
"""

from __future__ import annotations

import math
from typing import ClassVar

import attrs

from impact_rig.arithmetic.elementary import PI, log
from impact_rig.config import Contact
from impact_rig.physics.contact.base import ContactPair, Force, check_restitution, compiled_force


@compiled_force
def _spring_damper(stiffness, factor, per_v0, turned_at, w, speed):  # type: ignore[no-untyped-def]  # noqa: ARG001
    """F = k w² + c δ'."""
    return stiffness * w * w, factor * speed, 0.5 * stiffness * w * w * w * w, 2.0 * stiffness * w, factor


@attrs.frozen
class KelvinVoigt:
    """Linear contact with restitution e and contact time t_c [s]; `pulls` keeps the tensile end of the force."""

    name: ClassVar[str] = "kelvin_voigt"
    restitution: float = attrs.field(validator=check_restitution)
    contact_time_s: float = attrs.field(default=45e-6, validator=attrs.validators.gt(0.0))
    pulls: bool = True

    def force(self, pair: ContactPair) -> Force:
        """Return the force between the bodies of `pair`."""
        log_e = log(self.restitution)
        stiffness = pair.effective_mass * (PI * PI + log_e * log_e) / (self.contact_time_s * self.contact_time_s)
        damping = -2.0 * pair.effective_mass * log_e / self.contact_time_s
        return Force(_spring_damper, stiffness, damping, 1.0, self.restitution, clipped=not self.pulls)

    def realised_restitution(self) -> float:
        """Return e, or the larger value that release at zero force gives.

        With decay rate β = −ln(e)/t_c and ω_d = π/t_c, the force vanishes where tan(ω_d t) = −2 β ω_d / (ω_d² − β²).
        """
        if self.pulls:
            return self.restitution
        beta, omega = -math.log(self.restitution), math.pi  # in units of 1 / t_c
        angle = math.pi - math.atan2(2.0 * beta * omega, omega**2 - beta**2)
        # speed of δ = (v0/ω) e^(−βt) sin ωt at the instant the force vanishes
        speed = math.exp(-beta * angle / omega) * (math.cos(angle) - beta / omega * math.sin(angle))
        return -speed

    @classmethod
    def from_config(cls, contact: Contact) -> KelvinVoigt:
        """Build the law from the configuration's `contact` section."""
        return cls(contact.restitution, contact.contact_time_s, contact.release == "position")
