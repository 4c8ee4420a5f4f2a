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
"""Dynamics of the model, compared with closed forms, published limits, marching over a map, and a rig over ROS."""

from __future__ import annotations

import csv
import json
import math
import re
from pathlib import Path
from xml.etree import ElementTree as ET

import attrs
import numpy as np
import pytest
from kits.masri_caughey import STABLE, UNSTABLE, orbit
from kits.mechanics import TWO_PI, limit_case, sine
from scipy.optimize import brentq

from impact_rig.cli.main import main
from impact_rig.drawing import legend_outside, new_axes, style
from impact_rig.errors import ConfigError, SimulationError
from impact_rig.physics import Simulation
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies.dynamics import orbits, plan
from impact_rig_studies.dynamics.stroboscope import Place, Stroboscope, at
from impact_rig_studies.maps import exponent
from impact_rig_studies.maps.measure import NOTHING, MapRig, Settings
from impact_rig_studies.prediction import LinearRig
from qualification.prediction import job
from qualification.regimes import judged

pytestmark = pytest.mark.heavy

PLACE = Place(RigConfig(), 9.1, 0.52)


def study(folder: Path, kind: str, text: str) -> list[dict[str, object]]:
    """Return the rows of a study by name."""
    path = folder / "study.yaml"
    path.write_text(text)
    found = plan.load(path, kind)
    return [
        dict(zip(plan.COLUMNS[kind], row, strict=True)) for task in found.tasks for row in task.read(plan.run(task))
    ]


# Maps with known answers


def standard(z: np.ndarray, e: float, gamma: float) -> np.ndarray:
    """Return Holmes's map of a ball that bounces high: (phase of the impact, speed after it / speed of the table)."""
    phase = z[0] + z[1]
    return np.array([phase, e * z[1] - gamma * math.cos(phase)])


def test_the_period_of_a_high_bouncing_ball_doubles_where_holmes_predicts():
    """P. J. Holmes (1982), J. Sound Vib. 84, 173–189: the orbit of one bounce in n periods is stable for

    2πn (1 − e) < γ < 2 √(π²n² (1 − e)² + (1 + e)²): from a fold to a flip.
    """
    e, n = 0.8, 1
    turns = np.array([TWO_PI * n, 0.0])

    def ball(z: np.ndarray, gamma: float) -> np.ndarray:
        return standard(z, e, gamma) - turns

    fold, flip = TWO_PI * n * (1.0 - e), 2.0 * math.hypot(math.pi * n * (1.0 - e), 1.0 + e)
    gamma = 1.5
    start = orbits.orbit(ball, np.array([-math.acos(-fold / gamma), TWO_PI * n]) + 0.01, gamma)
    assert start is not None
    assert start.stable
    arcs = [orbits.followed(ball, start, way, (0.5, 5.0)) for way in (-1.0, 1.0)]
    found = {change.kind: change.orbit.p for arc in arcs for change in arc.changes}
    assert found["fold"] == pytest.approx(fold, rel=1e-8)
    assert found["flip"] == pytest.approx(flip, rel=1e-8)
    assert {one.kind for one in arcs[0].orbits} == {"stable", "fold"}
    assert arcs[1].orbits[-1].kind == "flip"


@pytest.mark.parametrize("aside", [0.09, 0.12, 0.15])
def test_an_orbit_found_in_the_last_round_of_newton_is_accepted(aside):
    """At a fold, Newton's method halves the distance in each round, and needs all rounds from a short distance.

    The result of the last round must be checked as well, and not thrown away.
    """

    def touching(z: np.ndarray, _p: float) -> np.ndarray:
        return z - z * z

    assert aside**2 / 4.0**orbits.ROUNDS < orbits.TOLERANCE < aside**2 / 4.0 ** (orbits.ROUNDS - 1)
    found = orbits.orbit(touching, np.array([aside]), 0.0)
    assert found is not None
    assert found.residual < orbits.TOLERANCE


@pytest.mark.parametrize("moves", [0, 1, 3])
def test_a_branch_that_meets_itself_is_closed_in_any_coordinates(moves):
    """The branch is a circle, whose coordinates are shifted along the way.

    The first orbit must be shifted as well; otherwise, it is never met again, and the branch continues forever.
    """
    shift = 0.0

    def circle(z: np.ndarray, p: float) -> np.ndarray:
        return z - 0.3 * ((z - shift) ** 2 + p * p - 1.0)

    def moved(points: list[tuple[np.ndarray, float]]) -> list[np.ndarray] | None:
        nonlocal moves, shift
        if not moves:
            return None
        moves, shift = moves - 1, shift + 0.7
        return [z + 0.7 for z, _ in points]

    start = orbits.orbit(circle, np.array([0.9]), 0.3)
    arc = orbits.followed(circle, start, 1.0, (-2.0, 2.0), moved=moved)
    assert arc.end == "closed"
    assert [(change.kind, round(change.orbit.p, 6)) for change in arc.changes] == [("fold", 1.0), ("fold", -1.0)]


@pytest.mark.parametrize("beyond", [1e-4, 0.02, 0.1])
def test_a_change_of_stability_in_the_last_step_of_a_branch_is_reported(beyond):
    """The logistic map flips at 3, in the last step up to the end of the range or before it.

    A change of stability in the last step must be reported, although this step also reaches the end.
    """

    def logistic(z: np.ndarray, p: float) -> np.ndarray:
        return p * z * (1.0 - z)

    start = orbits.orbit(logistic, np.array([0.6]), 2.5)
    assert start is not None
    arc = orbits.followed(logistic, start, 1.0, (2.0, 3.0 + beyond))
    assert (arc.end, arc.orbits[-1].p, arc.orbits[-1].stable) == ("edge", 3.0 + beyond, False)
    assert [(change.kind, round(change.orbit.p, 8)) for change in arc.changes] == [("flip", 3.0)]


