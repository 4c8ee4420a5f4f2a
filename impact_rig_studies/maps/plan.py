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
"""Plan of a map: read and validate its YAML file, divide it into lines of points, and measure a line.

The file has two or three axes; all other values are fixed. An invalid file is rejected before anything runs. A map that
would take too long is rejected with its estimated time.
"""

from __future__ import annotations

import functools
import itertools
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import attrs

from impact_rig.config.tree import Value
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, differences, from_flat
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError
from impact_rig_studies.campaign import axes
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ
from impact_rig_studies.campaign.plan import STARTS
from impact_rig_studies.campaign.tasks import HashedTask, Row, load_plan
from impact_rig_studies.maps.measure import FAILED, MapRig, Reading, Settings

FREQUENCY, CURRENT, GAP = "frequency_hz", "current_a", "gap_m"
POSITION, SPEED = "sphere_position_m", "sphere_speed_m_s"
"""Axes for the start of the sphere: its position from the middle between the walls, and its speed.

Both are positive to the right.
"""
NAMED = (FREQUENCY, CURRENT, GAP, POSITION, SPEED)
"""Axes with a name of their own; all others are configuration values by dotted name."""
FASTEST_M_S = 100.0  # limit of the initial speed of a sphere
RESET, UP, DOWN, BOTH = "reset", "up", "down", "both"
DIRECTIONS = (RESET, UP, DOWN, BOTH)
"""Values of `direction`: each point starts from rest, or from the motion at the next lower or next higher value.

`both` measures up and down. If the gap or a configuration value changes between the points, only the bases keep their
motion: the sphere returns to its start.
"""
OWNED = ("daq.", "instruments.", "time.", "step.", "pluck.", "output.", "drive.waveform")
"""Beginnings of the names of configuration values that a map rejects: the mechanics under a sine do not depend on them.
"""
# approximate computing time of a point on one core [s]: narrow gaps and chaos take twice as long, wide gaps a fifth
POINT_S = 0.004
LIMIT_S = 3600.0  # estimated time above which a map is rejected


@attrs.frozen(kw_only=True)
class MapLine(HashedTask):
    """Line of a map: its points along one axis, which are measured one after the other and stored together.

    A stored line is not measured again. The line contains every value that determines its results, so its hash
    identifies them.
    """

    changes: Mapping[str, Value]  # configuration values that differ from the default rig, by dotted name
    settings: Settings  # criteria by which a motion counts as settled and periodic
    held: Mapping[str, float]  # fixed values along the line, by name of axis
    along: str  # name of the axis along the line
    values: tuple[float, ...]  # its values, in the order of measurement
    direction: str
    """Start of each point: the motion at the previous point for `up` and `down`, rest for anything else.

    The latter is `reset`, or the start of the sphere (left, centre, right) if the plan lists several. If the gap or a
    configuration value varies along the line, `up` and `down` keep only the motion of the bases: the sphere returns to
    its start at each point.
    """
    frequency_hz: float  # frequency of the drive, unless it is an axis
    current_a: float  # amplitude of the drive (A, m or V by `drive.kind`), unless it is an axis

    def describe(self) -> str:
        """Return a text for progress messages: the fixed values of the line, and how its points start."""
        held = ", ".join(f"{name} {value:g}" for name, value in self.held.items())
        return f"{held}, {self.direction}"

    def read(self, rows: Sequence[Row]) -> list[Reading]:
        """Convert the rows that were stored for this line to readings, one for each value in `values`.

        Raises:
            ValueError: the number of rows is wrong, or a row is not a valid reading. `TaskStore.get` then counts the
                line as not measured.
        """
        if len(rows) != len(self.values):
            raise ValueError(f"it holds {len(rows)} readings of a line of the map that has {len(self.values)} points")
        return [_reading(row) for row in rows]

    def place(self, value: float) -> tuple[dict[str, Value], float, float, tuple[float, float] | None]:
        """Return settings and start of the point of the line at one value of its axis.

        Returns:
            Configuration values that axes set, by dotted name, in addition to `changes`. Then frequency [Hz] and
            amplitude (A, m or V by `drive.kind`) of the drive. Last, the sphere's initial position [m] and speed [m/s].
            If only one of these is an axis, the other is 0. If none is an axis, None replaces position and speed, and
            `sphere.start` applies.
        """
        at = {**self.held, self.along: value}
        frequency, current = at.pop(FREQUENCY, self.frequency_hz), at.pop(CURRENT, self.current_a)
        sphere = (at.pop(POSITION, 0.0), at.pop(SPEED, 0.0)) if {POSITION, SPEED} & set(at) else None
        changes: dict[str, Value] = {"barriers.gap_m" if name == GAP else name: one for name, one in at.items()}
        return changes, frequency, current, sphere


