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

`EventsExecutor` needs a third to a sixth of the processor time of rclpy's default executor. The default executor is
used if rclpy does not have `EventsExecutor`.

Signals only set a flag that the loop checks. Therefore no callback or clean-up is interrupted, however often Ctrl-C
arrives. Only the main thread receives signals.
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
    """Return a new executor for a ROS context (default: the global one).

    It is an events executor if this version of rclpy has one and is supported, otherwise rclpy's default executor. The
    value `default` of the environment variable `IMPACT_RIG_EXECUTOR` selects the default executor, too.
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
    """Run the callbacks of an executor for `seconds` of wall time."""
    never: Future[None] = Future()
    executor.spin_until_future_complete(never, timeout_sec=seconds)


@contextlib.contextmanager
def patient_threads() -> Iterator[None]:
    """Give threads that start within this `with` statement a scheduling policy by which they preempt no others (Linux).

    The policy (`SCHED_BATCH`) is meant for the threads of DDS, which would often interrupt the running callback. The
    calling thread has the same policy within the statement. Nothing changes if the process was started with a policy of
    its own, or if the system forbids the change.
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

    If the node cannot be created, the reason is printed on stderr. An exception in a callback is logged, and the node
    continues.

    Args:
        make_node: creates the node.
        ending: record of the signals that this process has received.

    Returns:
        Exit code: 0, or 2 if the node cannot be created, usually because its arguments are invalid.
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
    """Run a node as a program, and exit with its exit code."""
    with segments.Watch():
        sys.exit(ending.run(lambda: run(make_node, ending), interrupting=False))
