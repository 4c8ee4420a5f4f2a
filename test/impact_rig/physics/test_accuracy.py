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
"""Accuracy of the integration: its order, the benchmark problem's reference, tighter tolerances and floors."""

from __future__ import annotations

import math
from types import SimpleNamespace

import attrs
import numpy as np
import pytest
from kits.mechanics import benchmark_rig, hit, lock_in, prescribed, rig, sine, sphere_kg, stiffness
from scipy.integrate import solve_ivp

from impact_rig.physics import Simulation
from impact_rig.physics.collocation import LAST
from impact_rig.physics.contact import hunt_crossley
from impact_rig.physics.contact_step import ROUNDS, begin_step, solve
from impact_rig.physics.model import CONTACT_RTOL, Model, build
from impact_rig.physics.state import CONTACT_STEP, STATE, record
from impact_rig.rig.config import RigConfig
from impact_rig.rig.core import new_generator

FREQUENCY_HZ = 9.1
GAPS_M = (2e-3, 4e-3, 6e-3, 8e-3, 10e-3)
SETTLE_CYCLES, BATCHES, BATCH_CYCLES, PER_CYCLE = 100, 15, 20, 32
FLOOR_EFFECT = 1e-8  # of DT
REPEATABLE = 1e-8  # of DT: what tolerances may change where the motion repeats and its standard error is rounding
REFERENCE_M = {6e-3: (3.48083e-3, 1e-5), 10e-3: (2.44697e-3, 1e-5)}
"""Amplitudes of the benchmark problem by two other programs, and how closely they are to be met."""


def transmissibility(config: RigConfig, rtol: float) -> tuple[float, float]:
    """DT at 9.1 Hz and constant current, with its standard error from batches of cycles."""
    simulation, cycle_s = Simulation(config, rtol=rtol), 1.0 / FREQUENCY_HZ
    simulation.advance(sine(FREQUENCY_HZ, 0.52, cycle_s, SETTLE_CYCLES))
    ratios = []
    for _ in range(BATCHES):
        motion = simulation.advance(sine(FREQUENCY_HZ, 0.52, cycle_s, BATCH_CYCLES))
        cycle = np.repeat(np.arange(motion.first_tick, motion.last_tick + 1), PER_CYCLE)
        place = np.tile(np.arange(PER_CYCLE) / PER_CYCLE, BATCH_CYCLES)
        x_1, x_b = motion.quantities(("x_1", "x_b"), cycle, place * cycle_s) @ np.exp(-2j * math.pi * place)
        ratios.append(abs(x_1 / x_b))
    return float(np.mean(ratios)), float(np.std(ratios, ddof=1) / math.sqrt(BATCHES))


@pytest.mark.heavy
@pytest.mark.parametrize("gap", GAPS_M)
def test_tighter_tolerances_do_not_change_the_transmissibility(gap):
    config = rig(barriers={"gap_m": gap})
    (plain, plain_error), (tight, tight_error) = (
        transmissibility(config, rtol) for rtol in (CONTACT_RTOL, CONTACT_RTOL / 100.0)
    )
    assert max(plain_error, tight_error) < 3e-4 * plain
    assert abs(plain - tight) <= max(3.0 * math.hypot(plain_error, tight_error), REPEATABLE * plain)


@pytest.mark.heavy
@pytest.mark.parametrize("gap", [2e-3, 6e-3])
def test_the_least_approach_speed_does_not_change_the_transmissibility(gap):
    """Contacts slower than 1 mm/s are the tail of a chatter, or none."""
    plain, lower = (
        transmissibility(rig(barriers={"gap_m": gap}, contact={"speed_floor_m_s": floor}), CONTACT_RTOL)[0]
        for floor in (1e-3, 1e-4)
    )
    assert lower == pytest.approx(plain, rel=FLOOR_EFFECT)