@attrs.frozen
class Bouncer:
    """A ball on a table under gravity, made from the rig: g is a slow acceleration of a soft structure.

    Columns with a thousandth of the frequency are far from their rest position, so the superior base is accelerated by
    g, and also moves with the amplitude of the base. The two coordinates are height above the left wall, and its rate.

    Attributes:
        e: restitution.
        gamma: largest acceleration of the table, divided by g.
    """

    e: float
    gamma: float
    omega = TWO_PI * 100.0
    amplitude = 1e-3
    soft = 1e-3

    def __call__(self, z: np.ndarray, returns: int = 1) -> np.ndarray:
        g, omega_n = self.amplitude * self.omega**2 / self.gamma, self.soft * self.omega
        shape = 1.0 - 1.0 / self.soft**2
        config = limit_case(
            drive={"kind": "prescribed"}, contact={"law": "restitution", "restitution": self.e},
            structure={"mass_kg": 1e6, "natural_frequency_hz": omega_n / TWO_PI, "damping_ratio": 1e-12},
            barriers={"gap_m": 20.0},
        )  # fmt: skip
        simulation, state = Simulation(config), np.asarray(z) * [1.0, self.omega] * self.amplitude
        segment = sine(self.omega / TWO_PI, -self.amplitude * shape, TWO_PI / self.omega)
        for _ in range(returns):  # the structure begins each cycle where it did: its own motion is left out
            whole = np.zeros(7)
            whole[:2] = -g / omega_n**2, -self.amplitude * self.omega
            whole[5:] = state[0] - 10.0, state[1]
            simulation.set_state(whole)
            simulation.advance(segment)
            after = simulation.state()
            if after is None:
                return np.full(2, math.nan)
            state = np.array([after[5] + 10.0, after[6]])
        return state / [self.amplitude, self.amplitude * self.omega]


def bounced(e: float, gamma: float) -> np.ndarray:
    """Return height and rate, relative to those of the table, at phase 0 of the orbit with one bounce per period."""
    g, cosine = 1.0 / gamma, math.pi * (1.0 - e) / ((1.0 + e) * gamma)
    phase = -math.acos(-cosine) % TWO_PI  # the table moves as −sin: up where its cosine is negative
    late = TWO_PI - phase  # from the impact to phase 0
    height = -math.sin(phase) + math.pi * g * late - 0.5 * g * late**2
    return np.array([height, math.pi * g - g * late + 1.0])


GAMMA_0 = math.pi * (1.0 - 0.5) / (1.0 + 0.5)


def test_the_rig_as_a_bouncing_ball_doubles_its_period_where_luck_and_mehta_predict():
    """J. M. Luck & A. Mehta (1993), Phys. Rev. E 48, 3988: from Γ_0 = π(1 − e)/(1 + e) to

    Γ² = Γ_0² + [2(1 + e²)/(1 + e)²]², exactly, for one bounce a period.
    """
    e = 0.5
    wanted = math.hypot(GAMMA_0, 2.0 * (1.0 + e * e) / (1.0 + e) ** 2)

    def ball(z: np.ndarray, gamma: float) -> np.ndarray:
        return Bouncer(e, gamma)(z)

    start = orbits.orbit(ball, bounced(e, 1.2), 1.2)
    assert start is not None
    assert start.stable
    arc = orbits.followed(ball, start, 1.0, (1.0, 1.8), longest=0.2)
    (flip,) = [change.orbit for change in arc.changes if change.kind == "flip"]
    assert flip.p == pytest.approx(wanted, rel=1e-4)
    assert np.prod(flip.multipliers).real == pytest.approx(e * e, rel=2e-3)  # each bounce takes so much of an area


def test_the_second_period_doubling_of_a_bouncing_ball_agrees_with_a_diagram():
    """Tufillaro, Abbott & Reilly (1992), An Experimental Approach to Nonlinear Dynamics and Chaos, Fig. 1.16.

    Two bounces in two periods exist up to an amplitude of 0.0115 cm. The ball keeps half of its speed, and the table
    moves with 60 Hz: this follows from other figures of the authors, as the text near the diagram states neither. The
    exact map from impact to impact, solved without the rig, doubles its period at Γ = 1.6671307.
    """
    e, g, omega = 0.5, 9.81, TWO_PI * 60.0

    def twice(z: np.ndarray, gamma: float) -> np.ndarray:
        return Bouncer(e, gamma)(z, 2)

    start = orbits.orbit(twice, Bouncer(e, 1.6)(bounced(e, 1.5), 200), 1.6)
    assert start is not None
    assert start.stable
    assert np.abs(Bouncer(e, 1.6)(start.z) - start.z).max() > 0.1  # it repeats after two periods, not after one
    arc = orbits.followed(twice, start, 1.0, (1.5, 1.75), longest=0.05)
    (flip,) = [change.orbit.p for change in arc.changes if change.kind == "flip"]
    assert flip == pytest.approx(1.6671307, rel=1e-4)
    assert flip * g / omega**2 == pytest.approx(0.0115e-2, rel=5e-3)


def impact_map_exponent(e: float, gamma: float, bounces: int) -> float:
    """Return the largest exponent per period from the exact impact map and its derivative, without the rig."""
    g, t, v = 1.0 / gamma, 0.0, math.pi / gamma
    vector, total, begin = np.array([1.0, 0.3]), 0.0, 0.0
    for number in range(bounces):
        if number == bounces // 10:
            total, begin = 0.0, t

        def above(tau: float, t: float = t, v: float = v) -> float:
            return math.sin(t) + v * tau - 0.5 * g * tau * tau - math.sin(t + tau)

        grid = np.geomspace(1e-7, 2.0 * abs(v) / g + 2.0 * math.sqrt(1.0 / g) + 1.0, 4000)
        first = int(np.argmax(np.array([above(x) for x in grid]) < 0.0))
        tau = brentq(above, grid[max(first - 1, 0)], grid[first], xtol=1e-14)
        later, before = t + tau, v - g * tau
        dt = -np.array([math.cos(t) - v + g * tau, tau]) / (before - math.cos(later))
        dv = -(1.0 + e) * math.sin(later) * dt - e * (np.array([0.0, 1.0]) - g * (dt - np.array([1.0, 0.0])))
        vector = np.array([dt @ vector, dv @ vector])
        size = float(np.linalg.norm(vector))
        total, vector = total + math.log(size), vector / size
        t, v = later, (1.0 + e) * math.cos(later) - e * before
    return total / ((t - begin) / TWO_PI)


def test_the_exponents_of_a_bouncing_ball_are_the_closed_form():
    """The exponent is ln e if the multipliers are a complex pair: the area shrinks by e² per bounce."""
    e, gamma = 0.5, 1.2
    found = exponent.largest(Bouncer(e, gamma), bounced(e, gamma), returns=60, windows=6)
    assert found.value == pytest.approx(math.log(e), abs=5e-3)


