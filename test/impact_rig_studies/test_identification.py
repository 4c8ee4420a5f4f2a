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
"""Identification finds the constants of a rig within its uncertainties, and states what the data leave open."""

from __future__ import annotations

import itertools
import json
import re

import attrs
import numpy as np
import pytest
from kits.recorded_rig import record

from impact_rig.analysis.scans import BASE, LASER
from impact_rig.analysis.uncertainty_budget import plus_minus
from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig.cli import main
from impact_rig.physics.linear_response import base_per_ampere, transmissibility
from impact_rig.recording import open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Regime, Status
from impact_rig_studies.campaign import paper, run
from impact_rig_studies.campaign.job import execute
from impact_rig_studies.campaign.paper import FREQUENCIES_HZ
from impact_rig_studies.campaign.plan import load_campaign
from impact_rig_studies.campaign.results import Curves, Point
from impact_rig_studies.decay import Decay
from impact_rig_studies.identification import fit, paper_fit
from impact_rig_studies.identification.fit import NAMES, SCALED, identify, information, logarithms, rig
from impact_rig_studies.identification.measurements import (
    DISPLACEMENT_M,
    NUISANCES,
    RECORD_S,
    U_RESTITUTION,
    Gains,
    Measured,
    Reduced,
    SineData,
    measured_decay,
    recorded_decay,
    reduced_of,
    sine_of,
)
from impact_rig_studies.identification.motions import AROUND, SettledRig, place_of, simulated

pytestmark = pytest.mark.heavy

TRUTH = rig(RigConfig(), logarithms(RigConfig()) + np.array([0.002, 0.25, 0.15, -0.1, 0.1, 0.08, 0.2]))
"""Not the shipped rig: m_1 = 0.151 kg, ζ = 0.0058, ..."""
NOISE = 3e-4
LIMIT = 3.0
"""Standard uncertainties by which a constant may be off: by chance once in 370."""
GAPS = (0.004, 0.010)


def test_the_scatter_of_points_measured_several_times_is_the_stated_one():
    rng, noise, count = np.random.default_rng(8), 2e-3, 9
    gains = Gains.of(Rig(RigConfig()).info().rows)
    points = []
    for _ in range(300):
        rows = np.zeros(count, TRANSMISSIBILITY)
        rows["frequency"], rows["base_amplitude"], rows["current_amplitude"] = 9.1, 1e-4, 0.5
        rows["transmissibility"] = 10.0 * (1.0 + noise * rng.standard_normal(count))
        rows["laser_amplitude"] = rows["transmissibility"] * 1e-4
        sensors = sum(
            gains.calibration.gain_uncertainty_at(channel, size) ** 2 for channel, size in ((LASER, 1e-3), (BASE, 1e-4))
        )
        rows["transmissibility_uncertainty"] = 10.0 * np.sqrt(sensors + noise**2)
        points.append(point_of(rows))
    found = sine_of(points, gains)
    for values, truth in ((found.dt, 10.0), (found.laser_m, 1e-3)):
        assert np.sqrt(np.mean(((values / truth - 1.0) / found.u_amplitude) ** 2)) == pytest.approx(1.0, abs=0.15)


def point_of(rows):
    return Point(
        study="sine", axes={}, reference=True, gap_m=0.0, current_a=0.5, frequency_hz=9.1, direction="reset", rows=rows,
        failure="", key="",
    )  # fmt: skip


def test_sensor_nonlinearity_is_evaluated_at_the_readings():
    """An accelerometer reads ω² times the displacement: its range in m/s² must not be compared with a displacement."""
    info = Rig(RigConfig()).info().rows.copy()
    displacement = Gains.of(info).relative(1, np.array([0.004]), 9.1)
    row = info["name"] == b"laser"
    info["unit"][row] = b"m/s^2"
    for column in ("range_low", "range_high", "linearity"):
        info[column][row] *= (2 * np.pi * 9.1) ** 2
    assert Gains.of(info).relative(1, np.array([0.004]), 9.1) == pytest.approx(displacement)
    assert displacement[0, 3] != 0.0


