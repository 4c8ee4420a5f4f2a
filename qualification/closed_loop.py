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
"""Acceptance of the closed-loop controllers: `python -m qualification.closed_loop [hold] [lock] [backbone] [--draw]`.

- `hold`: on the linear rig, amplitudes within 0.5 % and DT within 2u of the closed form. With the sphere and the base
  held at 60 µm, DT within 1 % of that on a prescribed base (25 points). A response that does not repeat is averaged
  over 200 cycles or more.
- `lock`: −90° within 0.5° and 0.003 Hz, starting 1 Hz away, within 60 s; and a gap opened from 6 mm to 10 mm while
  locked.
- `backbone`: a gap of 10 mm up and down, from the wall and from the centre, compared with a campaign.

The exit code is 1 if a limit is exceeded. `--draw` draws docs/images/backbone.png.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import attrs
import numpy as np

from impact_rig.drawing import SERIES, legend_below, new_axes, style
from impact_rig.driver import LocalRig
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import NO_SPHERE
from impact_rig.simtime import NS_PER_S
from impact_rig_studies import prediction
from impact_rig_studies.campaign.job import Job, execute, start_local
from impact_rig_studies.campaign.pool import in_parallel
from impact_rig_studies.operate.operator import operate
from impact_rig_studies.operate.phase_lock import (
    AmplitudePoint,
    AmplitudeSweep,
    LockLoop,
    PhaseLock,
    follow,
    measure_backbone,
    run_phase_lock,
    with_short_blocks,
)
from impact_rig_studies.operate.plans import Hold, HoldPlan, LockPlan
from impact_rig_studies.operate.stepped_sine import ControlledSine, SweepState
from impact_rig_studies.prediction import Manifold
from qualification.prediction import job, tell

GAPS_MM, FREQUENCIES_HZ = (2, 4, 6, 8, 10), (8.8, 9.0, 9.1, 9.2, 9.4)
BASE_M = 60e-6
LONG, MANY = {"long_windows": 64, "wait_limit_s": 120.0}, 8
"""Settings of the measurement, and number of measurements, for a response that does not repeat."""
CURRENTS_A = tuple(round(float(one), 3) for one in np.geomspace(0.13, 0.7, 12))
SWEEP_GAP_M = 10e-3
PICTURE = Path(__file__).parents[1] / "docs" / "images" / "backbone.png"
Finding = tuple[str, bool]


def main() -> int:
    """Run the chosen parts; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=list(PARTS), help=f"of {', '.join(PARTS)}")
    parser.add_argument("--draw", action="store_true", help="draw docs/images/backbone.png")
    arguments = parser.parse_args()
    bad = 0
    for part in arguments.parts:
        for words, kept in PARTS[part](arguments.draw):
            tell(f"{'ok  ' if kept else 'BAD '} {words}")
            bad += not kept
    tell(f"{bad} limits exceeded")
    return 1 if bad else 0


def hold(one: Job, plan: HoldPlan) -> ControlledSine:
    """Measure a job's points in this process while a controller keeps an amplitude, and return the sweep."""
    sweep = ControlledSine(one.plan(), plan)
    operate(sweep, start_local(one))
    return sweep


def _held_pair(place: tuple[float, float]) -> tuple[float, float, float, float, float, str]:
    """Return error, DT held, its spread, DT prescribed, cycles and regime at (gap [m], frequency [Hz]).

    For a response that does not repeat, amplitude and DT are means of many measurements over thousands of cycles.
    """
    gap, frequency = place
    for repetitions in (1, MANY):
        one = attrs.evolve(job(frequency, gap), repetitions=repetitions, analysis=LONG)
        rows = hold(one, HoldPlan(hold=Hold.BASE, target=BASE_M, tolerance=3e-3)).controlled
        if np.all(rows["regime"] == b"periodic"):
            break
    other = attrs.evolve(one, changes={**one.changes, "drive.kind": "prescribed"}, current_a=BASE_M)
    prescribed = execute(other).rows
    return (
        abs(float(rows["base_amplitude"].mean()) / BASE_M - 1.0),
        float(rows["laser_amplitude"].mean() / rows["base_amplitude"].mean()),
        float(rows["spread"].mean()),
        float(prescribed["laser_amplitude"].mean() / prescribed["base_amplitude"].mean()),
        float(rows["cycles"].sum()),
        rows["regime"][0].decode(),
    )


