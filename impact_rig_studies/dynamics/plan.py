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
"""Plans of dynamics studies: validation of a YAML file, its division into tasks, and their results.

Tasks are independent of one another, so that several processes can run them in any order.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs
import numpy as np

from impact_rig.config.tree import Value
from impact_rig.errors import ConfigError, SimulationError
from impact_rig.rig.config import RigConfig, differences, from_flat, to_flat
from impact_rig_studies import dynamics
from impact_rig_studies.campaign import axes, tables
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ
from impact_rig_studies.campaign.plan import STARTS
from impact_rig_studies.campaign.tasks import HashedTask, Row, TaskStore, load_plan
from impact_rig_studies.dynamics import orbits
from impact_rig_studies.dynamics.stroboscope import Energy, OrbitSummary, Place, Properties, Stroboscope, at, size
from impact_rig_studies.maps import exponent
from impact_rig_studies.maps.measure import CHUNK, FAILED, MapRig, Reading, Settings
from impact_rig_studies.maps.plan import (
    BOTH,
    CURRENT,
    DOWN,
    FREQUENCY,
    GAP,
    POSITION,
    RESET,
    SPEED,
    UP,
    MapLine,
    refuse_owned,
)

SECTION, BIFURCATION, BASIN, ORBIT, CONTINUE, EXPONENT = KINDS = dynamics.KINDS
POINT = ("x_1_m", "v_1_m_s", "x_2_m", "v_2_m_s")
STATE = ("x_1_m", "v_1_m_s", "x_b_m", "v_b_m_s", "coil_a", "d_m", "d_rate_m_s")
MOST_STATES = len(STATE)
_ORBIT = (
    "value", "event", "stable", "period", *Properties._fields[:-1], *(f"{name}_j" for name in Energy._fields),
    "multiplier_real", "multiplier_imag", "residual", "turn",
    *(f"multiplier_{number}_{part}" for number in range(2, MOST_STATES + 1) for part in ("real", "imag")), *STATE,
)  # fmt: skip
COLUMNS: Mapping[str, tuple[str, ...]] = {
    SECTION: POINT,
    BIFURCATION: ("value", "regime", "dt", "impacts_per_cycle", "period", *POINT),
    BASIN: (POSITION, SPEED, "attractor", "regime", "dt", "impacts_per_cycle", "cycles"),
    ORBIT: _ORBIT,
    CONTINUE: _ORBIT,
    EXPONENT: ("value", "regime", "dt", "exponent_per_s", "uncertainty_per_s", "settled_cycles"),
}
"""Columns of the rows of results, by kind of study.

