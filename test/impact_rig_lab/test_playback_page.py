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
"""Recorded runs on the page: slider, marks, steps to impacts, two runs at once, and a server that restarts."""

from __future__ import annotations

import math
import queue
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import attrs
import numpy as np
import pytest
from kits.browser import PATIENCE_S, Page, wait_until
from kits.recorded_rig import PROVENANCE, Messages, edited, messages, published, record

from impact_rig import codec, topics
from impact_rig.blocks import Table
from impact_rig.cli.main import main
from impact_rig.errors import RecordingError
from impact_rig.recording import RunWriter, TopicDescription
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig_lab.playback import PlaybackSource
from impact_rig_lab.protocol import Request
from impact_rig_lab.server import Server

pytestmark = pytest.mark.heavy


@pytest.fixture
def shown(sample: Path) -> Iterator[Callable[..., Server]]:
    """Serve runs until the end of the test."""
    open_ones: list[tuple[Server, PlaybackSource]] = []

    def serve(*paths: Path) -> Server:
        source = PlaybackSource(paths or [sample])
        source.start()
        server = Server(source, port=0)
        server.start()
        open_ones.append((server, source))
        return server

    yield serve
    for server, source in open_ones:
        server.close()
        source.close()


def at(page: Page, seconds: float) -> None:
    page.wait(f"Math.abs(lab.now.playback.now - {seconds}) < 0.01", f"the instant {seconds} s")


def seek(page: Page, seconds: float) -> None:
    page.js(
        f"(() => {{ const p = document.getElementById('position'); p.value = {seconds};"
        " p.dispatchEvent(new Event('input')); p.dispatchEvent(new Event('change')); })()"
    )


def test_playback_plays_pauses_jumps_and_steps_to_the_next_impact(
    shown: Callable[..., Server], open_page: Callable[..., Page]
) -> None:
    page = open_page(shown().address)
    page.wait("window.lab && lab.drawn.pictures > 2", "the first traces")
    page.click("#play")
    page.wait("!lab.now.playback.playing", "a pause")
    seek(page, 15.0)
    at(page, 15.0)
    page.wait("Math.abs(lab.scope.trace.now - 15) < 0.02", "traces of that instant")
    page.wait("lab.spectrum.plot.data[0].length > 100", "the spectrum of the two seconds before it")
    page.wait("document.getElementById('dt-number').textContent !== '–'", "the measurement of before")
    shown_lines = "document.querySelectorAll('#journal-list li').length"
    page.wait(
        f"{shown_lines} === lab.now.journal.filter(([time]) => time <= 15).length", "a journal without the future"
    )
    page.wait("lab.now.playback.read === 1 && lab.now.impact_marks.some(n => n)", "the marks")
    page.click("#next-impact")
    page.wait("lab.now.playback.now > 15", "the next impact")
    then = page.js("lab.now.playback.now")
    page.key(",")
    page.wait(f"lab.now.playback.now < {then}", "the one before")
    page.choose("#play-speed", "20")
    page.wait("lab.now.playback.speed === 20", "twenty times")
    page.click("#play")
    page.wait("lab.now.playback.now === lab.now.playback.end && !lab.now.playback.playing", "the end")


def test_controls_show_the_recorded_values_and_are_disabled(
    shown: Callable[..., Server], open_page: Callable[..., Page]
) -> None:
    page = open_page(shown().address)
    page.wait("window.lab && lab.now.applied", "the state")
    seek(page, 0.5)
    page.wait("document.getElementById('knob-current').value === '0'", "no current before the command")
    seek(page, 10.0)
    page.wait("document.getElementById('knob-current').value === '0.52'", "the current of then")
    controls = "#knob-frequency, #knob-law, #run, #stop, #record, [data-mark]"
    assert page.js(f"[...document.querySelectorAll('{controls}')].every(e => e.disabled)")
    assert page.js("lab.link.ask('stop').answer.then(a => a.ok)") is False


def asked(source: PlaybackSource, do: str, **values: object) -> tuple[bool, str]:
    """Send a request, and return the answer."""
    answers: queue.SimpleQueue[tuple[bool, str]] = queue.SimpleQueue()
    source.ask(Request(1, do, values), lambda ok, text: answers.put((ok, text)))
    return answers.get(timeout=PATIENCE_S)


