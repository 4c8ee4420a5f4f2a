"""The streaming measurement: settles, survives every interruption by name, and never depends on how it is fed."""

from __future__ import annotations

import tracemalloc

import attrs
import numpy as np
import pytest
from analysis_records import (
    BASE_M,
    F_N,
    ZETA,
    add_impacts,
    applied,
    blocks,
    feed_all,
    info_rows,
    linear_transmissibility,
    steady_record,
    words,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tracker import Counters, Tracker
from impact_rig.analysis.transmissibility import measure_record
from impact_rig.analysis.words import MEASURED, Status
from impact_rig.blocks import Table
from impact_rig.errors import ConfigError
from impact_rig.simtime import NS_PER_S

RATE = 2000  # enough for 9.1 Hz and quick; the detector works from 2 kS/s on
QUICK = TrackerSettings(window_s=0.1)


def tracker(frequency_hz=9.1, *, rate_hz=RATE, tracker_settings=QUICK, start_ns=0, gap_m=0.006, info=None):
    made = Tracker(tracker_settings)
    made.configure(Table(start_ns, info_rows(rate_hz) if info is None else info))
    if frequency_hz is not None:
        made.command(applied(frequency_hz, at_ns=start_ns))
    made.label(gap_m, start_ns)
    return made


def record(frequency_hz=9.1, seconds=14.0, *, rate_hz=RATE, seed=1, **options):
    return steady_record(frequency_hz, seconds, rate_hz=rate_hz, rng=np.random.default_rng(seed), **options)


def test_a_settled_response_is_measured_window_after_window():
    measurements, _ = feed_all(tracker(), blocks(record(seconds=17.0), RATE, 20))
    truth = linear_transmissibility(9.1)
    assert words(measurements) == ["ok"] * 3
    for number, table in enumerate(measurements, start=1):
        row = table.rows[0]
        assert abs(row["transmissibility"] - abs(truth)) < 3 * row["transmissibility_uncertainty"]
        assert abs(row["phase"] - np.angle(truth)) < 3 * row["phase_uncertainty"]
        assert row["transmissibility_uncertainty"] < 0.003 * abs(truth)
        assert (row["settled"], row["cycles"], row["gap"], row["frequency"]) == (1, 48, 0.006, 9.1)
        # windows count from the command: the k-th row ends with the last scan of cycle 48 k
        last = int(np.ceil(48 * number * RATE / 9.1)) - 1
        assert table.stamp_ns == last * NS_PER_S // RATE
        assert row["time"] == 0
        assert row["waited"] == pytest.approx((last + 1) / RATE)


def test_streaming_gives_what_the_whole_record_gives():
    rows = record(seconds=48 / 9.1 + 0.2)
    row = feed_all(tracker(), blocks(rows, RATE, 20))[0][0].rows[0]
    whole = measure_record(rows[: int(np.ceil(48 * RATE / 9.1))], info_rows(RATE), 9.1)
    assert row["transmissibility"] == pytest.approx(whole.transmissibility, rel=1e-12)
    assert row["phase"] == pytest.approx(whole.phase_rad, rel=1e-12)
    # its uncertainty holds the bias of a transient as well, here noise
    assert whole.u_transmissibility <= row["transmissibility_uncertainty"] < 1.5 * whole.u_transmissibility


def transient_ratio(frequency_hz, tau_s):
    """DT whose free vibration dies with tau against the drive: what a command change leaves behind."""
    truth = linear_transmissibility(frequency_hz)
    beat = 2 * np.pi * (F_N - frequency_hz)
    return lambda t: truth * (1 - np.exp((-1 / tau_s + 1j * beat) * t))


@pytest.mark.parametrize(("frequency_hz", "tau_s"), [(9.1, 0.34), (9.1, 3.9), (9.0, 3.9), (10.0, 0.34), (8.5, 3.9)])
def test_a_transient_is_waited_for_no_longer_than_needed(frequency_hz, tau_s):
    """Settled means: bias below 5e-4; the wait is what that takes plus the measurement itself, not a fixed time."""
    rows = record(frequency_hz, 55.0, transient=transient_ratio(frequency_hz, tau_s))
    measurements, _ = feed_all(tracker(frequency_hz), blocks(rows, RATE, 20))
    row = measurements[0].rows[0]
    truth = abs(linear_transmissibility(frequency_hz))
    assert row["status"] == b"ok"
    assert row["transmissibility"] == pytest.approx(truth, rel=1e-3)
    assert abs(row["transmissibility"] - truth) < 3 * row["transmissibility_uncertainty"]
    assert row["waited"] < tau_s * np.log(1 / 2e-4) + 2 * 48 / frequency_hz


def test_the_bound_of_waiting_is_kept_and_named():
    """A response that never settles (growing drift) is reported with numbers, settled = 0, at the bound."""
    truth = linear_transmissibility(9.1)
    rows = record(9.1, 25.0, transient=lambda t: truth * (0.3 + 0.02 * t))
    slow = TrackerSettings(window_s=0.1, wait_limit_s=10.0)
    measurements, _ = feed_all(tracker(tracker_settings=slow), blocks(rows, RATE, 20))
    assert words(measurements) == ["not_settled"] * 2
    first = measurements[0].rows[0]
    assert first["settled"] == 0
    assert np.isfinite(first["transmissibility"])
    assert 10.0 <= first["waited"] < 11.0


def test_a_modulated_response_is_labelled_and_measured_long():
    truth = linear_transmissibility(9.2)
    rows = record(9.2, 30.0, transient=lambda t: truth * (1 + 0.03 * np.cos(2.7 * t)))
    measurements, _ = feed_all(tracker(9.2), blocks(rows, RATE, 20))
    row = measurements[0].rows[0]
    assert (row["status"], row["regime"], row["method"]) == (b"ok", b"modulated", b"block_bootstrap")
    assert row["cycles"] == 192
    assert abs(row["transmissibility"] - abs(truth)) < 3 * row["transmissibility_uncertainty"]


def scenario(rate_hz=RATE):
    """Everything at once: a change of frequency, an over-range spell, a NaN, impacts, a hole. (rows, events)."""
    rng = np.random.default_rng(3)
    first = steady_record(9.1, 9.0, rate_hz=rate_hz, rng=rng)
    second = steady_record(9.5, 27.0, rate_hz=rate_hz, rng=rng)
    rows = np.concatenate([first, second])
    rows["status"][int(17.0 * rate_hz) : int(17.3 * rate_hz)] = 2
    rows["laser"][int(23.5 * rate_hz)] = np.nan
    times = np.arange(0.5, 35.0, 0.0511)
    add_impacts(
        rows["accelerometer"], rate_hz, times, np.full(len(times), 0.4), np.tile([1, -1], len(times))[: len(times)]
    )
    hole = (int(29.013 * rate_hz), int(29.1 * rate_hz))
    return rows, hole


def run_scenario(sizes, *, late_ns=0, rate_hz=RATE, start_ns=0):
    """Feed the scenario; the command for 9.5 Hz is delivered `late_ns` after the scan it acts on."""
    rows, hole = scenario(rate_hz)
    made = tracker(rate_hz=rate_hz, start_ns=start_ns)
    parts = [(rows[: hole[0]], 0), (rows[hole[1] :], hole[1])]
    change_ns = start_ns + 9 * NS_PER_S
    found, told = [], False
    for part, first in parts:
        for table in blocks(part, rate_hz, sizes() if callable(sizes) else sizes, start_ns=start_ns, first=first):
            end_ns = table.stamp_ns + len(table.rows) * NS_PER_S // rate_hz
            if not told and end_ns > change_ns + late_ns:  # the rig accepts a command before it simulates its instant
                made.command(applied(9.5, at_ns=change_ns))
                told = True
            found.append(made.feed(table))
    found.append(made.flush())
    measurements = [table for one in found for table in one.measurements]
    impacts = [table for one in found for table in one.impacts]
    return measurements, impacts, made


def fingerprint(measurements, impacts):
    rows = b"".join(table.stamp_ns.to_bytes(8, "big", signed=True) + table.rows.tobytes() for table in measurements)
    hits = b"".join(
        table.stamp_ns.to_bytes(8, "big", signed=True) + row.tobytes() for table in impacts for row in table.rows
    )
    return rows, hits


def test_every_interruption_is_named_and_none_is_averaged_in():
    measurements, impacts, made = run_scenario(20)
    assert words(measurements) == [
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


@pytest.mark.parametrize("size", [1, 7, 100, 1999, 40_000])
def test_no_bit_depends_on_the_block_length(size):
    assert fingerprint(*run_scenario(size)[:2]) == fingerprint(*run_scenario(20)[:2])


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_bit_depends_on_any_cut(seed):
    def sizes():
        rng = np.random.default_rng(seed)
        while True:
            yield int(rng.integers(1, 300))

    assert fingerprint(*run_scenario(sizes)[:2]) == fingerprint(*run_scenario(20)[:2])


@pytest.mark.parametrize("late_ns", [10_000_000, 40_000_000])
def test_a_command_delivered_late_changes_nothing(late_ns):
    """Topics overtake each other; scans are held back for 50 ms of rig time."""
    measurements, impacts, made = run_scenario(20, late_ns=late_ns)
    assert fingerprint(measurements, impacts) == fingerprint(*run_scenario(20)[:2])
    assert made.counters.late_events == 0


def test_a_command_later_than_that_is_counted():
    made = run_scenario(20, late_ns=200_000_000)[2]
    assert made.counters.late_events == 1


@pytest.mark.parametrize("start_ns", [1_763_700_000_123_456_789, -5_000_000_000])
def test_the_time_base_only_shifts_the_stamps(start_ns):
    here, there = run_scenario(20)[0], run_scenario(20, start_ns=start_ns)[0]
    assert [table.stamp_ns + start_ns for table in here] == [table.stamp_ns for table in there]
    assert [table.rows.tobytes() for table in here] == [table.rows.tobytes() for table in there]


def test_stamps_of_a_period_that_is_no_whole_nanosecond_are_followed():
    """At 25 600 S/s the stamps are rounded down; over a minute that must never look like a lost block."""
    made = tracker(73.0, rate_hz=25_600)
    rows = record(73.0, 6.0, rate_hz=25_600)
    measurements, _ = feed_all(made, blocks(rows, 25_600, 97))
    assert made.counters.lost_scans == 0
    assert set(words(measurements)) == {"ok"}


def test_a_hole_inside_a_block_is_found():
    rows = record(seconds=6.5)
    table = next(blocks(rows, RATE, len(rows)))
    holed = Table(0, np.delete(table.rows, slice(12_000, 12_010)))
    made = tracker()
    found = made.feed(holed)
    assert "lost_blocks" in words(found.measurements)
    assert made.counters.lost_scans == 10


def test_a_repeated_block_is_dropped_and_a_jump_back_starts_anew():
    made = tracker()
    rows = record(seconds=7.0)
    tables = list(blocks(rows, RATE, 100))
    feed_all(made, [*tables[:50], tables[49]])
    assert made.counters.duplicate_scans == 100
    measurements, _ = feed_all(made, tables)  # from scan 0 again: the rig was reset
    assert words(measurements) == ["restarted", "ok"]
    assert made.counters.restarts == 1
    fresh, _ = feed_all(tracker(), tables)
    assert measurements[1].rows.tobytes() == fresh[0].rows.tobytes(), "nothing of the first life may remain"


def test_without_a_command_it_says_so_once_a_second():
    measurements, _ = feed_all(tracker(None), blocks(record(seconds=3.6), RATE, 20))
    assert words(measurements) == ["no_frequency"] * 3
    assert [table.stamp_ns for table in measurements] == [k * NS_PER_S - NS_PER_S // RATE for k in (1, 2, 3)]


def test_repeating_a_command_or_label_disturbs_nothing():
    rows = record(seconds=13.0)
    made = tracker()
    found = []
    for number, table in enumerate(blocks(rows, RATE, 20)):
        if number % 100 == 50:
            made.command(applied(9.1, at_ns=table.stamp_ns))
            made.label(0.006, table.stamp_ns)
            made.configure(Table(table.stamp_ns, info_rows(RATE, since_start=table.stamp_ns / NS_PER_S)))
        found += made.feed(table).measurements
    assert words(found) == ["ok", "ok"]


@pytest.mark.parametrize("late", [0, 1, 2])
@pytest.mark.parametrize("silence_ns", [0, 3_700_000], ids=["seamless", "a_part_of_a_block_dropped"])
def test_after_a_reset_everything_is_as_in_a_new_record(late, silence_ns):
    """However late its announcement comes within the time scans are held back."""
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
    assert words(found) == ["ok", "lost_blocks" if gap_seen_first else "restarted", "ok"]
    after = [table for table in found if table.stamp_ns >= reset_ns]
    assert [table.stamp_ns for table in after] == [table.stamp_ns for table in expected]
    assert b"".join(table.rows.tobytes() for table in after) == b"".join(t.rows.tobytes() for t in expected)


def test_who_joins_late_takes_scan_0_from_the_calibration():
    """A rig recalibrated long after its start: windows are counted from its scan 0 all the same."""
    rows = record(seconds=9.0)
    since_s = 3.0
    late = Tracker(QUICK)
    late.configure(Table(round(since_s * NS_PER_S), info_rows(RATE, since_start=since_s)))
    late.command(applied(9.1, at_ns=0))
    late.label(0.006, 0)
    expected, _ = feed_all(tracker(), blocks(rows, RATE, 20))
    found, _ = feed_all(late, blocks(rows, RATE, 20))
    assert [t.rows.tobytes() for t in found] == [t.rows.tobytes() for t in expected]


@pytest.mark.parametrize("kind", ["label", "calibration", "current"])
def test_every_change_starts_a_new_measurement(kind):
    rows = record(seconds=16.0)
    made = tracker()
    found = []
    for table in blocks(rows, RATE, 20):
        if table.stamp_ns == 8 * NS_PER_S:
            if kind == "label":
                made.label(0.010, table.stamp_ns)
            elif kind == "current":
                made.command(applied(9.1, current_a=0.6, at_ns=table.stamp_ns))
            else:
                info = info_rows(RATE, since_start=table.stamp_ns / NS_PER_S)
                info["sensitivity_uncertainty"] = 0.01
                made.configure(Table(table.stamp_ns, info))
        found += made.feed(table).measurements
    changed = {"label": "label_changed", "calibration": "calibration_changed", "current": "command_changed"}[kind]
    assert words(found) == ["ok", changed, "ok"]
    before, after = found[0].rows[0], found[2].rows[0]
    assert after["waited"] == pytest.approx(before["waited"], abs=1 / RATE)
    assert after["gap"] == (0.010 if kind == "label" else 0.006)
    if kind == "calibration":
        assert after["transmissibility_uncertainty"] > 5 * before["transmissibility_uncertainty"]


def _silence(rows, rng):
    for name, rms in (("laser", 3e-6), ("base", 1e-6), ("current", 2e-3), ("accelerometer", 0.05)):
        rows[name] = rms * rng.standard_normal(len(rows))


def _swap(rows, _):
    rows["laser"], rows["base"] = rows["base"].copy(), rows["laser"].copy()


@pytest.mark.parametrize(
    ("spoil", "status"),
    [
        (_silence, "silence"),
        (lambda rows, _: rows["laser"].fill(1e-3), "constant"),
        (lambda rows, _: rows["base"].fill(np.nan), "not_finite"),
        (lambda rows, _: rows["laser"].fill(0.5), "over_range"),
        (_swap, "swapped_channels"),
    ],
    ids=["silence", "constant", "nan", "clipped", "swapped"],
)
def test_a_spoiled_stream_gets_a_name_and_no_number(spoil, status):
    rows = record(seconds=20.0)
    spoil(rows, np.random.default_rng(7))
    measurements, _ = feed_all(tracker(), blocks(rows, RATE, 20))
    assert measurements
    assert set(words(measurements)) == {status}
    assert len(measurements) <= 5, "a lasting fault is told about once per measurement, not once per window"
    assert all(np.isnan(table.rows[0]["transmissibility"]) for table in measurements)


@pytest.mark.parametrize("frequency_hz", [0.0, -1.0, np.nan, 900.0])
def test_an_unusable_frequency_is_named(frequency_hz):
    measurements, _ = feed_all(tracker(frequency_hz), blocks(record(seconds=2.5), RATE, 20))
    assert set(words(measurements)) == {"no_frequency"}


def test_impacts_per_cycle_come_from_the_accelerometer():
    rows = record(9.1, 7.0, rate_hz=50_000)
    times = (np.arange(2 * 62) + 0.3) / (2 * 9.1)
    signs = np.tile([1, -1], 62)
    add_impacts(rows["accelerometer"], 50_000, times, np.full(len(times), 0.3), signs)
    measurements, impacts = feed_all(tracker(rate_hz=50_000), blocks(rows, 50_000, 500))
    row = measurements[0].rows[0]
    assert row["impacts_per_cycle"] == 2.0
    assert (row["regime"], row["period"]) == (b"periodic", 1)
    seconds = np.concatenate([table.stamp_ns / NS_PER_S + table.rows["time"] for table in impacts])
    assert np.allclose(seconds, times[: len(seconds)], atol=20e-6)
    assert np.array_equal(np.concatenate([table.rows["sign"] for table in impacts]), signs[: len(seconds)])


def test_scans_before_the_calibration_are_counted_not_measured():
    made = Tracker()
    feed_all(made, blocks(record(seconds=0.5), RATE, 20))
    assert made.counters == Counters(unconfigured_scans=RATE // 2)
    assert made.flush().measurements == ()


def test_a_bad_calibration_is_refused_and_the_old_one_kept():
    made = tracker()
    with pytest.raises(ConfigError):
        made.configure(Table(0, info_rows(RATE)[:3]))
    measurements, _ = feed_all(made, blocks(record(seconds=6.0), RATE, 20))
    assert words(measurements) == ["ok"]


def test_memory_does_not_grow_with_the_stream():
    made = tracker(tracker_settings=TrackerSettings())
    rows = record(seconds=30.0)
    tables = list(blocks(rows, RATE, 20))
    at = 0

    def minute():
        nonlocal at
        for _ in range(2):
            for table in tables:
                made.feed(Table(at * NS_PER_S // RATE, table.rows))
                at += len(table.rows)

    minute()
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        for _ in range(4):
            minute()
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert grown < 300_000, f"{grown} bytes in 4 minutes"


def test_words_that_carry_numbers_are_the_documented_ones():
    assert {Status.OK, Status.ACCELEROMETER_OVER_RANGE, Status.NOT_SETTLED} == MEASURED
    assert all(len(status.value) < 32 for status in Status), "text columns hold 32 bytes"


def test_settings_refuse_nonsense_by_name():
    with pytest.raises(ConfigError, match="windows must be >= 8"):
        TrackerSettings(windows=3)
    with pytest.raises(ConfigError, match="hold_s"):
        TrackerSettings(hold_s=-1.0)
    assert all(field.default is not attrs.NOTHING for field in attrs.fields(TrackerSettings))
    assert BASE_M * abs(linear_transmissibility(F_N)) < 0.01
    assert ZETA > 0


@pytest.mark.parametrize("times", ["another_rate", "nan", "backwards", "jitter"])
def test_scans_that_are_no_runs_are_lost_not_measured(times):
    """Another rate than daq/info says, or times that are none: counted, and no recursion."""
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


def test_windows_that_never_fill_are_refused():
    with pytest.raises(ConfigError, match="windows must be <= long_windows = 32, got 40"):
        TrackerSettings(windows=40)
