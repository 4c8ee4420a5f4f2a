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
"""Commands `impact-rig map` and `dynamics`: studies of the mechanics without instruments, which can be resumed."""

from __future__ import annotations

import argparse
import math
from collections import Counter

import numpy as np

from impact_rig.cli.terminal import Console, TextTable, figure, tell_results
from impact_rig.errors import ConfigError
from impact_rig.states import Regime
from impact_rig.system import files
from impact_rig_studies.campaign.pool import cluster_threads
from impact_rig_studies.campaign.tasks import Row, Runner, TaskStore
from impact_rig_studies.cli import tasks
from impact_rig_studies.dynamics import plan as plans
from impact_rig_studies.dynamics.plan import Plan
from impact_rig_studies.maps import optimum, run
from impact_rig_studies.maps.measure import FAILED
from impact_rig_studies.maps.plan import DOWN, UP, load_map, measure_line

SHOWN = {
    plans.ORBIT: ("event", "period", "dt", "impacts_per_cycle", "loss_factor", "multiplier_real", "multiplier_imag"),
    plans.CONTINUE: ("event", "dt", "impacts_per_cycle", "loss_factor", "multiplier_real", "multiplier_imag"),
    plans.EXPONENT: plans.COLUMNS[plans.EXPONENT][1:],
}
"""Columns of a study's rows that the terminal shows after the parameter, by kind of study."""
MOST_ROWS = 40  # largest number of rows that the terminal shows
EXPONENTS = "exponents"  # folder of the exponents in a map's directory


def run_map(arguments: argparse.Namespace) -> int:
    """Compute the missing points of a map file, write, draw and print the map, and return the exit code.

    The code is 0 if the motion could be simulated at one point or more, else 1.
    """
    file, directory, _, address = tasks.words(arguments, "map", "map config/maps/gap_frequency.yaml")
    runner = tasks.runner(measure_line, address, arguments.workers)
    plan = load_map(file, cluster_threads(address) if address else arguments.workers)
    if arguments.exponent and {UP, DOWN} & set(plan.layers):
        raise ConfigError(
            f"--exponent needs motions that start from rest: `direction` in {file} must be reset, or omit --exponent"
        )
    store = run.store(directory)
    console = Console(quiet=arguments.json)
    with files.results_in(directory, lambda: store.prepare(plan.text, plan.base)):
        measured, wall_s = tasks.measure(plan.lines(), store, runner, console, lambda line: len(line.values))
    done = run.finished(plan, directory)
    more: dict[str, object] = {"wall_s": wall_s, "measured_points": measured}
    if arguments.exponent or (directory / EXPONENTS).is_dir():  # exponents that are stored stay in the results
        exponents = tasks.runner(plans.run, address, arguments.workers) if arguments.exponent else None
        more["exponents"] = _add_exponents(done, console, exponents)
    unsolved = sum(int(np.count_nonzero(values["regime"] == FAILED)) for values in done.values.values())
    if plan.search and unsolved < plan.points:
        best = optimum.find(plan, plan.search)
        more["optimum"] = best.plain()
        _print_optimum(console, best)
    run.write_results(done, more)
    if not arguments.no_figures:
        from impact_rig_studies.report.heat_map import heat_maps  # noqa: PLC0415  # matplotlib

        folder = tasks.figures_folder(arguments, directory)
        for drawn in heat_maps(done):
            drawn.save(folder, arguments.formats)
    console.print(
        f"{plan.points} points of the mechanics without instruments, {measured} of them computed now; results in "
        f"{run.CSV_FILE} and {run.JSON_FILE}"
    )
    if unsolved == plan.points:
        console.print(
            f"the motion could not be simulated at any of the {plan.points} points: check the ranges in {file}",
            style="red",
        )
    tell_results(directory, {"points": plan.points, **more}, as_json=arguments.json)
    return 1 if unsolved == plan.points else 0


