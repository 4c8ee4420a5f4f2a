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
"""Pure modules of the page (numbers, scales, motion, frames, valid values), in the browser that runs them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from kits.browser import Page
from kits.lab import FakeSource

from impact_rig_lab.server import Server

UNITS = Path(__file__).parent / "unit.js"


def test_the_unit_tests_of_the_page_modules_pass(open_page: Callable[..., Page]) -> None:
    with Server(FakeSource(), port=0) as server:
        page = open_page(server.address)
        results = page.js(UNITS.read_text(encoding="utf-8"))
        page.js("lab.link.socket.onclose = null")  # no wish to connect again
    assert len(results) >= 10
    assert [result for result in results if result[1]] == []