`value` is the value of the parameter [SI]. On a branch, `event` is `start`, `orbit`, the kind of change there, or the
reason why the branch ends there; in a study of one orbit it is the kind of stability. A start from which no orbit is
found has one row, whose event is `NO_ORBIT` with the reason, and whose numbers are NaN. Multipliers are sorted, the
largest first; columns without a multiplier are NaN. State values are those at the section, where the phase of the
drive is `turn`. `settled_cycles` is the number of cycles from which regime and DT were measured, before the exponent.
"""
NAMES = (FREQUENCY, CURRENT, GAP)
UNRESOLVED = "the motion cannot be simulated"
NO_ORBIT = "no orbit: "  # beginning of the event of a start from which no orbit is found
CHUNK_VALUES = 20  # number of parameter values in one task of a bifurcation diagram, each measured from rest
_CYCLES, _WINDOWS = 100, 20  # default number of cycles in each window, and of windows, of an exponent
_PARTS = 20.0  # number of dimensionless steps of 1 into which the range of a continued parameter is divided
_LOOKED = 7  # number of starts along either axis to search for a basin's attractors
_NEAR = 1e-3  # distance, relative to an orbit's size, within which an approaching motion counts as one that reaches it
_SAME = 1e-4  # relative distance within which orbits are equal
_MOST_CYCLES = 1200  # number of cycles after which a motion that has reached no known attractor is measured itself

Start = str | tuple[float, float]


@attrs.frozen(kw_only=True)
class StudyTask(HashedTask):
    """Independent part of a dynamics study.

    It contains every value that determines its results, so that its hash identifies the stored results. The same code
    reuses stored results.
    """

    kind: str  # kind of the study
    name: str  # name for users, such as parameter values and start
    changes: Mapping[str, Value]  # configuration values that differ from the default rig, by dotted name
    settings: Settings  # criteria by which motions count as settled and periodic
    frequency_hz: float  # frequency of the drive, unless it is the parameter
    current_a: float  # amplitude of the drive (A, m or V by `drive.kind`), unless it is the parameter
    what: Mapping[str, object]  # arguments of the function that runs this kind of task, by name

    def describe(self) -> str:
        """Return the name of the task for progress messages, such as its parameter values and start."""
        return self.name

    @property
    def place(self) -> Place:
        """Rig of the task, with frequency and amplitude of its drive.

        The parameter that the study varies has its original value.
        """
        return Place(from_flat(RigConfig(), self.changes), self.frequency_hz, self.current_a)

    def read(self, rows: Sequence[Row]) -> list[Row]:
        """Check rows that were stored for this task, and return them as tuples.

        Raises:
            ValueError: a row does not have the number of columns of this kind of study.
        """
        columns = len(COLUMNS[self.kind])
        for row in rows:
            if len(row) != columns:
                raise ValueError(f"each stored row of the study {self.kind} must have {columns} values, got {len(row)}")
        return [tuple(row) for row in rows]


@attrs.frozen(eq=False, kw_only=True)
class Plan:
    """Plan of one dynamics study: the rig, and the tasks into which its section of a YAML file is divided."""

    kind: str  # kind of the study
    title: str  # title for users
    base: RigConfig  # the rig before a parameter is changed
    text: str  # text of the YAML file
    over: str  # name of the parameter that the study varies; empty if it varies none
    tasks: tuple[StudyTask, ...]  # in the order of their results

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns of the rows of results.

        The name of the study's parameter replaces `value`. For the kind `orbit`, which varies no parameter,
        `frequency_hz` replaces it.
        """
        return tuple((self.over or FREQUENCY) if name == "value" else name for name in COLUMNS[self.kind])


Found = Sequence[tuple[StudyTask, Sequence[Row]]]


@attrs.frozen(eq=False)
class FinishedStudy:
    """Dynamics study with its stored results from the present code.

    Some tasks may have no results yet.
    """

    plan: Plan
    found: Found  # each task with its rows of results, empty for a task without stored results

    @property
    def rows(self) -> list[Row]:
        """Rows of results of all tasks, one after the other, with the columns `plan.columns`."""
        return [row for _, rows in self.found for row in rows]

    def table(self) -> tuple[list[str], list[list[object]]]:
        """Return the results of all tasks as one table: the names of its columns, and its rows.

        Except for a basin, the first columns identify the task. They are `start` (start of the sphere), `direction` for
        a bifurcation diagram (up, down or reset), and `branch` for a continuation (number of the branch, from 1).
        """
        found = []
        front: dict[str, object] = {}
        for number, (task, rows) in enumerate(self.found, 1):
            front = _front(task, number)
            found += [[*front.values(), *row] for row in rows]
        return [*front, *self.plan.columns], found

    def to_dataframe(self) -> Any:
        """Return the table as a `pandas.DataFrame`.

        Raises:
            ImpactRigError: pandas is not installed, or no task has stored results yet.
        """
        return tables.to_dataframe(*self.table())

    def to_xarray(self) -> Any:
        """Return the table as an `xarray.Dataset`.

        A basin has the dimensions speed and position of its starts. Other studies have the dimension `row`.

        Raises:
            ImpactRigError: xarray is not installed, or no task has stored results yet.
        """
        if self.plan.kind == BASIN:
            return tables.to_xarray(*self.table(), grid=(SPEED, POSITION))
        return tables.to_xarray(*self.table(), coordinates=("start", "direction", "branch", self.plan.columns[0]))


def _front(task: StudyTask, number: int) -> dict[str, object]:
    """Return the columns that identify a task in a table of all tasks, by name (`FinishedStudy.table`).

    `number` is the number of the task in its plan, from 1.
    """
    if task.kind == BASIN:
        return {}
    front: dict[str, object] = {"start": named(task.what["start"])}
    if task.kind == BIFURCATION:
        front["direction"] = direction_of(task)
    if task.kind == CONTINUE:
        front["branch"] = number
    return front


