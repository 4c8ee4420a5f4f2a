# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Locks that one process holds at a time."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from impact_rig.system import files

HOLDER = """
import sys
from impact_rig.system import files
print(files.hold("places", "7.cell") is not None, flush=True)
sys.stdin.readline()
"""


@pytest.fixture(autouse=True)
def _own_directory(tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)


def test_a_lock_is_held_by_one_until_it_is_closed() -> None:
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


def test_a_lock_is_free_as_soon_as_its_holder_is_killed() -> None:
    holder = subprocess.Popen([sys.executable, "-c", HOLDER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    with holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "True\n"
        assert files.hold("places", "7.cell") is None
        holder.kill()
        holder.wait()
    again = files.hold("places", "7.cell")
    assert again is not None
    os.close(again)


def test_a_link_that_somebody_laid_out_is_not_followed(tmp_path) -> None:
    (tmp_path / "places").mkdir()
    (tmp_path / "places" / "7.cell.lock").symlink_to(tmp_path / "mine")
    with pytest.raises(OSError, match=r"7\.cell\.lock"):
        files.hold("places", "7.cell")
    assert not files.can_hold("places", "7.cell")
    assert files.can_hold("places", "8.cell")
    assert not (tmp_path / "mine").exists()
