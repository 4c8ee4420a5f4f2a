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
"""The energy account: work = losses + what is stored, every term integrated on its own."""

from __future__ import annotations

import numpy as np
import pytest
from kits.mechanics import benchmark_rig, limit_case, rig, sine

from impact_rig.physics import EnergyAccount, Simulation
from impact_rig.physics.contact import LAWS
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.core import new_generator
from impact_rig.simtime import COMMAND_GRID_S

GAPS_M = (2e-3, 4e-3, 6e-3, 8e-3, 10e-3)
TOLERANCE = 1e-8  # of the work done over a thousand cycles
FREQUENCY_HZ = 9.1


def on_ticks(amplitude: float, cycles: int) -> np.ndarray:
    """Return about this many cycles in segments of the command grid, as in the rig: they cut contacts anywhere."""
    return sine(FREQUENCY_HZ, amplitude, COMMAND_GRID_S, round(cycles / (FREQUENCY_HZ * COMMAND_GRID_S)))


def account(config: RigConfig, amplitude: float, cycles: int) -> tuple[EnergyAccount, int]:
    """Energies and impacts of a run from rest, the sphere leaving the left wall fast enough to find an orbit."""
    simulation = Simulation(config, account=True)
    simulation.place(x_1=-4e-3, d=0.0, d_rate=0.15)
    motion = simulation.advance(on_ticks(amplitude, cycles))
    return simulation.energy(), len(motion.impacts)


def assert_closed(energy: EnergyAccount, tolerance: float = TOLERANCE) -> None:
    turnover = abs(energy.work) + energy.columns + energy.shaker + energy.contact + energy.friction
    assert energy.contact > 0.0
    assert energy.columns > 0.0
    assert abs(energy.imbalance) <= tolerance * abs(energy.work), (
        f"{energy.imbalance:g} J of {energy.work:g} J are missing (turnover {turnover:g} J): {energy}"
    )


@pytest.mark.heavy
@pytest.mark.parametrize("gap", GAPS_M)
def test_the_energy_balance_closes_over_a_thousand_cycles_at_constant_current(gap):
    energy, _ = account(rig(barriers={"gap_m": gap}), 0.52, 1000)
    assert_closed(energy)
    assert energy.shaker > 0.0


@pytest.mark.parametrize("law", [law for law in LAWS if law != "hertz"])
def test_the_energy_balance_closes_for_every_law(law):
    energy, impacts = account(benchmark_rig(contact={"law": law, "release": "force"}), 60e-6, 300)
    assert impacts > 500
    assert_closed(energy)


def test_contacts_of_hertz_lose_no_energy():
    simulation = Simulation(benchmark_rig(contact={"law": "hertz"}), account=True)
    simulation.place(x_1=-4e-3, d_rate=0.15)
    simulation.advance(on_ticks(60e-6, 300))
    energy = simulation.energy()
    assert energy.contact == 0.0
    assert abs(energy.imbalance) <= TOLERANCE * abs(energy.work)


@pytest.mark.parametrize("before", ["prescribed", "current", "voltage"])
@pytest.mark.parametrize("after", ["prescribed", "current", "voltage"])
def test_a_change_of_the_kind_of_drive_keeps_no_state_of_the_previous_one(before, after):
    """A coil fed with current must not keep the current and the energy that a voltage has left in it."""
    amplitude = {"prescribed": 3e-4, "current": 0.52, "voltage": 5.0}
    changed, fresh = (
        Simulation(rig(drive={"kind": kind}, barriers={"gap_m": 2e-3}), account=True) for kind in (before, after)
    )
    assert len(changed.advance(on_ticks(amplitude[before], 10)).impacts) > 5
    changed.configure(fresh.config)
    for one in (changed, fresh):
        one.place()  # the same instant, both at rest
    impacts = [len(one.advance(on_ticks(amplitude[after], 10)).impacts) for one in (changed, fresh)]
    assert impacts[0] == impacts[1] > 5
    assert changed.energy() == fresh.energy()


PRESCRIBED, RANDOM = {"drive.kind": "prescribed"}, {"drive.kind": "prescribed", "drive.waveform": "random"}
LINEAR = {"contact.law": "kelvin_voigt"}


