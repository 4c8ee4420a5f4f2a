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
"""Common form of the content of imported files: named signals with their abscissas, and a list of omitted parts.

Every reader of a format returns this form, and all later steps of the import use it.
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]


class SignalKind(enum.StrEnum):
    """Kind of data that a signal contains; only time responses can be channels of a run."""

    TIME_RESPONSE = "time response"
    SPECTRUM = "spectrum"
    FRF = "frequency response"
    OTHER = "other"


class AbscissaKind(enum.StrEnum):
    """Quantity over which a signal is given; `NONE` if the file gives neither times nor a rate."""

    TIME = "time"
    FREQUENCY = "frequency"
    OTHER = "other"
    NONE = "none"  # the file gives neither times nor a rate


@attrs.frozen(eq=False)
class Abscissa:
    """Times or frequencies at which a signal is given: evenly spaced, listed one by one, or both.

    Times are in seconds, even if `unit` is another unit of time. All other values are in `unit`.
    """

    kind: AbscissaKind = AbscissaKind.NONE
    unit: str = ""  # unit in the file; empty if the file names none
    start: float = 0.0  # first value
    step: float | None = None  # spacing that the file states for all values; None if it states none
    values: Real | None = None  # values that the file lists, relative to the first, shape (n,); None if it lists none
    resolution: float = 0.0  # half of the last digit of step or values; 0 if they are exact
    note: str = ""  # assumption of the reader, as text; empty if none

    def __str__(self) -> str:
        """Return a description of the times or frequencies for the user, such as `time from 0 s, step 0.001 s`."""
        if self.kind is AbscissaKind.NONE:
            return "no times and no rate"
        unit = "s" if self.kind is AbscissaKind.TIME else self.unit
        if self.step is not None:
            return f"{self.kind} from {self.start:g} {unit}, step {self.step:.10g} {unit}"
        count = 0 if self.values is None else len(self.values)
        return f"{self.kind} from {self.start:g} {unit}, {count} listed values"


NO_ABSCISSA = Abscissa()


def even_times(rate_hz: float, start_s: float = 0.0) -> Abscissa:
    """Return the abscissa of evenly spaced samples at a stated rate; the first sample is at `start_s`."""
    return Abscissa(AbscissaKind.TIME, "s", start_s, 1.0 / rate_hz)


@attrs.frozen(eq=False)
class Signal:
    """Series of numbers from an imported file, with its unit, its abscissa and its kind."""

    values: Real  # shape (n,)
    unit: str = ""  # unit in the file; empty if the file names none
    abscissa: Abscissa = NO_ABSCISSA
    kind: SignalKind = SignalKind.TIME_RESPONSE
    origin: str = ""  # place in the file: column 3, dataset 2, group/channel

    @property
    def rate_hz(self) -> float | None:
        """Samples per second that the file states; None without a stated rate, even if times are listed."""
        step = self.abscissa.step
        return 1.0 / step if self.abscissa.kind is AbscissaKind.TIME and step else None

    @property
    def time_s(self) -> Real | None:
        """Listed times since the first sample [s], shape (n,); None if the file lists no times."""
        return self.abscissa.values if self.abscissa.kind is AbscissaKind.TIME else None


@attrs.frozen(eq=False)
class ImportedSignals:
    """Content of a file that another program wrote, in a form that is the same for all file formats."""

    path: Path
    format: str  # name of the format for messages
    signals: Mapping[str, Signal]  # by name, in the order of the file; lengths may differ
    start_ns: int | None = None  # stamp of the first sample; None if the file has none
    texts: Mapping[str, list[str]] = attrs.field(factory=dict)
    """Columns of words by heading, such as the names of channels in an exported `daq/info`."""
    left_out: Mapping[str, str] = attrs.field(factory=dict)
    """Parts of the file that are not signals: name to the reason, for the user."""
    remarks: tuple[str, ...] = ()  # assumptions about the complete file, as text

    @property
    def begins_s(self) -> float:
        """Time of the first sample of the first time signal [s], counted from the zero of the file's times.

        It is 0 if `start_ns` states the date of this sample, or if no signal has times.
        """
        if self.start_ns is not None:
            return 0.0
        starts = (one.abscissa.start for one in self.signals.values() if one.abscissa.kind is AbscissaKind.TIME)
        return next(starts, 0.0)


def reasons(left_out: Mapping[str, str]) -> str:
    """Return a text that lists the parts left out of a file, as `name: reason`, cut to 300 characters."""
    return "; ".join(f"{name}: {why}" for name, why in left_out.items())[:300]


class UniqueNames:
    """Generator of unique names for signals.

    Args:
        reserved: names that it never returns.
    """

    def __init__(self, reserved: tuple[str, ...] = ()) -> None:
        self._taken = set(reserved)
        self._counts: dict[str, int] = {}

    def unique(self, name: str) -> str:
        """Return the name; if it is reserved or was returned before, append a number (`name_2`, `name_3`, ...)."""
        candidate = name
        while candidate in self._taken:
            self._counts[name] = self._counts.get(name, 1) + 1
            candidate = f"{name}_{self._counts[name]}"
        self._taken.add(candidate)
        return candidate