def _reading(row: Row) -> Reading:
    if len(row) != len(Reading._fields) or any(isinstance(value, str) for value in row[1:]):
        raise ValueError(f"a stored reading must be a regime and {len(Reading._fields) - 1} numbers, got {row}")
    regime, *numbers = row
    if not (regime == FAILED or float(numbers[0]) > 0.0):
        raise ValueError(f"DT, after the regime in a stored reading, must be > 0, got {row}")
    return Reading(str(regime), *map(float, numbers))


def measure_line(line: MapLine) -> list[Reading]:
    """Measure the points of a line by simulation, and return their readings in the order of `line.values`.

    `line.direction` determines how each point starts. A point whose motion cannot be simulated has the regime `failed`.
    """
    base = from_flat(RigConfig(), line.changes)
    rig: MapRig | None = None
    readings, config, before = [], base, None
    for value in line.values:
        changes, frequency, current, sphere = line.place(value)
        if changes != before:
            config, before = from_flat(base, changes), changes
        rig = rig or MapRig(config, line.settings)
        rig.change(config)
        if line.direction not in (UP, DOWN):
            rig.reset(sphere)
        readings.append(rig.measure(frequency, current))
    return readings


@attrs.frozen(kw_only=True)
class Search:
    """Search for the value of one parameter that reduces DT most: parameter and range (key `optimum` of the file)."""

    over: str  # name of the parameter
    low: float  # lower end of the range
    high: float  # upper end of the range
    points: int = 41  # number of points of the first, coarse pass over the range


@attrs.frozen(eq=False, kw_only=True)
class MapPlan:
    """Plan of a complete map: rig, axes, fixed values and order of measurement, as its YAML file defines them."""

    title: str
    base: RigConfig  # the rig, before an axis changes a value
    axes: Mapping[str, tuple[float, ...]]
    """Ascending values of two or three axes by name, in the order of the file.

    The first is the horizontal axis of a picture, the second the vertical one; each value of a third has a picture.
    """
    direction: str  # how each point starts, one of `DIRECTIONS`
    starts: tuple[str, ...]
    """Values of `sphere.start` of which each gives a map of its own, for `reset`; empty means that of `base`."""
    sweep: str  # axis along which points are measured one after the other
    frequency_hz: float  # frequency of the drive, unless it is an axis
    current_a: float  # amplitude of the drive (A, m or V by `drive.kind`), unless it is an axis
    settings: Settings  # criteria by which a motion counts as settled and periodic
    search: Search | None  # search for the best value of a parameter, or None
    text: str  # text of the YAML file

    @property
    def layers(self) -> tuple[str, ...]:
        """Names of the complete grids that are measured: directions (up, down or reset), or starts of the sphere."""
        return (UP, DOWN) if self.direction == BOTH else self.starts or (self.direction,)

    @property
    def points(self) -> int:
        """Number of points to measure: grid points times number of `layers`, without a search for the optimum."""
        return len(self.layers) * math.prod(map(len, self.axes.values()))

    @functools.cached_property
    def changes(self) -> dict[str, Value]:
        """Configuration values of `base` that differ from the default rig, by dotted name."""
        return differences(self.base)

    def line(
        self, along: str, values: tuple[float, ...], held: Mapping[str, float] | None = None, layer: str = RESET
    ) -> MapLine:
        """Return a line of the map, or of a search for the optimum.

        Args:
            along: name of the axis along the line, or of the parameter that is searched for.
            values: ascending values of this axis.
            held: values that replace those of the plan, by name of axis; None means none.
            layer: how the points start, one of `layers`. With `down` the points run from the last of `values` to the
                first, otherwise from the first to the last. With `reset` or a start of the sphere, each point starts
                from rest.
        """
        return MapLine(
            changes={**self.changes, "sphere.start": layer} if layer in STARTS else self.changes,
            settings=self.settings,
            held=held or {},
            along=along,
            values=values[::-1] if layer == DOWN else values,
            direction=layer,
            frequency_hz=self.frequency_hz,
            current_a=self.current_a,
        )

    def lines(self) -> list[MapLine]:
        """Return all lines of the map; each line runs along the axis `sweep`.

        The lines of one layer follow those of another. A layer is a direction, or a start of the sphere.
        """
        others = {name: values for name, values in self.axes.items() if name != self.sweep}
        return [
            self.line(self.sweep, self.axes[self.sweep], dict(zip(others, held, strict=True)), layer)
            for layer in self.layers
            for held in itertools.product(*others.values())
        ]


