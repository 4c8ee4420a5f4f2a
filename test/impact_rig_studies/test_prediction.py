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
"""Prediction for two symmetric impacts per cycle, compared with exact orbits, the simulation and its own limits."""

from __future__ import annotations

import math

import numpy as np
import pytest
from kits.mechanics import TWO_PI, rig, sine

from impact_rig.errors import ConfigError
from impact_rig.physics import Simulation
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies import prediction
from impact_rig_studies.dynamics.stroboscope import Place
from impact_rig_studies.prediction import THETA_SYMMETRIC, Manifold
from qualification.prediction_stability import continued, judged

CURRENT_A = 0.52
FLORES = 0.309


@pytest.fixture(scope="module")
def nominal() -> RigConfig:
    return RigConfig()


def settled(config: RigConfig, frequency_hz: float, cycles: int) -> tuple[complex, float, float]:
    """Return DT, approach speed and impacts per cycle of the mechanics, averaged over 24 cycles after `cycles` ones."""
    simulation, period, last = Simulation(config), 1.0 / frequency_hz, 24
    simulation.advance(sine(frequency_hz, CURRENT_A, period, cycles))
    motion = simulation.advance(sine(frequency_hz, CURRENT_A, period, last))
    segment = cycles + np.repeat(np.arange(last), 64)
    offset = np.tile(np.arange(64) / 64 * period, last)
    turn = np.exp(-1j * TWO_PI * frequency_hz * offset)
    base, superior = motion.quantities(("x_b", "x_1"), segment, offset) @ turn
    return superior / base, float(motion.impacts["approach_speed"].mean()), len(motion.impacts) / last


@pytest.mark.parametrize("e", [0.1, FLORES, 0.8])
def test_theta_solves_the_two_conditions(e):
    manifold = Manifold(e, 0.01)
    xi = np.linspace(1.0001 * 2.0 / manifold.gap_per_amplitude_at_fold, 3.0, 50)
    assert manifold.xi(manifold.theta(xi)) == pytest.approx(xi, rel=1e-12)
    assert np.isnan(manifold.theta(0.9999 * 2.0 / manifold.gap_per_amplitude_at_fold))


def test_the_fold_of_the_rig_of_the_paper_is_the_published_one():
    assert Manifold(FLORES).gap_per_amplitude_at_fold == pytest.approx(6.28, abs=0.01)


def half_period_map(e: float, theta: float) -> np.ndarray:
    """Return the matrix, shape (2, 2), that maps errors of (phase, speed/V) from one impact to the next."""
    q = math.pi**2 / 4.0 * (1.0 + e) ** 2 * (theta - 1.0) / theta
    return np.array([[e, -math.pi * (1.0 + e) / 2.0], [e * 2.0 * q / (math.pi * (1.0 + e)), e - q]])


def test_a_branch_at_constant_current_is_stable_on_one_side_of_its_largest_gap(nominal):
    """Two motions merge there: the determinant of the slow flow is zero if the gap is stationary, its trace is not."""
    motions = prediction.branch(nominal, 8.6, current_a=CURRENT_A)
    largest = int(np.argmax(motions.gap_m))
    assert 0 < largest < len(motions.theta) - 1
    assert not motions.stable[:largest].any()
    assert motions.stable[largest + 1 : largest + 50].all()


@pytest.mark.parametrize("e", [0.1, FLORES, 0.8])
def test_the_bounds_of_stability_are_those_of_the_map(e):
    manifold = Manifold(e)
    theta = np.linspace(0.8 * manifold.theta_fold, 1.2 * THETA_SYMMETRIC, 301)
    radius = np.array([np.abs(np.linalg.eigvals(half_period_map(e, one))).max() for one in theta])
    assert np.array_equal(radius < 1.0, manifold.stable(theta))
    assert np.linalg.det(half_period_map(e, 1.1)) == pytest.approx(e * e)


def test_symmetry_breaks_where_continuation_predicts():
    """12.210 mm at 9.1 Hz; the sphere alone would stay symmetric down to 11.99 mm."""
    found = prediction.branch(RigConfig(), 9.1, current_a=0.52)
    assert found.gap_m[found.kind == "symmetry"].max() == pytest.approx(12.210e-3, rel=2e-3)
    assert not found.stable[found.gap_m < 12.2e-3].any()


