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
"""The drive's waveforms: no jump of phase or level, ramps, chirp and seeded noise, whatever the calls are cut into."""

from __future__ import annotations

import math

import attrs
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from impact_rig.arithmetic.random import Random
from impact_rig.config import Drive, Shaker
from impact_rig.errors import CommandError, ConfigError
from impact_rig.physics import FunctionGenerator

TICK_S = 0.01


def generator(seed: int = 1, ramp_s: float = 0.0, **drive: object) -> FunctionGenerator:
    return FunctionGenerator(
        attrs.evolve(Drive(), amplitude=0.5, **drive), attrs.evolve(Shaker(), ramp_s=ramp_s), Random(seed)
    )


def ends(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The drive at the start and at the end of each segment."""
    t = np.stack([np.zeros(len(rows)), rows["duration"]])
    values = (rows["amplitude"] + rows["growth"] * t) * np.sin(rows["omega"] * t + rows["phase"])
    return values[0], values[1]


@given(
    st.lists(st.tuples(st.floats(5.0, 200.0), st.floats(0.0, 5.0), st.integers(1, 2_000)), min_size=1, max_size=6),
    st.sampled_from([0.0, 0.1, 0.3]),
)
def test_a_sine_follows_from_its_last_change_and_ramp_to_the_last_bit(changes, ramp_s):
    """The rows agree with the formulas and libm's exact fmod; every phase is within a turn."""
    made, ramp = generator(ramp_s=ramp_s), math.ceil(ramp_s / TICK_S - 1e-9)
    made.segments(40)
    anchor, level = made.phase_rad, made.amplitude
    for frequency, amplitude, ticks in changes:
        made.set_frequency(frequency)
        made.set_amplitude(amplitude)
        rows = made.segments(ticks)
        turns = frequency * TICK_S * np.arange(ticks + 1)
        phases = np.fmod(anchor + 2 * math.pi * np.fmod(turns, 1.0), 2 * math.pi)
        begin, part = (level, np.arange(ticks + 1) / ramp) if ramp else (amplitude, np.ones(ticks + 1))
        levels = begin + (amplitude - begin) * np.minimum(part, 1.0)
        assert rows["phase"].tolist() == phases[:-1].tolist()
        assert rows["amplitude"].tolist() == levels[:-1].tolist()
        assert rows["growth"].tolist() == (np.diff(levels) / TICK_S).tolist()
        assert rows["omega"].tolist() == [2 * math.pi * frequency] * ticks
        assert rows["phase"].min() >= 0.0
        assert rows["phase"].max() < 2 * math.pi
        anchor, level = made.phase_rad, made.amplitude
        assert (anchor, level) == (phases[-1], levels[-1])


@pytest.mark.parametrize("waveform", ["sine", "chirp", "random"])
def test_a_drive_is_continuous_except_where_a_chirp_restarts(waveform):
    start, end = ends(generator(waveform=waveform, ramp_s=0.3).segments(500))
    assert np.abs(start[1:] - end[:-1]).max() <= 1e-12


@pytest.mark.heavy
@pytest.mark.parametrize("waveform", ["sine", "chirp", "random"])
@given(
    st.lists(
        st.tuples(st.floats(5.0, 200.0), st.floats(0.0, 5.0), st.floats(-500.0, 500.0), st.integers(1, 30)),
        min_size=1, max_size=8,
    )
)  # fmt: skip
def test_commands_and_a_drifting_clock_cause_no_jump(waveform, changes):
    """A chirp must continue after each of them from its own phase, not from that of a sine."""
    made = generator(waveform=waveform, ramp_s=0.1)
    rows = [made.segments(3)]
    for frequency, amplitude, ppm, ticks in changes:
        if waveform == "sine":  # the frequency of the others is no matter of a command
            made.set_frequency(frequency)
        made.set_amplitude(amplitude)
        made.set_tick(TICK_S * (1.0 + 1e-6 * ppm))
        rows.append(made.segments(ticks))
    start, end = ends(np.concatenate(rows))
    assert np.abs(start[1:] - end[:-1]).max() <= 1e-11


@pytest.mark.parametrize("waveform", ["sine", "chirp"])
@pytest.mark.parametrize("ticks", [1, 5, 700])
def test_the_reported_phase_is_that_of_the_next_segment(waveform, ticks):
    """Generators report the phase of a chirp, not that of a sine at its first frequency."""
    made = generator(waveform=waveform)
    made.segments(ticks)
    phase = made.phase_rad
    assert phase == made.segments(1)["phase"][0]


@pytest.mark.parametrize("waveform", ["sine", "chirp", "random"])
def test_a_drive_does_not_depend_on_the_division_into_calls(waveform):
    whole = generator(waveform=waveform, ramp_s=0.2).segments(700)
    made = generator(waveform=waveform, ramp_s=0.2)
    parts = np.concatenate([made.segments(count) for count in (1, 2, 7, 190, 500)])
    assert parts.tobytes() == whole.tobytes()


def test_the_phase_is_exact_after_a_million_ticks():
    """9.1 Hz and 10 ms: 0.091 turns per tick, exact in integers of a thousandth of a turn."""
    made = generator(frequency_hz=9.1)
    for _ in range(10):
        made.segments(100_000)
    turns = 91 * 1_000_000 % 1000 / 1000
    assert math.cos(made.phase_rad - 2.0 * math.pi * turns) == pytest.approx(1.0, abs=1e-12)


def test_a_ramp_is_linear_and_ends_at_its_target():
    made = generator(ramp_s=0.2)
    made.segments(100)
    made.set_amplitude(1.5)
    rows = made.segments(30)
    assert rows["amplitude"][:21] == pytest.approx(0.5 + np.arange(21) / 20)
    assert (rows["amplitude"][20:] == 1.5).all()
    assert not rows["growth"][20:].any()


def test_a_chirp_sweeps_between_its_frequencies_and_restarts():
    rows = generator(waveform="chirp", frequency_hz=5.0, chirp_end_hz=15.0, chirp_s=2.0).segments(400)
    frequency = rows["omega"] / (2.0 * math.pi)
    assert frequency[:200] == pytest.approx(5.0 + 10.0 * np.arange(200) / 200)
    assert (frequency[200:] == frequency[:200]).all()


def test_a_chirp_is_continuous_when_the_clock_starts_to_drift():
    """A phase counted from the start would jump, after hours of sweeps, by minutes of the clock's error."""
    made = generator(waveform="chirp", frequency_hz=5.0, chirp_end_hz=15.0, chirp_s=60.0)
    made.tick = 600_000
    before = made.segments(1)["omega"][0]
    made.set_tick(TICK_S * (1.0 + 100e-6))
    assert made.segments(1)["omega"][0] - before == pytest.approx(2.0 * math.pi * 10.0 / 6000, rel=1e-6)


@pytest.mark.heavy
def test_noise_is_reproducible_and_has_the_given_band_and_level():
    band = {"waveform": "random", "random_low_hz": 5.0, "random_high_hz": 15.0}
    level = generator(**band).segments(200_000)["amplitude"]
    assert level.tobytes() == generator(**band).segments(200_000)["amplitude"].tobytes()
    assert level.tobytes() != generator(seed=2, **band).segments(200_000)["amplitude"].tobytes()
    assert level.std() == pytest.approx(0.5, rel=0.03)  # the amplitude of random drive is its rms
    f, density = signal.welch(level, 1.0 / TICK_S, nperseg=4096)
    shares = [density[(f > low) & (f < high)].sum() / density.sum() for low, high in ((5.0, 15.0), (3.0, 20.0))]
    assert shares[0] > 0.9  # the filter's edges are its half-power points
    assert shares[1] > 0.99


@pytest.mark.parametrize("wrong", [0.0, -9.1, math.nan, math.inf])
def test_an_impossible_frequency_is_rejected(wrong):
    made = generator()
    before = made.frequency_hz
    with pytest.raises(CommandError, match=f"frequency must be finite and > 0 Hz, got {wrong}"):
        made.set_frequency(wrong)
    assert made.frequency_hz == before


@pytest.mark.parametrize("wrong", [-0.1, math.nan, math.inf])
def test_an_impossible_amplitude_is_rejected(wrong):
    with pytest.raises(CommandError, match=f"amplitude must be finite and >= 0, got {wrong}"):
        generator().set_amplitude(wrong)


def test_a_stream_accepts_no_amplitude_but_zero():
    made = generator(waveform="stream")
    with pytest.raises(CommandError, match=r"amplitude of a stream must be 0, which stops it .*, got 0\.1"):
        made.set_amplitude(0.1)
    made.set_amplitude(0.0)
    assert made.target_amplitude == 0.0


def test_a_band_above_the_rate_of_the_noise_is_rejected():
    with pytest.raises(
        ConfigError, match=r"^drive.random_high_hz must be < 45 Hz, .* one value per 0\.01 s, got 50 Hz"
    ):
        generator(waveform="random", random_high_hz=50.0)
