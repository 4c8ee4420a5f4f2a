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
"""Reader of ROS bags of other drivers (rosbag2 with MCAP or SQLite, ROS 1), with rosbags.

Each field of numbers in the messages of a topic is a signal. The time of a value is the stamp in the message's header,
or the time of receipt if there is no stamp or the stamp is zero. In a `PointCloud2`, each column is a signal. Its
column `time` (or `t`) contains the time of each row since the message's stamp [s]. A topic with clouds of several rows
but without that column is left out, with a reason.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any  # messages of types that a bag defines itself

import numpy as np

from impact_rig.simtime import NS_PER_S
from impact_rig_studies.importing.limits import check_column_count, check_value_count
from impact_rig_studies.importing.signals import Abscissa, AbscissaKind, ImportedSignals, Signal, UniqueNames

SUFFIXES = (".mcap", ".db3", ".bag")
SCHEMALESS = "__schemaless__"  # name that rosbags gives the type of a channel with schema 0
CLOUD = "sensor_msgs/msg/PointCloud2"
UNITS = {
    ("sensor_msgs/msg/Imu", "linear_acceleration"): "m/s^2", ("sensor_msgs/msg/Imu", "angular_velocity"): "rad/s",
    ("geometry_msgs/msg/Accel", "linear"): "m/s^2", ("geometry_msgs/msg/Twist", "linear"): "m/s",
    ("geometry_msgs/msg/Accel", "angular"): "rad/s^2", ("geometry_msgs/msg/Twist", "angular"): "rad/s",
    ("geometry_msgs/msg/Pose", "position"): "m", ("geometry_msgs/msg/PointStamped", "point"): "m",
    ("geometry_msgs/msg/Transform", "translation"): "m", ("sensor_msgs/msg/Range", "range"): "m",
}  # fmt: skip
"""Units that the definitions of ROS messages state, by type of the message and name of the field."""
_DATATYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}  # of `PointField`
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_TIME_COLUMNS = ("time", "t")  # of a `PointCloud2`, since its stamp [s]
MOST_ELEMENTS = 32  # longest array in a message; each element is a signal


def is_bag(path: Path) -> bool:
    """Return whether a path is a ROS bag.

    A file is a bag if it has a suffix of bags. A directory is a bag if it contains such a file or `metadata.yaml`.
    """
    if path.is_dir():
        return any(one.name == "metadata.yaml" or one.suffix.lower() in SUFFIXES for one in path.iterdir())
    return path.suffix.lower() in SUFFIXES


def read(path: Path, file_bytes: int, library: ModuleType) -> ImportedSignals:
    """Read the numbers in the messages of a bag as signals, one for each field of each topic.

    A topic is left out completely, with the reason for the user, if its messages have no numbers or no schema. It is
    also left out if a message cannot be decoded, has other fields than the first message, or is a cloud of several rows
    without times. The result has no signals if all topics are left out.

    Raises:
        BudgetError: the messages have more numbers than a bag of `file_bytes` bytes may contain, or more than
            `limits.COLUMNS` fields.
    """
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415  # of an extra, loaded with the library

    series: dict[tuple[str, str], _Series] = {}
    # a bag of SQLite defines no types: the types of ROS itself are used
    with library.AnyReader([path], default_typestore=get_typestore(Stores.LATEST)) as reader:
        for connection, log_ns, data in reader.messages():
            one = series.setdefault((connection.topic, connection.msgtype), _Series())
            if connection.msgtype == SCHEMALESS:
                one.left_out = "it has no schema"
            if not one.left_out:
                try:
                    message = reader.deserialize(data, connection.msgtype)
                except Exception as error:  # any error that a definition or its bytes cause in the library
                    one.left_out = f"{connection.msgtype} cannot be decoded: {' '.join(str(error).split())[:120]}"
                else:
                    one.add(message, log_ns)
    check_value_count(sum(one.values for one in series.values()), file_bytes)
    signals: dict[str, Signal] = {}
    left_out: dict[str, str] = {}
    remarks: list[str] = []
    names = UniqueNames()
    kept = {key: one for key, one in series.items() if not one.left_out and one.columns}
    start_ns = min((one.stamps[0] for one in kept.values()), default=None)
    for (topic, kind), one in series.items():
        if (topic, kind) not in kept:
            left_out[topic] = one.left_out or f"{kind} holds no numbers"
            continue
        assert start_ns is not None
        if not one.is_stamped:
            remarks.append(f"messages of {topic} have no stamps: times are those of their receipt")
        stamps = np.frombuffer(one.stamps, np.int64)
        times = Abscissa(
            AbscissaKind.TIME,
            "s",
            (stamps[0] - start_ns) / NS_PER_S,
            values=(stamps - stamps[0]) / NS_PER_S,
            resolution=0.5 / NS_PER_S,
        )
        for field, values in one.columns.items():
            name = f"{topic.strip('/')} {field}" if field else topic.strip("/")
            signals[names.unique(name)] = Signal(
                np.frombuffer(values, np.float64), one.units.get(field, ""), times, origin=f"{topic} ({kind})"
            )
    check_column_count(len(signals))
    return ImportedSignals(path, "ROS bag", signals, start_ns, left_out=left_out, remarks=tuple(remarks))


class _Series:
    """Stamps and numbers collected from the messages of one topic."""

    def __init__(self) -> None:
        self.stamps = array("q")  # [ns]
        self.columns: dict[str, array[float]] = {}  # by field
        self.units: dict[str, str] = {}
        self.is_stamped = True
        self.left_out = ""  # reason why there are no numbers

    @property
    def values(self) -> int:
        """Number of values collected so far, stamps included."""
        return len(self.stamps) * (1 + len(self.columns))

    def add(self, message: Any, log_ns: int) -> None:
        """Add the numbers of a message; if they cannot be added, only set `left_out` to the reason.

        A message cannot be added if its fields differ from those of earlier messages. `log_ns` is the time of receipt.
        It replaces a stamp that is missing or zero.
        """
        header = getattr(message, "header", None)
        stamp_ns = header.stamp.sec * NS_PER_S + header.stamp.nanosec if header is not None else 0
        if not stamp_ns:  # of a driver that leaves the stamp empty
            stamp_ns, self.is_stamped = log_ns, False
        if message.__msgtype__ == CLOUD:
            self._add_cloud(message, stamp_ns)
            return
        found = dict(_leaves(message, ""))
        if len(found) == 1:
            found = {"": next(iter(found.values()))}
        if not self.stamps:
            self.columns = {field: array("d") for field in found}
            self.units = {field: unit for field, (_, unit) in found.items()}
        if found.keys() != self.columns.keys():
            self.left_out = "its messages differ in their number of values"
            return
        self.stamps.append(stamp_ns)
        for field, (value, _) in found.items():
            self.columns[field].append(value)

    def _add_cloud(self, message: Any, stamp_ns: int) -> None:
        """Add the rows of a `PointCloud2` as samples.

        The time of a sample is `stamp_ns` plus the column `time` or `t` of the row [s]. If several rows have no such
        column, or the columns differ from those of earlier messages, only `left_out` is set.
        """
        order = ">" if message.is_bigendian else "<"
        fields = [one for one in message.fields if one.count == 1 and one.datatype in _DATATYPES]
        layout = np.dtype(
            {
                "names": [one.name for one in fields],
                "formats": [order + _DATATYPES[one.datatype] for one in fields],
                "offsets": [one.offset for one in fields],
                "itemsize": message.point_step,
            }
        )
        rows = np.frombuffer(message.data, layout, int(message.width) * int(message.height))
        time = next((name for name in _TIME_COLUMNS if name in layout.names), None) if layout.names else None
        if time is None and len(rows) > 1:
            self.left_out = "a point cloud without a column `time` is no series of samples"
            return
        named = [name for name in layout.names or () if name != time]
        if not self.stamps:
            self.columns = {name: array("d") for name in named}
        if list(self.columns) != named:
            self.left_out = "its messages differ in their columns"
            return
        since_ns = np.round(rows[time].astype(np.float64) * NS_PER_S) if time else np.zeros(len(rows))
        self.stamps.frombytes((stamp_ns + since_ns.astype(np.int64)).tobytes())
        for name in named:
            self.columns[name].frombytes(rows[name].astype(np.float64).tobytes())


def _leaves(message: Any, prefix: str, unit: str = "") -> Iterator[tuple[str, tuple[float, str]]]:
    """Yield the numbers in a message: for each number the dotted name of its field, and (value, unit).

    `prefix` is put in front of the names. An element of an array is `field[0]`, or `field[name]` if the message has a
    list `name` of the same length. Constants, covariances, stamps, texts, booleans, arrays of messages and arrays
    longer than `MOST_ELEMENTS` are left out. `unit` is the unit for fields whose own unit is unknown.
    """
    labels = getattr(message, "name", None)
    for field in message.__dataclass_fields__:
        value = getattr(message, field)
        if field.startswith("__") or field == "header" or field.isupper() or field.endswith("covariance"):
            continue
        own = UNITS.get((message.__msgtype__, field), unit)
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            yield prefix + field, (float(value), own)
        elif isinstance(value, np.ndarray) and value.dtype.kind in "fiu" and len(value) <= MOST_ELEMENTS:
            for place, number in enumerate(value.tolist()):
                label = labels[place] if isinstance(labels, list) and len(labels) == len(value) else place
                yield f"{prefix}{field}[{label}]", (float(number), own)
        elif hasattr(value, "__msgtype__") and value.__msgtype__ not in _TIMES:
            yield from _leaves(value, f"{prefix}{field}.", own)