def allow_time(points: int, workers: int | None = None) -> None:
    """Reject a map whose estimated computing time is longer than the limit.

    Args:
        points: number of points.
        workers: number of cores that share the points; None means all that this process may use.

    Raises:
        BudgetError: the map would take too long. The message states how to raise the limit.
    """
    cores = workers or len(os.sched_getaffinity(0))
    seconds, limit = points * POINT_S / cores, LIMIT_S * budget.factor()
    if seconds > limit:
        shared = "one core" if cores == 1 else f"{cores} cores"
        raise BudgetError(
            f"{points} points would take about {seconds / 3600.0:.1f} h on {shared}, "
            f"more than {limit / 3600.0:g} h; to allow N times the default limit of {LIMIT_S / 3600.0:g} h, "
            f"set the environment variable {budget.VARIABLE}=N"
        )


def load_map(path: str | Path, workers: int | None = None, resolved: RigConfig | None = None) -> MapPlan:
    """Read the plan of a map from a YAML file, and check it, including its estimated computing time.

    Args:
        path: path of the file.
        workers: number of cores for that estimate; None means all that this process may use.
        resolved: rig that replaces the file's `config` and `set`, for the results of an existing map. Then the
            computing time is not checked.

    Raises:
        ConfigError: the file cannot be read or is invalid; the message names key, value, range and file.
        BudgetError: the map would take too long.
    """
    file = Path(path)

    def read(document: object, text: str) -> MapPlan:
        plan = _read(axes.mapping("a map", document), file, text, resolved)
        if resolved is None:
            allow_time(plan.points, workers)
        _check_corners(plan)
        return plan

    return load_plan(file, "map", read)


def _read(top: Mapping[str, object], path: Path, text: str, resolved: RigConfig | None) -> MapPlan:
    known = ("title", "config", "set", "axes", "direction", "starts", "sweep", FREQUENCY, CURRENT, "measure", "optimum")
    axes.check_keys("", top, known)
    given = _axes(axes.mapping("axes", top.get("axes")))
    sweep = axes.word("sweep", top.get("sweep", FREQUENCY if FREQUENCY in given else next(iter(given))), given)
    for name in (FREQUENCY, CURRENT):
        if name in top and name in given:
            raise ConfigError(f"{name} is an axis and cannot be fixed as well: remove the key {name}, or axes.{name}")
    direction = axes.word("direction", top.get("direction", RESET), DIRECTIONS)
    starts = axes.values("starts", top["starts"]) if "starts" in top else []
    for name in ("starts", POSITION, SPEED):
        if direction != RESET and (name in given or name in top):
            raise ConfigError(
                f"{name} sets how each point starts: direction must then be {RESET}, got {direction!r}; set it to "
                f"{RESET} or remove {name}"
            )
    if starts and {POSITION, SPEED} & set(given):
        raise ConfigError(
            f"starts and an axis {POSITION} or {SPEED} exclude each other, because both define where the sphere "
            "starts: remove one of them"
        )
    return MapPlan(
        title=str(top.get("title", path.stem)),
        base=resolved or axes.rig(top, path.parent, refuse_owned),
        axes=given,
        direction=direction,
        starts=tuple(axes.word("starts", start, STARTS) for start in starts),
        sweep=sweep,
        frequency_hz=axes.number(FREQUENCY, top.get(FREQUENCY, FREQUENCY_HZ), 0.0, 1e4),
        current_a=axes.number(CURRENT, top.get(CURRENT, CURRENT_A), 0.0),
        settings=axes.settings("measure", top.get("measure"), Settings),
        search=_search(top.get("optimum")),
        text=text,
    )


