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
"""Digests of runs: computing, writing, reading and comparing them, and the first difference of two recordings."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.arithmetic import ARITHMETIC

FILE = Path(__file__).parents[2] / "test" / "data" / "digests.txt"
HEADER = f"""\
# What every supported machine must give, bit for bit: SHA-256 over the rows of each topic of the runs in
# qualification/portability/runs.py. `make test` and `make portability` compare; `make portability ARGS=--write`
# rewrites this.
# arithmetic {ARITHMETIC}
# run, topic, rows, digest
"""


@attrs.frozen
class Digest:
    """Digest of one topic of one run."""

    rows: int
    sha256: str


Digests = dict[tuple[str, str], Digest]
"""Digests by run and topic."""


def digest(rows: NDArray[np.void]) -> Digest:
    """Return the digest of rows without gaps between their columns."""
    return Digest(len(rows), hashlib.sha256(rows.tobytes()).hexdigest())


def write(digests: Digests, path: Path = FILE) -> None:
    """Replace the committed digests, one line each."""
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = (f"{run:19}{topic:15}{one.rows:>7} {one.sha256}\n" for (run, topic), one in sorted(digests.items()))
    path.write_text(HEADER + "".join(lines), encoding="utf-8")


def read(path: Path = FILE) -> Digests:
    """Read a file of digests that `write` wrote."""
    found: Digests = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            run, topic, rows, sha256 = line.split()
            found[run, topic] = Digest(int(rows), sha256)
    return found


def different(expected: Digests, found: Digests) -> dict[str, str]:
    """Return the runs with a topic that differs, with the first such topic of each; missing runs do not count."""
    runs = {run for run, _ in found}
    result: dict[str, str] = {}
    for key in sorted(expected.keys() | found.keys()):
        if key[0] in runs and key[0] not in result and expected.get(key) != found.get(key):
            result[key[0]] = key[1]
    return result


def first_difference(expected: Mapping[str, NDArray[np.void]], found: Mapping[str, NDArray[np.void]]) -> str:
    """Return topic, row, column and both values of the earliest difference of two recordings; empty if none."""
    firsts = []
    for topic in sorted(expected.keys() | found.keys()):
        if topic not in expected or topic not in found:
            return f"{topic} is in one of them only"
        one, other = expected[topic], found[topic]
        for name in one.dtype.names or ():
            count = min(len(one), len(other))
            unequal = np.flatnonzero(_bits(one[name][:count]) != _bits(other[name][:count]))
            if len(unequal):
                i = int(unequal[0])
                where = i / max(len(one), 1)
                firsts.append((where, f"{topic} row {i} of {len(one)}, {name}: {other[name][i]}, not {one[name][i]}"))
        if len(one) != len(other):
            firsts.append((1.0, f"{topic} has {len(other)} rows, not {len(one)}"))
    return min(firsts)[1] if firsts else ""


def _bits(column: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return numbers as integers, so that NaN equals NaN and 0.0 differs from -0.0; text stays unchanged."""
    return np.ascontiguousarray(column).view(f"u{column.dtype.itemsize}") if column.dtype.kind in "fiu" else column
