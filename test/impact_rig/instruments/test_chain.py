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
"""The complete chain: readings do not depend on how calls are divided, seeds change them, a reset starts again."""

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.instruments import AnalyticMotion, configured, fitted, hertz_pulse, measured, sine, steps_of
from kits.memory import growth

from impact_rig.arithmetic.random import Random
from impact_rig.blocks import DAQ_INFO
from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments import Chain, Fault
from impact_rig.instruments.section import CHANNELS, SCAN
from impact_rig.physics import FunctionGenerator, Simulation
from impact_rig.rig.config import from_flat

TICKS = 30


def lively_motion(**kwargs):
    """Motion in which all quantities change, with contacts within ticks and across one."""
    contacts = [(0.0523456, 42e-6), (0.10999, 36e-6), (0.2, 60e-6), (0.21, 90e-6)]
    forces = [hertz_pulse(start, duration, 60.0) for start, duration in contacts]
    return AnalyticMotion(
        np.concatenate([steps_of(*contact) for contact in contacts]),
        a_1=lambda t: 19.0 * np.sin(57 * t) + sum(force(t) for force in forces) / 0.13,
        x_1=sine(9.1, 5.85e-3),
        x_b=sine(9.1, 6e-5, 1.0),
        current=sine(9.1, 0.52, 2.0),
        **kwargs,
    )


def run(config, cuts=(TICKS,), block=None, motion=None, faults=()):
    motion = lively_motion() if motion is None else motion
    chain = Chain(config)
    for fault in faults:
        chain.inject(fault)
    rows, first = [], 0
    for ticks in cuts:
        chain.acquire(motion, first, ticks)
        first += ticks
        while block and chain.ready >= block:
            rows.append(chain.read(block))
    rows.append(chain.read(chain.ready))
    scans = np.concatenate(rows)
    scans["time"] = 0.0  # counts from each block's own first scan
    return scans


FAULTS = (
    Fault(kind="spike_train", channel="laser", start_sample=100, samples=1500, value=1e-3, seed=3, rate_hz=200.0),
    Fault(kind="added_noise", channel="base", start_sample=333, samples=777, value=1e-5, seed=4),
    Fault(kind="stuck", channel="current", start_sample=901, samples=300),
)


@pytest.mark.heavy
@settings(max_examples=12)
@given(data=st.data(), rate_hz=st.sampled_from([100, 777, 12_345, 25_600, 50_000]))
def test_readings_do_not_depend_on_how_calls_divide_the_motion(data, rate_hz):
    cuts, left = [], TICKS
    while left:
        cuts.append(data.draw(st.integers(1, left)))
        left -= cuts[-1]
    block = data.draw(st.integers(1, 700))
    config = configured(rate_hz)
    np.testing.assert_array_equal(run(config, cuts, block, faults=FAULTS), run(config, faults=FAULTS))


def test_readings_of_the_simulated_rig_do_not_depend_on_how_calls_divide_time():
    config = configured(50_000)

    def record(ticks_per_call):
        generator = FunctionGenerator(config.drive, config.shaker, Random(1))
        generator.set_amplitude(0.52)
        simulation, chain = Simulation(config), Chain(config)
        for first in range(0, 60, ticks_per_call):
            chain.acquire(simulation.advance(generator.segments(ticks_per_call)), first, ticks_per_call)
        return chain.read(chain.ready)

    whole = record(60)
    assert np.max(np.abs(whole["accelerometer"])) > 50.0  # the motion has impacts
    for ticks in (1, 7 - 2, 20):
        np.testing.assert_array_equal(record(ticks), whole)


