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
"""Recordings that try to fill the memory, to run forever, to control the terminal or to write to other places.

`qualification/hostile.py` makes them and measures what each command needs. Here, the commands that read everything get
every recording, and the other commands some of them.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from impact_rig.cli.recorded import INCOMPLETE
from impact_rig.errors import ImpactRigError
from impact_rig.recording import open_run
from impact_rig.recording.description import TopicDescription, starts_with_header
from impact_rig.recording.reader import parse_summary
from impact_rig.recording.records import DamageError
from impact_rig.runs import export, info, recover
from impact_rig.system import budget
from impact_rig.system.budget import BudgetError

TOOL: dict[str, Any] = runpy.run_path(str(Path(__file__).parents[3] / "qualification" / "hostile.py"))
RECORDINGS: dict[str, Callable[[Path], Path]] = TOOL["RECORDINGS"]
REFUSED = {
    "compression bomb, indexed 60 times": "twice, or beginning inside another",
    "chunk of 2 GB": "2000000031 bytes in a chunk, more than 33554432; .* IMPACT_RIG_BUDGET=N",
    "7.7 million empty messages": "bytes in a chunk, more than 33554432; .* IMPACT_RIG_BUDGET=N",
    "one chunk indexed 20,000 times": "twice, or beginning inside another",
    "60,000 topics": "60000 topics, more than 5000; .* IMPACT_RIG_BUDGET=N",
    "FIFO": "not a regular file",
    "link to /dev/zero": "not a regular file",
    "9 MB metadata.yaml": "bytes in .*metadata.yaml, more than 524288; .* IMPACT_RIG_BUDGET=N",
}


@pytest.fixture(scope="module")
def programs() -> Iterator[Any]:
    with TOOL["Programs"]() as found:
        yield found


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (command, what)
        for command in ("info", "recover", "export")
        for what in RECORDINGS
        if command != "export" or what not in REFUSED  # it opens them as `info` does, and takes three times as long
    ],
)
def test_a_hostile_recording_costs_little_and_is_rejected_in_one_line(
    programs: Any, tmp_path: Path, command: str, what: str
) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(TOOL["VICTIM"])
    path = RECORDINGS[what](tmp_path)
    cost = programs.cost(TOOL["words"](command, path, tmp_path), tmp_path)
    kept = command == "recover" and what == "9 MB metadata.yaml"  # metadata.yaml is not needed there
    expected = 1 if what in REFUSED else 0
    assert cost.faults(INCOMPLETE if kept else expected) == [], cost.output
    assert cost.peak_mb <= TOOL["MEMORY_LIMIT_MB"]
    assert cost.cpu_s <= TOOL["TIME_LIMIT_S"]
    assert victim.read_bytes() == TOOL["VICTIM"]


@pytest.mark.ros
@pytest.mark.parametrize("command", ["replay", "verify", "analyze"])
def test_every_command_handles_a_recording_with_false_times_and_names(
    programs: Any, tmp_path: Path, command: str
) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    for what in ("log time 2⁶⁴ − 1", "invalid topic name", "aliases in a QoS text", "FIFO"):
        cost = programs.cost(TOOL["words"](command, RECORDINGS[what](tmp_path), tmp_path), tmp_path)
        expected = 0 if command == "replay" and what == "aliases in a QoS text" else 1
        assert cost.faults(expected) == [], (what, cost.output)
        assert cost.peak_mb <= TOOL["MEMORY_LIMIT_MB"]


@pytest.mark.heavy
@pytest.mark.parametrize("what", REFUSED)
def test_a_rejection_names_the_limit_and_how_to_raise_it(tmp_path: Path, what: str) -> None:
    path = RECORDINGS[what](tmp_path)
    with pytest.raises(ImpactRigError, match=REFUSED[what]):
        open_run(path)


def test_the_user_can_raise_the_budget(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    size = budget.CHUNK_BYTES + 1000
    path = TOOL["recording"](tmp_path / "large.mcap", TOOL["zeros"](size), count=1)
    with pytest.raises(BudgetError, match="bytes in a chunk"):
        info(path)
    monkeypatch.setenv(budget.VARIABLE, "2")
    with open_run(path) as run:
        assert [len(message.data) for message in run.messages()] == [size]
    monkeypatch.setenv(budget.VARIABLE, "plenty")
    with pytest.raises(BudgetError, match="must be a number >= 1, got 'plenty'"), open_run(path) as run:
        list(run.messages())


def test_small_messages_are_counted_before_they_are_decoded(tmp_path: Path) -> None:
    """A chunk within the limit of bytes can still contain a million messages."""
    most = budget.HELD_BYTES // budget.MESSAGE_BYTES
    path = TOOL["recording"](tmp_path / "many.mcap", [TOOL["message"](0, b"") * (most + 1)], count=3)
    with open_run(path) as run, pytest.raises(BudgetError, match=f"{most + 1} records in a chunk, more than {most}"):
        list(run.messages())
    with pytest.raises(ImpactRigError, match="records in a chunk"):
        recover(path, tmp_path / "out")


def test_an_index_with_a_wrong_chunk_size_counts_as_damage(tmp_path: Path) -> None:
    path = TOOL["recording"](tmp_path / "liar.mcap", TOOL["scans"]())
    data = bytearray(path.read_bytes())
    with open_run(path) as run:
        size = run.sources[0].summary.chunk_indexes[0].uncompressed_size
    at = data.rindex(size.to_bytes(8, "little"))
    data[at : at + 8] = (size - 1).to_bytes(8, "little")
    path.write_bytes(data)
    with (
        open_run(path) as run,
        pytest.raises(DamageError, match=r"it states a decompressed size of \d+ bytes, the index \d+ bytes"),
    ):
        list(run.messages())


def test_a_chunk_that_ends_within_a_record_is_damage_with_path_and_remedy(tmp_path: Path) -> None:
    path = TOOL["recording"](tmp_path / "cut.mcap", [TOOL["message"](0, b"") + b"\x05\x00"])
    words = r"cut\.mcap: no complete record at byte \d+ of a chunk; impact-rig recover saves"
    with open_run(path) as run, pytest.raises(DamageError, match=words):
        list(run.messages())


def test_a_damaged_record_of_the_index_is_reported_as_one() -> None:
    with pytest.raises(DamageError, match="its index is damaged: no complete record at byte 0 of a chunk or index"):
        parse_summary(memoryview(b"\x0b\x01"))


def test_quality_of_service_is_read_by_field_without_expanding_aliases() -> None:
    def profiles(text: str) -> list[Any]:
        return TopicDescription(name="/a", type_name="b/msg/C", schema="", offered_qos_text=text).offered_qos_yaml()

    assert profiles("- {durability: transient_local, depth: 3, deadline: {sec: 1, nsec: 2, x: 3}, extra: [1, 2]}") == [
        {"depth": 3, "durability": "transient_local", "deadline": {"sec": 1, "nsec": 2}}
    ]
    for text in (TOOL["LAUGHS"], "&a [*a]", "- &a {depth: *a}", "[" * 10_000, "{depth: 3}", "- 3", "-" * 10**6):
        assert profiles(text) == []


def test_a_schema_of_blank_lines_is_read_in_linear_time() -> None:
    """A search that starts again from every line would need hours for this schema."""
    assert not starts_with_header("package/msg/Type", "\n" * 2_000_000)
    assert starts_with_header("package/msg/Type", "\n" * 1000 + "  std_msgs/Header header\n")


def test_an_export_never_follows_a_link(tmp_path: Path) -> None:
    path = TOOL["recording"](tmp_path / "run.mcap", TOOL["scans"]())
    target = tmp_path / "scan.csv"
    target.symlink_to(tmp_path / "nowhere")
    with open_run(path) as run, pytest.raises(ImpactRigError, match="exists already and is not overwritten"):
        export(run, "daq/scan", target)
    assert not (tmp_path / "nowhere").exists()
