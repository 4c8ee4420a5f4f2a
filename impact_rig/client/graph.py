# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What a node sees of the graph around it: who subscribes a topic, and as what it is published."""

from __future__ import annotations

from typing import Any  # rclpy handles

from rclpy.node import Node
from rclpy.qos import QoSProfile

from impact_rig import topics
from impact_rig.nodes import messages


def subscribers(node: Node, topic: str) -> set[str]:
    """Return the names of the nodes that subscribe a topic."""
    full_name = node.resolve_topic_name(topic)
    return {info.node_name for info in node.get_subscriptions_info_by_topic(full_name)}


def is_heard(node: Node, publisher: Any, listener: str | None) -> bool:
    """Return whether a node's publisher has reached all that the graph knows, the node `listener` among them."""
    found = node.get_subscriptions_info_by_topic(publisher.topic_name)
    there = listener is None or listener in {info.node_name for info in found}
    return there and publisher.get_subscription_count() >= max(len(found), 1)


def published(node: Node, topic: str) -> tuple[topics.Topic, QoSProfile] | None:
    """Return a topic's row, as the table of topics has them, and the profile that its first publisher satisfies.

    None: nobody publishes it.
    """
    found = node.get_publishers_info_by_topic(node.resolve_topic_name(topic))
    if not found:
        return None
    publisher = found[0]
    profile = messages.profile(topics.Qos.DATA)
    profile.reliability = publisher.qos_profile.reliability
    return topics.Topic(topic, publisher.topic_type, topics.Qos.DATA, publisher.node_name, "", ()), profile
