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
"""Samples of a motion agree with each other and with the laws, wherever they are taken."""

from __future__ import annotations

import numpy as np
import pytest
from kits.mechanics import TWO_PI, at_rest, gauss, rig, sine, sphere_kg, stiffness

from impact_rig.arithmetic.interpolation import NODES
from impact_rig.physics import Motion, Simulation
from impact_rig.physics.event_loop import ROWS_PER_PHASE, new_workspace
from impact_rig.physics.state import CONTACT
from impact_rig.rig.config import RigConfig

SEGMENTS, TICK_S = 60, 0.01
CONFIGS = {
    "current": rig(),
    "prescribed": rig(drive={"kind": "prescribed"}),
    "voltage": rig(drive={"kind": "voltage"}),
    "resting": rig(barriers={"gap_m": 0.5e-3}),
    "kelvin_voigt": rig(contact={"law": "kelvin_voigt", "release": "force"}, barriers={"gap_m": 2e-3}),
    "restitution": rig(contact={"law": "restitution"}, barriers={"gap_m": 1e-3}),
    "friction": rig(sphere={"guide_friction": 0.1}, barriers={"gap_m": 1e-3}),
}
AMPLITUDES = {"current": 2.0, "prescribed": 1e-4, "voltage": 5.0}


@pytest.fixture(scope="module", params=CONFIGS)
def case(request) -> tuple[RigConfig, Motion]:
    config = CONFIGS[request.param]
    simulation = Simulation(config)
    simulation.place(x_1=-4e-3, d_rate=0.1)
    motion = simulation.advance(sine(9.1, AMPLITUDES[config.drive.kind], TICK_S, SEGMENTS))
    assert len(motion.impacts) > 3
    return config, motion