def synthetic(rng, truth=TRUTH, gaps=(), errors=None):
    """Return closed-form measurements of a rig, and simulated reductions, with errors as stated by the certificate.

    Errors of calibration are drawn at random unless they are given, shape (6,).
    """
    gains = Gains.of(Rig(truth).info().rows)
    frequency = np.array(FREQUENCIES_HZ)
    ratio, per_ampere = transmissibility(truth, frequency), np.abs(base_per_ampere(truth, frequency))
    base = 0.52 * per_ampere
    laser = base * np.abs(ratio)
    errors = np.append(rng.normal(0.0, gains.u), 0.0) if errors is None else errors
    on_laser = gains.relative(1, laser, frequency) @ errors
    on_base, on_current = gains.relative(2, base, frequency) @ errors, errors[2]
    n, u = len(frequency), np.full(len(frequency), NOISE)
    sine = SineData(
        frequency, np.abs(ratio) * np.exp(on_laser - on_base + rng.normal(0, NOISE, n)),
        np.angle(ratio) + rng.normal(0, NOISE, n), per_ampere * np.exp(on_base - on_current + rng.normal(0, NOISE, n)),
        laser, base, u, u,
    )  # fmt: skip
    structure = truth.structure
    decay = Decay(
        status=Status.OK, natural_frequency_hz=structure.natural_frequency_hz * (1 + rng.normal(0, 1e-5)),
        damping_ratio=structure.damping_ratio * (1 + rng.normal(0, 1e-3)),
        u_natural_frequency_hz=structure.natural_frequency_hz * 1e-5, u_damping_ratio=structure.damping_ratio * 1e-3,
    )  # fmt: skip
    motions = {gap: simulated(truth, gap, 9.1, 0.52) for gap in gaps}
    shared = rng.normal(0.0, NOISE)
    effects = np.zeros((len(gaps), len(NUISANCES)))
    effects[:, NUISANCES.index("DT without sphere")] = -1.0
    reduced = Reduced(
        9.1, dict.fromkeys(gaps, 0.52 * np.exp(on_current)),
        {gap: np.exp(one.log_ratio + rng.normal(0.0, NOISE) - shared) for gap, one in motions.items()},
        np.full(len(gaps), NOISE), NOISE, effects, {gap: one.seen for gap, one in motions.items()},
    )  # fmt: skip
    return Measured(gains=gains, decay=decay, sine=sine, reduced=reduced if gaps else None)


def with_known_e(rng, truth, gaps, errors=None):
    """Return the same measurements with an exactly known e, whose fit takes a tenth of the time."""
    return attrs.evolve(synthetic(rng, truth, gaps, errors), u_restitution=0.0)


def foreign(rng, e):
    """Return a rig whose masses differ by up to a quarter, and its coefficient of restitution."""
    off = np.array([0.0, *rng.uniform(-0.25, 0.25, len(NAMES) - 1)])
    return from_flat(rig(RigConfig(), logarithms(RigConfig()) + off), {"contact.restitution": e})


@pytest.fixture(params=[5, pytest.param(1, marks=pytest.mark.slow)], ids=["fifth", "whole"])
def spacing(request, monkeypatch):
    """Begin a fit with every fifth factor and value of e only: these data have neither narrow nor distant minima."""
    monkeypatch.setattr(fit, "COARSE_E", fit.COARSE_E[:: request.param])
    monkeypatch.setattr(fit, "FACTORS", fit.FACTORS[:: request.param])
    return request.param


@pytest.mark.parametrize(
    ("seeds", "gaps"),
    [((1, 4), (0.004, 0.010)), pytest.param(range(40), (0.004, 0.007), marks=pytest.mark.slow)],
    ids=["two", "many"],
)
@pytest.mark.usefixtures("spacing")
def test_constants_are_found_within_their_uncertainty_despite_errors_of_e_and_sensors(seeds, gaps):
    """e is wrong by its standard uncertainty of 0.02, in either direction; draws may differ only by chance."""
    off = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        truth = foreign(rng, 0.35 + (0.02 if seed % 2 else -0.02))
        found = identify(synthetic(rng, truth, gaps), RigConfig(), logarithms(RigConfig()))
        assert all(map(found.information.determined, NAMES))
        scaled = (found.log_constants - logarithms(truth)) / found.information.u_relative
        off.append([*scaled, (found.restitution - truth.contact.restitution) / found.u_restitution])
    assert np.abs(off).max() < LIMIT
    if len(seeds) > 2:
        spread = np.sqrt(np.mean(np.square(off), axis=0))
        assert np.all((spread > 0.67) & (spread < 1.33)), spread  # ± 11 % each, three times that


