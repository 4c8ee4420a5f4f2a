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
"""Rig time: all modes give the same bits, a pause stops it, and a step is answered when all its work is done."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import DRIVEN, TICK, dotted, host_rig, same_as_resimulated
from std_srvs.srv import SetBool, Trigger

from impact_rig import codec, topics
from impact_rig.client import Client, ServiceFailedError
from impact_rig.client.client import Collector, Received
from impact_rig.nodes import publishers
from impact_rig.nodes.messages import nanoseconds
from impact_rig.nodes.pacing import Pacer
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S

pytestmark = pytest.mark.ros


def test_a_rig_in_lockstep_publishes_exactly_what_it_computes(client: Client) -> None:
    host_rig(client, time__peers=["client"], **DRIVEN)
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(13)
    row = client.command(frequency_hz=9.05)
    client.step(20)

    rig = Rig(from_flat(RigConfig(), dotted(DRIVEN)))
    blocks = rig.advance(13 * TICK)
    expected = rig.accept(frequency_hz=9.05).rows[0]
    blocks += rig.advance(33 * TICK)
    assert row == expected
    assert scans.lost() == 0
    assert len(scans) == 33, "the reply arrived after the last block was published and acknowledged"
    for table, block in zip(scans.tables(), blocks, strict=True):
        assert table.stamp_ns == block.scan.stamp_ns
        assert table.rows.tobytes() == block.scan.rows.tobytes()


def test_only_a_change_of_speed_restarts_the_period_of_the_blocks(client: Client) -> None:
    """A parameter such as a gap must not restart the period of the blocks."""
    node = host_rig(client, "realtime")
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: len(scans) > 5, "some blocks")
    timers = set(node.timers)
    client.set_parameters("rig", {"barriers.gap_m": 0.004, "shaker.ramp_s": 0.2})
    assert set(node.timers) == timers
    client.set_parameters("rig", {"time.factor": 0.5})
    assert set(node.timers) != timers
    before = len(scans)
    client.wait_until(lambda: len(scans) > before + 5, "blocks at the new speed")


@pytest.mark.parametrize("mode", ["realtime", "free_running"])
def test_all_time_modes_yield_the_same_bits_for_the_same_journal(client: Client, mode: str) -> None:
    """Commands may arrive at any time; the journal states where they acted."""
    host_rig(client, mode, time__peers=["client"], daq__seed=3, barriers__gap_m=0.002)
    client.wait_active("rig")
    journal = client.collect("rig/journal")
    scans = client.collect("daq/scan", acknowledge=True)
    client.command(frequency_hz=9.1, current_a=0.52)
    client.wait_until(lambda: len(scans) > 20, "20 blocks")
    client.command(frequency_hz=9.0)
    client.set_parameters("rig", {"barriers.gap_m": 0.004, "contact.law": "hertz"})
    client.wait_until(lambda: len(scans) > 40, "40 blocks")
    client.trigger("rig/stop")
    client.wait_until(lambda: len(scans) > 60, "60 blocks")
    client.pause()
    client.wait_until(lambda: "stop" in [entry.kind.value for entry in journal.entries()], "the whole journal")
    assert scans.lost() == 0
    stamps = [table.stamp_ns for table in scans.tables()]
    assert set(np.diff(stamps)) == {TICK}
    assert same_as_resimulated(scans, journal) > 60


def test_a_pause_stops_rig_time(client: Client) -> None:
    host_rig(client, "free_running", time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.pause(True)
    expected = "paused: rig time stands still until ~/pause is called with false"
    client.wait_until(lambda: client.status("rig").message == expected, "the diagnostic")
    before = len(scans)
    client.command(current_a=0.1)  # takes several turns of the executor
    assert len(scans) == before
    client.pause(False)
    client.wait_until(lambda: len(scans) > before, "rig time to go on")


def test_a_pause_is_answered_when_all_published_blocks_are_processed(client: Client) -> None:
    """The next action (a reset, a new recording) then has no blocks of the past under way."""
    host_rig(client, "free_running", time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 30, "blocks")
    client.pause()
    received = len(scans)
    journal = client.collect("rig/journal")
    client.trigger("rig/reset")
    client.pause(False)
    client.wait_until(lambda: len(scans) > received, "blocks after the reset")
    resets = [entry.stamp_ns for entry in journal.entries() if entry.kind.value == "reset"]
    assert [scans.tables()[received].stamp_ns] == resets, "the next block is the first after the reset"


def test_a_repeated_pause_succeeds_and_keeps_the_rig_paused(client: Client) -> None:
    """A pause is a state, not a toggle."""
    host_rig(client)
    client.wait_active("rig")
    for _ in range(2):
        response = client.call(SetBool, "rig/pause", SetBool.Request(data=True))
        assert response.success


@pytest.mark.parametrize("mode", ["realtime", "free_running", "lockstep"])
def test_a_paused_rig_is_stepped_block_by_block_and_stays_paused(client: Client, mode: str) -> None:
    """As simulation_interfaces defines it, a step needs the state PAUSED; the samples are those of any other mode."""
    node = host_rig(client, mode, time__peers=["client"], drive__amplitude=0.52)
    scans, journal = (client.collect(name, acknowledge=name == "daq/scan") for name in ("daq/scan", "rig/journal"))
    client.wait_active("rig")
    if mode != "lockstep":
        client.wait_until(lambda: len(scans) > 3, "the first blocks")
    client.pause()
    client.wait_until(lambda: "paused" in client.status("rig").message, "the pause")
    before = len(scans)
    client.step(7)
    client.wait_until(lambda: len(scans) >= before + 7, "the blocks of the step")
    assert client.step(1).startswith("rig time ")
    client.wait_until(lambda: len(scans) >= before + 8, "one more")
    client.command(current_a=0.3)
    assert len(scans) == before + 8, "it is stopped again"
    assert "paused" in client.status("rig").message
    client.pause(False)
    if mode != "lockstep":
        client.wait_until(lambda: len(scans) > before + 20, "it goes on")
    assert scans.lost() == 0
    assert same_as_resimulated(scans, journal) == len(scans)
    assert node.refusals.counts.total() == 0


def waiting_step(client: Client) -> tuple[Collector, Any]:
    """Start a rig and a step of 100 blocks, two of which come without an acknowledgement; return scans and answer."""
    host_rig(client, time__peers=["client"])
    scans = client.collect("daq/scan")
    client.wait_active("rig")
    client.set_parameters("rig", {"step.blocks": 100, "time.ack_window": 2})
    step = client.node.create_client(Trigger, "rig/step")
    client.wait_until(step.service_is_ready, "the service")
    answer = step.call_async(Trigger.Request())
    client.wait_until(lambda: len(scans) == 2, "the window")
    return scans, answer


def test_a_pause_defers_the_remaining_blocks_of_a_step(client: Client) -> None:
    scans, answer = waiting_step(client)
    pause = client.node.create_client(SetBool, "rig/pause").call_async(SetBool.Request(data=True))
    client.wait_until(lambda: "paused" in client.status("rig").message, "the pause")
    client.acknowledge_for("client", scans.tables()[-1].stamp_ns)
    client.wait_until(pause.done, "the answer to the pause")
    assert (len(scans), answer.done()) == (2, False)
    client.pause(False)
    acknowledged = 0
    while not answer.done():
        client.wait_until(lambda: len(scans) > acknowledged or answer.done(), "the next blocks")  # noqa: B023  # at once
        acknowledged = len(scans)
        client.acknowledge_for("client", scans.tables()[-1].stamp_ns)
    assert answer.result().success
    assert len(scans) == 100


def test_a_reset_ends_a_step_that_waits(client: Client) -> None:
    """The restarted rig must not continue the remaining blocks of the step."""
    scans, answer = waiting_step(client)
    client.trigger("rig/reset")
    client.wait_until(answer.done, "the answer to the step")
    assert (answer.result().success, answer.result().message) == (False, "the rig was reset")
    client.acknowledge_for("client", scans.tables()[-1].stamp_ns)
    client.spin_for(0.2)
    assert len(scans) == 2


def test_a_step_is_rejected_in_the_wrong_mode_and_answered_on_deactivation(client: Client) -> None:
    host_rig(client, "realtime")
    client.wait_active("rig")
    with pytest.raises(ServiceFailedError, match="pause it first"):
        client.trigger("rig/step")
    assert client.change_state("rig", "deactivate")
    with pytest.raises(ServiceFailedError, match="inactive"):
        client.trigger("rig/step")


@pytest.mark.parametrize(("mode", "published"), [("lockstep", True), ("realtime", False)])
def test_the_clock_runs_when_rig_time_is_not_real_time(client: Client, mode: str, published: bool) -> None:
    host_rig(client, mode)
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    if mode == "lockstep":
        client.step(5)
    client.wait_until(lambda: len(scans) >= 5, "blocks")
    assert bool(client.node.count_publishers("/clock")) == published
    if published:
        clock = client.collect("/clock")
        client.step(5)
        client.wait_until(
            lambda: clock.messages and nanoseconds(clock.messages[-1].clock) == 10 * TICK, "the end of the last block"
        )


def test_a_rig_slower_than_real_time_reports_it_and_still_answers(client: Client) -> None:
    """Ten thousand lossless bounces a second are valid, but at 1000 times real time too much for any machine."""
    host_rig(
        client, "realtime", drive__amplitude=0.52, time__factor=1000.0,
        contact__law="restitution", contact__restitution=1.0, barriers__gap_m=1e-6,
    )  # fmt: skip
    client.wait_active("rig")
    client.wait_until(lambda: "could not keep real time" in client.status("rig").message, "the diagnostic")
    for _ in range(2):
        client.trigger("rig/clear_trip")  # raises if there is no answer
    assert "could not keep real time" in client.status("rig").message, "it was late all the while"


def test_blocks_longer_than_the_largest_lag_are_published_in_real_time(client: Client) -> None:
    """The lag counts within a block: a block of two seconds must not be given up halfway, again and again."""
    node = host_rig(client, "realtime", daq__rate_hz=1000, daq__block_scans=2000)
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    client.wait_until(lambda: scans, "a block of two seconds", 8.0)
    assert node._session.pacer.slips == 0


@pytest.mark.parametrize("scans", [700, 730, 2500, 10_000])
def test_the_work_timer_calls_at_the_end_of_every_block(client: Client, scans: int) -> None:
    """A timer whose period does not divide the block would call up to one period late."""
    node = host_rig(client, "realtime", daq__block_scans=scans)
    client.wait_active("rig")
    calls = scans / 10_000 / node._session._timer._period_s
    assert calls == pytest.approx(round(calls), rel=1e-9)


def test_a_pause_and_a_change_of_speed_keep_the_position_within_a_block(client: Client) -> None:
    """The pacer continues within the block; otherwise, the rig would stop for as long as the block has lasted."""
    node = host_rig(client, "realtime", daq__rate_hz=1000, daq__block_scans=10_000)
    client.wait_active("rig")
    session = node._session
    client.wait_until(lambda: session.rig.frontier_ns > session.rig.start_ns + 50 * TICK, "half a second of a block")
    for change in (lambda: client.set_parameters("rig", {"time.factor": 0.5}), client.pause):
        change()
        client.pause(False)
        before = session.rig.frontier_ns
        client.wait_until(lambda before=before: session.rig.frontier_ns > before, "rig time to go on", 0.3)


def test_resuming_a_running_rig_gives_up_no_time(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks that are due keep their time, because only a pause restarts the time base."""
    pacers = []
    made = Pacer.__init__
    monkeypatch.setattr(Pacer, "__init__", lambda self, *given: (pacers.append(self), made(self, *given))[1])
    host_rig(client, mode="realtime", time__factor=1e-3)  # nothing falls due meanwhile
    client.wait_active("rig")

    def due_ns() -> int:
        """Return when the rig's second 1 is due; the clock that is read first can only make this too early."""
        return max(time.monotonic_ns() + pacers[-1].wait_ns(10**9) for _ in range(100))

    before, begin = due_ns(), time.monotonic_ns()
    while time.monotonic_ns() < begin + 100_000_000:
        client.pause(False)
    assert due_ns() < before + 50_000_000, "a tenth of a second of going on cost none of it"
    client.pause()
    begin = time.monotonic_ns()
    client.spin_for(0.1)
    stood_ns = time.monotonic_ns() - begin
    client.pause(False)
    assert due_ns() >= before + stood_ns, "as long as it stood still, and what pausing took"


