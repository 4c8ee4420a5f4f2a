# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""Which laws there are: every class of this folder's modules that has a name."""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path

from impact_rig.physics.contact.law import ContactLaw


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