def pieces(motion: Motion, shortest_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Segment, start, end of the smooth pieces that are not shorter than this."""
    segment, offset = motion.breakpoints()
    end = np.append(offset[1:], TICK_S)
    end[:-1][segment[1:] != segment[:-1]] = TICK_S
    kept = end - offset > shortest_s
    return segment[kept], offset[kept], end[kept]


@pytest.mark.parametrize(
    ("position", "speed", "acceleration"), [("x_b", "v_b", "a_b"), ("x_1", "v_1", "a_1"), ("x_2", "v_2", "a_2")]
)
@pytest.mark.repeats
def test_speeds_and_accelerations_are_derivatives(case, position, speed, acceleration):
    """Integrate accelerations to speeds and speeds to positions over every smooth piece."""
    _, motion = case
    segment, begin, end = pieces(motion, 1e-7)
    when, weights = gauss(begin, end)
    where, shape, when = np.repeat(segment, weights.shape[1]), weights.shape, when.ravel()
    inside = 1e-16  # [s]: still this piece, and nothing happens in it
    for function, derivative in ((position, speed), (speed, acceleration)):
        integral = (motion.quantity(derivative, where, when).reshape(shape) * weights).sum(axis=1)
        rise = motion.quantity(function, segment, end - inside) - motion.quantity(function, segment, begin)
        scale = np.abs(motion.quantity(function, where, when)).max()
        worst = np.argmax(np.abs(rise - integral))
        assert abs(rise - integral)[worst] <= 1e-8 * scale, (
            f"{function} rises by {rise[worst]:g}, the integral of {derivative} is {integral[worst]:g}, "
            f"piece of {end[worst] - begin[worst]:g} s"
        )


@pytest.mark.parametrize("name", ["x_b", "v_b", "x_1", "x_2", "current"])
def test_positions_and_speeds_are_continuous(case, name):
    _, motion = case
    segment, offset = motion.breakpoints()
    inner = np.flatnonzero(offset > 0.0)
    before = motion.quantity(name, segment[inner], offset[inner] * (1.0 - 4e-16))
    after = motion.quantity(name, segment[inner], offset[inner])
    scale = np.abs(after).max()
    assert np.abs(after - before).max() <= 1e-8 * scale if scale else not before.any()
    last = motion.quantity(name, np.arange(SEGMENTS - 1), np.full(SEGMENTS - 1, TICK_S * (1 - 1e-15)))
    first = motion.quantity(name, np.arange(1, SEGMENTS), np.zeros(SEGMENTS - 1))
    assert np.abs(last - first).max() <= 1e-8 * scale


def samples(motion: Motion, count: int = 20000) -> np.ndarray:
    """Random instants, and a thousand inside contacts."""
    generator = np.random.default_rng(3)
    segment, begin, end = pieces(motion, 0.0)
    middle = motion.sample(segment, 0.5 * (begin + end))
    touched = np.flatnonzero(middle["force_left"] + middle["force_right"])
    chosen = touched[generator.integers(0, len(touched), 1000)] if len(touched) else touched
    place = generator.uniform(size=len(chosen))
    where = np.append(generator.integers(0, SEGMENTS, count), segment[chosen])
    when = np.append(generator.uniform(0, TICK_S, count), begin[chosen] + place * (end - begin)[chosen])
    return motion.sample(where, when)


@pytest.mark.heavy
def test_forces_obey_newton_and_the_walls(case):
    config, motion = case
    rows = samples(motion)
    force = rows["force_right"] - rows["force_left"]
    if config.contact.law == "restitution" or config.sphere.guide_friction:
        return  # rigid and friction forces are not sampled
    scale = np.abs(force).max()
    assert np.abs(sphere_kg() * rows["a_2"] + force).max() <= 1e-12 * scale
    d, half = rows["x_2"] - rows["x_1"], config.barriers.gap_m / 2.0
    assert not rows["force_right"][d < half * (1.0 - 1e-9)].any()
    assert not rows["force_left"][d > -half * (1.0 - 1e-9)].any()
    assert (rows["force_right"] * rows["force_left"] == 0.0).all()


@pytest.mark.heavy
def test_columns_and_contact_accelerate_the_structure(case):
    config, motion = case
    rows = samples(motion)
    if config.contact.law == "restitution" or config.sphere.guide_friction:
        return
    structure = config.structure
    omega = TWO_PI * structure.natural_frequency_hz
    columns = -(omega**2) * (rows["x_1"] - rows["x_b"]) - 2.0 * structure.damping_ratio * omega * (
        rows["v_1"] - rows["v_b"]
    )
    wanted = columns + (rows["force_right"] - rows["force_left"]) / structure.mass_kg
    assert np.abs(rows["a_1"] - wanted).max() <= 1e-9 * np.abs(wanted).max()


def test_the_force_is_the_law_of_indentation_and_its_rate():
    """Flores: F = K δ^1.5 (1 + a δ'/v0), v0 of this contact."""
    config, simulation = rig(), Simulation(rig())
    simulation.place(x_1=-4e-3, d_rate=0.1)
    motion = simulation.advance(sine(9.1, 2.0, TICK_S, SEGMENTS))
    factor = 8.0 * 0.65 / (5.0 * 0.35)
    for row in motion.impacts[motion.impacts["wall"] == 1][:5]:
        t = row["offset"] + np.linspace(0.05, 0.95, 50) * row["duration"]
        if t[-1] > TICK_S:
            continue
        rows = motion.sample(np.full(50, row["tick"]), t)
        depth = rows["x_2"] - rows["x_1"] - config.barriers.gap_m / 2.0
        rate = rows["v_2"] - rows["v_1"]
        wanted = stiffness() * depth**1.5 * (1.0 + factor * rate / row["approach_speed"])
        assert rows["force_right"] == pytest.approx(wanted, rel=1e-6)


def test_instants_may_have_any_shape(case):
    _, motion = case
    segment, offset = np.meshgrid(np.arange(10, 14), np.linspace(0.0, TICK_S, 5), indexing="ij")
    flat = motion.sample(segment.ravel(), offset.ravel())
    assert flat.shape == (20,)
    sampled = motion.sample(segment, offset)
    assert sampled.shape == motion.quantity("x_1", segment, offset).shape == (4, 5)
    assert sampled.tobytes() == flat.tobytes()
    assert motion.quantities(("x_1", "x_2"), segment, offset).shape == (2, 4, 5)
    assert motion.sample(np.array(11), np.array(0.0)) == motion.sample(np.array([11]), np.array([0.0]))[0]


def test_instants_outside_the_motion_are_rejected():
    simulation = Simulation(rig())
    simulation.advance(sine(9.1, 1.0, TICK_S, 5))
    motion = simulation.advance(sine(9.1, 1.0, TICK_S, 5))
    for wrong in (4, 10):
        with pytest.raises(ValueError, match=f"holds ticks 5 to 9, got {wrong} to {wrong}"):
            motion.quantity("x_1", np.array([wrong]), np.array([0.0]))
    with pytest.raises(ValueError, match="the same shape"):
        motion.quantity("x_1", np.array([5, 6]), np.array([0.0]))


def test_more_names_than_quantities_are_rejected():
    """A motion has scratch memory for each quantity once: more rows would be written outside it."""
    motion, tick, zero = Simulation(rig()).advance(sine(9.1, 1.0, TICK_S, 5)), np.array([1]), np.array([0.0])
    assert motion.quantities(("x_1",) * 12, tick, zero).shape == (12, 1)
    wrong = pytest.raises(ValueError, match="at most 12 names are allowed, got 13")
    with wrong:
        motion.quantities(("x_1",) * 13, tick, zero)
    with wrong:
        motion.polynomials(("x_1",) * 13, tick, zero, zero + TICK_S)


def test_an_unknown_quantity_is_rejected_by_its_name():
    motion, tick, zero = Simulation(rig()).advance(sine(9.1, 1.0, TICK_S, 5)), np.array([1]), np.array([0.0])
    with pytest.raises(ValueError, match="'time' is no quantity of a motion; known: x_b, x_1"):
        motion.quantities(("x_1", "time"), tick, zero)


def test_times_of_another_number_of_pieces_are_rejected():
    """The compiled loop reads one start and one end for each tick: fewer would be read beyond their memory."""
    motion = Simulation(rig()).advance(sine(9.1, 1.0, TICK_S, 5))
    tick, zero = np.array([1, 2]), np.zeros(2)
    assert motion.polynomials(("x_1",), tick, zero, zero + TICK_S).shape == (1, 2, NODES)
    for start, end in ((zero[:1], zero + TICK_S), (zero, zero[:1] + TICK_S), (zero.reshape(1, 2), zero + TICK_S)):
        with pytest.raises(ValueError, match=r"one shape \(n,\)"):
            motion.polynomials(("x_1",), tick, start, end)


def test_motions_of_one_simulation_are_independent():
    """They share their scratch memory, so alternate queries must return the same as separate ones."""
    simulation = Simulation(CONFIGS["current"])
    simulation.place(x_1=-4e-3, d_rate=0.1)
    drive = sine(9.1, AMPLITUDES["current"], TICK_S, 2 * SEGMENTS)
    first, second = simulation.advance(drive[:SEGMENTS]), simulation.advance(drive[SEGMENTS:])
    offset = np.linspace(0.0, TICK_S, 50, endpoint=False)

    def sampled(motion: Motion, k: int) -> np.ndarray:
        return motion.sample(np.full(50, motion.first_tick + k), offset)

    alone = [np.concatenate([sampled(motion, k) for k in range(SEGMENTS)]) for motion in (first, second)]
    in_turn = [(sampled(first, k), sampled(second, k)) for k in range(SEGMENTS)]
    for one, both in zip(alone, zip(*in_turn, strict=True), strict=True):
        assert np.concatenate(both).tobytes() == one.tobytes()


def test_a_full_log_at_a_touch_on_the_start_of_a_tick_changes_nothing():
    """The sphere crosses half the gap in a tick: it touches 0 s into the next one, which begins with two states."""
    motions = []
    for rows in (10 * ROWS_PER_PHASE, ROWS_PER_PHASE + 1):
        simulation = Simulation(rig(barriers={"gap_m": 6e-3}))
        simulation._work = new_workspace(rows, 16)
        simulation.place(d_rate=3e-3 / TICK_S)
        motions.append(simulation.advance(sine(9.1, 0.0, TICK_S, 2)))
    (touch,) = motions[0].impacts
    assert (touch["tick"], touch["offset"]) == (1, 0.0)
    tick, offset = np.repeat([0, 1], 50), np.tile(np.linspace(0.0, TICK_S, 50, endpoint=False), 2)
    ample, full = (motion.sample(tick, offset) for motion in motions)
    assert np.array_equal(ample, full)
    assert np.abs(ample["x_2"][:50] - 0.3 * offset[:50]).max() <= 1e-15


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("changes", "left_out"),
    [
        ({}, 1e-7),
        ({"drive": {"kind": "prescribed"}}, 1e-7),
        ({"drive": {"kind": "voltage"}}, 1e-7),
        ({"sphere": {"present": False}}, 1e-7),
        ({"barriers": {"gap_m": 0.5e-3}}, 4e-6),  # long steps of a sphere that rests: (ω τ)² / 24 of the force's bend
        ({"contact": {"law": "restitution"}, "barriers": {"gap_m": 1e-3}}, 1e-7),
        ({"contact": {"law": "walton_braun"}, "barriers": {"gap_m": 1e-3}}, 1e-7),
        ({"sphere": {"guide_friction": 0.1}, "barriers": {"gap_m": 1e-3}}, 4e-6),
        ({"sphere": {"guide_friction": 0.5}, "barriers": {"gap_m": 10e-3}}, 1e-7),
    ],
    ids=str,
)
@pytest.mark.parametrize("phase", [0.0, 1.0])
def test_fundamentals_of_cycles_are_those_of_the_samples(changes, left_out, phase):
    """The sums leave out less than 1e-7 in every phase of the motion, under a growing drive and a steady one."""
    config, cycles, many = rig(**changes), 20, 1 << 14
    simulation, frequency_hz = Simulation(config), 9.1
    simulation.place(x_1=-1e-3, d_rate=0.1)
    segments = sine(frequency_hz, AMPLITUDES[config.drive.kind] / 4, 1.0 / frequency_hz, cycles)
    segments["phase"] = phase
    segments["growth"][:2] = segments["amplitude"][0] * frequency_hz / 2.0
    motion = simulation.advance(segments)
    turn = (np.arange(many) + 0.5) / many
    tick = np.repeat(np.arange(cycles), many)
    samples = motion.quantities(("x_b", "x_1"), tick, np.tile(turn / frequency_hz, cycles)).reshape(2, cycles, many)
    sums = samples @ (2j / many * np.exp(-1j * TWO_PI * turn))
    found = motion.cycles()
    for name, wanted in zip(("x_b", "x_1"), sums, strict=True):
        assert np.abs(found[name] - wanted).max() <= left_out * np.abs(wanted).mean(), name
    if config.sphere.present:
        places = motion.quantities(("x_2", "v_2"), np.arange(cycles), np.zeros(cycles))
        assert np.abs(found["x_2"] - places[0]).max() <= 1e-12
        assert np.abs(found["v_2"] - places[1]).max() <= 1e-9


@pytest.mark.parametrize("turns", [0.5, 1.001, 2.0])
def test_an_incomplete_cycle_has_no_fundamental(turns):
    motion = Simulation(rig()).advance(sine(9.1, 0.5, turns / 9.1, 3))
    with pytest.raises(ValueError, match="one complete cycle"):
        motion.cycles()


@pytest.mark.parametrize("law", ["kelvin_voigt", "walton_braun"])
def test_a_step_of_a_contact_is_one_polynomial_to_a_millionth(law):
    """A solution for the time that is already exact must be used; otherwise, a hundredth of the peak would be wrong."""
    config = rig(contact={"law": law}, sphere={"start": "centre"}, barriers={"gap_m": 6e-3})
    motion = Simulation(config).advance(sine(9.1, 2.0, 0.01, 100))
    tick, offset = motion.breakpoints()
    inside = (tick[1:] == tick[:-1]) & (np.diff(offset) > 1e-9)
    tick, begin, end = tick[:-1][inside], offset[:-1][inside], offset[1:][inside]
    middle, half = 0.5 * (begin + end), 0.5 * (end - begin)
    touching = motion.quantity("force_left", tick, middle) + motion.quantity("force_right", tick, middle) > 0.0
    tick, begin, end, middle, half = (values[touching] for values in (tick, begin, end, middle, half))
    assert len(tick) > 300
    pieces = motion.polynomials(("a_1",), tick, begin, end)[0]
    for x in np.linspace(-0.95, 0.95, 7):
        exact = motion.quantity("a_1", tick, middle + half * x)
        fitted = (pieces * x ** np.arange(pieces.shape[1])).sum(axis=1)
        assert np.abs(fitted - exact).max() < 1e-6 * np.abs(exact).max()


def test_a_step_of_a_contact_that_ends_with_the_segment_loses_no_time():
    """An end within the resolution of events must count as a pause: the contact must lose no time, and continue."""
    config = rig(drive={"kind": "prescribed"}, contact={"law": "kelvin_voigt"})

    def moved(*durations_s):
        simulation = Simulation(config)
        simulation.place(x_1=1e-3, d=0.0029, d_rate=0.5)
        return simulation.advance(np.concatenate([at_rest(duration_s) for duration_s in durations_s]))

    whole = moved(1e-3)
    history = whole._trajectory.history
    steps = history["t"][(history["phase"] == CONTACT) & (history["t"] > 0.0)]
    assert len(steps) > 5
    expected = whole.sample(np.array([0]), np.array([0.9e-3]))
    for end_s in steps[1:].tolist():
        for first_s in (end_s, end_s * (1.0 - 2e-16), end_s * (1.0 - 1e-13), end_s * (1.0 + 2e-16)):
            found = moved(first_s, 1e-3 - first_s).sample(np.array([1]), np.array([0.9e-3 - first_s]))
            assert found["x_2"] == pytest.approx(expected["x_2"], abs=1e-11)