def _add_exponents(done: run.FinishedMap, console: Console, runner: Runner[plans.StudyTask] | None) -> int:
    """Add the largest Lyapunov exponents [1/s] and their standard uncertainties to the values of a finished map.

    Only motions that are not periodic have an exponent. Other points are NaN. `runner` computes missing exponents; None
    means that only stored exponents are added. Return the number of points with a stored result.
    """
    axes, wanted = done.plan.axes, []
    for line in done.plan.lines():
        values = done.values[line.direction]
        for value in line.values:
            at = {**line.held, line.along: value}
            place = tuple(axis.index(at[name]) for name, axis in axes.items())
            if values["regime"][place] not in (Regime.PERIODIC.value, FAILED):
                wanted.append((plans.exponent_at(line, value), values, place))
    names = ("exponent_per_s", "uncertainty_per_s")
    part = [plans.COLUMNS[plans.EXPONENT].index(name) for name in names]
    for values in done.values.values():
        values |= {name: np.full(values["dt"].shape, np.nan) for name in names}
    store: TaskStore[plans.StudyTask] = TaskStore(done.directory, "map", EXPONENTS, ("maps", "dynamics"))
    if runner:
        store.prepare(done.plan.text, done.plan.base)
        tasks.measure([task for task, _, _ in wanted], store, runner, console, lambda _: 1)
    stored = [(rows[0], values, place) for task, values, place in wanted if (rows := store.get(task))]
    for row, values, place in stored:
        for name, found in zip(names, (row[i] for i in part), strict=True):
            values[name][place] = found
    return len(stored)


def _print_optimum(console: Console, best: optimum.Optimum) -> None:
    reading = best.reading
    console.print(
        f"largest reduction of DT at {best.over} {best.value:.6g}: {reading.reduction_percent:z.2f} % "
        f"(DT {reading.dt:.2f}, {reading.regime}, {reading.impacts_per_cycle:g} impacts per cycle); from "
        f"{best.region[0]:.6g} to {best.region[1]:.6g} the reduction is smaller by at most {optimum.REGION_POINTS:g} "
        "percentage point"
    )
    table = TextTable(
        "Change of this reduction if a value of the configuration is 1 % larger", left=("value",), right=("points",)
    )
    for name, points in best.points_per_percent.items():
        table.add_row(name, figure(points, "+.3f"))
    console.print(table)


def run_dynamics(arguments: argparse.Namespace) -> int:
    """Compute the missing tasks of a dynamics study, write, draw and print its rows, and return the exit code.

    The code is 0 if at least one row has a result, else 1.
    """
    kind = arguments.kind
    file, directory, _, address = tasks.words(arguments, "dynamics", f"dynamics {kind} config/dynamics/nominal.yaml")
    runner = tasks.runner(plans.run, address, arguments.workers)
    plan = plans.load(file, kind)
    store = plans.store(directory)
    console = Console(quiet=arguments.json)
    with files.results_in(directory, lambda: store.prepare(plan.text, plan.base)):
        measured, wall_s = tasks.measure(plan.tasks, store, runner, console, lambda _: 1)
    done = plans.finished(plan, directory)
    rows, missing = done.rows, plans.without_results(done.found)
    files.write_csv(directory / f"{kind}.csv", *done.table())
    content = {
        "title": plan.title, "kind": kind, "measured_on": "mechanics", "tasks": len(plan.tasks), "rows": len(rows),
        "measured_tasks": measured, "wall_s": wall_s, **({"without_results": missing} if missing else {}),
        **_summary(done),
    }  # fmt: skip
    files.write_json(directory / f"{kind}.json", content)
    if not arguments.no_figures:
        from impact_rig_studies.dynamics.figures import drawn  # noqa: PLC0415  # matplotlib

        drawn(plan, done.found).save(tasks.figures_folder(arguments, directory), arguments.formats)
    _show(console, done)
    for line in missing:
        console.print(line)
    console.print(f"{len(rows)} rows of the mechanics without instruments; results in {kind}.csv and {kind}.json")
    empty = _unsolved(plan, rows) == len(rows)
    if empty:
        console.print(
            "there is no result: no motion could be simulated, or none led to an orbit; change the values or starts in "
            f"{file}",
            style="red",
        )
    tell_results(directory, content, as_json=arguments.json)
    return 1 if empty else 0


