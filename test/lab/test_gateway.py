# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The lab in the graph, beside nothing else."""

from __future__ import annotations

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.browser import PATIENCE_S

from impact_rig import topics
from impact_rig.client import Client, isolated_domain
from impact_rig.lab.gateway import KEPT
from impact_rig.lab.live import LiveSource

pytestmark = pytest.mark.ros


def test_the_lab_hears_every_topic_once() -> None:
    """It once kept a second list of all that was applied, read by nobody, for as long as it ran."""
    with isolated_domain() as domain_id, Client(domain_id, "rig", name="observer") as observer:

        def times(topic: topics.Topic) -> int:
            name = observer.node.resolve_topic_name(topic.name)
            return [info.node_name for info in observer.node.get_subscriptions_info_by_topic(name)].count("lab")

        with LiveSource(domain_id, "/rig"):
            observer.wait_until(lambda: times(KEPT[-1]), "the lab", PATIENCE_S)
            assert {topic.name: times(topic) for topic in KEPT} == {topic.name: 1 for topic in KEPT}
