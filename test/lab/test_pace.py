# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The speed of rig time, of readings that come now and then."""

from __future__ import annotations

import pytest
from kits.recording import HandClock

from impact_rig.lab.pace import FOLLOWED, GAP_S, HURRIED, STALE_S, Pace


@pytest.fixture
def clock() -> HandClock:
    return HandClock()


def speed(clock: HandClock, pace: Pace, factor: float) -> float:
    """Return what a pace says after two readings, half a second apart."""
    pace.read(50.0)
    clock.now_s += 0.5
    return pace.read(50.0 + 0.5 * factor)


@pytest.mark.parametrize("factor", [0.5, 1.0, 4.0, 16.0])
def test_the_speed_is_that_between_two_readings(clock: HandClock, factor: float) -> None:
    pace = Pace(clock)
    assert speed(clock, pace, factor) == pytest.approx(factor)
    assert pace.is_hurried == (factor > HURRIED)
    assert pace.is_followed == (factor <= FOLLOWED)


def test_one_reading_says_nothing(clock: HandClock) -> None:
    pace = Pace(clock)
    assert pace.read(7.0) == 0.0
    assert pace.is_followed


def test_time_that_stands_has_no_speed_after_a_while(clock: HandClock) -> None:
    pace = Pace(clock)
    speed(clock, pace, 2.0)
    clock.now_s += STALE_S
    assert pace.read(51.0) == pytest.approx(2.0), "readings come twice a second at most"
    clock.now_s += 0.1
    assert pace.read(51.0) == 0.0


def test_a_reset_or_a_long_silence_gives_no_speed_of_its_own(clock: HandClock) -> None:
    pace = Pace(clock)
    speed(clock, pace, 2.0)
    clock.now_s += 0.5
    assert pace.read(0.1) == pytest.approx(2.0)
    clock.now_s += GAP_S
    assert pace.read(1000.0) == pytest.approx(2.0)