@pytest.mark.parametrize("gap", REFERENCE_M)
def test_the_benchmark_problem_yields_the_reference_amplitude(gap):
    """The references were computed with m = 1.0524 g and K = 4.403e9, rounded: unrounded they are missed by 0.002 %."""
    config = benchmark_rig(barriers={"gap_m": gap})
    heavier, stiffer = 1.0524e-3 / sphere_kg(config), 4.403e9 / stiffness(config)
    config = attrs.evolve(
        config,
        sphere=attrs.evolve(
            config.sphere,
            density_kg_m3=config.sphere.density_kg_m3 * heavier,
            young_modulus_pa=config.sphere.young_modulus_pa * stiffer,
        ),
        barriers=attrs.evolve(config.barriers, young_modulus_pa=config.barriers.young_modulus_pa * stiffer),
    )
    simulation = Simulation(config)
    simulation.place(x_1=-6e-3, d_rate=0.15)
    motion = simulation.advance(sine(FREQUENCY_HZ, 60e-6, 60.0))
    cycles = 182
    got = abs(lock_in(motion, "x_1", FREQUENCY_HZ, 60.0 - cycles / FREQUENCY_HZ, cycles, per_cycle=500))
    wanted, tolerance = REFERENCE_M[gap]
    assert got == pytest.approx(wanted, rel=tolerance)
    late = motion.impacts["offset"] > 60.0 - 100 / FREQUENCY_HZ
    assert late.sum() / 100 == pytest.approx({6e-3: 2.5, 10e-3: 2.0}[gap], abs=0.02)


def contact_by_equal_steps(model: Model, speed: float, length: float, steps: int) -> np.ndarray:
    """(sqrt(δ), δ') after a given way in the regularised variable, from the touch on."""
    p, s, k = model.parameters[0], record(STATE)[0], record(CONTACT_STEP)[0]
    p.rtol = 1e-16
    s.side, s.speed, s.per_v0 = 1.0, speed, 1.0 / speed
    k.terms = 1  # a structure at rest
    for _ in range(steps):
        begin_step(p, model.law, s, k)
        solve(p, model.law, s, k, length / steps, ROUNDS)
        s.w, s.speed = k.w[LAST], k.speed[LAST]
        s.deepest_w = max(s.deepest_w, s.w)
    return np.array([s.w, s.speed])


@pytest.mark.heavy
def test_a_contact_is_integrated_at_the_order_of_its_method():
    """The kink of δ^1.5 at the touch does not lower the order, 2 · 5 − 1 of Radau IIA: steps are in sqrt(δ)."""
    model, speed = build(benchmark_rig()), 0.3
    scale = (model.parameters[0].m_eff * speed**2 / model.parameters[0].stiffness) ** 0.4
    length = 3.0 * math.sqrt(scale) / speed  # the sphere is on its way out again
    exact = contact_by_equal_steps(model, speed, length, 96)
    assert exact[1] < 0.0
    counts = np.array([6, 8, 10, 12, 14, 16])
    errors = [np.abs(contact_by_equal_steps(model, speed, length, n) / exact - 1.0).max() for n in counts]
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(9.0, abs=1.0), errors


def test_a_classical_method_has_order_two_and_a_half_on_the_same_contact():
    """RK4 in (δ, δ') and time: what the regularised variable is for."""
    factor, speed = 8.0 * 0.65 / (5.0 * 0.35), 0.3
    k = stiffness() / sphere_kg()
    exact = hunt_crossley.realised(factor)

    def rates(y: np.ndarray) -> np.ndarray:
        return np.array([y[1], -k * max(y[0], 0.0) ** 1.5 * (1.0 + factor * y[1] / speed)])

    counts, errors = np.array([40, 80, 160, 320, 640]), []
    for n in counts:
        y, h = np.array([0.0, speed]), 60e-6 / n
        for _ in range(n):  # to beyond the release, where the sphere flies on
            a = rates(y)
            b = rates(y + 0.5 * h * a)
            c = rates(y + 0.5 * h * b)
            y = y + h / 6.0 * (a + 2.0 * b + 2.0 * c + rates(y + h * c))
        errors.append(abs(-y[1] / speed / exact - 1.0))
    assert -np.polyfit(np.log(counts), np.log(errors), 1)[0] == pytest.approx(2.5, abs=0.3), errors