def direction_of(task: StudyTask) -> str:
    """Return the order in which a task of a bifurcation diagram visits its parameter values: `up`, `down` or `reset`.

    With `up` and `down`, each motion continues the motion at the previous value, if that could be simulated. With
    `reset`, each motion starts from rest.
    """
    values = task.what["values"]
    assert isinstance(values, Sequence)
    return RESET if not task.what["marched"] else UP if values[0] <= values[-1] else DOWN


def store(directory: str | Path) -> TaskStore[StudyTask]:
    """Return the store of the tasks of dynamics studies, with the plan file and results in a directory."""
    return TaskStore(Path(directory), "dynamics", "tasks", ("maps", "dynamics"))


def open_study(directory: str | Path, kind: str) -> FinishedStudy:
    """Read a dynamics study with the results stored so far, for tables and figures.

    Args:
        directory: output directory of `impact-rig dynamics`.
        kind: kind of study, one of `KINDS`.

    Raises:
        ConfigError: the directory is not that of a dynamics study of this kind, or contains no row of results of it
            from this code.
    """
    kept = store(directory)
    plan = load(kept.file, kind, kept.configuration())
    done = finished(plan, directory)
    if not done.rows:
        if any(kept.get(task) is not None for task in plan.tasks):
            raise ConfigError(
                f"{directory}: the study {kind} has no points, because no start so far gave a motion that can be "
                "simulated; change the starts, the drive or the rig in the file of the study, and run it into another "
                "directory"
            )
        raise ConfigError(
            f"{directory} has no results of the study {kind} from this version of the code; run "
            f"impact-rig dynamics {kind} {kept.file} --output {directory}"
        )
    return done


def finished(plan: Plan, directory: str | Path) -> FinishedStudy:
    """Return a planned study with the results that its output directory already contains, possibly none.

    Damaged results, and those of other code, are left out.
    """
    kept = store(directory)
    return FinishedStudy(plan, [(task, kept.get(task) or []) for task in plan.tasks])


def kinds(directory: str | Path) -> list[str]:
    """Return the kinds of dynamics study with results of this code in a directory, in the order of `KINDS`.

    Args:
        directory: output directory of `impact-rig dynamics`; its plan file may define several kinds.

    Raises:
        ConfigError: the directory is not that of dynamics studies.
    """
    kept = store(directory)
    rig = kept.configuration()
    asked = load_plan(kept.file, "dynamics file", lambda document, _: axes.mapping("a dynamics file", document))
    return [kind for kind in KINDS if kind in asked and finished(load(kept.file, kind, rig), directory).rows]


def run(task: StudyTask) -> list[Row]:
    """Simulate the motions of a task, and return its rows of results with the columns `COLUMNS[task.kind]`.

    If a motion cannot be simulated, the measured values of its row are NaN, and its `regime` or `event` says so. A
    section then has no rows.
    """
    return _RUNNERS[task.kind](task, **task.what)


def load(path: str | Path, kind: str, resolved: RigConfig | None = None) -> Plan:
    """Read the plan of one dynamics study from its section of a YAML file; other studies' sections are not checked.

    For a basin, this already simulates some starts, to find the periodic motions that they lead to.

    Args:
        path: path of the YAML file.
        kind: kind of study, which is also the key of the section.
        resolved: rig that replaces the file's `config` and `set`, for stored results; None means that of the file.

    Raises:
        ConfigError: the file cannot be read, has no such section, or a value is wrong.
    """
    file = Path(path)
    return load_plan(file, "dynamics file", lambda document, text: _read(document, text, file, kind, resolved))


