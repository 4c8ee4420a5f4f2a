# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Does the stated uncertainty of a reduction cover the truth? `python tools/coverage_of_reductions.py --seeds 500`.

A session as in a laboratory: the rig runs at 9.1 Hz without the sphere, then with a gap of 8 mm, then of 2 mm, and goes
on all the while. Its motion is simulated once. Every seed then draws the calibration errors and the noise of all
instruments anew, and its chain of instruments reads that motion, as a rig of that seed would: instruments never act
back on the mechanics. The tracker measures; `analysis.reduction` gives the reductions and their uncertainties, from one
row per gap and from two. Truth is the reduction of the undisturbed motion: its own displacements, without instruments,
fitted over the very scans that the rows were measured from.

Exit code 1 if with 500 seeds or more less than 93 % or more than 98 % lie within ±2u. (A rig that is reset between its
runs repeats its noise sequence, part of which then cancels: for those the stated uncertainty is an upper bound.)
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from functools import cache

import attrs
import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table as TextTable

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.reduction import reduction
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, Table
from impact_rig.campaign.axes import NO_SPHERE
from impact_rig.campaign.paper import CURRENT_A, FREQUENCY_HZ
from impact_rig.instruments.chain import Chain
from impact_rig.physics import FunctionGenerator, Motion, Simulation
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S

CASES_M = (NO_SPHERE, 0.008, 0.002)
RATES_HZ = (10_000, 50_000)
REPETITIONS = (1, 2)
CASE_S = 18.0
"""Rig time at each case: enough for two settled measurements of all of them."""
TICKS_PER_S = 100
CASE_TICKS = round(CASE_S * TICKS_PER_S)
LEAST, MOST = 0.93, 0.98
SEEDS_TO_JUDGE = 500
HARMONICS = 5


@attrs.frozen
class Deviation:
    """A measured reduction against its truth, in points."""

    error: float
    u: float

    @property
    def inside(self) -> bool:
        """Whether ±2u covers the truth."""
        return abs(self.error) <= 2.0 * self.u


def rig(gap_m: float, rate_hz: int, seed: int) -> RigConfig:
    """Return the default rig with this gap, or without the sphere."""
    gap = {"sphere.present": False} if gap_m == NO_SPHERE else {"barriers.gap_m": gap_m}
    return from_flat(RigConfig(), {**gap, "daq.rate_hz": rate_hz, "daq.seed": seed})


@cache
def session() -> tuple[Motion, ...]:
    """Return the motion of each case, one after the other; nothing in it depends on instruments, rate or seed."""
    cases = [rig(gap_m, RATES_HZ[0], 1) for gap_m in CASES_M]
    drive = FunctionGenerator(cases[0].drive, cases[0].shaker, np.random.default_rng(1))
    drive.set_frequency(FREQUENCY_HZ)
    drive.set_amplitude(CURRENT_A)
    simulation, motions = Simulation(cases[0]), []
    for config in cases:
        if motions:
            simulation.configure(config)
        motions.append(simulation.advance(drive.segments(CASE_TICKS)))
    return tuple(motions)


def measured(rate_hz: int, seed: int) -> tuple[dict[float, list[Table]], Calibration]:
    """Return the settled rows of a session by gap, and the certificate of the instruments that measured it."""
    chain, tracker = Chain(rig(NO_SPHERE, rate_hz, seed)), Tracker()
    info = chain.info()
    tracker.configure(Table(0, info))
    command = np.zeros(1, APPLIED)
    command["frequency"], command["current"] = FREQUENCY_HZ, CURRENT_A
    tracker.on_applied(Table(0, command))
    for case, (gap_m, motion) in enumerate(zip(CASES_M, session(), strict=True)):
        chain.acquire(motion, case * CASE_TICKS, CASE_TICKS)
        tracker.label(gap_m, round(case * CASE_S * NS_PER_S))
    found: dict[float, list[Table]] = {gap_m: [] for gap_m in CASES_M}
    for table in tracker.feed(Table(0, chain.read(chain.ready))).measurements:
        if table.rows["settled"][0] == 1.0:
            found[float(table.rows["gap"][0])].append(table)
    return found, Calibration.from_info(info)


