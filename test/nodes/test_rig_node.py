"""The rig node through its topics and services, as any client sees it."""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from nodes_support import host_rig
from rclpy.qos import DurabilityPolicy
from std_msgs.msg import Float64, Header
from std_srvs.srv import SetBool

from impact_rig.config import RigConfig, from_flat, load
from impact_rig.errors import ConfigError, SimulationError
from impact_rig.nodes import topics
from impact_rig.nodes.stamps import nanoseconds
from impact_rig.rig import Block, Rig, resimulate
from impact_rig.testing import Client, Collector, ServiceFailedError, WaitTimeoutError

pytestmark = pytest.mark.ros
TICK = 10_000_000
DRIVEN = {"drive.amplitude": 0.52, "barriers.gap_m": 0.002}


def same_as_resimulated(scans: Collector, journal: Collector) -> int:
    """Compare every published block with a re-simulation of the journal; return how many were compared."""
    tables = scans.tables()
    pure = {}
    for block in resimulate(journal.tables()):
        pure[block.scan.stamp_ns] = block.scan.rows.tobytes()
        if block.scan.stamp_ns >= tables[-1].stamp_ns:
            break
    for table in tables:
        assert table.rows.tobytes() == pure[table.stamp_ns], f"block at {table.stamp_ns}"
    return len(tables)


def test_stepped_publishes_exactly_what_the_rig_computes(client: Client) -> None:
    host_rig(client, time__peers=["client"], **{k.replace(".", "__"): v for k, v in DRIVEN.items()})
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(13)
    row = client.command(frequency_hz=9.05)
    client.step(20)

    rig = Rig(from_flat(RigConfig(), DRIVEN))
    blocks = rig.advance(13 * TICK)
    expected = rig.command(frequency_hz=9.05).rows[0]
    blocks += rig.advance(33 * TICK)
    assert row == expected
    assert scans.lost() == 0
    assert len(scans) == 33, "the reply came after the last block was out and acknowledged"
    for table, block in zip(scans.tables(), blocks, strict=True):
        assert table.stamp_ns == block.scan.stamp_ns
        assert table.rows.tobytes() == block.scan.rows.tobytes()


@pytest.mark.parametrize("mode", ["realtime", "freewheel"])
def test_other_modes_give_the_same_bits_for_the_same_journal(client: Client, mode: str) -> None:
    """Commands arrive whenever they arrive; the journal says where they acted."""
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
    client.wait_until(lambda: b"stop" in journal.rows()["kind"], "the whole journal")
    assert scans.lost() == 0
    stamps = [table.stamp_ns for table in scans.tables()]
    assert set(np.diff(stamps)) == {TICK}
    assert same_as_resimulated(scans, journal) > 60


def test_hostile_commands_are_refused_counted_and_change_nothing(client: Client) -> None:
    node = host_rig(client)
    client.wait_active("rig")
    client.command(frequency_hz=9.1, current_a=0.3)
    applied = client.collect("shaker/applied")
    client.wait_until(lambda: len(applied) >= 3, "the rows so far")
    bad = [math.nan, math.inf, -math.inf, 1e308, -1.0, 1e-300, 4.9, 200.1]
    for value in bad:
        client.publish(topics.FREQUENCY, Float64(data=value))
    for value in (math.nan, -0.001, 30.0):
        client.publish(topics.CURRENT, Float64(data=value))
    client.wait_until(lambda: node.refusals.total() == len(bad) + 3, "all refusals")
    assert node.refusals.counts == {"shaker/frequency": len(bad), "shaker/current": 3}
    assert "200.1" in node.refusals.last["shaker/frequency"]
    row = client.command(frequency_hz=9.2)
    assert (row["frequency"], row["current"]) == (9.2, 0.3)
    client.wait_until(lambda: len(applied) >= 4, "the row")
    assert len(applied) == 4


def test_commands_before_activation_are_refused_and_parameters_accepted(client: Client) -> None:
    node = host_rig(client, output__autostart=False)
    client.wait_until(lambda: client.state("rig") == "unconfigured", "the node")
    client.publish(topics.CURRENT, Float64(data=0.1))
    client.wait_until(lambda: node.refusals.counts["inactive"] == 1, "the refusal")
    client.set_parameters("rig", {"barriers.gap_m": 0.008})
    for service in ("reset", "stop", "clear_trip", "pluck", "step"):
        with pytest.raises(ServiceFailedError, match="unconfigured"):
            client.trigger(f"rig/{service}")
    assert client.change_state("rig", "configure")
    assert client.change_state("rig", "activate")
    configuration = client.collect("rig/configuration")
    client.wait_until(lambda: configuration.messages, "rig/configuration")
    assert "gap_m: 0.008" in configuration.messages[0].data


