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
"""Any rig that the configuration accepts: no NaN, no hang, no energy from nowhere; what makes no sense is refused."""

from __future__ import annotations

import json
import math
import re
import sys
from collections import Counter
from pathlib import Path

import attrs
import numpy as np
import pytest
from hypothesis import event, given, settings
from hypothesis import strategies as st
from kits.mechanics import limit_case, rig, sine

from impact_rig.config.sections import FASTEST_HZ, SLOWEST_HZ
from impact_rig.errors import ConfigError
from impact_rig.physics import EnergyAccount, Motion, Simulation
from impact_rig.physics.contact import LAWS
from impact_rig.physics.contact.law import LEAST_RESTITUTION
from impact_rig.physics.model import CONTACT_RTOL, STANDARD_GRAVITY, build
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat

sys.path.insert(0, str(Path(__file__).parents[3]))  # the tool is no part of the package

from qualification import legal_configurations

FOUND = json.loads(Path(__file__).with_name("data").joinpath("found_rigs.json").read_text())
ANY_FREQUENCY = {"frequency_min_hz": SLOWEST_HZ, "frequency_max_hz": FASTEST_HZ}
CYCLES = 12
LONGEST_S = 2.0
PER_CYCLE = 50
ENERGY_TOLERANCE = 100.0 * CONTACT_RTOL  # which the integrators keep in each step
ROUNDING = 1e-14  # of the largest term of a position, with a margin


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers spread evenly over their logarithm."""
    return st.floats(math.log10(low), math.log10(high)).map(lambda x: 10.0**x)


@st.composite
def configs(draw: st.DrawFn) -> RigConfig:
    frequency = draw(decades(0.5, 0.99 * FASTEST_HZ))
    kind = draw(st.sampled_from(["prescribed", "current", "voltage"]))
    return rig(
        structure={
            "mass_kg": draw(decades(1e-3, 99.0)),
            "natural_frequency_hz": draw(decades(0.1, 1000.0)),
            "damping_ratio": draw(decades(1e-6, 0.99)),
        },
        shaker=ANY_FREQUENCY
        | {
            "armature_mass_kg": draw(decades(1e-2, 10.0)),
            "suspension_stiffness_n_m": draw(decades(1e2, 1e6)),
            "damping_n_s_m": draw(decades(1e-2, 1e3)),
        },
        drive={"kind": kind, "frequency_hz": frequency},
        sphere={
            "start": draw(st.sampled_from(["left", "centre", "right"])),
            "diameter_m": draw(decades(1e-4, 0.1)),
            "density_kg_m3": draw(decades(100.0, 2e4)),
            "young_modulus_pa": draw(decades(1e6, 1e12)),
            "guide_friction": draw(st.sampled_from([0.0, 0.0, 0.05, 1.0])),
        },
        barriers={"gap_m": draw(decades(1e-6, 1.0)), "young_modulus_pa": draw(decades(1e6, 1e12))},
        contact={
            "law": draw(st.sampled_from(tuple(LAWS))),
            "restitution": draw(st.floats(LEAST_RESTITUTION, 0.99)),
            "speed_floor_m_s": draw(decades(1e-6, 1e-2)),
            "contact_time_s": draw(decades(1e-6, 1e-3)),
            "release": draw(st.sampled_from(["position", "force"])),
        },
    )


@st.composite
def amplitudes(draw: st.DrawFn, config: RigConfig) -> float:
    """Nothing, anything, or what moves the base by something like the gap."""
    lively = config.barriers.gap_m * draw(decades(1e-2, 1e4))
    if config.drive.kind != "prescribed":
        lively *= config.shaker.suspension_stiffness_n_m / config.shaker.force_factor_n_a
    return draw(st.one_of(st.just(0.0), decades(1e-9, 1e3), st.just(lively)))


SPEEDS = st.sampled_from([0.0, 0.0, 1e-3, -0.5, 10.0])


def run(config: RigConfig, amplitude: float, speed: float) -> tuple[Simulation, Motion, np.ndarray, float]:
    """Simulate some cycles; return simulation, motion, samples and the energy [J] stored at the start."""
    simulation = Simulation(config, account=True)
    if speed:
        simulation.place(d_rate=speed)
    stored = simulation.stored_energy()
    cycle_s = min(1.0 / config.drive.frequency_hz, LONGEST_S / CYCLES)
    motion = simulation.advance(sine(config.drive.frequency_hz, amplitude, cycle_s, CYCLES))
    offsets = np.linspace(0.0, cycle_s, PER_CYCLE, endpoint=False)
    samples = motion.sample(np.repeat(np.arange(CYCLES), PER_CYCLE), np.tile(offsets, CYCLES))
    return simulation, motion, samples, stored


def assert_energy_closes(config: RigConfig, energy: EnergyAccount, motion: Motion, stored_before: float) -> None:
    """Allow what the integrators allow, the least speed that contacts start with, and rounding; nothing else."""
    p = build(config).parameters[0]
    exchanged = 0.5 * p.m_eff * (motion.impacts["approach_speed"] ** 2).sum()  # elastic impacts lose nothing of it
    turnover = abs(energy.work) + energy.columns + energy.shaker + abs(energy.contact) + energy.friction
    turnover += exchanged + 2.0 * stored_before + abs(energy.stored)
    touches = (len(motion.impacts) + CYCLES) * 0.5 * p.m_eff * p.touch_speed**2
    bend = (p.m * config.sphere.guide_friction * STANDARD_GRAVITY) ** 2 / p.k_1  # of the columns by friction
    assert abs(energy.imbalance) <= ENERGY_TOLERANCE * turnover + touches + ROUNDING * bend, energy


def assert_walls_hold(config: RigConfig, samples: np.ndarray, motion: Motion) -> None:
    """Outside the gap there is a force, never a pulling one, unless a contact has let go inside the wall.

    The sphere is then no further out than the contacts went since it was last between the walls.
    """
    contact = config.contact
    if contact.law == "kelvin_voigt" and contact.release == "position":
        return  # may pull, and has no force where spring and damper cancel
    force = samples["force_left"] + samples["force_right"]
    assert min(samples["force_left"].min(), samples["force_right"].min()) >= 0.0
    distance = samples["x_2"] - samples["x_1"]
    reach = config.barriers.gap_m / 2.0 * (1.0 + 1e-9) + ROUNDING * np.abs(samples["x_2"]).max()
    outside = np.abs(distance) > reach
    if contact.law == "restitution":
        assert not outside.any(), "the sphere has gone through a wall"
        return
    cycle_s = motion.segments["duration"][0]
    began = motion.impacts["tick"] + motion.impacts["offset"] / cycle_s
    ended = began + motion.impacts["duration"] / cycle_s
    instants = np.arange(len(samples)) / PER_CYCLE
    for i in np.flatnonzero(outside & (force == 0.0)):
        within = np.flatnonzero(~outside[:i])
        of_visit = (ended >= (instants[within[-1]] if len(within) else 0.0)) & (began <= instants[i])
        left_behind = motion.impacts["peak_indentation"][of_visit].sum()
        assert abs(distance[i]) - reach <= left_behind, "outside the gap without a force"


def assert_sane(config: RigConfig, amplitude: float, speed: float) -> int:
    """Run and check; return the number of impacts."""
    simulation, motion, samples, stored = run(config, amplitude, speed)
    for table in (samples, motion.impacts):
        for name in table.dtype.names:
            assert np.isfinite(table[name]).all(), name
    assert (motion.impacts["separation_speed"] >= 0.0).all()
    assert_energy_closes(config, simulation.energy(), motion, stored)
    assert_walls_hold(config, samples, motion)
    return len(motion.impacts)


@settings(max_examples=200)
@given(st.data())
@pytest.mark.repeats
def test_any_rig_runs_and_creates_no_energy(data):
    config = data.draw(configs())
    impacts = assert_sane(config, data.draw(amplitudes(config)), data.draw(SPEEDS))
    event(f"impacts: {next(n for n in (1000, 100, 10, 1, 0) if impacts >= n)} or more")


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ({"drive.kind": "voltage", "shaker.coil_inductance_h": 1e-7}, ">= 0.5 and <= 100000 1/s"),
        ({"shaker.damping_n_s_m": 1e5}, ">= 0.5 and <= 100000 1/s"),
        ({"sphere.diameter_m": 0.05}, "must not outweigh the superior base"),
    ],
)
def test_a_rig_that_cannot_be_resolved_is_rejected_at_the_start(values, rule):
    with pytest.raises(ConfigError, match=re.escape(rule)):
        Rig(from_flat(RigConfig(), values))


@pytest.mark.heavy
def test_random_valid_configurations_conserve_energy():
    """A slice of what `qualification/legal_configurations.py` tries, numbers of its first seed."""
    ends = Counter()
    for index in range(24):
        values, loudness = legal_configurations.drawn(1, index)
        result = legal_configurations.run(legal_configurations.legal(values), loudness, 0.3)
        assert result.ended not in legal_configurations.FAILURES, legal_configurations.report(index, 1, result)
        ends[result.ended] += 1
    assert ends[legal_configurations.OK] >= 12


@pytest.mark.heavy
@pytest.mark.parametrize("found", FOUND, ids=lambda found: found["story"])
def test_extreme_rigs_run_and_conserve_energy(found):
    sections = {"shaker": {}} | found["rig"]
    sections["shaker"] |= ANY_FREQUENCY
    with attrs.validators.disabled():  # some are beyond the ranges
        assert_sane(limit_case(**sections), found["amplitude"], found["speed_m_s"])


@pytest.mark.parametrize(
    ("section", "key", "value", "rule"),
    [
        ("structure", "mass_kg", -0.13, ">= 0.001"),
        ("structure", "mass_kg", 0.0, ">= 0.001"),
        ("structure", "natural_frequency_hz", math.nan, ">= 0.1"),
        ("structure", "damping_ratio", 1.0, ">= 1e-06 and < 1"),
        ("sphere", "density_kg_m3", -7850.0, ">= 100 and <= 100000"),
        ("sphere", "diameter_m", math.inf, ">= 0.0001"),
        ("sphere", "start", "top", "one of left, centre, right"),
        ("barriers", "gap_m", 0.0, ">= 1e-06 and <= 1"),
        ("barriers", "gap_m", -0.002, ">= 1e-06 and <= 1"),
        ("barriers", "gap_m", 1.5, ">= 1e-06 and <= 1"),
        ("contact", "restitution", 1.2, ">= 0.01 and <= 1"),
        ("contact", "restitution", 0.0, ">= 0.01 and <= 1"),
        ("contact", "law", "glue", "one of exact, flores,"),
        ("contact", "speed_floor_m_s", 0.0, ">= 1e-06"),
        ("drive", "amplitude", -1.0, ">= 0"),
    ],
)
def test_invalid_parameters_are_rejected_by_name(section, key, value, rule):
    with pytest.raises(ConfigError) as refused:
        rig(**{section: {key: value}})
    message = str(refused.value)
    assert key in message
    assert rule in message
    assert str(value) in message
