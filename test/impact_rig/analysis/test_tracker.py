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
"""Streaming measurement: it settles, reports how it knows this, and forgets data it has measured."""

from __future__ import annotations

import tracemalloc

import attrs
import numpy as np
import pytest
from kits.records import F_N, add_impacts, applied, blocks, feed_all, info_rows, linear_transmissibility, statuses
from kits.tracker import RATE, record, tracker

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.transmissibility import measure_record, note_on
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.errors import ConfigError
from impact_rig.simtime import NS_PER_S
from impact_rig.states import AnalysisWord


def test_a_settled_response_is_measured_window_after_window():
    measurements, _ = feed_all(tracker(), blocks(record(seconds=17.0), RATE, 20))
    truth = linear_transmissibility(9.1)
    assert statuses(measurements) == ["ok"] * 3
    for number, table in enumerate(measurements, start=1):
        row = table.rows[0]
        assert abs(row["transmissibility"] - abs(truth)) < 3 * row["transmissibility_uncertainty"]
        assert abs(row["phase"] - np.angle(truth)) < 3 * row["phase_uncertainty"]
        assert row["transmissibility_uncertainty"] < 0.003 * abs(truth)
        assert (row["settled"], row["cycles"], row["gap"], row["frequency"]) == (1, 48, 0.0, 9.1)
        # windows count from the command: the k-th row ends with the last scan of cycle 48 k
        last = int(np.ceil(48 * number * RATE / 9.1)) - 1
        assert table.stamp_ns == last * NS_PER_S // RATE
        assert row["time"] == 0
        assert row["waited"] == pytest.approx((last + 1) / RATE)


def test_streaming_yields_the_same_results_as_the_complete_record():
    rows = record(seconds=48 / 9.1 + 0.2)
    row = feed_all(tracker(), blocks(rows, RATE, 20))[0][0].rows[0]
    whole = measure_record(rows[: int(np.ceil(48 * RATE / 9.1))], info_rows(RATE), 9.1)
    assert row["transmissibility"] == pytest.approx(whole.transmissibility, rel=1e-12)
    assert row["phase"] == pytest.approx(whole.phase_rad, rel=1e-12)
    # its uncertainty holds the bias of a transient as well, here noise
    assert whole.u_transmissibility <= row["transmissibility_uncertainty"] < 1.5 * whole.u_transmissibility


def transient_ratio(frequency_hz, tau_s):
    """DT whose free vibration decays with tau relative to the drive, as after a command."""
    truth = linear_transmissibility(frequency_hz)
    beat = 2 * np.pi * (F_N - frequency_hz)
    return lambda t: truth * (1 - np.exp((-1 / tau_s + 1j * beat) * t))


@pytest.mark.heavy
@pytest.mark.parametrize(("frequency_hz", "tau_s"), [(9.1, 0.34), (9.1, 3.9), (9.0, 3.9), (10.0, 0.34), (8.5, 3.9)])
def test_the_wait_for_a_transient_is_no_longer_than_needed(frequency_hz, tau_s):
    """The bias of settled means is below 5e-4. The wait is as long as this requires, not a fixed time."""
    rows = record(frequency_hz, 55.0, transient=transient_ratio(frequency_hz, tau_s))
    measurements, _ = feed_all(tracker(frequency_hz), blocks(rows, RATE, 20))
    row = measurements[0].rows[0]
    truth = abs(linear_transmissibility(frequency_hz))
    assert (row["status"], row["regime"]) == (b"ok", b"periodic"), "the end of a transient is no modulation"
    assert row["transmissibility"] == pytest.approx(truth, rel=1e-3)
    assert abs(row["transmissibility"] - truth) < 3 * row["transmissibility_uncertainty"]
    assert row["waited"] < tau_s * np.log(1 / 2e-4) + 2.1 * 48 / frequency_hz


def test_the_wait_for_a_transient_is_the_same_if_the_laser_measures_velocity():
    """The noise of the certificate, of the same size as displacement, allows the same remnant of the transient."""
    omega, quiet = 2.0 * np.pi * 9.3, {"noise": 0.0, "transient": transient_ratio(9.3, 1.0)}
    rows, info = record(9.3, 15.0, **quiet), info_rows(RATE)
    expected = feed_all(tracker(9.3, info=info), blocks(rows, RATE, 200))[0][0].rows[0]
    rows["laser"] = omega * record(9.3, 15.0, phase=0.3 + np.pi / 2.0, **quiet)["laser"]
    laser = info["name"] == b"laser"
    info["unit"][laser] = b"m/s"
    for column in ("noise", "range_low", "range_high"):
        info[column][laser] *= omega
    found = feed_all(tracker(9.3, info=info), blocks(rows, RATE, 200))[0][0].rows[0]
    assert found["status"] == expected["status"] == b"ok"
    assert found["waited"] == expected["waited"]
    assert found["transmissibility"] == pytest.approx(expected["transmissibility"], rel=1e-3)


