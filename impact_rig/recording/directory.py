# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The directory of a run, before anything is written to it."""

from __future__ import annotations

from pathlib import Path

from impact_rig.errors import RecordingError
from impact_rig.recording import bag_metadata
from impact_rig.system import files


def make_room(directory: Path) -> None:
    """Make the directory of a run, with its parents, unless it is there.

    Raises:
        RecordingError: it cannot be made, is not ours, or holds a recording already: nothing is ever overwritten.
    """
    try:
        directory.mkdir(parents=True, exist_ok=True)
        files.refuse_foreign(directory)
        present = sorted(path.name for path in directory.iterdir())
    except FileExistsError as error:
        raise RecordingError(f"{directory} is a file, not a directory to record into") from error
    except OSError as error:
        raise RecordingError(f"the run directory {directory} cannot be made: {error.strerror}") from error
    for name in present:
        if name.endswith((".mcap", ".mcap.tail")) or name == bag_metadata.FILE_NAME:
            raise RecordingError(f"{directory} holds a recording already ({name}); nothing is overwritten")
