# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Identification finds the constants of a rig within its stated uncertainties, and says what data cannot tell."""

from __future__ import annotations

import json
import re

import attrs
import numpy as np
import pytest
from kits.recorded_rig import record

from impact_rig.analysis.decay import Decay
from impact_rig.analysis.words import Status
from impact_rig.campaign import run
from impact_rig.campaign.in_process import execute
from impact_rig.campaign.paper import FREQUENCIES_HZ
from impact_rig.campaign.plan import load_campaign
from impact_rig.cli import main
from impact_rig.physics.closed_form import base_amplitude, transmissibility
from impact_rig.recording import open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig.studies.identification.constants import NAMES, SCALED, logarithms, rig
from impact_rig.studies.identification.fisher import information
from impact_rig.studies.identification.fit import identify
from impact_rig.studies.identification.measurements import NUISANCES, Gains, Measured, SineData, reduced_of, sine_of
from impact_rig.studies.identification.paper_fit import fit_paper
from impact_rig.studies.identification.pluck import DISPLACEMENT_M, RECORD_S, measured_decay, recorded_decay

TRUTH = rig(RigConfig(), logarithms(RigConfig()) + np.array([0.002, 0.25, 0.15, -0.1, 0.1, 0.08, 0.2]))
"""Not the shipped rig: m_1 = 0.151 kg, ζ = 0.0058, ..."""
NOISE = 3e-4
LIMIT = 3.0
"""Standard uncertainties by which a constant may be off: by chance once in 370."""
GAPS = (0.004, 0.010)


def synthetic(rng):
    """Return measurements of TRUTH in closed form, with errors drawn as the certificate says."""
    gains = Gains.of(Rig(TRUTH).info().rows)
    frequency = np.array(FREQUENCIES_HZ)
    ratio, per_ampere = transmissibility(TRUTH, frequency), np.abs(base_amplitude(TRUTH, frequency))
    base = 0.52 * per_ampere
    laser = base * np.abs(ratio)
    errors = np.append(rng.normal(0.0, gains.u), 0.0)
    on_laser, on_base, on_current = gains.relative(1, laser) @ errors, gains.relative(2, base) @ errors, errors[2]
    n, u = len(frequency), np.full(len(frequency), NOISE)
    sine = SineData(
        frequency, np.abs(ratio) * np.exp(on_laser - on_base + rng.normal(0, NOISE, n)),
        np.angle(ratio) + rng.normal(0, NOISE, n), per_ampere * np.exp(on_base - on_current + rng.normal(0, NOISE, n)),
        laser, base, u, u,
    )  # fmt: skip
    structure = TRUTH.structure
    decay = Decay(
        status=Status.OK, natural_frequency_hz=structure.natural_frequency_hz * (1 + rng.normal(0, 1e-5)),
        damping_ratio=structure.damping_ratio * (1 + rng.normal(0, 1e-3)),
        u_natural_frequency_hz=structure.natural_frequency_hz * 1e-5, u_damping_ratio=structure.damping_ratio * 1e-3,
    )  # fmt: skip
    return Measured(gains=gains, decay=decay, sine=sine)


@pytest.mark.repeats
def test_stated_uncertainties_cover_the_truth():
    """Over 150 experiments, every combination that is said to be known is off by its standard uncertainty."""
    rng, truth = np.random.default_rng(1), logarithms(TRUTH)
    off = []
    for _ in range(150):
        found = identify(synthetic(rng), RigConfig())
        known = [one for one in found.information.combinations if one.determined]
        assert len(known) == len(NAMES) - 1
        off.append([one.powers @ (found.log_constants - truth) / one.u_relative for one in known])
    spread = np.sqrt(np.mean(np.square(off), axis=0))
    assert np.all((spread > 0.82) & (spread < 1.18)), spread  # 150 draws: ± 5.8 % each, three times that
    assert np.all(np.abs(np.mean(off, axis=0)) < 3.0 / np.sqrt(150) * 1.1), np.mean(off, axis=0)


def test_without_impacts_only_ratios_of_masses_and_forces_are_known():
    found = identify(synthetic(np.random.default_rng(2)), RigConfig())
    assert found.information.determined("f_n")
    assert found.information.determined("ζ")
    assert not [name for name in SCALED if found.information.determined(name)]
    (unknown,) = found.information.unknown()
    assert unknown.powers == pytest.approx([float(name in SCALED) for name in NAMES], abs=1e-3)
    assert unknown.u_relative == np.inf
    ratio = found.value("m_1") / found.value("K_f")
    assert ratio == pytest.approx(TRUTH.structure.mass_kg / TRUTH.shaker.force_factor_n_a, rel=0.02)


