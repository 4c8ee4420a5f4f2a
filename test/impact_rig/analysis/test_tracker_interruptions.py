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
"""The streaming measurement continues after every interruption, and names it: gaps, resets, changes."""

from __future__ import annotations

import attrs
import numpy as np
import pytest
from kits.records import applied, blocks, feed_all, info_rows, linear_transmissibility, statuses
from kits.tracker import QUICK, RATE, fingerprint, record, run_scenario, tracker

from impact_rig.analysis import tracker as tracker_module
from impact_rig.analysis.cycles import Accumulator
from impact_rig.blocks import Table
from impact_rig.simtime import NS_PER_S, stamp_ns


@pytest.mark.heavy
def test_every_interruption_is_named_and_excluded_from_the_mean():
    measurements, impacts, made = run_scenario(20)
    assert statuses(measurements) == [
        "ok",
        "command_changed",
        "ok",
        "over_range",
        "ok",
        "not_finite",
        "ok",
        "lost_blocks",
        "ok",
    ]
    for table in measurements:
        row = table.rows[0]
        if row["settled"]:
            truth = linear_transmissibility(row["frequency"])
            assert abs(row["transmissibility"] - abs(truth)) < 4 * row["transmissibility_uncertainty"]
        else:
            assert np.isnan(row["transmissibility"])
            assert np.isnan(row["laser_amplitude"])
    assert made.counters.lost_scans == int(29.1 * RATE) - int(29.013 * RATE)
    assert made.counters.impacts == sum(len(table.rows) for table in impacts) > 500
    assert made.counters.measurements == 5
    assert made.counters.refusals == 4


def test_an_interruption_finds_every_cycle_although_scans_are_added_in_few_steps(monkeypatch):
    begins = []
    really = Accumulator.add
    monkeypatch.setattr(Accumulator, "add", lambda self, *of: (begins.append(of[2]), really(self, *of)))
    made = tracker(100.0, tracker_settings=attrs.evolve(QUICK, hold_s=0.0))
    tables = list(blocks(record(100.0, 0.5), RATE, 20))
    feed_all(made, tables[:4])
    assert set(begins) == {0}, "nothing else is due yet"
    made.on_applied(applied(90.0, at_ns=tables[4].stamp_ns))  # four whole cycles are there, none of them added
    assert statuses(feed_all(made, tables[4:6])[0]) == ["command_changed"]


def test_a_window_is_reported_with_the_block_that_completes_it(monkeypatch):
    """The result is the same as if each block were added to its cycle at once."""
    found = []
    for add_s in (tracker_module.ADD_S, 0.0):
        monkeypatch.setattr(tracker_module, "ADD_S", add_s)
        made = tracker(23.0)
        tables = blocks(record(23.0, 4.0), RATE, 20)
        found.append([(k, one) for k, table in enumerate(tables) for one in statuses(made.feed(table).measurements)])
    assert found[0] == found[1]
    assert [word for _, word in found[0]] == ["ok"]


def test_a_gap_inside_a_block_is_found():
    rows = record(seconds=6.5)
    table = next(blocks(rows, RATE, len(rows)))
    holed = Table(0, np.delete(table.rows, slice(12_000, 12_010)))
    made = tracker()
    found = made.feed(holed)
    assert "lost_blocks" in statuses(found.measurements)
    assert made.counters.lost_scans == 10


def test_a_gap_is_reported_without_a_drive_too():
    made, (first, _, third) = tracker(None), blocks(record(seconds=0.03), RATE, 20)
    (row,) = feed_all(made, [first, third])[0]
    assert row.rows["status"] == b"lost_blocks"
    assert np.isnan(row.rows["frequency"])


