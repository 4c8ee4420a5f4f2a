# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The website, built once."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("mkdocs", reason="the website's builder is only on PyPI")

from tools.website.__main__ import build


@pytest.fixture(scope="session")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("website") / "site")
