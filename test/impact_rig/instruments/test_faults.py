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
"""Injected faults: each has its described effect at its time and channel, and is recorded."""

import attrs
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from kits.instruments import AnalyticMotion, configured, measured, sine

from impact_rig.blocks import FAULTS
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments import Chain, Fault
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.instruments.section import INSTRUMENTS
from impact_rig.rig.config import RigConfig, from_flat

START, DURATION = 300, 400
INSIDE = slice(START, START + DURATION)
MOTION = AnalyticMotion(x_1=sine(9.1, 5e-3), x_b=sine(9.1, 1e-3), current=sine(9.1, 0.5), a_1=sine(9.1, 15.0))


def with_fault(kind, channel="laser", seconds=0.1, **fault):
    """Return scans with the fault and scans without it, of the same rig with all its noise."""
    config = configured(10_000)
    chain = Chain(config)
    chain.inject(Fault(kind=kind, channel=channel, start_sample=START, samples=DURATION, **fault))
    return measured(chain, MOTION, seconds), measured(Chain(config), MOTION, seconds)


def outside(scans):
    return np.concatenate([scans[:START], scans[START + DURATION :]])


@pytest.mark.parametrize("kind", [kind for kind in FAULT_KINDS if kind not in ("lost_block", "clock_drift")])
def test_a_fault_acts_only_on_its_channel_and_its_scans(kind):
    faulty, sound = with_fault(kind, value=1e-3, rate_hz=500.0)
    assert not np.array_equal(faulty["laser"][INSIDE], sound["laser"][INSIDE])
    np.testing.assert_array_equal(outside(faulty), outside(sound))
    for name in ("accelerometer", "base", "current"):
        np.testing.assert_array_equal(faulty[name], sound[name])


def test_a_dropout_reads_zero_volts():
    faulty, _ = with_fault("dropout")
    # 0 V is 10 mm of distance too few; the converter still makes its noise of 0.28 mV
    np.testing.assert_allclose(faulty["laser"][INSIDE], 10e-3, atol=5 * 280e-6 / 500)
    assert np.std(faulty["laser"][INSIDE]) > 0
    assert not np.any(faulty["status"])


def test_a_stuck_channel_repeats_its_last_reading():
    faulty, sound = with_fault("stuck")
    assert set(faulty["laser"][INSIDE]) == {sound["laser"][START - 1]}


def test_a_stuck_channel_stays_stuck_across_calls():
    chain = Chain(configured(10_000))
    chain.inject(Fault(kind="stuck", channel="base", start_sample=150))
    scans = measured(chain, MOTION, 0.1, ticks_per_call=1)
    assert set(scans["base"][150:]) == {scans["base"][149]}


@pytest.mark.parametrize(("channel", "value", "tolerance"), [("laser", 1e-3, 2e-6), ("base", -2e-4, 2e-6)])
def test_an_offset_step_adds_its_value(channel, value, tolerance):
    faulty, sound = with_fault("offset_step", channel, value=value)
    difference = (faulty[channel] - sound[channel])[INSIDE]
    np.testing.assert_allclose(difference, value, atol=tolerance)


def test_a_gain_error_scales_the_readings():
    faulty, sound = with_fault("gain_error", "base", value=0.05)
    np.testing.assert_allclose(faulty["base"][INSIDE], 1.05 * sound["base"][INSIDE], atol=2e-6)


def test_added_noise_has_the_given_rms_and_seed():
    faulty, sound = with_fault("added_noise", "base", value=1e-4, seed=1)
    noise = (faulty["base"] - sound["base"])[INSIDE]
    assert np.std(noise) == pytest.approx(1e-4, rel=4.5 / np.sqrt(2 * DURATION))
    again, _ = with_fault("added_noise", "base", value=1e-4, seed=1)
    other, _ = with_fault("added_noise", "base", value=1e-4, seed=2)
    np.testing.assert_array_equal(faulty, again)
    assert not np.array_equal(faulty["base"], other["base"])


def test_a_spike_train_has_the_given_rate_and_size():
    config = configured(10_000)
    chain = Chain(config)
    chain.inject(Fault(kind="spike_train", channel="base", value=2e-3, rate_hz=50.0, seed=5))
    spikes = measured(chain, MOTION, 20.0)["base"] - measured(Chain(config), MOTION, 20.0)["base"]
    hit = np.abs(spikes) > 1e-4
    np.testing.assert_allclose(np.abs(spikes[hit]), 2e-3, atol=2e-6)
    assert np.sum(hit) == pytest.approx(1000, abs=4.5 * np.sqrt(1000))
    assert np.sum(spikes[hit] > 0) == pytest.approx(np.sum(hit) / 2, abs=4.5 * np.sqrt(np.sum(hit)) / 2)