@pytest.mark.parametrize(
    ("seconds", "values"),
    [
        (13, PRESCRIBED | LINEAR | {"drive.amplitude": 60e-6, "barriers.gap_m": 0.5e-3}),
        (11, PRESCRIBED | LINEAR | {"drive.amplitude": 60e-6, "barriers.gap_m": 1e-3, "contact.restitution": 0.1}),
        (20, PRESCRIBED | LINEAR | {"drive.amplitude": 60e-6, "barriers.gap_m": 2e-3}),
        (10, PRESCRIBED | LINEAR | {"drive.waveform": "chirp", "drive.amplitude": 1e-3}),
        (5, LINEAR | {"drive.amplitude": 0.52, "barriers.gap_m": 1e-3, "contact.restitution": 0.1}),
        (5, LINEAR | {"drive.amplitude": 0.52, "barriers.gap_m": 2e-3, "contact.restitution": 0.1}),
        (5, RANDOM | {"drive.amplitude": 3e-3}),
        (5, RANDOM | {"drive.amplitude": 3e-3, "daq.seed": 2}),
        (5, RANDOM | {"drive.amplitude": 1e-3, "contact.law": "exact"}),
        (2, RANDOM | {"drive.amplitude": 3e-3, "contact.law": "exact", "daq.seed": 2}),
        (5, RANDOM | LINEAR | {"drive.amplitude": 3e-3}),
        (2, {"drive.amplitude": 247.0, "sphere.diameter_m": 0.2105e-3, "shaker.current_limit_a_rms": 318.0}),
        (3, RANDOM | {"drive.amplitude": 1e-3, "shaker.ramp_s": 0.0}),
        (3, RANDOM | {"drive.amplitude": 1e-3, "shaker.ramp_s": 0.0, "structure.natural_frequency_hz": 369.0}),
        (3, RANDOM | {"drive.amplitude": 1e-3, "shaker.ramp_s": 0.0, "sphere.present": False}),
        (9, {"drive.amplitude": 1e-7, "shaker.ramp_s": 60.0}),
    ],
)
def test_the_energy_balance_closes_in_difficult_cases(seconds, values):
    """Long rests under a linear law, bases that jump in speed or place, tiny spheres, and hardly any motion."""
    config = from_flat(RigConfig(), values)
    simulation = Simulation(config, account=True)
    simulation.advance(new_generator(config).segments(round(seconds / COMMAND_GRID_S)))
    energy = simulation.energy()
    lost = energy.columns + energy.shaker + energy.contact + energy.friction
    assert energy.work != 0.0
    assert abs(energy.imbalance) <= TOLERANCE * max(abs(energy.work), abs(lost), abs(energy.stored)), energy


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["prescribed", "current", "voltage"])
@pytest.mark.parametrize("gap", GAPS_M)
@pytest.mark.parametrize("law", LAWS)
def test_the_energy_balance_closes_for_every_law_gap_and_drive(law, gap, kind):
    amplitude = {"prescribed": 60e-6, "current": 0.52, "voltage": 2.0}[kind]
    energy, _ = account(rig(drive={"kind": kind}, contact={"law": law}, barriers={"gap_m": gap}), amplitude, 1000)
    assert abs(energy.imbalance) <= TOLERANCE * abs(energy.work), energy


def test_friction_dissipates_its_force_times_the_distance():
    """A sphere sliding on a rig at rest loses its kinetic energy at μ m g per metre."""
    config = limit_case(
        drive={"kind": "prescribed"},
        structure={"mass_kg": 1e9, "natural_frequency_hz": 1e-4},
        sphere={"guide_friction": 0.2},
    )
    simulation = Simulation(config, account=True)
    simulation.place(d=-3e-3 + 1e-9, d_rate=0.1)  # stops after 2.55 mm
    motion = simulation.advance(sine(1.0, 0.0, 0.1))
    stop_s, way = 0.1 / (0.2 * 9.80665), 0.1**2 / (2 * 0.2 * 9.80665)
    assert way < 6e-3
    x, v = (motion.quantity(name, np.zeros(2, int), np.array([0.5 * stop_s, 0.09])) for name in ("x_2", "v_2"))
    assert v == pytest.approx([0.05, 0.0], abs=1e-12)
    assert x == pytest.approx([-3e-3 + 0.75 * way, -3e-3 + way], abs=1e-8)
    kinetic = 0.5 * 1.0524e-3 * 0.01
    assert simulation.energy().friction == pytest.approx(kinetic, rel=1e-4)


@pytest.mark.parametrize("kind", ["prescribed", "current"])
@pytest.mark.parametrize("law", ["flores", "restitution"])
def test_the_energy_balance_closes_with_friction(law, kind):
    config = rig(drive={"kind": kind}, contact={"law": law}, sphere={"guide_friction": 0.1})
    energy, _ = account(config, {"prescribed": 60e-6, "current": 0.52}[kind], 200)
    assert_closed(energy)
    assert energy.friction > 0.0


def test_the_energy_account_does_not_change_the_motion():
    config, drive = rig(), sine(9.1, 0.52, 0.01, 500)
    plain, kept = Simulation(config).advance(drive), Simulation(config, account=True).advance(drive)
    assert plain.impacts.tobytes() == kept.impacts.tobytes()


def test_a_base_that_jumps_does_no_work_without_an_energy_account_either():
    config = rig(drive={"kind": "prescribed"})
    jump = np.concatenate([sine(9.1, amplitude, 0.01, phase=1.0) for amplitude in (1e-3, 2e-3)])
    for account, works in ((True, True), (False, False)):
        simulation = Simulation(config, account=account)
        simulation.advance(jump)
        assert (simulation.energy().work != 0.0) == works


def test_contact_losses_are_the_sum_over_impacts():
    config = rig()
    simulation = Simulation(config)
    motion = simulation.advance(sine(9.1, 0.52, 0.01, 1000))
    assert motion.impacts["energy_lost"].sum() == pytest.approx(simulation.energy().contact, rel=1e-12)
