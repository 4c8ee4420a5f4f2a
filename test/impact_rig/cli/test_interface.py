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
"""Changes of the interface that break a client; `test/test_generated.py` compares the document with the code."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from impact_rig.cli import main
from impact_rig.cli.interface import DOCUMENT, differences, read
from impact_rig.errors import ConfigError

Document = dict[str, Any]
PRESENT = read(DOCUMENT)


def topic(name: str, **changes: object) -> Callable[[Document], None]:
    return lambda document: document["topics"][name].update(changes)


def column(name: str, topic: str, **changes: object) -> Callable[[Document], None]:
    return lambda document: document["topics"][topic]["columns"].setdefault(name, {}).update(changes)


def parameter(name: str, **changes: object) -> Callable[[Document], None]:
    return lambda document: document["parameters"]["rig"].setdefault(name, {}).update(changes)


def without(*path: str) -> Callable[[Document], None]:
    def change(document: Document) -> None:
        for key in path[:-1]:
            document = document[key]
        del document[path[-1]]

    return change


BREAKS = [
    (without("topics", "daq/scan"), "topic daq/scan was removed"),
    (topic("laser", type="std_msgs/msg/Float64"), "topic laser: type was"),
    (topic("laser", frame="table"), "topic laser: frame was"),
    (topic("daq/info", durability="volatile"), "topic daq/info: durability was"),
    (topic("daq/scan", reliability="best effort"), "topic daq/scan: reliability was"),
    (topic("rig/journal", depth=10), "topic rig/journal: depth was 5000, is 10"),
    (without("topics", "daq/scan", "reliability"), "topic daq/scan: reliability was"),
    (without("topics", "rig/journal", "depth"), "topic rig/journal: depth was 5000, is not stated"),
    (topic("shaker/current", durability="transient local"), "topic shaker/current: durability was"),
    (topic("notes", publisher="rig"), "topic notes: publisher was"),
    (without("topics", "impacts", "columns", "time"), "topic impacts, column time was removed"),
    (column("laser", "daq/scan", type="FLOAT32"), "topic daq/scan, column laser: type was"),
    (column("laser", "daq/scan", unit="mm"), 'topic daq/scan, column laser: unit was "m", is "mm"'),
    (column("more", "shaker/waveform", required=True), "topic shaker/waveform, column more is new and required"),
    (without("services", "rig/pause"), "service rig/pause was removed"),
    (lambda d: d["services"]["rig/pause"].update(type="std_srvs/srv/Trigger"), "service rig/pause: type was"),
    (without("parameters", "rig", "barriers.gap_m"), "parameter barriers.gap_m of rig was removed"),
    (parameter("barriers.gap_m", default=0.001), "parameter barriers.gap_m of rig: default was"),
    (parameter("barriers.gap_m", least=0.001), "parameter barriers.gap_m of rig: least was"),
    (parameter("barriers.gap_m", most=0.006), "parameter barriers.gap_m of rig: most was"),
    (parameter("barriers.gap_m", start_only=True), "parameter barriers.gap_m of rig: start_only was"),
    (parameter("contact.release", choices=["force"]), "parameter contact.release of rig: choices was"),
    (parameter("daq.seed", choices=[1, 2]), "parameter daq.seed of rig: choices was not stated, is [1, 2]"),
    (parameter("daq.seed", type="double"), "parameter daq.seed of rig: type was"),
]  # fmt: skip
NEW = [
    (topic("daq/scan", depth=10), "topic daq/scan: depth was 1000, is 10"),
    (topic("daq/scan", durability="transient local"), "topic daq/scan: durability was"),
    (column("more", "daq/scan", type="FLOAT64"), "topic daq/scan, column more is new"),
    (lambda d: d["topics"].update(more=d["topics"]["notes"]), "topic more is new"),
    (lambda d: d["services"].update({"rig/more": {"type": "std_srvs/srv/Trigger"}}), "service rig/more is new"),
    (parameter("more", default=1.0), "parameter more of rig is new"),
    (parameter("barriers.gap_m", most=2.0), "parameter barriers.gap_m of rig: most was"),
    (parameter("contact.release", choices=["position", "force", "x"]), "parameter contact.release of rig: choices was"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "said"), BREAKS + NEW, ids=lambda one: one if isinstance(one, str) else "")
def test_each_change_is_listed_by_name_and_by_whether_it_breaks_a_client(change: Callable[[Document], None], said: str):
    changed = copy.deepcopy(PRESENT)
    change(changed)
    breaks, other = differences(PRESENT, changed)
    one, none = (breaks, other) if (change, said) in BREAKS else (other, breaks)
    assert len(one) == 1
    assert one[0].startswith(said)
    assert not none


def test_the_description_of_a_row_is_not_part_of_the_interface():
    changed = copy.deepcopy(PRESENT)
    topic("daq/scan", doc="Other words.")(changed)
    assert differences(PRESENT, changed) == ([], [])


def test_the_command_prints_the_document_and_compares_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["interface", "--json"]) == 0
    (tmp_path / "same.json").write_text(capsys.readouterr().out)
    assert main(["interface", "--against", str(tmp_path / "same.json")]) == 0
    assert capsys.readouterr().out == "0 differences break a client of the older version, 0 do not\n"
    older = copy.deepcopy(PRESENT)
    older["services"]["rig/rewind"] = {"type": "std_srvs/srv/Trigger"}
    (tmp_path / "older.json").write_text(json.dumps(older))
    assert main(["interface", "--against", str(tmp_path / "older.json"), "--json"]) == 1
    assert json.loads(capsys.readouterr().out) == {
        "breaks": ["service rig/rewind was removed"], "other": [],
    }  # fmt: skip
    assert main(["interface"]) == 0
    assert "transmissibility/table" in capsys.readouterr().out


@pytest.mark.parametrize("text", ["[]", '[["topics", 1]]', "7"])
def test_a_document_is_a_json_object(text: str, tmp_path: Path):
    (tmp_path / "other.json").write_text(text)
    with pytest.raises(ConfigError, match="is not a document of"):
        read(tmp_path / "other.json")


@pytest.mark.parametrize(
    "text", ["", "[]", "7", '{"topics": {"a": 1}}', '{"topics": [], "services": 1}', "[" * 100_000]
)
def test_an_invalid_document_is_rejected_by_name(text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "other.json").write_text(text)
    assert main(["interface", "--against", str(tmp_path / "other.json")]) == 1
    assert "other.json" in capsys.readouterr().err
    assert main(["interface", "--against", str(tmp_path / "none.json")]) == 1
    assert f"document: No such file or directory ({tmp_path / 'none.json'})" in capsys.readouterr().err