def test_a_decay_alone_tells_frequency_and_damping_and_says_so():
    measured = attrs.evolve(synthetic(np.random.default_rng(3)), sine=None)
    found = identify(measured, RigConfig())
    assert [name for name in NAMES if found.information.determined(name)] == ["f_n", "ζ"]


def test_what_a_nuisance_can_imitate_is_no_information():
    slopes = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 100.0], [0.0, 0.0]])
    nuisance = np.array([[1.0], [1.0], [0.0], [10.0]])  # a gain error of 10 %, common to the first two
    alone, shared = information(("a", "b"), slopes), information(("a", "b"), slopes, nuisance)
    assert alone.u_relative == pytest.approx([2**-0.5, 0.01])
    assert shared.u_relative == pytest.approx([np.sqrt(0.5 + 0.01), 0.01], rel=1e-9)


@pytest.fixture(scope="module")
def directory(tmp_path_factory):
    """Measured runs of TRUTH, through its instruments: ten points without sphere, two gaps."""
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
    )
    found = identify(measured, RigConfig())
    for name, truth in zip(NAMES, np.exp(logarithms(TRUTH)), strict=True):
        assert found.information.determined(name), name
        assert abs(found.value(name) - truth) < LIMIT * found.u(name), (name, found.value(name), found.u(name), truth)
    assert found.u("m_1") < 0.01 * found.value("m_1")
    assert found.chi_square < 2.0 * found.freedom


def test_the_command_writes_what_it_found_and_what_it_could_not(directory, capsys):
    assert main(["identify", str(directory), "--without", "reductions"]) == 0
    output = capsys.readouterr().out
    assert output.splitlines()[-1] == str(directory)
    assert output.count("not determined by these data") == len(SCALED)
    found = json.loads((directory / "identification.json").read_text())
    assert found["constants"]["m_1"] == {"value": None, "standard_uncertainty": None, "unit": "kg", "determined": False}
    zeta = found["constants"]["ζ"]
    assert abs(zeta["value"] - TRUTH.structure.damping_ratio) < LIMIT * zeta["standard_uncertainty"]
    assert not (directory / "identified.yaml").exists()
    assert main(["identify", str(directory), "--without", "reductions", "sine", "decay"]) == 1
    assert "nothing to identify from" in capsys.readouterr().err


def test_a_decay_is_measured_through_the_instruments():
    decay = measured_decay(TRUTH)
    assert decay.status is Status.OK
    assert decay.damping_ratio == pytest.approx(TRUTH.structure.damping_ratio, abs=LIMIT * decay.u_damping_ratio)


def test_a_recorded_pluck_gives_what_a_pluck_of_our_own_gives(directory, tmp_path, capsys):
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
    assert f"free decay: f_n {decay.natural_frequency_hz:.6f}" in capsys.readouterr().out
    assert main([*arguments, str(tmp_path / "plucked"), "--decrement"]) == 0
    told = re.search(r"free decay: f_n ([0-9.]+) ± ([0-9.]+) Hz", capsys.readouterr().out)
    found, u2 = map(float, told.groups())
    assert found != round(decay.natural_frequency_hz, 6), "it is another estimate"
    assert found == pytest.approx(decay.natural_frequency_hz, abs=2 * u2 + 1e-6)
    assert main([*arguments, str(tmp_path / "quiet")]) == 1
    assert "nothing was plucked in this run (rig/pluck)" in capsys.readouterr().err


@pytest.mark.slow
def test_the_shipped_rig_is_near_the_best_fit_to_the_paper():
    """As docs/identification.md says: f_n and ζ follow from five reductions; a free current as well would not."""
    found = fit_paper(RigConfig())
    shipped = {"f_n": RigConfig().structure.natural_frequency_hz, "ζ": RigConfig().structure.damping_ratio}
    assert found.converged
    assert found.rms_points <= found.default_rms_points < 1.0
    for name, value in shipped.items():
        assert abs(found.fitted[name] - value) < LIMIT * found.u[name], name
    assert found.information.unknown()
