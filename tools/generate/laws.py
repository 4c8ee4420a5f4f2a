# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The table of contact laws in `docs/physics.md`."""

from __future__ import annotations

from collections.abc import Callable

from impact_rig.physics.contact import LAWS
from tools.generate.markdown import table


def _laws() -> str:
    rows = ((f"`{law.name}`", law.formula, f"{law.returns:.3f}", law.source) for law in LAWS.values())
    return table(("law", "a(e), or its shape", "returned e", "source"), rows)


TABLES: dict[str, Callable[[], str]] = {"contact laws": _laws}
