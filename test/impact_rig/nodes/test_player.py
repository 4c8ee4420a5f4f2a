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
"""A player and the peers that acknowledge its blocks: in every round, and after a suspension."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from impact_rig import codec
from impact_rig.client import Client, Collector
from impact_rig.errors import ImpactRigError
from impact_rig.nodes import player
from impact_rig.nodes.player import WINDOW, Player
from impact_rig.recording import Run, TopicDescription
from impact_rig.testing import LocalRig

pytestmark = pytest.mark.ros
BLOCKS = 3 * WINDOW


@pytest.fixture
def run(tmp_path: Path) -> Path:
    rig = LocalRig({"sphere.present": False})
    rig.step(BLOCKS)
    return rig.save(tmp_path / "run")


def follow(client: Client, run: Run) -> tuple[Player, Collector]:
    """Return a player as fast as this client acknowledges, in the client's node."""
    playing = Player(run, client.node, client.executor.spin_once, factor=None, peers=[client.name])
    return playing, client.collect("daq/scan", acknowledge=True)


def test_a_run_is_replayed_repeatedly_at_the_pace_of_acknowledgements(
    client: Client, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the second round stamps start again, so the window must not contain those of the first round."""
    monkeypatch.setattr(player, "PEER_TIMEOUT_S", 1.0)
    with Run(run) as opened:
        playing, scans = follow(client, opened)
        for played in (1, 2):
            for _ in playing.play():
                pass
            client.wait_until(lambda played=played: len(scans) == played * BLOCKS, "every block")


def test_a_paused_player_sends_the_calibration_but_no_scan(client: Client, run: Path) -> None:
    """Settings of a user before the replay continues, such as a gap label, then act from the first scan on."""
    with Run(run) as opened:
        playing, scans = follow(client, opened)
        calibration = client.collect("daq/info")
        playing.paused = True
        rounds = playing.play()
        client.wait_until(lambda: next(rounds) is not None and len(calibration), "the calibration")
        for _ in range(10):
            next(rounds)
        assert not len(scans)
        playing.paused = False
        for _ in rounds:
            pass
        client.wait_until(lambda: len(scans) == BLOCKS, "every block")


def test_a_callback_does_not_end_the_wait_for_subscribers(client: Client, run: Path) -> None:
    """A single callback in that time, such as a call of a service, must not start the playback early."""
    with Run(run) as opened:
        playing, _ = follow(client, opened)
        calls: list[float] = []
        client.node.create_timer(0.01, lambda: calls.append(time.monotonic()))
        begin = time.monotonic()
        playing.spin_for(0.5)
        assert time.monotonic() - begin >= 0.5
        assert len(calls) > 1


@pytest.mark.parametrize("name", ["X", "/msg/X", ".a/msg/X", "no_such_package/msg/X", "std_msgs/msg/X"])
def test_a_run_with_a_message_type_that_is_not_installed_is_rejected(client: Client, tmp_path: Path, name: str) -> None:
    rig = LocalRig({"sphere.present": False})
    rig.step()
    with rig._new_recording(tmp_path / "run", rig._kept, "") as recording:
        recording.add_topic(TopicDescription(name="/other", type_name=name, schema="float64 data"))
        recording.write("/daq/scan", codec.encode(rig.tables()[0]), 0)
        recording.write("/other", b"\0\1\0\0", 0)
    with (
        Run(tmp_path / "run") as opened,
        pytest.raises(ImpactRigError, match=f"/other: the message type {name!r} is not installed"),
    ):
        Player(opened, client.node, client.executor.spin_once)


def test_a_player_that_was_suspended_blames_no_peer(client: Client, run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Acknowledgements sent while this process was suspended are still read, and the replay continues."""
    monkeypatch.setattr(player, "PEER_TIMEOUT_S", 0.5)
    monkeypatch.setattr(player, "AWAY_S", 0.3)
    with Run(run) as opened:
        playing, scans = follow(client, opened)
        away = 0
        for _ in playing.play():
            if playing._window.outstanding() and not away:
                time.sleep(0.7)
                away += 1
        assert away
        client.wait_until(lambda: len(scans) == BLOCKS, "every block")