def test_a_gap_at_the_beginning_of_a_block_is_found():
    """The scans of the block must not be taken for the missing ones: then the gap would be part of the mean."""
    first, second = blocks(record(seconds=13.0), RATE, [12_000, 14_000])
    made = tracker()
    found = made.feed(first).measurements + made.feed(Table(second.stamp_ns, second.rows[100:])).measurements
    found += made.flush().measurements
    assert statuses(found) == ["ok", "lost_blocks", "ok"]
    assert found[1].stamp_ns == 6 * NS_PER_S - NS_PER_S // RATE
    assert found[2].rows[0]["waited"] == pytest.approx(48 / 9.1, abs=1 / RATE)
    assert found[2].stamp_ns == pytest.approx((6.05 + 48 / 9.1) * NS_PER_S, abs=NS_PER_S / RATE)
    assert made.counters.lost_scans == 100


@pytest.mark.parametrize("times", ["another_rate", "nan", "backwards", "jitter"])
def test_invalid_scans_are_counted_as_lost_and_not_measured(times):
    """If the rate differs from daq/info, or times are invalid, scans are counted as lost and not measured."""
    made = tracker()
    rows = record(seconds=1.0)[:200].copy()
    rows["time"] = np.arange(200) / RATE
    if times == "another_rate":
        rows["time"] /= 5
    elif times == "nan":
        rows["time"][-1] = np.nan
    elif times == "backwards":
        rows["time"] = rows["time"][::-1]
    else:
        rows["time"] += np.where(np.arange(200) % 2, 0.9, 0.0) / RATE
    found = made.feed(Table(0, rows))
    assert found.measurements == ()
    assert made.counters.lost_scans > 0


def test_a_repeated_block_is_dropped_and_a_jump_back_restarts_the_measurement():
    made = tracker()
    rows = record(seconds=7.0)
    tables = list(blocks(rows, RATE, 100))
    feed_all(made, [*tables[:50], tables[49]])
    assert made.counters.duplicate_scans == 100
    assert made.counters.scans == 50 * 100, "all received scans, repeated ones once"
    measurements, _ = feed_all(made, tables)  # from scan 0 again: the rig was reset
    assert statuses(measurements) == ["restarted", "ok"]
    assert made.counters.restarts == 1
    fresh, _ = feed_all(tracker(), tables)
    assert measurements[1].rows.tobytes() == fresh[0].rows.tobytes(), "nothing of the first life may remain"


@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("silence_ns", [0, 3_700_000], ids=["seamless", "a_part_of_a_block_dropped"])
def test_results_after_a_reset_equal_those_of_a_new_record(late, silence_ns):
    """The announcement of the reset may arrive at any time within the waiting time of scans."""
    reset_ns = 8 * NS_PER_S + silence_ns
    fresh = record(seconds=6.0, seed=2)
    announcement = Table(reset_ns, info_rows(RATE))
    expected, _ = feed_all(tracker(start_ns=reset_ns), blocks(fresh, RATE, 20, start_ns=reset_ns))

    made = tracker()
    found = []
    for table in blocks(record(seconds=8.0), RATE, 20):
        found += made.feed(table).measurements
    for number, table in enumerate(blocks(fresh, RATE, 20, start_ns=reset_ns)):
        if number == late:
            made.configure(announcement)
        found += made.feed(table).measurements
    found += made.flush().measurements
    gap_seen_first = silence_ns and late
    assert statuses(found) == ["ok", "lost_blocks" if gap_seen_first else "restarted", "ok"]
    after = [table for table in found if table.stamp_ns >= reset_ns]
    assert [table.stamp_ns for table in after] == [table.stamp_ns for table in expected]
    assert b"".join(table.rows.tobytes() for table in after) == b"".join(t.rows.tobytes() for t in expected)


