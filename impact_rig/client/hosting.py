# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Nodes in the process of the one who tests them: started in a client's executor, ended with it, acknowledged for.

There is no thread: a hosted node works while the client waits. A node of somebody else's needs nothing of this package,
neither keyword arguments for rclpy's `Node` nor a word about `daq/ack`.
"""

from __future__ import annotations

import contextlib
import functools
import inspect
from collections.abc import Callable, Iterator
from typing import Any  # rclpy handles; message classes have no common base

import rclpy.utilities
from rclpy.context import Context
from rclpy.node import Node

from impact_rig.nodes.messages import header_stamp_ns


class HostedNodes:
    """The nodes that run in one executor beside the node of its owner, with the owner's context and namespace.

    Args:
        owner: node of the one who hosts.
        executor: spun by the owner.
    """

    def __init__(self, owner: Node, executor: Any) -> None:
        self._owner = owner
        self._executor = executor
        self._nodes: list[Any] = []

    def start(self, make_node: Callable[..., Any], **kwargs: Any) -> Any:
        """Make a node and add it to the executor.

        A class that does not hand keyword arguments on to `Node` gets the context as the default one, and no namespace.
        """
        if takes_keywords(make_node):
            kwargs |= {
                "context": self._owner.context,
                "namespace": self._owner.get_namespace(),
                "use_global_arguments": False,
            }
        with _as_default(self._owner.context):
            node = make_node(**kwargs)
        self._nodes.append(node)
        self._executor.add_node(node)
        return node

    def stop_working(self) -> None:
        """Let nodes of this package end what they do, while the executor still runs."""
        for node in self._nodes:
            if hasattr(node, "close"):
                node.close()

    def destroy(self) -> None:
        """Destroy every node, after the executor was shut down."""
        for node in self._nodes:
            node.destroy_node()


def takes_keywords(make_node: Callable[..., Any]) -> bool:
    """Return whether a node's class hands keyword arguments on to rclpy's Node."""
    parameters = inspect.signature(make_node).parameters.values()
    return any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters)


def acknowledge_callbacks(node: Any, topic: str, acknowledge: Callable[[str, int], None]) -> int:
    """Acknowledge every message of a topic for a node, once its callback has returned, or raised.

    Args:
        node: a hosted node.
        topic: full name of a topic whose messages have a header.
        acknowledge: called with the node's name and the stamp of the message [ns].

    Returns:
        How many subscriptions to the topic the node has.
    """
    found = [subscription for subscription in node.subscriptions if subscription.topic_name == topic]
    for subscription in found:
        subscription.callback = _then(subscription.callback, functools.partial(acknowledge, node.get_name()))
    return len(found)


def _then(callback: Callable[..., Any], acknowledge: Callable[[int], None]) -> Callable[..., Any]:
    @functools.wraps(callback)
    def call(*args: Any) -> Any:
        message = args[0][0] if type(args[0]) is tuple else args[0]
        try:
            return callback(*args)
        finally:
            stamp_ns = header_stamp_ns(message)
            assert stamp_ns is not None, "a message without a header cannot be acknowledged"
            acknowledge(stamp_ns)

    return call


@contextlib.contextmanager
def _as_default(context: Context) -> Iterator[None]:
    """Make a context the default one, which is what a node gets that is not given any."""
    utilities: Any = rclpy.utilities
    before, utilities.g_default_context = utilities.g_default_context, context
    try:
        yield
    finally:
        utilities.g_default_context = before
