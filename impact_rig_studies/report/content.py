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
"""Content of a report's page as data: every displayed table, figure and number is also written to a file.

Each number of the page is in `report.json`, at full precision and in its displayed unit, or in `points.csv` or
`summary.json`. A test proves this.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import attrs
from markupsafe import Markup

from impact_rig.analysis.uncertainty_budget import COVERAGE, Budget, plus_minus
from impact_rig.drawing import Drawn
from impact_rig.system import files
from impact_rig_studies.report import page

FILE_NAME = "report.json"
LARGEST_BYTES = 100_000_000  # limit of an earlier `report.json` that is read
LEAST_SHARE = 1e-6  # share of the variance below which a line of the budget is left out


@attrs.frozen
class Cell:
    """Cell of a table in a report that shows a number: its text, and the number in the same unit for `report.json`."""

    text: str
    value: float | Sequence[float] | None
    """Number in the displayed unit, or a value and its expanded uncertainty; None if there is no number."""


def number(value: float, spec: str = ".6g") -> Cell:
    """Return a cell with a number, formatted by `spec`; the cell is empty if the number is not finite.

    A rounded zero has no minus sign.
    """
    return Cell(format(value, f"z{spec}"), value) if math.isfinite(value) else Cell("", None)


def uncertain(value: float, u: float) -> Cell:
    """Return a cell with a value and, after ±, its expanded uncertainty: `COVERAGE` times the standard uncertainty `u`.

    If `u` is not finite, the cell shows the value alone; if the value is not finite, the cell is empty.
    """
    if not (math.isfinite(value) and math.isfinite(u)):
        return number(value)
    return Cell(plus_minus(value, u), (value, COVERAGE * u))


BUDGET_HEADINGS = ("source", "error", "type", "relative u (%)", "u(DT)", "share of variance (%)")


def budget_rows(found: Budget) -> list[list[str | Cell]]:
    """Return the rows of a table of an uncertainty budget of a transmissibility (DT), with columns `BUDGET_HEADINGS`.

    Each row shows one contribution. Contributions below a share of `LEAST_SHARE` of the variance are left out. The last
    row shows the combined standard uncertainty.
    """
    relative = found.u_transmissibility / found.transmissibility
    rows: list[list[str | Cell]] = [
        [
            part.source, part.what, part.evaluation, number(100.0 * part.u_relative, ".2g"),
            number(part.u_relative * found.transmissibility, ".2g"), number(100.0 * found.share(part), ".1f"),
        ]
        for part in found.parts if found.share(part) >= LEAST_SHARE
    ]  # fmt: skip
    total = [number(100.0 * relative, ".2g"), number(found.u_transmissibility, ".2g"), Cell("100", 100.0)]
    return [*rows, ["combined", "standard uncertainty", "", *total]]


def earlier_figures(path: Path) -> set[str]:
    """Return the names of the figures of an earlier report whose `report.json` is at `path`.

    If the file is missing or invalid, the result is empty. Names that are longer than 100 characters or contain special
    characters are left out.
    """
    try:
        found = json.loads(files.read_bytes(path, LARGEST_BYTES))["figures"]
        return {name for name in found if re.fullmatch(r"[\w -]{1,100}", name)}
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()


class Content:
    """Collection of the facts, tables and figures of a report, from which `report.json` is written.

    Attributes:
        drawn: figures so far, to be saved.
    """

    def __init__(self) -> None:
        self.drawn: list[Drawn] = []
        self._facts: dict[str, object] = {"coverage_factor": COVERAGE}
        self._tables: dict[str, object] = {}

    def fact(self, name: str, value: float | str, spec: str = "") -> str:
        """Store a number or text of the page under `name`, and return it formatted by `spec`.

        An earlier value with the same name is replaced.
        """
        self._facts[name] = value
        return format(value, spec)

    def table(
        self, name: str, headings: Sequence[str], rows: Iterable[Sequence[str | Cell]], numeric: Iterable[int] = ()
    ) -> Markup:
        """Store the cells of a table under `name`, and return the table as HTML for the page.

        An earlier table with the same name is replaced. Columns whose indices are in `numeric` are right-aligned.
        """
        kept = [list(row) for row in rows]
        self._tables[name] = {
            "columns": list(headings),
            "rows": [[cell.value if isinstance(cell, Cell) else cell for cell in row] for row in kept],
        }
        texts = [[cell.text if isinstance(cell, Cell) else cell for cell in row] for row in kept]
        return page.table(headings, texts, numeric)

    def figures(self, found: Iterable[Drawn], *, large: bool = False) -> Markup:
        """Store figures so that they can be saved, and return them as HTML for the page; `large` makes them larger."""
        new = list(found)
        self.drawn += new
        return page.figures(new, large=large)

    def write(self, path: Path, title: str) -> None:
        """Write the title and everything stored so far into a JSON file at `path`."""
        figures = {
            one.name: {
                "caption": one.caption,
                "cases": [{"case": line.label, **{n: list(v) for n, v in line.columns.items()}} for line in one.lines],
            }
            for one in self.drawn
        }
        content = {"title": title, "facts": self._facts, "tables": self._tables, "figures": figures}
        files.write_text(path, json.dumps(files.plain(content), indent=1, ensure_ascii=False) + "\n")
