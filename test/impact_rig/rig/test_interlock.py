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
"""Protection of the shaker: limits that cannot be bypassed, and the interlock on the true motion."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.rig import TICK, paper_rig

from impact_rig.errors import CommandError, ConfigError
from impact_rig.rig import Rig
from impact_rig.rig.interlock import SAMPLES_PER_TICK, largest_travel, mean_square
from impact_rig.rig.journal import InputKind

SAMPLE_S = 1e-2 / SAMPLES_PER_TICK
FINE_HZ = 50_000
AT_RESONANCE = {"drive__frequency_hz": 9.105, "shaker__travel_limit_m": 1e-3}
BELOW_IT = {"drive__frequency_hz": 8.0}  # where the table moves most


def test_a_new_kind_of_drive_waits_for_the_reset_and_keeps_the_interlock_active() -> None:
    """The interlock must use the kind of drive that is active, not the one that the next reset will select."""
    rig = Rig(paper_rig(drive__frequency_hz=8.0, shaker__travel_limit_m=2e-3))
    rig.configure({"drive.kind": "prescribed"})
    rig.accept(amplitude=5.0)
    rig.advance(200 * TICK)
    assert rig.latched is not None
    assert re.fullmatch(r"over_travel: [\d.]+ mm of travel, limit [\d.]+ mm", rig.latched)


def test_an_initial_drive_beyond_the_shaker_is_rejected_when_it_is_set() -> None:
    rig = Rig(paper_rig())
    with pytest.raises(ConfigError, match=r"drive\.amplitude: current must be"):
        rig.configure({"drive.amplitude": 30.0})
    assert rig.config == paper_rig()


def test_a_kind_of_drive_that_the_shaker_cannot_serve_is_rejected_when_it_is_set() -> None:
    """A prescribed base has no shaker; if only the reset found this out, the rig could not start."""
    stiff = {"shaker.coil_inductance_h": 1e-7}
    for first, then in (({}, {**stiff, "drive.kind": "voltage"}), (stiff, {"drive.kind": "voltage"})):
        rig = Rig(paper_rig(drive__kind="prescribed", drive__amplitude=0.0))
        rig.configure(first)
        before = rig.config
        with pytest.raises(ConfigError, match="each mode of structure and shaker must have a rate"):
            rig.configure(then)
        assert rig.config == before
        rig.reset()
    rig = Rig(paper_rig(drive__kind="prescribed", drive__amplitude=0.0))
    rig.configure({"drive.kind": "voltage"})
    with pytest.raises(ConfigError, match="each mode of structure and shaker must have a rate"):
        rig.configure(stiff)


def test_a_rejected_reset_changes_nothing() -> None:
    """The initial drive must be checked before the new start is noted; otherwise, time would jump."""
    rig, twin = Rig(paper_rig(drive__amplitude=2.0)), Rig(paper_rig(drive__amplitude=2.0))
    for one in (rig, twin):
        one.advance(20 * TICK)
        one.configure({"shaker.current_limit_a_rms": 1.0})  # below what the next reset would begin with
    with pytest.raises(ConfigError, match=r"drive\.amplitude: current"):
        rig.reset()
    assert (rig.start_ns, rig.frontier_ns) == (twin.start_ns, twin.frontier_ns)
    for one, two in zip(rig.advance(40 * TICK), twin.advance(40 * TICK), strict=True):
        assert one.scan.rows.tobytes() == two.scan.rows.tobytes()
    assert rig.take_journal() == twin.take_journal()


@pytest.mark.parametrize(
    "chosen",
    [
        {**AT_RESONANCE, "drive__amplitude": 15.0},
        {**AT_RESONANCE, "drive__amplitude": 15.0, "sphere__present": False},
        {**BELOW_IT, "drive__amplitude": 7.0},
        {**BELOW_IT, "drive__amplitude": 5.6, "barriers__gap_m": 0.01},  # slowly, by a little
    ],
    ids=["resonance", "no sphere", "below resonance", "a little too much"],
)
def test_over_travel_trips_within_a_block_and_ramps_as_specified(chosen: dict) -> None:
    """The truth at 50 kS/s shows when the table passed its limit; the current then falls linearly in 0.1 s."""
    rig = Rig(paper_rig(**chosen, daq__rate_hz=FINE_HZ, daq__block_scans=500, output__truth_scan=True))
    limit, blocks = rig.config.shaker.travel_limit_m, []
    while rig.latched is None and rig.frontier_ns < 1000 * TICK:
        blocks += rig.advance(rig.frontier_ns + TICK)
    (trip,) = [entry for entry in rig.take_journal() if entry.kind is InputKind.TRIP]
    truth = np.concatenate([block.truth.rows for block in blocks])
    beyond = np.abs(truth["x_b"]) > limit
    assert beyond.any()
    first = int(np.argmax(beyond))
    assert first < trip.sample <= first + rig.config.daq.block_scans
    a_scan = 1.1 * np.abs(truth["v_b"]).max() / FINE_HZ  # the largest may be at the tick's end, one scan further on
    assert trip.value == pytest.approx(np.abs(truth["x_b"])[first : trip.sample].max(), abs=a_scan)

    after = np.concatenate([block.truth.rows for block in rig.advance(rig.frontier_ns + 30 * TICK)])
    ramp = int(rig.config.shaker.ramp_s * FINE_HZ)
    envelope = rig.config.drive.amplitude * (1.0 - (np.arange(ramp) + 1) / ramp)
    assert np.all(np.abs(after["current"][:ramp]) <= envelope + 1e-3 * envelope[0])
    assert np.abs(after["current"][: ramp // 2]).max() > 0.3 * envelope[0], "a ramp, not a cut"
    assert np.abs(after["current"][ramp:]).max() == 0.0


def test_a_trip_is_cleared_only_on_request_and_the_amplitude_stays_zero() -> None:
    rig = Rig(paper_rig(**BELOW_IT, drive__amplitude=8.0))
    rig.advance(300 * TICK)
    assert rig.latched is not None
    for refused in (lambda: rig.accept(amplitude=0.1), lambda: rig.accept(frequency_hz=9.0), rig.reset):
        with pytest.raises(CommandError, match="clear_trip"):
            refused()
    rig.configure({"shaker.travel_limit_m": 0.1, "barriers.gap_m": 0.004})
    rig.stop()
    rig.advance(900 * TICK)
    assert rig.latched is not None, "neither time nor a change of the limit nor another stop clears it"
    rig.clear_trip()
    assert (rig.latched, rig.target_amplitude) == (None, 0.0)
    blocks = rig.advance(1000 * TICK)
    assert max(np.abs(block.monitor_states["current"]).max() for block in blocks if len(block.monitor_states)) == 0.0
    rig.accept(amplitude=0.1)


def test_the_largest_accepted_current_does_not_trip() -> None:
    """The average of a sine ripples, and at the limit, the ripple must not pass it."""
    rig = Rig(paper_rig(drive__frequency_hz=5.0, shaker__travel_limit_m=1.0))
    rig.accept(amplitude=rig.config.shaker.current_limit_a_rms * math.sqrt(2.0))
    rig.advance(800 * TICK)
    assert rig.latched is None


def test_clearing_a_shaker_that_is_not_latched_keeps_the_average_current() -> None:
    """If `~/clear_trip` restarted the average on a free rig, frequent calls would disable the interlock."""
    trips = []
    for clears in (False, True):
        rig = Rig(paper_rig(drive__frequency_hz=5.0, shaker__travel_limit_m=1.0))
        rig.accept(amplitude=2.0)
        rig.configure({"shaker.current_limit_a_rms": 0.5})
        for _ in range(200):
            rig.advance(rig.frontier_ns + TICK)
            if clears and rig.latched is None:
                rig.clear_trip()
        trips.append([(row.sample, row.name, row.value) for row in rig.take_journal() if row.kind is InputKind.TRIP])
    assert [key for _, key, _ in trips[0]] == ["over_current"]
    assert trips[1] == trips[0]


def test_the_average_of_the_current_excludes_the_first_instant_of_a_tick() -> None:
    assert mean_square(np.array([9.0, 1.0, 2.0, 3.0])) == pytest.approx(14.0 / 3.0)


@given(st.floats(1.0, 30.0), st.floats(0.0, 2 * math.pi), st.floats(-1.0, 1.0))
def test_an_extreme_between_two_checks_is_found(frequency_hz: float, phase: float, offset: float) -> None:
    """The error is h⁴ ω⁴ / 384 of the amplitude, which is 3e-6 at 30 Hz."""
    omega = 2 * math.pi * frequency_hz
    instants, fine = np.arange(SAMPLES_PER_TICK + 1) * SAMPLE_S, np.linspace(0.0, SAMPLES_PER_TICK * SAMPLE_S, 100_001)
    position = offset + np.sin(omega * instants + phase)
    velocity = omega * np.cos(omega * instants + phase)
    found = largest_travel(position, velocity, SAMPLE_S)
    true = np.abs(offset + np.sin(omega * fine + phase)).max()
    assert found == pytest.approx(true, abs=(omega * SAMPLE_S) ** 4 / 384 + 1e-9)


def test_a_saddle_at_a_check_needs_no_root_of_a_negative_number() -> None:
    """The root of a negative number must neither raise (plain Python) nor be NaN (compiled)."""
    rate = 0.9693949389499377
    assert largest_travel(np.array([0.0, rate / 3.0]), np.array([rate, -1e-22]), 1.0) == pytest.approx(rate / 3.0)
