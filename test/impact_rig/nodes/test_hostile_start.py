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
"""Hostile start values: a rig is configured if the validator accepts them, else it stays unconfigured and says why."""

from __future__ import annotations

from typing import Any

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from hypothesis import given, settings
from hypothesis import strategies as st
from kits.hostile import CASES, FIELDS, cases, texts
from rclpy.lifecycle import TransitionCallbackReturn

from impact_rig.client import Client, isolated_domain
from impact_rig.client.client import ros_parameters
from impact_rig.errors import ConfigError
from impact_rig.nodes.rig_node import RigNode
from impact_rig.rig.config import RigConfig, from_flat

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120 + CASES)]


_START_VALUES = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1) | st.integers(-3, 20),
    st.floats(),
    texts,
    st.lists(st.sampled_from(["a", "\u2028", "stuck"]), min_size=1, max_size=2),
)


_START_NAMES = st.sampled_from([*FIELDS, "barriers.gap", "barriers", "a" * 999])


def test_start_values_of_any_name_and_type_are_validated() -> None:
    """The rig is configured only if the validator accepts all values; else it stays unconfigured with the reason."""
    with isolated_domain() as domain_id, Client(domain_id) as client:

        @settings(cases, max_examples=max(1, CASES // 2))
        @given(st.dictionaries(_START_NAMES, _START_VALUES, min_size=1, max_size=2))
        def attack(values: dict[str, Any]) -> None:
            overrides = ros_parameters(values)
            node = RigNode(context=client.context, use_global_arguments=False, parameter_overrides=overrides)
            try:
                plain = {name: tuple(v) if isinstance(v, list) else v for name, v in values.items()}
                try:
                    expected = from_flat(RigConfig(), plain)
                except ConfigError as error:
                    assert str(node.parameters.refused) == str(error)  # noqa: PT017  # either outcome is right
                    assert node.settings == RigConfig()
                    assert node.trigger_configure() == TransitionCallbackReturn.FAILURE
                else:
                    assert node.parameters.refused is None
                    assert node.settings == expected
            finally:
                node.close()
                node.destroy_node()

        attack()
