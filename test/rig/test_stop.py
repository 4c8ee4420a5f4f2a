# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What stops the shaker: the operator, over-travel and over-current; latched until it is cleared."""

from __future__ import annotations

import numpy as np
import pytest
from kits.rig import TICK, config, resimulated, samples

from impact_rig.blocks import Table
from impact_rig.errors import CommandError
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig
from impact_rig.rig.journal import InputKind, read


def test_the_emergency_stop_ramps_and_latches() -> None:
    rig = Rig(config(instruments__ideal=True))
    rig.advance(30 * TICK)
    rig.stop()
    current = samples(rig.advance(60 * TICK))["current"]
    assert np.abs(current[:500]).max() > 0.2, "a ramp, not a cut"
    assert np.abs(current[1000:]).max() == 0, "zero after shaker.ramp_s"
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


@pytest.mark.parametrize("step", [1, 7, 200])
def test_over_travel_trips_within_a_tick_whatever_the_cut(step: int) -> None:
    """5 A at 8 Hz drive the table far beyond 2 mm."""
    chosen = config(
        drive__amplitude=5.0, drive__frequency_hz=8.0, shaker__travel_limit_m=0.002, output__truth_scan=True
    )
    rig, blocks = Rig(chosen), []
    while len(blocks) < 200:
        blocks += rig.advance((len(blocks) + step) * TICK)
    entries = read(rig.take_journal())
    (trip,) = [entry for entry in entries if entry.kind is InputKind.TRIP]
    first = int(np.argmax(np.abs(travel(blocks)) > 0.002))
    assert trip.key == "over_travel"
    assert first < trip.sample <= first + 100, "at the end of the tick in which the limit was exceeded"
    assert trip.value > 0.002
    assert rig.latched is not None
    assert rig.latched.startswith("over_travel")
    assert "0.002" in rig.latched
    resimulated(blocks, journal_of(chosen, 200))


def journal_of(chosen: RigConfig, blocks: int) -> list[Table]:
    """The journal of the same rig, advanced in one go."""
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
    """What was averaged before belongs to the past."""
    rig = Rig(config(drive__amplitude=0.52, sphere__present=False))
    rig.advance(500 * TICK)
    rig.configure({"shaker.current_limit_a_rms": 0.1})
    rig.advance(600 * TICK)
    assert rig.latched is not None
    rig.clear_trip()
    rig.advance(700 * TICK)
    assert rig.latched is None