@pytest.mark.usefixtures("spacing")
def test_an_error_of_the_current_sensor_shifts_k_f_within_its_uncertainty():
    """K_f follows the gain of this sensor, and no other data determine it, so u(K_f) is at least u(gain)."""
    rng = np.random.default_rng(5)
    gains = Gains.of(Rig(TRUTH).info().rows)
    errors = np.zeros(len(NUISANCES))
    errors[NUISANCES.index("gain current")] = 2.0 * gains.u[2]
    found = identify(with_known_e(rng, TRUTH, (0.004, 0.010), errors), RigConfig())
    off = found.log_constants - logarithms(TRUTH)
    u = found.information.u_relative
    assert u[NAMES.index("K_f")] > gains.u[2]
    assert off[NAMES.index("K_f")] == pytest.approx(-2.0 * gains.u[2], abs=2.0 * u[NAMES.index("m_1")] + 1e-3)
    assert abs(off[NAMES.index("m_1")]) < 2.0 * u[NAMES.index("m_1")], "the masses do not follow it"


@pytest.mark.usefixtures("spacing")
def test_a_fit_that_has_not_converged_is_not_called_consistent(monkeypatch):
    """If the rounds are used up before the fit converges, c_f may be wrong by 4.4 u, so the fit must raise an alarm."""
    rng = np.random.default_rng(0)
    measured = with_known_e(rng, TRUTH, (0.004, 0.010))
    assert identify(measured, RigConfig()).converged
    monkeypatch.setattr("impact_rig_studies.identification.fit.ROUNDS", 1)
    found = identify(measured, RigConfig())
    assert (found.converged, found.consistent) == (False, False)


@pytest.mark.parametrize("without", [None, "decay", "sine"])
def test_a_fit_without_reductions_converges_and_is_consistent(without):
    """A common factor of forces and masses is undetermined; the fit must converge nevertheless, and be consistent."""
    measured = synthetic(np.random.default_rng(0))
    found = identify(attrs.evolve(measured, **{without: None}) if without else measured, RigConfig())
    assert (found.converged, found.consistent) == (True, True)
    if without != "sine":
        assert abs(found.log_constants[0] - logarithms(TRUTH)[0]) < LIMIT * found.information.u_relative[0]


def test_a_phase_of_almost_half_a_turn_may_be_measured_with_either_sign():
    """Far above resonance, x_1 lags by half a turn; with noise it may lead by that, which is not a whole turn away."""
    measured = synthetic(np.random.default_rng(0))
    assert measured.sine is not None
    phase, u = measured.sine.phase_rad.copy(), measured.sine.u_phase.copy()
    u[-1] = 0.05  # a weak signal
    for lag in (np.pi - 0.02, np.pi + 0.02):
        phase[-1] = np.angle(np.exp(-1j * lag))
        found = identify(
            attrs.evolve(measured, sine=attrs.evolve(measured.sine, phase_rad=phase, u_phase=u)), RigConfig()
        )
        assert found.consistent


@pytest.mark.usefixtures("spacing")
def test_a_wrong_known_value_raises_an_alarm():
    exact = with_known_e(np.random.default_rng(0), TRUTH, (0.002, 0.010))
    assert identify(exact, RigConfig()).consistent
    assert not identify(exact, from_flat(RigConfig(), {"contact.restitution": 0.37})).consistent
    wrong_law = from_flat(RigConfig(), {"contact.law": "lankarani_nikravesh"})
    livelier = identify(exact, wrong_law)
    assert 0.002 in livelier.contradicted
    assert not livelier.consistent


