# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The website, built once."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType

import pytest


@pytest.fixture(scope="session")
def mkdocs() -> ModuleType:
    """The website's builder, or the reason why its tests are left out."""
    return pytest.importorskip("mkdocs", reason="make venv installs the website's builder")


@pytest.fixture(scope="session")
def site(mkdocs: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tools.website.__main__ import build

    return build(tmp_path_factory.mktemp("website") / "site")
