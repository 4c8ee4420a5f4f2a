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
"""Commands act at the first instant that is not simulated yet, or are rejected and change nothing."""

from __future__ import annotations

import contextlib
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.rig import TICK, config, same, samples

from impact_rig.errors import CommandError, ConfigError
from impact_rig.rig import Block, Rig
from impact_rig.rig.journal import InputKind


def test_a_command_acts_at_the_first_instant_not_yet_simulated(reference: list[Block]) -> None:
    rig = Rig(config())
    blocks = rig.advance(20 * TICK + 3_000_000)
    applied = rig.accept(frequency_hz=11.0)
    row = applied.rows[0]
    assert (int(row["sample"]), applied.stamp_ns) == (2000, 20 * TICK)
    assert (row["frequency"], row["current"]) == (11.0, 0.52)
    assert row["phase"] == pytest.approx(math.fmod(2 * math.pi * 9.1 * 0.2, 2 * math.pi), abs=1e-12)
    blocks += rig.advance(40 * TICK)
    assert same(samples(blocks)[:2000], samples(reference)[:2000])


def test_a_command_acts_exactly_from_its_scan_on() -> None:
    """Ideal instruments read the drive itself: 9.1 Hz up to scan 2000, 11 Hz from there, without a jump of phase."""
    rig = Rig(config(instruments__ideal=True))
    blocks = rig.advance(20 * TICK + 3_000_000)
    rig.accept(frequency_hz=11.0)
    blocks += rig.advance(40 * TICK)
    time = np.arange(4000) / rig.rate_hz
    turns = np.where(time < 0.2, 9.1 * time, 9.1 * 0.2 + 11.0 * (time - 0.2))
    amplitude = 0.52 * np.minimum(time / rig.config.shaker.ramp_s, 1.0)
    assert samples(blocks)["current"] == pytest.approx(amplitude * np.sin(2 * math.pi * turns), abs=1e-9)


def test_the_drive_has_no_jump_of_phase_at_a_command() -> None:
    rig = Rig(config(instruments__ideal=True))
    blocks = rig.advance(10 * TICK)
    rig.accept(frequency_hz=50.0)
    blocks += rig.advance(20 * TICK)
    current = samples(blocks)["current"]
    fastest = 0.52 * 2 * math.pi * 50.0 / 10_000
    assert np.abs(np.diff(current)).max() <= fastest * (1 + 1e-9)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"frequency_hz": math.nan}, ["frequency", "5", "200", "nan"]),
        ({"frequency_hz": math.inf}, ["frequency", "inf"]),
        ({"frequency_hz": 4.99}, ["frequency", "4.99"]),
        ({"frequency_hz": 1e308}, ["frequency", "1e+308"]),
        ({"frequency_hz": -9.1}, ["frequency", "-9.1"]),
        ({"amplitude": math.nan}, ["current", "nan"]),
        ({"amplitude": -0.1}, ["current", "-0.1"]),
        ({"amplitude": 15.0 * math.sqrt(2) * 1.0001}, ["current", "21.21", "15 A", "current_limit_a_rms"]),
        ({"amplitude": math.inf}, ["current", "inf"]),
        ({"frequency_hz": 9.0, "amplitude": math.nan}, ["current", "nan"]),
    ],
)
def test_a_rejected_command_names_value_and_range_and_changes_nothing(
    command: dict[str, float], words: list[str]
) -> None:
    rig = Rig(config())
    rig.take_journal()
    with pytest.raises(CommandError) as refusal:
        rig.accept(**command)
    for word in words:
        assert word in str(refusal.value)
    assert (rig.frequency_hz, rig.target_amplitude) == (9.1, 0.52)
    assert rig.take_journal() == []


@pytest.mark.parametrize("waveform", ["chirp", "random"])
def test_a_drive_with_many_frequencies_rejects_a_frequency_command(waveform: str) -> None:
    """Such a command would change nothing, so it is rejected and not journaled; an amplitude is accepted."""
    rig = Rig(config(drive__waveform=waveform))
    rig.advance(10 * TICK)
    rig.take_applied(), rig.take_journal()
    for command in ({"frequency_hz": 11.0}, {"frequency_hz": 11.0, "amplitude": 0.1}):
        with pytest.raises(
            CommandError,
            match=f"the drive is {waveform}: it accepts no frequency.*set drive.waveform to sine",
        ):
            rig.accept(**command)
    assert (rig.take_applied(), rig.take_journal(), rig.target_amplitude) == ([], [], 0.52)
    rig.accept(amplitude=0.1)
    assert rig.target_amplitude == 0.1
    rig.configure({"drive.waveform": "sine"})  # the remedy in the message
    rig.reset()
    rig.accept(frequency_hz=11.0)
    assert rig.frequency_hz == 11.0


def test_the_initial_drive_is_checked_like_a_command() -> None:
    with pytest.raises(ConfigError, match=r"drive\.amplitude: current must be"):
        Rig(config(drive__amplitude=30.0))


@given(st.floats(), st.floats())
@settings(max_examples=2000)
@pytest.mark.repeats
def test_any_command_is_accepted_within_its_range_or_rejected(hammered: Rig, frequency: float, current: float) -> None:
    """After any command, the drive stays finite and within the limits of the shaker."""
    for command in ({"frequency_hz": frequency}, {"amplitude": current}, {"frequency_hz": 5 + abs(frequency) % 195}):
        with contextlib.suppress(CommandError):
            hammered.accept(**command)
    assert 5 <= hammered.frequency_hz <= 200
    assert 0 <= hammered.target_amplitude <= 15 * math.sqrt(2)
    assert all(0 <= table.rows["phase"][0] < 2 * math.pi for table in hammered.take_applied())
    hammered.take_journal()


def test_the_drive_ramps_down_when_the_controller_falls_silent() -> None:
    rig = Rig(config(output__command_timeout_s=0.2, instruments__ideal=True))
    rig.advance(15 * TICK)
    rig.accept(amplitude=0.52)
    current = samples(rig.advance(60 * TICK))["current"]
    at = [entry.sample for entry in rig.take_journal() if entry.kind is InputKind.TIMEOUT]
    assert at == [3500]
    assert np.abs(current[3500 + 1000 - 1500 :]).max() == 0
    rig.accept(amplitude=0.1)
    assert rig.target_amplitude == 0.1
