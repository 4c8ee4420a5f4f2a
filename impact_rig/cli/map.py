# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig map`: measure a map of the mechanics, resume it, draw it, find the best value."""

from __future__ import annotations

import argparse
import contextlib
import time
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeElapsedColumn, TimeRemainingColumn

from impact_rig.campaign.pool import in_parallel
from impact_rig.cli import command
from impact_rig.cli.terminal import Console, Steps, TextTable, Words, add_json, tell_json, tell_program
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.maps import optimum, run
from impact_rig.maps.plan import Line, load_map, measure_line
from impact_rig.system import files

WAYS = ("process", "dask")


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
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
        "--through", nargs="+", default=["process"], metavar="WAY",
        help="process: all cores (default); dask ADDRESS: on a Dask cluster",
    )  # fmt: skip
    parser.add_argument("--output", type=Path, metavar="DIR", help="default: runs/map_<file>; resumed if it exists")
    parser.add_argument("--workers", type=int, metavar="N", help="processes (default: one per core)")
    add_json(parser)
    parser.add_argument("--no-figures", action="store_true", help="measure only")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    file, runner = _words(arguments)
    if arguments.workers is not None and arguments.workers < 1:
        raise ConfigError(f"--workers must be >= 1, got {arguments.workers}")
    plan = load_map(file, arguments.workers)
    directory = (arguments.output or Path("runs") / f"map_{file.stem}").resolve()
    run.prepare(plan, directory)
    console = Console(quiet=arguments.json)
    began = time.monotonic()
    measured = _measure(plan.lines(), directory, runner, console)
    wall_s = time.monotonic() - began
    done = run.finished(plan, directory)
    more: dict[str, object] = {"wall_s": wall_s, "measured_points": measured}
    if plan.search:
        best = optimum.find(plan, plan.search)
        more["optimum"] = best.plain()
        _print_optimum(console, best)
    run.write_results(done, more)
    if not arguments.no_figures:
        _draw(done, directory)
    console.print(f"{plan.points} points on the mechanics, {measured} of them now; {run.CSV_FILE}, {run.JSON_FILE}")
    if arguments.json:
        tell_json({"directory": str(directory), "points": plan.points, **more})
    else:
        tell_program(directory)
    return 0


def _words(arguments: argparse.Namespace) -> tuple[Path, run.Runner]:
    """Return file and runner; the file may stand behind `--through` and its words, too."""
    way, *rest = arguments.through
    if way not in WAYS:
        raise ConfigError(f"--through must be one of {', '.join(WAYS)}, got {way!r}")
    runner: run.Runner = lambda lines: in_parallel(measure_line, lines, arguments.workers)  # noqa: E731  # either of two
    if way == "dask":
        if not rest:
            raise ConfigError("--through dask needs the address of a scheduler, e.g. tcp://127.0.0.1:8786")
        from impact_rig.campaign.pool import on_cluster  # noqa: PLC0415  # needs dask

        runner = on_cluster(measure_line, rest.pop(0))
    file = arguments.file or (Path(rest.pop(0)) if rest else None)
    if file is None or rest:
        raise ConfigError("one map file is needed, e.g. impact-rig map config/maps/gap_frequency.yaml")
    return file, runner


def _measure(lines: list[Line], directory: Path, runner: run.Runner, console: Console) -> int:
    """Measure what is missing; return how many places that were."""
    new = sum(len(line.values) for line in lines if run.stored(line, directory) is None)
    columns = (
        Words("{task.description}"), BarColumn(24), MofNCompleteColumn(), TimeElapsedColumn(),
        Words("left"), TimeRemainingColumn(), Words("{task.fields[state]}"),
    )  # fmt: skip
    bar = Progress(*columns, console=console, disable=not console.is_terminal)
    with (
        bar as progress,
        contextlib.closing(run.measure(lines, directory, runner)) as done,
    ):
        total = sum(len(line.values) for line in lines)
        task = progress.add_task("points", total=total, state="starting")
        steps, count = Steps("points", total), 0
        for line, _ in done:
            count += len(line.values)
            progress.update(task, completed=count, state=line.describe())
            if not console.is_terminal:
                steps.show(count, line.describe())
        progress.update(task, state="done")
    return new


def _print_optimum(console: Console, best: optimum.Optimum) -> None:
    reading = best.reading
    console.print(
        f"best {best.over}: {best.value:.6g}, reduction {reading.reduction_percent:.2f} % (DT {reading.dt:.2f}, "
        f"{reading.regime}, {reading.impacts_per_cycle:g} impacts per cycle); within "
        f"{optimum.REGION_POINTS:g} point from {best.region[0]:.6g} to {best.region[1]:.6g}"
    )
    table = TextTable(title="What 1 % more of a value changes the reduction there")
    table.add_column("value")
    table.add_column("points", justify="right")
    for name, points in best.points_per_percent.items():
        table.add_row(name, f"{round(points, 3) + 0.0:+.3f}")
    console.print(table)


def _draw(done: run.FinishedMap, directory: Path) -> None:
    from impact_rig.report.heat_map import heat_maps  # noqa: PLC0415  # matplotlib

    folder = directory / "figures"
    try:
        files.make_folder(folder)
    except OSError as error:
        raise RecordingError(f"cannot write {folder}: {error.strerror}") from error
    for drawn in heat_maps(done):
        drawn.save(folder)