def test_no_restitution_makes_up_for_a_wrong_law(spacing, monkeypatch):
    if spacing > 1:  # no search between the values: nothing there is consistent
        monkeypatch.setattr(fit, "COARSE_E", fit.COARSE_E[::2])
        monkeypatch.setattr(fit, "MINIMA", 0)
        monkeypatch.setattr(fit, "MOST_E", 0)
    measured = synthetic(np.random.default_rng(0), TRUTH, (0.002, 0.010))
    found = identify(measured, from_flat(RigConfig(), {"contact.law": "lankarani_nikravesh"}))
    assert found.chance < fit.SIGNIFICANCE
    assert not found.consistent


@pytest.mark.usefixtures("spacing")
def test_a_weakly_chaotic_motion_does_not_contradict_a_periodic_measurement():
    """At 8 mm, motions near that of the shipped rig separate, but DT changes by less than any measurement resolves."""
    motion = simulated(RigConfig(), 0.008, 9.1, 0.52)
    assert (motion.regime, motion.seen) == (Regime.CHAOTIC.value, Regime.PERIODIC.value)
    assert 0.0 < motion.u < 1e-5
    found = identify(with_known_e(np.random.default_rng(2), RigConfig(), (0.006, 0.008)), RigConfig())
    assert found.contradicted == ()
    assert found.consistent


@pytest.mark.parametrize(("gap", "slope"), [(0.006, 0.393427692), (0.010, 0.442785568)])
def test_the_slope_of_an_orbit_follows_from_the_derivative_of_its_map(gap, slope):
    """The stroboscopic map gives d ln DT / d ln m_1; settled differences with a step of 1e-5 agree to 1e-8."""
    heavier = NAMES.index("m_1")

    def place(i, step):
        return place_of(rig(RigConfig(), logarithms(RigConfig()) + step * np.eye(len(NAMES))[i]), gap, 9.1, 0.52)

    here = SettledRig(place_of(RigConfig(), gap, 9.1, 0.52))
    assert here.motion.repeats
    found, roughness = here.slopes(place, len(NAMES), NAMES.index("K_f"), [heavier])
    assert roughness == 0.0
    assert found[heavier] == pytest.approx(slope, abs=1e-5)
    sides = [SettledRig(place(heavier, step)).motion.log_ratio for step in (1e-4, -1e-4)]
    assert found[heavier] == pytest.approx((sides[0] - sides[1]) / 2e-4, abs=1e-4)


def test_a_motion_that_does_not_repeat_has_a_mean_with_an_uncertainty():
    """At 6.5 mm, the sphere is chaotic and hardly moves the structure: its mean is as informative as an orbit."""
    motions = [simulated(RigConfig(), 0.0065, 9.1, current) for current in (0.52, 0.52 * (1 + 1e-9))]
    for one in motions:
        assert one.regime == Regime.CHAOTIC.value
        assert not one.repeats
        assert 0.0 < one.u < 1e-3
    apart = abs(motions[0].log_ratio - motions[1].log_ratio)
    assert 0.0 < apart < 4.0 * np.hypot(*(one.u for one in motions))


@pytest.mark.parametrize(
    ("count", "least", "most"), [(4, 0.47, 1.53), pytest.param(6, 0.5, 1.2, marks=pytest.mark.slow)]
)
def test_the_roughness_of_an_irregular_mean_is_the_size_of_its_jumps(count, least, most):
    """The mean changes by jumps from window to window of regimes, which no slope describes: here about a line.

    At several places, the mean of a motion with up to 1 % more or less m_1 is off the line by the stated roughness.
    """
    rng = np.random.default_rng(0)
    heavier, off, jumps = NAMES.index("m_1"), [], 0
    for gap, e in itertools.product((0.0065, 0.0075), np.linspace(0.31, 0.39, count)):

        def place(i, step, gap=gap, e=e):
            change = step * np.eye(len(NAMES) + 1)[i]
            config = rig(RigConfig(), logarithms(RigConfig()) + change[:-1])
            return place_of(from_flat(config, {"contact.restitution": e + change[-1]}), gap, 9.1, 0.52)

        here = SettledRig(place(heavier, 0.0))
        if here.motion.repeats:
            continue
        by, roughness = here.slopes(place, len(NAMES) + 1, NAMES.index("K_f"), (heavier, len(NAMES)))
        jumps += roughness > 2.0 * here.motion.u
        for step in rng.uniform(AROUND[0], AROUND[-1], 4):
            near = SettledRig(place(heavier, step)).motion
            jump = near.log_ratio - here.motion.log_ratio - step * by[heavier]
            off.append(jump / np.hypot(roughness, np.hypot(here.motion.u, near.u)))
    assert len(off) >= 4 * count
    assert jumps >= 4, "the jumps are larger than the scatter at one place"
    # seven places with four dependent values each: ± 18 %, three times that
    assert least < np.sqrt(np.mean(np.square(off))) < most
    assert np.abs(off).max() < LIMIT


