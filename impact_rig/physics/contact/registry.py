# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Which laws there are: every class of this folder's modules that has a name."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

from impact_rig.physics.contact.compiled_force import declare
from impact_rig.physics.contact.law import ContactLaw, ContactPair


def _found() -> dict[str, type[ContactLaw]]:
    laws: dict[str, type[ContactLaw]] = {}
    for place in pkgutil.iter_modules([str(Path(__file__).parent)]):
        if place.name in _MACHINERY:
            continue
        module = importlib.import_module(f"{__package__}.{place.name}")
        for law in vars(module).values():
            if isinstance(law, type) and issubclass(law, ContactLaw) and law.__module__ == module.__name__:
                assert law.name not in laws, f"two contact laws are called {law.name}"
                laws[law.name] = law
    return dict(sorted(laws.items()))


_MACHINERY = frozenset({"compiled_force", "law", "registry", "section"})

LAWS: dict[str, type[ContactLaw]] = _found()
"""Every contact law by its name, in alphabetical order."""

for _law in LAWS.values():
    declare(_law().force(ContactPair(1.0, 1.0)).function)
