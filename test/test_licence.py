# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""One licence: the notice at the top of each file (ruff's CPY001 holds it), package.xml and LICENSE name the same."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

ROOT = Path(__file__).parents[1]
LICENCE = " ".join((ROOT / "LICENSE").read_text(encoding="utf-8").split())


def test_the_notice_names_the_licence_of_the_package() -> None:
    licence = ET.parse(ROOT / "package.xml").findtext("license")
    assert f"# SPDX-License-Identifier: {licence}" == Path(__file__).read_text(encoding="utf-8").splitlines()[1]
    name, version = licence.split("-")
    assert LICENCE.startswith(f"{name} License Version {version}")


def test_contributions_come_under_the_licence() -> None:
    section = LICENCE[LICENCE.index("5. Submission of Contributions.") : LICENCE.index(" 6. Trademarks.")]
    assert section in " ".join((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