@pytest.mark.usefixtures("spacing")
def test_a_gap_with_an_irregular_mean_adds_little_to_one_with_an_orbit():
    """The jumps of the mean are its uncertainty, which the result states."""
    one, both = (
        identify(with_known_e(np.random.default_rng(2), RigConfig(), gaps), RigConfig())
        for gaps in ((0.006,), (0.006, 0.0065))
    )
    assert 0.9 < both.u("m_1") / one.u("m_1") <= 1.0
    assert 5e-4 < both.irregular[0.0065] < 0.01


@pytest.mark.usefixtures("spacing")
def test_a_single_mass_ratio_gives_no_information_about_the_restitution():
    """It determines the masses at any e, less accurately where the motion is chaotic."""
    found = identify(synthetic(np.random.default_rng(0), RigConfig(), (0.0065,)), RigConfig())
    assert found.restitution == pytest.approx(0.35, abs=0.1 * U_RESTITUTION)
    assert found.u_restitution == pytest.approx(U_RESTITUTION, rel=0.1)
    assert abs(found.log_constants - logarithms(RigConfig()))[2] < LIMIT * found.information.u_relative[2]


def test_a_narrow_minimum_in_e_is_found(monkeypatch):
    """A minimum of χ² only 0.0025 wide can be deeper by 12 or more than a broad one, and can be anywhere."""
    profile = fit._Profile(synthetic(np.random.default_rng(0), RigConfig(), (0.006,)), RigConfig())
    start = logarithms(RigConfig())
    at_nominal = profile._fit(0.35, start, np.zeros(len(NUISANCES)))
    for narrow in np.random.default_rng(1).uniform(0.30, 0.40, 20):

        def fitted(e, *_, narrow=narrow):
            misfit = min(((e - 0.34) / 0.01) ** 2, 100.0) - (112.0 if abs(e - narrow) < 0.00125 else 0.0)
            return attrs.evolve(at_nominal, e=e, misfit=misfit)

        monkeypatch.setattr(profile, "_fit", fitted)
        held = profile.run([start], np.zeros(len(NUISANCES)), lambda _: None)
        assert abs(min(held, key=lambda one: one.cost).e - narrow) < 0.00125


@pytest.mark.parametrize("draws", [40, pytest.param(150, marks=pytest.mark.slow)])
def test_stated_uncertainties_cover_the_truth(draws):
    """Over many experiments, the errors of all combinations reported as known agree with their uncertainties."""
    rng, truth = np.random.default_rng(1), logarithms(TRUTH)
    off = []
    for _ in range(draws):
        found = identify(synthetic(rng), RigConfig())
        known = [one for one in found.information.combinations if one.determined]
        assert len(known) == len(NAMES) - 1
        off.append([one.powers @ (found.log_constants - truth) / one.u_relative for one in known])
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all(np.abs(spread - 1.0) < 3.1 / np.sqrt(2 * draws)), spread
    assert np.all(np.abs(np.mean(off, axis=0)) < 3.0 / np.sqrt(draws) * 1.1), np.mean(off, axis=0)


def test_data_without_impacts_determine_only_ratios_of_masses_and_forces():
    found = identify(synthetic(np.random.default_rng(2)), RigConfig())
    assert found.information.determined("f_n")
    assert found.information.determined("ζ")
    assert not [name for name in SCALED if found.information.determined(name)]
    (unknown,) = [one for one in found.information.combinations if not one.determined]
    assert unknown.powers == pytest.approx([float(name in SCALED) for name in NAMES], abs=1e-3)
    assert unknown.u_relative == np.inf
    ratio = found.value("m_1") / found.value("K_f")
    assert ratio == pytest.approx(TRUTH.structure.mass_kg / TRUTH.shaker.force_factor_n_a, rel=0.02)


