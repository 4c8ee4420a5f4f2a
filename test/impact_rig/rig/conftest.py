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
"""Fixtures to which several files compare their rigs."""

from __future__ import annotations

import pytest
from kits.rig import TICK, config

from impact_rig.rig import Block, Rig


@pytest.fixture(scope="session")
def reference() -> list[Block]:
    """Return the first 60 blocks of the rig that hits its walls; no test may modify them."""
    return Rig(config()).advance(60 * TICK)


@pytest.fixture(scope="module")
def hammered() -> Rig:
    """One rig that continues through every example of a file."""
    return Rig(config())
