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
"""Promises of docs/explanation/security.md: local traffic by default, no code from data, and a policy that fits."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from impact_rig import codec
from impact_rig.client import Processes
from impact_rig.config import tree
from impact_rig.system import budget
from impact_rig_lab import protocol, server
from impact_rig_studies.campaign import axes

ROOT = Path(__file__).parents[1]
SOURCES = sorted(
    path
    for pattern in ("impact_rig*", "launch", "qualification", "tools", "benchmarks")
    for path in ROOT.glob(f"{pattern}/**/*.py")
)
MODULES = {"pickle", "cPickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
CALLS = {"eval", "exec", "yaml.load", "yaml.unsafe_load", "yaml.full_load", "os.system", "os.popen", "tempfile.mktemp"}
ARGUMENTS = {"shell", "allow_pickle"}
STARTERS = {
    "impact_rig/client/processes.py", "impact_rig/kernels/build.py", "impact_rig/embedded/fmu.py",
    "impact_rig/embedded/wasm.py",
}  # fmt: skip
"""The modules of the package that start programs: nodes; compilers, which open no network."""


def _dotted(node: ast.expr) -> str:
    """Return `a.b.c` as it is written, or nothing if a node is not a name; `ast.unparse` needs ten times as long."""
    if isinstance(node, ast.Attribute):
        return f"{_dotted(node.value)}.{node.attr}"
    return node.id if isinstance(node, ast.Name) else ""


def offences(path: Path) -> Iterator[str]:
    file = path.relative_to(ROOT)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import | ast.ImportFrom):
            where = f"{file}:{node.lineno}"
            names = [alias.name for alias in node.names] + [getattr(node, "module", None) or ""]
            yield from (f"{where} imports {name}" for name in names if name.split(".")[0] in MODULES)
        elif isinstance(node, ast.Call):
            where = f"{file}:{node.lineno}"
            called = _dotted(node.func)
            if called in CALLS:
                yield f"{where} calls {called}"
            for keyword in node.keywords:
                if keyword.arg in ARGUMENTS and not (
                    isinstance(keyword.value, ast.Constant) and not keyword.value.value
                ):
                    yield f"{where} passes {keyword.arg}={ast.unparse(keyword.value)}"


@pytest.mark.repeats
def test_no_module_executes_data_as_code() -> None:
    assert len(SOURCES) > 150
    assert [offence for path in SOURCES for offence in offences(path)] == []


def test_the_search_finds_planted_offences(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(globals(), "ROOT", tmp_path)
    bad = tmp_path / "bad.py"
    bad.write_text(
        "import pickle\nfrom marshal import loads\nyaml.load(x)\neval(y)\n"
        "run(z, shell=True)\nnp.load(a, allow_pickle=b)\n"
    )
    assert len(list(offences(bad))) == 6
    bad.write_text("yaml.safe_load(x)\nnp.load(a, allow_pickle=False)\nself.exec(1)\n")
    assert list(offences(bad)) == []


def test_started_programs_are_visible_only_on_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")
    assert Processes(1, tmp_path).environment({})["ROS_AUTOMATIC_DISCOVERY_RANGE"] == "LOCALHOST"
    assert '"discovery",\n                default_value="LOCALHOST"' in (ROOT / "launch" / "rig.launch.py").read_text()
    assert "export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST" in (ROOT / "Makefile").read_text()
    assert (
        'setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")' in (ROOT / "impact_rig/cli/recorded.py").read_text()
    )
    starters = {
        str(path.relative_to(ROOT))
        for path in ROOT.glob("impact_rig*/**/*.py")
        if "subprocess." in path.read_text(encoding="utf-8")
    }
    assert starters == STARTERS, "a module that starts programs must keep them on this machine, and be listed"


@pytest.mark.ros
def test_the_policy_allows_exactly_what_the_nodes_open(tmp_path: Path) -> None:
    """The nodes run as the launch file starts them, in a namespace, which has its own clock."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from kits.opened import opened_by

    from impact_rig import graph
    from tools import sros2_policy

    namespace = sros2_policy.NAMESPACE
    allowed = sros2_policy.rights()
    optional = {graph.resolve(name, namespace, "rig") for name in graph.SIMULATION_SERVICES.values()}
    for node, opened in opened_by(namespace, sros2_policy.CLOCK, str(tmp_path)).items():
        for kind, names in allowed[node].items():
            found = opened[kind]
            assert names - optional <= found <= names, f"{node} {kind}: {sorted(names ^ found)}"
        assert not opened["services", "request"]


