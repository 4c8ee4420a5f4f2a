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
"""The exceptions of impact_rig, one type per kind of mistake; a message names the mistake and what is allowed."""

from __future__ import annotations

import difflib
import traceback
from collections.abc import Iterable

LONGEST_WORD = 100  # longest word that is compared: the time grows with its length


def did_you_mean(word: str, known: Iterable[str], question: str = ": did you mean {}?", otherwise: str = "") -> str:
    """Return a hint for the message about an unknown word.

    It is `question` with the most similar known word in its braces, or `otherwise` if no known word is similar.
    """
    close = difflib.get_close_matches(word[:LONGEST_WORD], list(known), n=1)
    return question.format(close[0]) if close else otherwise


class ImpactRigError(Exception):
    """Base class of all errors that this package raises on purpose.

    Examples:
        >>> import impact_rig
        >>> try:
        ...     impact_rig.simulate(20.0, {"barriers.gap_m": 6})
        ... except impact_rig.ImpactRigError as error:
        ...     print(error)
        barriers.gap_m must be >= 1e-06 and <= 1, got 6.0 m
    """


class ConfigError(ImpactRigError, ValueError):
    """A configuration value, key or file is invalid.

    The message names the key, its value, the allowed range and, if there is one, the file.
    """


class CommandError(ImpactRigError, ValueError):
    """A command was rejected.

    The message names the value and the allowed range. The shaker keeps its last valid state.
    """


class CodecError(ImpactRigError, ValueError):
    """Bytes are not the message that they should be.

    The message names the part of the message and the reason.
    """


class RecordingError(ImpactRigError, OSError):
    """A run cannot be written or read.

    Data that were already on disk are not changed. The message names the file.
    """


class GoneError(ImpactRigError, RuntimeError):
    """A process of a rig, analysis or recorder that this program uses has ended, so that it cannot answer a request."""


class SimulationError(ImpactRigError, RuntimeError):
    """The simulation cannot continue.

    The cause is a defect of the model or its tolerances, never a user's command.
    """


def describe(error: BaseException) -> str:
    """Return an unexpected error as one line for users: type, message, and the source line that raised it."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({frames[-1].filename.rsplit('/', 1)[-1]}:{frames[-1].lineno})" if frames else ""
    return f"{type(error).__name__}: {error}{where}"


def reason_of(error: BaseException) -> str:
    """Return why an input was rejected, for users: the message of an `ImpactRigError`, or `describe` of any other."""
    return str(error) if isinstance(error, ImpactRigError) else describe(error)
