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
"""Reading of a file in a separate process with limited memory and time, in which a crash only causes an error."""

from __future__ import annotations

import contextlib
import faulthandler
import json
import os
import resource
import select
import signal
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import attrs
import numpy as np

from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.system import budget
from impact_rig_studies.importing.limits import WORKING_BYTES, WORKING_PER_BYTE
from impact_rig_studies.importing.signals import Abscissa, AbscissaKind, ImportedSignals, Real, Signal, SignalKind

LIMIT_S, LIMIT_PER_MIB_S = 8.0, 2.0
"""Limit of a reader's computing time [s]: a constant part, and a part per MiB of its file."""
MOST_S = 1e9  # the system accepts no limit that is much longer
READ_BYTES = 2**20
_REFUSED, _DAMAGED, _MEMORY, _LENGTHS = "refused", "damaged", "memory", "lengths"


def run(
    path: Path, what: str, file_bytes: int, reader: Callable[[], ImportedSignals], prepare: Callable[[], object]
) -> ImportedSignals:
    """Run a reader in a child process with limited memory and time, and return the signals that it read.

    The environment variable IMPACT_RIG_BUDGET multiplies both limits.

    Args:
        path: the file, for messages.
        what: name of its format, for messages.
        file_bytes: size of the file, which determines the limits of memory and time.
        reader: function that reads the file.
        prepare: function that imports the modules of the reader before the process is forked.

    Raises:
        RecordingError: a library is missing, or the reader rejects the file, fails, crashes, or exceeds memory or time.
        BudgetError: the reader rejects the file because it claims more content than `limits` allow.
    """
    prepare()
    seconds = min((LIMIT_S + LIMIT_PER_MIB_S * file_bytes / budget.MIB) * budget.factor(), MOST_S)
    is_late = False
    source, sink = os.pipe()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # about threads of libraries, which the child does not use
        child = os.fork()
    if not child:
        os.close(source)
        _child(reader, sink, file_bytes, seconds)
    os.close(sink)
    try:
        received = _receive(source, time.monotonic() + 4.0 * seconds)
    except TimeoutError:
        received, is_late = b"", True
        os.kill(child, signal.SIGKILL)
    finally:
        os.close(source)
        status = os.waitpid(child, 0)[1]
    head, _, numbers = received.partition(b"\n")
    if not head:
        ended_by = os.WTERMSIG(status) if os.WIFSIGNALED(status) else 0
        if is_late or ended_by == signal.SIGXCPU:
            limit = f"{4.0 * seconds:.3g} s" if is_late else f"{seconds:.3g} s of computing time"
            raise RecordingError(
                f"{path} takes longer to read than {limit}, the limit for a file of {file_bytes} bytes; if you trust "
                f"it, set the environment variable {budget.VARIABLE}=N to allow N times the default"
            )
        how = f" ({signal.strsignal(ended_by)})" if ended_by else ""
        raise RecordingError(
            f"{path} cannot be read: the process that reads it as {what} crashed{how}; the file may be damaged: export "
            "it again, or in another format"
        )
    reply: dict[str, Any] = json.loads(head)
    if _REFUSED in reply:
        kind = budget.BudgetError if reply["budget"] else RecordingError
        message = str(reply[_REFUSED])
        raise kind(message if str(path) in message else f"{path} cannot be read: {message}")
    if _MEMORY in reply:
        raise RecordingError(
            f"{path} needs more memory to read than is allowed for a file of {file_bytes} bytes; if you trust it, "
            f"set the environment variable {budget.VARIABLE}=N to allow N times the default"
        )
    if _DAMAGED in reply:
        raise RecordingError(
            f"{path} cannot be read as {what}; the file may be damaged: export it again, or in another format "
            f"({str(reply[_DAMAGED])[:300]})"
        )
    return _decoded(path, reply, memoryview(numbers))