def test_a_point_with_an_invalid_current_yields_transmissibility_and_phase():
    measured = synthetic(np.random.default_rng(2))
    measured.sine.base_per_a[1] = np.nan
    ratio = [identify(measured, RigConfig()).value(name) for name in ("m_1", "K_f")]
    assert ratio[0] / ratio[1] == pytest.approx(TRUTH.structure.mass_kg / TRUTH.shaker.force_factor_n_a, rel=0.02)


def test_a_decay_alone_yields_only_frequency_and_damping_and_this_is_reported():
    measured = attrs.evolve(synthetic(np.random.default_rng(3)), sine=None)
    found = identify(measured, RigConfig())
    assert [name for name in NAMES if found.information.determined(name)] == ["f_n", "ζ"]


def test_an_effect_that_a_nuisance_parameter_can_imitate_adds_no_information():
    slopes = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 100.0], [0.0, 0.0]])
    nuisance = np.array([[1.0], [1.0], [0.0], [10.0]])  # a gain error of 10 %, common to the first two
    alone, shared = information(("a", "b"), slopes), information(("a", "b"), slopes, nuisance)
    assert alone.u_relative == pytest.approx([2**-0.5, 0.01])
    assert shared.u_relative == pytest.approx([np.sqrt(0.5 + 0.01), 0.01], rel=1e-9)


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    """Measured runs of TRUTH through its instruments: ten points without the sphere, two gaps."""
    folder = tmp_path_factory.mktemp("identify")
    file = folder / "runs.yaml"
    truth = {
        "structure": attrs.asdict(TRUTH.structure),
        "shaker": {k: v for k, v in attrs.asdict(TRUTH.shaker).items() if not k.endswith(("min_hz", "max_hz"))},
    }
    file.write_text(
        f"set: {json.dumps(truth)}\nstudies:\n  sine: {{frequencies_hz: {list(FREQUENCIES_HZ)}, gaps_m: none}}\n"
        f"  gaps: {{frequencies_hz: 9.1, gaps_m: {list(GAPS)}}}\n"
    )
    campaign = load_campaign(file)
    store = run.prepare(campaign, folder / "out", "process")
    for job in run.unique_jobs(campaign.planned()):
        store.put(job, execute(job))
    return folder / "out"


@pytest.mark.usefixtures("spacing")
def test_a_measured_rig_is_identified_within_its_uncertainties(directory):
    done = run.open_finished(directory)
    base, curves = done.campaign.base, done.curves
    gains = Gains.of(Rig(base).info().rows)
    reduced = reduced_of(curves, 9.1, GAPS, gains)
    assert reduced is not None
    assert reduced.effects.shape == (2, len(NUISANCES))
    measured = Measured(
        gains=gains,
        decay=measured_decay(base),
        sine=sine_of([point for _, point in sorted(curves.by_gap[0.0].items())], gains),
        reduced=reduced,
        u_restitution=0.005,  # as of a drop test
    )
    found = identify(measured, RigConfig())
    for name, truth in zip(NAMES, np.exp(logarithms(TRUTH)), strict=True):
        assert found.information.determined(name), name
        assert abs(found.value(name) - truth) < LIMIT * found.u(name), (name, found.value(name), found.u(name), truth)
    assert found.u("m_1") < 0.01 * found.value("m_1")
    assert abs(found.restitution - 0.35) < LIMIT * found.u_restitution
    assert found.chi_square < 2.0 * found.freedom


def test_a_regime_without_counted_impacts_contradicts_no_prediction(directory):
    """A light sphere strikes irregularly while the amplitude is constant: only an accelerometer can show this."""
    done = run.open_finished(directory)
    gains = Gains.of(Rig(done.campaign.base).info().rows)
    points = [attrs.evolve(point, rows=point.rows.copy()) for point in done.points]
    counted = reduced_of(Curves.of(points), 9.1, GAPS, gains)
    for point in points:
        point.rows["impacts_per_cycle"] = np.nan
    blind = reduced_of(Curves.of(points), 9.1, GAPS, gains)
    assert Regime.PERIODIC.value in counted.regimes.values()
    assert set(blind.regimes.values()) == {Regime.UNKNOWN.value}
    assert blind.ratio == counted.ratio