@pytest.mark.parametrize(
    ("frequency_hz", "tau_s"),
    [(9.3, 0.34), *(pytest.param(*one, marks=pytest.mark.slow) for one in [(9.1, 0.34), (9.3, 1.0)])],
)
@pytest.mark.repeats
def test_the_first_row_after_a_change_is_as_accurate_as_later_rows(frequency_hz, tau_s):
    """Over 120 draws of noise its mean error is at most 3.3 standard errors of that mean, 0.3 of a row's u."""
    truth, info = linear_transmissibility(frequency_hz), info_rows(RATE, gain_u=0.0)
    off = []
    for seed in range(120):
        rows = record(frequency_hz, 13.0 + 12.0 * tau_s, seed=seed, transient=transient_ratio(frequency_hz, tau_s))
        row = feed_all(tracker(frequency_hz, info=info), blocks(rows, RATE, 200))[0][0].rows[0]
        assert row["settled"] == 1
        off.append((
            (row["transmissibility"] - abs(truth)) / row["transmissibility_uncertainty"],
            (row["phase"] - np.angle(truth)) / row["phase_uncertainty"],
        ))  # fmt: skip
    assert np.all(np.abs(np.mean(off, axis=0)) < 3.3 / np.sqrt(len(off))), np.mean(off, axis=0)


@pytest.mark.heavy
def test_a_response_that_never_settles_is_reported_at_the_time_limit():
    """A response with a growing drift never settles: at the time limit it is reported with numbers, and settled = 0."""
    truth = linear_transmissibility(9.1)
    rows = record(9.1, 25.0, transient=lambda t: truth * (0.3 + 0.02 * t))
    slow = TrackerSettings(window_s=0.1, wait_limit_s=10.0)
    measurements, _ = feed_all(tracker(tracker_settings=slow), blocks(rows, RATE, 20))
    assert statuses(measurements) == ["not_settled"] * 2
    first = measurements[0].rows[0]
    assert first["settled"] == 0
    assert np.isfinite(first["transmissibility"])
    assert 10.0 <= first["waited"] < 11.0


@pytest.mark.heavy
def test_discarded_windows_do_not_count_as_waiting_time():
    """If a channel is over range for longer than the limit, the next 8 windows must not be reported as they are."""
    truth = linear_transmissibility(9.1)
    rows = record(seconds=50.0, transient=lambda t: truth * (1 + 0.05 * np.sin(3.3 * t) + 0.03 * np.sin(1.3 * t)))
    rows["status"][: 26 * RATE] = 2
    struck_twice_a_cycle(rows, 9.1, 50.0)
    made = tracker(tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=25.0))
    found = [table.rows[0] for table in feed_all(made, blocks(rows, RATE, 20))[0]]
    assert {row["status"] for row in found[:-1]} == {b"over_range"}
    assert (found[-1]["status"], found[-1]["regime"], found[-1]["cycles"]) == (b"ok", b"modulated", 192)


