# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What drives a rig through its stream reaches what was asked, and what it estimates is the closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from impact_rig.errors import CommandError
from impact_rig.operate.hardware import Exchange, Hardware, InProcess
from impact_rig.physics.linear import constants, input_vectors, state_matrix
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.studies.excitation.history import ReplicatePlan, replicate
from impact_rig.studies.excitation.random import RandomPlan, Spectrum, control
from impact_rig.studies.excitation.response import BURST, Excitation, measure
from impact_rig.studies.excitation.shock import Pulse, half_sine_spectrum, shock_response_spectrum

X_B = 2
RATE_HZ = 2_000


def hardware(**values: object) -> Hardware:
    """A rig in this process, by configuration values with `__` for the point."""
    settings = {"drive.waveform": "stream", "drive.stream_rate_hz": RATE_HZ, "daq.rate_hz": RATE_HZ}
    given = {name.replace("__", "."): value for name, value in values.items()}
    return Hardware(InProcess(Rig(from_flat(RigConfig(), settings | given))))


def base_of(rows: np.ndarray) -> np.ndarray:
    return rows["base"].astype(float)


def test_a_scan_belongs_to_the_sample_it_is_read_with():
    linear = hardware(sphere__present=False, instruments__ideal=True)
    exchange = Exchange(linear, 100)
    samples = np.random.default_rng(1).uniform(-0.1, 0.1, 1_000)
    parts = [exchange.exchange(part) for part in np.split(samples, 10)]
    played, rows = (np.concatenate(one) for one in zip(*parts, strict=True))
    assert np.array_equal(played, np.append(np.zeros(100), samples[:-100]))
    assert np.abs(rows["current"] - played).max() < 1e-9
    assert linear.acquisition.delay_s(0, 0) == 0.0


def test_reading_what_nobody_plays_ends_in_time():
    waiting = hardware()
    waiting.acquisition.start(waiting.output.start())
    waiting.output.write(np.zeros(150))
    assert len(waiting.acquisition.read(100)) == 100
    with pytest.raises(TimeoutError, match="200 scans"):
        waiting.acquisition.read(200)
    waiting.output.stop()
    assert len(waiting.acquisition.read(200)) == 200


@pytest.mark.parametrize("present", [False, True])
def test_a_frequency_response_is_within_its_random_error_of_the_closed_form(present):
    """In the complex plane: 95 % of a circular normal distribution lie within 2.45 of its deviation either way."""
    rig = hardware(sphere__present=present)
    found = measure(rig, rig.wire.rig.info().rows, Excitation(kind=BURST), "base")
    c = constants(rig.wire.rig.config)
    matrix, b = state_matrix(c, "current", c.m_1), input_vectors(c, "current", c.m_1)[0]
    exact = [np.linalg.solve(2j * np.pi * f * np.eye(4) - matrix, b)[X_B] for f in found.frequency_hz]
    lines = (found.coherence > 0.9) & (found.frequency_hz > 4.0) & (found.frequency_hz < 60.0)
    apart = np.abs(found.h1 / exact - 1.0)[lines] / found.u_relative[lines]
    assert np.count_nonzero(lines) > 400
    assert np.mean(apart < 2.45) >= 0.95


def test_random_control_holds_a_density_of_the_base_acceleration():
    """Within 1 dB on 95 % of the lines from 5 to 200 Hz, by 60 averages."""
    spectrum = Spectrum(frequency_hz=(5.0, 15.0, 200.0), density=(0.02, 0.25, 0.25))
    plan = RandomPlan(spectrum=spectrum, start_rms=0.5)
    found = control(hardware(sphere__present=False), plan, base_of, lambda f: (2.0 * np.pi * f) ** 4)
    assert found.within(1.0) >= 0.95
    assert found.kurtosis == pytest.approx(3.0, abs=0.3)


def test_random_control_ends_when_the_shaker_trips():
    spectrum = Spectrum(frequency_hz=(5.0, 200.0), density=(0.02, 0.02))
    rig = hardware(sphere__present=False, shaker__travel_limit_m=1e-5)
    with pytest.raises(CommandError, match="over_travel"):
        control(rig, RandomPlan(spectrum=spectrum, start_rms=0.5, averages=4), base_of)


def test_the_shock_response_spectrum_of_a_half_sine_is_the_closed_form():
    rate_hz, duration_s = 200_000, 11e-3
    pulse = np.sin(np.pi * np.arange(round(duration_s * rate_hz) + 1) / (duration_s * rate_hz))
    frequency = np.geomspace(5.0, 1_000.0, 60)
    found = shock_response_spectrum(pulse, rate_hz, frequency, quality=1e9)
    assert found == pytest.approx(half_sine_spectrum(1.0, duration_s, frequency), rel=0.01)


def test_a_compensated_pulse_leaves_nothing_behind():
    pulse, rate_hz = Pulse(), 10_000
    acceleration, moved = pulse.acceleration(rate_hz), pulse.displacement(rate_hz)
    assert acceleration.max() == pytest.approx(pulse.peak, rel=1e-3)
    assert abs(acceleration.sum()) / rate_hz < 1e-12
    assert abs(moved[-1]) < 1e-12 < np.abs(moved).max()


def test_a_history_of_the_superior_base_is_replicated_within_two_percent():
    band = signal.butter(4, (6.0, 14.0), "bandpass", fs=RATE_HZ, output="sos")
    asked = signal.sosfilt(band, np.random.default_rng(3).standard_normal(4 * RATE_HZ)) * signal.windows.tukey(
        8_000, 0.2
    )
    asked *= 1.5e-3 / asked.std()
    plan = ReplicatePlan(low_hz=4.0, high_hz=25.0, identify_rms=0.15)
    found = replicate(hardware(sphere__present=False), asked, plan, lambda rows: rows["laser"].astype(float))
    assert len(found.errors) <= 6
    assert np.sqrt(np.mean((found.reached - asked) ** 2) / np.mean(asked**2)) == pytest.approx(min(found.errors))
    assert min(found.errors) <= 0.02
