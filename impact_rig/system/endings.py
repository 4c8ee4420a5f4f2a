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
"""Orderly end of a program on SIGINT, SIGTERM or the end of its parent process.

A program creates its `Ending` in its first import, which installs the signal handlers. Until `Ending.run` is called, a
signal ends the program immediately. Afterwards the first signal raises `SignalReceived` in the main thread, so that
files and processes are closed while the exception propagates. Further signals have no effect. Code that must not be
interrupted runs in `defer_signals`. If third-party code catches the exception, it is raised again every second. A
program that has not ended 15 s after the first signal is ended immediately, unless its signals raise nothing
(`interrupting`).
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)
AGAIN_S = 1.0  # delay until `SignalReceived` is raised again, if the program has not ended
LAST_S = 5.0  # time limit for the shutdown of the interpreter, after the work has ended
PATIENCE_S = 15.0  # time limit for the end of the work after the first signal
PARENT_VARIABLE = "IMPACT_RIG_EXIT_WITH"
"""Environment variable with the id of another process; when that process ends for any reason, this program ends, too.
"""
_WORDS = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}


class SignalReceived(KeyboardInterrupt):
    """SIGINT or SIGTERM, raised in the main thread so that the program closes files and ends its processes.

    It has no arguments: `Ending.received` says which signal arrived.
    """


class Ending:
    """Handler of SIGINT and SIGTERM for a program; until `run` is called, a signal ends the program immediately.

    During `run`, the first signal raises `SignalReceived` in the main thread, and again every second while the work
    goes on. If the work has not ended after 15 s, the program is ended. Further signals have no effect. After `run`,
    both signals are ignored.

    Args:
        name: name of the program, for the line printed when a signal arrives.
        code: function that returns the exit code for the number of a signal; by default 128 + number, as in shells.
    """

    def __init__(self, name: str, code: Callable[[int], int] = lambda number: 128 + number) -> None:
        self.name = name
        self.received = 0  # number of the first signal; 0 before
        self.reason = ""  # text to print after the kind of the signal, such as ", as its parent is gone"
        self.code = code
        self._received_at = 0.0
        self._cut_short = False
        self._answer = self._end_here
        for number in SIGNALS:
            signal.signal(number, self._on_signal)

    def run(self, work: Callable[[], int], *, interrupting: bool = True) -> int:
        """Call `work`, and return its exit code, or the exit code for the first signal if one has arrived.

        After a signal, exceptions of `work` are discarded. The name of the program and the signal are printed on
        stderr, unless the exit code for the signal is 0 and `reason` is empty. If threads of other libraries then keep
        the process alive for 5 s after the end of the work, the process is ended.

        Args:
            work: main function of the program.
            interrupting: whether a signal raises `SignalReceived`. Otherwise `work` must check `received` itself, and
                has no time limit.
        """
        signal.signal(signal.SIGALRM, self._remind)
        sys.unraisablehook = self._unraisable
        code = 0
        try:
            code = self._do(work, self._interrupt if interrupting else lambda: None)
        except SignalReceived:  # a signal at the moment the work was done
            self._over()
        if self.received:
            self._report()
            code = self.code(self.received)
            last = threading.Timer(LAST_S, os._exit, (code,))  # threads of other libraries may never end
            last.daemon = True
            last.start()
        return code

    def _do(self, work: Callable[[], int], answer: Callable[[], None]) -> int:
        try:
            self._answer = answer
            return work()
        except BaseException:  # exception into which other code has turned the first signal
            if not self.received:
                raise
            return 0
        finally:
            self._over()

    def _over(self) -> None:
        """Ignore signals from now on, and no longer raise `SignalReceived`, because the work is done."""
        ignored = False
        while not ignored:
            with contextlib.suppress(SignalReceived):  # a signal may arrive in between
                # Python would restore the default handler, which kills, on its way out
                for number in (*SIGNALS, signal.SIGALRM):
                    signal.signal(number, signal.SIG_IGN)
                ignored = True
        signal.setitimer(signal.ITIMER_REAL, 0.0)

    def _on_signal(self, number: int, _frame: FrameType | None) -> None:
        if not self.received:
            self.received, self._received_at = number, time.monotonic()
            self._answer()

    def _interrupt(self) -> None:
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S, AGAIN_S)
        _raise_unless_deferred()

    def _remind(self, _number: int, _frame: FrameType | None) -> None:
        if time.monotonic() - self._received_at > PATIENCE_S:
            self._end_here()
        _raise_unless_deferred()

    def _end_here(self) -> None:
        if self._cut_short:  # a second signal arrived while a stream waited for a lock that is never released
            os._exit(self.code(self.received))
        self._cut_short = True
        self._report()
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError, RuntimeError):  # closed, or being written at this moment
                stream.flush()
        os._exit(self.code(self.received))

    def _report(self) -> None:
        if not self.reason and self.code(self.received) == 0:  # a signal is the regular end of this program
            return
        with contextlib.suppress(OSError):  # the reader may be gone
            os.write(2, f"{self.name}: {_WORDS[signal.Signals(self.received)]}{self.reason}\n".encode())

    def _unraisable(self, unraisable: sys.UnraisableHookArgs) -> None:
        if not isinstance(unraisable.exc_value, SignalReceived):
            sys.__unraisablehook__(unraisable)


class _Deferred:
    """State of `defer_signals`: depth of its nested `with` blocks, and whether a signal arrived in one (`owed`)."""

    depth = 0
    owed = False


@contextlib.contextmanager
def defer_signals() -> Iterator[None]:
    """Delay the effect of SIGINT and SIGTERM to the end of a `with` block that closes files or ends processes.

    If a signal arrived during the block, the end of the outermost such block raises `SignalReceived`. Only signals that
    `Ending.run` handles are delayed. Outside the main thread, which alone handles signals, this does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    _Deferred.depth += 1
    try:
        yield
    finally:
        _Deferred.depth -= 1
        if _Deferred.owed and not _Deferred.depth:
            _Deferred.owed = False
            raise SignalReceived


@contextlib.contextmanager
def block_signals() -> Iterator[None]:
    """Block SIGINT and SIGTERM for this thread during a `with` block.

    A signal that arrives in the block takes effect at its end, or at once if the process has a thread that does not
    block it. Processes and threads started in the block receive neither signal, unless they unblock it themselves.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with(process: int, end: Callable[[], None]) -> None:
    """Call `end` in a new thread when the process with the id `process` ends.

    If there is no such process, `end` is called immediately in this thread. On systems without pidfd, `process` must be
    the parent of the calling process.
    """
    try:
        descriptor = os.pidfd_open(process)
    except ProcessLookupError:
        end()
        return
    except OSError:  # a kernel or container without pidfd: watch for a change of the parent
        parent = os.getppid()
        wait: Callable[[], object] = lambda: _poll(parent)  # noqa: E731  # the other alternative is a method
    else:
        waiter = select.poll()
        waiter.register(descriptor, select.POLLIN)
        wait = waiter.poll

    def watch() -> None:
        wait()
        end()

    threading.Thread(target=watch, name="parent", daemon=True).start()


def _poll(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)


def _raise_unless_deferred() -> None:
    if _Deferred.depth:
        _Deferred.owed = True
    else:
        raise SignalReceived