def _special(done: plans.FinishedStudy) -> list[dict[str, object]]:
    """Return the key rows of a study for JSON, as mappings from column to value.

    Of a continued branch, only rows with an event are included, such as its start or a fold. Of other studies, all rows
    are included. NaN and infinity become None.
    """
    names, rows = done.table()
    named = [dict(zip(names, row, strict=True)) for row in rows]
    return [
        {name: None if isinstance(cell, float) and not math.isfinite(cell) else cell for name, cell in row.items()}
        for row in named
        if done.plan.kind != plans.CONTINUE or row["event"] != "orbit"
    ]


def _unsolved(plan: Plan, rows: list[Row]) -> int:
    """Return the number of rows without a result: the motion could not be simulated, or no orbit was found from it."""
    word = next((plan.columns.index(name) for name in ("regime", "event") if name in plan.columns), None)
    words = [] if word is None else [str(row[word]) for row in rows]
    return sum(one == FAILED or one.startswith(plans.NO_ORBIT) for one in words)


def _summary(done: plans.FinishedStudy) -> dict[str, object]:
    """Return the key results of a study as data for JSON.

    A basin has the shares of its motions with their 95 % intervals. A bifurcation diagram has the number of failed
    rows, if any. A section has none. Other studies have their key rows (`_special`).
    """
    plan, rows = done.plan, done.rows
    if plan.kind == plans.BASIN:
        from impact_rig_studies.dynamics.figures import motion  # noqa: PLC0415  # as above

        counts = Counter(motion(plan, row) for row in rows)
        # for random starts; for a grid the same, with boundaries finer than the grid
        return {
            "shares": {name: count / len(rows) for name, count in sorted(counts.items())},
            "shares_95_percent": {name: _wilson(count, len(rows)) for name, count in sorted(counts.items())},
        }
    if plan.kind == plans.BIFURCATION:
        failed = _unsolved(plan, rows)
        return {"failed_rows": failed} if failed else {}
    if plan.kind == plans.SECTION:
        return {}
    return {"found": _special(done)}


def _wilson(count: int, total: int) -> list[float]:
    """Return lower and upper limit of Wilson's 95 % interval for a share, estimated as `count` of `total` trials."""
    from scipy.stats import binomtest  # noqa: PLC0415  # slow to import

    interval = binomtest(count, total).proportion_ci(0.95, "wilson")
    return [float(interval.low), float(interval.high)]


def _show(console: Console, done: plans.FinishedStudy) -> None:
    plan, rows, summary = done.plan, done.rows, _summary(done)
    for name, share in summary.get("shares", {}).items():  # type: ignore[attr-defined]  # a mapping
        low, high = summary["shares_95_percent"][name]  # type: ignore[index]  # likewise
        console.print(
            f"{100.0 * share:.2f} % of the initial states lead to: {name} "
            f"(95 % interval {100.0 * low:.2f} to {100.0 * high:.2f} %)"
        )
    if "failed_rows" in summary:
        console.print(
            f"{summary['failed_rows']} of {len(rows)} rows have no result (regime {FAILED}): the motion cannot be "
            "simulated there"
        )
    if plan.kind not in SHOWN:
        return
    special = [row for row in _special(done) if not str(row.get("event", "")).startswith(plans.NO_ORBIT)]
    shown = [name for name in done.table()[0] if name in ("start", "branch", plan.columns[0], *SHOWN[plan.kind])]
    table = TextTable(right=[name.replace("_", " ") for name in shown])
    for row in special[:MOST_ROWS]:
        cells = [row[name] for name in shown]
        table.add_row(*(f"{cell:z.5g}" if isinstance(cell, float) else str(cell or "-") for cell in cells))
    console.print(table)