def test_resuming_without_a_silent_peer_gives_up_no_time(client: Client) -> None:
    timing = {"time__peers": ["client"], "time__peer_timeout_s": 0.2, "time__factor": 0.1}
    session = host_rig(client, "realtime", **timing)._session
    client.wait_active("rig")
    client.collect("daq/scan")  # listens, but never acknowledges
    client.wait_until(lambda: bool(session.window.silent()), "the silence of the peer")
    before = session.pacer._deadline_ns(0)
    client.pause(False)
    assert session.pacer._deadline_ns(0) == before


def test_a_paused_rig_updates_its_subscribers_at_each_step(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishers, "GRAPH_POLL_S", 1000.0)  # a running one in real time looks now and then
    host_rig(client, "realtime")
    client.wait_active("rig")
    client.pause()
    client.step(1)
    states = client.collect("truth/joint_states")
    client.step(4)
    client.wait_until(lambda: len(states) == 2, "the true states of four blocks")


def test_a_subscriber_with_the_scans_of_a_block_has_the_complete_block(client: Client) -> None:
    """If scans were published before the rest of a block, they would leave a killed recorder without the rest."""
    host_rig(client, daq__block_scans=2000)
    client.wait_active("rig")
    held: list[tuple[int, int]] = []  # end of each block of scans, and stamp of the newest joint state before it
    joints = client.listen(topics.JOINT_STATES.name)

    def on_scan(message: Received) -> None:
        held.append((codec.header_stamp_ns(message.data) + 20 * TICK, nanoseconds(joints.messages[-1].header.stamp)))

    client.listen(topics.SCAN.name, on_scan)
    client.step(4)
    client.wait_until(lambda: len(held) == 4, "four blocks of scans")
    assert all(0 < end - newest <= NS_PER_S // 50 for end, newest in held), held
