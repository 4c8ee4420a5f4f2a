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
"""The stepped-sine node measures a curve over topics, and leaves the shaker at rest whatever happens."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.nodes import host_rig
from std_srvs.srv import Trigger

from impact_rig.client import Client, ServiceFailedError
from impact_rig.client.client import ros_parameters
from impact_rig.errors import ConfigError
from impact_rig.nodes.analysis_node import AnalysisNode
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig
from impact_rig_studies.stepped_sine_node import SteppedSineNode

pytestmark = pytest.mark.ros

FREQUENCIES_HZ = [8.0, 10.5, 9.5]


@pytest.fixture
def sweeping(client: Client) -> Client:
    """Rig that runs as fast as its analysis, and a stepped-sine node."""
    client.host(AnalysisNode)
    values = {"frequencies_hz": FREQUENCIES_HZ, "direction": "up_down"}
    client.host(SteppedSineNode, parameter_overrides=ros_parameters(values))
    host_rig(client, "free_running", time__peers=["analysis"], sphere__present=False)
    client.wait_active("rig", "analysis", "stepped_sine")
    return client


def status(client: Client) -> str:
    return client.status("stepped_sine").message


def begin(client: Client) -> None:
    client.wait_until(lambda: status(client) == "idle", "the node to be idle")
    client.collect("base_displacement")
    client.wait_until(lambda: _started(client), "a sweep")


def _started(client: Client) -> bool:
    """Request a sweep; it is rejected until the node has found rig and analysis."""
    return bool(client.call(Trigger, "stepped_sine/start", Trigger.Request()).success)


def current_now(client: Client) -> float:
    return float(client.applied.tables()[-1].rows["current"][-1])


def test_the_measured_curve_is_the_closed_form(sweeping: Client) -> None:
    curves = sweeping.collect("sweep/table")
    begin(sweeping)
    with pytest.raises(ServiceFailedError, match="running already"):
        sweeping.trigger("stepped_sine/start")
    with pytest.raises(ConfigError, match="a sweep is running"):
        sweeping.set_parameters("stepped_sine", {"current_a": 0.1})
    sweeping.wait_until(lambda: status(sweeping) == "finished, 6 points", "the end of the sweep", 60.0)
    sweeping.wait_until(lambda: len(curves.rows()) == 6, "the whole curve")
    curve = curves.rows()
    up = sorted(FREQUENCIES_HZ)
    assert curve["frequency"].tolist() == up + up[::-1]
    assert (np.diff(curve["time"]) > 0).all()
    truth = [abs(transmissibility(RigConfig(), frequency)) for frequency in curve["frequency"]]
    assert np.all(np.abs(curve["transmissibility"] - truth) < 3 * curve["transmissibility_uncertainty"])
    sweeping.wait_until(lambda: current_now(sweeping) == 0.0, "the shaker at rest")


def test_an_amplitude_is_held_and_its_curve_published(sweeping: Client) -> None:
    held, measurements = sweeping.collect("sweep/table"), sweeping.collect("transmissibility/table")
    values = {"hold": "base", "target": 60e-6, "frequencies_hz": [8.8, 9.2], "direction": "up"}
    sweeping.set_parameters("stepped_sine", values)
    begin(sweeping)
    sweeping.wait_until(lambda: status(sweeping) == "finished, 2 points", "the end of the sweep", 60.0)
    sweeping.wait_until(lambda: len(held.rows()) == 2, "the whole curve")
    rows = held.rows()
    assert np.all(np.abs(rows["error"]) <= 2e-3)
    assert rows["held"].tolist() == [1.0, 1.0]
    assert set(rows["transmissibility"]) <= set(measurements.rows()["transmissibility"])
    assert np.isnan(rows["locked"]).all()
    sweeping.wait_until(lambda: current_now(sweeping) == 0.0, "the shaker at rest")


@pytest.fixture
def locking(client: Client) -> Client:
    """Linear rig that waits for the node that locks on its resonance, at most two blocks ahead of it."""
    values = {"hold": "phase", "frequencies_hz": [8.9], "current_a": 0.3, "dwell_s": 4.0, "within_deg": 1.0}
    client.host(SteppedSineNode, parameter_overrides=ros_parameters(values))
    ahead = {"daq__block_scans": 500, "time__ack_window": 2}
    host_rig(client, "free_running", time__peers=["stepped_sine"], sphere__present=False, **ahead)
    client.wait_active("rig", "stepped_sine")
    return client


def test_the_phase_is_locked_held_and_published(locking: Client) -> None:
    samples = locking.collect("sweep/table")
    begin(locking)
    with pytest.raises(ConfigError, match="a sweep is running"):  # at once: all is over in half a second
        locking.set_parameters("stepped_sine", {"reference": "current"})
    locking.wait_until(lambda: status(locking).startswith("finished, the resonance is at 9.10"), "the end", 60.0)
    rows = samples.rows()
    assert (np.diff(rows["time"]) > 0).all()
    held = rows[rows["locked"] == 1.0]
    assert held["time"][-1] - held["time"][0] >= 4.0
    true_hz = 9.105 / np.sqrt(1.0 - 4.0 * RigConfig().structure.damping_ratio ** 2)
    assert held["frequency"][-1] == pytest.approx(true_hz, abs=0.003)
    assert np.degrees(held["phase"][-1]) == pytest.approx(-90.0, abs=0.5)
    assert held["transmissibility"][-1] == pytest.approx(abs(transmissibility(RigConfig(), true_hz)), rel=0.01)
    locking.wait_until(lambda: current_now(locking) == 0.0, "the shaker at rest")


@pytest.mark.parametrize("cause", ["operator", "stranger"])
def test_a_lock_that_cannot_continue_reports_the_reason_and_stops_the_drive(locking: Client, cause: str) -> None:
    locking.collect("shaker/applied")
    begin(locking)
    locking.wait_until(lambda: current_now(locking) > 0, "the first command")
    if cause == "operator":
        locking.trigger("stepped_sine/stop")
        words = "aborted: stopped by the operator"
    else:
        locking.command(frequency_hz=33.0)
        words = "aborted: another client set 33 Hz"
    locking.wait_until(lambda: status(locking).startswith(words), words)
    locking.wait_until(lambda: current_now(locking) == 0.0, "the shaker at rest")


@pytest.mark.parametrize("cause", ["trip", "operator", "stranger"])
def test_a_sweep_that_cannot_continue_reports_the_reason_and_stops_the_drive(sweeping: Client, cause: str) -> None:
    sweeping.collect("shaker/applied")
    begin(sweeping)
    sweeping.wait_until(lambda: current_now(sweeping) > 0, "the first command")
    if cause == "trip":
        sweeping.trigger("rig/stop")
        words = "aborted: the rig was stopped"
    elif cause == "operator":
        sweeping.trigger("stepped_sine/stop")
        words = "aborted: stopped by the operator"
    else:
        sweeping.command(frequency_hz=33.0)
        words = "aborted: another client set 33 Hz and the amplitude 0.52; only one client may command the drive"
    sweeping.wait_until(lambda: status(sweeping) == words, words)
    assert sweeping.status("stepped_sine").level == b"\x02"
    sweeping.wait_until(lambda: current_now(sweeping) == 0.0, "the shaker at rest")


def test_no_sweep_starts_before_the_node_is_active(client: Client) -> None:
    client.host(SteppedSineNode, parameter_overrides=ros_parameters({"autostart": False}))
    with pytest.raises(ServiceFailedError, match="the node is unconfigured: configure and activate it first"):
        client.trigger("stepped_sine/start")


def test_no_sweep_starts_without_a_rig(client: Client) -> None:
    client.host(SteppedSineNode, parameter_overrides=ros_parameters({"begin": True}))
    client.wait_active("stepped_sine")
    client.wait_until(lambda: "no rig subscribes" in status(client), "a reason")
    with pytest.raises(ServiceFailedError, match="no rig subscribes"):
        client.trigger("stepped_sine/start")
    assert client.trigger("stepped_sine/stop") == "the sweep that waited to begin is cancelled"
    assert client.trigger("stepped_sine/stop") == "no sweep is running"


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"frequencies_hz": [9.0, 9.0]}, "must not repeat"),
        ({"frequencies_hz": [9.0, -1.0]}, "> 0 and <= 10000, got -1.0 Hz"),
        ({"frequencies_hz": ["9"]}, "one or more numbers"),
        ({"current_a": float("nan")}, "current_a must be > 0"),
        ({"direction": "sideways"}, "one of up, down, up_down"),
        ({"hold": "breath"}, "one of command, current, base, superior, phase"),
        ({"hold": "phase", "frequencies_hz": [3.0]}, r"first frequency of .* must be > 5 and < 20 Hz, .*, got 3"),
        ({"reference": "sphere"}, "one of base, current"),
        ({"within_deg": 0.0}, "within_deg must be > 0"),
    ],
)
def test_an_invalid_plan_is_rejected_by_name(client: Client, values: dict[str, object], words: str) -> None:
    client.host(SteppedSineNode)
    client.wait_active("stepped_sine")
    with pytest.raises(ConfigError, match=words):
        client.set_parameters("stepped_sine", values)  # type: ignore[arg-type]  # bad on purpose
