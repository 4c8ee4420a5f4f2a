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
"""Fuzz targets, and the loop that passes inputs to them."""

from __future__ import annotations

import dataclasses
import faulthandler
import resource
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis import strategies as st

from impact_rig.errors import ImpactRigError

HANG_S = 10.0
"""An input that computes for longer is a finding; if it has waited as long, the stack is printed."""
MEMORY_MIB = 256.0
"""A run of a target with a process that uses more memory is a finding."""
BATCH = 1000
"""Number of examples drawn with one seed."""


@dataclasses.dataclass(frozen=True)
class Target:
    """Reader of hostile input.

    Attributes:
        name: name on the command line.
        inputs: strategy of the inputs.
        check: function that takes one input; it raises an ImpactRigError to reject it, or returns (inputs, rejections)
            if the input was a sequence.
        modules: files of the repository whose branches it should reach.
    """

    name: str
    inputs: st.SearchStrategy[Any]
    check: Callable[[Any], tuple[int, int] | None]
    modules: tuple[str, ...]


@dataclasses.dataclass
class Tally:
    """Counts and times of the inputs."""

    inputs: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    peak_mib: float = 0.0  # of the largest process so far
    largest: str = ""  # the first input after which a process had used too much
    wall_s: float = 0.0


def prepared(target: Target, examples: int, number: int, tally: Tally) -> Callable[[], None]:
    """Return a hypothesis test that passes `examples` inputs, drawn with a seed, and counts them.

    Its `hypothesis.fuzz_one_input` takes bytes, as a coverage-guided fuzzer needs.
    """

    @seed(number)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        print_blob=True,
        phases=(Phase.generate, Phase.shrink),
        suppress_health_check=list(HealthCheck),
    )
    @given(target.inputs)
    def each(value: Any) -> None:
        started = _cpu_s()
        faulthandler.dump_traceback_later(HANG_S)  # prints where a slow input is, while it is there
        try:
            inputs, refused = target.check(value) or (1, 0)
        except ImpactRigError:
            inputs, refused = 1, 1
        finally:
            faulthandler.cancel_dump_traceback_later()
        took = _cpu_s() - started
        tally.inputs += inputs
        tally.refused += refused
        tally.slowest_s = max(tally.slowest_s, took)
        tally.peak_mib = max(tally.peak_mib, _peak_mib())
        if tally.peak_mib > MEMORY_MIB and not tally.largest:
            tally.largest = repr(value)
        assert took < HANG_S, f"{target.name}: one input took {took:.1f} s"

    return each


def _cpu_s() -> float:
    """Return the CPU time of this process and of its ended children [s], unaffected by other loads."""
    return sum(one.ru_utime + one.ru_stime for one in _used())


def _peak_mib() -> float:
    """Return the peak memory of this process and of its ended children [MiB]."""
    # ru_maxrss of a started program begins with that of its parent
    status = Path("/proc/self/status").read_text(encoding="ascii")
    own = next(line for line in status.splitlines() if line.startswith("VmHWM:"))
    return max(int(own.split()[1]), resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) / 1024.0


def _used() -> list[resource.struct_rusage]:
    return [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]


def run(target: Target, inputs: int, number: int = 0) -> Tally:
    """Pass at least this many inputs to a target; an exception is a finding, reduced to its smallest form.

    hypothesis omits repetitions and stops early if a space is small; further seeds make up for that.
    """
    tally, started = Tally(), time.perf_counter()
    while tally.inputs < inputs:
        prepared(target, min(inputs - tally.inputs, BATCH), number, tally)()
        number += 1
    tally.wall_s = time.perf_counter() - started
    return tally
