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
"""Coverage of the truth by the stated uncertainties: `python -m qualification.coverage_of_uncertainties [TABLE]`.

A motion is simulated once. Every seed then draws new calibration errors and noise of all instruments, and its chain of
instruments reads that motion, as in a rig with that seed: instruments never act back on the mechanics. The tracker
measures. There are three tables:

    small        prescribed base, no sphere: 2 to 50 µm, 12 to 16 bits, noise of the laser on and off, 6 to 100 Hz;
                 truth: displacements of the motion, without instruments, fitted over the scans of the row
    irregular    gaps at which the motion never repeats; truth: the mean over ten hours; every seed reads another
                 stretch of it
    reductions   a session: the rig runs at 9.1 Hz without the sphere, then with each gap in turn, without a pause;
                 the reductions of `impact_rig_studies.reduction`, from one row per gap and from two

A cell passes if 93 to 98 % of the rows are within ±2u, allowing for chance at that number of seeds. More rows may be
within if the steps of a converter or sensor are the larger part of u and no noise averages them: such an error is
bounded by 2u, not scattered ("bounded"). Rows without a number are counted by status and cover nothing. The exit code
is 1 if a cell fails.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from itertools import repeat

import attrs
import numpy as np
from rich.console import Console
from rich.progress import Progress
from rich.table import Table as TextTable
from scipy.stats import binom

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, Table
from impact_rig.instruments.chain import Chain
from impact_rig.physics import FunctionGenerator, Motion, Simulation
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.gaps import NO_SPHERE, gap_values
from impact_rig.simtime import NS_PER_S, TICKS_PER_S
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ
from impact_rig_studies.reduction import reduction

RATE_HZ = 10_000
PER_TICK = RATE_HZ // TICKS_PER_S
LEAST, MOST = 0.93, 0.98
CHANCE = 0.01
"""A cell fails if, with a true share at the limit, its result would occur less often than this."""
HARMONICS = 5
BATCH = 25
"""Seeds per task of a worker: the motion is simulated once for all of them."""


@attrs.frozen
class Case:
    """One motion, and the instruments that read it."""

    table: str  # name of the table
    changes: tuple[tuple[str, object], ...]  # differences from the default configuration
    frequency_hz: float  # drive frequency
    amplitude: float  # drive amplitude [A or m]
    gaps_m: tuple[float, ...]  # gaps set in sequence, `span_s` each; 0 = no sphere
    wait_s: float  # duration of the motion before anything is read
    span_s: float  # duration read at each gap
    label: tuple[str, ...]  # name of the cell

    def config(self, gap_m: float, seed: int = 1) -> RigConfig:
        """Return the rig with this gap, or without the sphere."""
        return from_flat(
            RigConfig(), {**dict(self.changes), **gap_values(gap_m), "daq.rate_hz": RATE_HZ, "daq.seed": seed}
        )


@attrs.frozen
class Deviation:
    """A measured value and its truth; `bounded` if steps without noise are the larger part of its variance."""

    error: float
    u: float
    bounded: bool = False

    @property
    def inside(self) -> bool:
        """Return whether ±2u covers the truth."""
        return abs(self.error) <= 2.0 * self.u


SETTLE_TIMES = 14
"""Time constants of the structure that pass before a prescribed motion is read: 1e-6 of the start remains."""


def small_cases(frequencies_hz=(6.0, 9.1, 20.0, 50.0, 100.0)) -> Iterator[Case]:
    """Yield the small signals."""
    for frequency_hz in frequencies_hz:
        for base_um in (2.0, 5.0, 10.0, 50.0):
            for bits in (12, 14, 16):
                for noisy in (True, False):
                    changes = {"drive.kind": "prescribed", "instruments.adc.bits": bits}
                    if not noisy:
                        changes["instruments.laser.noise_m_rms"] = 0.0
                    label = f"{frequency_hz:g}", f"{base_um:g}", f"{bits}", "on" if noisy else "off"
                    span_s = 16.0 if frequency_hz < 8.0 else 11.0
                    yield Case(
                        "small", tuple(changes.items()), frequency_hz, base_um * 1e-6, (NO_SPHERE,), SETTLE_TIMES * 3.9,
                        span_s, label,
                    )  # fmt: skip


def irregular_cases() -> Iterator[Case]:
    """Yield the motions that never repeat."""
    for gap_m, frequency_hz in ((0.032, 9.1), (0.030, 8.82)):
        label = f"{gap_m * 1e3:g}", f"{frequency_hz:g}"
        yield Case("irregular", (), frequency_hz, CURRENT_A, (gap_m,), 30.0, 66.0, label)


def reduction_cases() -> Iterator[Case]:
    """Yield the sessions."""
    for bits in (12, 14, 16):
        gaps_m = (NO_SPHERE, 0.008, 0.006, 0.004, 0.002)
        yield Case(
            "reductions", (("instruments.adc.bits", bits),), FREQUENCY_HZ, CURRENT_A, gaps_m, 0.0, 20.0, (f"{bits}",)
        )


def driven(case: Case) -> tuple[Simulation, FunctionGenerator]:
    """Return the mechanics and their drive, `wait_s` after a start from rest."""
    config = case.config(case.gaps_m[0])
    drive = FunctionGenerator(config.drive, config.shaker, np.random.default_rng(1))
    drive.set_frequency(case.frequency_hz)
    drive.set_amplitude(case.amplitude)
    simulation = Simulation(config)
    if case.wait_s:
        simulation.advance(drive.segments(round(case.wait_s * TICKS_PER_S)))
    return simulation, drive


@cache
def motions(case: Case) -> tuple[Motion, ...]:
    """Return the motion at each gap in sequence; it does not depend on instruments or seed."""
    simulation, drive = driven(case)
    found: list[Motion] = []
    for gap_m in case.gaps_m:
        if found:
            simulation.configure(case.config(gap_m))
        found.append(simulation.advance(drive.segments(round(case.span_s * TICKS_PER_S))))
    return tuple(found)


def stretches(case: Case, numbers: range) -> Iterator[Motion]:
    """Yield stretches of one irregular motion, each an independent sample: the n-th begins n spans after the first."""
    simulation, drive = driven(case)
    for number in range(numbers.stop):
        motion = simulation.advance(drive.segments(round(case.span_s * TICKS_PER_S)))
        if number in numbers:
            yield motion


def measured(case: Case, seed: int, found: tuple[Motion, ...]) -> tuple[list[Table], Calibration]:
    """Return the rows of a session, and the certificate of the instruments that measured it."""
    chain, tracker = Chain(case.config(case.gaps_m[0], seed)), Tracker()
    info = chain.info()
    tracker.configure(Table(0, info))
    command = np.zeros(1, APPLIED)
    command["frequency"], command["current"] = case.frequency_hz, case.amplitude
    tracker.on_applied(Table(0, command))
    for number, (gap_m, motion) in enumerate(zip(case.gaps_m, found, strict=True)):
        chain.acquire(motion, motion.first_tick, len(motion.segments))
        tracker.label(gap_m, round(number * case.span_s * NS_PER_S))
    rows = list(tracker.feed(Table(0, chain.read(chain.ready))).measurements)
    return rows, Calibration.from_info(info)


@cache
def true_ratio(case: Case, stamp_ns: int, cycles: int) -> complex:
    """Return X_1 / X_b of the motion itself over the scans of a measurement that ends at this stamp."""
    last = round(stamp_ns * RATE_HZ / NS_PER_S)
    scans = np.arange(last + 1 - round(cycles * RATE_HZ / case.frequency_hz), last + 1)
    motion = motions(case)[scans[0] // (round(case.span_s * TICKS_PER_S) * PER_TICK)]
    segment = scans // PER_TICK + motions(case)[0].first_tick
    x_1, x_b = motion.quantities(("x_1", "x_b"), segment, scans % PER_TICK / RATE_HZ)
    angle = 2.0 * np.pi * case.frequency_hz / RATE_HZ * np.outer(np.arange(1, HARMONICS + 1), scans)
    basis = np.concatenate([np.ones((1, len(scans))), np.cos(angle), np.sin(angle)])
    found = np.linalg.solve(basis @ basis.T, basis @ np.stack([x_1, x_b], axis=1))
    phasors = found[1] - 1j * found[1 + HARMONICS]
    return complex(phasors[0] / phasors[1])


LONG_S = 36_000.0
CHUNK_S = 60.0
PER_CYCLE = 32


@cache
def long_run_ratio(case: Case) -> complex:
    """Return X_1 / X_b from means over a long record: DT and phase of an irregular motion."""
    simulation, drive = driven(case)
    total = np.zeros(2, np.complex128)
    chunk = round(CHUNK_S * TICKS_PER_S)
    for _ in range(round(LONG_S / CHUNK_S)):
        motion = simulation.advance(drive.segments(chunk))
        number = np.repeat(np.arange(motion.first_tick, motion.last_tick + 1), PER_CYCLE)
        offset = np.tile(np.arange(PER_CYCLE) / PER_CYCLE / TICKS_PER_S, chunk)
        turn = np.exp(-2j * np.pi * case.frequency_hz * (number / TICKS_PER_S + offset))
        total += motion.quantities(("x_1", "x_b"), number, offset) @ turn
    return complex(total[0] / total[1])


Found = tuple[str, dict[tuple[str, ...], list[Deviation]], Counter[str]]


def judged(case: Case, seeds: range) -> Found:
    """Return the table, the deviations by quantity, and the statuses of rows without numbers."""
    cells: dict[tuple[str, ...], list[Deviation]] = {}
    refused: Counter[str] = Counter()
    irregular = case.table == "irregular"
    read = ((one,) for one in stretches(case, seeds)) if irregular else repeat(motions(case))
    for seed, found in zip(seeds, read, strict=False):
        rows, calibration = measured(case, seed, found)
        settled = [table for table in rows if table.rows["settled"][0] == 1.0]
        if case.table == "reductions":
            for name, one in reductions(case, settled, calibration):
                cells.setdefault((*case.label, *name), []).append(one)
            continue
        if not settled:
            refused[rows[0].rows["status"][0].decode() if rows else "nothing"] += 1
            continue
        table = settled[0]
        row = table.rows[0]
        truth = long_run_ratio(case) if irregular else true_ratio(case, table.stamp_ns, int(row["cycles"]))
        for name, one in deviations(row, truth):
            cells.setdefault((*case.label, name), []).append(one)
    return case.table, cells, refused


def deviations(row: np.void, truth: complex) -> Iterator[tuple[str, Deviation]]:
    """Yield DT and phase of a row against the truth."""
    dt, u = float(row["transmissibility"]), float(row["transmissibility_uncertainty"])
    steps = float(row["steps_uncertainty"])
    yield "DT", Deviation(dt / abs(truth) - 1.0, u / abs(truth), 2.0 * steps**2 > u**2)
    turn = float(np.angle(np.exp(1j * row["phase"]) / (truth / abs(truth))))
    yield "phase", Deviation(turn, float(row["phase_uncertainty"]), steps / dt > float(row["phase_uncertainty"]) / 2.0)


def reductions(
    case: Case, settled: list[Table], calibration: Calibration
) -> Iterator[tuple[tuple[str, str], Deviation]]:
    """Yield the results of a session by (gap, rows per gap): its reduction against the truth."""
    by_gap = {gap_m: [table for table in settled if table.rows["gap"][0] == gap_m] for gap_m in case.gaps_m}
    without = by_gap.pop(NO_SPHERE)
    for gap_m, tables in by_gap.items():
        for count in (1, 2):
            dt_0, dt = (
                np.mean([abs(true_ratio(case, t.stamp_ns, int(t.rows["cycles"][0]))) for t in taken[:count]])
                for taken in (without, tables)
            )
            got = reduction(
                *(np.concatenate([t.rows for t in taken[:count]]) for taken in (without, tables)), calibration
            )
            one = Deviation(
                got.percent - 100.0 * float(1.0 - dt / dt_0), got.u_points, 2.0 * got.steps_points**2 > got.u_points**2
            )
            yield (f"{gap_m * 1e3:g}", f"{count}"), one


HEADINGS = {
    "small": ("Hz", "base [µm]", "bits", "laser noise"),
    "irregular": ("gap [mm]", "Hz"),
    "reductions": ("bits", "gap [mm]", "rows"),
}
CASES = {"small": small_cases, "irregular": irregular_cases, "reductions": reduction_cases}


def verdict(found: list[Deviation]) -> tuple[str, bool]:
    """Return a remark on a cell and whether it passes."""
    n, inside = len(found), sum(one.inside for one in found)
    bounded = sum(one.bounded for one in found) > 0.5 * n
    low = binom.cdf(inside, n, LEAST) < CHANCE
    high = binom.sf(inside - 1, n, MOST) < CHANCE and not bounded
    return ("too few" if low else "too many" if high else "bounded" if bounded else "", not (low or high))


def main() -> int:
    """Print a row per cell and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help="small, irregular, reductions; default: all")
    parser.add_argument("--seeds", type=int, default=300, metavar="N", help="default: %(default)s")
    parser.add_argument("--first-seed", type=int, default=1, metavar="N", help="default: %(default)s")
    parser.add_argument("--frequencies", type=float, nargs="+", metavar="HZ", help="frequencies of small signals [Hz]")
    parser.add_argument("--processes", type=int, default=2, metavar="N", help="default: %(default)s")
    options = parser.parse_args()
    wanted = options.tables or list(CASES)
    if not set(wanted) <= set(CASES):
        parser.error(f"TABLE must be one of {', '.join(CASES)}")
    cases = [
        case
        for table in wanted
        for case in CASES[table](*([options.frequencies] if options.frequencies and table == "small" else []))
    ]
    end = options.first_seed + options.seeds
    tasks = [
        (case, range(first, min(first + BATCH, end)))
        for case in cases
        for first in range(options.first_seed, end, BATCH)
    ]
    console, failed = Console(), False
    cells: dict[tuple[str, ...], list[Deviation]] = {}
    refusals: dict[tuple[str, ...], Counter[str]] = {}
    with (
        ProcessPoolExecutor(options.processes) as pool,
        Progress(console=console, disable=not sys.stdout.isatty()) as bar,
    ):
        going = bar.add_task("seeds", total=len(tasks))
        for (case, _), (table, found, refused) in zip(tasks, pool.map(judged, *zip(*tasks, strict=True)), strict=True):
            for name, some in found.items():
                cells.setdefault((table, *name), []).extend(some)
            refusals.setdefault((table, *case.label), Counter()).update(refused)
            bar.advance(going)
    for table in wanted:
        text = TextTable(title=f"{table}, {options.seeds} sets of instruments")
        of = ("of",) if table != "reductions" else ()
        for heading in (*HEADINGS[table], *of, "measured", "u", "rms error", "mean error", "within ± 2u", ""):
            text.add_column(heading, justify="right")
        for (kind, *name), refused in refusals.items():
            if kind == table and refused:
                words = ", ".join(f"{status} {count}" for status, count in refused.items())
                text.add_row(*name, *("" for _ in of), *[""] * 5, words)
        for (kind, *name), found in cells.items():
            if kind != table:
                continue
            errors, u, (word, good) = np.array([one.error for one in found]), [one.u for one in found], verdict(found)
            failed |= not good
            text.add_row(
                *name, f"{len(found)}", f"{np.mean(u):.5f}", f"{np.sqrt(np.mean(errors**2)):.5f}",
                f"{errors.mean():+.5f}", f"{100.0 * np.mean([one.inside for one in found]):.1f} %", word,
            )  # fmt: skip
        console.print(text)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
