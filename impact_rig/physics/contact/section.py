# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The configuration's `contact` section: what every law reads, and what laws bring."""

from __future__ import annotations

from typing import Any  # attrs attributes of any type

import attrs

from impact_rig.config.fields import Origin, choice, quantity
from impact_rig.physics.contact.law import ContactLaw, restitution
from impact_rig.physics.contact.registry import LAWS


def _with_settings_of_laws(_section: type, own: list[attrs.Attribute[Any]]) -> list[attrs.Attribute[Any]]:
    """Return the section's attributes and those that only some laws have; laws that share one share its meaning."""
    found = {attribute.name: attribute for attribute in own}
    for law in LAWS.values():
        for attribute in attrs.fields(law):
            known = found.setdefault(attribute.name, attribute.evolve(kw_only=True, inherited=False))
            same = (known.default, known.metadata) == (attribute.default, attribute.metadata)
            assert same, f"two contact laws mean different things by {attribute.name}"
    return list(found.values())


@attrs.frozen(kw_only=True, field_transformer=_with_settings_of_laws)
class Contact:
    """The contact between sphere and barrier."""

    law: str = choice("flores", tuple(LAWS), "Contact law, by name.", Origin.PAPER)
    restitution: float = restitution()
    calibration: str = choice(
        "nominal",
        ("nominal", "exact"),
        "nominal: e goes into the law as published; exact: the law is adjusted until it returns e.",
        Origin.PAPER,
    )
    speed_floor_m_s: float = quantity(
        1e-3, "m/s", "Floor of the approach speed in c = a K / v0, singular as v0 -> 0.", at_least=1e-6, at_most=0.1
    )


def from_config(contact: Contact) -> ContactLaw:
    """Return the configured law; `calibration: exact` replaces a damping factor by the one that returns e."""
    named = LAWS[contact.law]
    law = LAWS["exact"] if contact.calibration == "exact" and named.adjustable else named
    return law(**{attribute.name: getattr(contact, attribute.name) for attribute in attrs.fields(law)})
