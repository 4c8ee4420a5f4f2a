"""The mechanics beside its peers, on one problem, in one run.

Prescribed base 60 µm · sin(2π 9.1 t), m_1 = 0.13 kg, f_n = 9.105 Hz, ζ = 0.0045, Flores e = 0.35; start x_1 = −6 mm at
rest, sphere at x_1 with +0.15 m/s; 60 s. Speeds are simulated seconds per wall second, medians, one core, warm; peers
take turns with us, so that a busy machine slows all alike.
"""

from __future__ import annotations

import math
import statistics
import subprocess
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from impact_rig.config import RigConfig, from_flat
from impact_rig.physics import SEGMENT, FunctionGenerator, Simulation
from impact_rig.physics.properties import hertz_stiffness_n_m32, sphere_mass_kg

END_S, LATE_S, REPEATS = 60.0, 40.0, 5
FREQUENCY_HZ, BASE_M = 9.1, 60e-6
REFERENCE_AMPLITUDE_M = 3.48083e-3
"""Gap 6 mm: closed-form flights with 50 ns steps in contact, and an order-8 integrator at rtol 1e-11, agree on it."""


def problem(gap_m: float) -> Simulation:
    """Return the simulation of the benchmark problem at its start."""
    config = from_flat(
        RigConfig(), {"drive.kind": "prescribed", "structure.damping_ratio": 0.0045, "barriers.gap_m": gap_m}
    )
    simulation = Simulation(config)
    simulation.place(x_1=-6e-3, d_rate=0.15)
    return simulation


def segment(duration_s: float) -> np.ndarray:
    """Return the drive as one long segment."""
    rows = np.zeros(1, SEGMENT)
    rows["duration"], rows["omega"], rows["amplitude"] = duration_s, 2.0 * math.pi * FREQUENCY_HZ, BASE_M
    return rows


def wall_s(gap_m: float) -> float:
    """Return the wall time of 60 s."""
    simulation, drive = problem(gap_m), segment(END_S)
    begin = time.perf_counter()
    simulation.advance(drive)
    return time.perf_counter() - begin


def coupled_wall_s(gap_m: float) -> float:
    """Return the wall time of 60 s of the coupled rig, in ticks of 10 ms."""
    config = from_flat(RigConfig(), {"barriers.gap_m": gap_m, "drive.amplitude": 0.52})
    generator = FunctionGenerator(config.drive, config.shaker, np.random.default_rng(1))
    simulation, drive = Simulation(config), generator.segments(round(END_S * 100))
    begin = time.perf_counter()
    simulation.advance(drive)
    return time.perf_counter() - begin


def amplitude_m(gap_m: float) -> float:
    """Return the amplitude by lock-in over whole cycles of the last 20 s."""
    motion = problem(gap_m).advance(segment(END_S))
    cycles = int((END_S - LATE_S) * FREQUENCY_HZ)
    n = cycles * 2000
    t = END_S - (cycles / FREQUENCY_HZ) * (1.0 - np.arange(n) / n)
    x = motion.quantity("x_1", np.full(n, motion.first_segment), t)
    return float(2.0 * abs(np.mean(x * np.exp(-2j * math.pi * FREQUENCY_HZ * t))))


def plain_c(gap_m: float) -> float:
    """Return the wall time of the fixed-step C program."""
    program = Path("build") / "plain_rk4"
    if not program.exists():
        program.parent.mkdir(exist_ok=True)
        subprocess.run(["gcc", "-O3", "-o", program, Path(__file__).with_name("plain_rk4.c"), "-lm"], check=True)
    config = RigConfig()
    mass, stiffness = sphere_mass_kg(config.sphere), hertz_stiffness_n_m32(config.sphere, config.barriers)
    numbers = [str(value) for value in (gap_m, END_S, LATE_S, mass, stiffness)]
    output = subprocess.run([program.resolve(), *numbers], check=True, capture_output=True, text=True).stdout
    return float(output.split()[0])


def solve_ivp_x_realtime(gap_m: float, duration_s: float = 2.0) -> float:
    """Return the speed of SciPy's RK45 at rtol 1e-6 with events at the walls: the paper's ode45."""
    p = problem(gap_m)._model.p  # the same numbers, not the same code
    c, half = p.c, p.half_gap

    def rates(t: float, s: np.ndarray, side: int, beta: float) -> list[float]:
        x, v, x2, v2 = s
        angle = 2.0 * math.pi * FREQUENCY_HZ * t
        force = 0.0
        if side:
            depth, speed = side * (x2 - x) - half, side * (v2 - v)
            force = max(0.0, p.force.stiffness * max(depth, 0.0) ** 1.5 * (1.0 + beta * speed))
        base, base_v = BASE_M * math.sin(angle), BASE_M * 2.0 * math.pi * FREQUENCY_HZ * math.cos(angle)
        return [v, (-c.k_1 * (x - base) - c.c_1 * (v - base_v) + side * force) / c.m_1, v2, -side * force / p.m]

    def right(_t: float, s: np.ndarray, side: int, _b: float) -> float:
        return s[2] - s[0] - half if side >= 0 else -1.0

    def left(_t: float, s: np.ndarray, side: int, _b: float) -> float:
        return s[0] - s[2] - half if side <= 0 else -1.0

    t, state, side, beta = 0.0, np.array([-6e-3, 0.0, -6e-3, 0.15]), 0, 0.0
    begin = time.perf_counter()
    while t < duration_s:
        for event in (right, left):
            event.terminal, event.direction = True, -1.0 if side else 1.0  # type: ignore[attr-defined]
        step = 1e-6 if side else 1e-4
        found = solve_ivp(
            rates, (t, duration_s), state, "RK45", events=(right, left), args=(side, beta),
            rtol=1e-6, atol=1e-12, first_step=min(step, duration_s - t),
        )  # fmt: skip
        t, state = found.t[-1], found.y[:, -1]
        if found.status == 1:
            wall = 1 if len(found.t_events[0]) else -1
            side = 0 if side else wall
            beta = p.force.damping / max(wall * (state[3] - state[1]), p.speed_floor)
    return duration_s / (time.perf_counter() - begin)


def run() -> dict[str, float]:
    """Measure and return the figures."""
    figures: dict[str, float] = {}
    for gap in (2e-3, 6e-3, 10e-3):
        wall_s(gap)
        ours, peer = [], []
        for _ in range(REPEATS):
            ours.append(wall_s(gap))
            if gap < 10e-3:
                peer.append(plain_c(gap))
        name = f"gap{gap * 1e3:g}"
        figures[f"mechanics_x_realtime_{name}mm"] = END_S / statistics.median(ours)
        if peer:
            figures[f"plain_c_x_realtime_{name}mm"] = END_S / statistics.median(peer)
            figures[f"mechanics_over_plain_c_{name}mm"] = statistics.median(
                p / o for p, o in zip(peer, ours, strict=True)
            )
            coupled_wall_s(gap)
            figures[f"coupled_x_realtime_{name}mm"] = END_S / statistics.median(
                coupled_wall_s(gap) for _ in range(REPEATS)
            )
    figures["mechanics_amplitude_error_percent_gap6mm"] = 100.0 * abs(amplitude_m(6e-3) / REFERENCE_AMPLITUDE_M - 1.0)
    figures["solve_ivp_x_realtime_gap6mm"] = solve_ivp_x_realtime(6e-3)
    figures["mechanics_over_solve_ivp"] = (
        figures["mechanics_x_realtime_gap6mm"] / figures["solve_ivp_x_realtime_gap6mm"]
    )
    return figures