def _axes(given: Mapping[str, object]) -> dict[str, tuple[float, ...]]:
    if not 2 <= len(given) <= 3:
        raise axes.wrong("axes", "two or three named axes", list(given))
    found = {}
    for name, value in given.items():
        _check_axis(f"axes.{name}", name)
        found[name] = tuple(sorted(axes.numbers(f"axes.{name}", value, -math.inf)))
        if len(found[name]) < 2:
            raise axes.wrong(f"axes.{name}", "a list or range of two values or more", value)
    return found


def _search(given: object) -> Search | None:
    if given is None:
        return None
    wanted = axes.mapping("optimum", given)
    axes.check_keys("optimum", wanted, ("over", "from", "to", "points"))
    over = str(wanted.get("over", GAP))
    _check_axis("optimum.over", over)
    low = axes.number("optimum.from", wanted.get("from"), 0.0)
    return Search(
        over=over,
        low=low,
        high=axes.number("optimum.to", wanted.get("to"), low),
        points=axes.whole("optimum.points", wanted.get("points", 41), 5, 10_000),
    )


def _check_axis(key: str, name: str) -> None:
    if name not in NAMED and "." not in name:
        raise ConfigError(
            f"{key}: unknown axis {name!r}, known: {', '.join(NAMED)}, or a number of the configuration by its dotted "
            "name"
        )
    refuse_owned(key, name)


def refuse_owned(key: str, name: str) -> None:
    """Reject a configuration value that a map or dynamics study must not set in this way.

    Such a value has no effect, or must be set by another key.

    Args:
        key: key of the file that contains the name, for the message. A key in the section `set` or `axes` of the file
            begins with `set.` or `axes.`.
        name: dotted name of the value.

    Raises:
        ConfigError: the value is rejected. The message names the key, and the key to use instead if there is one.
    """
    if name == "sphere.start" and key.startswith("axes."):
        raise ConfigError(
            f"{key}: the start of the sphere cannot be an axis; use starts: [left, centre, right], or some of them"
        )
    if name == "barriers.gap_m" and not key.startswith("set."):
        raise ConfigError(f"{key}: use gap_m instead of barriers.gap_m")
    if name == "drive.frequency_hz":
        raise ConfigError(
            f"{key}: use {FREQUENCY} instead of {name}; a fixed frequency is a key at the top level of the file"
        )
    if name.startswith(OWNED):
        raise ConfigError(f"{key}: {name} has no effect on a map or dynamics study; remove it")


def _check_corners(plan: MapPlan) -> None:
    """Reject a map with invalid points at the ends of its first line, its last line, or its search for the optimum.

    Raises:
        ConfigError: a point is invalid; the message names the value and its range.
    """
    lines = plan.lines()
    ends = lines[:: max(1, len(lines) - 1)]
    if plan.search is not None:
        ends.append(plan.line(plan.search.over, (plan.search.low, plan.search.high)))
    for line in ends:
        for value in (line.values[0], line.values[-1]):
            changes, frequency, current, sphere = line.place(value)
            if not (frequency > 0.0 and current > 0.0):
                name, wrong = (CURRENT, current) if frequency > 0.0 else (FREQUENCY, frequency)
                raise axes.wrong(name, "> 0", wrong)
            config = from_flat(from_flat(RigConfig(), line.changes), changes)
            place, speed = sphere or (0.0, 0.0)
            half = 0.5 * config.barriers.gap_m
            if abs(place) > half:
                raise axes.wrong(POSITION, f">= {-half:g} and <= {half:g} m, half the gap", place)
            if abs(speed) > FASTEST_M_S:
                raise axes.wrong(SPEED, f">= {-FASTEST_M_S:g} and <= {FASTEST_M_S:g} m/s", speed)