def exponent_at(line: MapLine, value: float) -> StudyTask:
    """Return a task that computes the largest Lyapunov exponent of the motion at one point of a map.

    Args:
        line: line of the map on which the point lies. Its direction must not be up or down, because the task starts
            from rest; this is not checked.
        value: value of the parameter that varies along the line, at the point.
    """
    changes, frequency, current, sphere = line.place(value)
    changes = {**line.changes, **changes}
    start = sphere or from_flat(RigConfig(), changes).sphere.start
    what = {"over": FREQUENCY, "value": frequency, "start": start, "cycles": _CYCLES, "windows": _WINDOWS}
    return StudyTask(
        kind=EXPONENT, name=f"{line.along} {value:g}, {line.describe()}", changes=changes, settings=line.settings,
        frequency_hz=frequency, current_a=current, what=what,
    )  # fmt: skip


def _read(document: object, text: str, path: Path, kind: str, resolved: RigConfig | None) -> Plan:
    top = axes.mapping("a dynamics file", document)
    axes.check_keys("", top, ("title", "config", "set", FREQUENCY, CURRENT, "measure", *KINDS))
    if kind not in top:
        defined = ", ".join(one for one in KINDS if one in top)
        raise ConfigError(
            f"the file has no section named {kind}, which defines this study: add it (docs/how-to/dynamics.md), or "
            f"choose a study that the file defines ({defined or 'none so far'})"
        )
    rig = resolved or axes.rig(top, path.parent, refuse_owned)
    changes = differences(rig)
    settings = axes.settings("measure", top.get("measure"), Settings)
    frequency_hz = axes.number(FREQUENCY, top.get(FREQUENCY, FREQUENCY_HZ), 0.0, 1e4)
    current_a = axes.number(CURRENT, top.get(CURRENT, CURRENT_A), 0.0)
    over, parts = _PARTS_OF[kind](axes.mapping(kind, top[kind]), Place(rig, frequency_hz, current_a), settings)
    tasks = tuple(
        StudyTask(
            kind=kind, name=name, changes=changes, settings=settings, frequency_hz=frequency_hz, current_a=current_a,
            what=what,
        )
        for name, what in parts
    )  # fmt: skip
    return Plan(kind=kind, title=str(top.get("title", path.stem)), base=rig, text=text, over=over, tasks=tasks)


Parts = tuple[str, list[tuple[str, dict[str, object]]]]


def _section_parts(given: Mapping[str, object], _place: Place, _settings: Settings) -> Parts:
    axes.check_keys(SECTION, given, ("starts", "cycles", "turn"))
    cycles = axes.whole("section.cycles", given.get("cycles", 2000), 1, 100_000)
    turn = axes.number("section.turn", given.get("turn", 0.0), -1.0, 1.0) % 1.0
    return "", [(named(start), {"start": start, "cycles": cycles, "turn": turn}) for start in _starts(SECTION, given)]


def _bifurcation_parts(given: Mapping[str, object], place: Place, _settings: Settings) -> Parts:
    axes.check_keys(BIFURCATION, given, ("over", "values", "direction", "starts", "cycles", "turn"))
    over, values = _over(BIFURCATION, given, place)
    direction = axes.word("bifurcation.direction", given.get("direction", BOTH), (RESET, UP, DOWN, BOTH))
    held = {
        "over": over,
        "cycles": axes.whole("bifurcation.cycles", given.get("cycles", 48), 8, 10_000),
        "turn": axes.number("bifurcation.turn", given.get("turn", 0.0), -1.0, 1.0) % 1.0,
    }
    parts: list[tuple[str, dict[str, object]]] = []
    for start in _starts(BIFURCATION, given):
        ways = {UP: [values], DOWN: [values[::-1]], BOTH: [values, values[::-1]]}
        marched = direction != RESET and len(values) > 1
        chunks = [values[i : i + CHUNK_VALUES] for i in range(0, len(values), CHUNK_VALUES)]
        for line in ways[direction] if marched else chunks:
            name = f"{over} {line[0]:g} to {line[-1]:g}, {named(start)}"
            parts.append((name, {**held, "values": line, "start": start, "marched": marched}))
    return over, parts


