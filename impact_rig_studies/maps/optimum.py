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
"""Search for the value of one parameter, such as the gap, at which the sphere reduces the transmissibility DT most.

The result includes the range of values that are nearly as good, and sensitivities to other constants of the rig. DT
jumps where the kind of motion changes. Therefore the search uses no slopes: it scans the whole range, and refines the
scan around the best point.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import attrs
import numpy as np

from impact_rig.errors import ConfigError
from impact_rig.rig.config import to_flat
from impact_rig_studies.maps.measure import Reading
from impact_rig_studies.maps.plan import CURRENT, FREQUENCY, GAP, MapPlan, Search, measure_line

# distance from the best reduction of DT [percentage points] up to which values of the parameter belong to its region
REGION_POINTS = 1.0
_ROUNDS, _POINTS, _HALVINGS = 4, 9, 10  # refinements, points of each, and bisections of each end of the region
_SHARE = 0.005  # relative change of a value, either way, for its sensitivity
SENSITIVE = (  # configuration values whose influence on the reduction is computed
    "barriers.gap_m",
    "sphere.density_kg_m3",
    "contact.restitution",
    "structure.damping_ratio",
    "structure.mass_kg",
)


@attrs.frozen(kw_only=True)
class Optimum:
    """Value of one parameter at which the sphere reduces DT most, with the motion and the sensitivities there."""

    over: str  # name of the parameter
    value: float  # its best value [SI]
    reading: Reading  # motion of the mechanics there
    region: tuple[float, float]  # ends of the range of values around it within 1 percentage point of the best reduction
    points_per_percent: dict[str, float]
    """Change of the reduction of DT [percentage points] if a value of the rig is 1 % larger, by name of the value.

    The values are those of `SENSITIVE`, frequency and current of the drive, and the parameter itself.
    """

    def plain(self) -> dict[str, object]:
        """Return the optimum as a dictionary for `map.json`.

        It has all attributes, but instead of `reading` its values dt, regime, reduction_percent and impacts_per_cycle.
        """
        return {
            "over": self.over, "value": self.value, "reduction_percent": self.reading.reduction_percent,
            "dt": self.reading.dt, "regime": self.reading.regime, "impacts_per_cycle": self.reading.impacts_per_cycle,
            "region": list(self.region), "points_per_percent": self.points_per_percent,
        }  # fmt: skip


def find(plan: MapPlan, search: Search) -> Optimum:
    """Find the value of a parameter at which DT is reduced most, by simulating points of its range.

    A failed point counts as worse than all other points. If all points fail, the result is the lowest value, with NaN
    as its reduction.

    Args:
        plan: plan of a map, of which only rig, frequency, current and settings are used. Each point is measured from a
            reset rig.
        search: name of the parameter, its range, and the number of points of the first, coarse pass over the range.
    """
    known: dict[float, Reading] = {}

    def measure(values: Sequence[float]) -> None:
        new = tuple(value for value in values if value not in known)
        known.update(zip(new, _measured(plan, search.over, new), strict=True))

    def reduction(value: float) -> float:
        measure((value,))
        return known[value].reduction_percent

    measure(np.linspace(search.low, search.high, search.points).tolist())
    for _ in range(_ROUNDS):
        places = sorted(known)
        i = places.index(_best(known))
        measure(np.linspace(places[max(i - 1, 0)], places[min(i + 1, len(places) - 1)], _POINTS).tolist())
    best = _best(known)
    enough = known[best].reduction_percent - REGION_POINTS
    places = sorted(known)
    at = places.index(best)
    edges = []
    for side in (places[at::-1], places[at:]):
        inside = best
        for value in side:
            if not known[value].reduction_percent >= enough:
                outside = value
                for _ in range(_HALVINGS):
                    middle = 0.5 * (inside + outside)
                    inside, outside = (middle, outside) if reduction(middle) >= enough else (inside, middle)
                break
            inside = value
        edges.append(inside)
    return Optimum(
        over=search.over,
        value=best,
        reading=known[best],
        region=(edges[0], edges[1]),
        points_per_percent=_sensitivity(plan, search.over, best),
    )


def _best(known: dict[float, Reading]) -> float:
    return max(sorted(known), key=lambda value: np.nan_to_num(known[value].reduction_percent, nan=-np.inf))


def _measured(plan: MapPlan, over: str, values: tuple[float, ...], **changed: float) -> list[Reading]:
    """Measure points at some values of `over`, each from a reset rig, and return the readings in the same order.

    Args:
        plan: plan of the map, with all other values.
        over: name of the varied parameter.
        values: values of this parameter.
        **changed: values that replace those of the plan, by name. A value for `over` is ignored.
    """
    return measure_line(plan.line(over, values, {name: one for name, one in changed.items() if name != over}))


def _sensitivity(plan: MapPlan, over: str, best: float) -> dict[str, float]:
    values = to_flat(plan.base)
    nominal = {GAP if name == "barriers.gap_m" else name: float(values[name]) for name in SENSITIVE}  # type: ignore[arg-type]  # numbers
    nominal |= {FREQUENCY: plan.frequency_hz, CURRENT: plan.current_a, over: best}
    found = {}
    for name, value in nominal.items():
        reductions = []
        for factor in (1.0 - _SHARE, 1.0 + _SHARE):
            try:
                one = (
                    _measured(plan, over, (factor * best,))[0]
                    if name == over
                    else _measured(plan, over, (best,), **{name: factor * value})[0]
                )
            except ConfigError:  # beyond the range of the value: only the difference to the other side
                continue
            reductions.append((factor, one.reduction_percent))
        if len(reductions) < 2:
            reductions.append((1.0, _measured(plan, over, (best,))[0].reduction_percent))
        (_, low), (_, high) = sorted(reductions)
        sides = sum(factor != 1.0 for factor, _ in reductions)
        found[name] = (high - low) / (100.0 * sides * _SHARE)
    return found


def from_map(reductions: Sequence[float], values: Sequence[float]) -> tuple[float, tuple[float, float]]:
    """Return the best value of a parameter on the grid of a finished map, and the range of values nearly as good.

    Args:
        reductions: reduction of DT in percent at each value; NaN if that point is not measured or has failed.
        values: values of the parameter, in the same order.

    Returns:
        The value with the largest reduction, and the ends of the contiguous range of values around it. In this range,
        the reduction is at most `REGION_POINTS` (percentage points) below the largest reduction.

    Raises:
        ValueError: all reductions are NaN.
    """
    order = np.argsort(values)
    x, y = np.asarray(values, float)[order], np.asarray(reductions, float)[order]
    i = int(np.nanargmax(y))
    good = y >= y[i] - REGION_POINTS
    low = i - sum(1 for _ in itertools.takewhile(bool, good[:i][::-1]))
    high = i + sum(1 for _ in itertools.takewhile(bool, good[i + 1 :]))
    return float(x[i]), (float(x[low]), float(x[high]))
