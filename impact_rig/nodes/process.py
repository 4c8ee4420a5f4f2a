"""What every node's `main` does: spin until told to stop, then end in order.

`EventsExecutor` costs a third to a sixth of the default executor; its `spin()` busy-loops in Jazzy, so it is driven by
`spin_once`. Where rclpy does not have it, the default one runs. A second Ctrl-C must not interrupt the clean-up: from
there on signals are ignored.
"""

from __future__ import annotations

import gc
import os
import signal
import sys
from collections.abc import Callable
from typing import Any  # executors have no common type

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor

from impact_rig.nodes.managed import ManagedNode

SPIN_S = 0.5
EXECUTOR_VARIABLE = "IMPACT_RIG_EXECUTOR"
"""Environment: `default` takes rclpy's default executor instead of the events executor."""


def make_executor(context: Any = None) -> Any:
    """Return the cheapest executor this rclpy has."""
    if os.environ.get(EXECUTOR_VARIABLE, "") != "default":
        try:
            from rclpy.experimental.events_executor import EventsExecutor  # noqa: PLC0415  # absent before rclpy 7.1.2

            return EventsExecutor(context=context)
        except ImportError:
            pass
    return SingleThreadedExecutor(context=context)


def run(make_node: Callable[[], ManagedNode[Any]], arguments: list[str] | None = None) -> int:
    """Spin the node until a signal or a shutdown; return the exit code."""
    rclpy.init(args=arguments)
    executor = make_executor()
    node: ManagedNode[Any] | None = None
    try:
        node = make_node()
        executor.add_node(node)
        # what exists now lives as long as the process: without this, full collections stall a block by 10 ms and more
        gc.collect()
        gc.freeze()
        while rclpy.ok():
            executor.spin_once(timeout_sec=SPIN_S)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)  # a second Ctrl-C would leave a file unfinished
        if node is not None:
            node.close()
        executor.shutdown()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def main(make_node: Callable[[], ManagedNode[Any]]) -> None:
    """Entry point of the console scripts."""
    sys.exit(run(make_node))