def test_the_sign_of_an_exponent_is_certain_early_only_if_it_is_clear():
    """With the exponent zero, a sign after fewer than 16 windows is wrong: less than 1 % of the motions have one."""
    rng, early = np.random.default_rng(3), 0
    for _ in range(4000):
        windows = iter(rng.standard_normal(64).tolist())
        early += exponent.sign(windows) != 0 and len([*windows]) > 64 - 16
    assert early < 40
    for mean in (-2.0, 2.0):
        windows = iter(rng.normal(mean, 0.3, 64).tolist())
        assert exponent.sign(windows) == np.sign(mean)
        assert len([*windows]) >= 64 - 9, "no more windows are simulated than needed"
    assert exponent.sign([1.0, math.nan]) == 0


@pytest.mark.slow
def test_the_exponent_of_a_chaotic_bouncing_ball_agrees_with_its_impact_map():
    e, gamma = 0.9, 1.6  # no flight becomes so short that chatter begins
    ball = Bouncer(e, gamma)
    found = exponent.largest(ball, ball(np.array([5.0, 1.0]), 100), returns=150, windows=12)
    assert found.value == pytest.approx(impact_map_exponent(e, gamma, 1500), abs=4.0 * found.uncertainty)
    assert found.value > 5.0 * found.uncertainty


# Two symmetric impacts per cycle


@pytest.mark.parametrize("case", [*STABLE, UNSTABLE])
def test_orbits_multipliers_and_limits_of_masri_and_caughey_are_reproduced(case):
    o, config = orbit(case), case.config()
    place, unit = Place(config, o.omega / TWO_PI, o.base_m), config.barriers.gap_m
    strobe = Stroboscope(place, "gap_m", unit)
    strobe.turn = (o.drive_phase / TWO_PI + 0.1) % 1.0
    strobe.scale = np.array([1.0, o.omega, 1.0, o.omega]) * 2e-3
    simulation = Simulation(config)
    simulation.place(x_1=o.x, v_1=o.after, d=config.barriers.gap_m / 2.0, d_rate=-o.speed - o.after)
    simulation.advance(sine(o.omega / TWO_PI, o.base_m, 0.1 * TWO_PI / o.omega, phase=o.drive_phase))
    z = simulation.state()[[0, 1, 5, 6]] / strobe.scale
    found = orbits.orbit(strobe, z, 1.0)
    assert found is not None
    assert np.abs(found.z - z).max() < 1e-8
    assert abs(found.multipliers[0]) == pytest.approx(case.radius**2, abs=2e-3 * case.radius)
    assert found.stable == (case in STABLE)
    if case.gap > 1.0:
        arc = orbits.followed(strobe, found, 1.0, (0.5, 50.0), moved=strobe.moved)
        (fold,) = [change.orbit.p for change in arc.changes if change.kind == "fold"]
        assert fold * unit == pytest.approx(o.widest_gap_m, rel=1e-6)


@pytest.fixture(scope="module")
def over_gap(tmp_path_factory) -> list[dict[str, object]]:
    """Return the motion with two impacts per cycle at 9.1 Hz, over the gap, through its fold."""
    text = "continue: {over: gap_m, from: 0.002, to: 0.036, at: [0.028], points: 120}"
    return study(tmp_path_factory.mktemp("gap"), "continue", text)


def event(rows, name):
    return next(row for row in rows if row["event"] == name)


def test_both_branches_lie_on_the_slow_invariant_manifold(over_gap):
    """Loss factor of the damper compared with (m/m_1)(8/π²) ρΘ²/ξ², on the stable and the unstable side of the fold."""
    rig = LinearRig.of(RigConfig())
    sphere, m_1 = rig.sphere_kg, RigConfig().structure.mass_kg
    seen = set()
    for row in over_gap:
        xi = 2.0 * row["superior_m"] / row["value"]
        both = rig.manifold.kappa**2 + rig.manifold.rho**2
        square = both * xi**2 - rig.manifold.rho**2
        if row["event"] != "orbit" or square < 0.0 or row["impacts_per_cycle"] != 2.0:
            continue
        theta = (rig.manifold.kappa + np.array([1.0, -1.0]) * math.sqrt(square)) / both
        losses = -rig.manifold.force(theta).imag * sphere / m_1
        side = int(np.argmin(np.abs(losses - row["dt_loss_factor"])))
        if abs(xi / rig.manifold.xi(rig.manifold.theta_fold) - 1.0) > 0.05:  # not at the fold, where all changes fast
            assert row["dt_loss_factor"] == pytest.approx(losses[side], rel=0.02)
            seen.add((side, bool(row["stable"])))
    assert seen == {(0, True), (0, False), (1, False)}
    widest = 2.0 * event(over_gap, "fold")["superior_m"] * rig.manifold.gap_per_amplitude_at_fold / 2.0
    assert event(over_gap, "fold")["value"] == pytest.approx(widest, rel=0.02)


@pytest.mark.parametrize(
    ("friction", "gap_m"), [(2.0, 0.006), (0.3, 0.1), (0.05, 0.2)], ids=["held", "held and sliding", "sliding"]
)
def test_the_orbit_of_a_sphere_without_impacts_agrees_with_the_settled_motion(friction, gap_m, tmp_path):
    """Without impacts the sphere is still not free: at rest on the structure it adds mass, and sliding it adds damping.

    A motion without impacts must not be taken for that of a free sphere, which rests.
    """
    rig = f"set: {{sphere.guide_friction: {friction}, barriers.gap_m: {gap_m}}}\n"
    measure = "measure: {settle_tolerance: 1.0e-6, settle_cycles: 2000}\n"
    (one,) = study(tmp_path, "orbit", f"{rig}{measure}orbit: {{}}")
    settled = study(tmp_path, "bifurcation", f"{rig}{measure}bifurcation: {{over: frequency_hz, values: 9.1}}")[0]
    assert (one["impacts_per_cycle"], one["event"]) == (0.0, "stable")
    assert one["dt"] == pytest.approx(settled["dt"], rel=1e-6)
    assert one["loss_factor"] == pytest.approx(one["dt_loss_factor"], rel=1e-5, abs=1e-12)
    assert abs(one["imbalance_j"]) < 1e-9 * one["work_j"]


def test_the_energy_per_cycle_closes_and_yields_the_loss_factor_of_dt(over_gap):
    for row in over_gap:
        assert abs(row["imbalance_j"]) <= 1e-8 * row["work_j"]
        assert row["loss_factor"] == pytest.approx(row["dt_loss_factor"], rel=1e-3)


def marched(place: Place, over: str, values: np.ndarray) -> float:
    """Return the last value at which a motion, continued from value to value, repeats with this number of impacts."""
    rig: MapRig | None = None
    for value in values.tolist():
        here = plan.at(place, over, value)
        rig = rig or MapRig(here.config, Settings(settle_cycles=2400))
        rig.carry(here.config)
        reading = rig.measure(here.frequency_hz, here.amplitude)
        kind = reading.period, reading.impacts_per_cycle
        if value == values[0]:
            first = kind
        elif kind != first:
            break
        last = value
    return last


