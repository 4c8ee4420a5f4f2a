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
"""Registry of the contact laws by name, and the section `contact` of the rig's configuration.

`LAWS` holds every law that a module of this folder defines, in alphabetical order of names. The choices and fields of
the `contact` section, the tables of the documentation and the tests are made from `LAWS`. docs/how-to/extending.md
shows how to add a law as a new module in this folder.
"""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path
from typing import Any  # attrs attributes of any type

import attrs

from impact_rig.config.fields import Origin, choice, quantity
from impact_rig.physics.contact.law import ContactLaw, ContactPair, Force, declare, restitution

__all__ = ["LAWS", "Contact", "ContactLaw", "ContactPair", "Force", "from_config"]


def _found() -> dict[str, type[ContactLaw]]:
    laws: dict[str, type[ContactLaw]] = {}
    for place in pkgutil.iter_modules([str(Path(__file__).parent)]):
        module = importlib.import_module(f"{__package__}.{place.name}")
        own = (kind for kind in vars(module).values() if getattr(kind, "__module__", None) == module.__name__)
        for law in own:
            if isinstance(law, type) and issubclass(law, ContactLaw) and hasattr(law, "name"):
                assert law.name not in laws, f"two contact laws are called {law.name}: rename one"
                laws[law.name] = law
    return dict(sorted(laws.items()))


LAWS: dict[str, type[ContactLaw]] = _found()
"""Class of every contact law by the name with which `contact.law` of a configuration selects it, in alphabetical order.
"""

for _law in LAWS.values():
    declare(_law().force(ContactPair(1.0, 1.0)).function)


def _with_settings_of_laws(_section: type, own: list[attrs.Attribute[Any]]) -> list[attrs.Attribute[Any]]:
    """Return the attributes of the section `contact`: `own`, and the attributes that only contact laws define.

    attrs calls this function while it makes the class `Contact`. An AssertionError names an attribute to which two
    laws, or a law and `own`, give different defaults or metadata.
    """
    found = {attribute.name: attribute for attribute in own}
    for law in LAWS.values():
        for attribute in attrs.fields(law):
            known = found.setdefault(attribute.name, attribute.evolve(kw_only=True, inherited=False))
            same = (known.default, known.metadata) == (attribute.default, attribute.metadata)
            assert same, f"contact laws must give {attribute.name} the same default and metadata, two laws differ"
    return list(found.values())


@attrs.frozen(kw_only=True, field_transformer=_with_settings_of_laws)
class Contact:
    """Section `contact` of a configuration: the law that describes contacts of sphere and barrier, and its settings."""

    law: str = choice("flores", tuple(LAWS), "Contact law, by name.", Origin.PAPER)
    restitution: float = restitution()
    calibration: str = choice(
        "nominal",
        ("nominal", "exact"),
        "nominal: the law uses e as published; exact: the law exact, which rebounds with exactly e, replaces it, "
        f"unless it is one of {', '.join(name for name, law in LAWS.items() if not law.adjustable)}.",
        Origin.PAPER,
    )
    speed_floor_m_s: float = quantity(
        1e-3, "m/s", "Lower limit of v0 in c = a K / v0, which is singular at v0 = 0.", at_least=1e-6, at_most=0.1
    )


def from_config(contact: Contact) -> ContactLaw:
    """Return the contact law that the section `contact` of a configuration selects, with its settings.

    With `calibration: exact`, the law `exact` replaces an adjustable law. The damping factor of `exact` makes the
    realised restitution equal to the configured e. Any other law stays as it is.
    """
    named = LAWS[contact.law]
    law = LAWS["exact"] if contact.calibration == "exact" and named.adjustable else named
    return law(**{attribute.name: getattr(contact, attribute.name) for attribute in attrs.fields(law)})