def test_silent_peer_pauses_the_rig_by_name_until_told_to_go_on(client: Client) -> None:
    host_rig(client, "freewheel", time__peers=["client"], time__peer_timeout_s=0.5, time__ack_window=4)
    client.wait_active("rig")
    scans = client.collect("daq/scan")  # listens, but never acknowledges
    client.wait_until(lambda: "client silent for 0.5 s" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == b"\2"
    assert len(scans) == 4, "no further than the window"
    client.pause(False)
    client.wait_until(lambda: len(scans) == 8, "the next window")
    with pytest.raises(ConfigError, match="peers must name who follows in freewheel"):
        client.set_parameters("rig", {"time.peers": [""]})


def test_freewheel_waits_for_peers_that_are_not_there_yet(client: Client) -> None:
    host_rig(client, "freewheel", time__peers=["client", "absent"])
    client.wait_active("rig")
    client.wait_until(lambda: "waiting for peer" in client.status("rig").message, "the diagnostic")
    assert "absent" in client.status("rig").message
    client.set_parameters("rig", {"time.peers": ["client"]})
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 20, "blocks")
    assert scans.tables()[0].stamp_ns == 0, "the first block was not lost to the late peer"


def test_senseless_acknowledgements_are_counted_and_harmless(client: Client) -> None:
    node = host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(2)
    for stamp in (10**15, 2 * TICK):
        header = Header(frame_id="client")
        header.stamp.sec, header.stamp.nanosec = divmod(stamp, 10**9)
        client.publish(topics.ACK, header)
    client.publish(topics.ACK, Header(frame_id="nobody"))
    client.wait_until(lambda: node.refusals.counts["daq/ack"] == 2, "the refusals")
    client.step(2)
    assert len(scans) == 4


