"""Contact laws, one file each, found by name.

docs/physics.md shows how to add one. A law of the Hunt–Crossley form says only its factor; any other brings a force of
its own, as `base` explains.
"""

from __future__ import annotations

from impact_rig.config import Contact
from impact_rig.physics.contact.base import CompiledForce, ContactLaw, ContactPair, Force, HystereticLaw
from impact_rig.physics.contact.exact import Exact
from impact_rig.physics.contact.flores import Flores
from impact_rig.physics.contact.gonthier import Gonthier
from impact_rig.physics.contact.herbert_mcwhannell import HerbertMcWhannell
from impact_rig.physics.contact.hertz import Hertz
from impact_rig.physics.contact.hu_guo import HuGuo
from impact_rig.physics.contact.hunt_crossley import HuntCrossley
from impact_rig.physics.contact.impulsive import Restitution
from impact_rig.physics.contact.kelvin_voigt import KelvinVoigt
from impact_rig.physics.contact.lankarani_nikravesh import LankaraniNikravesh
from impact_rig.physics.contact.lee_wang import LeeWang
from impact_rig.physics.contact.walton_braun import WaltonBraun
from impact_rig.physics.contact.zhiying_qishao import ZhiyingQishao

_LAWS: tuple[type[ContactLaw], ...] = (
    Flores,
    Hertz,
    HuntCrossley,
    HerbertMcWhannell,
    LeeWang,
    LankaraniNikravesh,
    Gonthier,
    ZhiyingQishao,
    HuGuo,
    Exact,
    KelvinVoigt,
    WaltonBraun,
    Restitution,
)

LAWS: dict[str, type[ContactLaw]] = {law.name: law for law in _LAWS}
"""Every contact law by its name."""


def from_config(contact: Contact) -> ContactLaw:
    """Return the configured law; `calibration: exact` replaces a Hunt–Crossley factor by the one that returns e."""
    law = LAWS[contact.law].from_config(contact)
    if contact.calibration == "exact" and isinstance(law, HystereticLaw) and not isinstance(law, Hertz):
        return Exact(contact.restitution)
    return law


__all__ = ["LAWS", "CompiledForce", "ContactLaw", "ContactPair", "Force", "HystereticLaw", "from_config"]
