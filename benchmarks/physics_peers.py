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
"""Peers of the mechanics on the benchmark problem: SciPy's `solve_ivp`, and a plain C program optimised for speed."""

from __future__ import annotations

import json
import math
import subprocess
import time
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

PROGRAM = Path("build") / "peer_rk4"
SOURCE = Path(__file__).with_name("peer_rk4.c")
COMPILE = ("gcc", "-O3", "-march=native")
LONGEST_STEP_S = 1e-3


def peer_c(gap_m: float, end_s: float) -> tuple[float, float]:
    """Run the C program, RK4 with 2 µs in contact and 1 ms in flight; return its wall time [s] and amplitude [m]."""
    if not PROGRAM.exists() or PROGRAM.stat().st_mtime < SOURCE.stat().st_mtime:
        PROGRAM.parent.mkdir(exist_ok=True)
        subprocess.run([*COMPILE, "-o", PROGRAM, SOURCE, "-lm"], check=True)
    numbers = [repr(value) for value in (gap_m, end_s, 2e-6, LONGEST_STEP_S, 1)]
    found = json.loads(subprocess.run([PROGRAM.resolve(), *numbers], check=True, capture_output=True, text=True).stdout)
    return float(found["wall"]), float(found["amp"])


def scipy_wall_s(
    end_s: float, p: np.record, frequency_hz: float, base_m: float, *, longest_s: float = LONGEST_STEP_S
) -> float:
    """Return the wall time of SciPy's RK45 at rtol 1e-6 with events at the walls: the paper's ode45.

    SciPy looks for events at the ends of steps only. With steps no longer than those of the C program in flight, it
    does not miss a touch that is faster than a few mm/s.
    """
    half = p.half_gap  # the same numbers in independent code
    omega = 2.0 * math.pi * frequency_hz

    def rates(t: float, s: np.ndarray, side: int, beta: float) -> list[float]:
        x, v, x2, v2 = s
        force = 0.0
        if side:
            depth, speed = side * (x2 - x) - half, side * (v2 - v)
            force = max(0.0, p.stiffness * max(depth, 0.0) ** 1.5 * (1.0 + beta * speed))
        base, base_v = base_m * math.sin(omega * t), base_m * omega * math.cos(omega * t)
        return [v, (-p.k_1 * (x - base) - p.c_1 * (v - base_v) + side * force) / p.m_1, v2, -side * force / p.m]

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
            beta = p.factor / max(wall * (state[3] - state[1]), p.speed_floor)
    return time.perf_counter() - begin
