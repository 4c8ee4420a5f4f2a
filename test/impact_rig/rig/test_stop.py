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
"""Stops of the shaker: the operator, over-travel and over-current; each is latched until it is cleared."""

from __future__ import annotations

import contextlib
import random
from collections.abc import Callable, Iterable

import numpy as np
import pytest
from kits.rig import TICK, config, paper_rig, resimulated, samples

from impact_rig.errors import CommandError, ImpactRigError
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig
from impact_rig.rig.journal import InputKind, JournalEntry


def test_the_emergency_stop_ramps_and_latches() -> None:
    rig = Rig(config(instruments__ideal=True))
    rig.advance(30 * TICK)
    rig.stop()
    current = samples(rig.advance(60 * TICK))["current"]
    assert np.abs(current[:500]).max() > 0.2, "a ramp, not a cut"
    assert np.abs(current[1000:]).max() == 0, "zero after shaker.stop_ramp_s"
    for refused in ({"amplitude": 0.1}, {"frequency_hz": 9.0}):
        with pytest.raises(CommandError, match="clear_trip"):
            rig.accept(**refused)
    with pytest.raises(CommandError, match="clear_trip"):
        rig.reset()
    rig.clear_trip()
    assert rig.target_amplitude == 0
    rig.accept(amplitude=0.1)


def travel(blocks: list[Block]) -> np.ndarray:
    """True displacement of the table at every scan [m]."""
    return np.concatenate([block.truth.rows["x_b"] for block in blocks])


@pytest.mark.heavy
@pytest.mark.parametrize("step", [1, 7, 200])
def test_over_travel_trips_within_a_tick_for_any_division_into_calls(step: int) -> None:
    """5 A at 8 Hz drive the table far beyond 2 mm."""
    chosen = config(
        drive__amplitude=5.0, drive__frequency_hz=8.0, shaker__travel_limit_m=0.002, output__truth_scan=True
    )
    rig, blocks = Rig(chosen), []
    while len(blocks) < 200:
        blocks += rig.advance((len(blocks) + step) * TICK)
    entries = rig.take_journal()
    (trip,) = [entry for entry in entries if entry.kind is InputKind.TRIP]
    first = int(np.argmax(np.abs(travel(blocks)) > 0.002))
    assert trip.name == "over_travel"
    assert first < trip.sample <= first + 100, "at the end of the tick in which the limit was exceeded"
    assert trip.value > 0.002
    assert rig.latched is not None
    assert rig.latched.startswith("over_travel")
    assert rig.latched.endswith("limit 2 mm")
    resimulated(blocks, journal_of(chosen, 200))


def journal_of(chosen: RigConfig, blocks: int) -> list[JournalEntry]:
    """Return the journal of the same rig, advanced in one go."""
    rig = Rig(chosen)
    rig.advance(blocks * TICK)
    return rig.take_journal()


def test_over_current_trips_on_the_rms_of_the_true_current() -> None:
    """A voltage drive does not command the current: here it is far above the limit."""
    rig = Rig(config(drive__kind="voltage", drive__amplitude=2.0, shaker__current_limit_a_rms=2.0))
    rig.configure({"shaker.current_limit_a_rms": 0.1, "shaker.travel_limit_m": 1.0})
    rig.advance(300 * TICK)
    assert rig.latched is not None
    assert rig.latched.startswith("over_current")


def test_a_trip_for_current_is_cleared_at_once() -> None:
    """Averages from before the trip do not count."""
    rig = Rig(config(drive__amplitude=0.52, sphere__present=False))
    rig.advance(500 * TICK)
    rig.configure({"shaker.current_limit_a_rms": 0.1})
    rig.advance(600 * TICK)
    assert rig.latched is not None
    rig.clear_trip()
    rig.advance(700 * TICK)
    assert rig.latched is None


AT_REST_TICKS = 50  # after the first stop or trip
QUIET = {
    "sphere__present": False,
    "instruments__ideal": True,
    "daq__rate_hz": 1000,
    "daq__block_scans": 10,
    "output__truth_scan": True,
}
STREAM = {"drive__waveform": "stream", "drive__on_underrun": "hold", "drive__stream_buffer_s": 10.0}
DRIVES: list[dict[str, object]] = [
    {"drive__amplitude": 3.0},
    {"drive__kind": "prescribed", "drive__amplitude": 1e-3},
    {"drive__waveform": "random", "drive__amplitude": 1.0},
    {"drive__waveform": "chirp", "drive__amplitude": 1.0},
    {**STREAM, "drive__stream_rate_hz": 1},
    {**STREAM, "drive__stream_rate_hz": 1, "drive__stream_hold": "zero_order"},
    {**STREAM, "drive__stream_rate_hz": 997},
]


def driven(blocks: Iterable[Block], quantity: str = "current") -> np.ndarray:
    """Return the prescribed drive at every scan of the blocks."""
    return np.concatenate([block.truth.rows[quantity] for block in blocks])


def feed(rig: Rig, value: float, samples: int = 8) -> None:
    rig.feed(rig.stream.played + rig.stream.buffered(), [value] * samples)


