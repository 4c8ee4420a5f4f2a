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
"""One rig for the module: every test gets its own pages, and checks the ROS side."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

pytest.importorskip("aiohttp", reason="the extra [lab] is not installed")

from kits.browser import Browser, Page


@pytest.fixture
def open_page(browser: Browser) -> Iterator[Callable[..., Page]]:
    """Open pages; any complaint of a console by the end fails the test."""
    pages: list[Page] = []

    def open_one(address: str, width: int = 1280, height: int = 800, **features: str) -> Page:
        page = browser.page(width, height, **features)
        pages.append(page)
        page.goto(address)
        return page

    yield open_one
    errors = [error for page in pages for error in page.faults()]
    for page in pages:
        page.close()
    assert errors == []


@pytest.fixture(scope="session")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from impact_rig.driver.sample_run import make_sample

    return make_sample(tmp_path_factory.mktemp("lab") / "sample")
