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
"""Public names: each is documented, on its page and in its docstring, and is loaded when it is first used."""

from __future__ import annotations

import re
from pathlib import Path

import impact_rig

PAGE = Path(__file__).parents[1] / "docs" / "reference" / "api.md"


def test_the_page_of_the_api_shows_exactly_the_public_names() -> None:
    shown = re.findall(r"^::: impact_rig\.(\w+)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(shown) == impact_rig.__all__


def test_every_public_name_is_there_and_has_a_docstring() -> None:
    for name in impact_rig.__all__:
        found = getattr(impact_rig, name)
        assert (found.__doc__ or "").strip(), name
        assert found.__module__.startswith("impact_rig"), name


def test_the_first_look_is_the_papers_rig_at_resonance() -> None:
    assert str(impact_rig.simulate(20.0)).startswith("DT 63.57 ± 0.32 (2u) at 9.1 Hz")
