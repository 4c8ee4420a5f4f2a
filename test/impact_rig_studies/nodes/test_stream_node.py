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
"""A controller over topics: the same bits as in process; a slow, hostile or missing controller is reported by name."""

from __future__ import annotations

import contextlib
import functools
import math
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from kits.rig import paper_rig
from numpy.typing import NDArray
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from impact_rig import codec, topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.client import Client, Collector, ProcessDiedError, ServiceFailedError
from impact_rig.client.client import ros_parameters
from impact_rig.driver import Acquisition, Hardware, LocalRig, RosRig
from impact_rig.errors import CommandError
from impact_rig.nodes import session
from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.nodes.rig_node import RigNode
from impact_rig.physics.stream import StreamState
from impact_rig.recording import Run
from impact_rig.rig import Rig
from impact_rig.rig.journal import InputKind
from impact_rig.runs.verification import verify
from impact_rig.simtime import NS_PER_S
from impact_rig.states import RigWord

pytestmark = pytest.mark.ros
RATE_HZ = 10_000
STREAM = {"drive__waveform": "stream", "barriers__gap_m": 0.002}
FLAT = {name.replace("__", "."): value for name, value in STREAM.items()}
WAVE = 0.6 * np.sin(2.0 * np.pi * 9.1 * np.arange(RATE_HZ) / RATE_HZ)


