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
"""No bit of a measurement depends on how the tracker is fed: block division, delays, time base, repetition."""

from __future__ import annotations

import functools

import attrs
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from kits.records import add_impacts, applied, blocks, feed_all, info_rows, statuses
from kits.tracker import QUICK, RATE, fingerprint, record, run_scenario, tracker

from impact_rig.analysis.tracker import MOST_EARLY, Tracker
from impact_rig.blocks import Table
from impact_rig.simtime import NS_PER_S


def impacting_record():
    """Return a record of 9 s with an impact near every extreme of the drive."""
    rows = record(seconds=9.0)
    add_impacts(rows["accelerometer"], RATE, (np.arange(160) + 0.3) / 18.2, np.full(160, 0.4), np.resize([1, -1], 160))
    return rows


@functools.cache
def usual():
    """Return the result of the scenario in blocks of 20 scans."""
    return fingerprint(*run_scenario(20)[:2])


@pytest.mark.parametrize("size", [1, 7, 100, 1999, 40_000])
@pytest.mark.repeats
def test_results_do_not_depend_on_the_block_length(size):
    assert fingerprint(*run_scenario(size)[:2]) == usual()


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
@pytest.mark.repeats
def test_results_do_not_depend_on_any_division_into_blocks(seed):
    def sizes():
        rng = np.random.default_rng(seed)
        while True:
            yield int(rng.integers(1, 300))

    assert fingerprint(*run_scenario(sizes)[:2]) == usual()


@pytest.mark.heavy
@pytest.mark.parametrize("late_ns", [10_000_000, 40_000_000])
def test_a_command_that_arrives_late_changes_no_result(late_ns):
    """Topics overtake each other; scans wait for 50 ms of rig time before they are used."""
    measurements, impacts, made = run_scenario(20, late_ns=late_ns)
    assert fingerprint(measurements, impacts) == usual()
    assert made.counters.late_events == 0


@pytest.mark.parametrize("late_blocks", [1, 6])
def test_a_calibration_that_arrives_late_changes_no_result(late_blocks):
    """Blocks of 10 ms wait for their calibration for 50 ms."""
    found = []
    for late in (0, late_blocks):
        made, tables = Tracker(QUICK), [*blocks(impacting_record(), RATE, 20)]
        made.on_applied(applied(9.1))
        made.label(0.006, 0)
        early = feed_all(made, tables[:late])
        made.configure(Table(0, info_rows(RATE)))
        measurements, impacts = feed_all(made, tables[late:])
        assert early == ([], [])
        found.append((*fingerprint(measurements, impacts), made.counters))
    assert found[0] == found[1]
    assert found[0][2].measurements
    assert found[0][2].impacts > 100


def test_blocks_that_waited_for_a_calibration_are_measured_at_the_end():
    """The record ends before another block arrives."""
    made, tables = Tracker(QUICK), [*blocks(impacting_record(), RATE, 100)]
    made.feed(tables[0])
    made.configure(Table(0, info_rows(RATE)))
    assert sum(len(table.rows) for table in made.flush().impacts) == made.counters.impacts == 1
    assert made.counters.scans == 100