def test_saturation_limits_and_flags_the_readings():
    faulty, sound = with_fault("saturation", "laser", value=2e-3)
    assert np.max(np.abs(faulty["laser"][INSIDE])) < 2.01e-3
    beyond = np.abs(sound["laser"][INSIDE]) > 2.01e-3
    assert np.all(faulty["status"][INSIDE][beyond] == 0b10)
    assert 0.3 < np.mean(beyond) < 1.0
    assert not np.any(outside(faulty)["status"])


def test_simultaneous_faults_combine():
    config = configured(10_000)
    chain = Chain(config)
    for value in (1e-4, 2e-4):
        chain.inject(Fault(kind="offset_step", channel="base", start_sample=START, samples=DURATION, value=value))
    difference = measured(chain, MOTION, 0.1)["base"] - measured(Chain(config), MOTION, 0.1)["base"]
    np.testing.assert_allclose(difference[INSIDE], 3e-4, atol=2e-6)


def test_ideal_instruments_can_have_faults():
    config = from_flat(configured(10_000), {"instruments.ideal": True})
    chain = Chain(config)
    chain.inject(Fault(kind="offset_step", channel="laser", start_sample=START, samples=DURATION, value=1e-3))
    difference = measured(chain, MOTION, 0.1)["laser"] - measured(Chain(config), MOTION, 0.1)["laser"]
    np.testing.assert_allclose(difference[INSIDE], 1e-3, atol=1e-15)
    assert not np.any(outside(difference))


def test_the_board_counts_lost_blocks():
    chain = Chain(configured(10_000))
    chain.inject(Fault(kind="lost_block", start_sample=250, samples=100))
    assert [first for first in range(0, 600, 100) if chain.block_lost(first, 100)] == [200, 300]


def test_clock_drift_accumulates():
    chain = Chain(configured(25_600))
    chain.inject(Fault(kind="clock_drift", start_sample=256, samples=512, value=30.0))
    chain.inject(Fault(kind="clock_drift", start_sample=512, value=-10.0))
    assert [chain.clock_ppm(tick) for tick in range(5)] == [0.0, 30.0, 20.0, -10.0, -10.0]


def test_the_scan_clock_never_stops_or_runs_backwards():
    """A drift of -1e6 ppm would stop the clock, and a larger one give ticks of negative length."""
    chain = Chain(configured(10_000))
    for _ in range(3):
        chain.inject(Fault(kind="clock_drift", value=-4e5))
    assert chain.clock_ppm(0) == -5e5


def test_the_start_and_the_end_of_a_fault_are_logged_once():
    chain = Chain(configured(10_000))
    first = chain.inject(Fault(kind="stuck", channel="base", start_sample=150, samples=100))
    second = chain.inject(Fault(kind="dropout", channel="laser", start_sample=99, value=0.5))
    chain.acquire(MOTION, 0, 6)
    chain.clear(second)
    rows = np.concatenate([chain.fault_rows(start, 100) for start in range(0, 1000, 100)])
    assert rows.dtype == FAULTS
    expected = [(99, second, b"dropout", 1), (150, first, b"stuck", 1), (250, first, b"stuck", 0)]
    assert [(row["sample"], row["id"], row["kind"], row["active"]) for row in rows] == [
        *expected,
        (600, second, b"dropout", 0),
    ]
    np.testing.assert_allclose(rows["time"], [99e-4, 50e-4, 50e-4, 0.0])
    np.testing.assert_allclose(rows["duration"], [0.0, 0.01, 0.01, 0.0])  # as planned; 0 = until it is cleared


def test_a_fault_without_end_is_reported_as_such_and_can_be_cleared():
    chain = Chain(configured(10_000))
    number = chain.inject(Fault(kind="dropout", channel="laser", start_sample=100))
    assert chain.fault_rows(100, 100)["duration"][0] == 0
    chain.acquire(MOTION, 0, 3)
    chain.clear()
    ends = chain.fault_rows(300, 100)
    assert [(row["sample"], row["kind"], row["active"]) for row in ends] == [(300, b"dropout", 0)]
    with pytest.raises(CommandError, match=r"no fault number 7; numbers of faults .* since the reset: 1 to 1$"):
        chain.clear(7)
    chain.acquire(MOTION, 3, 3)
    laser = chain.read(chain.ready)["laser"]
    assert np.all(laser[100:300] > 9.9e-3)
    assert np.all(laser[300:] < 6e-3)
    assert number == 1