def test_the_command_writes_determined_and_undetermined_constants(directory, capsys):
    (directory / "identified.yaml").write_text("{}")  # of an earlier fit
    assert main(["identify", str(directory), "--without", "reductions"]) == 0
    output = capsys.readouterr().out
    assert output.splitlines()[-1] == str(directory)
    assert output.count("not determined by these data") == len(SCALED)
    found = json.loads((directory / "identification.json").read_text())
    assert found["constants"]["m_1"] == {"value": None, "standard_uncertainty": None, "unit": "kg", "determined": False}
    zeta = found["constants"]["ζ"]
    assert abs(zeta["value"] - TRUTH.structure.damping_ratio) < LIMIT * zeta["standard_uncertainty"]
    assert not (directory / "identified.yaml").exists()
    assert (
        "no identified.yaml is written, because the data do not determine all constants; that of an earlier fit is "
        "removed"
    ) in " ".join(output.split())
    assert main(["identify", str(directory), "--without", "reductions", "sine", "decay"]) == 1
    assert "nothing to identify from" in capsys.readouterr().err


def test_a_decay_is_measured_through_the_instruments():
    decay = measured_decay(TRUTH)
    assert decay.status is Status.OK
    assert decay.damping_ratio == pytest.approx(TRUTH.structure.damping_ratio, abs=LIMIT * decay.u_damping_ratio)


def test_a_pluck_with_the_sphere_is_rejected(directory, tmp_path, capsys):
    """The result would be a ζ nearly twice that of the structure."""
    struck = Rig(TRUTH)
    struck.pluck(DISPLACEMENT_M)
    scans = [("daq/scan", block.scan) for block in struck.advance(8 * NS_PER_S)]
    record(
        tmp_path / "struck", [("daq/info", struck.info()), *(("rig/journal", t) for t in struck.take_journal()), *scans]
    )
    arguments = ["identify", str(directory), "--without", "reductions", "sine", "--decay", str(tmp_path / "struck")]
    assert main(arguments) == 1
    assert "the accelerometer shows impacts" in capsys.readouterr().err.replace("\n", " ")


def test_a_recorded_pluck_yields_the_result_of_a_pluck_by_the_command(directory, tmp_path, capsys):
    """`--decay RUN`: the last pluck of a run that the recorder wrote, or an error that says what is missing."""
    plucked = Rig(from_flat(TRUTH, {"sphere.present": False}))
    quiet = [("daq/info", plucked.info()), *(("rig/journal", table) for table in plucked.take_journal())]
    quiet += [("daq/scan", block.scan) for block in plucked.advance(200_000_000)]
    record(tmp_path / "quiet", quiet)
    plucked.pluck(DISPLACEMENT_M)
    swinging = [("daq/scan", block.scan) for block in plucked.advance(round((RECORD_S + 0.2) * NS_PER_S))]
    record(tmp_path / "plucked", [*quiet, *(("rig/journal", table) for table in plucked.take_journal()), *swinging])
    with open_run(tmp_path / "plucked") as recorded:
        decay = recorded_decay(recorded)
    own = measured_decay(TRUTH)
    for name in ("natural_frequency_hz", "damping_ratio"):
        assert getattr(decay, name) == pytest.approx(getattr(own, name), abs=LIMIT * getattr(own, f"u_{name}"))
    arguments = ["identify", str(directory), "--without", "reductions", "sine", "--decay"]
    assert main([*arguments, str(tmp_path / "plucked")]) == 0
    assert (
        f"free decay: f_n {plus_minus(decay.natural_frequency_hz, decay.u_natural_frequency_hz)} Hz"
        in capsys.readouterr().out
    )
    assert main([*arguments, str(tmp_path / "plucked"), "--decrement"]) == 0
    line = re.search(r"free decay: f_n ([0-9.]+) ± ([0-9.]+) Hz", capsys.readouterr().out)
    found, u2 = map(float, line.groups())
    assert found != round(decay.natural_frequency_hz, 6), "it is another estimate"
    assert found == pytest.approx(decay.natural_frequency_hz, abs=2 * u2 + 1e-6)
    assert main([*arguments, str(tmp_path / "plucked"), "--rig", "/left"]) == 1
    assert "/left" in capsys.readouterr().err
    assert main([*arguments, str(tmp_path / "quiet")]) == 1
    assert "no pluck in this run (rig/pluck)" in capsys.readouterr().err