def _basin_parts(given: Mapping[str, object], place: Place, settings: Settings) -> Parts:
    axes.check_keys(BASIN, given, (POSITION, SPEED))
    half = 0.5 * place.config.barriers.gap_m
    positions = axes.numbers(f"basin.{POSITION}", given.get(POSITION), -half - 1e-12, half)
    speeds = axes.numbers(f"basin.{SPEED}", given.get(SPEED), -100.0, 100.0)
    known = [list(one) for one in _attractors(place, settings, positions, speeds)]
    return "", [
        (f"{SPEED} {speed:g}", {"positions": positions, "speed": speed, "attractors": known}) for speed in speeds
    ]


def _orbit_parts(given: Mapping[str, object], _place: Place, _settings: Settings) -> Parts:
    axes.check_keys(ORBIT, given, ("starts",))
    return "", [(named(start), {"start": start}) for start in _starts(ORBIT, given)]


def _continue_parts(given: Mapping[str, object], place: Place, _settings: Settings) -> Parts:
    axes.check_keys(CONTINUE, given, ("over", "from", "to", "at", "starts", "points"))
    over = _parameter(CONTINUE, given, place)
    low = axes.number("continue.from", given.get("from"), 0.0)
    high = axes.number("continue.to", given.get("to"), low)
    points = axes.whole("continue.points", given.get("points", 400), 2, 100_000)
    values = axes.numbers("continue.at", given.get("at"), np.nextafter(low, 0.0), high)
    return over, [
        (
            f"{over} {value:g}, {named(start)}",
            {"over": over, "low": low, "high": high, "value": value, "start": start, "points": points},
        )
        for start in _starts(CONTINUE, given)
        for value in values
    ]


def _exponent_parts(given: Mapping[str, object], place: Place, _settings: Settings) -> Parts:
    axes.check_keys(EXPONENT, given, ("over", "values", "starts", "cycles", "windows"))
    over, values = _over(EXPONENT, {"over": FREQUENCY, "values": place.frequency_hz, **given}, place)
    held = {
        "over": over,
        "cycles": axes.whole("exponent.cycles", given.get("cycles", _CYCLES), 10, 100_000),
        "windows": axes.whole("exponent.windows", given.get("windows", _WINDOWS), 4, 1000),
    }
    return over, [
        (f"{over} {value:g}, {named(start)}", {**held, "value": value, "start": start})
        for start in _starts(EXPONENT, given)
        for value in values
    ]


_PARTS_OF: Mapping[str, Callable[[Mapping[str, object], Place, Settings], Parts]] = {
    SECTION: _section_parts,
    BIFURCATION: _bifurcation_parts,
    BASIN: _basin_parts,
    ORBIT: _orbit_parts,
    CONTINUE: _continue_parts,
    EXPONENT: _exponent_parts,
}


def _parameter(kind: str, given: Mapping[str, object], place: Place) -> str:
    over = str(given.get("over", GAP))
    refuse_owned(f"{kind}.over", over)
    if over not in NAMES and not isinstance(to_flat(place.config).get(over), float):
        raise axes.wrong(
            f"{kind}.over", f"one of {', '.join(NAMES)}, or a number of the configuration by its dotted name", over
        )
    return over


def _over(kind: str, given: Mapping[str, object], place: Place) -> tuple[str, tuple[float, ...]]:
    over = _parameter(kind, given, place)
    least = 0.0 if over in (FREQUENCY, CURRENT) else -math.inf  # the configuration has the range of the others
    values = tuple(sorted(axes.numbers(f"{kind}.values", given.get("values"), least)))
    for value in (values[0], values[-1]):
        at(place, over, value)
    return over, values


def _starts(kind: str, given: Mapping[str, object]) -> list[Start]:
    """Read the starts of the sphere from a section of the file; the default is the left wall.

    A start is a word of `sphere.start` (such as left), or a pair of position [m] and speed [m/s], each of them within
    ±100. ConfigError, which names the section `kind`, is raised for an empty list or another value.
    """
    found: list[Start] = []
    listed = given.get("starts", ["left"])
    if listed == []:
        raise axes.wrong(f"{kind}.starts", "at least one start", listed)
    for i, one in enumerate(listed if isinstance(listed, list) else [listed]):
        if isinstance(one, list) and len(one) == 2:
            place, speed = (
                axes.number(f"{kind}.starts[{i}][{j}]", value, -100.0, 100.0) for j, value in enumerate(one)
            )
            found.append((place, speed))
        elif one in STARTS:
            found.append(str(one))
        else:
            rule = f"one of {', '.join(STARTS)}, or a list of position [m] and speed [m/s]"
            raise axes.wrong(f"{kind}.starts[{i}]", rule, one)
    return found