def test_a_fault_cannot_be_injected_into_the_past():
    chain = Chain(configured(10_000))
    chain.acquire(MOTION, 0, 5)
    with pytest.raises(CommandError, match=r"start_sample of a fault must be >= 500, the first .*, got 499"):
        chain.inject(Fault(kind="dropout", channel="laser", start_sample=499))


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ({"kind": "gremlin"}, "fault kind must be one of dropout, stuck"),
        ({"kind": "stuck"}, f"stuck needs a channel, one of {', '.join(INSTRUMENTS)}, got ''"),
        ({"kind": "lost_block", "channel": "laser"}, "lost_block is a fault of the whole board"),
        (
            {"kind": "stuck", "channel": "base", "start_sample": -1},
            "start_sample of the fault stuck must be finite and >= 0, got -1",
        ),
        (
            {"kind": "gain_error", "channel": "base", "value": np.nan},
            "value of the fault gain_error must be finite, got nan",
        ),
        (
            {"kind": "clock_drift", "value": -1e6},
            "value of the fault clock_drift, by which the clock is slow, must be within ± 500000 ppm, got -1000000.0",
        ),
    ],
)
def test_an_invalid_fault_is_rejected_by_name(fault, message):
    with pytest.raises(CommandError, match=message):
        Fault(**fault)


@given(
    st.integers(0, 10**9), st.integers(0, 10**9), st.integers(100, 250_000), st.floats(-1e3, 1e3), st.floats(0.0, 1e5)
)
@example(0, 0, 1000, 0.0, 0.0)
def test_a_line_of_text_describes_the_same_fault(start, samples, scan_rate, value, rate):
    fault = Fault(kind="spike_train", channel="base", start_sample=start, samples=samples, value=value, rate_hz=rate)
    assert Fault.from_line(fault.line(scan_rate), scan_rate) == fault


def test_the_configuration_contains_the_planned_faults():
    line = "offset_step channel=laser start_s=0.03 duration_s=0.04 value=1e-3"
    config = from_flat(configured(10_000), {"instruments.faults.planned": [line]})
    faulty, sound = measured(Chain(config), MOTION, 0.1), measured(Chain(configured(10_000)), MOTION, 0.1)
    np.testing.assert_allclose((faulty["laser"] - sound["laser"])[INSIDE], 1e-3, atol=2e-6)
    np.testing.assert_array_equal(outside(faulty), outside(sound))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("gremlin channel=laser", r"instruments\.faults\.planned: fault kind must be one of"),
        ("stuck channel=lser", r"planned: stuck needs a channel"),
        ("stuck channel=laser start=2", r"key of a fault must be one of channel, start_s, .* got 'start'"),
        ("stuck channel=laser start_s=soon", r"start_s of a fault must be a number, got 'soon'"),
        ("stuck channel=laser start_s=1e300", r"must be at most 2\*\*53, got 1\.0+\d*e\+300, in 'stuck .*1e300'$"),
        ("stuck channel=laser duration_s=-1", r"duration_s of a fault must be finite and >= 0, got -1"),
        ("stuck channel=laser seed=inf", r"seed of a fault must be an integer >= 0, got inf"),
        ("stuck channel=laser seed=1.7", r"seed of a fault must be an integer >= 0, got 1.7"),
    ],
)
def test_an_invalid_planned_fault_is_rejected_by_name(line, message):
    with pytest.raises(ConfigError, match=message):
        from_flat(RigConfig(), {"instruments.faults.planned": [line]})


def test_a_fault_shorter_than_a_scan_ends_after_one():
    assert Fault.from_line("stuck channel=laser duration_s=1e-11", 10_000).samples == 1


def test_a_time_whose_number_of_scans_overflows_is_rejected():
    with pytest.raises(ConfigError, match=r"start_sample of the fault stuck must be at most 2\*\*53"):
        Fault.from_line("stuck channel=laser start_s=1e308", 10_000)


def test_the_values_of_a_planned_fault_are_parsed():
    fault = Fault.from_line("spike_train channel=base start_s=1 duration_s=2 value=-3e-4 seed=5 rate_hz=7", 500)
    assert attrs.astuple(fault) == ("spike_train", "base", 500, 1000, -3e-4, 5, 7.0)