def test_blocks_of_an_earlier_record_are_not_measured_with_the_calibration():
    """A new scan 0 means that the rig was reset: the blocks before it have another, unknown calibration."""
    rows, start_ns = record(seconds=9.0), NS_PER_S
    found = []
    for early in (0, 3):
        made = Tracker(QUICK)
        feed_all(made, blocks(rows[: 20 * early], RATE, 20, start_ns=start_ns - early * NS_PER_S // 100))
        made.feed(next(blocks(rows, RATE, 20, start_ns=start_ns)))
        made.configure(Table(start_ns, info_rows(RATE)))
        made.on_applied(applied(9.1, at_ns=start_ns))
        found.append(fingerprint(*feed_all(made, blocks(rows[20:], RATE, 20, start_ns=start_ns, first=20))))
        assert made.counters.unconfigured_scans == 20 * early
        assert made.counters.restarts == made.counters.lost_scans == 0
    assert found[0] == found[1]


@pytest.mark.heavy
def test_blocks_that_wait_for_a_calibration_need_bounded_memory():
    """A publisher may send any stamps: repeated, in the past, or a nanosecond apart."""
    made, table = Tracker(QUICK), next(blocks(record(seconds=0.1), RATE, 1))
    for stamp_ns in (*range(3000), *range(0, -50, -1), -100, -100):
        made.feed(Table(stamp_ns, table.rows))
        assert len(made._early) <= MOST_EARLY + 1
    assert made.counters.unconfigured_scans == 3051
    assert len(made._early) == 1


def test_a_label_and_a_command_of_one_instant_may_arrive_in_either_order():
    """Live, the command arrives first; in a recorded run, the label is known first. The row is the same."""
    reasons = set()
    for label_first in (True, False):
        made = tracker()
        if label_first:
            made.label(0.006, 4 * NS_PER_S)
        made.on_applied(applied(9.5, at_ns=4 * NS_PER_S))
        made.label(0.006, 4 * NS_PER_S)
        reasons |= set(statuses(feed_all(made, blocks(record(seconds=5.0), RATE, 20))[0]))
    assert reasons == {"label_changed"}


@pytest.mark.heavy
@pytest.mark.parametrize("late_ns", [0, 40_000_000])
def test_impacts_are_timed_by_the_calibration_of_their_scans(late_ns):
    """The detector uses the lag of the accelerometer that is calibrated for these scans, not the lag at the start."""
    lag_s, changed_ns, rows = 3e-3, round(2.003 * NS_PER_S), impacting_record()
    info = info_rows(RATE, since_start=changed_ns / NS_PER_S)
    info["lag"][0] += lag_s

    def of(size, calibration):
        made, found = tracker(gap_m=0.006), []
        for table in blocks(rows, RATE, size):
            if calibration is not None and table.stamp_ns >= changed_ns + late_ns - size * NS_PER_S // RATE:
                made.configure(Table(changed_ns, calibration))
            found.append(made.feed(table))
        measured = [one for part in found for one in part.measurements]
        struck = [
            one.stamp_ns / NS_PER_S + float(row["time"]) for part in found for one in part.impacts for row in one.rows
        ]
        return measured, np.array(struck)

    plain, changed, longer = of(20, None), of(20, info), of(100, info)
    moved = plain[1] - changed[1]
    assert moved[plain[1] < 2.0] == pytest.approx(0.0)
    assert moved[plain[1] > 2.1] == pytest.approx(lag_s, abs=1e-6)
    assert [one.rows.tobytes() for one in changed[0]] == [one.rows.tobytes() for one in longer[0]]
    assert "ok" in statuses(changed[0])


@pytest.mark.heavy
def test_a_command_that_arrives_too_late_is_counted():
    made = run_scenario(20, late_ns=200_000_000)[2]
    assert made.counters.late_events == 1


@pytest.mark.parametrize("size", [1000, 5000])
def test_the_first_command_discards_no_impact(size):
    """Scans wait, but their impacts are known at once: the first command must not discard these."""
    rows = impacting_record()
    found = []
    for cut in (20, size):
        made = tracker(None, gap_m=0.006)
        made.on_applied(applied(9.1, at_ns=NS_PER_S))
        found.append(feed_all(made, blocks(rows, RATE, cut))[0])
    assert statuses(found[0]) == ["no_frequency", "ok"]
    assert found[0][0].rows["impact_age"][0] < 0.1, "the status must not state that there are no impacts"
    assert fingerprint(found[0], ()) == fingerprint(found[1], ())


@pytest.mark.heavy
def test_a_window_contains_the_impacts_just_before_its_end():
    """At 200 kS/s, an impact is known 30 scans later, so the window must stay open for longer than 16 scans."""
    rate_hz, frequency_hz = 200_000, 97.0
    rows = record(frequency_hz, 1.05, rate_hz=rate_hz)
    times = (np.arange(200) + 0.999) / (2 * frequency_hz)
    add_impacts(rows["accelerometer"], rate_hz, times, np.full(200, 0.4), np.resize([1, -1], 200))
    ages = []
    for size in (20, 1000):
        made = tracker(frequency_hz, rate_hz=rate_hz, tracker_settings=attrs.evolve(QUICK, hold_s=0.0), gap_m=0.006)
        ages += [float(table.rows["impact_age"][0]) for table in feed_all(made, blocks(rows, rate_hz, size))[0]]
    assert len(ages) == 2
    assert max(ages) < 10 / rate_hz


@pytest.mark.heavy
@pytest.mark.parametrize("start_ns", [1_763_700_000_123_456_789, -5_000_000_000])
def test_the_time_base_only_shifts_the_stamps(start_ns):
    here, there = run_scenario(20)[0], run_scenario(20, start_ns=start_ns)[0]
    assert [table.stamp_ns + start_ns for table in here] == [table.stamp_ns for table in there]
    assert [table.rows.tobytes() for table in here] == [table.rows.tobytes() for table in there]


def test_stamps_with_a_period_of_fractional_nanoseconds_are_contiguous():
    """At 25,600 S/s, stamps are rounded down; over a minute, this must never look like a lost block."""
    made = tracker(73.0, rate_hz=25_600)
    rows = record(73.0, 6.0, rate_hz=25_600)
    measurements, _ = feed_all(made, blocks(rows, 25_600, 97))
    assert made.counters.lost_scans == 0
    assert set(statuses(measurements)) == {"ok"}


def test_a_repeated_command_or_label_changes_no_result():
    rows = record(seconds=13.0)
    made = tracker()
    found = []
    for number, table in enumerate(blocks(rows, RATE, 20)):
        if number % 100 == 50:
            made.on_applied(applied(9.1, at_ns=table.stamp_ns))
            made.label(0.0, table.stamp_ns)
            made.configure(Table(table.stamp_ns, info_rows(RATE, since_start=table.stamp_ns / NS_PER_S)))
        found += made.feed(table).measurements
    assert statuses(found) == ["ok", "ok"]


def test_a_late_subscriber_gets_scan_0_from_the_calibration():
    """If the rig was recalibrated long after its start, windows are still counted from its scan 0."""
    rows = record(seconds=9.0)
    since_s = 3.0
    late = Tracker(QUICK)
    late.configure(Table(round(since_s * NS_PER_S), info_rows(RATE, since_start=since_s)))
    late.on_applied(applied(9.1, at_ns=0))
    late.label(0.0, 0)
    expected, _ = feed_all(tracker(), blocks(rows, RATE, 20))
    found, _ = feed_all(late, blocks(rows, RATE, 20))
    assert [t.rows.tobytes() for t in found] == [t.rows.tobytes() for t in expected]