def named(start: object) -> str:
    """Return a start of the sphere as text, such as "0.001 m at 0 m/s" or "left".

    `start` is a word of `STARTS`, or a pair (position [m], speed [m/s]).
    """
    return start if isinstance(start, str) else "{:g} m at {:g} m/s".format(*start)  # type: ignore[misc]  # a pair


def _begun(place: Place, start: Start, settings: Settings) -> MapRig:
    """Return a new rig at rest, at a point of parameter space, with its sphere at the position and speed `start`."""
    config = place.config
    rig = MapRig(from_flat(config, {"sphere.start": start}) if isinstance(start, str) else config, settings)
    rig.reset(None if isinstance(start, str) else (start[0], start[1]))
    return rig


def _points(rig: MapRig, place: Place, cycles: int, turn: float) -> list[list[float]]:
    """Continue the motion of a rig, and return its state once per cycle with the columns `POINT`.

    `turn` is the phase of the drive, in turns, at which the state is read. The list is empty if the motion cannot be
    simulated.
    """
    try:
        motion = rig.run_cycles(place.frequency_hz, place.amplitude, cycles)
    except SimulationError:
        return []
    number = np.arange(motion.first_tick, motion.last_tick + 1)
    offset = np.full(cycles, turn / place.frequency_hz)
    points: list[list[float]] = motion.quantities(("x_1", "v_1", "x_2", "v_2"), number, offset).T.tolist()
    return points


def _section(task: StudyTask, start: Start, cycles: int, turn: float) -> list[Row]:
    place = task.place
    rig = _begun(place, start, task.settings)
    if rig.measure(place.frequency_hz, place.amplitude).regime == FAILED:
        return []  # the rig has been reset: its next motion is not settled
    return [tuple(point) for point in _points(rig, place, cycles, turn)]


def _bifurcation(
    task: StudyTask, over: str, values: Sequence[float], start: Start, marched: bool, cycles: int, turn: float
) -> list[Row]:
    rows: list[Row] = []
    rig: MapRig | None = None
    for value in values:
        place = at(task.place, over, value)
        if rig is None or not marched:
            rig = _begun(place, start, task.settings)
        else:
            rig.carry(place.config)
        reading = rig.measure(place.frequency_hz, place.amplitude)
        count = int(reading.period) if math.isfinite(reading.period) else cycles
        points = [] if reading.regime == FAILED else _points(rig, place, count, turn)
        if not points:
            rows.append((value, FAILED, *[math.nan] * 7))
            rig = None
        head = (value, reading.regime, reading.dt, reading.impacts_per_cycle, reading.period)
        rows += [(*head, *point) for point in points]
    return rows


def _orbit(task: StudyTask, start: Start) -> list[Row]:
    try:
        strobe, one = _found(task, FREQUENCY, task.frequency_hz, start, 1.0)
    except SimulationError as reason:
        return [_without_orbit(task.frequency_hz, reason)]
    return [_row(one, strobe.note(one), 1.0, strobe.kind(one))]


def _continue(
    task: StudyTask, over: str, low: float, high: float, value: float, start: Start, points: int
) -> list[Row]:
    unit = (high - low) / _PARTS
    try:
        strobe, first = _found(task, over, value, start, unit)
    except SimulationError as reason:
        return [_without_orbit(value, reason)]
    turn = strobe.turn
    here = _row(first, strobe.note(first), unit, "start")
    rows: list[Row] = []
    for way in (-1.0, 1.0):
        strobe.turn = turn
        arc = orbits.followed(
            strobe,
            first,
            way,
            (low / unit, high / unit),
            points=points,
            noted=strobe.note,
            born=strobe.born,
            moved=strobe.moved,
        )
        half = [_row(one, one.note, unit, "orbit") for one in arc.orbits]
        half += [_row(one.orbit, one.note, unit, one.kind) for one in arc.changes]
        if arc.orbits:
            half.append(_row(arc.orbits[-1], arc.orbits[-1].note, unit, arc.end))
        rows = [*half[::-1], here] if way < 0.0 else [*rows, *half]
        if arc.end == "closed":
            break
    return rows