def struck_twice_a_cycle(rows, frequency_hz, seconds):
    """Add impacts of about the same phases in every cycle."""
    count = int(2 * seconds * frequency_hz) - 2
    times = (np.arange(count) + 0.3) / (2 * frequency_hz)
    add_impacts(rows["accelerometer"], RATE, times, np.full(count, 0.3), np.tile([1, -1], count // 2 + 1)[:count])


@pytest.mark.heavy
def test_fluctuation_without_impacts_is_not_called_modulation():
    """A linear rig is neither modulated nor chaotic, although its first rows fluctuate if the base moves little."""
    truth = linear_transmissibility(9.2)
    rows = record(9.2, 30.0, transient=lambda t: truth * (1 + 0.03 * np.cos(2.7 * t)))
    assert not feed_all(tracker(9.2), blocks(rows, RATE, 20))[0]


@pytest.mark.heavy
def test_a_modulated_response_is_labelled_and_averaged_for_longer():
    truth = linear_transmissibility(9.2)
    rows = record(9.2, 30.0, transient=lambda t: truth * (1 + 0.03 * np.cos(2.7 * t)))
    struck_twice_a_cycle(rows, 9.2, 30.0)
    measurements, _ = feed_all(tracker(9.2), blocks(rows, RATE, 20))
    row = measurements[0].rows[0]
    assert (row["status"], row["regime"], row["method"]) == (b"ok", b"modulated", b"batch_means")
    assert row["cycles"] == 192
    assert abs(row["transmissibility"] - abs(truth)) < 3 * row["transmissibility_uncertainty"]


@pytest.mark.heavy
def test_impacts_per_cycle_are_counted_by_the_accelerometer():
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


@pytest.mark.repeats
def test_memory_does_not_grow_with_the_length_of_the_stream():
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


def test_invalid_settings_are_rejected_by_name():
    with pytest.raises(ConfigError, match="windows must be >= 8"):
        TrackerSettings(windows=3)
    with pytest.raises(ConfigError, match="hold_s"):
        TrackerSettings(hold_s=-1.0)
    assert all(field.default is not attrs.NOTHING for field in attrs.fields(TrackerSettings))


def test_settings_whose_windows_never_fill_are_rejected():
    with pytest.raises(ConfigError, match=r"windows must be <= long_windows = 32, the number averaged .* got 40"):
        TrackerSettings(windows=40)


def test_the_state_reports_the_activity_of_the_measurement_and_its_start():
    """States: no scans, settling from the command on, measuring from the first row on, unable with a stuck laser."""
    made, rows = tracker(), record(seconds=30.0)
    assert (made.state.word, made.state.since_ns) == (AnalysisWord.NO_SCANS, None)
    rows["laser"][20 * RATE :] = rows["laser"][20 * RATE]
    tables, seen = list(blocks(rows, RATE, 20)), []
    made.on_applied(applied(9.1, 0.0, at_ns=28 * NS_PER_S))
    for table in (*tables[:1000], *tables[1010:]):
        made.feed(table)
        if not seen or seen[-1] != made.state:
            seen.append(made.state)
    found = [(state.word, state.reason) for state in seen]
    assert found == [
        (AnalysisWord.AT_REST, ""),  # the command is known with the scans it acts on, which are held back at first
        (AnalysisWord.SETTLING, ""), (AnalysisWord.MEASURING, ""), (AnalysisWord.LOST_SCANS, "lost_blocks"),
        (AnalysisWord.MEASURING, ""), (AnalysisWord.UNABLE, "constant"), (AnalysisWord.AT_REST, ""),
    ]  # fmt: skip
    assert seen[1].since_ns == 0
    assert seen[2].since_ns == (int(np.ceil(48 * RATE / 9.1)) - 1) * NS_PER_S // RATE
    assert seen[-1].since_ns == 28 * NS_PER_S


def test_rest_is_a_state_and_not_a_problem():
    """At rest, the rows have the status `silence`, and after a pluck a worse one. This is no problem."""
    rng, made = np.random.default_rng(6), tracker()
    rows = record(seconds=20.0)
    for name, rms in (("laser", 3e-6), ("base", 1e-6), ("current", 2e-3), ("accelerometer", 0.05)):
        rows[name] = rms * rng.standard_normal(len(rows))
    free = np.arange(8 * RATE) / RATE
    rows["laser"][12 * RATE :] += 2e-3 * np.exp(-0.25 * free) * np.cos(2 * np.pi * F_N * free)
    made.on_applied(applied(9.1, 0.0))
    seen, said = set(), []
    for table in blocks(rows, RATE, 20):
        said += statuses(made.feed(table).measurements)
        seen.add(made.state)
    assert said[:3] == ["silence", "silence", "spikes"]
    assert {(state.word, state.reason) for state in seen} - {(AnalysisWord.NO_SCANS, "")} == {
        (AnalysisWord.AT_REST, "")
    }


def test_the_state_is_no_longer_measured_when_the_next_row_is_overdue():
    """The wall becomes softer, for example: no message reports this, but the response disagrees with its last row."""
    made, rows = tracker(), record(seconds=20.0)
    growth = 1.0 + 0.1 * np.maximum(np.arange(len(rows)) / RATE - 12.0, 0.0)
    for channel in ("laser", "accelerometer"):
        rows[channel] *= growth
    seen = []
    for table in blocks(rows, RATE, 20):
        made.feed(table)
        if not seen or seen[-1] != made.state:
            seen.append(made.state)
    assert [state.word for state in seen] == [
        AnalysisWord.AT_REST,
        AnalysisWord.SETTLING,
        AnalysisWord.MEASURING,
        AnalysisWord.SETTLING,
    ]
    assert 15.8 < seen[-1].since_ns / NS_PER_S < 16.6, "a window after the third row was due"
    assert made.progress.windows < made.progress.needed


def test_progress_expects_a_further_window_while_the_transient_lasts():
    made, rows = tracker(), record(seconds=12.0)
    for channel in ("laser", "accelerometer"):
        rows[channel] *= 1.0 + 0.1 * np.arange(len(rows)) / RATE
    seen = set()
    for table in blocks(rows, RATE, 20):
        if made.feed(table).measurements:  # given up
            break
        if (progress := made.progress) is not None:
            seen.add(progress.windows)
            assert progress.windows < progress.needed
    assert max(seen) > TrackerSettings().windows


def struck(rows, times_s, rate_hz=RATE):
    add_impacts(rows["accelerometer"], rate_hz, times_s, np.full(len(times_s), 0.4), np.resize([1, -1], len(times_s)))
    return rows


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("gap_m", "strikes", "first_s", "age_s"),
    [
        pytest.param(0.0, False, 5.3, np.nan, id="no sphere"),
        pytest.param(0.010, False, 10.5, np.nan, id="a sphere that never strikes"),
        pytest.param(0.010, True, 16.4, 10.4, id="a sphere that struck for 6 s"),
        pytest.param(np.nan, False, 5.3, np.nan, id="unknown, and no impact ever"),
        pytest.param(np.nan, True, 28.4, 22.4, id="unknown, but there were impacts"),
    ],
)
def test_a_row_without_impacts_waits_until_a_drifting_sphere_would_have_struck(gap_m, strikes, first_s, age_s):
    """The amplitude of the structure is steady all the time; the status states what the silence does not exclude."""
    rows = record(seconds=max(25.0, first_s + 3.0))
    if strikes:
        struck(rows, np.arange(0.2, 6.0, 0.0549))
    made = tracker(gap_m=gap_m, tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=22.0, slowest_speed=1e-3))
    measurements, _ = feed_all(made, blocks(rows, RATE, 20))
    quiet = [t.rows[0] for t in measurements if t.rows[0]["settled"] == 1 and t.rows[0]["impacts_per_cycle"] == 0]
    is_sphere = gap_m > 0.0 or strikes
    assert {bytes(row["status"]) for row in quiet} == {b"no_impacts" if is_sphere else b"ok"}
    assert all(row["transmissibility_uncertainty"] > 0.0 for row in quiet)
    assert quiet[0]["waited"] == pytest.approx(first_s, abs=0.7)
    assert quiet[0]["impact_age"] == pytest.approx(age_s, abs=0.7, nan_ok=True)


