# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""Contact laws, one file each, found by name; docs/extending.md shows how to add one.

`LAWS` holds every law that a module of this folder defines, in alphabetical order of names. Nothing else lists them:
the configuration's choices and its `contact` section, the tables of the documentation and the tests are made from it.
"""

from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force, HystereticLaw
from impact_rig.physics.contact.registry import LAWS
from impact_rig.physics.contact.section import Contact, from_config

__all__ = ["LAWS", "Contact", "ContactLaw", "ContactPair", "Force", "HystereticLaw", "from_config"]