@pytest.fixture(scope="module")
def recorded() -> Messages:
    return messages(12)


def from_second(found: Messages, second: float) -> Messages:
    """Return the messages of a recorder that started late: the latched ones, and the scans from then on."""
    return [(name, table) for name, table in found if name != "daq/scan" or table.stamp_ns >= second * 1e9]


def test_stepping_reaches_every_impact_and_ends_at_the_last(sample: Path) -> None:
    """An impact less than 50 ms before the end of the run must not be found again and again: later ones follow."""
    with PlaybackSource([sample]) as source:
        run = source._runs[0]
        wait_until(lambda: run.whole, "the marks")
        impacts = sorted(run._impacts)
        assert impacts[-2] > run.end_s - 0.05
        assert asked(source, "seek", value=run.end_s - 0.2)[0]
        shown = []
        while asked(source, "next_impact", value=1.0)[0]:
            shown.append(source._impact_s)
            assert len(shown) <= len(impacts)
        assert shown == [one for one in impacts if one > run.end_s - 0.25]
        assert asked(source, "next_impact", value=-1.0)[0]
        assert source._impact_s == impacts[-2]


def test_two_runs_can_be_aligned_by_start_time_or_change_and_have_a_legend(
    shown: Callable[..., Server], open_page: Callable[..., Page], recorded: Messages, tmp_path: Path
) -> None:
    """The second run begins five seconds later in rig time: aligned by start, both appear at once."""
    late = record(tmp_path / "late", from_second(recorded, 5.0))
    page = open_page(shown(record(tmp_path / "first", recorded), late).address, 1920, 1080, prefers_color_scheme="dark")
    page.wait("window.lab && lab.now.playback?.read === 1", "the marks")
    page.click("#play")
    seek(page, 4.0)
    page.wait("lab.scope.other && Math.abs(lab.scope.trace.now - 4) < 0.02", "traces of both")
    assert page.js("Math.abs(lab.scope.other.begin - lab.scope.trace.begin - 5) < 0.6")
    assert [page.text(f"#legend-{run}") for run in "ab"] == ["first", "late"]
    page.choose("#align", "time")
    page.wait("lab.now.playback.aligned === 'time' && lab.scope.other === null", "the second not to have begun")
    seek(page, 10.8)
    page.wait("lab.scope.other && Math.abs(lab.scope.other.begin - lab.scope.trace.begin) < 0.6", "both at one time")
    page.wait("lab.now.dt_b?.length > 0 && lab.now.dt.length === lab.now.dt_b.length", "measurements of both")
    page.choose("#align", "change")
    page.wait("lab.now.playback.aligned === 'change'", "the change")
    page.choose("#align-change", page.js("[...document.querySelectorAll('#align-change option')].at(-1).value"))
    page.wait("document.getElementById('answer').textContent.startsWith('both runs at stop')", "its words")
    driven = "driven at 9.1 Hz, 0.52 A."
    assert page.js("lab.now.rig.text") == f"first: {driven} late: {driven}"


def test_a_run_recorded_from_mid_session_begins_with_its_first_scan(recorded: Messages, tmp_path: Path) -> None:
    with PlaybackSource([record(tmp_path / "late", from_second(recorded, 6.0))]) as source:
        source.watchers = 1
        assert source.now_s == pytest.approx(6.0, abs=0.05)
        wait_until(lambda: source.record.scope.end_s > 6.2, "scans at once")
        assert source.snapshot.get("playback")["begin"] == 6.0
        wait_until(lambda: (source.snapshot.get("applied") or {}).get("current") == 0.52, "the drive of before")


