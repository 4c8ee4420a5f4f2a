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
"""`impact-rig recover`: what was recovered and what is missing, and a run that states its origin."""

from __future__ import annotations

import pytest
from kits.recording import SCAN_TOPIC, fill, foreign_file, scan_block

from impact_rig.cli import main
from impact_rig.cli.recorded import INCOMPLETE
from impact_rig.recording import open_run
from impact_rig.runs import info, recover

BLOCK_S = 0.01


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")


def printed(capsys):
    return " ".join(capsys.readouterr().out.split())


def test_a_truncated_file_is_reported_with_its_own_exit_code(record, tmp_path, capsys):
    with record(chunk_bytes=20_000) as writer:
        fill(writer, 40)
    path = writer.files[0]
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    assert main(["recover", str(writer.directory), str(tmp_path / "out")]) == INCOMPLETE
    with open_run(tmp_path / "out") as run:
        back = run.message_count
    text = printed(capsys)
    assert "RecoverReport(" not in text
    assert f"{back} messages saved; an unknown number of messages" in text
    assert "the file ends inside this record" in text
    found = info(tmp_path / "out")
    assert found.recovered.source == "run"
    assert found.recovered.unfinished
    assert not found.intact
    assert found.verdict.startswith("recovered: every checksum fits, but an unknown number of messages")
    assert main(["info", str(tmp_path / "out")]) == 1
    assert "recovered from the damaged run run" in printed(capsys)


def test_messages_seconds_and_bytes_are_reported_per_file(record, tmp_path):
    """A damaged chunk in the middle of the second file: the first is complete, the second lacks what the chunk held."""
    with record(max_file_duration_ns=190_000_000, chunk_bytes=20_000) as writer:
        sent = fill(writer, 40)
    first, second = writer.files
    with open_run(second) as part:
        index = part.sources[0].summary.chunk_indexes[1]
        inside = [m for m in part.messages() if index.message_start_time <= m.log_time <= index.message_end_time]
    data = bytearray(second.read_bytes())
    data[index.chunk_start_offset + index.chunk_length - 3] ^= 0xFF
    second.write_bytes(data)
    report = recover(writer.directory, tmp_path / "out")
    whole, damaged = report.files
    assert (whole.name, whole.missing_messages, whole.missing_s, whole.lost_bytes) == (first.name, 0, 0.0, 0)
    assert damaged.name == second.name
    assert damaged.missing_messages == report.missing_messages == len(sent) - report.messages
    lost_blocks = sum(message.topic == SCAN_TOPIC.name for message in inside)
    assert lost_blocks > 0
    assert damaged.missing_s == pytest.approx(lost_blocks * BLOCK_S)
    assert damaged.lost_bytes == index.chunk_length
    assert not report.complete


def test_an_intact_run_is_recovered_with_exit_code_zero_and_marked(record, tmp_path, capsys):
    with record() as writer:
        sent = fill(writer, 10)
    assert main(["recover", str(writer.directory), str(tmp_path / "out")]) == 0
    assert f"all {len(sent)} messages are saved" in printed(capsys)
    found = info(tmp_path / "out")
    assert found.intact
    assert found.recovered is not None
    assert "whole" not in found.verdict


def test_chunks_without_checksum_need_an_option(tmp_path, capsys):
    path = tmp_path / "bag.mcap"
    foreign_file(path, crc=False)
    assert main(["recover", str(path), str(tmp_path / "refused")]) == 1
    assert "a chunk carries no checksum" in " ".join(capsys.readouterr().err.split())
    main(["recover", str(path), str(tmp_path / "out"), "--accept-unchecked"])
    with open_run(tmp_path / "out") as run:
        assert [bytes(message.data) for message in run.messages()] == [scan_block(number) for number in range(3)]


def test_messages_that_the_recorder_missed_stay_listed(record, tmp_path):
    with record() as writer:
        fill(writer, 5)
        writer.write(SCAN_TOPIC.name, scan_block(5), 0, 9)
    recover(writer.directory, tmp_path / "out")
    assert info(tmp_path / "out").lost == info(writer.directory).lost == {SCAN_TOPIC.name: 3}
