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
"""Exceptions of impact_rig, one type per kind of mistake, and functions that word their messages."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Iterable

LONGEST_WORD = 100  # longest word that is compared: the time grows with its length


def did_you_mean(word: str, known: Iterable[str], question: str = ": did you mean {}?", otherwise: str = "") -> str:
    """Return a hint to append to an error message about an unknown word.

    The hint is `question`, in which the most similar word of `known` replaces the braces. If no word is similar, the
    hint is `otherwise`.
    """
    close = difflib.get_close_matches(word[:LONGEST_WORD], list(known), n=1)
    return question.format(close[0]) if close else otherwise


class ImpactRigError(Exception):
    """Base class of all errors that this package reports to users.

    The message names the value, what is allowed and what to do. It is one line, unless it quotes a log. A wrong call in
    code, such as an argument out of range, can also raise a plain `ValueError`.

    Examples:
        >>> import impact_rig
        >>> try:
        ...     impact_rig.simulate(20.0, {"barriers.gap_m": 6})
        ... except impact_rig.ImpactRigError as error:
        ...     print(error)
        barriers.gap_m must be >= 1e-06 and <= 1, got 6.0 m
    """


class ConfigError(ImpactRigError, ValueError):
    """Invalid configuration value, key or file; also a `ValueError`.

    The message names the key or file, and what is wrong: usually the value and the allowed range.

    Examples:
        >>> import impact_rig
        >>> try:
        ...     impact_rig.LocalRig({"barriers.gap": 0.006})
        ... except impact_rig.ConfigError as error:
        ...     print(error)
        unknown key 'barriers.gap', did you mean 'barriers.gap_m'?
    """


class CommandError(ImpactRigError, ValueError):
    """Rejection of a command, or trip or stop of the shaker during a test; also a `ValueError`.

    The message names the value and the allowed range, or the state of the rig that excludes the command. After a
    rejection the shaker keeps its last valid state.

    Examples:
        >>> import impact_rig
        >>> try:
        ...     impact_rig.LocalRig().command(frequency_hz=1000.0)
        ... except impact_rig.CommandError as error:
        ...     print(error)
        frequency must be >= 5 and <= 200 Hz, got 1000 Hz
    """


class CodecError(ImpactRigError, ValueError):
    """Invalid bytes of a ROS message, or table that cannot be encoded as a message; also a `ValueError`.

    The text of the error names the part of the message and the reason.

    Examples:
        >>> import impact_rig
        >>> try:
        ...     impact_rig.decode(b"")
        ... except impact_rig.CodecError as error:
        ...     print(error)
        a message with a header has at least 12 bytes, got 0
    """


class RecordingError(ImpactRigError, OSError):
    """Failure to write or read a run, or another file or directory of results; also an `OSError`.

    Data that were already on disk are not changed. The message names the file, if one is concerned.

    Examples:
        >>> import impact_rig
        >>> try:
        ...     impact_rig.open_run("missing")
        ... except impact_rig.RecordingError as error:
        ...     print(error)
        missing does not exist: check the path
    """


class GoneError(ImpactRigError, RuntimeError):
    """End or replacement of a rig or another node that this program uses; also a `RuntimeError`.

    The process will not answer any further request. The message names the process and quotes the end of its log, or it
    names the request that a rig did not answer.
    """


class SimulationError(ImpactRigError, RuntimeError):
    """Failure of the simulation, which cannot continue; also a `RuntimeError`.

    In a rig, the cause is a defect of the model, its tolerances or a contact law, never a command: please report it. In
    a study or fit, the message can instead ask for another start, value or configuration.
    """


def describe(error: BaseException) -> str:
    """Return an unexpected error as text for users: `TYPE: MESSAGE (FILE:LINE)`.

    FILE:LINE is the line of code that raised the error; it is left out if unknown.
    """
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rsplit('/', 1)[-1]}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def reason_of(error: BaseException) -> str:
    """Return why an input was rejected, for users: the message of an `ImpactRigError`, or `describe` of any other."""
    return str(error) if isinstance(error, ImpactRigError) else describe(error)