def test_the_wait_for_a_drifting_sphere_counts_from_the_setting_of_the_gap():
    """The wait counts from the label, not from an impact in the window that the label interrupted a second before."""
    rows = struck(record(seconds=22.0), np.arange(0.2, 6.7, 0.0549))
    made = tracker(gap_m=0.010, tracker_settings=TrackerSettings(window_s=1.3, wait_limit_s=40.0, slowest_speed=1e-3))
    made.label(0.011, 7_800_000_000)  # the window from 6.6 s on is not complete then
    measurements, _ = feed_all(made, blocks(rows, RATE, 20))
    assert statuses(measurements) == ["label_changed", "no_impacts"]
    assert measurements[0].rows["impact_age"][0] == pytest.approx(7.8 - 6.679, abs=0.06)
    row = measurements[1].rows[0]
    assert row["waited"] >= 11.0
    assert np.isnan(row["impact_age"])


def test_the_wait_at_a_wide_gap_does_not_exceed_the_time_limit():
    """At 12 mm and 0.1 mm/s, the sphere needs two minutes; a wait beyond the time limit would count as a failure."""
    made = tracker(gap_m=0.012, tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=12.0))
    measurements, _ = feed_all(made, blocks(record(seconds=19.0), RATE, 20))
    assert statuses(measurements) == ["no_impacts"] * 2
    first = measurements[0].rows[0]
    assert first["waited"] == pytest.approx(12.2, abs=0.7)
    assert note_on(first) == "no impacts for 13 s; a sphere slower than 0.96 mm/s could still strike"


