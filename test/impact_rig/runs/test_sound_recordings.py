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
"""Sound but unusual recordings are accepted by every command, and their durations are right."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from kits.recorded_rig import Messages, agreement, everything, messages, record
from mcap.writer import Writer

from impact_rig import codec, topics
from impact_rig.analysis.settings import TrackerSettings, settings_table
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.cli.main import main
from impact_rig.recording import TopicDescription, open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.runs import info, reanalysis, recorded_journal
from impact_rig.runs.verification import Verification, verify
from impact_rig.simtime import NS_PER_S, stamp_ns

THIRD_VERSION = Path(__file__).parents[2] / "data" / "third_version"
"""Recorded by the third version in mid-session: what is latched has log times of up to 120 s before the first scan."""
BESIDE = (("plot/envelope/laser", "geometry_msgs/msg/Vector3Stamped"), ("plot/truth/impacts", "std_msgs/msg/String"))
"""Topics that end like those of the rig, as a recording of everything holds them."""


def analysed(rig: Rig, blocks: int, deeds: dict[int, Any], until: int | None = None) -> Messages:
    """Return the messages of rig and analysis, which has processed blocks up to `until` when the recorder stops."""
    tracker = Tracker()
    tracker.configure(rig.info())
    tracker.label(0.0, 0)
    found: Messages = [("daq/info", rig.info()), ("analysis/settings", settings_table(TrackerSettings(), 0.0, 0))]
    for number in range(blocks):
        deeds.get(number, lambda: None)()
        for block in rig.advance(rig.block_end_ns(1)):
            for topic, tables in (("rig/journal", rig.take_journal()), ("shaker/applied", rig.take_applied())):
                found += [(topic, table) for table in tables]
                if topic == "shaker/applied":
                    for table in tables:
                        tracker.on_applied(table)
            found.append(("daq/scan", block.scan))
            if block.impacts is not None:
                found.append(("truth/impacts", block.impacts))
            results = tracker.feed(block.scan).measurements
            if until is None or number < until:
                found += [("transmissibility/table", table) for table in results]
    return found


def bag_of_everything(path: Path, **runs: Path) -> Path:
    """Write several runs into one file as `ros2 bag record -a` would: each in a namespace, with additional topics."""
    writer = Writer(str(path))
    writer.start("ros2")
    for namespace, source in runs.items():
        for name, kind in BESIDE:
            schema = writer.register_schema(
                kind, "ros2msg", TopicDescription(name=name, type_name=kind).schema.encode()
            )
            channel = writer.register_channel(f"/{namespace}/{name}", "cdr", schema)
            writer.add_message(channel, 1, b"\0\1\0\0" + bytes(44), 1)
        with open_run(source) as run:
            ids: dict[str, int] = {}
            for name, one in run.topics.items():
                schema = writer.register_schema(one.topic.type_name, "ros2msg", one.topic.schema.encode())
                ids[name] = writer.register_channel(f"/{namespace}/{run.relative(name)}", "cdr", schema)
            for number, one in enumerate(run.messages(recorded_order=True)):  # log times of another clock
                writer.add_message(ids[one.topic], 10**18 + number, bytes(one.data), one.publish_time, one.sequence)
    writer.finish()
    return path


@pytest.mark.heavy
def test_a_recording_of_everything_is_verified(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = Rig(from_flat(RigConfig(), {"daq.seed": 3}))
    rig.accept(frequency_hz=9.1, amplitude=0.52)
    source = record(tmp_path / "run", everything(rig, 60))
    path = bag_of_everything(tmp_path / "bag.mcap", rig=source)
    with open_run(path) as run:
        found = verify(run)
    assert found.identical, found.reason
    assert {one.topic for one in found.topics if not one.left_out} >= {"truth/impacts", "truth/joint_states"}
    two = bag_of_everything(tmp_path / "two.mcap", left=source, right=source)
    for command in ("verify", "analyze"):
        assert main([command, str(two)]) == 1
        assert "several rigs: /left, /right; choose one with --rig NAMESPACE" in " ".join(
            capsys.readouterr().err.split()
        )
    assert main(["verify", str(two), "--rig", "/right"]) == 0
    assert info(two).rigs == ("/left", "/right")
    assert info(two).scans is not None
    assert info(two).scans.whole


@pytest.mark.heavy
@pytest.mark.parametrize("blocks", [60, 61, 64])
def test_a_recording_over_a_restart_at_zero_is_verified(tmp_path: Path, blocks: int) -> None:
    """The last blocks of the first rig have no joint states; those of the second start at 0 again."""
    rigs = [Rig(from_flat(RigConfig(), {"daq.seed": seed})) for seed in (3, 4)]
    source = record(tmp_path / "run", [one for rig in rigs for one in everything(rig, blocks)])
    with open_run(source) as run:
        found = verify(run)
        joints = len(list(run.messages(["truth/joint_states"])))
    assert found.identical, found.reason
    assert found.scans == 2 * blocks * 100
    (compared,) = [one for one in found.topics if one.topic == "truth/joint_states"]
    assert compared.count == joints


@pytest.mark.heavy
def test_a_recording_that_starts_during_a_session_spans_only_its_own_data(tmp_path: Path) -> None:
    values = {"daq.rate_hz": 200, "daq.block_scans": 20, "sphere.present": False, "daq.seed": 5}
    rig = Rig(from_flat(RigConfig(), values))
    deeds = {5: lambda: rig.accept(frequency_hz=9.0, amplitude=0.5), 2_450: lambda: rig.accept(frequency_hz=9.6)}
    found = analysed(rig, 2_660, deeds)
    begun_ns = 240 * NS_PER_S
    recorded = ("daq/scan", "transmissibility/table")  # not latched, or not part of a recording that starts later
    early = [one for one in found if one[1].stamp_ns < begun_ns and one[0] not in recorded]
    late = [one for one in found if one[1].stamp_ns >= begun_ns]
    directory = record(tmp_path / "run", [*early, *late])
    said = yaml.safe_load((directory / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    with open_run(directory) as run:
        times = [one.log_time for one in run.messages(recorded_order=True)]
        first = next(run.messages([topics.SCAN.name]))
        scans = list(run.tables(topics.SCAN))
        assert next(run.tables(topics.INFO)).stamp_ns == 0, "its stamp is its own"
        found_again = verify(run)
    assert times == sorted(times)
    assert times[0] == scans[0].stamp_ns == begun_ns
    span_s = (scans[-1].stamp_ns - scans[0].stamp_ns) / NS_PER_S
    assert said["duration"]["nanoseconds"] / NS_PER_S == pytest.approx(span_s, abs=1.0)
    assert (first.log_time - times[0]) / NS_PER_S < 1.0
    assert found_again.identical, found_again.reason
    assert agreement(directory).same


def test_a_recording_of_the_third_version_is_still_read() -> None:
    found = info(THIRD_VERSION)
    assert found.verdict.startswith("whole: every checksum fits, 220 blocks of daq/scan without a gap")
    assert found.rig_s == pytest.approx(22.0)
    assert found.log_s == pytest.approx(142.0, abs=1.0), "log times of latched history were its old stamps"
    compared = agreement(THIRD_VERSION)
    assert compared.same is None
    assert "arithmetic version 5" in compared.reason
    with open_run(THIRD_VERSION) as run:
        rows = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))
        live = np.concatenate([table.rows for table in run.tables("transmissibility/table")])
    found, live = (one[one["settled"] == 1] for one in (rows, live))
    assert found["frequency"].tolist() == live["frequency"].tolist() != []
    for name in ("transmissibility", "phase"):
        assert found[name] == pytest.approx(live[name], abs=live["transmissibility_uncertainty"].max())


def test_a_reset_inside_a_block_does_not_count_as_a_gap(tmp_path: Path) -> None:
    """A reset drops the scans that do not fill a block."""
    rig = Rig(from_flat(RigConfig(), {"daq.block_scans": 150, "sphere.present": False}))
    parts: list[Any] = []
    for _ in range(3):
        for block in rig.advance(rig.frontier_ns + 100_000_000):
            parts += [("rig/journal", one) for one in rig.take_journal()]
            parts.append(("daq/scan", block.scan))
        rig.reset()
    parts += [("rig/journal", one) for one in rig.take_journal()]
    for block in rig.advance(rig.frontier_ns + 100_000_000):
        parts.append(("daq/scan", block.scan))
    path = record(tmp_path / "run", parts)
    scans = info(path).scans
    assert scans is not None
    assert scans.whole, scans.gaps
    resets = [number for number, (name, one) in enumerate(parts) if name == "rig/journal"]
    assert len(resets) > 1
    last = max(number for number in range(resets[1]) if parts[number][0] == "daq/scan")
    lost = info(record(tmp_path / "lost", parts[:last] + parts[last + 1 :])).scans
    assert lost is not None
    assert lost.lost_blocks == 1, "a complete block missing before a reset is still reported"


@pytest.mark.heavy
def test_true_impacts_are_not_taken_for_detected_ones(tmp_path: Path) -> None:
    """Below 2 kS/s the analysis detects none, and publishes no `impacts`."""
    rig = Rig(from_flat(RigConfig(), {"daq.rate_hz": 1000, "daq.block_scans": 100, "daq.seed": 2}))
    rig.accept(frequency_hz=9.1, amplitude=0.52)
    found = analysed(rig, 200, {})
    assert sum(name == "truth/impacts" for name, _ in found) > 10
    compared = agreement(record(tmp_path / "run", found))
    assert compared.same, compared.reason
    assert any("impacts: not compared: it is not in this run" in str(one) for one in compared.others)


@pytest.mark.heavy
def test_an_analysis_some_long_blocks_behind_does_not_count_as_ended(tmp_path: Path) -> None:
    values = {"daq.rate_hz": 1000, "daq.block_scans": 500, "sphere.present": False}
    changes = {0: (9.1, 0.52), 30: (9.3, None), 60: (9.5, None), 65: (9.7, None)}
    rig = Rig(from_flat(RigConfig(), values))
    deeds = {n: lambda f=f, a=a: rig.accept(frequency_hz=f, amplitude=a) for n, (f, a) in changes.items()}
    found = analysed(rig, 80, deeds, until=64)
    assert agreement(record(tmp_path / "run", found)).same
    rig = Rig(from_flat(RigConfig(), values))
    ended = agreement(record(tmp_path / "ended", analysed(rig, 80, deeds, until=20)))
    assert "it may have ended before" in ended.reason, "further behind than a rig runs ahead"


def verified_stream(directory: Path, pieces: Iterable[tuple[int, int, bool]], blocks: int) -> Verification:
    """Verify the run of a streamed rig from pieces of the stream: first sample, count, and whether it is recorded."""
    rig = Rig(from_flat(RigConfig(), {"drive.waveform": "stream", "drive.amplitude": 0.0, "sphere.present": False}))
    found: list[Any] = []
    for first, count, is_recorded in pieces:
        rows = np.zeros(count, WAVEFORM)
        rows["value"] = 0.1
        rig.feed(first, rows["value"])
        if is_recorded:
            found.append(("shaker/waveform", Table(stamp_ns(first, rig.rate_hz, 0), rows)))
    for _ in range(blocks):
        for block in rig.advance(rig.block_end_ns(1)):
            found += [("rig/journal", one) for one in rig.take_journal()]
            found.append(("daq/scan", block.scan))
    with open_run(record(directory, found)) as run:
        return verify(run)


def test_missing_samples_that_the_rig_had_not_reached_are_no_difference(tmp_path: Path) -> None:
    checked = verified_stream(tmp_path / "run", [(0, 1600, True), (2000, 1000, True)], 16)  # a gap from 1600 to 2000
    assert checked.identical, checked.reason
    assert checked.scans == 1600


def test_a_missing_sample_that_the_rig_had_used_is_found(tmp_path: Path) -> None:
    """The rig had this sample, so its absence is a difference."""
    checked = verified_stream(tmp_path / "run", [(first, 500, first != 1000) for first in range(0, 3000, 500)], 20)
    assert not checked.identical
    assert "sample 1000" in checked.reason


@pytest.mark.heavy
def test_messages_of_other_types_keep_their_stamps(tmp_path: Path) -> None:
    found = messages(2)
    with open_run(record(tmp_path / "run", found)) as run:
        wanted = [table.stamp_ns for topic, table in found if topic == "shaker/applied"]
        assert [table.stamp_ns for table in run.tables("shaker/applied")] == wanted
        assert list(recorded_journal.of_run(run)) == [entry for topic, entry in found if topic == "rig/journal"]
        assert codec.header_stamp_ns(next(run.messages(["daq/info"])).data) == 0


@pytest.mark.heavy
def test_a_verdict_lists_unchecked_topics_and_includes_unindexed_messages(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = Rig(from_flat(RigConfig(), {"daq.rate_hz": 1000, "daq.block_scans": 50, "sphere.present": False}))
    directory = record(tmp_path / "run", everything(rig, 20))
    assert main(["verify", str(directory)]) == 0
    assert "not checked: metadata.yaml" in " ".join(capsys.readouterr().out.split())
    bag = bag_of_everything(tmp_path / "bag.mcap", rig=directory)
    assert main(["verify", str(bag)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for kind in ("commands", "frame ids", "publish times", "attachments other than config.yaml", "schemas"):
        assert kind in said.partition("not checked: ")[2], "another recorder writes no digests"
    (path,) = directory.glob("*.mcap")
    data = bytearray(path.read_bytes())
    with open_run(directory) as run:
        source = run.sources[0]
        number = next(one for one, topic in source.topics.items() if topic.name == "/rig/truth/joint_states")
        (chunk, *_) = (one.chunk for one in source.segments if one.chunk and number in one.chunk.message_index_offsets)
    start = int.from_bytes(data[-28:-20], "little")
    place = data.index(chunk.chunk_start_offset.to_bytes(8, "little"), start) + 16 + 4  # behind offset, length, count
    entry = number.to_bytes(2, "little") + chunk.message_index_offsets[number].to_bytes(8, "little")
    at = data.index(entry, place)
    data[at : at + 2] = (0xFFFF).to_bytes(2, "little")
    data[-12:-8] = bytes(4)  # no checksum of the summary
    path.write_bytes(data)
    for command in ("verify", "info"):
        assert main([command, str(directory)]) == 1
        assert "does not match its messages of /rig/truth/joint_states" in " ".join(capsys.readouterr().out.split())