def test_one_rig_of_a_recording_of_two_is_shown(tmp_path: Path) -> None:
    writer = RunWriter(tmp_path / "two", provenance=PROVENANCE, clock=time.monotonic)
    with writer:
        for namespace, current in (("left", 0.3), ("right", 0.6)):
            rig = Rig(from_flat(RigConfig(), {"daq.seed": 5, "drive.amplitude": current}))
            tables = [
                ("daq/info", rig.info()),
                *((name, one) for name, one in published(rig, 50) if name != "rig/journal"),
            ]
            for name in {name for name, _ in tables}:
                writer.add_topic(TopicDescription(name=f"/{namespace}/{name}", type_name=topics.TABLE))
            for name, one in tables:
                writer.write(f"/{namespace}/{name}", codec.encode(one), one.stamp_ns)
    with pytest.raises(RecordingError, match=r"several rigs: /left, /right; choose one with --rig NAMESPACE"):
        PlaybackSource([tmp_path / "two"])
    for namespace, current in (("/left", 0.3), ("/right", 0.6)):
        with PlaybackSource([tmp_path / "two"], namespace) as source:
            wait_until(lambda source=source: source.snapshot.get("applied"), "the drive")
            assert source.snapshot.get("applied")["current"] == current


def test_playback_skips_the_time_between_two_runs_of_a_session(recorded: Messages, tmp_path: Path) -> None:
    """The second run begins 21 minutes of rig time after the end of the first: the player must skip this time."""
    first = [(name, table) for name, table in recorded if table.stamp_ns < 3e9]
    runs = [record(tmp_path / "first", first), record(tmp_path / "late", from_second(recorded, 8.0))]
    with PlaybackSource(runs) as source:
        wait_until(lambda: source.snapshot.get("playback"), "the state")
        assert asked(source, "play", value=False) == (True, "")
        assert asked(source, "seek", value=1.0) == (True, "")
        found = source.snapshot.get("playback")
        assert (found["begin"], found["aligned"]) == (0.0, "start")
        assert found["end"] < 3.1
        assert source.other is not None
        assert source.other.end_s == pytest.approx(9.0, abs=0.02), "the second after its first second"


def test_a_recorded_value_is_current_only_until_something_changes(recorded: Messages, tmp_path: Path) -> None:
    """At rest, while settling, and after the latch, the last value is not the present one."""
    rows = [table for name, table in recorded if name == "transmissibility/table"]
    measured_s = rows[0].stamp_ns / 1e9
    with PlaybackSource([record(tmp_path / "run", recorded)]) as source:
        wait_until(lambda: (source.snapshot.get("playback") or {}).get("read") == 1.0, "the marks")
        asked(source, "play", value=False)
        for at_s, state in ((0.05, "at_rest"), (measured_s - 0.2, "settling"), (measured_s + 0.1, "measuring"),
                            (11.65, "settling"), (11.9, "at_rest")):  # fmt: skip
            asked(source, "seek", value=at_s)
            now = source.snapshot.get("dt_now")
            assert (now["state"], now["holds"]) == (state, state == "measuring"), at_s
        assert "latched by emergency stop" in source.snapshot.get("rig")["text"]
        asked(source, "seek", value=11.79)
        assert source.snapshot.get("faults") == []


def test_the_beginning_of_a_long_run_is_shown_as_well(recorded: Messages, tmp_path: Path) -> None:
    """Not only the last 400 rows, 300 faults and lines are kept: earlier measurements must be shown as well."""
    measured = next(table for name, table in recorded if name == "transmissibility/table")
    with PlaybackSource([record(tmp_path / "run", recorded)]) as source:
        run = source._runs[0]
        wait_until(lambda: run.whole, "the marks")
        fault = np.zeros(1, topics.FAULTS.columns)
        fault["id"], fault["active"], fault["kind"], fault["channel"] = 1, 1, b"dropout", b"laser"
        begins = Table(measured.stamp_ns, fault)
        run.record.faults.add(begins)
        run.record.journal.fault(begins)
        for number in range(500):  # an hour later
            later_ns = measured.stamp_ns + (3600 + number) * NS_PER_S
            run.record.curve.add(Table(later_ns, measured.rows))
            fault["id"] = 2 + number
            run.record.faults.add(Table(later_ns, fault))
            run.record.journal.fault(Table(later_ns, fault))
        at_s = measured.stamp_ns / NS_PER_S + 0.05
        assert len(run.rows(at_s)) == 1
        assert run.present(at_s, run.at(at_s))["state"] == "measuring"
        assert len(run.record.faults.in_force(0, run.instant_ns(at_s))) == 1
        assert any("dropout" in line[3] and line[0] < at_s for line in run.record.journal.part(0))
        assert len(run.rows(5000.0)) == 400