@pytest.mark.parametrize(("over", "value"), [("frequency_hz", 0.0), ("frequency_hz", 2e4), ("current_a", -0.1)])
def test_a_drive_out_of_range_is_rejected_as_a_parameter(over, value):
    with pytest.raises(ConfigError, match=f"{over} must be > 0"):
        at(Place(RigConfig(), 9.1, 0.52), over, value)


def test_a_section_of_a_motion_that_cannot_be_resolved_is_empty(tmp_path, monkeypatch):
    """It must not be the section of the first cycles after a reset of the rig."""
    real, calls = Simulation.advance, []

    def fail_first(self: Simulation, segments: np.ndarray) -> object:
        calls.append(len(segments))
        if len(calls) == 1:
            raise SimulationError("stuck")
        return real(self, segments)

    monkeypatch.setattr(Simulation, "advance", fail_first)
    assert study(tmp_path, "section", "section: {cycles: 3}") == []
    assert len(calls) == 1


TAKEN_ALONG = 1
"""Cycles that are asked for at once after a motion that repeats in each cycle has settled."""


@pytest.fixture
def stuck(monkeypatch):
    """Make the rig's first run of this number of cycles fail."""

    def fail_once(cycles: int) -> None:
        real, left = MapRig.run_cycles, [cycles]

        def run_cycles(self: MapRig, frequency_hz: float, amplitude: float, count: int) -> object:
            if count in left:
                left.remove(count)
                raise SimulationError("stuck")
            return real(self, frequency_hz, amplitude, count)

        monkeypatch.setattr(MapRig, "run_cycles", run_cycles)

    return fail_once


def test_an_unresolvable_value_of_a_diagram_is_marked_and_the_others_continue(stuck, tmp_path, capsys):
    """The error of one value must not end the diagram."""
    stuck(TAKEN_ALONG)
    path = tmp_path / "study.yaml"
    path.write_text("bifurcation: {over: gap_m, values: [0.011, 0.0115, 0.012], direction: up}")
    assert main(["dynamics", "bifurcation", str(path), "--output", str(tmp_path / "out"), "--no-figures"]) == 0
    rows = list(csv.DictReader((tmp_path / "out" / "bifurcation.csv").read_text().splitlines()))
    assert [(row["gap_m"], row["regime"]) for row in rows] == [
        ("0.011", "failed"), ("0.0115", "periodic"), ("0.012", "periodic"),
    ]  # fmt: skip
    assert json.loads((tmp_path / "out" / "bifurcation.json").read_text())["failed_rows"] == 1
    assert "1 of 3 rows have no result" in capsys.readouterr().out


def test_an_unresolvable_start_of_a_basin_is_marked_and_the_others_continue(tmp_path, monkeypatch):
    """The error of one start must not end the basin."""
    path = tmp_path / "study.yaml"
    path.write_text("basin: {sphere_position_m: [-0.002, 0.001, 0.002], sphere_speed_m_s: 0.5}")
    found = plan.load(path, "basin")
    real, starts = MapRig.run_cycles, []
    monkeypatch.setattr(
        MapRig, "reset", lambda self, sphere, reset=MapRig.reset: (starts.append(sphere), reset(self, sphere))
    )

    def run_cycles(self: MapRig, *asked: float) -> object:
        if starts[-1][0] == 0.001:
            raise SimulationError("stuck")
        return real(self, *asked)

    monkeypatch.setattr(MapRig, "run_cycles", run_cycles)
    (task,) = found.tasks
    regimes = {row[0]: row[3] for row in task.read(plan.run(task))}
    assert regimes == {-0.002: "periodic", 0.001: "failed", 0.002: "periodic"}


def test_a_start_without_an_attractor_does_not_affect_the_others(stuck, tmp_path):
    """A start without an attractor must not prevent the plan of the basin."""
    stuck(TAKEN_ALONG)
    rows = study(tmp_path, "basin", "basin: {sphere_position_m: [-0.002, 0.002], sphere_speed_m_s: 0.5}")
    assert [(row["attractor"], row["regime"]) for row in rows] == [(0.0, "periodic")] * 2


@pytest.mark.parametrize(("kind", "words"), [("section", []), ("orbit", ["no orbit: stuck"]), ("exponent", ["failed"])])
def test_an_unresolvable_motion_does_not_affect_the_other_tasks(kind, words, stuck, tmp_path):
    """The error of one motion must not end the study."""
    stuck(TAKEN_ALONG)
    text = {"section": "{cycles: 1}", "orbit": "{starts: left}", "exponent": "{starts: left, cycles: 10, windows: 4}"}
    assert [row.get("regime", row.get("event")) for row in study(tmp_path, kind, f"{kind}: {text[kind]}")] == words


ABSENT = {
    "orbit": (
        "set: {barriers.gap_m: 0.032}\norbit: {starts: [left, centre]}",
        "no orbit from left: the motion does not repeat: it is chaotic",
    ),
    "continue": (
        "continue: {over: gap_m, from: 0.007, to: 0.022, at: [0.008, 0.020], points: 3}",
        "no orbit from gap_m 0.008, left: the motion does not repeat: it is chaotic",
    ),
    "section": ("section: {starts: [left, centre], cycles: 3}", "no section from left: the motion cannot be simulated"),
}
"""Two starts, of which the first gives no result."""


@pytest.mark.parametrize("kind", ABSENT)
def test_a_start_without_an_orbit_or_a_section_is_reported_and_not_in_the_legend(kind, tmp_path, capsys, monkeypatch):
    """Such a start must not be missing from the rows without a message, nor have an entry in the legend."""
    text, line = ABSENT[kind]
    if kind == "section":
        real, calls = MapRig.measure, []

        def fail_first(self: MapRig, *asked: float) -> object:
            calls.append(asked)
            return NOTHING if len(calls) == 1 else real(self, *asked)

        monkeypatch.setattr(MapRig, "measure", fail_first)
    (tmp_path / "study.yaml").write_text(text)
    out = tmp_path / "out"
    assert main(["dynamics", kind, str(tmp_path / "study.yaml"), "--workers", "1", "--output", str(out)]) == 0
    assert capsys.readouterr().out.splitlines().count(line) == 1
    assert json.loads((out / f"{kind}.json").read_text())["without_results"] == [line]
    drawing = ET.fromstring((out / "figures" / f"dynamics_{kind}.svg").read_text())
    shown = ["".join(text.itertext()) for text in drawing.iter("{http://www.w3.org/2000/svg}text")]
    absent = line.split(" from ")[1].split(":")[0]
    assert absent not in shown
    assert {"centre", "gap_m 0.02, left"} & {*shown}


