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
"""Some of the recordings and edits that `qualification/sound_recordings.py` makes."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from qualification import sound_recordings

pytestmark = pytest.mark.ros
KINDS = {kind.name: kind for kind in sound_recordings.kinds()}
KILLED = next(name for name in KINDS if name.startswith("53 "))
FEW = [name for name in KINDS if name.startswith(("01 ", "06 ", "08 ", "57 "))]


@pytest.mark.parametrize(("name", "seed"), [*((name, 3) for name in FEW), (FEW[-1], 557), (KILLED, 1053)])
def test_a_valid_recording_is_accepted(tmp_path: Path, name: str, seed: int) -> None:
    """The last two: samples of a stream recorded after a reset that they precede; an entry lost by a kill."""
    for recording in sound_recordings.recordings(KINDS[name], seed, tmp_path):
        assert not sound_recordings.problems(recording, KINDS[name])


def test_every_edit_is_found(tmp_path: Path) -> None:
    ((path, _),) = sound_recordings.recordings(KINDS[FEW[0]], 4, tmp_path)
    made = dict(sound_recordings.missed(path, 40, 5, tmp_path))
    assert len(made) > 30
    assert not [f"{name}: {miss}" for name, miss in made.items() if miss]


def test_sixty_kinds_of_recordings_are_generated() -> None:
    assert len(KINDS) == 60
