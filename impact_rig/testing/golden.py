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
"""Golden runs and golden values: results of a pipeline that were checked once, with which tests compare later ones.

A golden run is an ordinary MCAP run, so every tool opens it. A comparison names the first difference: topic, time, row,
column and both values.
"""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Table
from impact_rig.errors import ConfigError
from impact_rig.names import quoted
from impact_rig.recording import open_run
from impact_rig.simtime import NS_PER_S
from impact_rig.topics import SCAN

if TYPE_CHECKING:
    from impact_rig.driver import RigDriver

UPDATE_OPTION = "--rig-update-golden"
_RENEW = f"if the new result is right, run pytest once with {UPDATE_OPTION}"


class Golden:
    """Golden data of one test: a run and named numbers that were checked once, with which later results are compared.

    Args:
        directory: directory of the data, next to the test file.
        update: whether `run` and `values` replace the data by the present results instead of comparing with them. The
            option `--rig-update-golden` of pytest sets it.
    """

    def __init__(self, directory: Path, *, update: bool) -> None:
        self.directory = directory
        self._update = update

    def run(
        self, rig: RigDriver, topics: Sequence[str] = (SCAN.name,), tolerances: Mapping[str, float] | None = None
    ) -> None:
        """Compare the tables that a rig has published with those of the golden run; with `update`, replace that run.

        Args:
            rig: rig that the test has run.
            topics: topics to compare, which carry tables; an update saves all topics that the rig keeps.
            tolerances: largest absolute difference, by name of a column that each of the topics must have; all other
                columns must agree bit for bit.

        Raises:
            AssertionError: a table differs (the message has the first difference), or there is no golden run yet.
            ConfigError: the rig keeps no tables of a topic, or a topic lacks a column of `tolerances`.
            RecordingError: the golden run lacks a topic or cannot be read, or the new one cannot be written.
        """
        where = self.directory / "run"
        if self._update:
            where.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=where.parent) as new:  # a run that cannot be saved replaces nothing
                rig.save(Path(new) / "run")
                shutil.rmtree(where, ignore_errors=True)
                (Path(new) / "run").rename(where)
            return
        if not where.exists():
            raise AssertionError(self._absent(where))
        with open_run(where) as golden:
            for topic in topics:
                expected = golden.tables(topic, recorded_order=True)
                difference = first_difference(rig.tables(topic), expected, tolerances or {})
                if difference:
                    raise AssertionError(
                        f"{topic} differs from the golden run {where}; first difference: {difference}; {_RENEW}"
                    )

    def values(self, found: Mapping[str, float], rel: float = 1e-9, abs: float = 0.0) -> None:  # noqa: A002  # as in pytest.approx
        """Compare named numbers, such as results of an analysis, with the golden ones; with `update`, replace those.

        Args:
            found: the numbers by name.
            rel: fraction of a golden value by which a number may differ from it, in addition to `abs`.
            abs: absolute difference that is allowed for every number; NaN equals NaN.

        Raises:
            AssertionError: numbers differ, or only one side has a name (the message lists all of them); or there are no
                golden values yet.
        """
        where = self.directory / "values.json"
        numbers = {name: float(value) for name, value in found.items()}
        if self._update:
            where.parent.mkdir(parents=True, exist_ok=True)
            where.write_text(json.dumps(numbers, indent=1) + "\n", encoding="utf-8")
            return
        if not where.exists():
            raise AssertionError(self._absent(where))
        expected: dict[str, float] = json.loads(where.read_text(encoding="utf-8"))
        wrong = [
            f"{name}: {numbers.get(name, 'missing')}, golden {expected.get(name, 'missing')}"
            for name in sorted({*numbers, *expected})
            if name not in numbers
            or name not in expected
            or not np.isclose(numbers[name], expected[name], rel, abs, equal_nan=True)
        ]
        if wrong:
            raise AssertionError(
                f"values unlike the golden ones in {where} (rel {rel:g}, abs {abs:g}): {'; '.join(wrong)}; {_RENEW}"
            )

    def _absent(self, where: Path) -> str:
        return f"there is no {where} yet: run pytest once with {UPDATE_OPTION}, check the result, and keep it"


def first_difference(found: Iterable[Table], expected: Iterable[Table], tolerances: Mapping[str, float]) -> str:
    """Return a description of the first difference between two series of tables; an empty text if there is none.

    Other numbers of tables, rows or columns, and other stamps, are differences, too.

    Args:
        found: tables to check.
        expected: correct tables.
        tolerances: largest absolute difference, by name of a column; NaN equals NaN. Every other column must agree bit
            for bit.

    Raises:
        ConfigError: `tolerances` names a column that a compared table does not have.
    """
    got, right = list(found), list(expected)
    for one, other in zip(got, right, strict=False):
        if one.stamp_ns != other.stamp_ns or len(one.rows) != len(other.rows):
            return (
                f"{len(one.rows)} rows in the table at {one.stamp_ns / NS_PER_S:.9f} s, "
                f"golden {len(other.rows)} rows at {other.stamp_ns / NS_PER_S:.9f} s"
            )
        names = other.rows.dtype.names or ()
        if one.rows.dtype.names != names:
            return f"columns {', '.join(one.rows.dtype.names or ())}, golden {', '.join(names)}"
        unknown = set(tolerances) - set(names)
        if unknown:
            raise ConfigError(
                f"tolerances name columns that a compared table does not have: {', '.join(sorted(unknown))}; it has "
                f"{', '.join(names)}"
            )
        for name in names:
            bad = np.flatnonzero(~_agree(one.rows[name], other.rows[name], tolerances.get(name)))
            if len(bad):
                i = int(bad[0])
                return (
                    f"{name} in row {i}, counted from 0, of the table at {one.stamp_ns / NS_PER_S:.9f} s: "
                    f"{quoted(one.rows[name][i])}, golden {quoted(other.rows[name][i])}"
                )
    return "" if len(got) == len(right) else f"{len(got)} tables, golden {len(right)}"


def _agree(found: NDArray[np.generic], expected: NDArray[np.generic], tolerance: float | None) -> NDArray[np.bool_]:
    if tolerance is not None:
        return np.isclose(found.astype(float), expected.astype(float), rtol=0.0, atol=tolerance, equal_nan=True)
    if found.dtype != expected.dtype:
        return np.zeros(len(found), bool)
    if found.dtype.kind != "f":
        return np.asarray(found == expected)
    bits = f"u{found.dtype.itemsize}"
    return np.asarray(np.ascontiguousarray(found).view(bits) == np.ascontiguousarray(expected).view(bits))