@pytest.mark.parametrize("ended_by", ["lost blocks", "reset"])
def test_a_recorded_decay_ends_at_the_first_gap_of_its_scans(tmp_path, ended_by):
    """Later scans do not belong to the decay: a jump would count as impacts, the next drive as vibration."""
    plucked = Rig(from_flat(TRUTH, {"sphere.present": False}))
    plucked.pluck(DISPLACEMENT_M)
    scans = [("daq/scan", block.scan) for block in plucked.advance(8 * NS_PER_S)]
    if ended_by == "reset":
        plucked.reset()
        plucked.accept(9.5, 0.5)
    later = [("daq/scan", block.scan) for block in plucked.advance(plucked.frontier_ns + 4 * NS_PER_S)]
    beside = [("daq/info", plucked.info()), *(("rig/journal", table) for table in plucked.take_journal())]
    record(tmp_path / "alone", [*beside, *scans])
    record(tmp_path / "more", [*beside, *scans, *later[3 if ended_by == "lost blocks" else 0 :]])
    found = []
    for name in ("alone", "more"):
        with open_run(tmp_path / name) as recorded:
            found.append(recorded_decay(recorded))
    assert found[0] == found[1]
    assert found[0].status is Status.OK


def test_an_unfinished_fit_to_the_paper_reports_the_reductions_of_its_constants(monkeypatch):
    """Constants and reductions in the result must belong to the same rig, also after the last step."""
    monkeypatch.setattr(paper_fit, "ITERATIONS", 1)
    found = paper_fit.fit_paper(RigConfig(), ("ζ",))
    assert not found.converged
    fitted = from_flat(RigConfig(), {"structure.damping_ratio": found.fitted["ζ"]})
    (gap, percent), *_ = found.points.items()
    motion = simulated(fitted, gap, 9.1, paper.CURRENT_A)
    assert percent == pytest.approx(100.0 * (1.0 - np.exp(motion.log_ratio)), abs=1e-6)


def test_the_fit_to_the_paper_takes_no_campaign(capsys):
    assert main(["identify", "runs/campaign", "--paper"]) == 1
    assert "--paper fits the paper's reductions of DT and takes no directory" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--paper", "--decay", "runs/pluck"], "--decay applies only to a campaign"),
        (["--paper", "--e-uncertainty", "0.1"], "--e-uncertainty applies only to a campaign"),
        (["runs/campaign", "--config", "rig.yaml"], "--config applies only to --paper"),
        (["runs/campaign", "--rig", "/a"], "--rig applies only to the run of --decay"),
        (["runs/campaign", "--decay", "runs/pluck", "--without", "decay"], "--decay applies to the free decay, which"),
        (["runs/campaign", "--decrement", "--without", "decay"], "--decrement applies to the free decay, which"),
    ],
)
def test_an_option_without_an_effect_is_rejected(capsys, words, says):
    assert main(["identify", *words]) == 1
    assert says in capsys.readouterr().err


@pytest.mark.slow
def test_the_shipped_rig_is_near_the_best_fit_to_the_paper():
    """As docs/how-to/identification.md says, f_n and ζ follow from the five reductions, but the current does not."""
    found = paper_fit.fit_paper(RigConfig())
    shipped = {"f_n": RigConfig().structure.natural_frequency_hz, "ζ": RigConfig().structure.damping_ratio}
    assert found.converged
    assert found.rms_points <= found.default_rms_points < 1.0
    for name, value in shipped.items():
        assert abs(found.fitted[name] - value) < LIMIT * found.u[name], name
    assert not all(one.determined for one in found.information.combinations)
