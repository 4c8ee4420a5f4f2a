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
"""The rig without impacts against closed forms: transmissibility, shaker, free decay."""

from __future__ import annotations

import math

import numpy as np
import pytest
from kits.mechanics import TWO_PI, at_rest, lock_in, of, prescribed, rig, sine, transmissibility
from scipy.integrate import solve_ivp

from impact_rig.errors import ConfigError
from impact_rig.physics import Simulation
from impact_rig.physics.linear import constants
from impact_rig.rig.config import RigConfig
from impact_rig.rig.core import tried_model

FREQUENCIES_HZ = (0.5, 5.0, 7.5, 9.0, 9.1, 9.105, 9.2, 10.5, 50.0, 200.0)
SETTLED_S = 150.0  # 38 time constants of the structure on a prescribed base
TOLERANCE = 1e-9


def settled(config: RigConfig, frequency_hz: float, amplitude: float, name: str) -> complex:
    """Complex amplitude of a quantity, long after the drive was switched on at rest."""
    simulation = Simulation(config)
    begin = math.ceil(SETTLED_S * frequency_hz) / frequency_hz
    motion = simulation.advance(sine(frequency_hz, amplitude, begin + 10.0 / frequency_hz))
    return lock_in(motion, name, frequency_hz, begin, 10)


@pytest.mark.parametrize("frequency_hz", FREQUENCIES_HZ)
def test_the_transmissibility_of_a_prescribed_base_is_the_closed_form(frequency_hz):
    config = prescribed(sphere={"present": False})
    got = settled(config, frequency_hz, 1e-4, "x_1") / settled(config, frequency_hz, 1e-4, "x_b")
    assert got == pytest.approx(transmissibility(config, frequency_hz), rel=TOLERANCE)


def test_a_run_that_starts_on_the_steady_state_stays_there():
    frequency_hz, amplitude, config = 9.1, 1e-4, prescribed(sphere={"present": False})
    x = amplitude * transmissibility(config, frequency_hz)
    omega = TWO_PI * frequency_hz
    simulation = Simulation(config)
    simulation.place(x_1=x.imag, v_1=(1j * omega * x).imag)
    motion = simulation.advance(sine(frequency_hz, amplitude, 0.01, 1000))
    segment = np.arange(1000)
    wanted = (x * np.exp(1j * omega * 0.01 * segment)).imag
    got = motion.quantity("x_1", segment, np.zeros(1000))
    assert np.abs(got - wanted).max() <= 1e-11 * abs(x)


def test_the_peak_of_the_transmissibility_is_at_the_predicted_frequency():
    config = prescribed(sphere={"present": False})
    zeta = config.structure.damping_ratio
    r = math.sqrt((math.sqrt(1.0 + 8.0 * zeta**2) - 1.0) / (4.0 * zeta**2))
    peak_hz = r * config.structure.natural_frequency_hz
    below, at, above = (abs(settled(config, peak_hz * (1.0 + shift), 1e-4, "x_1")) for shift in (-1e-5, 0.0, 1e-5))
    assert below < at > above
    assert (at - below) == pytest.approx(at - above, rel=0.05), "the peak is not between its neighbours' middle"


def shaker_response(config: RigConfig, frequency_hz: float, force_per_unit: complex = 1.0) -> complex:
    """X_b for unit coil current."""
    c, omega = constants(config), TWO_PI * frequency_hz
    load = c.m_1 * omega**2 * transmissibility(config, frequency_hz)
    return c.force_factor / (c.k_f - c.m_base * omega**2 + 1j * omega * c.c_f - load) * force_per_unit


@pytest.mark.parametrize("frequency_hz", FREQUENCIES_HZ)
def test_the_base_at_constant_current_is_the_closed_form(frequency_hz):
    config = rig(sphere={"present": False})
    wanted = 0.52 * shaker_response(config, frequency_hz)
    assert settled(config, frequency_hz, 0.52, "x_b") == pytest.approx(wanted, rel=TOLERANCE)
    assert settled(config, frequency_hz, 0.52, "x_1") == pytest.approx(
        wanted * transmissibility(config, frequency_hz), rel=TOLERANCE
    )


