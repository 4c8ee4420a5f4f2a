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
"""Incomplete shared memory of a killed process, which must not stop another process."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import pytest

from impact_rig.system import segments


def word(path: Path) -> int:
    return int(struct.unpack("<I", path.read_bytes()[:4])[0])


@pytest.mark.parametrize("library", ["fastrtps", "fastdds"])
def test_only_a_segment_unfinished_at_two_checks_is_marked(tmp_path: Path, library: str) -> None:
    contents = {
        "port1": b"",
        "port2": bytes(64),
        "port3": struct.pack("<I", 1),
        "port4": struct.pack("<I", 2) + bytes(60),
    }
    for name, content in contents.items():
        (tmp_path / f"{library}_{name}").write_bytes(content)
    others = [f"{library}_port1_el", f"sem.{library}_port1_mutex", f"{library}_0a1b", "another"]
    for name in others:
        (tmp_path / name).touch()
    (tmp_path / f"{library}_port5").symlink_to(tmp_path / "another")
    before = segments.invalidate_abandoned_segments(tmp_path, set())
    assert {name for name, _ in before} == {f"{library}_port1", f"{library}_port2", f"{library}_port3"}
    assert (tmp_path / f"{library}_port1").stat().st_size == 0, "it may be being made"
    (tmp_path / f"{library}_port2").write_bytes(contents["port4"])  # it was
    (tmp_path / "new").write_bytes(b"")
    Path(tmp_path / "new").replace(tmp_path / f"{library}_port3")  # another one
    segments.invalidate_abandoned_segments(tmp_path, before)
    assert word(tmp_path / f"{library}_port1") == 3
    assert (tmp_path / f"{library}_port1").stat().st_size > 4
    assert word(tmp_path / f"{library}_port2") == word(tmp_path / f"{library}_port4") == 2
    assert [(tmp_path / name).stat().st_size for name in (f"{library}_port3", *others)] == [0] * 5


def test_the_watch_ends_with_its_context(tmp_path: Path) -> None:
    (tmp_path / "fastrtps_port7").touch()
    with segments.Watch(tmp_path, 0.01):
        deadline = time.monotonic() + 60
        while not (tmp_path / "fastrtps_port7").stat().st_size and time.monotonic() < deadline:
            time.sleep(0.01)
    assert word(tmp_path / "fastrtps_port7") == 3
    with segments.Watch(tmp_path / "nowhere", 0.01):
        time.sleep(0.05)


@pytest.mark.ros
@pytest.mark.pipeline
def test_a_rig_starts_on_the_ports_of_a_process_killed_during_its_start(tmp_path: Path) -> None:
    """Leave the ports of the first participants of a domain as a killed process does, with no older process."""
    pytest.importorskip("rclpy")
    from impact_rig.client import Client, Processes, isolated_domain

    with isolated_domain() as domain:
        numbers = [7400 + 250 * domain + 11 + 2 * number for number in range(3)]
        left = [segments.SHARED / f"{name}{number}" for name in segments.PORTS for number in numbers]
        for path in left:
            path.touch()
        try:
            with Processes(domain, tmp_path) as processes:
                processes.start("rig")
                with Client(domain, processes=processes) as client:
                    client.wait_active("rig")
            assert not any(path.exists() and not path.stat().st_size for path in left)
        finally:
            for path in left:
                path.unlink(missing_ok=True)