@pytest.mark.parametrize("late", [5, 6, 50])
def test_a_late_announcement_of_a_reset_loses_no_scan(late):
    """If the announcement arrives after the waiting time, scans that are already measured must not count as lost."""
    reset_ns, made, found = 8 * NS_PER_S, tracker(), []
    for table in blocks(record(seconds=8.0), RATE, 20):
        found += made.feed(table).measurements
    for number, table in enumerate(blocks(record(seconds=8.0, seed=2), RATE, 20, start_ns=reset_ns)):
        if number == late:
            made.configure(Table(reset_ns, info_rows(RATE)))
        found += made.feed(table).measurements
    assert statuses(found) == ["ok", "restarted", "ok"]
    assert [table.stamp_ns for table in found] == sorted(table.stamp_ns for table in found)
    last = found[-1]
    begun_ns = reset_ns + max(0, 20 * late - 100) * NS_PER_S // RATE
    assert last.rows["waited"][0] == pytest.approx((last.stamp_ns - begun_ns) / NS_PER_S, abs=1.5 / RATE)
    assert (made.counters.restarts, made.counters.lost_scans) == (1, 0)
    assert made.counters.late_events == (late > 5)


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", [RATE, 2 * RATE])
def test_a_calibration_that_overtakes_the_scans_of_a_reset_acts_from_its_stamp(rate_hz):
    """A reset that changes the rate is one reset, not two."""
    reset_ns, changed_s = 2 * NS_PER_S, 6.0
    changed = info_rows(rate_hz, since_start=changed_s)
    changed["sensitivity_uncertainty"] = 0.01
    found = []
    for first in (0, 1):  # the block of the new record before which it is delivered
        made = tracker()
        measurements, _ = feed_all(made, blocks(record(seconds=2.0), RATE, 20))
        made.configure(Table(reset_ns, info_rows(rate_hz)))
        for number, table in enumerate(blocks(record(seconds=12.0, rate_hz=rate_hz), rate_hz, 40, start_ns=reset_ns)):
            if number == first:
                made.configure(Table(reset_ns + round(changed_s * NS_PER_S), changed))
            measurements += made.feed(table).measurements
        found.append(measurements)
        assert made.counters.restarts == 1
    assert statuses(found[0]) == ["restarted", "ok", "calibration_changed", "ok"]
    assert fingerprint(found[0], ()) == fingerprint(found[1], ())


@pytest.mark.heavy
def test_a_new_calibration_after_months_is_not_taken_for_a_reset():
    """After months, the seconds since scan 0 are rounded by more than a nanosecond; scan 0 is still the same."""
    first = 200 * 86_400 * RATE
    instants = (stamp_ns(first + 16_000 + 20 * k, RATE) for k in range(100))
    changed_ns = next(ns for ns in instants if round(ns / NS_PER_S * NS_PER_S) != ns)
    info = info_rows(RATE, since_start=changed_ns / NS_PER_S)
    info["sensitivity_uncertainty"] = 0.01
    made, found = tracker(), []
    for table in blocks(record(seconds=16.0), RATE, 20, first=first):
        if table.stamp_ns == changed_ns:
            made.configure(Table(changed_ns, info))
        found += made.feed(table).measurements
    assert statuses(found) == ["ok", "calibration_changed", "ok"]
    assert made.counters.restarts == 0


@pytest.mark.heavy
@pytest.mark.parametrize("kind", ["label", "calibration", "current"])
def test_every_change_starts_a_new_measurement(kind):
    rows = record(seconds=16.0)
    made = tracker()
    found = []
    for table in blocks(rows, RATE, 20):
        if table.stamp_ns == 8 * NS_PER_S:
            if kind == "label":
                made.label(np.nan, table.stamp_ns)
            elif kind == "current":
                made.on_applied(applied(9.1, current_a=0.6, at_ns=table.stamp_ns))
            else:
                info = info_rows(RATE, since_start=table.stamp_ns / NS_PER_S)
                info["sensitivity_uncertainty"] = 0.01
                made.configure(Table(table.stamp_ns, info))
        found += made.feed(table).measurements
    changed = {"label": "label_changed", "calibration": "calibration_changed", "current": "command_changed"}[kind]
    assert statuses(found) == ["ok", changed, "ok"]
    before, after = found[0].rows[0], found[2].rows[0]
    assert after["waited"] == pytest.approx(before["waited"], abs=1 / RATE)
    assert np.isnan(after["gap"]) if kind == "label" else after["gap"] == 0.0
    if kind == "calibration":
        assert after["transmissibility_uncertainty"] > 5 * before["transmissibility_uncertainty"]
