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
"""The website, built once."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest
from kits.shared import shared


@pytest.fixture(scope="session")
def mkdocs() -> ModuleType:
    """Return the website's builder; without it, skip the tests and say why."""
    return pytest.importorskip("mkdocs", reason="make venv installs the website's builder")


@pytest.fixture(scope="session")
def site(mkdocs: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tools.website.__main__ import build

    return shared(tmp_path_factory, "website", build)
