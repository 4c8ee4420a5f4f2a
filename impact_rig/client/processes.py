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
"""Management of node processes: start, supervision and orderly end.

Each process has its own process group, and gets time to clean up. If a process ends unexpectedly, the error quotes the
last lines of its log. `isolated_domain` reserves a ROS domain without other nodes. This module needs no rclpy.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import attrs

import impact_rig
from impact_rig.errors import GoneError, ImpactRigError
from impact_rig.system import files, segments
from impact_rig.system.endings import PARENT_VARIABLE, defer_signals

STOP_TIMEOUT_S = 10.0
"""Time [s] that a process may take to end after SIGINT; then it gets SIGTERM and, 2 s later, SIGKILL.

A recorder finishes its file in this time.
"""
QUOTED_LINES = 15
NODES = ("rig", "analysis", "recorder")
"""Nodes of this package that `Processes.start` runs as `python -m impact_rig.nodes NODE`."""

ParameterValue = bool | int | float | str | Sequence[str] | Sequence[float]


class ProcessDiedError(GoneError):
    """Unexpected end of a node process; the message has its exit code or signal, and its last log lines."""


@attrs.define(eq=False)
class NodeProcess:
    """Node process with its log file.

    Attributes:
        name: node name.
        log: file of its output.
        process: the process.
    """

    name: str
    log: Path
    process: subprocess.Popen[bytes]

    @property
    def pid(self) -> int:
        """Process id, which is also the id of the process group of the node and its children."""
        return self.process.pid

    @property
    def exit_code(self) -> int | None:
        """Exit code, or the negative number of the signal that ended the process; None while it runs."""
        return self.process.poll()

    def last_words(self) -> str:
        """Return the last 15 lines of the process's log, indented, for an error message; never empty."""
        lines = self.log.read_text(errors="replace").splitlines()[-QUOTED_LINES:]
        return "\n".join(f"    {line}" for line in lines) or "    (no output)"

    def signal(self, number: int) -> None:
        """Send a signal to the process and its children, even if only children still run.

        If all have ended, the call has no effect.
        """
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.pid, number)

    def wait(self, timeout_s: float) -> int | None:
        """Wait until the process ends, and return its exit code; None if it still runs after `timeout_s` seconds."""
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return None