def test_a_study_with_only_chaotic_starts_has_no_result(tmp_path, capsys):
    (tmp_path / "study.yaml").write_text("set: {barriers.gap_m: 0.008}\norbit: {}")
    assert main(["dynamics", "orbit", str(tmp_path / "study.yaml"), "--output", str(tmp_path / "out")]) == 1
    assert "no orbit from left: the motion does not repeat: it is chaotic" in capsys.readouterr().out


def test_a_section_without_points_is_not_taken_for_a_missing_one(tmp_path, monkeypatch):
    monkeypatch.setattr(MapRig, "measure", lambda *_: NOTHING)
    (tmp_path / "study.yaml").write_text("section: {cycles: 1}")
    words = ["dynamics", "section", str(tmp_path / "study.yaml"), "--workers", "1", "--no-figures"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 1
    with pytest.raises(ConfigError, match="has no points, because no start so far gave a motion that can be simul"):
        plan.open_study(tmp_path / "out", "section")


@pytest.mark.parametrize("kind", ["orbit", "continue", "exponent"])
def test_the_printed_table_and_the_data_contain_start_and_branch(kind, tmp_path, capsys):
    (tmp_path / "small.yaml").write_text(SMALL)
    words = ["dynamics", kind, str(tmp_path / "small.yaml"), "--workers", "1", "--no-figures"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 0
    printed = capsys.readouterr().out
    found = json.loads((tmp_path / "out" / f"{kind}.json").read_text())["found"]
    columns = ["start", "branch"] if kind == "continue" else ["start"]
    for column in columns:
        assert column in printed
    assert list(found[0])[: len(columns)] == columns
    for row in found:
        assert any(line.split()[: len(columns)] == [str(row[one]) for one in columns] for line in printed.splitlines())


def test_the_shares_of_a_basin_have_an_interval_within_0_and_1(tmp_path, capsys):
    """The interval of a normal distribution would reach below 0 for rare motions, and be empty for a share of 1."""
    text = "set: {barriers.gap_m: 0.020}\nbasin: {sphere_position_m: [-0.009, 0.0], sphere_speed_m_s: "
    for speeds, shares in (("[0.0, 0.4, 0.5]}", 2), ("[0.4]}", 1)):
        (tmp_path / "study.yaml").write_text(text + speeds)
        words = ["dynamics", "basin", str(tmp_path / "study.yaml"), "--workers", "1", "--no-figures"]
        assert main([*words, "--output", str(tmp_path / str(shares))]) == 0
        printed = " ".join(capsys.readouterr().out.split())
        found = json.loads((tmp_path / str(shares) / "basin.json").read_text())
        assert len(found["shares"]) == shares
        total = found["rows"]
        for name, share in found["shares"].items():
            low, high = found["shares_95_percent"][name]
            z = 1.959963984540054  # Wilson (1927): |share - p| = z sqrt(p (1 - p) / n) at both ends
            for p in (low, high):
                assert (share - p) ** 2 == pytest.approx(z * z * p * (1.0 - p) / total, abs=1e-12)
            assert 0.0 <= low < high <= 1.0
            assert low <= share <= high
            assert f"lead to: {name} (95 % interval {100.0 * low:.2f} to {100.0 * high:.2f} %)" in printed


@pytest.mark.parametrize(
    ("way", "limits", "kinds"), [(-1.0, (11.0, 31.0), {"symmetry"}), (1.0, (11.0, 31.0), {"torus", "fold"})]
)
def test_an_unstable_orbit_is_named_after_the_bifurcation_that_it_comes_from(way, limits, kinds):
    """The symmetric motion has a multiplier > 1 below 12.21 mm and beyond its fold: only the latter is a fold."""
    rig = MapRig(from_flat(RigConfig(), {"barriers.gap_m": 0.020}), Settings())
    rig.reset()
    strobe = Stroboscope(PLACE, "gap_m", 1e-3)
    start = orbits.orbit(strobe, strobe.seen(rig, 20.0, rig.measure(9.1, 0.52)), 20.0)
    arc = orbits.followed(strobe, start, way, limits, points=60, longest=1.0, noted=strobe.kind, moved=strobe.moved)
    assert {one.note for one in arc.orbits if not one.stable} == kinds
    assert {one.note for one in arc.orbits if one.stable} == {"stable"}


@pytest.mark.parametrize("gap", [0.01218, 0.01219])
def test_a_symmetric_orbit_that_just_lost_stability_has_the_right_event(gap, tmp_path):
    """The sphere starts where it comes so close to this orbit that it leaves it only after hundreds of cycles."""
    (row,) = study(tmp_path, "orbit", f"set: {{barriers.gap_m: {gap}}}\norbit: {{}}")
    assert row["multiplier_real"] > 1.0
    assert row["event"] == "symmetry"


@pytest.mark.parametrize("over", ["gap_m", "sphere.contact_stiffness_of_a_long_name"])
def test_a_legend_is_within_its_figure(over):
    """Three columns of long names are wider than the figure, which would cut them off at both sides."""
    with style():
        figure, (axis,) = new_axes()
        for number in range(7):
            axis.plot([0.0, 1.0], [number, number], label=f"{over} {number}, left")
        legend_outside(figure, axis, 3)
        figure.draw_without_rendering()
    (legend,) = figure.legends
    box = legend.get_window_extent()
    assert 0.0 <= box.x0 < box.x1 <= figure.bbox.width


def test_marching_follows_the_branch_until_it_changes_and_yields_its_dt(over_gap):
    torus = event(over_gap, "torus")
    last = marched(PLACE, "gap_m", np.arange(0.0300, 0.0311, 0.00001))
    assert last == pytest.approx(torus["value"], rel=1e-3)
    for gap in (0.013, 0.020, 0.027, 0.030):
        config = from_flat(RigConfig(), {"barriers.gap_m": gap})
        rig = MapRig(config, Settings(settle_tolerance=1e-9))
        rig.reset()
        reading = rig.measure(9.1, 0.52)
        found = orbits.orbit(
            strobe := Stroboscope(PLACE, "gap_m", 0.001), strobe.seen(rig, gap * 1e3, reading), gap * 1e3
        )
        assert found is not None
        assert strobe.properties(found.z, found.p).dt == pytest.approx(reading.dt, rel=1e-6)


def test_four_impacts_per_cycle_at_6_mm_exist_between_two_folds(tmp_path):
    rows = study(
        tmp_path,
        "continue",
        "set: {barriers.gap_m: 0.006}\ncontinue: {over: frequency_hz, from: 8.5, to: 9.7, at: 9.1}",
    )
    assert event(rows, "closed")
    low, high = sorted(row["value"] for row in rows if row["event"] == "fold")
    place = Place(from_flat(RigConfig(), {"barriers.gap_m": 0.006}), 9.1, 0.52)
    assert marched(place, "frequency_hz", np.arange(9.1, 9.3, 0.001)) == pytest.approx(high, rel=1e-3)
    assert marched(place, "frequency_hz", np.arange(9.1, 8.8, -0.001)) == pytest.approx(low, rel=1e-3)


@pytest.mark.parametrize(("gap", "at", "stable", "period"), [(0.010, 0.010, 0.00975, 2), (0.008, 0.00806, 0.00806, 3)])
def test_marching_doubles_its_period_at_the_flip(gap, at, stable, period, tmp_path):
    """Past a flip, the square of the alternating part grows linearly, so marching shows where it is zero.

    The branch of doubled orbits, followed back, turns where it begins: this is the same flip, and not a fold.
    """
    text = f"continue: {{over: gap_m, from: {0.5 * gap}, to: {1.02 * gap}, at: {at}, points: 40}}"
    flip = event(study(tmp_path, "continue", text), "flip")["value"]
    rig = MapRig(from_flat(RigConfig(), {"barriers.gap_m": gap}), Settings())
    rig.reset()
    rig.measure(PLACE.frequency_hz, PLACE.amplitude)
    gaps, squares = flip * (1.0 - np.array([0.001, 0.0015, 0.002])), []
    for value in [stable, *gaps.tolist()]:
        rig.carry(from_flat(RigConfig(), {"barriers.gap_m": value}))
        motion = rig.run_cycles(PLACE.frequency_hz, PLACE.amplitude, 2400 + 2 * period)
        number = np.arange(motion.last_tick - 2 * period + 1, motion.last_tick + 1)
        x_1 = motion.quantities(("x_1",), number, np.zeros(2 * period))[0]
        squares.append(float(((x_1[:period] - x_1[period:]) ** 2).sum()))
    assert squares[0] < 1e-6 * squares[1]
    assert np.polyfit(squares[1:], gaps, 1)[1] == pytest.approx(flip, rel=1e-4)
    doubled = rig.measure(PLACE.frequency_hz, PLACE.amplitude)
    assert doubled.period == 2 * period
    strobe, here = Stroboscope(PLACE, "gap_m", 1e-3), 1e3 * float(gaps[-1])
    one = orbits.orbit(strobe, strobe.seen(rig, here, doubled), here)
    assert one is not None
    arc = orbits.followed(
        strobe, one, 1.0, (0.99 * here, 1.01 * here), longest=0.05, born=strobe.born, moved=strobe.moved
    )
    assert {change.kind for change in arc.changes} == {"flip"}
    assert max(change.orbit.p for change in arc.changes) == pytest.approx(1e3 * flip, rel=1e-5)


@pytest.mark.parametrize(("gap", "e"), [(0.008, 0.6), (0.008, 0.8), (0.008, 0.35), (0.0065, 0.35)])
def test_a_chaotic_sphere_that_leaves_the_structure_steady_is_called_chaotic(gap, e):
    """In all cases but the first, the structure alone repeats to 1e-3 or better."""
    config = from_flat(RigConfig(), {"barriers.gap_m": gap, "contact.restitution": e})
    reading = MapRig(config, Settings()).measure(9.1, 0.52)
    assert reading.regime == "chaotic"
    assert math.isnan(reading.period)


def test_a_motion_in_a_thin_chaotic_band_is_not_called_periodic():
    """After six cycles the sphere repeats to 1.7e-3 at most, to 2e-4 now and then: its exponent is +0.74 ± 0.06 /s."""
    found = judged(77, 38)
    assert found["regime"] == "chaotic"
    assert found["exponent_per_s"] > 4.0 * found["u_per_s"]


@pytest.mark.parametrize(("number", "period"), [(46, 11), (63, 12)])
def test_a_long_orbit_is_called_periodic(number, period):
    """Its amplitude looks chaotic, but neighbouring motions approach one another: exponents of -2.1 and -1.1 /s."""
    found = judged(2, number)
    assert (found["regime"], found["period"], found["transient"]) == ("periodic", period, 0.0)
    assert found["exponent_per_s"] < -4.0 * found["u_per_s"]


def test_a_slow_separation_of_neighbours_is_measured_for_longer():
    """The sphere's motion changes little in a cycle: its exponent of +0.75 /s is not certain after 192 cycles."""
    assert judged(2, 31)["regime"] == "chaotic"


def test_a_chaotic_transient_does_not_decide_the_regime():
    found = judged(2, 39)
    assert (found["regime"], found["transient"]) == ("periodic", 1.0)
    assert found["exponent_per_s"] < 0.0


@pytest.mark.parametrize(
    ("first", "last", "step"),
    [
        (0.012308, 0.012172, 0.000068),
        (0.012227, 0.012176, 0.000017),
        (0.012216, 0.012199, 0.000017),
        (0.009800, 0.009680, 0.000003),
    ],
)
def test_a_motion_that_slowly_leaves_an_unstable_orbit_is_not_called_chaotic(first, last, step, tmp_path):
    """The symmetric orbit loses its stability at 12.210 mm, and an orbit of five impacts in two cycles at 9.689 mm.

    Just below, neighbouring motions separate as long as the motion is near the old orbit, but it settles to a new one.
    """
    values = np.arange(first, last - step / 2, -step).tolist()
    text = f"bifurcation: {{over: gap_m, values: {values}, direction: down}}\n"
    rows = study(tmp_path, "bifurcation", f"frequency_hz: 9.1\ncurrent_a: 0.52\n{text}")
    assert {row["regime"] for row in rows} == {"periodic"}


# Two motions at one place

TWO_MOTIONS = ((9.1, 0.030), (9.1, 0.020), (9.1, 0.016), (9.0, 0.024), (9.2, 0.014))
"""Frequency and gap where a sphere that rests at a wall comes to strike, and one in the middle never does."""


@pytest.fixture(scope="module")
def predicted(tmp_path_factory, request) -> dict[tuple[float, float], dict[str, float]]:
    """Return DT by the start position of the sphere, from orbits; `basin` must find the same motions."""
    folder, found = tmp_path_factory.mktemp("two"), {}
    for frequency, gap in TWO_MOTIONS if request.config.getoption("--thorough") else TWO_MOTIONS[:2]:
        text = (
            f"frequency_hz: {frequency}\nset: {{barriers.gap_m: {gap}}}\n"
            f"continue: {{over: gap_m, from: {0.999 * gap}, to: {1.001 * gap}, at: [{gap}], starts: [left, centre]}}\n"
            f"basin: {{sphere_position_m: [{-0.49 * gap}, 0.0], sphere_speed_m_s: [0.0]}}\n"
        )
        rows = [row for row in study(folder, "continue", text) if row["event"] == "start"]
        assert [row["stable"] for row in rows] == [1.0, 1.0]
        by_start = dict(zip(("left", "centre"), (row["dt"] for row in rows), strict=True))
        starts = {(row["sphere_position_m"], row["sphere_speed_m_s"]): row for row in study(folder, "basin", text)}
        assert starts[(-0.49 * gap, 0.0)]["dt"] == pytest.approx(by_start["left"], rel=1e-3)
        assert starts[(0.0, 0.0)]["dt"] == pytest.approx(by_start["centre"], rel=1e-3)
        assert starts[(0.0, 0.0)]["impacts_per_cycle"] == 0.0
        found[frequency, gap] = by_start
    return found


def test_basin_and_continue_find_both_motions(predicted):
    for both in predicted.values():
        assert both["centre"] > 1.1 * both["left"]


@pytest.mark.ros
@pytest.mark.pipeline
@pytest.mark.timeout(500)
def test_a_rig_over_ros_settles_to_the_predicted_motion(predicted, tmp_path, request):
    from impact_rig_studies.ros_campaign import ros_runner

    places = TWO_MOTIONS if request.config.getoption("--thorough") else TWO_MOTIONS[:1]
    jobs = [
        attrs.evolve(job(frequency, gap), changes={"barriers.gap_m": gap, "sphere.start": start})
        for frequency, gap in places
        for start in ("left", "centre")
    ]
    for one, outcome in ros_runner(tmp_path)(jobs):
        wanted = predicted[one.frequencies_hz[0], one.gap_m][str(one.changes["sphere.start"])]
        measured, doubt = outcome.rows["transmissibility"][0], outcome.rows["transmissibility_uncertainty"][0]
        assert measured == pytest.approx(wanted, abs=max(4.0 * doubt, 5e-3 * wanted)), one


# The command

SMALL = """
title: small
set: {barriers.gap_m: 0.020}
section: {cycles: 10}
bifurcation: {over: gap_m, values: [0.019, 0.020, 0.021], direction: both, cycles: 8}
basin: {sphere_position_m: [-0.009, 0.0], sphere_speed_m_s: [0.0, 0.4]}
orbit: {starts: [left, right]}
continue: {over: current_a, from: 0.4, to: 0.6, at: [0.45, 0.52], points: 3}
exponent: {over: frequency_hz, values: [9.0, 9.1], cycles: 10, windows: 4}
"""


@pytest.mark.parametrize("direction", ["up", "down", "both", "reset"])
def test_a_diagram_of_one_value_has_one_motion_from_rest(direction, tmp_path):
    (tmp_path / "one.yaml").write_text(f"bifurcation: {{over: gap_m, values: 0.02, direction: {direction}}}")
    tasks = plan.load(tmp_path / "one.yaml", "bifurcation").tasks
    assert [plan.direction_of(task) for task in tasks] == ["reset"]


@pytest.mark.parametrize("kind", plan.KINDS)
def test_an_interrupted_study_resumes_to_the_same_bytes(kind, tmp_path, capsys):
    (tmp_path / "small.yaml").write_text(SMALL)
    words = [
        "dynamics",
        kind,
        str(tmp_path / "small.yaml"),
        "--workers",
        "1",
        "--output",
        str(tmp_path / "out"),
        "--json",
    ]

    def contents() -> dict[str, bytes]:
        files = [path for path in (tmp_path / "out").rglob("*") if path.is_file() and path.name != f"{kind}.json"]
        return {str(path.relative_to(tmp_path)): path.read_bytes() for path in files}

    assert main(words) == 0
    printed, whole = json.loads(capsys.readouterr().out), contents()
    assert printed["rows"] > 0
    assert f"out/figures/dynamics_{kind}.svg" in whole
    tasks = sorted((tmp_path / "out" / "tasks").iterdir())
    assert len(tasks) == printed["tasks"] == printed["measured_tasks"]
    for path in tasks[::2]:
        path.unlink()
    (tmp_path / "out" / f"{kind}.csv").unlink()
    assert main(words) == 0
    assert json.loads(capsys.readouterr().out)["measured_tasks"] == len(tasks[::2])
    assert contents() == whole
    with (tmp_path / "out" / f"{kind}.csv").open() as file:
        assert len(list(csv.DictReader(file))) == printed["rows"]


LEADING = {
    "section": ["start", "x_1_m"],
    "bifurcation": ["start", "direction", "gap_m", "regime"],
    "basin": ["sphere_position_m", "sphere_speed_m_s", "attractor"],
    "orbit": ["start", "frequency_hz", "event"],
    "continue": ["start", "branch", "current_a", "event"],
    "exponent": ["start", "frequency_hz", "regime"],
}


@pytest.fixture(scope="module")
def several(tmp_path_factory):
    """Directory with two kinds of study."""
    folder = tmp_path_factory.mktemp("several")
    (folder / "small.yaml").write_text(SMALL)
    for kind in ("bifurcation", "basin"):
        words = ["--workers", "1", "--no-figures", "--output", str(folder / "out")]
        assert main(["dynamics", kind, str(folder / "small.yaml"), *words]) == 0
    return folder / "out"


@pytest.mark.parametrize("kind", plan.KINDS)
def test_the_table_of_a_study_names_parameter_direction_and_start(kind, tmp_path):
    """The table must contain parameter, direction and start, as the exported file does."""
    path = tmp_path / "small.yaml"
    path.write_text(SMALL)
    study = plan.load(path, kind)
    names, _ = plan.FinishedStudy(study, [(task, []) for task in study.tasks]).table()
    assert names[: len(LEADING[kind])] == LEADING[kind]
    assert "value" not in names


@pytest.mark.parametrize("kind", ["bifurcation", "basin"])
def test_a_study_is_exported_as_its_table(several, kind, tmp_path):
    assert main(["export", str(several), kind, str(tmp_path / "rows.csv")]) == 0
    with (several / f"{kind}.csv").open() as written, (tmp_path / "rows.csv").open() as exported:
        own, found = list(csv.DictReader(written)), list(csv.DictReader(exported))
    assert list(own[0]) == list(found[0])
    for one, other in zip(own, found, strict=True):
        assert [cell or "nan" for cell in one.values()] == list(other.values())


def test_an_unknown_table_of_a_study_is_rejected_with_a_list_of_the_known_ones(several, tmp_path, capsys):
    assert main(["export", str(several), "orbit", str(tmp_path / "rows.csv")]) == 1
    assert f"{several} has no table 'orbit'; it has the tables bifurcation, basin" in capsys.readouterr().err


def test_the_example_for_reading_finished_studies_runs(tmp_path, monkeypatch):
    """It is in docs/how-to/recording.md, and names its directories by strings."""
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    monkeypatch.chdir(tmp_path)
    page = Path(__file__).parents[2] / "docs" / "how-to" / "recording.md"
    pattern = re.compile(r"^```python studies\n(.*?)^```$", re.DOTALL | re.MULTILINE)
    (example,) = pattern.findall(page.read_text(encoding="utf-8"))
    Path("map.yaml").write_text("axes: {gap_m: [0.006, 0.020], frequency_hz: [9.0, 9.1]}\n")
    Path("study.yaml").write_text("frequency_hz: 9.1\nbifurcation: {over: gap_m, values: [0.018, 0.020]}\n")
    options = ["--no-figures", "--workers", "1", "--output"]
    assert main(["map", "map.yaml", *options, "runs/map_gap_frequency"]) == 0
    assert main(["dynamics", "bifurcation", "study.yaml", *options, "runs/dynamics_nominal"]) == 0
    names: dict[str, object] = {}
    exec(compile(example, str(page), "exec"), names)
    assert dict(names["regimes"].sizes) == {"gap_m": 2, "frequency_hz": 2, "direction": 1}
    assert set(names["march"]["regime"]) == {"periodic"}


def test_a_study_becomes_a_data_frame_and_a_dataset(several):
    pytest.importorskip("pandas")
    pytest.importorskip("xarray")
    march, basin = (plan.open_study(several, kind) for kind in ("bifurcation", "basin"))
    frame, rows = march.to_dataframe(), march.to_xarray()
    assert set(frame["direction"]) == {"up", "down"}
    assert set(rows.coords) == {"start", "direction", "gap_m"}
    assert frame["dt"].tolist() == rows["dt"].values.tolist()
    grid = basin.to_xarray()
    assert dict(grid.sizes) == {"sphere_speed_m_s": 2, "sphere_position_m": 2}
    for _, row in basin.to_dataframe().iterrows():
        place = grid.sel(sphere_speed_m_s=row["sphere_speed_m_s"], sphere_position_m=row["sphere_position_m"])
        assert float(place["dt"]) == pytest.approx(row["dt"], nan_ok=True)


def test_a_map_lists_the_exponent_next_to_the_regime_on_request(tmp_path, capsys):
    text = "axes: {gap_m: [0.020, 0.031], sphere_position_m: [-0.0099, -0.005]}\n"
    (tmp_path / "map.yaml").write_text(text)
    words = ["map", str(tmp_path / "map.yaml"), "--workers", "1", "--no-figures", "--output", str(tmp_path / "out")]

    def rows() -> list[dict[str, str]]:
        with (tmp_path / "out" / "map.csv").open() as file:
            return list(csv.DictReader(file))

    assert main([*words, "--exponent", "--json"]) == 0
    asked = rows()
    assert json.loads(capsys.readouterr().out)["exponents"] == 1
    (modulated,) = [row for row in asked if row["exponent_per_s"]]
    assert {row["regime"] for row in asked if row is not modulated} == {"periodic"}
    where = f"{{barriers.gap_m: {modulated['gap_m']}}}\nexponent: {{starts: [[{modulated['sphere_position_m']}, 0.0]]}}"
    (alone,) = study(tmp_path, "exponent", f"set: {where}")
    for name in ("regime", "exponent_per_s", "uncertainty_per_s"):
        assert modulated[name] == str(alone[name])
    assert main(words) == 0
    assert rows() == asked, "what is stored is kept"
    (tmp_path / "map.yaml").write_text("axes: {gap_m: [0.020, 0.031], current_a: [0.5, 0.52]}\ndirection: up\n")
    assert main([*words[:-1], str(tmp_path / "up"), "--exponent"]) == 1
    assert "map.yaml must be reset" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("section", "title: x", "the file has no section named section"),
        ("section", "section: {cycles: 0}", "section.cycles must be an integer >= 1"),
        ("section", "section: {starts: []}", r"section.starts must be at least one start, got \[\]"),
        ("section", "section: {starts: [above]}", r"section.starts\[0\] must be one of left, centre, right"),
        ("orbit", "orbit: {speed: 1}", "unknown key 'speed' in orbit"),
        ("continue", "continue: {over: sphere.start, from: 1, to: 2, at: 1}", "or a number of the configuration"),
        ("continue", "continue: {over: contact.law, from: 1, to: 2, at: 1}", "or a number of the configuration"),
        ("continue", "continue: {from: 0.02, to: 0.01, at: 0.02}", "continue.to must be > 0.02"),
        ("continue", "continue: {from: 0.01, to: 0.02, at: 0.03}", r"continue.at\[0\] must be"),
        ("bifurcation", "bifurcation: {over: gap_m, values: [-1, 0.02]}", "barriers.gap_m must be"),
        ("bifurcation", "bifurcation: {over: frequency_hz, values: [0, 9.1]}", r"bifurcation.values\[0\] must be > 0"),
        ("exponent", "exponent: {over: current_a, values: [0.5, -0.5]}", r"exponent.values\[1\] must be > 0"),
        ("basin", "basin: {sphere_position_m: [0.5], sphere_speed_m_s: [0, 1]}", r"basin.sphere_position_m\[0\]"),
        ("exponent", "exponent: {over: gap_m, values: [0.02], windows: 1}", "exponent.windows must be"),
        ("exponent", "set: {daq.seed: 1}\nexponent: {}", "has no effect on"),
        ("orbit", "orbit: [", "cannot be read as plain YAML"),
    ],
)
def test_an_invalid_file_is_rejected_by_name(kind, text, message, tmp_path):
    with pytest.raises(ConfigError, match=message):
        study(tmp_path, kind, text)