def holding(_draw: bool) -> Iterator[Finding]:
    """Yield the findings about controlled sine, place by place as they are measured; they take the longest."""
    linear = attrs.evolve(
        job(9.0, 6e-3), changes={"sphere.present": False}, gap_m=NO_SPHERE, frequencies_hz=FREQUENCIES_HZ
    )
    for what, target in ((Hold.BASE, BASE_M), (Hold.SUPERIOR, 3e-3), (Hold.CURRENT, 0.3)):
        rows = hold(linear, HoldPlan(hold=what, target=target)).controlled
        worst = float(np.abs(rows["error"]).max())
        wanted = np.abs(transmissibility(RigConfig(), rows["frequency"]))
        in_u = float(np.max(np.abs(rows["transmissibility"] - wanted) / rows["transmissibility_uncertainty"]))
        kept = len(rows) == len(FREQUENCIES_HZ) and worst <= 0.005 and in_u <= 2.0
        yield f"linear rig, {what.value} held: worst error {100 * worst:.3f} %, DT within {in_u:.2f} u", kept
    places = [(gap * 1e-3, frequency) for gap in GAPS_MM for frequency in FREQUENCIES_HZ]
    for (gap, frequency), (error, dt, spread, wanted_dt, cycles, regime) in in_parallel(_held_pair, places):
        apart = dt / wanted_dt - 1.0
        kept = error <= 0.005 and abs(apart) <= 0.01 and (regime == "periodic" or cycles >= 200)
        words = (
            f"{gap * 1e3:3.0f} mm {frequency:4.1f} Hz base held ({100 * error:.2f} %): DT {dt:.3f} (spread "
            f"{spread:.3f}, {regime}, {cycles:.0f} cycles), prescribed {wanted_dt:.3f}: {100 * apart:+.2f} %"
        )
        yield words, kept


def locking(_draw: bool) -> list[Finding]:
    """Return the findings about the phase lock."""
    found = []
    config = from_flat(RigConfig(), {"sphere.present": False})
    true_hz = 9.105 / math.sqrt(1.0 - 4.0 * config.structure.damping_ratio**2)
    for start in (true_hz - 1.0, true_hz + 1.0):
        lock = run_phase_lock(
            LockPlan(start_hz=start, current_a=0.3, dwell_s=30.0), LockLoop(LocalRig(with_short_blocks(config)))
        )
        late = lock.rows[-20:]
        f, phase = float(np.mean(late["frequency"])), math.degrees(float(np.mean(late["phase"])))
        first = (lock.locked_ns or 0) / NS_PER_S
        kept = (
            lock.state is SweepState.FINISHED
            and abs(phase + 90.0) <= 0.5
            and abs(f - true_hz) <= 0.003
            and first <= 60.0
        )
        words = f"from {start:.2f} Hz: locked after {first:.1f} s, {f - true_hz:+.5f} Hz, phase {phase:.3f}°"
        found.append((words, kept))
    rig = LockLoop(LocalRig(with_short_blocks(from_flat(RigConfig(), {"barriers.gap_m": 6e-3}))))
    lock = PhaseLock(LockPlan(start_hz=8.8, current_a=0.52, dwell_s=1e6))
    rig.set(lock.start(0))
    follow(lock, rig, lambda _: rig.now_ns >= 30 * NS_PER_S)
    before = lock.locked
    rig.rig.configure({"barriers.gap_m": 10e-3})
    lock.unlock(rig.now_ns)
    changed = rig.now_ns
    follow(lock, rig, lambda _: rig.now_ns >= changed + 60 * NS_PER_S)
    rows = lock.rows[lock.rows["time"] > changed / NS_PER_S]
    seconds = rows["time"] - changed / NS_PER_S
    mean = np.convolve(np.degrees(rows["phase"]), [0.5, 0.5], "valid") + 90.0
    away = seconds[1:][np.abs(mean) > 2.0]
    last = float(away[-1]) if len(away) else 0.0
    kept = before and lock.state is SweepState.RUNNING and last < 20.0
    words = f"gap 6 to 10 mm while locked: held within 2° from {last:.1f} s on, {lock.frequency_hz:.4f} Hz"
    return [*found, (words, kept)]


def _backbone(start: str) -> list[AmplitudePoint]:
    config = from_flat(RigConfig(), {"barriers.gap_m": SWEEP_GAP_M, "sphere.start": start})
    sweep = AmplitudeSweep(currents_a=CURRENTS_A, lock=LockPlan(start_hz=9.0, current_a=CURRENTS_A[0]))
    return measure_backbone(sweep, LockLoop(LocalRig(with_short_blocks(config))))[0]


