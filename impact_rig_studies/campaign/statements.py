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
"""The paper's qualitative statements, each judged on a campaign's points, with the strength of each verdict.

If a statement cannot be judged, its verdict names the missing points. The paper does not print six constants of the
rig. They were chosen so that the five reductions and these statements result. `Worth` therefore states how strong the
evidence is. `variations` judges the statements with other values of these constants.
"""

from __future__ import annotations

import enum
import itertools
from collections.abc import Callable, Mapping, Sequence

import attrs

from impact_rig.config.tree import Value
from impact_rig.rig.gaps import NO_SPHERE, case_of
from impact_rig_studies.campaign.paper import FREQUENCIES_HZ, FREQUENCY_HZ, REDUCTION_PERCENT
from impact_rig_studies.campaign.plan import RESET
from impact_rig_studies.campaign.results import Curves, Point, Statement

ABOVE_HZ = (9.2, 9.5)
FAR_HZ = (7.5, 8.0, 10.0, 10.5)
FAR_LIMIT_PERCENT = 6.0  # our interpretation of `tend to coincide`
SHIFT_LIMIT_PERCENT = 1.0
"""Largest shift of the peak, in percent, that counts as the paper's "virtually unchanged".

(Its 0.44 % are the difference between its simulation and its experiment.)
"""
# grid on which a peak is located; slightly more than 0.01 Hz because of the rounding of frequencies
PEAK_STEP_HZ = 0.0101
GAPS_M = tuple(REDUCTION_PERCENT)


class Worth(enum.StrEnum):
    """Strength of the evidence for a statement, given that constants of the rig were chosen to match the paper."""

    FIT = "fit"  # it holds for the chosen constants, but not for some varied ones
    FOLLOWS = "follows from the fit"  # it repeats a quantity that was fitted: natural frequency, or five reductions
    PREDICTION = "prediction"  # it holds for all tried variations of the chosen constants


class MissingError(LookupError):
    """Error that a settled point which a statement needs is missing; the message only names the point."""


@attrs.frozen
class Verdict:
    """Verdict on one of the paper's statements, with the numbers from which it follows."""

    name: str  # key in `summary.json`
    text: str
    kind: Worth  # how strong the evidence is
    result: Statement | None  # the judgement; None if points that it needs are missing
    detail: str  # text for the user: the numbers from which it follows, or the missing points
    unit: str  # unit of value and limit of the judgement

    @property
    def margin(self) -> float | None:
        """Absolute distance of the judged value from its limit, in `unit`; None if the statement was not judged."""
        return None if self.result is None else abs(self.result.limit - self.result.value)

    @property
    def word(self) -> str:
        """Verdict for display: `pass`, `FAIL` or `not judged`."""
        return "not judged" if self.result is None else "pass" if self.result.passed else "FAIL"


Judgement = tuple[Statement, str]
"""Result of judging a statement, and the text of `Verdict.detail`."""


def judge(curves: Curves) -> list[Verdict]:
    """Judge each of the paper's seven statements on the settled points of the reference rig.

    The result of a statement is None if a point that it needs is missing or not settled.
    """
    verdicts = []
    for name, kind, unit, text, judge_one in _STATEMENTS:
        result: Statement | None = None
        try:
            result, detail = judge_one(curves)
        except MissingError as error:
            detail = f"needs {error}"
        verdicts.append(Verdict(name, text, kind, result, detail, unit))
    return verdicts


def _need(curves: Curves, gap_m: float, frequency_hz: float) -> Point:
    point = curves.at(gap_m, frequency_hz)
    if point is None:
        raise MissingError(f"a settled point at {frequency_hz:g} Hz, {case_of(gap_m)}")
    return point


def _reduction(curves: Curves, gap_m: float) -> float:
    """Return the reduction of DT by the sphere at 9.1 Hz with this gap [%], relative to DT without the sphere.

    Raises:
        MissingError: one of the two points is missing or not settled.
    """
    without = _need(curves, NO_SPHERE, FREQUENCY_HZ).dt
    return 100.0 * (1.0 - _need(curves, gap_m, FREQUENCY_HZ).dt / without)


