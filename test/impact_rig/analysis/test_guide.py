# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The code in docs/analysis.md runs and says what the page says."""

from __future__ import annotations

import re
from pathlib import Path

from impact_rig.states import Status

PAGE = Path(__file__).parents[3] / "docs" / "analysis.md"


def test_the_example_runs(capsys):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    exec(compile(code, str(PAGE), "exec"), {})
    assert capsys.readouterr().out == "DT = 100.0 ± 0.6, phase -85.9°\n"


def test_every_status_is_explained():
    text = PAGE.read_text(encoding="utf-8")
    assert [status.value for status in Status if f"`{status.value}`" not in text] == []
