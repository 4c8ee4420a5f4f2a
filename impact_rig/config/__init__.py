"""The rig's configuration: frozen sections with units, ranges and origins; one validator for all ways in."""

from impact_rig.config.fields import FieldInfo, Origin
from impact_rig.config.load import dump, fields, from_flat, load, to_flat
from impact_rig.config.mechanics import CONTACT_LAWS, Barriers, Contact, Drive, Shaker, Sphere, Structure
from impact_rig.config.operation import Daq, Output, Pluck, Step, Time
from impact_rig.config.rig import RigConfig

__all__ = [
    "CONTACT_LAWS",
    "Barriers",
    "Contact",
    "Daq",
    "Drive",
    "FieldInfo",
    "Origin",
    "Output",
    "Pluck",
    "RigConfig",
    "Shaker",
    "Sphere",
    "Step",
    "Structure",
    "Time",
    "dump",
    "fields",
    "from_flat",
    "load",
    "to_flat",
]
