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
"""A contact of 40 µs passes the accelerometer according to its transfer function, at any scan rate."""

import numpy as np
import pytest
from kits.instruments import IMPACT, AnalyticMotion, configured, filtered, hertz_pulse, measured, steps_of

from impact_rig.arithmetic.random import Random
from impact_rig.instruments import Chain
from impact_rig.instruments.chain import sensors
from impact_rig.physics import FunctionGenerator, Simulation

OF_PEAK = 0.01  # the acceptance line of the project
MASS_KG = 0.13
RATES = (10_000, 50_000, 200_000)


def dense(start_s: float, end_s: float) -> np.ndarray:
    return np.arange(round((end_s - start_s) / 40e-9)) * 40e-9 + start_s


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", RATES)
@pytest.mark.parametrize(
    ("start_s", "duration_s"),
    [(0.0123456, 42.1e-6), (0.01999, 36.7e-6), (0.0250000, 100e-6)],
    ids=["inside a tick", "across a tick", "at a scan"],
)
def test_a_pulse_agrees_with_the_convolution_of_the_force(rate_hz, start_s, duration_s):
    config = configured(rate_hz, exact=True)
    force = hertz_pulse(start_s, duration_s, 60.5)
    motion = AnalyticMotion(steps_of(start_s, duration_s), a_1=lambda t: force(t) / MASS_KG)

    scans = measured(Chain(config), motion, 0.04)

    time = dense(start_s - 1e-4, start_s + 1.5e-3)
    expected = filtered(sensors(config)[0].transfer, time, force(time) / MASS_KG)
    inside = (scans["time"] > time[0]) & (scans["time"] < time[-1])
    error = scans["accelerometer"][inside] - np.interp(scans["time"][inside], time, expected)
    assert np.max(np.abs(expected)) > 100.0
    assert np.max(np.abs(error)) < OF_PEAK * np.max(np.abs(expected))


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", RATES)
def test_pulses_of_the_simulated_rig_agree_with_its_true_acceleration(rate_hz):
    config = configured(rate_hz, exact=True)
    generator = FunctionGenerator(config.drive, config.shaker, Random(1))
    generator.set_amplitude(0.52)
    chain, simulation = Chain(config), Simulation(config)
    chain.acquire(simulation.advance(generator.segments(100)), 0, 100)
    motion = simulation.advance(generator.segments(50))
    assert len(motion.impacts) >= 5
    first = chain.ready
    chain.read(first)
    chain.acquire(motion, 100, 50)
    scans = chain.read(chain.ready)
    time_of_scan = (first + np.arange(len(scans))) / rate_hz - 1.0

    transfer = sensors(config)[0].transfer
    worst = []
    for impact in motion.impacts[:4]:
        start = (impact["tick"] - 100) * 0.01 + impact["offset"]
        time = dense(start - 2e-4, start + 5e-4)
        inside = np.flatnonzero((time_of_scan > start) & (time_of_scan < time[-1]))
        tick = np.floor(time / 0.01).astype(np.int64)
        truth = motion.quantities(("a_1",), 100 + tick, time - tick * 0.01)[0]
        # what came before leaves its slow rest (1 Hz high-pass) in the sensor: compare from the contact's start on
        expected = filtered(transfer, time, truth - truth[0])
        at = np.interp(time_of_scan[inside], time, expected)
        error = scans["accelerometer"][inside] - at
        worst.append(np.max(np.abs(error - np.median(error))) / np.max(np.abs(expected)))
    assert max(worst) < OF_PEAK, worst


def test_the_area_of_a_pulse_does_not_depend_on_the_rate():
    """The area of a pulse is the change of the structure's velocity, reduced by the 1 Hz high-pass."""
    force = hertz_pulse(0.0123, 42e-6, 60.5)
    motion = AnalyticMotion(steps_of(0.0123, 42e-6), a_1=lambda t: force(t) / MASS_KG)
    scans = measured(Chain(configured(200_000, exact=True)), motion, 0.02)
    time = dense(0.0122, 0.0124)
    velocity = np.sum(force(time)) * 40e-9 / MASS_KG
    within = (scans["time"] > 0.0122) & (scans["time"] < 0.0135)
    left = np.exp(-2 * np.pi * 1.0 * (0.0135 - 0.0123))
    assert np.sum(scans["accelerometer"][within]) / 200_000 == pytest.approx(velocity * left, rel=3e-3)


def test_an_instantaneous_impact_yields_the_impulse_response():
    impacts = np.array([(1, 0.00234, 1, 2e-3, 0.0), (2, 0.00234, -1, 2e-3, 0.0)], dtype=IMPACT)
    motion = AnalyticMotion((0.01234, 0.02234), impacts)
    config = configured(50_000, exact=True)
    scans = measured(Chain(config), motion, 0.03)
    modes = sensors(config)[0].transfer.modes()

    def answer(at):
        since = np.maximum(scans["time"] - at, 0.0)
        response = np.sum((modes.residues * np.exp(np.multiply.outer(since, modes.poles))).real, axis=1)
        return np.where(scans["time"] >= at, response, 0.0) * 2e-3 / config.structure.mass_kg

    expected = answer(0.01234) - answer(0.02234)
    # the gain of the volts: the impulse response itself is checked against scipy in test_instruments_transfer
    np.testing.assert_allclose(scans["accelerometer"], expected, atol=1e-3 * np.max(np.abs(expected)))