def test_a_recorded_value_is_not_current_during_a_fault(recorded: Messages, tmp_path: Path) -> None:
    measured_ns = next(table.stamp_ns for name, table in recorded if name == "transmissibility/table")
    row = np.zeros(1, topics.FAULTS.columns)
    row["id"], row["active"], row["kind"], row["channel"] = 1, 1, b"dropout", b"laser"
    fault = Table(measured_ns + NS_PER_S // 10, row)
    place = next(
        n for n, (name, table) in enumerate(recorded) if name == "daq/scan" and table.stamp_ns > fault.stamp_ns
    )
    run = record(tmp_path / "run", [*recorded[:place], ("truth/faults", fault), *recorded[place:]])
    with PlaybackSource([run]) as source:
        wait_until(lambda: (source.snapshot.get("playback") or {}).get("read") == 1.0, "the marks")
        asked(source, "play", value=False)
        for later_s, holds in ((0.05, True), (0.15, False)):
            asked(source, "seek", value=measured_ns / NS_PER_S + later_s)
            assert source.snapshot.get("dt_now")["state"] == "measuring"
            assert source.snapshot.get("dt_now")["holds"] is holds, source.snapshot.get("faults")


def test_missing_blocks_are_counted(recorded: Messages, tmp_path: Path) -> None:
    missing = [one for one in recorded if not (one[0] == "daq/scan" and 3e9 <= one[1].stamp_ns < 4e9)]
    with PlaybackSource([record(tmp_path / "run", missing)]) as source:
        wait_until(lambda: (source.snapshot.get("playback") or {}).get("read") == 1.0, "the marks")
        for at_s, lost in ((2.0, {}), (5.0, {"blocks missing in the recording": 100})):
            asked(source, "seek", value=at_s)
            assert source.snapshot.get("lost") == lost


@pytest.mark.parametrize("rate", [math.nan, 0.0, math.inf, 1e12])
def test_an_impossible_rate_is_reported_in_one_line(recorded: Messages, tmp_path: Path, rate: float) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        rows["rate"] = rate
        return rows

    with pytest.raises(RecordingError, match="rate"):
        PlaybackSource([record(tmp_path / "run", edited(recorded, "daq/info", change))])


def without(column: str) -> Callable[[np.ndarray], np.ndarray]:
    """Return a table without a column."""

    def change(rows: np.ndarray) -> np.ndarray:
        names = [name for name in rows.dtype.names if name != column]
        found = np.zeros(len(rows), [(name, rows.dtype[name]) for name in names])
        for name in names:
            found[name] = rows[name]
        return found

    return change


@pytest.mark.parametrize(
    ("topic", "column"),
    [
        ("daq/scan", "status"),
        ("transmissibility/table", "phase"),
        ("shaker/applied", "current"),
    ],
)  # fmt: skip
def test_tables_without_a_column_do_not_affect_other_topics(
    recorded: Messages, tmp_path: Path, topic: str, column: str
) -> None:
    """Every table of one topic is broken after the third second; the other topics are played to the end."""
    broken = [
        (name, attrs.evolve(table, rows=without(column)(table.rows)))
        if name == topic and (table.stamp_ns >= 3e9 or name != "daq/scan") else (name, table)
        for name, table in recorded
    ]  # fmt: skip
    with PlaybackSource([record(tmp_path / "run", broken)]) as source:
        source.watchers = 1
        wait_until(lambda: (source.snapshot.get("playback") or {}).get("read") == 1.0, "the marks")
        assert asked(source, "seek", value=2.0) == (True, "")
        assert asked(source, "seek", value=11.9) == (True, "")
        assert topic in source.snapshot.get("refused")
        wait_until(lambda: source.now_s == pytest.approx(12.0, abs=0.05), "the end")


def test_invalid_messages_of_both_runs_are_shown(recorded: Messages, tmp_path: Path) -> None:
    broken = edited(recorded, "shaker/applied", without("current"))
    paths = [record(tmp_path / "one", broken), record(tmp_path / "two", [*broken, *broken[-1:]])]
    with PlaybackSource(paths) as source:
        wait_until(lambda: len(source.snapshot.get("refused") or {}) == 2, "the counts of both runs")
        assert list(source.snapshot.get("refused")) == ["shaker/applied", "shaker/applied of the second run"]


def test_a_recorded_drive_in_volts_is_shown_with_its_unit(tmp_path: Path) -> None:
    found = messages(2, **{"drive.kind": "voltage"})
    with PlaybackSource([record(tmp_path / "run", found)]) as source:
        wait_until(lambda: (source.snapshot.get("playback") or {}).get("read") == 1.0, "the marks")
        assert asked(source, "seek", value=1.0) == (True, "")
        assert "9.1 Hz, 0.52 V" in source.snapshot.get("rig")["text"]


def test_runs_without_rows_are_rejected_in_one_line(recorded: Messages, tmp_path: Path) -> None:
    none = edited(recorded, "daq/info", lambda rows: rows[:0])
    with pytest.raises(RecordingError, match=r"its calibration \(daq/info\) is unusable: daq/info has no rows, so"):
        PlaybackSource([record(tmp_path / "info", none)])
    empty = edited(recorded, "daq/scan", lambda rows: rows[:0])
    with PlaybackSource([record(tmp_path / "scans", empty)]) as source:
        wait_until(lambda: (source.snapshot.get("playback") or {}).get("read") == 1.0, "the marks")


def test_a_truncated_run_is_played(
    shown: Callable[..., Server], open_page: Callable[..., Page], sample: Path, tmp_path: Path
) -> None:
    broken = tmp_path / "broken"
    broken.mkdir()
    (whole,) = sample.glob("*.mcap")
    (broken / "run.mcap").write_bytes(whole.read_bytes()[: whole.stat().st_size * 2 // 3])
    page = open_page(shown(broken).address)
    page.wait("window.lab && lab.now.rig?.text.includes('truncated')", "the words about it")
    page.wait("lab.drawn.pictures > 2", "the intact part")
    assert 5.0 < page.js("lab.now.playback.end") < 20.0


def test_a_path_that_is_not_a_run_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(RecordingError):
        PlaybackSource([tmp_path / "nothing"])


def test_the_page_reconnects_to_a_restarted_server_and_keeps_its_measurements(
    shown: Callable[..., Server], open_page: Callable[..., Page], sample: Path
) -> None:
    server = shown()
    page = open_page(server.address)
    seek(page, 19.0)
    page.wait("window.lab && lab.now.dt?.length > 0", "a measurement")
    count = page.js("lab.now.dt.length")
    page.expected = "ERR_CONNECTION_REFUSED"
    server.close()
    page.wait("document.getElementById('word').textContent === 'offline'", "the connection to be missed")
    assert page.js("document.body.classList.contains('stale') && lab.now.dt.length") == count
    source = PlaybackSource([sample])
    with Server(source, port=server.port, token=server.token), source:
        pictures = page.js("lab.drawn.pictures")
        page.wait(f"lab.link.connected && lab.drawn.pictures > {pictures}", "traces after the restart")
        wait_until(lambda: page.text("#word") == "playback", "the word")


def test_the_scope_of_a_rig_driven_by_samples_shows_the_commanded_current(
    shown: Callable[..., Server], open_page: Callable[..., Page], tmp_path: Path
) -> None:
    np.savez(tmp_path / "wave.npz", drive=0.4 * np.sin(2.0 * np.pi * 9.1 * np.arange(3_000) / 1_000), fs=1_000.0)
    command = ("drive", "play", tmp_path / "wave.npz", "--scan-rate", 2_000, "--output", tmp_path / "run")
    assert main([str(word) for word in command]) == 0
    page = open_page(shown(tmp_path / "run").address)
    page.wait("lab.now?.playback && lab.drawn.pictures > 2", "the first traces")
    seek(page, 2.0)
    page.wait("lab.scope.trace.low.length === 5 && lab.scope.trace.low[4].some(v => v > 0.35)", "the current commanded")
    apart = "Math.max(...lab.scope.trace.low[4].map((v, i) => Math.abs(v - lab.scope.trace.low[3][i]) || 0))"
    assert page.js(apart) < 0.1
    page.wait("/^[0-9.]+ of 2\\.0 s$/.test(document.getElementById('stream').textContent)", "the buffer in the bar")
    assert page.js("!document.getElementById('stream-box').hidden")
    assert "driven by a stream of samples" in page.text("#sentence")
