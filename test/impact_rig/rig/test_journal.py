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
"""The journal tells everything: the same samples come out of it again."""

from __future__ import annotations

import numpy as np
import pytest
from kits.rig import START_NS, TICK, config, impacts, resimulated, same

from impact_rig.blocks import JOURNAL, Table
from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.rig import Block, Rig
from impact_rig.rig.config import RigConfig, from_flat, to_flat
from impact_rig.rig.journal import InputKind, JournalView, read, short_key, values_of
from impact_rig.rig.resimulation import Resimulation


def eventful(chosen: RigConfig, cuts: int) -> tuple[list[Block], list[Table], Rig]:
    """A run with every kind of input; `cuts` advances between two of them."""
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
def test_the_journal_is_all_a_resimulation_needs(cuts: int) -> None:
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


def test_a_fault_ordered_ahead_does_not_end_what_a_resimulation_is_given_before_a_reset() -> None:
    """A bug once: where no block came before the reset, changes behind such a fault were left out."""
    rig = Rig(config(daq__block_scans=1000))
    rig.inject(Fault(kind="dropout", channel="laser", start_sample=50_000))
    rig.advance(2 * TICK)
    rig.configure({"instruments.laser.lag_s": 1e-3})
    again = Resimulation(rig.take_journal())
    again.finish(3 * TICK)
    assert [one.instruments.laser.lag_s for one in again.configurations] == [0.7e-3, 1e-3]
    assert any(entry.kind is InputKind.FAULT for entry in read(again.rig.take_journal()))


def test_a_journal_with_a_missing_row_is_refused() -> None:
    _, journal, _ = eventful(config(), 1)
    with pytest.raises(ConfigError, match=r"row 3 is missing"):
        read([journal[0], *journal[2:]])
    with pytest.raises(ConfigError, match="empty"):
        read([])


def test_journal_rows_carry_every_kind_of_value_exactly() -> None:
    changes = {
        "barriers.gap_m": 0.1 + 0.2,
        "daq.seed": 2**53,
        "sphere.present": False,
        "contact.law": "lankarani_nikravesh",
        "instruments.faults.planned": ("stuck channel=laser start_s=1 duration_s=0.5", "lost_block start_s=2.5 seed=3"),
    }
    rig = Rig(from_flat(RigConfig(), changes))
    initial = [entry for entry in read(rig.take_journal()) if entry.kind is InputKind.INITIAL]
    assert values_of(initial) == changes


def test_short_keys_of_configuration_values_are_unique() -> None:
    names = list(to_flat(RigConfig()))
    assert len({short_key(name) for name in names}) == len(names)
    assert all(len(short_key(name).encode()) <= 32 for name in names)


def test_a_view_follows_what_a_journal_says_table_by_table() -> None:
    """What resimulation, playback and page read of it is the same: inputs whole, the state they leave behind."""
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "contact.law": "hunt_crossley"}), START_NS)
    view = JournalView()

    def seen() -> list[InputKind]:
        return [change.kind for table in rig.take_journal() for change in view.take(table)]

    rig.advance(START_NS + 5 * TICK)
    rig.accept(frequency_hz=9.1, amplitude=0.3)
    rig.configure({"barriers.gap_m": 0.004, "sphere.present": True, "contact.law": "lankarani_nikravesh"})
    assert seen() == [InputKind.START, InputKind.INITIAL, InputKind.COMMAND, InputKind.COMMAND, InputKind.PARAMETER]
    assert view.start_ns == START_NS
    assert (view.configuration["daq.seed"], view.configuration["contact.law"]) == (5, "lankarani_nikravesh")
    assert view.configuration["barriers.gap_m"] == 0.004
    assert (view.drive, view.latched, view.plucked) == ({"frequency": 9.1, "current": 0.3}, None, False)
    rig.stop()
    assert seen() == [InputKind.STOP]
    assert view.latched is not None
    assert view.latched.kind is InputKind.STOP
    rig.clear_trip()
    rig.pluck(0.001)
    assert seen() == [InputKind.CLEAR_TRIP, InputKind.PLUCK]
    assert (view.latched, view.plucked) == (None, True)
    rig.reset()
    assert seen()[0] is InputKind.RESET
    assert (view.plucked, view.drive, view.configuration["barriers.gap_m"]) == (False, {}, 0.004)


def test_a_view_takes_nothing_of_a_table_it_does_not_understand() -> None:
    view = JournalView()
    rows = np.zeros(2, JOURNAL)
    rows["kind"], rows["key"] = b"command", b"frequency"
    view.take(Table(0, rows[:1]))
    rows["kind"][1] = b"unheard"
    for table in (Table(0, rows), Table(0, np.zeros(1, [("time", "f8")]))):
        with pytest.raises(ConfigError, match=r"unknown kind 'unheard'|'sample', 'sequence', .* is missing"):
            view.take(table)
    assert view.drive == {"frequency": 0.0}