def _found(task: StudyTask, over: str, value: float, start: Start, unit: float) -> tuple[Stroboscope, orbits.Orbit]:
    """Return the map of a rig, and the periodic orbit of this map to which the motion from a start settles.

    The parameter `over` of the map has the value `value`, and changes by `unit` for one dimensionless step. If there is
    no such orbit, SimulationError is raised, with the reason as its message.
    """
    place = at(task.place, over, value)
    strobe = Stroboscope(task.place, over, unit)
    rig = _begun(place, start, task.settings)
    reading = rig.measure(place.frequency_hz, place.amplitude)
    if reading.regime == FAILED:
        raise SimulationError(UNRESOLVED)
    if not math.isfinite(reading.period):
        raise SimulationError(f"the motion does not repeat: it is {reading.regime}")
    one = orbits.orbit(strobe, strobe.seen(rig, value / unit, reading), value / unit)
    if one is None:
        raise SimulationError(
            "the motion repeats, but Newton's method does not converge to an orbit near it; try another start or value"
        )
    return strobe, one


def _without_orbit(value: float, reason: SimulationError) -> Row:
    """Return the row of results for a start from which no orbit is found, at the parameter `value`."""
    return (value, f"{NO_ORBIT}{reason}", *[math.nan] * (len(_ORBIT) - 2))


def without_results(found: Found) -> list[str]:
    """Return one line for each task without a section or orbit, with its name and the reason.

    A section without stored rows counts as a motion that cannot be simulated. Tasks of other kinds of study are
    ignored.
    """
    lines = []
    for task, rows in found:
        if task.kind in (ORBIT, CONTINUE) and rows and str(rows[0][1]).startswith(NO_ORBIT):
            lines.append(f"no orbit from {task.name}: {str(rows[0][1]).removeprefix(NO_ORBIT)}")
        elif task.kind == SECTION and not rows:
            lines.append(f"no section from {task.name}: {UNRESOLVED}")
    return lines


def _row(one: orbits.Orbit, note: object, unit: float, event: str) -> Row:
    assert isinstance(note, OrbitSummary)
    properties, cycles, turn, state = note
    multipliers = np.full(MOST_STATES, complex(math.nan, math.nan))
    multipliers[: len(one.multipliers)] = one.multipliers
    largest, *others = ((float(each.real), float(each.imag)) for each in multipliers)
    return (
        one.p * unit, event, float(one.stable), float(cycles), *properties[:-1], *properties.energy,
        *largest, one.residual, turn, *itertools.chain(*others), *state,
    )  # fmt: skip


def _exponent(task: StudyTask, over: str, value: float, start: Start, cycles: int, windows: int) -> list[Row]:
    place = at(task.place, over, value)
    rig = _begun(place, start, task.settings)
    reading = rig.measure(place.frequency_hz, place.amplitude)
    strobe = Stroboscope(place, FREQUENCY, 1.0)
    try:
        z = None if reading.regime == FAILED else strobe.seen(rig, place.frequency_hz, reading)
    except SimulationError:
        z = None
    if z is None:
        return [(value, FAILED, *[math.nan] * 4)]
    strobe.cycles = 1
    found = exponent.largest(lambda z, n: strobe(z, place.frequency_hz, n), z, cycles, windows)
    rate = place.frequency_hz
    return [(value, reading.regime, reading.dt, rate * found.value, rate * found.uncertainty, reading.cycles)]


