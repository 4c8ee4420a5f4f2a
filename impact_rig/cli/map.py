# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig map`: measure a map of the mechanics, resume it, draw it, find the best value."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from impact_rig.campaign.tasks import Runner, Store
from impact_rig.cli import tasks
from impact_rig.cli.terminal import Console, TextTable, subcommand, tell_json, tell_program
from impact_rig.errors import ConfigError
from impact_rig.maps import optimum, run
from impact_rig.maps.measure import FAILED
from impact_rig.maps.plan import DOWN, UP, load_map, measure_line
from impact_rig.states import Regime
from impact_rig.studies.dynamics import plan as plans


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "map", "map DT and regimes over two or three parameters; run again to resume",
        [
            ("map config/maps/gap_frequency.yaml", "on all cores; draws the map beside its table"),
            ("map my_map.yaml --through dask tcp://host:8786", "on a Dask cluster"),
        ],
    )  # fmt: skip
    parser.add_argument(
        "file", nargs="?", type=Path, metavar="FILE", help="map file, e.g. config/maps/gap_frequency.yaml"
    )
    parser.add_argument(
        "--exponent", action="store_true", help="measure the largest exponent of every motion that does not repeat"
    )
    tasks.add_words(parser, "map")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    file, directory, _, address = tasks.words(arguments, "map", "map config/maps/gap_frequency.yaml")
    runner = tasks.runner(measure_line, address, arguments.workers)
    plan = load_map(file, arguments.workers)
    if arguments.exponent and {UP, DOWN} & set(plan.layers):
        raise ConfigError("--exponent is of motions that begin from rest: direction must be reset")
    store = run.store(directory)
    store.prepare(plan.text, plan.base)
    console = Console(quiet=arguments.json)
    began = time.monotonic()
    measured = tasks.measure(plan.lines(), store, runner, console, lambda line: len(line.values))
    wall_s = time.monotonic() - began
    done = run.finished(plan, directory)
    more: dict[str, object] = {"wall_s": wall_s, "measured_points": measured}
    if arguments.exponent:
        more["exponents"] = _add_exponents(done, console, tasks.runner(plans.run, address, arguments.workers))
    if plan.search:
        best = optimum.find(plan, plan.search)
        more["optimum"] = best.plain()
        _print_optimum(console, best)
    run.write_results(done, more)
    if not arguments.no_figures:
        from impact_rig.report.heat_map import heat_maps  # noqa: PLC0415  # matplotlib

        folder = tasks.figures_folder(directory)
        for drawn in heat_maps(done):
            drawn.save(folder)
    console.print(f"{plan.points} points on the mechanics, {measured} of them now; {run.CSV_FILE}, {run.JSON_FILE}")
    if arguments.json:
        tell_json({"directory": str(directory), "points": plan.points, **more})
    else:
        tell_program(directory)
    return 0


def _add_exponents(done: run.FinishedMap, console: Console, runner: Runner[plans.Task]) -> int:
    """Add exponent and standard uncertainty beside the regimes; return of how many places."""
    axes, wanted = done.plan.axes, []
    for line in done.plan.lines():
        values = done.values[line.direction]
        for value in line.values:
            at = {**line.held, line.along: value}
            place = tuple(axis.index(at[name]) for name, axis in axes.items())
            if values["regime"][place] not in (Regime.PERIODIC.value, FAILED):
                wanted.append((plans.exponent_at(line, value), values, place))
    names = plans.COLUMNS[plans.EXPONENT][-2:]
    for values in done.values.values():
        values |= {name: np.full(values["dt"].shape, np.nan) for name in names}
    store: Store[plans.Task] = Store(done.directory, "map", "exponents", ("maps", "studies"))
    store.prepare(done.plan.text, done.plan.base)
    tasks.measure([task for task, _, _ in wanted], store, runner, console, lambda _: 1)
    for task, values, place in wanted:
        for name, found in zip(names, (store.get(task) or [[]])[0][-2:], strict=True):
            values[name][place] = found
    return len(wanted)


def _print_optimum(console: Console, best: optimum.Optimum) -> None:
    reading = best.reading
    console.print(
        f"best {best.over}: {best.value:.6g}, reduction {reading.reduction_percent:.2f} % (DT {reading.dt:.2f}, "
        f"{reading.regime}, {reading.impacts_per_cycle:g} impacts per cycle); within "
        f"{optimum.REGION_POINTS:g} point from {best.region[0]:.6g} to {best.region[1]:.6g}"
    )
    table = TextTable("What 1 % more of a value changes the reduction there", left=("value",), right=("points",))
    for name, points in best.points_per_percent.items():
        table.add_row(name, f"{round(points, 3) + 0.0:+.3f}")
    console.print(table)