@pytest.mark.parametrize("frequency_hz", [5.0, 9.105, 48.5, 200.0])
def test_a_published_shaker_at_constant_voltage_is_the_closed_form(frequency_hz):
    """LDS V203: the coil's current is (V − K v_b) / (R + jωL), and the base follows it."""
    config = rig(
        sphere={"present": False},
        drive={"kind": "voltage"},
        shaker={
            "armature_mass_kg": 0.0312,
            "base_mass_kg": 0.0,
            "suspension_stiffness_n_m": 2897.0,
            "damping_n_s_m": 6.85,
            "coil_resistance_ohm": 1.6,
            "coil_inductance_h": 764e-6,
            "force_factor_n_a": 3.744,
        },
    )
    tried_model(config)  # a legal rig
    omega = TWO_PI * frequency_hz
    per_current = shaker_response(config, frequency_hz)
    current = 0.3 / (1.6 + 1j * omega * 764e-6 + 3.744 * 1j * omega * per_current)
    assert settled(config, frequency_hz, 0.3, "current") == pytest.approx(current, rel=TOLERANCE)
    assert settled(config, frequency_hz, 0.3, "x_b") == pytest.approx(current * per_current, rel=TOLERANCE)


@pytest.mark.parametrize("zeta", [1e-6, 0.0045, 0.3, 0.95])
def test_the_free_decay_of_the_locked_rig_is_the_closed_form(zeta):
    config = rig(structure={"damping_ratio": zeta}, sphere={"present": False})
    simulation = Simulation(config)
    simulation.pluck(5e-3)
    motion = simulation.advance(sine(9.1, 0.5, 0.01, 500))  # the drive does not move a locked base
    t = 0.01 * np.arange(500)
    omega = TWO_PI * 9.105
    omega_d = omega * math.sqrt(1.0 - zeta**2)
    wanted = 5e-3 * np.exp(-zeta * omega * t) * (np.cos(omega_d * t) + zeta * omega / omega_d * np.sin(omega_d * t))
    got = motion.quantity("x_1", np.arange(500), np.zeros(500))
    assert np.abs(got - wanted).max() <= 1e-12 * 5e-3 * 100
    assert not motion.quantity("x_b", np.arange(500), np.zeros(500)).any()


def test_a_locked_rig_adopts_a_new_configuration():
    """It decays as the new structure does, and its sphere begins at the new wall.

    Structure, gap and law must not stay those of the pluck until the reset.
    """
    simulation = Simulation(rig(sphere={"present": False}))
    simulation.pluck(5e-3)
    other = rig(sphere={"present": False}, structure={"damping_ratio": 0.05, "natural_frequency_hz": 20.0})
    simulation.configure(other)
    motion = simulation.advance(sine(9.1, 0.5, 0.01, 100))  # and is still locked
    simulation.reset()
    simulation.configure(other)
    simulation.pluck(5e-3)
    wanted = simulation.advance(sine(9.1, 0.5, 0.01, 100))
    instants = np.arange(100), np.zeros(100)
    assert np.array_equal(motion.quantity("x_1", *instants), wanted.quantity("x_1", *instants))
    assert not motion.quantity("x_b", *instants).any()

    simulation.configure(rig(barriers={"gap_m": 2e-3}))
    assert simulation.locked
    assert simulation.state()[5] == -1e-3


def test_a_configuration_without_a_model_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = Simulation(rig(sphere={"present": False}))
    simulation.advance(sine(9.1, 0.5, 0.01, 10))
    before, config = simulation.state(), simulation.config

    def without_modes(*_: object, **__: object) -> None:
        raise ConfigError("no modes")

    monkeypatch.setattr("impact_rig.physics.simulation.build", without_modes)
    with pytest.raises(ConfigError, match="no modes"):
        simulation.configure(rig(structure={"damping_ratio": 0.05}))
    assert simulation.config is config
    np.testing.assert_array_equal(simulation.state(), before)