def _from_reset(place: tuple[str, float, float]) -> float:
    """Return DT of a campaign's point, at this start, frequency and current."""
    start, frequency, current = place
    one = job(frequency, SWEEP_GAP_M, current)
    rows = execute(attrs.evolve(one, changes={**one.changes, "sphere.start": start})).rows
    return float(rows["transmissibility"][0]) if len(rows) else math.nan


def backbones(draw: bool) -> list[Finding]:
    """Return the findings about the backbone."""
    points = dict(in_parallel(_backbone, ("left", "centre")))
    for start, found in points.items():
        for one in found:
            words = f"{'' if one.locked else 'not locked '}{'JUMP' if one.jumped else ''}"
            tell(
                f"     {start:6} {one.direction:4} {one.current_a:.3f} A  {one.frequency_hz:.4f} Hz  DT {one.dt:7.2f}  "
                f"g/X {SWEEP_GAP_M / one.superior_m:.2f}  {words}"
            )
    if draw:
        _draw(points)
    up = [one for one in points["centre"] if one.direction == "up"]
    jump = next(i for i, one in enumerate(up) if one.jumped)
    quiet = up[jump - 1]
    struck = next(one for one in points["left"] if one.direction == "down" and one.current_a == quiet.current_a)
    places = [("centre", quiet.frequency_hz, quiet.current_a), ("left", struck.frequency_hz, struck.current_a)]
    fresh = dict(in_parallel(_from_reset, places))
    both = [(quiet.dt, fresh[places[0]]), (struck.dt, fresh[places[1]])]
    kept = all(abs(a / b - 1.0) <= 0.02 for a, b in both) and quiet.dt > 1.5 * struck.dt
    words = (
        f"two answers at {quiet.current_a:.3f} A: DT {both[0][0]:.2f} and {both[1][0]:.2f}; a campaign from centre and "
        f"wall {both[0][1]:.2f} and {both[1][1]:.2f}"
    )
    findings = [(words, kept)]
    fold = Manifold(0.309).gap_per_amplitude_at_fold
    down = list(itertools.takewhile(lambda one: not one.jumped, (r for r in points["left"] if r.direction == "down")))
    ratio = SWEEP_GAP_M / down[-1].superior_m
    words = f"down: the last point on the branch has g/X = {ratio:.2f}, the fold is at {fold:.2f}"
    findings.append((words, 5.5 < ratio <= fold))
    line = prediction.backbone(RigConfig(), SWEEP_GAP_M)
    line = line.take(line.stable)
    on = [one for one in down if one.superior_m < float(line.superior_m.max())]
    worst = max(abs(one.dt / float(np.interp(one.superior_m, line.superior_m, line.dt)) - 1.0) for one in on)
    return [
        *findings, (f"down: {len(on)} points within {100 * worst:.2f} % of the predicted backbone", worst <= 0.01),
    ]  # fmt: skip


def _draw(points: dict[str, list[AmplitudePoint]]) -> None:
    line = prediction.backbone(RigConfig(), SWEEP_GAP_M)
    with style():
        figure, (upper, lower) = new_axes(5.0, (1.3, 1.0))
        x = line.superior_m * 1e3
        for mask, mark, label in ((line.stable, "-", "predicted"), (~line.stable, ":", "predicted, unstable")):
            for axis, y in ((upper, line.dt), (lower, line.frequency_hz)):
                axis.plot(x, np.where(mask, y, np.nan), mark, color="0.3", label=label if axis is upper else None)
        for number, (start, found) in enumerate(sorted(points.items())):
            for direction, marker in (("up", "^"), ("down", "v")):
                own = [one for one in found if one.direction == direction]
                x, appearance = [one.superior_m * 1e3 for one in own], {"color": SERIES[number], "fillstyle": "none"}
                upper.plot(
                    x, [one.dt for one in own], marker, label=f"{direction}, sphere from the {start}", **appearance
                )
                lower.plot(x, [one.frequency_hz for one in own], marker, **appearance)
        upper.set(ylabel="DT at −90°", ylim=(0, None), xlim=(1, 8), xscale="log")
        lower.set(xlabel="amplitude of the superior base (mm)", ylabel="frequency (Hz)")
        lower.set_xticks([1, 2, 3, 4, 5, 6, 8], ["1", "2", "3", "4", "5", "6", "8"])
        lower.minorticks_off()
        upper.set_title("Backbone, gap 10 mm", loc="left")
        legend_below(lower, 2, upper)
        figure.savefig(PICTURE, dpi=130, facecolor="white")


PARTS: dict[str, Callable[[bool], Iterable[Finding]]] = {"hold": holding, "lock": locking, "backbone": backbones}

if __name__ == "__main__":
    sys.exit(main())
