"""The mechanics' peers on the benchmark problem: SciPy's `solve_ivp` and a plain C program."""

from __future__ import annotations

import math
import subprocess
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from impact_rig.physics.model import Parameters

PROGRAM = Path("build") / "plain_rk4"
LONGEST_STEP_S = 1e-3


def plain_c(gap_m: float, end_s: float, late_s: float, p: Parameters) -> tuple[float, float]:
    """Run the fixed-step C program; return its wall time [s] and amplitude [m]."""
    if not PROGRAM.exists():
        PROGRAM.parent.mkdir(exist_ok=True)
        subprocess.run(["gcc", "-O3", "-o", PROGRAM, Path(__file__).with_name("plain_rk4.c"), "-lm"], check=True)
    numbers = [repr(value) for value in (gap_m, end_s, late_s, p.m, p.force.stiffness)]
    output = subprocess.run([PROGRAM.resolve(), *numbers], check=True, capture_output=True, text=True).stdout
    wall, amplitude, _ = output.split()
    return float(wall), float(amplitude)


def scipy_wall_s(
    end_s: float, p: Parameters, frequency_hz: float, base_m: float, *, longest_s: float = LONGEST_STEP_S
) -> float:
    """Return the wall time of SciPy's RK45 at rtol 1e-6 with events at the walls: the paper's ode45.

    Its events are seen at the ends of steps only; with steps no longer than the C program's in flight it does not pass
    over a touch that is faster than a few mm/s.
    """
    c, half = p.c, p.half_gap  # the same numbers, not the same code
    omega = 2.0 * math.pi * frequency_hz

    def rates(t: float, s: np.ndarray, side: int, beta: float) -> list[float]:
        x, v, x2, v2 = s
        force = 0.0
        if side:
            depth, speed = side * (x2 - x) - half, side * (v2 - v)
            force = max(0.0, p.force.stiffness * max(depth, 0.0) ** 1.5 * (1.0 + beta * speed))
        base, base_v = base_m * math.sin(omega * t), base_m * omega * math.cos(omega * t)
        return [v, (-c.k_1 * (x - base) - c.c_1 * (v - base_v) + side * force) / c.m_1, v2, -side * force / p.m]

    def right(_t: float, s: np.ndarray, side: int, _b: float) -> float:
        return s[2] - s[0] - half if side >= 0 else -1.0

    def left(_t: float, s: np.ndarray, side: int, _b: float) -> float:
        return s[0] - s[2] - half if side <= 0 else -1.0

    t, state, side, beta = 0.0, np.array([-6e-3, 0.0, -6e-3, 0.15]), 0, 0.0
    begin = time.perf_counter()
    while t < end_s:
        for event in (right, left):
            event.terminal, event.direction = True, -1.0 if side else 1.0  # type: ignore[attr-defined]  # SciPy's way
        step = 1e-6 if side else 1e-4
        found = solve_ivp(
            rates, (t, end_s), state, "RK45", events=(right, left), args=(side, beta),
            rtol=1e-6, atol=1e-12, first_step=min(step, end_s - t), max_step=longest_s,
        )  # fmt: skip
        t, state = found.t[-1], found.y[:, -1]
        if found.status == 1:
            wall = 1 if len(found.t_events[0]) else -1
            side = 0 if side else wall
            beta = p.force.damping / max(wall * (state[3] - state[1]), p.speed_floor)
    return time.perf_counter() - begin
