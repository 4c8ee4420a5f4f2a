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
"""Files in directories that others may write to: links of other users are not followed, waited for or overwritten."""

from __future__ import annotations

import contextlib
import os
import re
import signal
import stat
import subprocess
import sys
from pathlib import Path
from typing import BinaryIO

import pytest

from impact_rig.errors import RecordingError
from impact_rig.system import files

MINE, THEIRS = b"whole\n", b"not to be touched\n"


@pytest.fixture
def victim(tmp_path: Path) -> Path:
    path = tmp_path / "victim"
    path.write_bytes(THEIRS)
    return path


def test_a_file_exists_completely_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "out.txt"

    def fail_half_way() -> None:
        with files.atomic_write(path) as file:
            file.write(MINE)
            assert not path.exists()
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert list(tmp_path.iterdir()) == []
    with files.atomic_write(path) as file:
        file.write(MINE)
    assert path.read_bytes() == MINE
    assert list(tmp_path.iterdir()) == [path]


def test_a_new_file_has_ordinary_permissions(tmp_path: Path) -> None:
    (tmp_path / "other").write_text("")
    files.write_text(tmp_path / "mine", "")
    assert stat.S_IMODE((tmp_path / "mine").stat().st_mode) == stat.S_IMODE((tmp_path / "other").stat().st_mode)


def partial_of(file: BinaryIO) -> Path:
    return Path(f"/proc/self/fd/{file.fileno()}").readlink()


@pytest.mark.parametrize("what", ["link", "directory", "being written"])
def test_a_file_of_another_user_under_the_temporary_name_is_not_touched(
    tmp_path: Path, victim: Path, what: str
) -> None:
    usual = tmp_path / ".out.partial"
    with contextlib.ExitStack() as stack:
        if what == "link":
            usual.symlink_to(victim)
        elif what == "directory":
            usual.mkdir()
        else:
            first = stack.enter_context(files.atomic_write(tmp_path / "out"))
            assert partial_of(first) == usual
        with files.atomic_write(tmp_path / "out") as file:
            assert re.fullmatch(r"\.out\.[0-9a-f]{16}\.partial", partial_of(file).name)
            file.write(MINE)
        assert usual.exists()
        assert (tmp_path / "out").read_bytes() == MINE
        if what == "link":
            assert usual.is_symlink()
    assert victim.read_bytes() == THEIRS


def test_leftovers_of_a_killed_process_are_removed_when_the_file_is_rewritten(tmp_path: Path) -> None:
    program = """
import os, signal, sys
from pathlib import Path
from impact_rig.system import files
with files.atomic_write(Path(sys.argv[1])) as file:
    file.write(b"half")
    file.flush()
    os.kill(os.getpid(), signal.SIGKILL)
"""
    path = tmp_path / "out"
    done = subprocess.run([sys.executable, "-c", program, path], check=False)
    assert done.returncode == -signal.SIGKILL
    assert [left.read_bytes() for left in tmp_path.iterdir()] == [b"half"]
    files.write_text(path, MINE.decode())
    assert list(tmp_path.iterdir()) == [path]
    assert path.read_bytes() == MINE


def test_a_link_at_the_path_is_replaced_and_not_followed(tmp_path: Path, victim: Path) -> None:
    (tmp_path / "out").symlink_to(victim)
    files.write_text(tmp_path / "out", MINE.decode())
    assert victim.read_bytes() == THEIRS
    assert not (tmp_path / "out").is_symlink()
    assert (tmp_path / "out").read_bytes() == MINE


@pytest.mark.parametrize("what", ["file", "link", "link to nowhere"])
def test_a_file_that_must_be_kept_is_not_overwritten(tmp_path: Path, victim: Path, what: str) -> None:
    path = tmp_path / "out"
    if what == "file":
        path.write_bytes(THEIRS)
    else:
        path.symlink_to(victim if what == "link" else tmp_path / "nowhere")

    def write() -> None:
        with files.atomic_write(path, replace=False) as file:
            file.write(MINE)

    with pytest.raises(FileExistsError):
        write()
    assert victim.read_bytes() == THEIRS
    assert not (tmp_path / "nowhere").exists()
    assert not list(tmp_path.glob(".*"))


def test_a_file_that_must_be_kept_is_not_overwritten_without_hard_links(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This is as on FAT. There is no such file system to test on, so the system call that FAT lacks is removed."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "link", refuse)
    path = tmp_path / "out"
    with files.atomic_write(path, replace=False) as file:
        file.write(MINE)
    assert path.read_bytes() == MINE
    with pytest.raises(FileExistsError), files.atomic_write(path, replace=False):
        pass
    assert path.read_bytes() == MINE


def test_only_regular_files_are_opened_without_waiting_for_a_fifo(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "device").symlink_to("/dev/zero")
    for name in ("fifo", "device"):
        with pytest.raises(OSError, match="not a regular file"):
            files.read_bytes(tmp_path / name, 100)
    with pytest.raises(IsADirectoryError):
        files.read_bytes(tmp_path, 100)


def test_a_file_that_is_too_large_is_not_read(tmp_path: Path) -> None:
    path = tmp_path / "large"
    with path.open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(OSError, match="larger than 100 bytes"):
        files.read_bytes(path, 100)
    path.write_bytes(bytes(100))
    assert len(files.read_bytes(path, 100)) == 100


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a directory away")
def test_a_directory_of_another_user_is_rejected(tmp_path: Path) -> None:
    files.refuse_foreign(tmp_path)
    directory = tmp_path / "theirs"
    directory.mkdir()
    os.chown(directory, 4321, -1)
    with pytest.raises(PermissionError, match="another user"):
        files.refuse_foreign(directory)
    link = tmp_path / "link"
    link.symlink_to(tmp_path)
    os.chown(link, 4321, -1, follow_symlinks=False)
    with pytest.raises(PermissionError, match="another user"):
        files.refuse_foreign(link)


def test_system_errors_become_messages_and_errors_of_the_package_keep_theirs(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"^there: No such file or directory$"), files.translate_errors("there"):
        (tmp_path / "nothing").read_bytes()
    with pytest.raises(RecordingError, match=r"^no room$"), files.translate_errors("there"):
        raise RecordingError("no room")


def test_state_is_stored_in_the_folder_of_the_user_or_a_temporary_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    assert files.state_dir("logs") == tmp_path / "state" / "impact_rig" / "logs"
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    found = files.state_dir("logs")
    assert found.parent == tmp_path
    assert found.is_dir()


@pytest.mark.parametrize("initial", [[], ["plan"]])
def test_a_failed_attempt_leaves_no_directory_unless_it_has_results(tmp_path: Path, initial: list[str]) -> None:
    directory = tmp_path / "results"

    def prepare() -> None:
        directory.mkdir(exist_ok=True)
        for name in initial:
            (directory / name).touch()

    for results in ([], ["result"]):
        with pytest.raises(FileNotFoundError), files.results_in(directory, prepare):
            _ = [(directory / name).touch() for name in results], (tmp_path / "missing").stat()
        assert sorted(path.name for path in directory.glob("*")) == initial * bool(results) + results


def test_a_number_is_appended_to_an_existing_path(tmp_path: Path) -> None:
    """Two commands without --output that start within one second must not use one folder."""
    taken = []
    for _ in range(3):
        taken.append(files.free_path(tmp_path / "hold_20261128_034830"))
        taken[-1].mkdir()
    assert [one.name.removeprefix("hold_20261128_034830") for one in taken] == ["", "_2", "_3"]