@pytest.mark.ros
def test_the_policy_and_the_launch_file_agree() -> None:
    """The arguments of one are the defaults of the other: namespace, clock, enclaves."""
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from kits.launched import nodes

    from impact_rig import graph
    from tools import sros2_policy

    started = nodes(ROOT / "launch" / "rig.launch.py", enclave="/rig", mode="free_running")
    enclaves = {one.get("path"): one for one in ET.fromstring(sros2_policy.policy()).iter("enclave")}
    for name, node in started.items():
        profile = enclaves[node["ros_arguments"][node["ros_arguments"].index("--enclave") + 1]].find("profiles/profile")
        assert (profile.get("ns"), profile.get("node")) == (graph.resolve(node["namespace"]), name)
        clock = graph.resolve(dict(node["remappings"])["/clock"], node["namespace"])
        kind = "publish" if name == "rig" else "subscribe"
        assert clock in [topic.text for topic in profile.iterfind(f"topics[@{kind}='ALLOW']/topic")]
    assert not any("--enclave" in node["ros_arguments"] for node in nodes(ROOT / "launch" / "rig.launch.py").values())
    page = (ROOT / "docs" / "explanation" / "security.md").read_text(encoding="utf-8")
    made = re.search("for node in (.+); do", page)[1].split()
    assert {f"/rig/{name}" for name in made} == set(enclaves), "a node without an enclave does not start under Enforce"


@pytest.mark.ros
def test_a_policy_can_be_written_for_another_namespace_and_clock(capsys, monkeypatch) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from tools import sros2_policy

    monkeypatch.setattr("sys.argv", ["sros2_policy.py", "--namespace", "left/rig", "--clock", "/clock"])
    sros2_policy.main()
    policy = ET.fromstring(capsys.readouterr().out)
    assert policy.find(".//enclave[@path='/left/rig/analysis']") is not None
    analysis = [topic.text for topic in policy.iterfind(".//profile[@node='analysis']/topics[@subscribe]/topic")]
    assert "/left/rig/daq/scan" in analysis
    assert "/clock" in analysis


def test_the_stated_limits_are_those_of_the_code() -> None:
    page = (ROOT / "docs" / "explanation" / "security.md").read_text(encoding="utf-8")
    page = re.sub(r"(?<=\d)\s(?=\d{3})", ",", page)
    table = dict(re.findall(r"^\| (.+?) \| (.+?) \|$", page.partition("| read | bound |")[2], re.MULTILINE))
    mib, kib = budget.MIB, 1024
    stated = {
        "table (`PointCloud2`)": [f"{codec.MAX_COLUMNS} columns"],
        "configuration file": [
            f"{tree.MAX_FILE_BYTES / 1e6:g} MB", f"{tree.MAX_KEYS:,} keys", f"{tree.MAX_DEPTH} levels"
        ],
        "campaign file": [f"{axes.MAX_VALUES:,} values per axis", f"{budget.POINTS:,} points × n"],
        "MCAP chunk, or any other record": [f"{budget.CHUNK_BYTES // mib} MiB × n"],
        "MCAP chunks whose messages are not in order": [f"{budget.HELD_BYTES // mib} MiB × n"],
        "all chunks of a recording": [
            f"{budget.DECOMPRESSED_BYTES // mib} MiB + {budget.DECOMPRESSED_PER_BYTE} × the size",
            f"{budget.RECORDS:,} records",
        ],
        "index of an MCAP file; topics": [f"{budget.INDEX_BYTES // mib} MiB × n", f"{budget.TOPICS:,} × n"],
        "`metadata.yaml` of a run": [f"{budget.METADATA_BYTES // kib} KiB × n"],
        "quality of service in a recording": [f"{budget.QOS_CHARACTERS // mib} MiB × n"],
        "request of the lab's page": [f"{protocol.LONGEST_REQUEST // kib} KiB", f"{server.MAX_INVALID} malformed"],
    }  # fmt: skip
    for read, bounds in stated.items():
        for bound in bounds:
            assert bound in table[read], f"{read}: {bound}"
