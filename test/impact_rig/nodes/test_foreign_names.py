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
"""Names and values from the network: a recorder stays in its directory; diagnostics and logs stay short and plain."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy", reason="no ROS 2 here")

from kits.hostile_names import HOSTILE_NAMES
from kits.nodes import host_rig
from rclpy.parameter import Parameter

from impact_rig.client import Client
from impact_rig.client.client import ros_parameters
from impact_rig.errors import ImpactRigError
from impact_rig.names import LONGEST_LINE, file_name
from impact_rig.nodes.recorder_node import RecorderNode

pytestmark = pytest.mark.ros

LEAVING = [name for name in HOSTILE_NAMES if "/" in name or not name.isprintable() or name.startswith((".", "-"))]


def test_a_recorder_rejects_a_name_that_is_not_a_plain_file_name(client: Client, tmp_path: Path) -> None:
    directory = tmp_path / "runs"
    settings = {"directory": str(directory), "record": False, "configuration_wait_s": 0.0}  # there is no rig
    node = client.host(RecorderNode, parameter_overrides=ros_parameters(settings))
    client.wait_active("recorder")
    for name in ["../x", "/abs", *LEAVING]:
        result = node.set_parameters([Parameter("name", value=name)])[0]
        assert not result.successful, name
        assert "name must be a" in result.reason
        assert result.reason.isprintable()
    for name in ("run 2", "gap_2.5mm", "messung_ü"):
        assert node.set_parameters([Parameter("name", value=name)])[0].successful, name
        client.trigger("recorder/start")
        client.trigger("recorder/stop")
        assert (directory / name).is_dir()
    assert {path.name for path in tmp_path.iterdir()} == {"runs"}


@pytest.mark.parametrize("name", ["../x", "\x1b[31mrun"], ids=file_name)
def test_a_recorder_that_starts_with_such_a_name_is_not_configured(client: Client, tmp_path: Path, name: str) -> None:
    node = client.host(RecorderNode, parameter_overrides=ros_parameters({"directory": str(tmp_path), "name": name}))
    client.wait_until(lambda: "name must be a file name" in client.status("recorder").message, "the refusal")
    assert node.state == "unconfigured"
    assert list(tmp_path.iterdir()) == []


def test_a_recorder_does_not_record_through_a_link(client: Client, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "runs").mkdir()
    (tmp_path / "runs" / "run").symlink_to(tmp_path / "elsewhere")
    overrides = {"directory": str(tmp_path / "runs"), "name": "run", "record": False}
    client.host(RecorderNode, parameter_overrides=ros_parameters(overrides))
    client.wait_active("recorder")
    with pytest.raises(ImpactRigError, match="links are not followed for writing"):
        client.trigger("recorder/start")
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_diagnostics_do_not_repeat_a_rejected_value_of_megabytes(client: Client, tmp_path: Path) -> None:
    node = host_rig(client)
    client.wait_active("rig")
    huge = f"\x1b[31m{'x' * 3_000_000}"
    for name in ("contact.law", "sphere.start", huge):
        result = node.set_parameters([Parameter(name, value=huge)])[0]
        assert not result.successful
        assert len(result.reason) <= LONGEST_LINE + 100
        assert result.reason.isprintable()
    client.wait_until(lambda: "unknown key" in client.figures("rig").get("last_refused.parameter", ""), "the refusal")
    status = client.status("rig")
    texts = [status.message, *(text for item in status.values for text in (item.key, item.value))]
    assert max(map(len, texts)) <= LONGEST_LINE + 100
    assert all(text.isprintable() for text in texts)
