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
"""What every node's `main` does: spin until told to stop, then end in order.

`EventsExecutor` costs a third to a sixth of the default executor; its `spin()` busy-loops in Jazzy, and its `spin_once`
comes back to Python after every message, so it spins for a while at a time. Where rclpy does not have it, the default
one runs. Signals are noted, not raised: neither a callback nor the clean-up is interrupted, however often Ctrl-C
arrives, and the last messages still find a valid context. They reach the main thread only, never one of DDS.
"""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any  # executors have no common type

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from impact_rig.errors import describe
from impact_rig.nodes import rclpy_internals
from impact_rig.nodes.managed import ManagedNode
from impact_rig.system import segments
from impact_rig.system.endings import SIGNALS, Ending, held

SPIN_S = 0.2
DISCOVERY_S = 3.5
"""How long a new process may not know of others: an announcement that it misses comes again 3 s later
(qualification/discovery.py)."""
EXIT_USAGE = 2  # exit code when arguments, parameter files or names are no good
EXECUTOR_VARIABLE = "IMPACT_RIG_EXECUTOR"
"""Environment: `default` takes rclpy's default executor instead of the events executor."""


def make_executor(context: Any = None) -> Any:
    """Return the cheapest executor this rclpy has."""
    if os.environ.get(EXECUTOR_VARIABLE, "") != "default":
        handlers = {number: signal.getsignal(number) for number in SIGNALS}
        try:
            with contextlib.redirect_stderr(sys.__stderr__):  # it wants a file behind it, which a test may have changed
                executor = rclpy_internals.events_executor(rclpy.get_default_context() if context is None else context)
            if executor is not None:
                return executor
        finally:
            if threading.current_thread() is threading.main_thread():
                for number, handler in handlers.items():
                    signal.signal(number, handler)  # an events executor may take them for itself
    return SingleThreadedExecutor(context=context)


def spin(executor: Any, seconds: float) -> None:
    """Let callbacks run for so long, without coming back after each of them."""
    never: Future[None] = Future()
    executor.spin_until_future_complete(never, timeout_sec=seconds)


@contextlib.contextmanager
def patient_threads() -> Iterator[None]:
    """Let threads that begin meanwhile, those of DDS, wait for a free core or their turn when they wake (Linux).

    Each message wakes some, in its sender as well: receipt, heartbeats, acknowledgements. Where all cores are busy they
    would interrupt the callback that runs some five times a block, which costs a quarter of the speed.
    The calling thread is as patient meanwhile. A process that somebody gave a policy of its own keeps it (sched(7):
    `SCHED_BATCH` and others are inherited).
    """
    patient = getattr(os, "SCHED_BATCH", None)
    changed = False
    with contextlib.suppress(OSError):  # a container may forbid it: slower, nothing else
        if patient is not None and os.sched_getscheduler(0) == os.SCHED_OTHER:
            os.sched_setscheduler(0, patient, os.sched_param(0))
            changed = True
    try:
        yield
    finally:
        if changed:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def run(make_node: Callable[[], ManagedNode[Any]], ending: Ending) -> int:
    """Spin the node until a signal or a shutdown; return the exit code."""
    try:
        with held(), patient_threads():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            executor = make_executor()
            node = make_node()
    except Exception as error:  # rclpy's own, which it does not export: arguments, parameter files, names
        print(f"cannot start: {' '.join(str(error).split())}", file=sys.stderr)  # noqa: T201  # there is no logger yet
        rclpy.try_shutdown()
        return EXIT_USAGE
    node.is_told_to_end = lambda: bool(ending.told) or node.quitting
    try:
        executor.add_node(node)
        frozen = False
        while node.context.ok() and not node.is_told_to_end():
            try:
                spin(executor, SPIN_S)
            except (ExternalShutdownException, KeyboardInterrupt):
                raise
            except Exception as error:  # of rclpy itself: our callbacks are guarded, and the rest can go on
                node.report_failure("executor", describe(error))
            if not frozen and node.active:
                # what exists now lives as long as the process: without this, collections stall a block by 10 ms
                gc.collect()
                gc.freeze()
                frozen = True
    except ExternalShutdownException:
        pass
    finally:
        node.close()
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def main(make_node: Callable[[], ManagedNode[Any]], ending: Ending) -> None:
    """Run a node as a program, from when its imports are done."""
    with segments.Watch():
        sys.exit(ending.run(lambda: run(make_node, ending), interrupting=False))