def test_a_restored_state_without_a_sphere_has_no_friction():
    """Otherwise, the friction of the guide would push the structure to one side and count as a loss."""
    simulation = Simulation(rig(sphere={"present": False, "guide_friction": 0.3}), account=True)
    simulation.advance(sine(9.1, 0.5, 0.01, 37))
    twin = simulation.copy()
    twin.set_state(simulation.state())
    motions = [one.advance(sine(9.1, 0.5, 0.01, 100, first=37)) for one in (simulation, twin)]
    ticks, zeros = np.arange(37, 137), np.zeros(100)
    assert np.array_equal(*(motion.quantity("x_1", ticks, zeros) for motion in motions))
    assert twin.energy().friction == 0.0
    assert abs(twin.energy().imbalance) < 1e-12 * twin.energy().work


def test_the_logarithmic_decrement_yields_the_damping_ratio():
    config = rig(sphere={"present": False})
    simulation = Simulation(config)
    simulation.pluck(5e-3)
    zeta = config.structure.damping_ratio
    period = 1.0 / (9.105 * math.sqrt(1.0 - zeta**2))
    motion = simulation.advance(at_rest(51 * period))
    x_0, x_50 = of(motion, "x_1", np.array([0.0, 50 * period]))
    decrement = math.log(x_0 / x_50) / 50
    assert decrement / math.hypot(TWO_PI, decrement) == pytest.approx(zeta, rel=1e-9)


def test_a_centred_sphere_in_a_wide_gap_never_touches_a_wall():
    simulation = Simulation(rig(sphere={"start": "centre"}, barriers={"gap_m": 10.001e-3}))
    simulation.pluck(5e-3)
    simulation.place(x_1=5e-3, d=-5e-3)  # at rest at zero: pluck has put it on the moved rig's centre
    motion = simulation.advance(at_rest(20.0))
    assert len(motion.impacts) == 0


@pytest.mark.heavy
@pytest.mark.parametrize("kind", ["prescribed", "current", "voltage"])
def test_a_ramped_drive_agrees_with_another_integrator(kind):
    """(A + B t) sin(ωt + φ) at rest: no closed form in textbooks, so SciPy's order 8 is the judge."""
    config = rig(drive={"kind": kind}, sphere={"present": False})
    c = constants(config)
    omega, phase, level, slope = 50.0, 0.7, 1e-3, 0.02

    def drive(t):
        angle = omega * t + phase
        a = level + slope * t
        return a * math.sin(angle), slope * math.sin(angle) + a * omega * math.cos(angle)

    def rates(t, y):
        x_1, v_1, x_b, v_b, i = y
        u, du = drive(t)
        if kind == "prescribed":
            x_b, v_b = u, du
        column = -c.k_1 * (x_1 - x_b) - c.c_1 * (v_1 - v_b)
        current = i if kind == "voltage" else u
        table = (c.force_factor * current - c.c_f * v_b - c.k_f * x_b - column) / c.m_base
        coil = (u - c.resistance * i - c.force_factor * v_b) / c.inductance
        return [v_1, column / c.m_1, v_b, table, coil]

    motion = Simulation(config).advance(np.array([(0.5, omega, phase, level, slope, 0.0)], sine(1, 1, 1).dtype))
    t = np.linspace(0.0, 0.5, 21)
    other = solve_ivp(rates, (0.0, 0.5), np.zeros(5), "DOP853", t, rtol=1e-12, atol=1e-16)
    names = ("x_1", "v_1") if kind == "prescribed" else ("x_1", "v_1", "x_b", "v_b")
    for name, wanted in zip(names, other.y, strict=False):
        got = of(motion, name, t)
        assert np.abs(got - wanted).max() <= 1e-9 * np.abs(wanted).max(), name
    if kind == "voltage":
        assert np.abs(of(motion, "current", t) - other.y[4]).max() <= 1e-9 * np.abs(other.y[4]).max()
