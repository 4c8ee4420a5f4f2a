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
"""Main loop of every node: run its callbacks (spin) until the process is asked to end, then clean up and end.

`EventsExecutor` needs a third to a sixth of the processor time of rclpy's default executor. In Jazzy, its `spin()`
busy-loops and its `spin_once` returns to Python after every message, so the loop spins for 0.2 s at a time. If rclpy
does not have `EventsExecutor`, the default one is used.

Signals only set a flag that the loop checks. So neither a callback nor the clean-up is interrupted, however often
Ctrl-C arrives, and the last messages still find a valid context. Only the main thread receives signals; threads of DDS
never do.
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
from impact_rig.system.endings import SIGNALS, Ending, block_signals

SPIN_S = 0.2
DISCOVERY_S = 3.5
"""Time [s] for which a new process may not know of other nodes.

If their announcement is missed, it is repeated 3 s later (qualification/discovery.py).
"""
EXIT_USAGE = 2  # exit code for invalid arguments, parameter files or names
EXECUTOR_VARIABLE = "IMPACT_RIG_EXECUTOR"
"""Environment variable: the value `default` selects rclpy's default executor instead of the events executor."""


def make_executor(context: Any = None) -> Any:
    """Return a new executor for a ROS context (default: the global one), of the kind that needs least processor time.

    It is an events executor, unless this version of rclpy has none or is not supported, or `IMPACT_RIG_EXECUTOR` is
    `default`; then it is rclpy's default executor.
    """
    if os.environ.get(EXECUTOR_VARIABLE, "") != "default":
        handlers = {number: signal.getsignal(number) for number in SIGNALS}
        try:
            # it needs a file as stderr, which a test may have replaced
            with contextlib.redirect_stderr(sys.__stderr__):
                executor = rclpy_internals.events_executor(rclpy.get_default_context() if context is None else context)
            if executor is not None:
                return executor
        finally:
            if threading.current_thread() is threading.main_thread():
                for number, handler in handlers.items():
                    signal.signal(number, handler)  # an events executor may install its own
    return SingleThreadedExecutor(context=context)


def spin(executor: Any, seconds: float) -> None:
    """Run the callbacks of an executor for `seconds` of wall time, without returning after each of them."""
    never: Future[None] = Future()
    executor.spin_until_future_complete(never, timeout_sec=seconds)


@contextlib.contextmanager
def patient_threads() -> Iterator[None]:
    """Give all threads that start within this `with` statement a policy by which they preempt no others (Linux).

    It is meant for the threads of DDS. Each message wakes several of them, also in its sender: receipt, heartbeats,
    acknowledgements. If all cores are busy, they would interrupt the running callback about five times per block of
    scans, which costs a quarter of the speed. The calling thread has the same policy (`SCHED_BATCH`) within the
    statement. A process that was started with a policy of its own keeps that one, as threads inherit it (sched(7)).
    """
    patient = getattr(os, "SCHED_BATCH", None)
    changed = False
    with contextlib.suppress(OSError):  # a container may forbid it: the node is then slower, but works
        if patient is not None and os.sched_getscheduler(0) == os.SCHED_OTHER:
            os.sched_setscheduler(0, patient, os.sched_param(0))
            changed = True
    try:
        yield
    finally:
        if changed:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def run(make_node: Callable[[], ManagedNode[Any]], ending: Ending) -> int:
    """Create a node, run its callbacks until a signal, a shutdown of ROS or `node.quitting` ends it, and clean up.

    Args:
        make_node: creates the node.
        ending: record of the signals that this process has received.

    Returns:
        Exit code: 0, or 2 if the node cannot be created, usually because its arguments are invalid. An exception while
        it is created is printed on stderr; one in a callback is logged, and the node continues.
    """
    try:
        with block_signals(), patient_threads():
            rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
            executor = make_executor()
            node = make_node()
    except Exception as error:  # raised by rclpy for arguments, parameter files and names; it exports no class for them
        print(f"cannot start the node: {' '.join(str(error).split())}", file=sys.stderr)  # noqa: T201  # there is no logger yet
        rclpy.try_shutdown()
        return EXIT_USAGE
    node.is_ending = lambda: bool(ending.received) or node.quitting
    try:
        executor.add_node(node)
        frozen = False
        while node.context.ok() and not node.is_ending():
            try:
                spin(executor, SPIN_S)
            except (ExternalShutdownException, KeyboardInterrupt):
                raise
            except Exception as error:  # raised by rclpy itself: our callbacks are guarded, so the node can continue
                node.report_failure("executor", describe(error))
            if not frozen and node.active:
                # objects created so far live as long as the process: without this, collections stall a block by 10 ms
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
    """Run a node as a program, and exit with its exit code; the caller has done the heavy imports."""
    with segments.Watch():
        sys.exit(ending.run(lambda: run(make_node, ending), interrupting=False))
