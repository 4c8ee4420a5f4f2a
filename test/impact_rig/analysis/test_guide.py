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
"""The code in docs/explanation/analysis.md runs, and its results are those of the page."""

from __future__ import annotations

import re
from pathlib import Path

from impact_rig.states import Status

PAGE = Path(__file__).parents[3] / "docs" / "explanation" / "analysis.md"


def test_the_example_of_the_guide_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == "DT = 100.0 ± 0.6, phase -85.9°\n"


def test_the_guide_explains_every_status():
    text = PAGE.read_text(encoding="utf-8")
    assert [status.value for status in Status if f"`{status.value}`" not in text] == []