@pytest.mark.parametrize(("gap_mm", "kind"), [(8.6, "stable"), (8.75, "torus")])
def test_a_torus_ends_the_motion_before_its_fold(gap_mm, kind):
    """Sphere and structure, each stable by itself, exchange a slow beat, so the motion is unstable before the fold."""
    sphere_kg = prediction.LinearRig.of(RigConfig()).sphere_kg
    config = from_flat(RigConfig(), {"structure.mass_kg": sphere_kg / 0.0263212, "barriers.gap_m": gap_mm * 1e-3})
    place = Place(config, 9.642195, 0.201917)
    found = prediction.at(config, place.frequency_hz, gap_mm * 1e-3, current_a=place.amplitude)
    assert found.kind[0] == kind
    one = continued(place, 0)[1]
    assert one is not None
    assert one.kind == kind
    assert abs(one.multipliers[0]) == pytest.approx(1.0, abs=0.2)


@pytest.mark.heavy
@pytest.mark.parametrize("number", [2, 4, 6, 9])
def test_the_multipliers_of_the_model_agree_with_the_prediction(number):
    found = judged(60, number)
    assert (found["predicted"] == "stable") == found["stable"]
    assert found["predicted_dt"] == pytest.approx(found["dt"], rel=0.01)


def test_without_recoil_the_structure_keeps_its_own_multipliers(nominal):
    """An impact then leaves the structure alone, so two eigenvalues of its free motion over half a cycle remain."""
    rig = prediction.LinearRig.of(nominal, recoil=False)
    held = prediction.HeldDrive(None, 100e-6, None)
    theta, hz = np.array([1.3]), np.array([9.1])
    found = rig._multipliers(theta, hz, rig._answer(theta, hz, held), held)[0]
    c = rig.linear
    roots = np.roots([c.m_1, c.c_1, c.k_1])
    for one in -np.exp(roots * 0.5 / hz[0]):
        assert np.abs(found - one).min() < 1e-9


@pytest.mark.parametrize("held", ["current_a", "base_m", "superior_m"])
def test_the_prediction_at_a_gap_is_the_motion_of_the_branch(nominal, held):
    value = {"current_a": CURRENT_A, "base_m": 100e-6, "superior_m": 5e-3}[held]
    along = prediction.branch(nominal, 9.1, **{held: value})
    wanted = along.take(np.array([400]))
    found = prediction.at(nominal, 9.1, float(wanted.gap_m[0]), **{held: value})
    nearest = found.take(np.array([np.argmin(abs(found.theta - wanted.theta))]))
    for name in ("theta", "dt", "base_m", "superior_m", "current_a", "impact_speed_m_s"):
        assert getattr(nearest, name) == pytest.approx(getattr(wanted, name), rel=1e-9), name
    assert getattr(wanted, held) == pytest.approx(value, rel=1e-12)


def test_curves_are_interrupted_where_no_motion_exists(nominal):
    frequencies = np.arange(8.5, 9.8, 0.05)
    lines = prediction.curves(nominal, frequencies, 29e-3, current_a=CURRENT_A)
    assert lines
    for line in lines:
        assert np.diff(line.frequency_hz) == pytest.approx(0.05)
        assert line.gap_m == pytest.approx(29e-3, rel=1e-9)
    reached = np.concatenate([line.frequency_hz for line in lines])
    assert reached.min() > 8.8
    assert reached.max() < 9.4


def test_the_superior_base_lags_a_quarter_cycle_on_the_backbone(nominal):
    line = prediction.backbone(nominal, 6e-3)
    assert np.degrees(line.phase_rad) == pytest.approx(-90.0, abs=1e-9)
    assert line.gap_m[0] / line.superior_m[0] == pytest.approx(
        Manifold(FLORES, 0.0081).gap_per_amplitude_at_fold, rel=2e-3
    )
    # the same motion, asked for by its frequency and current
    again = prediction.at(nominal, float(line.frequency_hz[200]), 6e-3, current_a=float(line.current_a[200]))
    assert np.abs(again.theta - line.theta[200]).min() < 1e-9


