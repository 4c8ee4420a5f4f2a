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
"""Bags of other drivers as sources: every storage and message type gives the right signals, or the true reason."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from impact_rig.cli.main import main
from impact_rig.errors import ImpactRigError
from impact_rig.recording import open_run
from impact_rig.runs import reanalysis
from impact_rig_studies.importing import readers
from impact_rig_studies.importing.assignment import guess
from impact_rig_studies.importing.conversion import convert
from impact_rig_studies.importing.mapping import refined
from impact_rig_studies.importing.readers.bag import is_bag
from impact_rig_studies.importing.store import write

pytest.importorskip("rosbags")
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore

pytestmark = pytest.mark.heavy

RATE_HZ, HZ, DT, PHASE = 125, 9.1, 10.0, np.radians(-40.0)
BEGIN_NS = 1_700_000_000_000_000_000
TIME_S = np.arange(1000) / RATE_HZ
OMEGA = 2 * np.pi * HZ
BASE = 1e-4 * np.sin(OMEGA * TIME_S)
ROS_2, ROS_1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
STORAGES = ("mcap", "sqlite3", "ROS 1")


def laser(time_s: Any) -> Any:
    return DT * 1e-4 * np.sin(OMEGA * time_s + PHASE)


Stamped = Iterator[tuple[str, str, int, dict[str, Any]]]  # topic, type, log time, fields that are not zero


def message(store: Any, kind: str, fields: dict[str, Any]) -> Any:
    """Return a message whose fields are zero except for these; a header takes a stamp in nanoseconds."""
    definition = store.types[kind]
    values: dict[str, Any] = {}
    for name, (what, of) in store.fielddefs[kind][1]:
        if name == "header":
            stamp = store.types["builtin_interfaces/msg/Time"](*divmod(int(fields["header"]), 10**9))
            seq = {"seq": 0} if store is ROS_1 else {}
            values[name] = store.types["std_msgs/msg/Header"](**seq, stamp=stamp, frame_id="sensor")
        elif name in fields and not isinstance(fields[name], dict):
            values[name] = fields[name]
        elif what.name == "NAME":
            values[name] = message(store, of, fields.get(name, {}))
        elif what.name == "ARRAY":
            values[name] = np.zeros(of[1])
        elif what.name == "SEQUENCE":
            values[name] = np.zeros(0) if "float" in str(of) else []
        else:
            values[name] = "" if of[0] == "string" else False if of[0] == "bool" else 0.0 if "float" in of[0] else 0
    return definition(**values)


def bag(folder: Path, storage: str, messages: Stamped) -> Path:
    """Write a bag; return the path to import."""
    store = ROS_1 if storage == "ROS 1" else ROS_2
    path = folder / ("own.bag" if store is ROS_1 else "own")
    plugins = {"mcap": rosbag2.StoragePlugin.MCAP, "sqlite3": rosbag2.StoragePlugin.SQLITE3}
    writer: Any = (
        rosbag1.Writer(path) if store is ROS_1 else rosbag2.Writer(path, version=9, storage_plugin=plugins[storage])
    )
    connections: dict[str, Any] = {}
    encode: Callable[[Any, str], Any] = store.serialize_ros1 if store is ROS_1 else store.serialize_cdr
    with writer:
        for topic, kind, log_ns, fields in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(connections[topic], log_ns, encode(message(store, kind, fields), kind))
    return path


def vector(value: float) -> dict[str, Any]:
    return {"x": float(value)}


def two_imus() -> Stamped:
    for place, time_s in enumerate(TIME_S):
        stamp = BEGIN_NS + round(time_s * 1e9)
        late = stamp + 2_000_000 + 500_000 * (place % 3)  # receipt jitters, stamps do not
        for topic, x in (("/base/imu", BASE[place]), ("/top/imu", laser(time_s))):
            fields = {"header": stamp, "linear_acceleration": vector(-(OMEGA**2) * x)}
            yield topic, "sensor_msgs/msg/Imu", late, fields
        if place % 100 == 0:
            yield "/log", "std_msgs/msg/String", late, {"data": "running"}


def dt_of(source: Any, folder: Path, mapping: str) -> np.void:
    run = write(convert(source, refined(guess(source), mapping)), folder / "run")
    with open_run(run) as found:
        return reanalysis.rows(reanalysis.measurements(reanalysis.analyze(found)))[-1]


def check(row: np.void) -> None:
    assert abs(row["transmissibility"] - DT) < max(2 * row["transmissibility_uncertainty"], 1e-4)
    assert row["phase"] == pytest.approx(PHASE, abs=1e-3)


@pytest.mark.parametrize("storage", STORAGES)
def test_two_imus_of_a_bag_are_imported(tmp_path: Path, storage: str) -> None:
    found = readers.read(bag(tmp_path, storage, two_imus()))
    assert found.signals["base/imu linear_acceleration.x"].unit == "m/s^2"
    assert found.signals["top/imu angular_velocity.z"].unit == "rad/s"
    assert found.left_out == {"/log": "std_msgs/msg/String holds no numbers"}
    assert not any("covariance" in name for name in found.signals)
    assert found.start_ns == BEGIN_NS
    check(
        dt_of(
            found, tmp_path,
            "channels: {base: {column: base/imu linear_acceleration.x, unit: m/s^2}, "
            "laser: {column: top/imu linear_acceleration.x, unit: m/s^2}}",
        )
    )  # fmt: skip


@pytest.mark.parametrize("lengths", [(0, 2, 2), (2, 0, 2), (1, 2)], ids=str)
def test_a_topic_whose_messages_differ_in_length_is_left_out(tmp_path: Path, lengths: tuple[int, ...]) -> None:
    def messages() -> Stamped:
        for place, length in enumerate(lengths):
            yield "/own", "std_msgs/msg/Float64MultiArray", BEGIN_NS + place, {"data": np.ones(length)}
            yield "/other", "std_msgs/msg/Float64", BEGIN_NS + place, {"data": 1.0}

    found = readers.read(bag(tmp_path, "mcap", messages()))
    assert found.left_out == {"/own": "its messages differ in their number of values"}
    assert list(found.signals) == ["other"]


def numbers(kind: str) -> Stamped:
    """Yield two topics of one number each, as a driver of each kind does."""
    for time_s, x_b in zip(TIME_S, BASE, strict=True):
        stamp = BEGIN_NS + round(time_s * 1e9)
        for topic, value in (("/base", x_b), ("/laser", laser(time_s))):
            fields: dict[str, Any] = {"data": float(value)}
            if kind.endswith("Range"):
                fields = {"header": stamp, "range": float(value)}
            elif kind.endswith("PointStamped"):
                fields = {"header": stamp, "point": vector(value)}
            elif kind.endswith("JointState"):
                fields = {"header": stamp, "name": ["x", "y"], "position": np.array([value, 0.0])}
            elif kind.endswith("MultiArray"):
                fields = {"data": np.array([value, 1.0])}
            yield topic, kind, stamp, fields


@pytest.mark.parametrize(
    ("kind", "field", "unit"),
    [
        ("std_msgs/msg/Float64", "", ""), ("std_msgs/msg/Float32", "", ""), ("sensor_msgs/msg/Range", " range", "m"),
        ("geometry_msgs/msg/PointStamped", " point.x", "m"), ("sensor_msgs/msg/JointState", " position[x]", ""),
        ("std_msgs/msg/Float64MultiArray", " data[0]", ""),
    ],
)  # fmt: skip
@pytest.mark.parametrize("storage", STORAGES)
def test_messages_with_single_numbers_are_imported(
    tmp_path: Path, storage: str, kind: str, field: str, unit: str
) -> None:
    """18 variants."""
    found = readers.read(bag(tmp_path, storage, numbers(kind)))
    assert found.signals[f"laser{field}"].unit == unit
    assert any("those of their receipt" in one for one in found.remarks) == kind.startswith("std_msgs")
    columns = f"channels: {{base: {{column: 'base{field}', unit: m}}, laser: {{column: 'laser{field}', unit: m}}}}"
    check(dt_of(found, tmp_path, columns))


def clouds(rows: int, *, timed: bool) -> Stamped:
    """Yield blocks of scans as a `PointCloud2`, in float32 and with padding."""
    layout = np.dtype({
        "names": ["time", "base", "laser"], "formats": ["<f4", "<f8", "<f4"], "offsets": [0, 4, 12], "itemsize": 20
    })  # fmt: skip
    kinds = {"<f4": 7, "<f8": 8}
    for first in range(0, len(TIME_S), rows):
        part = slice(first, first + rows)
        block = np.zeros(len(TIME_S[part]), layout)
        block["time"], block["base"], block["laser"] = (
            TIME_S[part] - TIME_S[first], BASE[part], laser(TIME_S[part])
        )  # fmt: skip
        fields = [
            ROS_2.types["sensor_msgs/msg/PointField"](name, int(kind[1]), kinds[str(kind[0])], 1)
            for name, kind in ((name, (layout.fields[name][0].str, layout.fields[name][1])) for name in layout.names)
            if timed or name != "time"
        ]
        stamp = BEGIN_NS + round(TIME_S[first] * 1e9)
        yield "/daq", "sensor_msgs/msg/PointCloud2", stamp, {
            "header": stamp, "height": 1, "width": len(block), "fields": fields, "point_step": 20,
            "row_step": 20 * len(block), "data": np.frombuffer(block.tobytes(), np.uint8),
        }  # fmt: skip


@pytest.mark.parametrize(("rows", "timed"), [(50, True), (7, True), (1, True), (1, False)])
@pytest.mark.parametrize("storage", STORAGES[:2])
def test_blocks_of_scans_are_imported(tmp_path: Path, storage: str, rows: int, timed: bool) -> None:
    found = readers.read(bag(tmp_path, storage, clouds(rows, timed=timed)))
    assert list(found.signals) == ["daq base", "daq laser"]
    check(dt_of(found, tmp_path, "channels: {base: {column: daq base, unit: m}, laser: {column: daq laser, unit: m}}"))


def test_a_cloud_of_points_in_space_is_not_imported_as_a_series(tmp_path: Path) -> None:
    with pytest.raises(ImpactRigError, match="no signal of numbers: /daq: a point cloud without a column `time`"):
        readers.read(bag(tmp_path, "mcap", clouds(50, timed=False)))


def test_topics_with_different_instants_are_resampled_to_common_times(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A laser at 100 Hz and an accelerometer at 125 Hz have no scans at the times of the other."""

    def both() -> Stamped:
        for time_s in TIME_S:
            stamp = BEGIN_NS + round(time_s * 1e9)
            acceleration = -(OMEGA**2) * 1e-4 * np.sin(OMEGA * time_s)
            fields = {"header": stamp, "linear_acceleration": vector(acceleration)}
            yield "/imu", "sensor_msgs/msg/Imu", stamp, fields
        for time_s in np.arange(13, 790) / 100.0 + 0.0033:
            stamp = BEGIN_NS + round(time_s * 1e9)
            yield "/laser", "sensor_msgs/msg/Range", stamp, {"header": stamp, "range": float(laser(time_s))}

    path = bag(tmp_path, "mcap", both())
    channels = ["--channel", "base=imu linear_acceleration.x", "--channel", "laser=laser range"]
    words = ["import", str(path), "--output", str(tmp_path / "run"), *channels]
    assert main(words) == 1
    assert "resample them to one (--resample HZ)" in " ".join(capsys.readouterr().err.split())
    assert main([*words, "--resample", "500"]) == 0
    with open_run(tmp_path / "run") as found:
        row = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(found)))[-1]
    assert row["transmissibility"] == pytest.approx(DT, rel=2e-3)
    assert row["phase"] == pytest.approx(PHASE, abs=2e-3)