def test_pause_holds_rig_time(client: Client) -> None:
    host_rig(client, "freewheel", time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.pause(True)
    client.wait_until(lambda: client.status("rig").message == "paused", "the diagnostic")
    before = len(scans)
    client.command(current_a=0.1)  # takes several turns of the executor
    assert len(scans) == before
    client.pause(False)
    client.wait_until(lambda: len(scans) > before, "rig time to go on")


def test_a_pause_is_answered_when_everything_out_was_processed(client: Client) -> None:
    """So that what is done next (a reset, a new recording) has no blocks of the past on the way."""
    node = host_rig(client, "freewheel", time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.wait_until(lambda: len(scans) > 30, "blocks")
    client.pause()
    published, received = node._figures.blocks, len(scans)
    assert received == published
    client.trigger("rig/reset")
    client.pause(False)
    client.wait_until(lambda: len(scans) > received, "blocks after the reset")


def test_step_refuses_in_the_wrong_mode_and_answers_when_deactivated(client: Client) -> None:
    host_rig(client, "realtime")
    client.wait_active("rig")
    with pytest.raises(ServiceFailedError, match=r"time\.mode must be stepped"):
        client.trigger("rig/step")
    assert client.change_state("rig", "deactivate")
    with pytest.raises(ServiceFailedError, match="inactive"):
        client.trigger("rig/step")


def test_a_step_waits_for_the_slowest_peer(client: Client) -> None:
    host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan")
    with pytest.raises(WaitTimeoutError, match="rig/step"):
        client.trigger("rig/step", timeout_s=0.5)
    assert len(scans) == 1


def test_reset_begins_a_new_journal_and_stamps_go_on(client: Client) -> None:
    host_rig(client, **{k.replace(".", "__"): v for k, v in DRIVEN.items()})
    client.wait_active("rig")
    journal, scans = client.collect("rig/journal"), client.collect("daq/scan")
    client.step(5)
    client.trigger("rig/reset")
    client.step(5)
    client.wait_until(lambda: len(scans) == 10, "all blocks")
    assert [table.stamp_ns for table in scans.tables()] == [k * TICK for k in range(10)]
    first, second = ([t.rows.tobytes() for t in scans.tables()[k : k + 5]] for k in (0, 5))
    assert first == second, "as new"
    rows = journal.rows()
    assert [bytes(kind) for kind in rows["kind"]] == [
        b"start",
        b"initial",
        b"initial",
        b"reset",
        b"initial",
        b"initial",
    ]
    assert rows["sequence"].tolist() == [0, 1, 2, 0, 1, 2]


def test_a_late_subscriber_gets_calibration_configuration_journal_and_present_command(client: Client) -> None:
    host_rig(client)
    client.wait_active("rig")
    client.command(frequency_hz=8.0, current_a=0.2)
    client.step(3)
    late = {name: client.collect(name) for name in ("daq/info", "rig/configuration", "rig/journal", "shaker/applied")}
    expected = {"daq/info": 1, "rig/configuration": 1, "rig/journal": 3, "shaker/applied": 3}
    client.wait_until(lambda: {n: len(c) for n, c in late.items()} == expected, "what was published before")
    assert late["daq/info"].rows()["name"].tolist() == [b"accelerometer", b"laser", b"base", b"current"]
    assert late["shaker/applied"].rows()[["frequency", "current"]].tolist() == [(9.1, 0.0), (8.0, 0.0), (8.0, 0.2)]
    assert late["rig/journal"].rows()["key"].tolist() == [b"", b"frequency", b"current"]


def test_the_published_configuration_is_a_file_that_loads_again(client: Client, tmp_path) -> None:
    host_rig(client, barriers__gap_m=0.004)
    client.wait_active("rig")
    configuration = client.collect("rig/configuration")
    client.wait_until(lambda: configuration.messages, "rig/configuration")
    path = tmp_path / "rig.yaml"
    path.write_text(configuration.messages[0].data)
    expected = from_flat(RigConfig(), {"barriers.gap_m": 0.004, "time.mode": "stepped"})
    assert load(path) == expected


def test_a_parameter_changes_at_a_command_instant_and_is_journaled(client: Client) -> None:
    host_rig(client)
    client.wait_active("rig")
    journal = client.collect("rig/journal")
    client.step(7)
    client.set_parameters("rig", {"barriers.gap_m": 0.004, "output.monitor_rate_hz": 20.0})
    client.wait_until(lambda: len(journal) == 2, "the journal")
    (row,) = journal.tables()[1].rows
    assert (row["kind"], row["key"], row["value"], row["sample"]) == (b"parameter", b"barriers.gap_m", 0.004, 700)
    with pytest.raises(ConfigError, match=r"barriers.gap_m must be > 0 and <= 1, got 6"):
        client.set_parameters("rig", {"barriers.gap_m": 6, "contact.law": "hertz"})
    assert client.get_parameters("rig", ["barriers.gap_m", "contact.law"]) == {
        "barriers.gap_m": 0.004,
        "contact.law": "flores",
    }


def test_over_travel_latches_with_an_error_until_cleared(client: Client) -> None:
    host_rig(client, shaker__travel_limit_m=0.001)
    client.wait_active("rig")
    client.command(frequency_hz=8.0, current_a=5.0)
    client.step(100)
    client.wait_until(lambda: "latched by over_travel" in client.status("rig").message, "the diagnostic")
    assert client.status("rig").level == b"\2"
    client.trigger("rig/clear_trip")
    row = client.command(current_a=0.1)
    assert row["current"] == 0.1


def test_pluck_uses_its_parameter(client: Client) -> None:
    host_rig(client, pluck__displacement_m=0.003, output__truth_scan=True, sphere__present=False)
    client.wait_active("rig")
    truth = client.collect("truth/scan")
    client.trigger("rig/pluck")
    client.step(2)
    client.wait_until(lambda: len(truth) == 2, "the truth")
    assert truth.rows()["x_1"][0] == pytest.approx(0.003)
    assert np.all(truth.rows()["x_b"] == 0)


@pytest.mark.parametrize(("mode", "published"), [("stepped", True), ("realtime", False)])
def test_the_clock_runs_when_rig_time_is_not_real_time(client: Client, mode: str, published: bool) -> None:
    host_rig(client, mode)
    client.wait_active("rig")
    clock, scans = client.collect("/clock"), client.collect("daq/scan")
    if mode == "stepped":
        client.step(5)
    client.wait_until(lambda: len(scans) >= 5, "blocks")
    assert bool(clock.messages) == published
    if published:
        client.wait_until(lambda: nanoseconds(clock.messages[-1].clock) == 5 * TICK, "the end of the last block")


def test_a_rig_with_a_bad_value_refuses_to_configure_and_says_why(client: Client) -> None:
    node = host_rig(client, barriers__gap_m=6)
    client.wait_until(lambda: client.status("rig").level == b"\2", "the diagnostic")
    assert "barriers.gap_m must be > 0 and <= 1, got 6" in client.status("rig").message
    assert client.state("rig") == "unconfigured"
    assert not client.change_state("rig", "configure")
    assert node.refusals.total() == 0


def test_services_do_not_answer_success_twice(client: Client) -> None:
    """A pause is a state, not a toggle."""
    host_rig(client)
    client.wait_active("rig")
    for _ in range(2):
        response = client.call(SetBool, "rig/pause", SetBool.Request(data=True))
        assert response.success
    with pytest.raises(ServiceFailedError, match="paused"):
        client.trigger("rig/step")


def test_a_flood_of_commands_leaves_order_and_a_whole_journal(client: Client) -> None:
    """As fast as a client can publish: the queue keeps the newest, every accepted one is journaled."""
    host_rig(client, "realtime")
    client.wait_active("rig")
    journal, scans = client.collect("rig/journal"), client.collect("daq/scan")
    client.command(frequency_hz=10.0)
    publisher = client._publishers["shaker/frequency"]
    for k in range(3000):
        publisher.publish(Float64(data=10.0 + k / 1000))
        if k % 20 == 0:
            client.executor.spin_once(timeout_sec=0.0)
    client.wait_until(lambda: (newest := journal.last()) and newest.rows["value"][-1] == 12.999, "the last command")
    client.pause()
    values = journal.rows()["value"][1:]
    assert np.all(np.diff(values) >= 0)
    assert same_as_resimulated(scans, journal) > 0


def test_qos_can_be_overridden(client: Client) -> None:
    host_rig(client, **{"qos_overrides./daq/scan.publisher.depth": 7})
    client.wait_active("rig")
    assert client.get_parameters("rig", ["qos_overrides./daq/scan.publisher.depth"]) == {
        "qos_overrides./daq/scan.publisher.depth": 7
    }


@pytest.mark.parametrize("mode", ["realtime", "freewheel"])
def test_a_simulation_that_cannot_go_on_deactivates_the_rig_and_can_be_started_again(client: Client, mode: str) -> None:
    node = host_rig(client, mode, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)

    def stuck(_until_ns: int) -> list[Block]:
        raise SimulationError("no progress in drive segment 7")

    node._rig.advance = stuck  # a fault put in by hand: no legal configuration is known that does this
    client.wait_until(lambda: "no progress in drive segment 7" in client.status("rig").message, "the reason")
    assert client.status("rig").level == b"\2"
    assert client.state("rig") == "inactive"
    assert client.change_state("rig", "activate")
    scans.clear()
    client.wait_until(lambda: len(scans) > 5, "blocks of the next rig")
    assert node.refusals.counts == {"exception": 1}


def test_a_rig_slower_than_real_time_says_so_and_still_answers(client: Client) -> None:
    """A hundred thousand lossless bounces a second: legal; at 200 times real time too much for any machine."""
    host_rig(
        client, "realtime", drive__amplitude=0.52, time__factor=200.0,
        contact__law="restitution", contact__restitution=1.0, barriers__gap_m=1e-7,
    )  # fmt: skip
    client.wait_active("rig")
    client.wait_until(lambda: "could not keep real time" in client.status("rig").message, "the diagnostic")
    begin = time.monotonic()
    for _ in range(2):
        client.trigger("rig/clear_trip")
    assert time.monotonic() - begin < 4.0


def test_a_reader_that_cannot_match_holds_nobody_up(client: Client) -> None:
    """It asks for history that daq/scan does not offer; the peer is there all the same."""
    profile = topics.SCAN.qos.profile()
    profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    client.node.create_subscription(topics.SCAN.message_type(), topics.SCAN.name, lambda _: None, profile)
    host_rig(client, time__peers=["client"])
    client.wait_active("rig")
    scans = client.collect("daq/scan", acknowledge=True)
    client.step(3)
    assert len(scans) == 3


def test_a_step_without_its_peer_is_refused_by_name(client: Client) -> None:
    host_rig(client, time__peers=["nobody"], time__peer_timeout_s=0.3)
    client.wait_active("rig")
    with pytest.raises(ServiceFailedError, match="peer nobody is not there"):
        client.step(1)
    client.wait_until(lambda: client.status("rig").level == b"\x02", "an error in the diagnostics")
    assert "waiting for peer nobody" in client.status("rig").message


def test_freewheel_without_anybody_to_follow_is_refused(client: Client) -> None:
    rig = host_rig(client, mode="freewheel")
    assert "peers must name who follows in freewheel" in str(rig.parameters.refused)


def test_going_on_while_running_gives_up_no_time(client: Client) -> None:
    rig = host_rig(client, mode="realtime")
    client.wait_active("rig")
    before = rig._pacer.wait_ns(0) + time.monotonic_ns()
    for _ in range(5):
        client.pause(False)
    after = rig._pacer.wait_ns(0) + time.monotonic_ns()
    assert after == pytest.approx(before, abs=1_000_000), "scan 0 is due when it was due"
