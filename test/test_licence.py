# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""The notice at the top of each file, which ruff holds (CPY001), is one that ament_copyright recognises.

That linter is not on the index of wheels. It wants a line `Copyright YEAR NAME` in a comment and in the same comment
the text that ends LICENSE, in CONTRIBUTING.md the licence's section 5; white space does not count.
"""

from __future__ import annotations

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
LICENCE = " ".join((ROOT / "LICENSE").read_text(encoding="utf-8").split())


def test_the_notice_is_the_one_of_the_licence() -> None:
    comment = re.match("(?:#.*\n)*", Path(__file__).read_text(encoding="utf-8")).group().replace("#", "")
    owner, text = re.match(r"\s*Copyright \d{4} (.+)\n([\s\S]+)", comment).groups()
    assert owner in (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert LICENCE.endswith("[name of copyright owner] " + " ".join(text.split()))


def test_contributions_come_under_the_licence() -> None:
    section = LICENCE[LICENCE.index("5. Submission of Contributions.") : LICENCE.index(" 6. Trademarks.")]
    assert section in " ".join((ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").split())
