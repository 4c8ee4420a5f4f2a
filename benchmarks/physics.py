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
"""The mechanics compared with its peers, on one problem, in one run.

The problem: prescribed base 60 µm · sin(2π 9.1 t), m_1 = 0.13 kg, f_n = 9.105 Hz, ζ = 0.0045, m = 1.0524 g,
K = 4.403e9 N/m^1.5, Flores e = 0.35. It starts with x_1 = −6 mm at rest and the sphere at x_1 with +0.15 m/s, and lasts
60 s.

Speeds are simulated seconds per wall second, medians of five, on one warm core. The programs run alternately, so that
other loads slow all of them alike, and a ratio is the median of the ratios of the turns.
"""

from __future__ import annotations

import math
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from benchmarks.physics_peers import peer_c, scipy_wall_s
from impact_rig.arithmetic.random import Random
from impact_rig.physics import SEGMENT, FunctionGenerator, Simulation
from impact_rig.physics.linear import hertz_stiffness_n_m32, sphere_mass_kg
from impact_rig.rig.config import RigConfig, from_flat

END_S, LATE_S, TURNS = 60.0, 40.0, 5
SCIPY_END_S = 3.0  # it is slow, and linear in time
FREQUENCY_HZ, BASE_M = 9.1, 60e-6
MASS_KG, STIFFNESS = 1.0524e-3, 4.403e9
REFERENCE_AMPLITUDE_M = 3.48083e-3
"""Amplitude at 6 mm, as given alike by closed-form flights with 50 ns steps in contact and an order-8 integrator."""

FIRST_RESULT = "from benchmarks.physics import wall_s; wall_s(6e-3, 1.0)"


def problem(gap_m: float, *, sphere: bool = True) -> Simulation:
    """Return the simulation of the benchmark problem at its start.

    Density and Young's moduli are those that give the mass and stiffness of the problem, with the rounding used there.
    """
    rig = RigConfig()
    heavier = MASS_KG / sphere_mass_kg(rig.sphere)
    stiffer = STIFFNESS / hertz_stiffness_n_m32(rig.sphere, rig.barriers)
    config = from_flat(
        rig,
        {
            "drive.kind": "prescribed",
            "structure.damping_ratio": 0.0045,
            "barriers.gap_m": gap_m,
            "barriers.young_modulus_pa": stiffer * rig.barriers.young_modulus_pa,
            "sphere.young_modulus_pa": stiffer * rig.sphere.young_modulus_pa,
            "sphere.density_kg_m3": heavier * rig.sphere.density_kg_m3,
            "sphere.present": sphere,
        },
    )
    simulation = Simulation(config)
    simulation.place(x_1=-6e-3, d_rate=0.15)
    return simulation


def segment(duration_s: float) -> np.ndarray:
    """Return the drive as one long segment."""
    rows = np.zeros(1, SEGMENT)
    rows["duration"], rows["omega"], rows["amplitude"] = duration_s, 2.0 * math.pi * FREQUENCY_HZ, BASE_M
    return rows


def wall_s(gap_m: float, end_s: float = END_S, *, sphere: bool = True) -> float:
    """Return the wall time of `end_s` of the benchmark problem."""
    simulation, drive = problem(gap_m, sphere=sphere), segment(end_s)
    return _clock(lambda: simulation.advance(drive))


def coupled(gap_m: float) -> tuple[Simulation, FunctionGenerator]:
    """Return the default rig including the shaker, and its drive in ticks of 10 ms."""
    config = from_flat(RigConfig(), {"barriers.gap_m": gap_m, "drive.amplitude": 0.52})
    return Simulation(config), FunctionGenerator(config.drive, config.shaker, Random(1))


def coupled_wall_s(gap_m: float) -> float:
    """Return the wall time of 60 s of the coupled rig."""
    simulation, generator = coupled(gap_m)
    drive = generator.segments(round(END_S * 100))
    return _clock(lambda: simulation.advance(drive))


def amplitude_m(gap_m: float) -> float:
    """Return the amplitude by lock-in over complete cycles of the last 20 s."""
    motion = problem(gap_m).advance(segment(END_S))
    cycles = int((END_S - LATE_S) * FREQUENCY_HZ)
    n = cycles * 2000
    t = END_S - (cycles / FREQUENCY_HZ) * (1.0 - np.arange(n) / n)
    x = motion.quantity("x_1", np.full(n, motion.first_tick), t)
    return float(2.0 * abs(np.mean(x * np.exp(-2j * math.pi * FREQUENCY_HZ * t))))


