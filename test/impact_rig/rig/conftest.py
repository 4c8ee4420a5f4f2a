# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What several files compare their rigs with."""

from __future__ import annotations

import pytest
from kits.rig import TICK, config

from impact_rig.rig import Block, Rig


@pytest.fixture(scope="session")
def reference() -> list[Block]:
    """The first 60 blocks of the rig that hits its walls; nobody writes into them."""
    return Rig(config()).advance(60 * TICK)


@pytest.fixture(scope="module")
def hammered() -> Rig:
    """A rig that goes on through every example of a file."""
    return Rig(config())
