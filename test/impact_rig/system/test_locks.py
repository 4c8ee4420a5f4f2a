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
"""Locks that only one process can hold at a time."""

from __future__ import annotations

import contextlib
import os
import socket
import subprocess
import sys

import pytest

from impact_rig.client import processes
from impact_rig.errors import ImpactRigError
from impact_rig.system import files

HOLDER = """
import sys
from pathlib import Path
from impact_rig.system import files
files.LOCK_PARENTS = (Path(sys.argv[1]),)
print(files.hold("places", "7.cell") is not None, flush=True)
sys.stdin.readline()
"""

STRANGER = """
import fcntl, os, sys
fcntl.flock(os.open(sys.argv[1], os.O_RDONLY), fcntl.LOCK_EX)
print("held", flush=True)
sys.stdin.readline()
"""


@pytest.fixture(autouse=True)
def _own_directory(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(files, "LOCK_PARENTS", (tmp_path,))


def test_a_lock_has_one_holder_until_it_is_closed() -> None:
    first = files.hold("places", "7.cell")
    assert first is not None
    assert files.hold("places", "7.cell") is None
    other = files.hold("places", "8.cell")
    assert other is not None
    os.close(other)
    os.close(first)
    again = files.hold("places", "7.cell")
    assert again is not None
    os.close(again)


def test_a_lock_is_free_as_soon_as_its_holder_is_killed(tmp_path) -> None:
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    holder = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "True\n"
        assert files.hold("places", "7.cell") is None
        holder.kill()
        holder.wait()
    again = files.hold("places", "7.cell")
    assert again is not None
    os.close(again)


def test_a_lock_of_another_program_does_not_count() -> None:
    """A lock that `flock FILE` of another program holds must not stop a rig from starting."""
    os.close(files.hold("places", "7.cell") or 0)
    path = files.lock_directory() / "places" / "7.cell.lock"
    command = [sys.executable, "-c", STRANGER, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout is not None
        assert other.stdout.readline() == "held\n"
        assert files.hold("places", "7.cell") is None
        assert files.is_held_by_others("places", "7.cell")
        other.kill()
    held = files.hold("places", "7.cell")
    assert held is not None
    assert not files.is_held_by_others("places", "7.cell")
    os.close(held)


def test_a_planted_link_is_not_followed(tmp_path) -> None:
    places = files.lock_directory() / "places"
    places.mkdir()
    (places / "7.cell.lock").symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match=r"7\.cell\.lock"):
        files.hold("places", "7.cell")
    assert not files.can_hold("places", "7.cell")
    assert files.can_hold("places", "8.cell")
    assert not (tmp_path / "mine").exists()


def test_environment_variables_do_not_move_the_locks(monkeypatch) -> None:
    before = files.lock_directory()
    for name in ("TMPDIR", "HOME", "XDG_RUNTIME_DIR"):
        monkeypatch.setenv(name, "/nowhere")
    monkeypatch.setattr("tempfile.tempdir", None)
    assert files.lock_directory() == before
    assert before.stat().st_mode & 0o077 == 0


def test_a_directory_that_another_user_could_change_is_skipped(tmp_path, monkeypatch) -> None:
    """If an open directory or a link has the name, the next candidate is used, or the error names the cause."""
    name = files.lock_directory().name
    parents = [tmp_path / parent for parent in ("open", "link", "absent", "good")]
    for parent in parents:
        if parent.name != "absent":
            parent.mkdir()
    (parents[0] / name).mkdir(mode=0o777)
    (parents[0] / name).chmod(0o777)
    (parents[1] / name).symlink_to(tmp_path)
    monkeypatch.setattr(files, "LOCK_PARENTS", tuple(parents))
    assert files.lock_directory().parent == parents[3]
    monkeypatch.setattr(files, "LOCK_PARENTS", tuple(parents[:1]))
    with pytest.raises(PermissionError, match="other users may open it: delete it, or set its mode to 700"):
        files.lock_directory()


def test_a_domain_that_a_process_uses_is_skipped(monkeypatch) -> None:
    taken = processes.FIRST_DOMAIN
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as participant:
        with contextlib.suppress(OSError):  # a real participant has it
            participant.bind(("127.0.0.1", processes.FIRST_PORT + processes.PORTS_PER_DOMAIN * taken + 10))
        monkeypatch.setattr(processes, "LAST_DOMAIN", taken)
        assert processes.is_in_use(taken)
        with pytest.raises(ImpactRigError, match="used by a running program"), processes.isolated_domain():
            pass