@pytest.mark.parametrize("rate_hz", [100, 777, 10_000, 12_345, 25_600, 50_000, 250_000])
def test_scans_are_complete_when_their_period_is_simulated(rate_hz):
    chain = Chain(configured(rate_hz))
    for tick in range(20):
        chain.acquire(lively_motion(), tick, 1)
        assert chain.ready >= (tick + 1) * rate_hz // 100
        assert chain.first_open_scan <= -(-(tick + 1) * rate_hz // 100)
    rows = chain.read(chain.ready)
    assert rows.dtype == SCAN
    np.testing.assert_allclose(rows["time"], np.arange(len(rows)) / rate_hz, rtol=1e-15)
    assert chain.next_scan == len(rows)
    with pytest.raises(ValueError, match="count must be 0 to"):
        chain.read(1_000)


def test_readings_at_different_rates_agree_where_their_scans_coincide():
    slow, fast = (run(configured(rate, exact=True, adc__multiplexed=False)) for rate in (5_000, 50_000))
    for name in CHANNELS:
        scale = np.max(np.abs(fast[name]))
        np.testing.assert_allclose(slow[name], fast[name][::10], atol=2e-3 * scale, err_msg=name)


def test_the_seed_determines_the_noise():
    first, again, other = (run(configured(10_000, seed=seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    for name in CHANNELS:
        assert not np.array_equal(first[name], other[name])
    clean = [run(configured(10_000, exact=True, seed=seed)) for seed in (1, 2)]
    np.testing.assert_array_equal(*clean)  # noise and calibration errors are all a seed decides


def test_a_reset_repeats_the_readings_from_the_start():
    chain = Chain(configured(10_000))
    before = measured(chain, lively_motion(), 0.1)
    chain.inject(Fault(kind="dropout", channel="laser", start_sample=chain.first_open_scan))
    chain.reset()
    assert (chain.next_scan, chain.first_open_scan, chain.ready) == (0, 0, 0)
    np.testing.assert_array_equal(measured(chain, lively_motion(), 0.1), before)


def test_a_change_of_one_instrument_does_not_affect_the_others():
    config = configured(10_000)
    changed = from_flat(config, {"instruments.laser.lag_s": 2e-3, "instruments.laser.inverted": True})
    chain = Chain(config)
    chain.acquire(lively_motion(), 0, 10)
    chain.reconfigure(changed)
    chain.acquire(lively_motion(), 10, 20)
    scans, before = chain.read(chain.ready), run(config)
    for name in ("accelerometer", "base", "current"):
        np.testing.assert_array_equal(scans[name], before[name])
    np.testing.assert_array_equal(scans["laser"][:1000], before["laser"][:1000])
    np.testing.assert_allclose(scans["laser"][1200:], -before["laser"][1200:], atol=1.2e-3)
    assert chain.info()[1]["lag"] == pytest.approx(2e-3)
    for key, value in (("daq.rate_hz", 20_000), ("daq.seed", 9)):
        with pytest.raises(ConfigError, match=f"{key} is fixed at start"):
            chain.reconfigure(from_flat(changed, {key: value}))


def test_an_error_of_the_clock_scales_the_time_of_the_physics():
    """If the clock is 100 ppm fast, a tick of DAQ time covers less of the motion, so its frequency reads lower."""
    tick_s = 0.01 * (1 - 100e-6)
    config = configured(10_000, exact=True)
    chain = Chain(config)
    motion = AnalyticMotion(x_b=sine(50.0, 1e-3), tick_s=tick_s)
    for first in range(0, 1000, 100):
        chain.acquire(motion, first, 100, tick_s)
    chain.read(1000)  # the sensor's filter starts settled at zero and has to catch up
    rows = chain.read(chain.ready)
    apparent = 50.0 * (1 - 100e-6)
    residual = (
        rows["base"]
        - (fitted(rows["time"], rows["base"], apparent) * np.exp(2j * np.pi * apparent * rows["time"])).imag
    )
    assert np.max(np.abs(residual)) < 1e-8


def test_ideal_instruments_read_the_motion_itself():
    config = from_flat(configured(10_000), {"instruments.ideal": True})
    chain, motion = Chain(config), lively_motion()
    rows = measured(chain, motion, TICKS * 0.01)
    segment = np.arange(len(rows)) // 100
    offset = 0.01 * (np.arange(len(rows)) % 100 / 100)
    truth = motion.quantities(("a_1", "x_1", "x_b", "current"), segment, offset)
    for name, expected in zip(CHANNELS, truth, strict=True):
        np.testing.assert_array_equal(rows[name], expected)
    assert not np.any(rows["status"])
    info = chain.info()
    for column in ("lag", "skew", "noise", "resolution", "sensitivity_uncertainty", "offset_uncertainty"):
        assert not np.any(info[column])


@pytest.mark.parametrize("ticks", [3, 53])
def test_every_channel_reads_each_scan_once_after_a_change_to_ideal_instruments(ticks):
    """A channel whose conversion lies beyond the end of a tick must not miss it, or it stays one scan behind."""
    config = configured(1234)
    chain, motion = Chain(config), lively_motion()
    chain.acquire(motion, 0, ticks)
    start = chain.first_open_scan
    assert chain.ready < start  # skews keep some channels behind
    chain.reconfigure(from_flat(config, {"instruments.ideal": True}))
    chain.calibrate("current", 20.0, 1.0, TICKS)
    chain.acquire(motion, ticks, TICKS)
    rows = chain.read(chain.ready)[start:]
    assert len(rows) == -(-(ticks + TICKS) * 1234 // 100) - start
    at = (start + np.arange(len(rows))) / 1234
    truth = motion.quantities(("a_1", "x_1", "x_b"), np.zeros(len(at), np.int64), at)
    for name, expected in zip(CHANNELS, truth, strict=False):
        np.testing.assert_allclose(rows[name], expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(rows["current"], np.sin(2 * np.pi * 20.0 * (at - 0.01 * ticks)), atol=1e-9)


@pytest.mark.parametrize("change", [{"adc.multiplexed": False}, {"adc.conversion_ns": 1000}], ids=["one", "sooner"])
def test_a_smaller_skew_that_puts_a_scan_into_the_past_delays_no_other_scan(change):
    """If a scan is in the past after the change, it must not delay the others of that piece."""
    config = configured(1234, exact=True, base__bandwidth_hz=1e5)
    then = from_flat(config, {f"instruments.{name}": value for name, value in change.items()})
    motion, chain, twin = AnalyticMotion(x_b=sine(20.0, 10e-3)), Chain(config), Chain(then)
    chain.acquire(motion, 0, 3)
    start = chain.first_open_scan
    assert chain.ready < start
    chain.reconfigure(then)
    chain.acquire(motion, 3, TICKS)
    twin.acquire(motion, 0, 3 + TICKS)
    assert chain.ready == twin.ready
    scans, all_along = chain.read(chain.ready)["base"], twin.read(twin.ready)["base"]
    np.testing.assert_allclose(scans[start:], all_along[start:], atol=1e-8)
    assert abs(scans[start - 1] - all_along[start - 1]) < 22e-6 * 2 * np.pi * 20.0 * 10e-3  # at most as late as it was


def test_the_certificate_contains_what_the_analysis_needs():
    info = Chain(configured(50_000)).info()
    assert info.dtype == DAQ_INFO
    assert [name.decode() for name in info["name"]] == list(CHANNELS)
    assert [unit.decode() for unit in info["unit"]] == ["m/s^2", "m", "m", "A"]
    np.testing.assert_allclose(info["sensitivity"], [28e-3 / 9.80665, -500.0, 800.0, 0.2])
    np.testing.assert_allclose(info["offset"], [0, 5, 0, 0])
    np.testing.assert_allclose(info["skew"], [0, 5e-6, 10e-6, 15e-6])
    delay = 1 / (2 * np.pi * 25e3 * 30) + np.sqrt(2) / (2 * np.pi * 10e3)
    np.testing.assert_allclose(info["lag"], [delay, 0.7e-3, np.sqrt(2) / (2e3 * np.pi), 1 / (2 * np.pi * 20e3)])
    np.testing.assert_array_equal(info["lag_order"], [0, 1, 2, 1])
    np.testing.assert_allclose(info["linearity"], [0, 30e-6, 0.0025 * 12.5e-3, 0])
    assert info["noise"][0] == pytest.approx(5e-3 * 9.80665, rel=0.5)  # 5 mg, and the converter's own


def test_a_calibration_sine_replaces_one_channel_for_its_duration():
    config = configured(10_000, exact=True)
    chain = Chain(config)
    chain.acquire(lively_motion(), 0, 10)
    chain.calibrate("base", 25.0, 3e-3, 16)
    chain.acquire(lively_motion(), 10, 20)
    scans, before = chain.read(chain.ready), run(config)
    for name in ("accelerometer", "laser", "current"):
        np.testing.assert_array_equal(scans[name], before[name])
    time = np.arange(len(scans)) / 10_000 - 0.1 + 22e-6 - np.sqrt(2) / (2e3 * np.pi)
    np.testing.assert_allclose(scans["base"][1100:2599], 3e-3 * np.sin(2 * np.pi * 25.0 * time[1100:2599]), atol=2e-6)
    np.testing.assert_allclose(scans["base"][2700:], before["base"][2700:], atol=1e-7)
    np.testing.assert_array_equal(scans["base"][:1000], before["base"][:1000])
    for wrong in (("lase", 10.0, 1.0, 1), ("laser", 0.0, 1.0, 1), ("laser", 1e4, 1.0, 1), ("laser", 1.0, np.nan, 1)):
        with pytest.raises(CommandError):
            chain.calibrate(*wrong)


@pytest.mark.parametrize("ideal", [True, False])
def test_a_calibration_sine_is_continuous_when_the_clock_starts_to_drift(ideal):
    """The phase must not jump, as it would if the new length of a tick were applied to all ticks so far."""
    config = configured(10_000, exact=True)
    config = attrs.evolve(config, instruments=attrs.evolve(config.instruments, ideal=ideal))
    chain = Chain(config)
    chain.calibrate("base", 10.0, 1e-3, 300)
    chain.acquire(lively_motion(), 0, 100, 0.01)
    chain.acquire(lively_motion(), 100, 100, 0.01 * (1.0 + 0.05))
    readings = chain.read(chain.ready)["base"][900:]
    steps = np.abs(np.diff(readings))
    assert steps.max() < 2.0 * np.pi * 10.0 * 1e-3 * 1.05e-4 * 1.02, "no faster than a sine of 10 Hz"


def test_the_memory_of_the_chain_is_bounded():
    """Only data that have not been read are kept."""
    chain = Chain(configured(10_000))
    handed_out = 0

    def measure(first: int, last: int) -> None:
        nonlocal handed_out
        for tick in range(first, last, 10):
            chain.acquire(lively_motion(), tick, 10)
            handed_out += chain.read(chain.ready).nbytes

    measure(0, 100)  # allocations that happen only once
    handed_out = 0
    assert growth(lambda: measure(100, 600)) < handed_out / 20