@pytest.mark.heavy
def test_the_ends_of_branches_and_the_best_damping_are_predicted(nominal):
    for frequency, low, high in ((8.8, 27e-3, 28e-3), (9.1, 30e-3, 32e-3), (9.4, 26e-3, 28e-3)):
        branch = prediction.branch(nominal, frequency, current_a=CURRENT_A)
        assert low < prediction.widest_gap_m(branch) < high
        assert len(prediction.at(nominal, frequency, 32e-3, current_a=CURRENT_A)) == 0
    best = prediction.best_gap(prediction.branch(nominal, 9.1, current_a=CURRENT_A))
    assert best.gap_m == pytest.approx(29e-3, abs=0.5e-3)
    assert best.reduction_percent(nominal) == pytest.approx(68.1, abs=0.5)


@pytest.mark.parametrize(("frequency_hz", "gap_mm"), [(8.8, 20), (9.1, 12.5), (9.1, 29), (9.4, 25)])
def test_the_simulated_mechanics_agree_with_the_prediction(nominal, frequency_hz, gap_mm):
    config = rig(barriers={"gap_m": gap_mm * 1e-3})
    ratio, speed, impacts = settled(config, frequency_hz, 220)
    found = prediction.at(config, frequency_hz, gap_mm * 1e-3, current_a=CURRENT_A)
    found = found.take(found.stable)
    assert len(found) == 1
    assert impacts == 2.0
    assert found.dt[0] == pytest.approx(abs(ratio), rel=2e-3)
    assert math.degrees(found.phase_rad[0]) == pytest.approx(math.degrees(np.angle(ratio)), abs=0.2)
    assert found.impact_speed_m_s[0] == pytest.approx(speed, rel=3e-3)


@pytest.mark.heavy
def test_the_deviation_at_the_fold_falls_as_the_rig_grows_heavier():
    """A rig with ten times the mass and the force is the same linear rig; m/m_1 is a tenth."""
    nominal, plain, recoiling = RigConfig(), [], []
    names = ("force_factor_n_a", "suspension_stiffness_n_m", "damping_n_s_m", "armature_mass_kg", "base_mass_kg")
    for times, cycles in ((1.0, 220), (10.0, 1100)):
        structure = {"mass_kg": times * nominal.structure.mass_kg}
        shaker = {name: times * getattr(nominal.shaker, name) for name in names}
        config = rig(structure=structure, shaker=shaker)
        end = prediction.branch(config, 9.1, current_a=CURRENT_A, recoil=False)
        gap = 0.95 * prediction.widest_gap_m(end)
        ratio, _, impacts = settled(rig(structure=structure, shaker=shaker, barriers={"gap_m": gap}), 9.1, cycles)
        assert impacts == 2.0
        for recoil, kept in ((False, plain), (True, recoiling)):
            found = prediction.at(config, 9.1, gap, current_a=CURRENT_A, recoil=recoil)
            kept.append(abs(found.take(found.stable).dt[0] / abs(ratio) - 1.0))
    assert plain[0] > 5e-3
    assert plain[1] < 0.1 * plain[0]
    assert recoiling[0] < 0.1 * plain[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sphere": {"present": False}}, "needs a sphere"),
        ({"sphere": {"guide_friction": 0.1}}, "friction"),
        ({"contact": {"law": "hertz"}}, "restitution"),
    ],
)
def test_rigs_that_the_prediction_does_not_cover_are_rejected(changes, message):
    with pytest.raises(ConfigError, match=message):
        prediction.branch(rig(**changes), 9.1, current_a=CURRENT_A)


@pytest.mark.parametrize("held", [{}, {"current_a": 0.5, "base_m": 1e-4}, {"current_a": 0.0}])
def test_a_branch_needs_exactly_one_positive_current_or_base_amplitude(nominal, held):
    with pytest.raises(ConfigError):
        prediction.branch(nominal, 9.1, **held)
