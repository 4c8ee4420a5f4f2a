# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""A user of the graph on a ROS domain of its own."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from impact_rig.client import Client, isolated_domain


@pytest.fixture
def client() -> Iterator[Client]:
    """A client alone on its domain."""
    with isolated_domain() as domain_id, Client(domain_id) as user:
        yield user