def test_a_row_without_a_wait_names_no_speed():
    """A file of another program may contain one; its gap over no time is no speed."""
    row = np.zeros(1, TRANSMISSIBILITY)[0]
    row["status"], row["gap"] = b"no_impacts", 0.012
    assert note_on(row) == "no impacts for 0 s; a slower sphere could still strike"


def test_silence_after_impacts_extends_the_wait_beyond_the_time_limit():
    """The sphere struck for 6 s: if the time limit of 10 s ends before the silence is long enough, nothing failed."""
    rows = struck(record(seconds=18.0), np.arange(0.2, 6.0, 0.0549))
    made = tracker(gap_m=0.012, tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=10.0))
    measurements, _ = feed_all(made, blocks(rows, RATE, 20))
    assert statuses(measurements) == ["ok", "no_impacts"]
    assert measurements[1].rows[0]["impact_age"] == pytest.approx(10.7, abs=0.7)


def test_impacts_that_resume_after_the_time_limit_end_the_wait_as_intermittent():
    rows = struck(record(seconds=12.0), np.r_[np.arange(0.2, 3.0, 0.31), 9.5])
    made = tracker(gap_m=0.012, tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=10.0))
    measurements, _ = feed_all(made, blocks(rows, RATE, 20))
    first = measurements[0].rows[0]
    assert (first["status"], first["regime"], first["settled"]) == (b"not_settled", b"intermittent", 0)
    assert 10.0 < first["waited"] < 11.0


def test_the_end_of_a_record_releases_a_row_that_waits_for_the_sphere():
    """A record of 15 s at 12 mm gives a row, or the reason why there is none."""
    made = tracker(gap_m=0.012)
    measurements, _ = feed_all(made, blocks(record(seconds=15.0), RATE, 20))
    assert measurements == []
    measurements = made.flush().measurements
    assert statuses(measurements) == ["no_impacts"]
    assert note_on(measurements[0].rows[0]).startswith("no impacts for 15 s; a sphere slower than 0.8")


def test_silence_at_rest_does_not_count_as_silence_of_the_sphere():
    """The label is set long before the drive; slow impacts of a rig at rest are not detected."""
    made = tracker(None, gap_m=0.010, tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=12.0))
    made.on_applied(applied(9.1, 0.0))
    made.on_applied(applied(9.1, 0.52, at_ns=10 * NS_PER_S))
    measurements, _ = feed_all(made, blocks(record(seconds=24.0), RATE, 20))
    last = measurements[-1].rows[0]
    assert (last["status"], last["waited"]) == (b"no_impacts", pytest.approx(12.2, abs=0.7))


def test_progress_never_exceeds_its_total_and_mentions_a_wait_for_the_sphere():
    """Progress must not read "window 83 of 16, transient 0.0 %" while the analysis waits for the sphere."""
    made, seen = tracker(gap_m=0.012, tracker_settings=TrackerSettings(window_s=0.1, wait_limit_s=14.0)), []
    for block in blocks(record(seconds=16.0), RATE, 20):
        made.feed(block)
        if made.progress is not None:
            seen.append((block.stamp_ns / 1e9, made.progress, made.state.word))
    assert all(progress.windows <= progress.needed for _, progress, _ in seen)
    settling = [(at_s, progress) for at_s, progress, word in seen if word == "settling"]
    assert all(progress.windows < progress.needed for _, progress in settling)
    reasons = {at_s: progress.reason for at_s, progress in settling if progress.reason}
    assert set(reasons.values()) == {"waiting up to 14 s for a sphere that may still strike"}
    assert min(reasons) < 1.0
    assert {progress.reason for _, progress, word in seen if word != "settling"} == {""}


@pytest.mark.heavy
@pytest.mark.parametrize("window_s", [0.5, 2.0])
def test_progress_mentions_no_wait_for_a_sphere_that_strikes_regularly(window_s):
    """Impacts since the last finished window count, too: nothing is awaited however long a window is."""
    made = tracker(gap_m=0.006, tracker_settings=TrackerSettings(window_s=window_s))
    for block in blocks(struck(record(seconds=7.0), (np.arange(126) + 0.3) / 18.2), RATE, 20):
        made.feed(block)
        assert made.progress is None or made.progress.reason == ""


def test_regular_impacts_do_not_extend_the_wait():
    rows = struck(record(seconds=7.0), (np.arange(126) + 0.3) / 18.2)
    row = feed_all(tracker(gap_m=0.006), blocks(rows, RATE, 20))[0][0].rows[0]
    assert row["waited"] == pytest.approx(48 / 9.1, abs=1 / RATE)
    assert row["impact_age"] < 0.1