def _attractors(
    place: Place, settings: Settings, positions: Sequence[float], speeds: Sequence[float]
) -> list[tuple[str | float, ...]]:
    """Return the periodic motions with impacts to which starts on a coarse grid of a basin lead.

    They save time: the simulation of a start ends as soon as it approaches one of these motions.

    Returns:
        For each motion, sorted by DT and without duplicates, these numbers: DT, impacts per cycle, period in cycles,
        and then the seven values of `Simulation.state` at the beginning of each cycle.
    """
    some = [
        [values[i] for i in sorted({*np.linspace(0, len(values) - 1, _LOOKED).astype(int).tolist()})]
        for values in (positions, speeds)
    ]
    found: list[tuple[str | float, ...]] = []
    for start in itertools.product(*some):
        rig = _begun(place, start, settings)
        reading = rig.measure(place.frequency_hz, place.amplitude)
        if not math.isfinite(reading.period) or not reading.impacts_per_cycle:
            continue
        states = _states(rig, place, int(reading.period))
        if states and all(_distance(states[0], one, size(place, states[0])) > _SAME for one in found):
            found.append((reading.dt, reading.impacts_per_cycle, reading.period, *np.concatenate(states).tolist()))
    return sorted(found)


def _states(rig: MapRig, place: Place, cycles: int) -> list[np.ndarray]:
    """Continue the motion of a rig for some cycles, and return its state at the beginning of each.

    The list is empty if the sphere is in contact with a wall at one of these times, or the motion cannot be simulated.
    """
    states = []
    for _ in range(cycles):
        state = rig.simulation.state()
        if state is None:
            return []
        states.append(state)
        try:
            rig.run_cycles(place.frequency_hz, place.amplitude, 1)
        except SimulationError:
            return []
    return states


def _distance(state: np.ndarray, attractor: Sequence[str | float], scale: np.ndarray) -> float:
    """Return the distance of a state from the nearest state of an attractor.

    The distance is the largest difference of the state values, each divided by its `scale`. `attractor` is a periodic
    motion from `_attractors`.
    """
    states = np.array(attractor[3:], float).reshape(-1, len(state))
    return float(np.abs((states - state) / scale).max(axis=1).min())


def _basin(
    task: StudyTask, positions: Sequence[float], speed: float, attractors: Sequence[Sequence[str | float]]
) -> list[Row]:
    place = task.place
    rig = MapRig(place.config, task.settings)
    rows: list[Row] = []
    for position in positions:
        rig.reset((position, speed))
        try:
            label, cycles = _led_to(rig, place, attractors)
        except SimulationError:
            rows.append((position, speed, -1.0, FAILED, math.nan, math.nan, math.nan))
            continue
        if label >= 0:
            dt, impacts = (float(value) for value in attractors[label][:2])
            rows.append((position, speed, float(label), "periodic", dt, impacts, float(cycles)))
            continue
        reading: Reading = rig.measure(place.frequency_hz, place.amplitude)
        rows.append(
            (position, speed, -1.0, reading.regime, reading.dt, reading.impacts_per_cycle, cycles + reading.cycles)
        )
    return rows


def _led_to(rig: MapRig, place: Place, attractors: Sequence[Sequence[str | float]]) -> tuple[int, int]:
    """Continue the motion of a rig until it is near a known attractor, impacts cease, or `_MOST_CYCLES` are over.

    `place` states frequency and amplitude of the drive. SimulationError is raised if the motion cannot be simulated.

    Returns:
        (index of the attractor in `attractors`, number of simulated cycles). The index is −1 if impacts cease or the
        motion comes near no attractor.
    """
    sizes = [size(place, np.array(one[3:10], float)) for one in attractors]
    near, cycles = math.inf, 0
    while cycles < _MOST_CYCLES:
        motion = rig.run_cycles(place.frequency_hz, place.amplitude, CHUNK)
        cycles += CHUNK
        state = rig.simulation.state()
        if not len(motion.impacts):
            break  # at rest, or drifting: the measurement decides
        if state is None or not attractors:
            continue
        away = [_distance(state, one, size) for one, size in zip(attractors, sizes, strict=True)]
        nearest = int(np.argmin(away))
        if away[nearest] < _NEAR and away[nearest] <= near:
            return nearest, cycles
        near = away[nearest] if away[nearest] < _NEAR else math.inf
    return -1, cycles


_RUNNERS: Mapping[str, Callable[..., list[Row]]] = {
    SECTION: _section,
    BIFURCATION: _bifurcation,
    BASIN: _basin,
    ORBIT: _orbit,
    CONTINUE: _continue,
    EXPONENT: _exponent,
}
