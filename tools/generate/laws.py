# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""The table of contact laws in `docs/physics.md`."""

from __future__ import annotations

from collections.abc import Callable

from impact_rig.physics.contact import LAWS
from tools.generate.markdown import table


def _laws() -> str:
    rows = ((f"`{law.name}`", law.formula, f"{law.returns:.3f}", law.source) for law in LAWS.values())
    return table(("law", "a(e), or its shape", "returned e", "source"), rows)


TABLES: dict[str, Callable[[], str]] = {"contact laws": _laws}