class Processes:
    """Group of node processes on one ROS domain; leaving it as a context manager ends all of them.

    Args:
        domain_id: ROS domain of the nodes, see `isolated_domain`.
        directory: folder of their logs; created if missing.
        namespace: ROS namespace of all nodes, e.g. `/rig1`; empty for none.
    """

    def __init__(self, domain_id: int, directory: Path, namespace: str = "") -> None:
        self.domain_id = domain_id
        self.directory = directory
        self.namespace = namespace
        self.running: dict[str, NodeProcess] = {}
        self._segments = segments.Watch()
        files.make_folder(directory)

    def __enter__(self) -> Processes:
        self._segments.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        try:
            self.stop()
        finally:
            self._segments.__exit__()

    def start(
        self,
        node: str,
        parameters: Mapping[str, ParameterValue] | None = None,
        *,
        name: str | None = None,
        parameters_file: Path | None = None,
        environment: Mapping[str, str] | None = None,
        command: Sequence[str] | None = None,
    ) -> NodeProcess:
        """Start one node as a process, and return without waiting until it is active.

        Args:
            node: one of `NODES`, or the name of a Python module to run. With `command`, it is only the default of
                `name`.
            parameters: ROS parameters, `section.key` -> value; they override the file.
            name: node name (default: `node`). The output is appended to `NAME.log`.
            parameters_file: ROS 2 parameter file.
            environment: additional environment variables.
            command: program and arguments that start the node instead of a module; `--ros-args …` is appended.

        Raises:
            ImpactRigError: a process of this name is running.
            OSError: the program or the log file cannot be opened.
        """
        name = name or node
        if name in self.running and self.running[name].exit_code is None:
            raise ImpactRigError(
                f"node process {name!r} is already running: stop it first, or give the new one another name"
            )
        arguments = ["-r", f"__node:={name}"]
        if self.namespace:
            arguments += ["-r", f"__ns:={self.namespace}"]
        if parameters_file is not None:
            arguments += ["--params-file", str(parameters_file)]
        for key, value in (parameters or {}).items():
            arguments += ["-p", f"{key}:={_yaml(value)}"]
        log = self.directory / f"{name}.log"
        with defer_signals(), log.open("ab") as output:
            process = subprocess.Popen(  # noqa: S603  # the caller's own program, arguments as a list
                [*(command or _command(node)), "--ros-args", *arguments],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=self.environment(environment or {}),
                start_new_session=True,  # only this process receives Ctrl-C; it ends the nodes in order
            )
            self.running[name] = NodeProcess(name, log, process)
        return self.running[name]

    def check(self) -> None:
        """Check that no process of the group has ended, except those ended by `stop`.

        Raises:
            ProcessDiedError: a process has ended; the message has its name, exit code or signal, and last log lines.
        """
        for process in self.running.values():
            code = process.exit_code
            if code is not None:
                how = f"was ended by {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
                raise ProcessDiedError(f"the {process.name} process {how}; its last lines:\n{process.last_words()}")

    def stop(self, *names: str, timeout_s: float = STOP_TIMEOUT_S) -> dict[str, int]:
        """End the named processes, or all processes if no name is given; return their exit codes by name.

        Each process gets SIGINT. A process that still runs after `timeout_s` seconds gets SIGTERM, and 2 s later
        SIGKILL. The exit code of a process that a signal has ended is the negative number of the signal.

        Raises:
            KeyError: there is no process of a given name; no process is ended then.
        """
        with defer_signals():
            chosen = [self.running[name] for name in names or tuple(self.running)]
            for process in chosen:
                self.running.pop(process.name, None)
            for number, patience in ((signal.SIGINT, timeout_s), (signal.SIGTERM, 2.0), (signal.SIGKILL, 5.0)):
                waiting = [process for process in chosen if process.exit_code is None]
                for process in waiting:
                    process.signal(number)
                deadline = time.monotonic() + patience
                for process in waiting:
                    process.wait(max(0.0, deadline - time.monotonic()))
            for process in chosen:
                process.signal(signal.SIGKILL)  # children that the process left behind in its group
            return {process.name: process.process.wait() for process in chosen}

    def environment(self, more: Mapping[str, str]) -> dict[str, str]:
        """Return the environment variables of a new node: those of this process, the group's ROS domain, and `more`.

        Discovery is limited to this machine. Variables in `more` replace all others of the same name.
        """
        source = str(Path(impact_rig.__file__).parents[1])
        path = os.environ.get("PYTHONPATH", "")
        return {
            **os.environ,
            "ROS_DOMAIN_ID": str(self.domain_id),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(self.directory),
            "PYTHONPATH": f"{source}{os.pathsep}{path}" if path else source,
            "PYTHONUNBUFFERED": "1",
            PARENT_VARIABLE: str(os.getpid()),
            **more,
        }


def _command(node: str) -> list[str]:
    module = ["impact_rig.nodes", node] if node in NODES else [node]
    return [sys.executable, "-m", *module]


def _yaml(value: ParameterValue) -> str:
    """Return a parameter value as a YAML text for the command line (`-p NAME:=VALUE`)."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        text = repr(float(value))  # repr() of a numpy float includes its type
        return text if "." in text or "n" in text else text.replace("e", ".0e")  # YAML 1.1 floats need a point
    if isinstance(value, int):
        return str(value)
    if isinstance(value, str):
        return "'" + value.replace("'", "''") + "'"
    return "[" + ", ".join(_yaml(item) for item in value or ("",)) + "]"


FOLDER = "impact_rig_domains"
FIRST_DOMAIN, LAST_DOMAIN = 1, 49
"""Range of the ROS domain ids that `isolated_domain` uses.

