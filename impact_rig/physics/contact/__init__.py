# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Contact laws, one file each, found by name; docs/extending.md shows how to add one.

`LAWS` holds every law that a module of this folder defines, in alphabetical order of names. Nothing else lists them:
the configuration's choices and its `contact` section, the tables of the documentation and the tests are made from it.
"""

from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force, HystereticLaw
from impact_rig.physics.contact.registry import LAWS
from impact_rig.physics.contact.section import Contact, from_config

__all__ = ["LAWS", "Contact", "ContactLaw", "ContactPair", "Force", "HystereticLaw", "from_config"]