def _child(reader: Callable[[], ImportedSignals], sink: int, file_bytes: int, seconds: float) -> NoReturn:
    """Run the reader in the child process, write its result or its error into the pipe `sink`, and end the process.

    The process is limited to `seconds` of computing time, and to an amount of memory that grows with `file_bytes`.
    """
    faulthandler.disable()
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # discards messages of a library that fails
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    reply: dict[str, object] | None = None
    found: ImportedSignals | None = None
    try:
        _limit(file_bytes, seconds)
        found = reader()
    except ImpactRigError as error:
        reply = {_REFUSED: str(error), "budget": isinstance(error, budget.BudgetError)}
    except MemoryError:
        reply = {_MEMORY: True}
    except BaseException as error:  # any error that a library raises for a damaged file or one of another format
        reply = {_DAMAGED: " ".join(str(error).split()) or type(error).__name__}
    try:
        with os.fdopen(sink, "wb") as out:
            if found is not None:
                _send(found, out)
            else:
                out.write(json.dumps(reply).encode() + b"\n")
    finally:
        os._exit(0)


def _limit(file_bytes: int, seconds: float) -> None:
    """Limit the further computing time of this process to `seconds`, and its further memory by the size of the file."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    more = budget.raised(WORKING_BYTES + WORKING_PER_BYTE * file_bytes)
    for kind, limit in (
        (resource.RLIMIT_AS, min(pages * resource.getpagesize() + more, sys.maxsize)),
        (resource.RLIMIT_CPU, round(time.process_time() + seconds) + 1),
    ):
        soft, hard = resource.getrlimit(kind)
        ends = [one for one in (soft, hard) if one != resource.RLIM_INFINITY]
        with contextlib.suppress(ValueError):
            resource.setrlimit(kind, (min([limit, *ends]), hard))


def _receive(source: int, deadline: float) -> bytes:
    """Return everything that the child process writes into a pipe, until it closes the pipe.

    Raises:
        TimeoutError: the child has not closed the pipe by the deadline [s of the monotonic clock].
    """
    parts: list[bytes] = []
    while True:
        if not select.select([source], [], [], max(0.0, deadline - time.monotonic()))[0]:
            raise TimeoutError
        part = os.read(source, READ_BYTES)
        if not part:
            return b"".join(parts)
        parts.append(part)


def _send(found: ImportedSignals, out: BinaryIO) -> None:
    """Write signals into the pipe to the parent process: a line of JSON, then the numbers of all arrays.

    In the JSON, the index of an array stands for the array. An array that several signals share is written once.
    """
    arrays: list[Real] = []
    places: dict[int, int] = {}

    def place(_owner: object, _field: object, value: object) -> object:
        if not isinstance(value, np.ndarray):
            return value
        if id(value) not in places:
            places[id(value)] = len(arrays)
            arrays.append(np.ascontiguousarray(value, np.float64))
        return places[id(value)]

    reply = attrs.asdict(found, filter=lambda field, _: field.name != "path", value_serializer=place)
    lengths = [len(one) for one in arrays]
    out.write(json.dumps({_LENGTHS: lengths, **reply}).encode() + b"\n")
    for values in arrays:
        out.write(values.data)


def _decoded(path: Path, reply: dict[str, Any], numbers: memoryview) -> ImportedSignals:
    arrays: list[Real] = []
    at = 0
    for length in reply.pop(_LENGTHS):
        arrays.append(np.frombuffer(numbers, np.float64, length, at))
        at += 8 * length
    shared: dict[str, Abscissa] = {}

    def abscissa(about: dict[str, Any]) -> Abscissa:
        key = json.dumps(about)
        if key not in shared:
            values = None if about["values"] is None else arrays[about["values"]]
            shared[key] = Abscissa(**about | {"kind": AbscissaKind(about["kind"]), "values": values})
        return shared[key]

    def signal_of(about: dict[str, Any]) -> Signal:
        values, kind = arrays[about["values"]], SignalKind(about["kind"])
        return Signal(**about | {"values": values, "kind": kind, "abscissa": abscissa(about["abscissa"])})

    signals = {name: signal_of(about) for name, about in reply["signals"].items()}
    return ImportedSignals(path, **reply | {"signals": signals, "remarks": tuple(reply["remarks"])})
