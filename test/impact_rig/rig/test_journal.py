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
"""The journal contains all inputs: a re-simulation from it gives the same samples."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st
from kits.rig import START_NS, TICK, config, impacts, resimulated, same

from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.rig.journal import InputKind, JournalEntry, JournalView, last_journal
from impact_rig.rig.resimulation import Resimulation


def eventful(chosen: RigConfig, cuts: int) -> tuple[list[Block], list[JournalEntry], Rig]:
    """Run with every kind of input, and `cuts` advances between two of them."""
    rig, blocks = Rig(chosen, START_NS), []

    def go(ticks: int) -> None:
        end = rig.start_ns + ticks * TICK
        for k in range(1, cuts + 1):
            blocks.extend(rig.advance(rig.frontier_ns + (end - rig.frontier_ns) * k // cuts))

    go(13)
    rig.accept(amplitude=0.4)
    rig.accept(frequency_hz=9.05, amplitude=0.45)
    go(29)
    rig.configure({"barriers.gap_m": 0.003, "contact.law": "lankarani_nikravesh", "contact.restitution": 0.5})
    rig.configure({"instruments.laser.lag_s": 1e-3})
    rig.inject(Fault(kind="offset_step", channel="laser", start_sample=4000, samples=300, value=1e-3, seed=7))
    go(37)
    rig.accept(frequency_hz=12.0)
    go(50)
    rig.stop()
    go(55)
    rig.clear_trip()
    rig.accept(amplitude=0.52)
    rig.clear_fault()
    go(70)
    rig.pluck(0.001)
    go(80)
    return blocks, rig.take_journal(), rig


@pytest.mark.parametrize("cuts", [1, 5])
def test_a_resimulation_needs_only_the_journal(cuts: int) -> None:
    blocks, journal, _ = eventful(config(daq__block_scans=250, daq__seed=9), cuts)
    assert len(blocks) > 30
    assert same(impacts(resimulated(blocks, journal)), impacts(blocks))


def test_a_resimulation_begins_at_the_last_reset() -> None:
    _, _, rig = eventful(config(), 2)
    rig.reset()
    blocks = rig.advance(rig.start_ns + 10 * TICK)
    rig.accept(amplitude=0.3)
    blocks += rig.advance(rig.start_ns + 20 * TICK)
    resimulated(blocks, rig.take_journal())


def test_a_fault_planned_ahead_hides_no_later_change_before_a_reset() -> None:
    """If no block comes before the reset, changes after such a fault must not be left out."""
    rig = Rig(config(daq__block_scans=1000))
    rig.inject(Fault(kind="dropout", channel="laser", start_sample=50_000))
    rig.advance(2 * TICK)
    rig.configure({"instruments.laser.lag_s": 1e-3})
    again = Resimulation(rig.take_journal())
    again.finish(3 * TICK)
    assert [one.instruments.laser.lag_s for one in again.configurations] == [0.7e-3, 1e-3]
    assert any(entry.kind is InputKind.FAULT for entry in again.rig.take_journal())


def test_a_journal_with_a_missing_entry_is_rejected() -> None:
    _, journal, _ = eventful(config(), 1)
    with pytest.raises(ConfigError, match=r"is incomplete: entry 3, .*, is missing \(found 4 instead\)"):
        last_journal([*journal[:3], *journal[4:]])
    with pytest.raises(ConfigError, match="has no entry"):
        last_journal([])
    with pytest.raises(ConfigError, match="must begin with a start or reset, got parameter"):
        last_journal([JournalEntry(0, InputKind.PARAMETER, 0, 0), *journal[1:]])


def test_an_entry_stores_every_kind_of_value_exactly() -> None:
    changes = {
        "barriers.gap_m": 0.1 + 0.2,
        "daq.seed": 2**53,
        "sphere.present": False,
        "contact.law": "lankarani_nikravesh",
        "instruments.faults.planned": ("stuck channel=laser start_s=1 duration_s=0.5", "lost_block start_s=2.5 seed=3"),
    }
    (start,) = Rig(from_flat(RigConfig(), changes)).take_journal()
    assert JournalEntry.from_line(start.line()).values == changes


def test_an_entry_is_one_json_object_without_unused_fields() -> None:
    rig = Rig(config())
    rig.take_journal()
    rig.accept(frequency_hz=9.05)
    (entry,) = rig.take_journal()
    found = {"sequence": 1, "kind": "command", "sample": 0, "stamp_ns": 0, "name": "frequency", "value": 9.05}
    assert json.loads(entry.line()) == found


def test_every_entry_is_read_back_from_its_line() -> None:
    _, journal, _ = eventful(config(), 1)
    assert {entry.kind for entry in journal} > {InputKind.START, InputKind.FAULT, InputKind.PLUCK, InputKind.PARAMETER}
    again = [JournalEntry.from_line(entry.line()) for entry in journal]
    assert [entry.line() for entry in again] == [entry.line() for entry in journal]


WHOLE = st.integers(0, 2**53)


@given(WHOLE, WHOLE, WHOLE, st.floats(allow_nan=False, allow_infinity=False), st.floats(1e-300, 1e300))
def test_every_number_of_a_fault_is_read_back_exactly(start, samples, seed, value, rate):
    fault = Fault(
        kind="spike_train", channel="laser", start_sample=start, samples=samples, seed=seed, value=value, rate_hz=rate
    )
    entry = JournalEntry(3, InputKind.FAULT, start, 0, fault=fault)
    assert JournalEntry.from_line(entry.line()).fault == fault


def test_a_view_follows_a_journal_entry_by_entry() -> None:
    """Re-simulation, playback and page read the journal alike: complete inputs, and the state after each of them."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "contact.law": "hunt_crossley"}), START_NS)
    view = JournalView()

    def followed() -> list[InputKind]:
        entries = rig.take_journal()
        for entry in entries:
            view.follow(entry)
        return [entry.kind for entry in entries]

    rig.advance(START_NS + 5 * TICK)
    rig.accept(frequency_hz=9.1, amplitude=0.3)
    rig.configure({"barriers.gap_m": 0.004, "sphere.present": True, "contact.law": "lankarani_nikravesh"})
    assert followed() == [InputKind.START, InputKind.COMMAND, InputKind.COMMAND, InputKind.PARAMETER]
    assert view.start_ns == START_NS
    assert (view.configuration["daq.seed"], view.configuration["contact.law"]) == (5, "lankarani_nikravesh")
    assert view.configuration["barriers.gap_m"] == 0.004
    assert (view.drive, view.latched, view.plucked) == ({"frequency": 9.1, "current": 0.3}, None, False)
    rig.stop()
    assert followed() == [InputKind.STOP]
    assert view.latched is not None
    assert view.latched.kind is InputKind.STOP
    rig.clear_trip()
    rig.pluck(0.001)
    assert followed() == [InputKind.CLEAR_TRIP, InputKind.PLUCK]
    assert (view.latched, view.plucked) == (None, True)
    rig.reset()
    assert followed()[0] is InputKind.RESET
    assert (view.plucked, view.drive, view.configuration["barriers.gap_m"]) == (False, {}, 0.004)