def _peak_without_sphere(curves: Curves) -> Judgement:
    points = [_need(curves, NO_SPHERE, frequency) for frequency in FREQUENCIES_HZ]
    highest = max(points, key=lambda point: point.dt)
    passed = highest.frequency_hz == FREQUENCY_HZ
    return Statement(passed, highest.frequency_hz, FREQUENCY_HZ), f"DT {highest.dt:.1f} at {highest.frequency_hz:g} Hz"


def _amplitudes_at_peak(curves: Curves) -> Judgement:
    points = {frequency: _need(curves, NO_SPHERE, frequency) for frequency in FREQUENCIES_HZ}
    here = points.pop(FREQUENCY_HZ)
    base = here.base_m / min(point.base_m for point in points.values())
    superior = max(point.laser_m for point in points.values()) / here.laser_m
    worst = max(base, superior)
    detail = (
        f"base {here.base_m * 1e6:.1f} µm = {base:.2f} × the smallest elsewhere; "
        f"superior base {here.laser_m * 1e3:.2f} mm, elsewhere at most {superior:.2f} × that"
    )
    return Statement(worst < 1.0, worst, 1.0), detail


def _grows_with_gap(curves: Curves) -> Judgement:
    reductions = [_reduction(curves, gap) for gap in GAPS_M]
    least = min(b - a for a, b in itertools.pairwise(reductions))
    return Statement(least > 0.0, least, 0.0), " < ".join(f"{value:z.1f}" for value in reductions) + " %"


def _lower_above_resonance(curves: Curves) -> Judgement:
    ratios = {
        (gap, frequency): _need(curves, gap, frequency).dt / _need(curves, NO_SPHERE, frequency).dt
        for gap in GAPS_M
        for frequency in ABOVE_HZ
    }
    (gap, frequency), worst = max(ratios.items(), key=lambda item: item[1])
    detail = f"at most {worst:.3f} of DT without sphere (gap {gap * 1e3:g} mm, {frequency:g} Hz)"
    return Statement(worst < 1.0, worst, 1.0), detail


def _agree_far_away(curves: Curves) -> Judgement:
    deviations = {
        (gap, frequency): 100.0 * (_need(curves, gap, frequency).dt / _need(curves, NO_SPHERE, frequency).dt - 1.0)
        for gap in GAPS_M
        for frequency in FAR_HZ
    }
    (gap, frequency), worst = max(deviations.items(), key=lambda item: abs(item[1]))
    detail = f"largest difference {worst:+z.1f} % (gap {gap * 1e3:g} mm, {frequency:g} Hz)"
    return Statement(abs(worst) <= FAR_LIMIT_PERCENT, abs(worst), FAR_LIMIT_PERCENT), detail


def _falls_beyond_optimum(curves: Curves) -> Judgement:
    points = [point for gap in curves.gaps() if (point := curves.at(gap, FREQUENCY_HZ)) is not None]
    gaps = [point.gap_m for point in points if point.impacts]
    if not gaps or max(gaps) <= max(GAPS_M):
        raise MissingError(
            f"settled points with impacts at {FREQUENCY_HZ:g} Hz, gaps wider than {max(GAPS_M) * 1e3:g} mm"
        )
    reductions = {gap: _reduction(curves, gap) for gap in gaps}
    best = max(gaps, key=lambda gap: reductions[gap])
    beyond = {gap: reductions[gap] for gap in gaps if gap > best}
    passed = best > max(GAPS_M) and bool(beyond)
    detail = f"maximum {reductions[best]:z.1f} % at {best * 1e3:g} mm"
    if beyond:
        detail += f"; {', '.join(f'{value:z.1f} % at {gap * 1e3:g} mm' for gap, value in list(beyond.items())[:4])}"
    return Statement(passed, best * 1e3, max(gaps) * 1e3), detail


def _frequency_unchanged(curves: Curves) -> Judgement:
    without = peak_hz(curves, NO_SPHERE)
    shifts = {gap: 100.0 * (1.0 - peak_hz(curves, gap) / without) for gap in GAPS_M}
    largest = max(abs(shift) for shift in shifts.values())
    detail = f"peak at {without:.3f} Hz without sphere; lower by " + ", ".join(
        f"{shift:z.2f}" for shift in shifts.values()
    )
    found = Statement(largest < SHIFT_LIMIT_PERCENT, largest, SHIFT_LIMIT_PERCENT)
    return found, f"{detail} % with gaps of {', '.join(f'{gap * 1e3:g}' for gap in shifts)} mm"


