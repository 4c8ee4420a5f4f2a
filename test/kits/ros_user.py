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
"""A user of the graph, on its own ROS domain."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from impact_rig.client import Client, isolated_domain


@pytest.fixture
def client() -> Iterator[Client]:
    """Client that is alone on its domain."""
    with isolated_domain() as domain_id, Client(domain_id) as user:
        yield user