def test_a_small_constant_delay_of_stamps_is_corrected_as_skew(tmp_path: Path) -> None:
    """A delay of less than half a period must be corrected: 3 ms at 9.1 Hz are ten degrees."""

    def both() -> Stamped:
        for time_s, x_b in zip(TIME_S, BASE, strict=True):
            stamp = BEGIN_NS + round(time_s * 1e9)
            yield "/base", "sensor_msgs/msg/Range", stamp, {"header": stamp, "range": float(x_b)}
            late = time_s + 0.003
            stamp = BEGIN_NS + round(late * 1e9)
            yield "/laser", "sensor_msgs/msg/Range", stamp, {"header": stamp, "range": float(laser(late))}

    found = readers.read(bag(tmp_path, "mcap", both()))
    check(
        dt_of(
            found, tmp_path, "channels: {base: {column: base range, unit: m}, laser: {column: laser range, unit: m}}"
        )
    )  # fmt: skip


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("left", [0.0, 0.3, 0.9])
def test_a_truncated_bag_is_an_error(tmp_path: Path, storage: str, left: float) -> None:
    path = bag(tmp_path, storage, two_imus())
    file = path if path.is_file() else next(one for one in path.iterdir() if one.suffix in (".mcap", ".db3"))
    content = file.read_bytes()
    file.write_bytes(content[: round(left * len(content))])
    with pytest.raises(ImpactRigError):
        readers.read(path)


def test_a_folder_without_a_bag_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ImpactRigError, match=r"its suffix must be one of|is a directory"):
        readers.read(tmp_path)


def test_a_directory_with_a_bag_in_capital_letters_is_a_bag(tmp_path: Path) -> None:
    assert not is_bag(tmp_path)
    (tmp_path / "X.MCAP").touch()
    assert is_bag(tmp_path)
    assert is_bag(tmp_path / "X.MCAP")
