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
"""Check of the JavaScript reader @mcap/core: it must read the same bytes and values from a run as were written.

    python -m qualification.check_mcap_js.check [RUN]

It needs node >= 18 and npm, and installs the pinned npm packages into build/check_mcap_js on first use. Without RUN it
records a small run with every message type that the rig publishes. Values are compared with those of rosbags.
"""

# ruff: noqa: S603, S607, T201  (a developer's script: it runs node and npm from the path and prints)
from __future__ import annotations

import argparse
import dataclasses
import hashlib
import json
import math
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from pathlib import Path

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from impact_rig import codec
from impact_rig.blocks import Table
from impact_rig.instruments.section import SCAN
from impact_rig.recording import (
    Attachment,
    OfferedQos,
    Provenance,
    Run,
    RunWriter,
    TopicDescription,
    open_run,
    schema_text,
)

HERE = Path(__file__).resolve().parent
BUILD = HERE.parents[1] / "build" / "check_mcap_js"
TYPES = {
    "/rig/accelerometer": "sensor_msgs/msg/Imu",
    "/rig/laser": "sensor_msgs/msg/Range",
    "/rig/base_displacement": "geometry_msgs/msg/Vector3Stamped",
    "/rig/truth/joint_states": "sensor_msgs/msg/JointState",
    "/rig/transmissibility": "std_msgs/msg/Float64",
    "/rig/notes": "std_msgs/msg/String",
    "/rig/daq/ack": "std_msgs/msg/Header",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
    "/clock": "rosgraph_msgs/msg/Clock",
}


def sample(store: Typestore, type_name: str, rng: np.random.Generator) -> object:
    """Return a message of a type with a value in every field."""
    values = []
    for _, (kind, detail) in store.fielddefs[type_name][1]:
        if kind == Nodetype.BASE:
            values.append(_basic(detail[0], rng))
        elif kind == Nodetype.NAME:
            values.append(sample(store, detail, rng))
        else:
            (inner, inner_detail), length = detail
            count = length or 3
            if inner == Nodetype.NAME:
                values.append([sample(store, inner_detail, rng) for _ in range(count)])
            elif inner_detail[0] == "string":
                values.append([_basic("string", rng) for _ in range(count)])
            else:
                values.append(rng.integers(0, 100, count).astype(inner_detail[0]))
    return store.types[type_name](*values)


def _basic(name: str, rng: np.random.Generator) -> object:
    if name == "string":
        return f"µ{rng.integers(1000)}"
    if name == "bool":
        return bool(rng.integers(2))
    if name.startswith("float"):
        return float(np.dtype(name).type(rng.normal()))
    return int(rng.integers(0, 100))


def record(directory: Path, store: Typestore) -> None:
    """Record a few messages of every type, in two files."""
    rng = np.random.default_rng(1)
    with RunWriter(
        directory,
        provenance=Provenance(version="check", seed=1, wall_start_ns=0),
        attachments=[Attachment("config.yaml", b"a: 1\n", "application/yaml")],
        clock=time.monotonic,
        max_file_duration_ns=500_000_000,
        chunk_bytes=20_000,
    ) as writer:
        scan = "sensor_msgs/msg/PointCloud2"
        for name, type_name in {"/rig/daq/scan": scan, **TYPES}.items():
            writer.add_topic(
                TopicDescription(
                    name=name,
                    type_name=type_name,
                    schema=schema_text(type_name),
                    type_hash=store.hash_rihs01(type_name),
                    offered_qos=(OfferedQos(),),
                )
            )
        for number in range(100):
            rows = np.zeros(100, SCAN)
            rows["time"] = np.arange(100) / 10_000
            rows["laser"] = np.where(rng.random(100) < 0.1, np.nan, rng.normal(size=100))
            writer.write("/rig/daq/scan", codec.encode(Table(number * 10_000_000, rows)), number, number)
            if number % 10 == 0:
                for name, type_name in TYPES.items():
                    message = store.serialize_cdr(sample(store, type_name, rng), type_name)
                    writer.write_at(name, bytes(message), number * 10_000_000, number, number)


def expected(run: Run, store: Typestore) -> dict[str, dict[str, object]]:
    """Return the contents that `read.mjs` must find, by topic."""
    hashes = {name: hashlib.sha256() for name in run.topics}
    decoded: dict[str, list[object]] = defaultdict(list)
    for message in run.messages():
        head = f"{message.log_time} {message.publish_time} {message.sequence} {len(message.data)}\n"
        hashes[message.topic].update(head.encode() + message.data)
        decoded[message.topic].append(_plain(store.deserialize_cdr(message.data, message.type_name), store))
    return {
        name: {
            "type": found.topic.type_name,
            "schema_encoding": "ros2msg",
            "message_encoding": "cdr",
            "metadata": found.topic.channel_metadata(),
            "hash": hashes[name].hexdigest(),
            "decoded": decoded[name],
        }
        for name, found in run.topics.items()
        if found.count
    }


def _plain(value: object, store: Typestore) -> object:
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(inner, store) for inner in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, float) and not math.isfinite(value):
        return {"nan": "NaN", "inf": "Infinity", "-inf": "-Infinity"}[str(value)]
    if dataclasses.is_dataclass(value):
        constants = {name for name, _, _ in store.fielddefs[value.__msgtype__][0]}
        names = [field.name for field in dataclasses.fields(value) if field.name not in constants | {"__msgtype__"}]
        return {name: _plain(getattr(value, name), store) for name in names}
    return value


def install() -> None:
    """Install the pinned packages next to a copy of the script."""
    if shutil.which("node") is None or shutil.which("npm") is None:
        sys.exit("node and npm are needed for this check")
    BUILD.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "read.mjs"):
        shutil.copy(HERE / name, BUILD / name)
    subprocess.run(["npm", "install", "--no-audit", "--no-fund", "--silent", "--ignore-scripts"], cwd=BUILD, check=True)


def main() -> None:
    """Record or open a run, read it with both readers, and compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", nargs="?", type=Path, help="run to read (default: a new one)")
    given = parser.parse_args().run
    install()
    store = get_typestore(Stores.ROS2_JAZZY)
    with tempfile.TemporaryDirectory() as scratch:
        path = given or Path(scratch) / "run"
        if not given:
            record(path, store)
        with open_run(path) as run:
            wanted = expected(run, store)
            files = [str(source.path.resolve()) for source in run.sources]
            attachments = {name: len(data) for name, data in run.attachments().items()}
        output = subprocess.run(["node", "read.mjs", *files], cwd=BUILD, check=True, capture_output=True, text=True)
    found = json.loads(output.stdout)
    failures = [f"{name}: missing" for name in wanted.keys() - found["topics"].keys()]
    failures += [f"{name}: not recorded" for name in found["topics"].keys() - wanted.keys()]
    for name in sorted(wanted.keys() & found["topics"].keys()):
        differing = [key for key, value in wanted[name].items() if found["topics"][name].get(key) != value]
        failures += [f"{name}: {key} differs" for key in differing]
        print(f"{name:32} {wanted[name]['type']:36} {run.topics[name].count:6} messages")
    if set(found["profiles"]) != {"ros2"} or found["attachments"] != attachments or "rosbag2" not in found["metadata"]:
        failures.append("profile, attachments or metadata differ")
    sys.exit("\n".join(failures) if failures else None)


if __name__ == "__main__":
    main()
