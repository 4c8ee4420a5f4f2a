# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Measure a map into its directory: lines that are there already stay, missing ones are measured.

| file | content |
|---|---|
| `map.yaml` | the map file as it was given |
| `configuration.yaml` | the rig, complete |
| `lines/` | one file per line |
| `map.csv` | every place, every direction |
| `map.json` | figures for programs: points, regimes, the optimum |
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Sequence
from pathlib import Path

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.campaign.store import DECIDING, fingerprint
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.maps.measure import FAILED, Reading
from impact_rig.maps.plan import DOWN, Line, MapPlan, load_map
from impact_rig.rig.config import dump, load
from impact_rig.system import files

MAP_FILE, CONFIGURATION_FILE, CSV_FILE, JSON_FILE, FOLDER = (
    "map.yaml", "configuration.yaml", "map.csv", "map.json", "lines",
)  # fmt: skip
MAX_LINE_BYTES = 64 * 2**20
_NUMBERS = Reading._fields[1:]
"""Readings but the word for the regime, which is the first."""

Runner = Callable[[Sequence[Line]], Generator[tuple[Line, list[Reading]], None, None]]
"""A way of measuring: yields every line with its readings, in any order."""


@attrs.frozen(eq=False, kw_only=True)
class FinishedMap:
    """A map with what is measured of it.

    Attributes:
        plan: what was asked for.
        directory: where it is kept.
        values: by direction and name of a reading: arrays in the order of the axes, NaN (or "") where not measured.
    """

    plan: MapPlan
    directory: Path
    values: dict[str, dict[str, NDArray[np.generic]]]


def prepare(plan: MapPlan, directory: Path) -> None:
    """Make the map's directory.

    Raises:
        RecordingError: it cannot be written, or holds something else.
    """
    if directory.exists() and any(directory.iterdir()) and not (directory / MAP_FILE).exists():
        raise RecordingError(f"{directory} is not empty and holds no map: choose another --output")
    try:
        files.make_folder(directory / FOLDER)
        files.write_text(directory / MAP_FILE, plan.text)
        files.write_text(directory / CONFIGURATION_FILE, dump(plan.base))
    except OSError as error:
        raise RecordingError(f"cannot write {directory}: {error.strerror}") from error


def measure(
    lines: Sequence[Line], directory: Path, runner: Runner
) -> Generator[tuple[Line, list[Reading]], None, None]:
    """Yield every line with its readings as soon as they are stored: those stored already first.

    Raises:
        RecordingError: a line cannot be stored.
    """
    missing = []
    for line in lines:
        readings = stored(line, directory)
        if readings is None:
            missing.append(line)
        else:
            yield line, readings
    if not missing:
        return
    with contextlib.closing(runner(missing)) as measured:
        for line, readings in measured:
            _store(line, readings, directory)
            yield line, readings


def finished(plan: MapPlan, directory: Path) -> FinishedMap:
    """Return a map with everything that is stored of it."""
    shape, names = tuple(map(len, plan.axes.values())), list(plan.axes)
    values: dict[str, dict[str, NDArray[np.generic]]] = {}
    for line in plan.lines():
        if line.direction not in values:
            values[line.direction] = {
                name: np.full(shape, "", "U12") if name == "regime" else np.full(shape, math.nan)
                for name in Reading._fields
            }
        readings = stored(line, directory)
        if readings is None:
            continue
        place = tuple(slice(None) if name == line.along else plan.axes[name].index(line.held[name]) for name in names)
        ordered = readings[::-1] if line.direction == DOWN else readings
        for i, name in enumerate(Reading._fields):
            values[line.direction][name][place] = [reading[i] for reading in ordered]
    return FinishedMap(plan=plan, directory=directory, values=values)


def open_map(directory: Path) -> FinishedMap:
    """Return the map in a directory.

    Raises:
        ConfigError: it is no map's directory.
    """
    if not (directory / MAP_FILE).exists() or not (directory / FOLDER).is_dir():
        raise ConfigError(f"{directory} is no map's directory: `impact-rig map FILE --output NEW` makes one")
    return finished(load_map(directory / MAP_FILE, resolved=load(directory / CONFIGURATION_FILE)), directory)


def write_results(done: FinishedMap, more: dict[str, object]) -> None:
    """Write `map.csv` and `map.json`."""
    text = io.StringIO(newline="")
    writer = csv.writer(text)
    names, rows = table(done)
    writer.writerow(names)
    writer.writerows([["" if isinstance(cell, float) and math.isnan(cell) else cell for cell in row] for row in rows])
    files.write_text(done.directory / CSV_FILE, text.getvalue())
    regimes = {
        layer: dict(sorted(Counter(str(word) for word in values["regime"].ravel() if word).items()))
        for layer, values in done.values.items()
    }
    content = {"title": done.plan.title, "points": done.plan.points, "measured_on": "mechanics", "regimes": regimes}
    files.write_text(done.directory / JSON_FILE, json.dumps({**content, **more}, indent=2) + "\n")


def table(done: FinishedMap) -> tuple[list[str], list[list[object]]]:
    """Return the names of the columns and a row a measured place; NaN where a reading is none."""
    return [*done.plan.axes, "direction", *Reading._fields], list(_rows(done))


def _rows(done: FinishedMap) -> Iterable[list[object]]:
    axes = list(done.plan.axes.values())
    for layer, values in done.values.items():
        for place in np.ndindex(*map(len, axes)):
            if not values["regime"][place]:
                continue
            numbers = [float(values[name][place]) for name in _NUMBERS]
            yield [
                *(axis[i] for axis, i in zip(axes, place, strict=True)), layer,
                str(values["regime"][place]), *numbers,
            ]  # fmt: skip


def code() -> str:
    """Return what decides a map's numbers: results of other code are measured anew."""
    return fingerprint((*DECIDING, "maps"))


def stored(line: Line, directory: Path) -> list[Reading] | None:
    """Return what is stored of a line, or None if it is to be measured: never was, with other code, or damaged."""
    try:
        found = json.loads(files.read_bytes(directory / FOLDER / f"{line.key}.json", MAX_LINE_BYTES))
        rows = found["readings"]
        if found["code"] != code() or found["key"] != line.key or len(rows) != len(line.values):
            return None
        return [_reading(row) for row in rows]
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError):
        return None


def _store(line: Line, readings: Sequence[Reading], directory: Path) -> None:
    rows = [[one.regime, *(x if math.isfinite(x) else None for x in map(float, one[1:]))] for one in readings]
    content = {
        "line": line.describe(),
        "key": line.key,
        "code": code(),
        "along": line.along,
        "values": line.values,
        "readings": rows,
    }
    try:
        files.write_text(directory / FOLDER / f"{line.key}.json", json.dumps(content) + "\n")
    except OSError as error:
        raise RecordingError(f"cannot write {directory / FOLDER}: {error.strerror}") from error


def _reading(row: Sequence[object]) -> Reading:
    if len(row) != len(Reading._fields):
        raise ValueError("not a reading")
    numbers = [math.nan if value is None else float(value) for value in row[1:]]  # type: ignore[arg-type]  # it raises
    if any(math.isinf(value) for value in numbers) or not (row[0] == FAILED or numbers[0] > 0.0):
        raise ValueError("not a reading")
    return Reading(str(row[0]), *numbers)
