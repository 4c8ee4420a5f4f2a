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
"""One contact: force over indentation for every law, and the error as a function of the number of steps."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from impact_rig.physics import SEGMENT, Motion, Simulation
from impact_rig.physics.collocation import LAST
from impact_rig.physics.contact import LAWS, hunt_crossley
from impact_rig.physics.contact_step import ROUNDS, begin_step, solve
from impact_rig.physics.model import Model, build
from impact_rig.physics.state import CONTACT_STEP, STATE, record
from impact_rig.rig.config import RigConfig, from_flat
from tools.figures.style import SERIES, STRUCTURE, direct_label, finished, new_figure, style

Real = NDArray[np.float64]

HEIGHT = 420.0
SPEED_M_S, GAP_M = 0.3, 1e-3
HEAVY_KG = 100.0  # a wall that hardly moves
POINTS = 161
COLOURS, DASHES = (*SERIES[:5], SERIES[6]), ("-", "--", ":")
"""Pairs of colour and dashes, each used once."""
EXACT_STEPS, COLLOCATION_STEPS, RK4_STEPS = 96, (4, 5, 6, 8, 10, 12, 14, 16), (10, 20, 40, 80, 160, 320, 640, 1280)


def draw_laws() -> str:
    """Draw force over indentation of every compliant law, each with its own pair of colour and dashes."""
    with style():
        figure = new_figure(HEIGHT)
        axes = figure.subplots()
        drawn = 0
        for law in LAWS:
            simulation, motion = _one_contact(law)
            hit = motion.impacts[0]
            if hit["duration"] == 0.0:
                continue  # instantaneous: nothing to draw
            t = hit["offset"] + np.linspace(0.0, 1.0, POINTS)[1:-1] * hit["duration"]
            x_1, x_2, force = motion.quantities(("x_1", "x_2", "force_right"), np.zeros(len(t), int), t)
            colour, dashes = COLOURS[drawn % len(COLOURS)], DASHES[drawn // len(COLOURS)]
            axes.plot(
                1e6 * (x_2 - x_1 - 0.5 * GAP_M), force, color=colour, linestyle=dashes,
                linewidth=3.5 if law == "flores" else 1.5, label=f"{law}: {simulation.realised_restitution:.3f}",
            )  # fmt: skip
            drawn += 1
        axes.set(
            xlabel="indentation (µm)",
            ylabel="force (N)",
            title="One contact at 0.3 m/s, e = 0.35: law, and the e it returns",
        )
        axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        return finished(
            figure,
            "Loops of contact force over indentation for every law; the wider the loop, the less the sphere returns.",
        )


def draw_order() -> str:
    """Draw the error over the number of equal steps: our collocation, and RK4 on the original equations."""
    factor = LAWS["flores"](0.35).hysteresis_factor()
    model = build(from_flat(RigConfig(), {"drive.kind": "prescribed"}))
    exact = _by_collocation(model, EXACT_STEPS)
    ours = [np.abs(_by_collocation(model, steps) / exact - 1.0).max() for steps in COLLOCATION_STEPS]
    returned = hunt_crossley.realised(factor)
    k = model.parameters[0].stiffness / model.parameters[0].m
    classical = np.array([abs(_rk4(k, factor, steps) / returned - 1.0) for steps in RK4_STEPS])
    with style():
        figure = new_figure(HEIGHT)
        axes = figure.subplots()
        axes.loglog(COLLOCATION_STEPS, ours, "o-", color=STRUCTURE)
        axes.loglog(RK4_STEPS, classical, "s-", color=SERIES[2])
        direct_label(axes, 14.0, 1e-8, "collocation in √δ: order 9", STRUCTURE)
        direct_label(axes, 60.0, 3e-5, "RK4 in δ and time: order 2.5", SERIES[2])
        axes.set(xlabel="equal steps in one contact", ylabel="relative error", title="Flores, e = 0.35, 0.3 m/s")
        return finished(
            figure, "Error over steps of one contact: collocation falls far faster than the Runge-Kutta method."
        )


def _by_collocation(model: Model, steps: int) -> Real:
    """Return √δ and δ' at a given value of the regularised variable after the touch, shape (2,)."""
    p, s, k = model.parameters[0], record(STATE)[0], record(CONTACT_STEP)[0]
    p.rtol = 1e-16
    deepest = (p.m_eff * SPEED_M_S**2 / p.stiffness) ** 0.4
    step = 3.0 * math.sqrt(deepest) / SPEED_M_S / steps  # in total: until the sphere is on its way out again
    s.side, s.speed, s.per_v0 = 1.0, SPEED_M_S, 1.0 / SPEED_M_S
    k.terms = 1  # a structure at rest
    for _ in range(steps):
        begin_step(p, model.law, s, k)
        solve(p, model.law, s, k, step, ROUNDS)
        s.w, s.speed = k.w[LAST], k.speed[LAST]
        s.deepest_w = max(s.deepest_w, s.w)
    return np.array([s.w, s.speed])


def _one_contact(law: str) -> tuple[Simulation, Motion]:
    """Let the sphere meet the right wall at 0.3 m/s."""
    config = from_flat(
        RigConfig(),
        {
            "drive.kind": "prescribed",
            "contact.law": law,
            "barriers.gap_m": GAP_M,
            "structure.mass_kg": HEAVY_KG,
            "structure.natural_frequency_hz": 0.1,
        },
    )
    simulation = Simulation(config)
    simulation.place(d_rate=SPEED_M_S)
    drive = np.zeros(1, SEGMENT)
    drive["duration"], drive["omega"] = 0.5 * GAP_M / SPEED_M_S + 200e-6, 1.0
    return simulation, simulation.advance(drive)


def _rk4(k: float, factor: float, steps: int) -> float:
    def rates(y: Real) -> Real:
        return np.array([y[1], -k * max(y[0], 0.0) ** 1.5 * (1.0 + factor * y[1] / SPEED_M_S)])

    y, h = np.array([0.0, SPEED_M_S]), 60e-6 / steps  # to beyond the release
    for _ in range(steps):
        a = rates(y)
        b = rates(y + 0.5 * h * a)
        c = rates(y + 0.5 * h * b)
        y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(y + h * c))
    return float(-y[1] / SPEED_M_S)