@pytest.mark.parametrize("again", ["stop", "pluck", "ramp", "trip"])
def test_later_inputs_do_not_prolong_a_stop(again: str) -> None:
    """This holds for any ramp of ordinary commands, and for all inputs while the shaker is latched."""
    rig = Rig(paper_rig(**QUIET, drive__amplitude=3.0, shaker__ramp_s=60.0))
    rig.configure({"shaker.ramp_s": 0.0})
    rig.accept(amplitude=3.0)
    rig.configure({"shaker.ramp_s": 60.0})
    rig.advance(100 * TICK)
    rig.stop()
    blocks = []
    for _ in range(30):
        if again == "stop":
            rig.stop()
        elif again == "ramp":
            rig.configure({"shaker.ramp_s": 100.0 - rig.config.shaker.ramp_s})
        elif again == "trip":
            rig.configure({"shaker.travel_limit_m": 1e-6})
        elif not rig.plucked:
            rig.pluck(1e-3)
        blocks += rig.advance(rig.frontier_ns + TICK)
    current = driven(blocks)
    assert np.abs(current[:90]).max() > 0.0 or again == "pluck"  # a locked base carries no current at all
    assert np.abs(current[100:]).max() == 0.0


def test_a_stop_has_its_own_ramp_and_ends_a_longer_one_to_zero() -> None:
    rig = Rig(paper_rig(**QUIET, shaker__ramp_s=0.0, shaker__stop_ramp_s=0.3))
    rig.accept(amplitude=3.0)
    rig.advance(50 * TICK)
    rig.configure({"shaker.ramp_s": 60.0})
    rig.accept(amplitude=0.0)
    rig.advance(70 * TICK)
    rig.stop()
    current = np.abs(driven(rig.advance(120 * TICK)))
    assert current[150:290].max() > 0.3
    assert current[300:].max() == 0.0


@pytest.mark.parametrize("ramp_s", [0.0, 0.1])
def test_a_rig_stopped_before_its_first_tick_never_moves(ramp_s: float) -> None:
    rig = Rig(paper_rig(**QUIET, drive__amplitude=3.0, shaker__ramp_s=ramp_s))
    rig.stop("what stopped the one before")
    blocks = rig.advance(100 * TICK)
    assert not driven(blocks).any()
    assert rig.latched == "what stopped the one before"
    resimulated(blocks, rig.take_journal())


def test_the_interlock_watches_a_latched_shaker_and_reports_each_reason_once() -> None:
    rig = Rig(paper_rig(drive__amplitude=5.0, drive__frequency_hz=8.0))
    rig.advance(100 * TICK)
    rig.stop()
    rig.configure({"shaker.travel_limit_m": 1e-4})
    blocks = rig.advance(200 * TICK)
    trips = [row.name for row in rig.take_journal() if row.kind is InputKind.TRIP]
    assert trips == ["over_travel"]
    assert (rig.latched or "").startswith("over_travel")
    assert blocks


@pytest.mark.parametrize("hold", ["first_order", "zero_order"])
@pytest.mark.parametrize("when", ["playing", "holding", "ramping"])
def test_a_stream_of_slow_samples_stops_as_quickly_as_a_sine(hold: str, when: str) -> None:
    """Samples may be a second apart: the stop must not wait for the next one, nor for a ramp in samples."""
    rig = Rig(
        paper_rig(**{
            **QUIET, **STREAM, "drive__stream_rate_hz": 1, "drive__stream_hold": hold, "shaker__ramp_s": 60.0,
            "drive__on_underrun": "hold" if when == "holding" else "ramp",
        })
    )  # fmt: skip
    feed(rig, 2.0, 2 if when != "playing" else 8)
    before = driven(rig.advance(355 * TICK))
    rig.stop()
    after = np.abs(driven(rig.advance(600 * TICK)))
    assert abs(before[-1]) > 1.0
    assert abs(abs(before[-1]) - after[0]) < 0.05, "no jump"
    assert after[:90].min() > 0.0
    assert after[100:].max() == 0.0


def sequence(seed: int) -> None:
    """Drive a rig by a random sequence of inputs; check that it comes to rest in time and stays at rest."""
    chance = random.Random(seed)
    rig = Rig(paper_rig(**QUIET, **DRIVES[seed % len(DRIVES)], shaker__ramp_s=chance.choice([0.0, 0.1, 60.0])))
    is_stream, quantity = rig.takes_samples, "x_b" if rig.config.drive.kind == "prescribed" else "current"
    inputs: list[Callable[[], object]] = [
        rig.stop,
        lambda: rig.configure({"shaker.travel_limit_m": chance.choice([1e-6, 0.1])}),
        lambda: rig.configure({"shaker.current_limit_a_rms": chance.choice([0.01, 15.0])}),
        lambda: rig.configure({"shaker.ramp_s": chance.choice([0.0, 0.05, 60.0])}),
        lambda: rig.configure({"shaker.stop_ramp_s": chance.choice([0.0, 0.1, 0.3])}),
        lambda: rig.configure({"daq.clock_error_ppm": chance.uniform(-100.0, 100.0)}),
        lambda: rig.pluck(1e-3),
        rig.reset,
        lambda: feed(rig, chance.uniform(-3.0, 3.0)) if is_stream else rig.accept(amplitude=1e-3),
        rig.clear_trip,
    ]
    stopped_at = None
    for _ in range(30):
        with contextlib.suppress(ImpactRigError):
            chance.choice(inputs)()
        for _ in range(chance.choice([0, 1, 3, 20])):
            stopped_at = None if rig.latched is None else stopped_at or rig.frontier_ns
            blocks = rig.advance(rig.frontier_ns + TICK)
            if stopped_at is not None and rig.frontier_ns > stopped_at + AT_REST_TICKS * TICK:
                assert not driven(blocks, quantity).any(), f"seed {seed}, {rig.latched}"


@pytest.mark.heavy
@pytest.mark.parametrize("first", range(0, 140, 35))
def test_the_drive_is_zero_half_a_second_after_a_stop_until_it_is_cleared(first: int) -> None:
    for seed in range(first, first + 35):
        sequence(seed)


@pytest.mark.slow
def test_two_thousand_sequences_never_drive_a_stopped_shaker() -> None:
    for seed in range(2000):
        sequence(seed)
