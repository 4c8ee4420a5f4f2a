"""The recorder writes every message it gets, says what it cannot, and never holds up the rig."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

pytest.importorskip("rclpy", reason="no ROS 2 here")

from nodes_support import host_rig

from impact_rig.nodes.recorder_node import RecorderNode
from impact_rig.recording import open_run
from impact_rig.testing import Client, ServiceFailedError
from impact_rig.testing.parameters import ros_parameters

pytestmark = pytest.mark.ros


def host_recorder(client: Client, directory: Path, **values: object) -> RecorderNode:
    return client.host(
        RecorderNode, parameter_overrides=ros_parameters({"directory": str(directory), "name": "run", **values})
    )


def recording(client: Client) -> bool:
    return client.status("recorder").message == "recording"


def test_a_run_holds_every_message_and_the_configuration(client: Client, tmp_path: Path) -> None:
    recorder = host_recorder(client, tmp_path)
    host_rig(client, time__peers=["recorder"], daq__seed=77, barriers__gap_m=0.002)
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: recording(client), "the recorder")
    client.command(frequency_hz=9.1, current_a=0.52)
    client.note("first light")
    client.step(50)
    client.trigger("recorder/stop")
    assert not any(recorder._lost.values())
    with open_run(tmp_path / "run") as run:
        assert run.topics[run.resolve("daq/scan")].count == 50
        assert run.provenance["seed"] == "77"
        assert run.provenance["mode"] == "stepped"
        assert b"gap_m: 0.002" in run.attachments()["config.yaml"]
        stamps = [table.stamp_ns for table in run.tables("daq/scan")]
        assert stamps == [k * 10_000_000 for k in range(50)]
        names = {name.lstrip("/") for name in run.topics}
        assert names >= {"daq/info", "rig/journal", "rig/configuration", "shaker/applied", "accelerometer", "notes"}
        journal = [row["kind"] for table in run.tables("rig/journal") for row in table.rows]
        assert journal == [b"start", b"initial", b"initial", b"command", b"command"]
        times = [message.log_time for message in run.messages()]
        assert max(times) < 10**9, "rig time, not the system's"


def test_nothing_is_overwritten_and_the_rig_goes_on(client: Client, tmp_path: Path) -> None:
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metadata.yaml").write_text("precious")
    host_recorder(client, tmp_path)
    host_rig(client, time__peers=["recorder"])
    client.wait_until(lambda: client.status("recorder").message.startswith("recording stopped"), "the reason")
    client.wait_active("rig", "recorder")
    client.step(30)
    with pytest.raises(ServiceFailedError, match="run"):
        client.trigger("recorder/start")
    assert (tmp_path / "run" / "metadata.yaml").read_text() == "precious"
    client.set_parameters("recorder", {"name": "other"})
    client.trigger("recorder/start")
    client.step(3)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "other") as run:
        assert run.topics[run.resolve("daq/scan")].count == 3
        assert run.topics[run.resolve("rig/journal")].count == 1, "what came before the start but belongs to the run"


def test_start_and_stop_in_every_state(client: Client, tmp_path: Path) -> None:
    host_recorder(client, tmp_path, record=False, configuration_wait_s=0.0)
    client.wait_active("recorder")
    assert "nothing" in client.trigger("recorder/stop")
    client.trigger("recorder/start")
    with pytest.raises(ServiceFailedError, match="already recording"):
        client.trigger("recorder/start")
    assert client.change_state("recorder", "deactivate")
    with pytest.raises(ServiceFailedError, match="inactive"):
        client.trigger("recorder/start")
    with open_run(tmp_path / "run") as run:
        assert run.attachments()["environment.json"]


def test_the_calibration_is_attached_for_people(client: Client, tmp_path: Path) -> None:
    host_recorder(client, tmp_path)
    host_rig(client, time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    client.wait_until(lambda: recording(client), "the recorder")
    client.step(5)
    client.set_parameters("rig", {"instruments.laser.lag_s": 0.001})
    client.step(5)
    client.trigger("recorder/stop")
    with open_run(tmp_path / "run") as run:
        found = run.attachments()
        certificates = [table.rows for table in run.tables("daq/info")]
    first, second = (yaml.safe_load(found[name]) for name in ("calibration.yaml", "calibration_2.yaml"))
    assert list(first["channels"]) == ["accelerometer", "laser", "base", "current"]
    assert first["channels"]["laser"]["lag"] == certificates[0]["lag"][1]
    assert second["channels"]["laser"]["lag"] == certificates[1]["lag"][1] == 0.001


def test_a_directory_that_cannot_be_is_refused_and_the_node_goes_on(client: Client, tmp_path: Path) -> None:
    host_recorder(client, tmp_path, record=False)
    host_rig(client, time__peers=["recorder"])
    client.wait_active("rig", "recorder")
    client.step(1)
    client.set_parameters("recorder", {"directory": "~nobody_of_that_name/runs"})
    with pytest.raises(ServiceFailedError, match="nobody_of_that_name/runs' cannot be used"):
        client.trigger("recorder/start")
    client.set_parameters("recorder", {"directory": str(tmp_path)})
    assert client.trigger("recorder/start") == str(tmp_path / "run")
