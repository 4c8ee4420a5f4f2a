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
"""One licence: the notice at the top of each file (ruff's CPY001 checks it), package.xml and LICENSE state the same."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

ROOT = Path(__file__).parents[1]
LICENCE = " ".join((ROOT / "LICENSE").read_text(encoding="utf-8").split())


def test_the_notice_of_every_file_names_the_licence_of_the_package() -> None:
    licence = ET.parse(ROOT / "package.xml").findtext("license")
    name, version = licence.split("-")
    notice = Path(__file__).read_text(encoding="utf-8").splitlines()[2]
    assert notice.startswith(f"# Licensed under the {name} License, Version {version}")
    assert LICENCE.startswith(f"{name} License Version {version}")


def test_contributions_are_under_the_licence() -> None:
    section = LICENCE[LICENCE.index("5. Submission of Contributions.") : LICENCE.index(" 6. Trademarks.")]
    assert section in " ".join((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