def peak_hz(curves: Curves, gap_m: float) -> float:
    """Return the frequency of the peak of DT at one gap, in Hz, which may lie between the measured points.

    It is the vertex of the parabola through the highest settled point and both its neighbours.

    Raises:
        MissingError: there is no settled point, the highest one lacks a neighbour on one side, or its neighbours are
            more than 2 `PEAK_STEP_HZ` apart from each other.
    """
    curve = sorted(curves.by_gap.get(gap_m, {}).items())
    top = max(range(len(curve)), key=lambda i: curve[i][1].dt, default=0)
    near = curve[max(top - 1, 0) : top + 2]
    if len(near) < 3 or near[2][0] - near[0][0] > 2.0 * PEAK_STEP_HZ:
        raise MissingError(
            f"three settled points at most 0.01 Hz apart, the middle one with the highest DT, {case_of(gap_m)}"
        )
    (left, a), (middle, b), (right, c) = ((frequency, point.dt) for frequency, point in near)
    rise, fall = (b - a) / (middle - left), (c - b) / (right - middle)
    return (left + middle) / 2.0 + rise * (right - left) / (2.0 * (rise - fall))


_STATEMENTS: tuple[tuple[str, Worth, str, str, Callable[[Curves], Judgement]], ...] = (
    ("dt_peaks_at_9_1_hz", Worth.FOLLOWS, "Hz", "Without sphere DT peaks at 9.1 Hz.", _peak_without_sphere),
    (
        "amplitudes_at_resonance",
        Worth.FIT,
        "-",
        f"At {FREQUENCY_HZ:g} Hz the base's amplitude is smallest and the superior base's largest.",
        _amplitudes_at_peak,
    ),
    (
        "reduction_grows_with_gap",
        Worth.FOLLOWS,
        "points",
        "The reduction at 9.1 Hz grows with the gap from 2 to 10 mm.",
        _grows_with_gap,
    ),
    (
        "lower_above_resonance",
        Worth.PREDICTION,
        "-",
        "At 9.2 and 9.5 Hz DT is below the curve without sphere for every gap.",
        _lower_above_resonance,
    ),
    (
        "curves_agree_far_from_resonance",
        Worth.FIT,
        "%",
        f"At {', '.join(f'{f:g}' for f in FAR_HZ)} Hz curves tend to coincide (here: within {FAR_LIMIT_PERCENT:g} %).",
        _agree_far_away,
    ),
    (
        "reduction_falls_beyond_optimal_gap",
        Worth.PREDICTION,
        "mm",
        "Beyond an optimal gap, among orbits that impact, the reduction falls again.",
        _falls_beyond_optimum,
    ),
    (
        "natural_frequency_unchanged",
        Worth.FIT,
        "%",
        f"The natural frequency is virtually unchanged (here: the peak moves by less than {SHIFT_LIMIT_PERCENT:g} %).",
        _frequency_unchanged,
    ),
)


@attrs.frozen(eq=False)
class Variation:
    """Verdicts on the paper's statements for one rig of a campaign, the reference rig or one with other constants."""

    changed: Mapping[str, Value]
    """Values of its study's axes other than frequency, gap and current, by dotted name; empty for the reference rig."""
    verdicts: list[Verdict]


def variations(points: Sequence[Point]) -> list[Variation]:
    """Judge the statements for every rig among a campaign's points, the reference rig first.

    Only points after a reset of the rig are used, at a current at which the reference rig was measured, too. A rig that
    differs from the reference rig without an axis that names the difference is left out. So are rigs for which no
    statement can be judged. If fewer than two rigs are left, the list is empty.
    """
    currents = {point.current_a for point in points if point.reference}
    rigs: dict[tuple[tuple[str, Value], ...], list[Point]] = {}
    for point in points:
        is_named = point.reference or point.axes
        if is_named and point.direction == RESET and point.current_a in currents:
            changed = () if point.reference else tuple(sorted(point.axes.items()))
            rigs.setdefault(changed, []).append(attrs.evolve(point, reference=True))
    found = [Variation(dict(rig), judge(Curves.of(rigs[rig]))) for rig in sorted(rigs, key=len)]
    judged = [one for one in found if any(verdict.result for verdict in one.verdicts)]
    return judged if len(judged) > 1 else []
