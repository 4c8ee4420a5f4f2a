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
"""Columns of a table topic, for exports, data frames and datasets.

Three columns precede those of the table; the rows of every topic have them:

| column | content |
|---|---|
| `time` | seconds since the first scan of the recording, for all topics of a rig, continuous from message to message |
| `timestamp` | the same time as a date, to the nanosecond: rig time, which counts from 1970 as ROS time does |
| `earlier` | 1 if the message was published before the recording began: a latched topic delivers it to a new recorder |

If a table has a column `time`, which counts seconds from the stamp of its message, each row has its own time. In other
tables, the time of every row is the stamp of its message.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.blocks import LONGEST_S, Table
from impact_rig.errors import RecordingError
from impact_rig.simtime import NS_PER_S
from impact_rig.system import extras

if TYPE_CHECKING:
    from impact_rig.recording.reader import Message, Run

TIME, TIMESTAMP, EARLIER = "time", "timestamp", "earlier"
# size of the rows at which a batch is yielded: text decoded to str, and a number written as text, need four times that
BATCH_BYTES = 4 * 2**20

Columns = dict[str, NDArray[np.generic]]


def batches(run: Run, topic: str) -> Iterator[Columns]:
    """Yield the columns of a table topic in batches of about 4 MiB, with text as str.

    The columns `time`, `timestamp` and `earlier` precede the columns of the table; the docstring of this module
    describes them. If the messages of the topic have no rows, there is one batch of empty columns.

    Raises:
        RecordingError: the topic carries no tables, has no message, or has tables with different columns.
    """
    dtype: np.dtype[np.void] | None = None
    tables: list[Table] = []
    earlier: list[bool] = []
    waiting = 0
    origin_ns = first_scan_ns(run, topic)
    for message, table in run.received_tables(topic):
        if dtype is None:
            dtype = table.rows.dtype
        elif dtype != table.rows.dtype:
            raise RecordingError(
                f"{run.path}: topic {topic} changes its columns at the stamp {table.stamp_ns} ns, so its rows do "
                "not form one table; read its messages one by one with Run.tables in Python"
            )
        origin_ns = table.stamp_ns if origin_ns is None else origin_ns
        tables.append(table)
        earlier.append(is_earlier(run, message))
        waiting += table.rows.nbytes
        if waiting >= BATCH_BYTES:
            yield _joined(tables, earlier, origin_ns)
            tables, earlier, waiting = [], [], 0
    if dtype is None:
        raise RecordingError(f"{run.path}: topic {topic} has no message in this recording: choose another topic")
    if tables:
        yield _joined(tables, earlier, origin_ns or 0)


def complete(parts: Iterator[Columns]) -> Columns:
    """Join batches into one array per column.

    There must be at least one batch, and all batches must have the same columns.
    """
    found = list(parts)
    return {name: np.concatenate([part[name] for part in found]) for name in found[0]}


def to_dataframe(run: Run, topic: str) -> Any:
    """Return the rows of a table topic as a `pandas.DataFrame`.

    This implements `Run.to_dataframe`, and raises the same errors.
    """
    pandas = extras.load("pandas", "to_dataframe()", "tables")
    return pandas.DataFrame(complete(batches(run, topic)))


def to_xarray(run: Run, topic: str) -> Any:
    """Return the rows of a table topic as an `xarray.Dataset`.

    This implements `Run.to_xarray`, and raises the same errors.
    """
    xarray = extras.load("xarray", "to_xarray()", "tables")
    columns = complete(batches(run, topic))
    described = _described(run, topic)
    coordinates = {name: (TIME, columns.pop(name)) for name in (TIME, TIMESTAMP, EARLIER)}
    dataset = xarray.Dataset(
        {name: (TIME, column, described.get(name, {})) for name, column in columns.items()},
        coordinates,
        {"run": str(run.path), "topic": run.resolve(topic)},
    )
    dataset[TIME].attrs |= {"units": "s", "long_name": "Since the first scan of the recording."}
    return dataset


def first_scan_ns(run: Run, topic: str) -> int | None:
    """Return the stamp [ns] of the first recorded scan of the rig to which a topic belongs.

    The result is None if no scan of this rig was recorded.
    """
    scans = _prefix(run, run.resolve(topic)) + topics.SCAN.name
    if scans not in run.topics:
        return None
    return next((table.stamp_ns for table in run.tables(scans)), None)


def _prefix(run: Run, name: str) -> str:
    """Return the topic prefix, such as `/rig/`, of the rig to which a topic belongs; empty if it belongs to no rig.

    `name` is the full name of the topic.
    """
    return max((one for one in run.prefixes if name.startswith(one)), key=len, default="")


def is_earlier(run: Run, message: Message) -> bool:
    """Return whether a message was published before its recording began, as a latched message can be.

    The result is False if the publish time of the message or the start of the recording is unknown.
    """
    text = run.provenance.get("wall_start_ns", "")
    if message.publish_time == message.log_time:
        return False  # the writer knew no publish times: both times are rig time
    return text.isdecimal() and message.publish_time < int(text)


def leading(
    stamps: NDArray[np.int64], since: NDArray[np.float64], earlier: Sequence[bool], origin_ns: int | None
) -> Columns:
    """Return the columns `time`, `timestamp` and `earlier` of n rows, shape (n,) each.

    The first three arguments have one entry for each row: `stamps` is the stamp of its message [ns], `since` the time
    of the row after this stamp [s], and `earlier` whether its message was published before the recording began. The
    column `time` counts from `origin_ns`, or from the first stamp if `origin_ns` is None. `timestamp` is NaT if `since`
    is not finite or is longer than a rig can run (`LONGEST_S`).
    """
    known = np.abs(since) <= LONGEST_S
    own = stamps + np.round(np.where(known, since, 0.0) * NS_PER_S).astype(np.int64)
    begin = origin_ns if origin_ns is not None else int(stamps[0]) if len(stamps) else 0
    return {
        TIME: (stamps - begin) / NS_PER_S + since,
        TIMESTAMP: np.where(known, own.astype("datetime64[ns]"), np.datetime64("NaT", "ns")),
        EARLIER: np.array(earlier, np.uint8),
    }


def _joined(tables: list[Table], earlier: list[bool], origin_ns: int) -> Columns:
    """Return the columns of the rows of several tables with equal columns, after the leading columns of `leading`.

    `time` counts from `origin_ns` [ns]. `earlier` states for each table whether its message was published before the
    recording began. A numeric column `time` of the tables counts from the stamp of each table [s]: it is used to
    compute the leading `time`. Any other column with the name of a leading column becomes `<name>_of_table`.
    """
    rows = np.concatenate([table.rows for table in tables])
    counts = [len(table.rows) for table in tables]
    stamps = np.repeat(np.array([table.stamp_ns for table in tables], np.int64), counts)
    fields: Mapping[str, tuple[Any, ...]] = rows.dtype.fields or {}
    timed = TIME in fields and fields[TIME][0].kind in "fiu"
    since = np.asarray(rows[TIME], float) if timed else np.zeros(len(rows))
    columns = leading(stamps, since, np.repeat(earlier, counts).tolist(), origin_ns)
    for name in fields:
        if name != TIME or not timed:
            column = rows[name]
            own_name = f"{name}_of_table" if name in columns else name
            columns[own_name] = np.char.decode(column, "utf-8", "replace") if column.dtype.kind == "S" else column
    return columns


def _described(run: Run, topic: str) -> dict[str, dict[str, str]]:
    """Return the known units (`units`) and descriptions (`long_name`) of the columns of a topic, by column name.

    They are those of `impact_rig.topics`. The channels of `daq/scan` have no description. Their units are those in the
    recorded `daq/info` of the same rig.
    """
    name = run.resolve(topic)
    prefix = _prefix(run, name)
    known = next((one for one in topics.COMMON if prefix + one.name == name), None)
    found = {one.name: {"units": one.unit, "long_name": one.doc} for one in (known.fields if known else ())}
    info = prefix + topics.INFO.name
    if known is topics.SCAN and info in run.topics:
        for message in run.messages([info]):
            for row in run.table(message, topics.INFO).rows:
                found[row["name"].decode("utf-8", "replace")] = {"units": row["unit"].decode("utf-8", "replace")}
    return found