def block(first: int, values: NDArray[np.float64], start_ns: int = 0) -> bytes:
    rows = np.zeros(len(values), WAVEFORM)
    rows["value"] = values
    return codec.encode(Table(start_ns + first * NS_PER_S // RATE_HZ, rows))


def send(client: Client, first: int, values: NDArray[np.float64], start_ns: int = 0) -> None:
    client.publish(topics.WAVEFORM, block(first, values, start_ns), listener="rig")


@contextlib.contextmanager
def paused(client: Client) -> Iterator[None]:
    """Rig in real time that is paused: samples sent meanwhile are in time, however busy the machine is."""
    client.pause()
    yield
    client.pause(False)


@pytest.fixture(scope="module")
def in_process() -> NDArray[np.void]:
    rig = Rig(paper_rig(**STREAM))
    rig.feed(0, WAVE)
    rig.feed(len(WAVE), ())
    return np.concatenate([block.scan.rows for block in rig.advance(NS_PER_S)])


@pytest.mark.parametrize(("mode", "block"), [("free_running", 100), ("free_running", 5_000), ("lockstep", 700)])
def test_a_stream_over_topics_yields_the_bits_of_the_rig_in_process(client, in_process, mode, block):
    host_rig(client, mode, time__peers=[client.name], **STREAM)
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    wanted = client.collect("shaker/stream")
    client.wait_until(lambda: len(wanted), "shaker/stream")
    for first in range(0, len(WAVE), block):
        send(client, first, WAVE[first : first + block])
    send(client, len(WAVE), WAVE[:0])
    if mode == "lockstep":
        client.step(100)
    client.wait_until(lambda: len(scans) >= 100, "a second of scans")
    rows = np.concatenate([table.rows for table in scans.tables()])
    names = [name for name in rows.dtype.names if name != "time"]
    for name in names:
        assert rows[name][:RATE_HZ].tobytes() == in_process[name].tobytes(), name


def test_a_stream_in_real_time_yields_the_bits_of_the_rig_in_process(client):
    node = host_rig(client, "realtime", **STREAM)
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: len(scans), "scans")
    rig = node._session.rig
    wave = WAVE[: RATE_HZ // 2]
    with paused(client):
        first = rig.stream.played
        for begin in range(0, len(wave), 700):
            send(client, first + begin, wave[begin : begin + 700], rig.start_ns)
        send(client, first + len(wave), wave[:0], rig.start_ns)
        client.wait_until(lambda: rig.stream.buffered() == len(wave), "the samples")
    last_ns = rig.start_ns + (first + len(wave)) * NS_PER_S // RATE_HZ
    client.wait_until(lambda: scans.tables()[-1].stamp_ns > last_ns, "the scans of all samples")
    alone = Rig(paper_rig(**STREAM))
    alone.feed(first, wave)
    alone.feed(first + len(wave), ())
    expected = {block.scan.stamp_ns: block.scan.rows for block in alone.advance(last_ns - rig.start_ns + NS_PER_S)}
    found = scans.tables()
    assert rig.stream_state().rows["late"][0] == 0
    assert found[0].stamp_ns < rig.start_ns + first * NS_PER_S // RATE_HZ
    for table in found:
        assert table.rows.tobytes() == expected[table.stamp_ns - rig.start_ns].tobytes()


@pytest.mark.parametrize(
    ("harm", "says"),
    [
        (None, "identical: "),
        ("removed", "lacks sample 2000 of shaker/waveform, which drove the rig 0.200000 s after the start"),
        (0.1, "daq/scan in the table at 0.240000000 s, row 89 (from 0), current: logged"),
        (1e-16, 'rig/journal: entry 2 at 1.000000000 s: logged "name": "crc32", "value": 0.0, "text": "10000 '),
    ],
)
def test_a_recording_is_verified_only_with_all_its_samples(client, tmp_path, harm, says):
    client.host(RecorderNode, parameter_overrides=ros_parameters({"directory": str(tmp_path), "name": "run"}))
    host_rig(client, "free_running", time__peers=[client.name, "recorder"], **STREAM)
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: client.status("recorder").message == "recording", "the recorder")
    scans = client.collect("daq/scan", acknowledge=True)
    for first in range(0, len(WAVE), 500):
        send(client, first, WAVE[first : first + 500])
    send(client, len(WAVE), WAVE[:0])
    client.wait_until(lambda: len(scans) >= 120, "scans")
    client.trigger("recorder/stop")
    path = next(tmp_path.iterdir())
    with Run(path) as run:
        messages = run.messages

        def harmed(names, **options):
            for received in messages(names, **options):
                message = received
                if harm and message.topic.endswith(topics.WAVEFORM.name):
                    table = run.table(message, topics.WAVEFORM)
                    if table.stamp_ns == NS_PER_S // 5:
                        if harm == "removed":
                            continue
                        rows = table.rows.copy()
                        rows["value"][490] += harm
                        message = message._replace(data=memoryview(codec.encode(Table(table.stamp_ns, rows))))
                yield message

        run.messages = harmed
        assert says in str(verify(run))


def test_a_controller_that_ends_in_real_time_causes_a_ramp_a_row_and_a_warning(client):
    node = host_rig(client, "realtime", **STREAM)
    client.wait_active("rig")
    journal = client.collect("rig/journal")
    wanted = client.collect("shaker/stream")
    client.wait_until(lambda: len(wanted), "shaker/stream")
    rig = node._session.rig

    def alive():
        with paused(client):
            send(client, rig.stream.played, np.full(1_000, 0.2), rig.start_ns)
            client.wait_until(lambda: rig.stream.buffered() == 1_000, "the samples")

    def kinds():
        return [entry.name for entry in journal.entries() if entry.kind is InputKind.STREAM]

    alive()
    client.wait_until(lambda: "end" in kinds(), "the end of the stream")
    assert kinds()[:3] == ["begin", "crc32", "end"]
    client.wait_until(lambda: "did not arrive in time" in client.status("rig").message, "the warning")
    alive()
    client.wait_until(lambda: kinds().count("begin") == 2, "that it goes on")
    assert node.refusals.counts.total() == 0


def test_invalid_samples_are_rejected_as_a_block_and_counted(client):
    node = host_rig(client, "realtime", **STREAM)
    client.wait_active("rig")
    client.wait_until(lambda: node._session.rig is not None, "the rig")
    rig = node._session.rig
    for values in (np.array([0.1, math.nan]), np.array([math.inf]), np.array([1e308])):
        send(client, 10**6, values, rig.start_ns)
    send(client, rig.stream.played + 10 * RATE_HZ, WAVE[:10], rig.start_ns)
    send(client, 10**12, WAVE[:10], rig.start_ns)
    send(client, 3, WAVE[:10], rig.start_ns + 40_000)
    client.wait_until(lambda: node.refusals.counts["shaker/waveform"] == 6, "six refusals")
    client.wait_until(lambda: rig.stream.played > 10, "the rig to be beyond ten samples")
    send(client, 0, WAVE[:10], rig.start_ns)
    client.wait_until(lambda: rig.stream_state().rows["late"][0] == 10, "ten late samples")
    assert rig.stream_state().rows["refused"][0] == 6
    assert rig.stream.buffered() == 0
    assert client.state("rig") == "active"


def test_a_free_running_rig_waits_for_samples_and_names_the_silent_sender(client):
    node = host_rig(client, "free_running", time__peers=[client.name], time__peer_timeout_s=0.3, **STREAM)
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    send(client, 0, WAVE[:2_050])
    client.wait_until(lambda: len(scans) == 20, "twenty blocks")
    client.wait_until(lambda: node.doing().word is RigWord.SILENT_PEER, "the word")
    assert client.name in node.doing().reason
    send(client, 2_050, WAVE[2_050:4_001])
    client.wait_until(lambda: len(scans) == 40, "twenty more, when samples come again")
    client.wait_until(lambda: node.doing().word is RigWord.SILENT_PEER, "the word again")
    client.pause(False)
    client.wait_until(lambda: len(scans) > 60, "that it goes on without")


def starved(client: Client, mode: str = "free_running", **values: Any) -> tuple[RigNode, Collector]:
    """Free-running rig that has no samples after twenty blocks, except for half a block."""
    node = host_rig(client, mode, time__peers=[client.name], **STREAM, **values)
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    send(client, 0, WAVE[:2_050])
    client.wait_until(lambda: len(scans) == 20, "twenty blocks")
    return node, scans


def test_samples_received_during_a_pause_are_played_after_it(client: Client) -> None:
    """If a rig was paused while it waited for samples, their arrival must not end the stream when it resumes."""
    node, scans = starved(client, time__peer_timeout_s=0.3)
    rig = node._session.rig
    client.pause()
    send(client, 2_050, WAVE[2_050:4_001])
    client.wait_until(lambda: rig.stream.buffered() > 1_900, "the samples")
    client.spin_for(0.4)
    assert node.doing().word is RigWord.PAUSED
    client.pause(False)
    client.wait_until(lambda: len(scans) == 40, "the blocks of these samples")
    client.spin_for(0.1)
    assert (len(scans), rig.stream.state) == (40, StreamState.PLAYING), "it waits for more"


def test_a_rig_stopped_during_a_pause_waits_for_no_samples(client: Client) -> None:
    """The latched shaker must not make the resumption fail halfway: no longer paused, but without work."""
    node, scans = starved(client, time__peer_timeout_s=0.3)
    client.pause()
    client.trigger("rig/stop")
    client.spin_for(0.4)
    client.pause(False)
    client.wait_until(lambda: len(scans) > 40, "that it goes on, without the stream")
    assert node.refusals.counts.total() == 0


@pytest.mark.parametrize("what", ["reset", "suspended"])
def test_the_timeout_for_samples_restarts_after_a_reset_or_suspension(
    client: Client, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """Samples that were missing before the reset, or during a suspension, must not reject a step at once."""
    node = host_rig(client, "lockstep", time__peers=[client.name], time__peer_timeout_s=0.5, **STREAM)
    client.wait_active("rig")
    client.collect("daq/scan", acknowledge=True)
    with pytest.raises(ServiceFailedError, match="no node publishes samples on shaker/waveform"):
        client.step(1)
    if what == "reset":
        client.trigger("rig/reset")
    else:
        monkeypatch.setattr(session, "AWAY_S", -1.0)
        client.wait_until(lambda: not node._session.is_starving, "a call of the timer")
        monkeypatch.undo()
    began = time.monotonic()
    with pytest.raises(ServiceFailedError, match="no node publishes samples on shaker/waveform"):
        client.step(1)
    assert time.monotonic() - began > 0.2


def test_the_last_of_two_controllers_is_followed_and_both_are_named(client):
    node = host_rig(client, "lockstep", time__peers=[client.name], **STREAM)
    other = client.host(functools.partial(Node, "other"))
    client.wait_active("rig")
    publisher = other.create_publisher(PointCloud2, topics.WAVEFORM.name, 10)
    scans = client.collect("daq/scan", acknowledge=True)
    send(client, 0, np.full(2_001, 0.1))
    client.wait_until(lambda: node._session.rig.stream.buffered() == 2_001, "the first")
    client.wait_until(publisher.get_subscription_count, "the rig to listen to the other")
    publisher.publish(block(0, np.full(2_001, 0.3)))
    client.wait_until(lambda: node._session.rig.stream.buffer.values(0, 1)[0] == 0.3, "the second")
    client.step(20)
    client.wait_until(lambda: len(scans) == 20, "the blocks")
    assert scans.tables()[-1].rows["current"].mean() == pytest.approx(0.3, abs=0.02)
    client.wait_until(lambda: "all send samples" in client.status("rig").message, "both named")


def test_controller_hardware_reads_the_same_over_topics_and_in_process():
    with RosRig({**FLAT, "time.mode": "free_running"}, hosted=True) as over, LocalRig(FLAT) as alone:
        found = [Hardware(rig).respond(WAVE[: RATE_HZ // 2], rest=RATE_HZ // 10) for rig in (over, alone)]
    assert len(found[0]) == len(found[1]) > RATE_HZ // 2
    assert np.array_equal(found[0]["laser"], found[1]["laser"])
    assert np.array_equal(found[0]["current"], found[1]["current"])


def test_a_controller_whose_rig_has_ended_gets_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """It must not wait until its time limit, and then report that no scans have arrived."""
    with RosRig({**FLAT, "time.mode": "free_running"}, hosted=True) as rig:

        class Died:
            def check(self) -> None:
                raise ProcessDiedError("the rig process was ended by SIGKILL")

        monkeypatch.setattr(rig.client, "_processes", Died())
        with pytest.raises(ProcessDiedError, match="ended by SIGKILL"):
            Acquisition(rig).read(10**6, timeout_s=0.5)


def test_a_stop_during_the_search_for_readers_is_not_overlooked(monkeypatch: pytest.MonkeyPatch) -> None:
    def is_stopped(rig: RosRig) -> bool:
        rig.client.prepare(Trigger, "rig/stop").call_async(Trigger.Request())
        return any(entry.kind is InputKind.STOP for entry in rig.journal())

    monkeypatch.setattr(RosRig, "_finds_readers", is_stopped)
    with (
        RosRig({**FLAT, "time.mode": "realtime"}, hosted=True) as rig,
        pytest.raises(CommandError, match=r"^the rig tripped: emergency stop$"),
    ):
        rig.feed(rig.stream_level().sample, WAVE[:100])
