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
"""Contact law of a rigid wall: the contact takes no time, and the relative speed jumps from v to −e v.

The superior base takes up the change of the sphere's momentum at the same instant. A sphere that no longer bounces
stays on the wall and moves with the superior base, in phase ATTACHED.
"""

from __future__ import annotations

import attrs

from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force


def _never(
    stiffness: float,  # noqa: ARG001  # a rigid wall ignores all arguments
    factor: float,  # noqa: ARG001
    per_v0: float,  # noqa: ARG001
    turned_at: float,  # noqa: ARG001
    w: float,  # noqa: ARG001
    speed: float,  # noqa: ARG001
) -> tuple[float, float, float, float, float]:
    """Return zeros; the function only fills the interface, because the force of a rigid wall is never evaluated."""
    return 0.0, 0.0, 0.0, 0.0, 0.0


@attrs.frozen
class Restitution(ContactLaw):
    """Contact law of a rigid wall: a contact takes no time and reverses the relative speed v to −e v."""

    name = "restitution"
    formula = "instantaneous, δ' → −e δ'"
    source = "Newton (1687), Principia; Masri (1969) for impact dampers"
    returns = 0.350

    def force(self, pair: ContactPair) -> Force:  # noqa: ARG002  # an impulse needs no stiffness
        """Return a `Force` marked as rigid: the simulation then multiplies the relative speed by −e."""
        return Force(_never, 0.0, 0.0, 1.0, self.restitution, rigid=True)

    def realised_restitution(self) -> float:
        """Return the nominal restitution e, which a rigid wall gives exactly."""
        return self.restitution