@pytest.mark.parametrize("law", ["flores", "kelvin_voigt"])
def test_the_error_of_a_contact_follows_the_tolerance(law):
    """Contacts of Flores' law are looked up at the default tolerance and below, as exactly as at the tightest one."""
    exact = hunt_crossley.realised(8.0 * 0.65 / (5.0 * 0.35)) if law == "flores" else 0.35
    tolerances = 10.0 ** -np.arange(3, 13)
    errors = [
        np.mean([abs(hit(v, law=law, rtol=rtol).restitution / exact - 1.0) for v in np.geomspace(0.1, 1.0, 5)])
        for rtol in tolerances
    ]
    assert (np.array(errors) <= 10.0 * tolerances).all(), errors
    if law == "kelvin_voigt":
        assert np.polyfit(np.log(tolerances), np.log(errors), 1)[0] >= 0.8, errors


USED = ("m_1", "c_1", "k_1", "m", "m_eff", "half_gap")


def touches_by_dop853(config: RigConfig, segments: np.ndarray) -> list[float]:
    """Instants [s] at which a sphere touches under `kelvin_voigt`, by SciPy's order-8 method with events.

    A base that moves in straight lines from tick to tick; a new start at every tick, touch and release.
    """
    p = SimpleNamespace(**{name: float(build(config).parameters[0][name]) for name in USED})
    log_e, contact_s = math.log(config.contact.restitution), config.contact.contact_time_s
    spring = p.m_eff * (math.pi**2 + log_e**2) / contact_s**2
    damper = -2.0 * p.m_eff * log_e / contact_s

    def motion(t, y, side, place, speed):
        x_1, v_1, x_2, v_2 = y
        force = 0.0
        if side:
            force = spring * (side * (x_2 - x_1) - p.half_gap) + damper * side * (v_2 - v_1)
        columns = -p.k_1 * (x_1 - place - speed * t) - p.c_1 * (v_1 - speed)
        return [v_1, (columns + side * force) / p.m_1, v_2, -side * force / p.m]

    def event(side, direction):
        def depth(_t, y, *_):
            return side * (y[2] - y[0]) - p.half_gap

        depth.terminal, depth.direction = True, direction
        return depth

    y, side, touches = np.array([0.0, 0.0, -p.half_gap, 0.0]), 0.0, []
    for tick, row in enumerate(segments):
        t, end = 0.0, float(row["duration"])
        while t < end:
            events = [event(side, -1.0)] if side else [event(-1.0, 1.0), event(1.0, 1.0)]
            found = solve_ivp(
                motion, (t, end), y, "DOP853", events=events, args=(side, row["amplitude"], row["growth"]),
                rtol=1e-10, atol=1e-14, max_step=1e-3,
            )  # fmt: skip
            t, y = float(found.t[-1]), found.y[:, -1]
            if found.status == 1:
                left = bool(side)
                side = 0.0 if left else (-1.0 if len(found.t_events[0]) else 1.0)
                if not left:
                    touches.append(tick * 0.01 + t)
    return touches


def test_contacts_under_a_random_base_agree_with_dop853():
    """A base of 3 mm rms, in straight lines from tick to tick: its speed jumps ten times between two touches."""
    config = prescribed(
        drive={"waveform": "random", "amplitude": 3e-3}, contact={"law": "kelvin_voigt"}, shaker={"ramp_s": 0.0}
    )
    segments = new_generator(config).segments(15)
    motion = Simulation(config).advance(segments)
    ours = motion.impacts["tick"] * 0.01 + motion.impacts["offset"]
    theirs = np.array(touches_by_dop853(config, segments))
    assert ours[0] == 0.0, "it lies against the wall at the start"
    assert len(theirs) >= 3
    assert ours[1:] == pytest.approx(theirs, abs=1e-8)