Domain 0 is the default of all nodes; above 101, the ports of a domain fall into Linux's range of ephemeral ports.
"""
FIRST_PORT, PORTS_PER_DOMAIN = 7400, 250  # of RTPS (DDSI-RTPS 2.2, 9.6.1.1)
DISCOVERY_VARIABLE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def domain_of_environment() -> int:
    """Return the ROS domain of this process, from `ROS_DOMAIN_ID` (0 if it is not set).

    Raises:
        ImpactRigError: `ROS_DOMAIN_ID` is not a whole number, at least 0.
    """
    value = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not value.isdecimal():
        raise ImpactRigError(f"ROS_DOMAIN_ID must be a whole number >= 0, got {value!r}")
    return int(value)


@contextmanager
def isolated_domain() -> Iterator[int]:
    """Reserve an unused ROS domain for the duration of a `with` statement, and yield its id.

    Two programs of one user never get the same id. Another program can still select the reserved domain by
    ROS_DOMAIN_ID. Within the statement, discovery of this process and its children is limited to this machine.

    Raises:
        ImpactRigError: all ids (1 to 49) are in use, or no lock file can be created.
    """
    try:
        files.lock_directory()
    except OSError as error:
        raise ImpactRigError(
            "cannot reserve a ROS domain: its lock file needs a private directory in one of "
            f"{', '.join(map(str, files.LOCK_PARENTS))}; the last one tried is {error.filename}: {error.strerror}"
        ) from error
    before = os.environ.get(DISCOVERY_VARIABLE)
    count = LAST_DOMAIN - FIRST_DOMAIN + 1
    first = time.monotonic_ns() // 1000 % count  # spreads the workers; the locks decide
    for domain_id in (FIRST_DOMAIN + (first + k) % count for k in range(count)):
        handle = None
        with contextlib.suppress(OSError):  # the name is taken by a link or a directory
            handle = files.hold(FOLDER, str(domain_id))
        if handle is None:
            continue
        if is_in_use(domain_id):
            os.close(handle)
            continue
        os.environ[DISCOVERY_VARIABLE] = "LOCALHOST"
        remove_litter(domain_id)
        try:
            yield domain_id
        finally:
            remove_litter(domain_id)
            os.close(handle)
            if before is None:
                del os.environ[DISCOVERY_VARIABLE]
            else:
                os.environ[DISCOVERY_VARIABLE] = before
        return
    raise ImpactRigError(
        f"no free ROS domain id between {FIRST_DOMAIN} and {LAST_DOMAIN}: each is used by a running program, or its "
        f"lock file in {files.lock_directory() / FOLDER} cannot be opened; end other programs with ROS nodes "
        "(ROS_DOMAIN_ID has no effect here)"
    )


def is_in_use(domain_id: int) -> bool:
    """Return whether a process of this machine takes part in a ROS domain: one of the domain's UDP ports is in use."""
    first = FIRST_PORT + PORTS_PER_DOMAIN * domain_id
    for table in ("/proc/net/udp", "/proc/net/udp6"):
        with contextlib.suppress(OSError):
            for line in Path(table).read_text(encoding="ascii").splitlines()[1:]:
                port = int(line.split()[1].rpartition(":")[2], 16)
                if first <= port < first + PORTS_PER_DOMAIN:
                    return True
    return False


def remove_litter(domain_id: int) -> None:
    """Remove the shared-memory ports of Fast DDS that killed processes left in a domain.

    A process that finds a half-written port may crash (https://github.com/eProsima/Fast-DDS/issues/6501). Ports in use
    stay. Call this only in an isolated domain, because a port that is just being created looks unused.
    """
    first = FIRST_PORT + PORTS_PER_DOMAIN * domain_id
    for name, number in itertools.product(segments.PORTS, range(first, first + PORTS_PER_DOMAIN)):
        port = segments.SHARED / f"{name}{number}"
        if port.exists():
            _remove_unless_in_use(port)


def _remove_unless_in_use(port: Path) -> None:
    locks = [port.with_name(f"{port.name}_{kind}") for kind in ("el", "sl")]
    with contextlib.ExitStack() as held, contextlib.suppress(BlockingIOError, PermissionError):
        for path in locks:
            with contextlib.suppress(FileNotFoundError):
                handle = os.open(path, os.O_RDONLY)
                held.callback(os.close, handle)
                fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        for path in (port, *locks, segments.SHARED / f"sem.{port.name}_mutex"):
            path.unlink(missing_ok=True)