@cache
def true_transmissibility(rate_hz: int, stamp_ns: int, cycles: int) -> float:
    """Return |X_1| / |X_b| of the motion itself over the scans of a measurement that ends at this stamp."""
    last = round(stamp_ns * rate_hz / NS_PER_S)
    scans = np.arange(last + 1 - round(cycles * rate_hz / FREQUENCY_HZ), last + 1)
    per_tick = rate_hz // TICKS_PER_S
    motion = session()[scans[0] // (CASE_TICKS * per_tick)]
    x_1, x_b = motion.quantities(("x_1", "x_b"), scans // per_tick, scans % per_tick / rate_hz)
    return abs(_amplitude(x_1, scans / rate_hz) / _amplitude(x_b, scans / rate_hz))


def _amplitude(values: NDArray[np.float64], time_s: NDArray[np.float64]) -> complex:
    """Return the phasor at the drive frequency: least squares with offset and harmonics."""
    angle = 2.0 * np.pi * FREQUENCY_HZ * np.outer(np.arange(1, HARMONICS + 1), time_s)
    basis = np.concatenate([np.ones((1, len(time_s))), np.cos(angle), np.sin(angle)])
    found = np.linalg.solve(basis @ basis.T, basis @ values)
    return complex(found[1], -found[1 + HARMONICS])


def deviations(rate_hz: int, seed: int) -> Iterator[tuple[float, int, Deviation]]:
    """Yield gap [m], rows per case and what a session gives: its reduction against the truth."""
    found, calibration = measured(rate_hz, seed)
    without = found.pop(NO_SPHERE)
    for gap_m, tables in found.items():
        for count in REPETITIONS:
            dt_0, dt = (
                np.mean([true_transmissibility(rate_hz, t.stamp_ns, int(t.rows["cycles"][0])) for t in taken[:count]])
                for taken in (without, tables)
            )
            got = reduction(
                *(np.concatenate([t.rows for t in taken[:count]]) for taken in (without, tables)), calibration
            )
            yield gap_m, count, Deviation(got.percent - 100.0 * float(1.0 - dt / dt_0), got.u_points)


def share_inside(found: list[Deviation]) -> float:
    """Return the share of the truths within ±2u."""
    return float(np.mean([one.inside for one in found]))


def main() -> int:
    """Print a row per case and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS_TO_JUDGE, metavar="N", help="default: %(default)s")
    seeds = range(1, parser.parse_args().seeds + 1)
    console = Console()
    table = TextTable(title=f"Reductions against the truth, {len(seeds)} sets of instruments")
    for heading in ("rate [kS/s]", "gap [mm]", "rows", "u [points]", "rms error", "mean error", "within ± 2u"):
        table.add_column(heading, justify="right")
    failed = False
    for rate_hz in RATES_HZ:
        cases: dict[tuple[float, int], list[Deviation]] = {}
        for seed in track(seeds, f"{rate_hz / 1e3:g} kS/s", console=console):
            for gap_m, count, one in deviations(rate_hz, seed):
                cases.setdefault((gap_m, count), []).append(one)
        for (gap_m, count), found in sorted(cases.items()):
            errors, share = np.array([one.error for one in found]), share_inside(found)
            failed |= len(seeds) >= SEEDS_TO_JUDGE and not LEAST <= share <= MOST
            table.add_row(
                f"{rate_hz / 1e3:g}", f"{gap_m * 1e3:g}", f"{count}", f"{np.mean([one.u for one in found]):.4f}",
                f"{np.sqrt(np.mean(errors**2)):.4f}", f"{errors.mean():+.4f}", f"{100.0 * share:.1f} %",
            )  # fmt: skip
    console.print(table)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