def speeds() -> dict[str, float]:
    """Measure our speed and that of the peers alternately."""
    takes: dict[str, Callable[[], float]] = {
        "mechanics_{}_gapnone": lambda: wall_s(6e-3, sphere=False) / END_S,
        "mechanics_{}_gap2mm": lambda: wall_s(2e-3) / END_S,
        "mechanics_{}_gap6mm": lambda: wall_s(6e-3) / END_S,
        "mechanics_{}_gap10mm": lambda: wall_s(10e-3) / END_S,
        "coupled_{}_gap2mm": lambda: coupled_wall_s(2e-3) / END_S,
        "coupled_{}_gap6mm": lambda: coupled_wall_s(6e-3) / END_S,
        "peer_c_{}_gap2mm": lambda: peer_c(2e-3, END_S)[0] / END_S,
        "peer_c_{}_gap6mm": lambda: peer_c(6e-3, END_S)[0] / END_S,
        "solve_ivp_{}_gap6mm": lambda: (
            scipy_wall_s(SCIPY_END_S, problem(6e-3).parameters, FREQUENCY_HZ, BASE_M) / SCIPY_END_S
        ),
        "solve_ivp_any_step_{}_gap6mm": lambda: (
            scipy_wall_s(SCIPY_END_S, problem(6e-3).parameters, FREQUENCY_HZ, BASE_M, longest_s=math.inf) / SCIPY_END_S
        ),
    }
    for take in takes.values():
        take()
    turns = [{name: take() for name, take in takes.items()} for _ in range(TURNS)]

    def ahead(ours: str, peer: str) -> float:
        return statistics.median(turn[peer] / turn[ours] for turn in turns)

    return {
        **{name.format("x_realtime"): 1.0 / statistics.median(turn[name] for turn in turns) for name in takes},
        "mechanics_over_solve_ivp": ahead("mechanics_{}_gap6mm", "solve_ivp_{}_gap6mm"),
        "mechanics_over_solve_ivp_any_step": ahead("mechanics_{}_gap6mm", "solve_ivp_any_step_{}_gap6mm"),
        "mechanics_over_peer_c_gap2mm": ahead("mechanics_{}_gap2mm", "peer_c_{}_gap2mm"),
        "mechanics_over_peer_c_gap6mm": ahead("mechanics_{}_gap6mm", "peer_c_{}_gap6mm"),
    }


def accuracy() -> dict[str, float]:
    """Compare amplitudes with the reference, at the settings whose speed is measured."""
    _, of_c = peer_c(6e-3, END_S)
    amplitudes = {"mechanics": amplitude_m(6e-3), "peer_c": of_c}
    return {
        f"{name}_amplitude_error_percent_gap6mm": 100.0 * abs(value / REFERENCE_AMPLITUDE_M - 1.0)
        for name, value in amplitudes.items()
    }


def costs() -> dict[str, float]:
    """Measure the causes of cost: simulated time, impacts and samples, and nothing else."""
    simulation, generator = coupled(6e-3)
    slices, impacts = [], []
    for _ in range(10):  # ten times a minute of rig time, in calls of a second, as a node makes them
        spent, count = 0.0, 0
        for _ in range(60):
            begin = time.perf_counter()
            motion = simulation.advance(generator.segments(100))
            spent += time.perf_counter() - begin
            count += len(motion.impacts)
        slices.append(spent)
        impacts.append(count)
    figures = {
        "coupled_us_per_simulated_s": 1e6 * statistics.median(slices) / 60.0,
        "coupled_us_per_impact": 1e6 * statistics.median(s / n for s, n in zip(slices, impacts, strict=True)),
        "coupled_cost_last_over_first_minute": statistics.median(slices[-3:]) / statistics.median(slices[:3]),
    }
    second = generator.segments(100)
    motion = simulation.advance(second)
    for rate_hz in (1_000, 10_000, 50_000):
        per_tick = rate_hz // 100
        which = np.repeat(np.arange(motion.first_tick, motion.last_tick + 1), per_tick)
        offsets = np.tile(np.arange(per_tick) / rate_hz, len(second))
        wall = statistics.median(_clock(lambda: motion.quantities(("x_1", "x_b"), which, offsets)) for _ in range(9))  # noqa: B023  # called at once
        figures[f"sampling_ns_per_sample_{rate_hz // 1000}kSps"] = 1e9 * wall / rate_hz
    return figures


def first_results() -> dict[str, float]:
    """Measure the time from starting Python to the first simulated second."""
    run = [sys.executable, "-c", FIRST_RESULT]
    return {"mechanics_cold_first_result_s": _clock(lambda: subprocess.run(run, check=True))}


def _clock(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def run() -> dict[str, float]:
    """Measure and return the figures."""
    return speeds() | accuracy() | costs() | first_results()
