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
"""Encoder and decoder of tables: `Table` <-> bytes of a `sensor_msgs/PointCloud2` in little-endian CDR, without rclpy.

    encapsulation 00 01 00 00 | stamp i4 u4 | frame_id | height u4 = 1 | width u4
    | fields[]: name, offset u4, datatype u1, count u4
    | is_bigendian u1 | point_step u4 | row_step u4 | data u1[] | is_dense u1

Numbers are aligned to their size, counted from the byte after the encapsulation. A string is its length with the
closing NUL (u4), its bytes and the NUL. A sequence is its length (u4) and its elements. Source: OMG DDSI-RTPS 2.2,
section 10 (CDR_LE), the encoding that ROS 2 transmits.

A text column is UINT8 x 32. `is_dense` is always false, which `PointCloud2` defines as "may hold invalid values",
because tables use NaN for "unknown".
"""

from __future__ import annotations

import functools
import struct
from collections.abc import Mapping, Sequence
from typing import Any  # numbers of any precision

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import TEXT, Column, Table
from impact_rig.errors import CodecError
from impact_rig.kernels import BYTES, entry
from impact_rig.simtime import NS_PER_S
from impact_rig.topics import Topic

Buffer = bytes | bytearray | memoryview

MAX_MESSAGE_BYTES = 480_000
"""Largest size of a message: above ~500 kB it exceeds the default shared-memory segment of Fast DDS."""
MAX_COLUMNS = 256  # more columns than any table of this package has; limits what a hostile message makes `decode` build

_ENCAPSULATION = b"\x00\x01\x00\x00"
_ORIGIN = len(_ENCAPSULATION)  # start of the CDR alignment
_STAMP = struct.Struct("<iI")
_HEADER = struct.Struct("<4siI")
_BEGINNING = struct.Struct("<2s2xiI")  # the same, without the options
_LITTLE_ENDIAN, _BIG_ENDIAN = b"\x00\x01", b"\x00\x00"
_U4 = struct.Struct("<I")
_SIZES = struct.Struct("<II")
_NOT_DENSE = b"\x00"
_PRIMITIVES = {
    "bool": "?", "byte": "B", "char": "B", "float32": "f", "float64": "d",
    "int8": "b", "int16": "h", "int32": "i", "int64": "q", "uint8": "B", "uint16": "H", "uint32": "I", "uint64": "Q",
}  # fmt: skip
_MAX_TRAILING = 3  # some writers pad the payload to a multiple of four

_MOST_HEADS = 64  # number of message heads that `decode` remembers; no graph of this package has as many kinds

# sensor_msgs/PointField
_FORMAT_OF_DATATYPE = {1: "i1", 2: "u1", 3: "<i2", 4: "<u2", 5: "<i4", 6: "<u4", 7: "<f4", 8: "<f8"}
_UINT8 = 2
_DATATYPE_OF = {np.dtype(fmt): number for number, fmt in _FORMAT_OF_DATATYPE.items()}
_TEXT_DTYPE = np.dtype(TEXT)
_BYTE = np.dtype("u1")


def encode(table: Table, frame_prefix: str = "") -> bytes:
    """Encode a table as a serialised `sensor_msgs/PointCloud2`, the message of all table topics.

    Args:
        table: table to encode. Its columns are integers of 8 to 32 bits, floats of 32 or 64 bits, or texts of 32 bytes
            (`S32`), in little-endian byte order.
        frame_prefix: text that is put before the table's `frame_id` in the message, such as `left/rig/`.

    Returns:
        The message as little-endian CDR, the encoding that ROS 2 transmits.

    Raises:
        CodecError: the rows are not one-dimensional or have no columns, or the type or name of a column, the stamp or
            the frame id cannot be represented in a PointCloud2.

    Examples:
        >>> import impact_rig
        >>> rig = impact_rig.Rig(impact_rig.RigConfig())
        >>> message = impact_rig.encode(rig.info())
        >>> print(impact_rig.decode(message).rows["name"])
        [b'accelerometer' b'laser' b'base' b'current']

    See Also:
        - `decode`: the inverse.
    """
    rows = table.rows
    if rows.ndim != 1:
        raise CodecError(f"rows must be one-dimensional, got shape {rows.shape}")
    seconds, nanoseconds = divmod(table.stamp_ns, NS_PER_S)
    if not -(2**31) <= seconds < 2**31:
        raise CodecError(
            f"stamp_ns must be >= {-(2**31) * NS_PER_S} and < {2**31 * NS_PER_S} ns, got {table.stamp_ns} ns"
        )
    frame, layout = _constant_parts(rows.dtype, frame_prefix + table.frame_id)
    data = rows.tobytes()
    return b"".join(
        (
            _HEADER.pack(_ENCAPSULATION, seconds, nanoseconds),
            frame,
            _U4.pack(len(rows)),
            layout,
            _SIZES.pack(len(data), len(data)),  # row_step and the length of data: there is one row of points
            data,
            _NOT_DENSE,
        )
    )


def encode_polygon(stamp_ns: int, frame_id: str, points: NDArray[np.floating[Any]]) -> bytes:
    """Return a serialised `geometry_msgs/PolygonStamped`, the message of spectra for plotters.

    Args:
        stamp_ns: stamp of the message [ns].
        frame_id: frame of the message.
        points: points (x, y, z), shape (n, 3).
    """
    stream = bytearray(_HEADER.pack(_ENCAPSULATION, *divmod(stamp_ns, NS_PER_S)))
    _append_text(stream, frame_id, "frame_id")
    _append_u4(stream, len(points))
    return bytes(stream) + points.astype("<f4").tobytes()


def decode(data: Buffer, topic: Topic | None = None, needs: tuple[str, ...] = ()) -> Table:
    """Decode a serialised `sensor_msgs/PointCloud2` into a table.

    The function is safe for hostile bytes: every length is compared with the available bytes before it is used.

    Args:
        data: serialised message (little-endian CDR).
        topic: topic of the table (an entry of `impact_rig.topics`, such as `impact_rig.topics.SCAN`), whose columns and
            values are then checked; None allows any columns and values.
        needs: names of columns that the table must have in addition to those of `topic`, such as the channels of a
            scan.

    Returns:
        The table. Its rows are a read-only view of `data`, or a new array if columns had to be added or widened for
        `topic`, see `checked`.

    Raises:
        CodecError: `data` is not a little-endian PointCloud2 of height 1 with columns of the types that `encode`
            writes, or not a table of `topic`; the message names the member or column and the reason.

    Examples:
        >>> import numpy as np, impact_rig
        >>> rows = np.array([(0.0, 1.5), (0.1, 1.6)], [("time", "<f8"), ("level", "<f4")])
        >>> message = impact_rig.encode(impact_rig.Table(stamp_ns=10**9, rows=rows))
        >>> table = impact_rig.decode(message)
        >>> table.stamp_ns, table.rows["level"].tolist()
        (1000000000, [1.5, 1.600000023841858])

    See Also:
        - `encode`: the inverse.
        - `Run`: reads tables from a recording.
    """
    table = _decode(data)
    if topic is not None:
        return checked(table, topic, needs)
    if missing := [name for name in needs if name not in (table.rows.dtype.names or ())]:
        raise CodecError(_missing(missing))
    return table


def checked(table: Table, topic: Topic, needs: tuple[str, ...] = ()) -> Table:
    """Check that a table is valid for `topic`, and return it with all columns of that topic.

    Every table that was received or read from a file must pass this check. A missing column is filled with its default,
    if the topic defines one. A number of a narrower type is widened. Columns that the topic does not define are kept,
    after those of the topic. If nothing must be filled or widened, the same table is returned, with its columns in
    their order.

    Args:
        table: the decoded table.
        topic: a topic that carries tables.
        needs: names of columns that the table must have in addition to those of `topic`, such as the channels of a
            scan.

    Raises:
        CodecError: a column without a default or one of `needs` is missing, a column has a type that cannot be widened
            to that of the topic, or a value is not allowed. The message names topic, column, value and the allowed
            values.
    """
    plan = _plan(topic, table.rows.dtype, needs)
    rows = table.rows if plan.fits else _fitted(table.rows, plan)
    # made with the type of the rows: with cold caches `view` takes twice as long
    data: NDArray[np.uint8] = np.ndarray((rows.nbytes,), _BYTE, rows if rows.flags.c_contiguous else rows.copy())
    for column, offset in plan.numbers:
        row = _first_wrong(data, offset, rows.itemsize, column.least, column.most, column.whole)
        if row < len(rows):
            value = rows[column.name][row].item()
            raise CodecError(
                f"{topic.name}: {column.name} must be {column.allowed()}, got {value!r} in row {row}, counted from 0, "
                "of the decoded table"
            )
    for column in plan.texts:
        _refuse_texts(rows[column.name], column, topic)
    return table if rows is table.rows else Table(table.stamp_ns, rows, table.frame_id)


def _missing(names: Sequence[str]) -> str:
    listed = ", ".join(map(repr, names))
    return f"column {listed} is missing" if len(names) == 1 else f"columns {listed} are missing"


@attrs.frozen(eq=False)
class _Plan:
    """Conversions and checks that `checked` applies to tables of one topic whose rows have one numpy type."""

    fits: bool  # whether the rows can stay unchanged
    dtype: np.dtype[np.void]  # row type of the result
    absent: tuple[Column, ...]  # columns that get their default
    numbers: tuple[tuple[Column, int], ...]  # columns with bounded values, and their offsets in a row
    texts: tuple[Column, ...]  # columns whose values must be text


@functools.lru_cache(maxsize=256)  # few types of rows exist
def _plan(topic: Topic, found: np.dtype[np.void], needs: tuple[str, ...]) -> _Plan:
    """Return the conversions and checks for tables of `topic` whose rows have the numpy type `found`.

    `needs` names required columns in addition to those of the topic. Columns unknown to the topic are kept.

    Raises:
        CodecError: a column of `needs`, or a column of the topic without a default, is missing. Also if a column has a
            type that cannot be widened to that of the topic.
    """
    there = {name: found[name] for name in found.names or ()}
    kinds = [(column.name, np.dtype(column.kind)) for column in topic.fields]
    own = {name for name, _ in kinds}
    kinds += [(name, np.dtype(topic.further or there[name])) for name in there if name not in own]
    absent = tuple(column for column in topic.fields if column.name not in there)
    missing = [column.name for column in absent if column.default is None]
    missing += [name for name in needs if name not in there]
    if missing:
        raise CodecError(f"{topic.name}: {_missing(missing)}")
    for name, wanted in kinds:
        got = there.get(name, wanted)
        if (got.kind == "S") != (wanted.kind == "S") or not np.can_cast(got, wanted, "safe"):
            needed, present = ("text" if one.kind == "S" else one.name for one in (wanted, got))
            raise CodecError(f"{topic.name}: column {name!r} must be of type {needed}, got {present}")
    fits = not absent and all(there[name] == wanted for name, wanted in kinds)
    dtype = found if fits else np.dtype(kinds)
    places: Mapping[str, Any] = dtype.fields or {}
    return _Plan(
        fits=fits,
        dtype=dtype,
        absent=absent,
        numbers=tuple((column, places[column.name][1]) for column in topic.fields if column.is_bounded),
        texts=tuple(column for column in topic.fields if column.kind == TEXT and not column.is_part),
    )


def _fitted(rows: NDArray[np.void], plan: _Plan) -> NDArray[np.void]:
    absent = {column.name: column.default for column in plan.absent}
    fitted: NDArray[np.void] = np.zeros(rows.shape, plan.dtype)
    for name in plan.dtype.names or ():
        fitted[name] = absent[name] if name in absent else rows[name]
    return fitted


@entry(BYTES, int, int, float, float, bool, returns=int)
def _first_wrong(data: NDArray[np.uint8], offset: int, step: int, least: float, most: float, whole: bool) -> int:
    """Check one column of 64-bit floats, and return the index of the first row whose number is not allowed.

    NaN is never allowed. If all numbers are allowed, the result is the number of rows.

    Args:
        data: bytes of the rows, one row after the other.
        offset: position of the column in a row [bytes].
        step: length of a row [bytes].
        least: smallest number that is allowed.
        most: largest number that is allowed.
        whole: whether only integers are allowed.
    """
    count = len(data) // step
    for row in range(count):
        begin = row * step + offset
        value = data[begin : begin + 8].view(np.float64)[0]
        if not (least <= value <= most) or (whole and value != np.floor(value)):
            return row
    return count


def _refuse_texts(values: NDArray[np.generic], column: Column, topic: Topic) -> None:
    for row, raw in enumerate(values.tolist()):
        try:
            raw.decode()
        except UnicodeDecodeError:
            raise CodecError(
                f"{topic.name}: {column.name} must be UTF-8, got {raw!r} in row {row}, counted from 0, of the "
                "decoded table"
            ) from None


def _decode(data: Buffer) -> Table:
    if not isinstance(data, bytes):
        data = memoryview(data).cast("B").toreadonly()
    stamp = header_stamp_ns(data)
    head = _heads.get(len(data))
    if head is None or data[_HEADER.size : head.end] != head.content:
        head = _head(memoryview(data))
        if len(_heads) >= _MOST_HEADS:
            _heads.clear()
        _heads[len(data)] = head
    rows: NDArray[np.void] = np.ndarray((head.width,), head.dtype, data, head.end)
    return Table(stamp, rows, head.frame_id)


@attrs.frozen
class _Head:
    """Head of a serialised PointCloud2: the bytes between its stamp and its data, and their meaning.

    `content` has these bytes, and `end` is the offset of the data in the message. `_decode` remembers heads, because
    the messages of one stream usually have the same head.
    """

    content: bytes
    end: int
    frame_id: str
    width: int
    dtype: np.dtype[np.void]


_heads: dict[int, _Head] = {}  # the head that was parsed last, by the length [bytes] of its message


def _head(view: memoryview) -> _Head:
    """Parse the head of a serialised PointCloud2, and check that the data after it have the stated length."""
    cursor = _Cursor(view, _HEADER.size)
    frame_id = cursor.text("frame_id")
    height, width = cursor.u4("height"), cursor.u4("width")
    if height != 1:
        raise CodecError(f"height of the PointCloud2 must be 1, got {height}")
    dtype = _layout(cursor)
    row_step, length = cursor.u4("row_step"), cursor.u4("length of data")
    if not row_step == length == width * dtype.itemsize:
        name, wrong = ("length of data", length) if row_step == width * dtype.itemsize else ("row_step", row_step)
        raise CodecError(
            f"{name} must be width * point_step = {width} * {dtype.itemsize} = {width * dtype.itemsize} bytes, "
            f"got {wrong}"
        )
    start = cursor.take(length, "data")
    cursor.u1("is_dense")
    trailing = len(cursor.view) - cursor.position
    if trailing > _MAX_TRAILING:
        raise CodecError(f"{trailing} bytes follow the end of the message, at most {_MAX_TRAILING} are allowed")
    return _Head(bytes(view[_HEADER.size : start]), start, frame_id, width, dtype)


def header(data: Buffer) -> tuple[int, str]:
    """Return stamp [ns] and frame_id of any serialised message that starts with `std_msgs/Header`.

    Raises:
        CodecError: as for `header_stamp_ns`, or the frame_id is not text.
    """
    stamp = header_stamp_ns(data)
    return stamp, _Cursor(memoryview(data).cast("B"), _ORIGIN + _STAMP.size).text("frame_id")


def header_stamp_ns(data: Buffer) -> int:
    """Return the header stamp [ns] of any serialised message that starts with `std_msgs/Header`.

    Raises:
        CodecError: `data` is too short or not little-endian CDR, or the nanoseconds of its stamp are not below 10^9.
    """
    if len(data) < _HEADER.size:
        raise CodecError(f"a message with a header has at least {_HEADER.size} bytes, got {len(data)}")
    encapsulation, seconds, nanoseconds = _BEGINNING.unpack_from(data)
    if encapsulation != _LITTLE_ENDIAN:
        kind = " (big-endian CDR)" if encapsulation == _BIG_ENDIAN else ""
        raise CodecError(f"encapsulation must be 00 01 (little-endian CDR), got {encapsulation.hex(' ')}{kind}")
    if nanoseconds >= NS_PER_S:
        raise CodecError(f"nanoseconds of the stamp must be < {NS_PER_S}, got {nanoseconds}")
    stamp: int = seconds * NS_PER_S + nanoseconds
    return stamp


def joint_state(data: Buffer) -> tuple[int, tuple[NDArray[np.float64], ...]]:
    """Return stamp [ns] and (positions, velocities, efforts) of a serialised `sensor_msgs/JointState`.

    Each of the three is a one-dimensional array, which is empty if the message does not contain it.

    Raises:
        CodecError: `data` is not a JointState in little-endian CDR.
    """
    stamp = header_stamp_ns(data)
    cursor = _Cursor(memoryview(data).cast("B"), _ORIGIN + _STAMP.size)
    cursor.text("frame_id")
    for _ in range(cursor.u4("number of names")):
        cursor.text("name of a joint")
    return stamp, tuple(cursor.numbers(what) for what in ("position", "velocity", "effort"))


def encode_joint_state(stamp_ns: int, *values: Sequence[float]) -> bytes:
    """Return a serialised `sensor_msgs/JointState` without names of joints.

    Args:
        stamp_ns: stamp of the message [ns].
        values: positions, then velocities, then efforts; those that are not given are empty.
    """
    stream = bytearray(_HEADER.pack(_ENCAPSULATION, *divmod(stamp_ns, NS_PER_S)))
    _append_text(stream, "", "frame_id")
    for numbers in ((), *values, *[()] * (3 - len(values))):
        _append_u4(stream, len(numbers))
        if numbers:
            stream += bytes((_ORIGIN - len(stream)) % 8) + struct.pack(f"<{len(numbers)}d", *numbers)
    return bytes(stream)


def plain(data: Buffer, members: Sequence[tuple[str, str, int]]) -> dict[str, Any]:
    """Decode the first members of a serialised message, and return their values by path.

    A value is a number, a text, or a tuple of numbers for an array of two or more.

    Args:
        data: a message of any type that starts with `std_msgs/Header`.
        members: (path, primitive ROS type, count) of each member, in the order of the message and without a gap. The
            path is the key in the result, and the count the length of an array (otherwise 1). The first member is the
            seconds of the header stamp.

    Raises:
        CodecError: as for `header_stamp_ns`, or the message ends before a member. Also if a member is a sequence
            (negative count), a `wstring` or an array of texts, or has the count 0.
    """
    header_stamp_ns(data)  # rejects another byte order
    cursor, found = _Cursor(memoryview(data).cast("B"), _ORIGIN), dict[str, Any]()
    for path, kind, count in members:
        if kind == "string" and count == 1:
            found[path] = cursor.text(path)
            continue
        if kind not in _PRIMITIVES or count < 0:
            got = kind if count == 1 else f"{'a sequence' if count < 0 else f'an array of {count}'} of type {kind}"
            raise CodecError(
                f"cannot read member {path} of the message: its type must be a number, an array of numbers with fixed "
                f"length or a single string, got {got}"
            )
        if not 0 < count <= len(data):  # a definition may contain any count
            raise CodecError(
                f"member {path} must have 1 to {len(data)} values, because the message has {len(data)} bytes, got "
                f"{count}; correct the definition of the message type"
            )
        form = struct.Struct(f"<{count}{_PRIMITIVES[kind]}")
        cursor.position += (_ORIGIN - cursor.position) % struct.calcsize(_PRIMITIVES[kind])
        values = form.unpack_from(cursor.view, cursor.take(form.size, path))
        found[path] = values if count > 1 else values[0]
    return found


def encode_text(content: str) -> bytes:
    """Return a serialised `std_msgs/String`."""
    stream = bytearray(_ENCAPSULATION)
    _append_text(stream, content, "data")
    return bytes(stream)


def text(data: Buffer) -> str:
    """Return the content of a serialised `std_msgs/String` in little-endian CDR; the byte order is not checked.

    Raises:
        CodecError: `data` is too short, or its text is not UTF-8 with a NUL at its end and no other NUL.
    """
    return _Cursor(memoryview(data).cast("B"), _ORIGIN).text("data")


@attrs.define
class _Cursor:
    """Reader of a CDR stream, which raises a CodecError instead of reading beyond the end.

    The error names the member `what`.
    """

    view: memoryview
    position: int

    def take(self, count: int, what: str) -> int:
        """Advance by `count` bytes, and return the offset of the first of them."""
        start = self.position
        if count > len(self.view) - start:
            left = max(len(self.view) - start, 0)
            raise CodecError(f"message ends too early: {what} needs {count} bytes at offset {start}, only {left} left")
        self.position = start + count
        return start

    def u1(self, what: str) -> int:
        return self.view[self.take(1, what)]

    def u4(self, what: str) -> int:
        self.position += (_ORIGIN - self.position) % 4
        return int(_U4.unpack_from(self.view, self.take(4, what))[0])

    def numbers(self, what: str) -> NDArray[np.float64]:
        count = self.u4(f"number of values of {what}")
        if count:
            self.position += (_ORIGIN - self.position) % 8
        return np.frombuffer(self.view, "<f8", count, self.take(8 * count, what))

    def text(self, what: str) -> str:
        length = self.u4(f"length of {what}")
        if length == 0:  # not legal CDR, but some writers encode the empty string like this
            return ""
        start = self.take(length, what)
        raw = bytes(self.view[start : start + length])
        if raw.find(0) != length - 1:
            raise CodecError(f"{what} must end with a NUL byte and contain no other, got {raw[:40]!r}")
        try:
            return raw[:-1].decode("utf-8")
        except UnicodeDecodeError as error:
            raise CodecError(f"{what} must be UTF-8, got {raw[:40]!r}") from error


def _layout(cursor: _Cursor) -> np.dtype[np.void]:
    """Read the members `fields`, `is_bigendian` and `point_step` of a PointCloud2, and return the type of its rows."""
    columns = _columns(cursor)
    if cursor.u1("is_bigendian"):
        raise CodecError("data must be little-endian, got is_bigendian = true")
    return _dtype(columns, cursor.u4("point_step"))


def _columns(cursor: _Cursor) -> dict[str, tuple[str, int]]:
    """Read the member `fields` of a PointCloud2, and return its columns: name -> (numpy format, offset in a row)."""
    count = cursor.u4("number of fields")
    if not 1 <= count <= MAX_COLUMNS:
        raise CodecError(f"a message to decode must have 1 to {MAX_COLUMNS} fields, got {count}")
    columns: dict[str, tuple[str, int]] = {}
    for _ in range(count):
        name = cursor.text("name of a field")
        offset, datatype, repeat = cursor.u4("offset"), cursor.u1("datatype"), cursor.u4("count")
        if not name or name in columns:
            raise CodecError(
                f"names of fields must be unique and not empty, got {name!r}{' twice' if name else ''}: the "
                "sender of the message must give each field a name of its own"
            )
        if datatype not in _FORMAT_OF_DATATYPE:
            raise CodecError(f"datatype of field {name!r} must be 1 to 8 (INT8 to FLOAT64), got {datatype}")
        if repeat == 1:
            columns[name] = (_FORMAT_OF_DATATYPE[datatype], offset)
        elif datatype == _UINT8 and repeat == _TEXT_DTYPE.itemsize:
            columns[name] = (TEXT, offset)
        else:
            raise CodecError(
                f"count of field {name!r} must be 1, got {repeat}; only a text has the count {_TEXT_DTYPE.itemsize}, "
                f"and the datatype {_UINT8} (UINT8)"
            )
    return columns


def _dtype(columns: dict[str, tuple[str, int]], point_step: int) -> np.dtype[np.void]:
    """Return the type of rows of `point_step` bytes with these columns: name -> (numpy format, offset).

    Columns may be in any order and leave gaps, but must not overlap or exceed the row.
    """
    before, end = "", 0
    for name, (fmt, offset) in sorted(columns.items(), key=lambda item: item[1][1]):
        if offset < end:
            raise CodecError(f"field {name!r} at offset {offset} overlaps field {before!r}, which ends at {end}")
        before, end = name, offset + np.dtype(fmt).itemsize
    # limit of NumPy; a larger point can only occur with width 0, since all of its bytes must be in the message
    if not end <= point_step < 2**31:
        raise CodecError(f"point_step must be >= {end} (end of the last field) and < 2**31, got {point_step}")
    formats, offsets = zip(*columns.values(), strict=True)
    return np.dtype({"names": list(columns), "formats": formats, "offsets": offsets, "itemsize": point_step})


@functools.lru_cache(maxsize=64)  # few dtypes and frames exist
def _constant_parts(dtype: np.dtype[np.void], frame_id: str) -> tuple[bytes, bytes]:
    """Return the two parts of a PointCloud2 that all messages of this row type and frame have in common.

    The first part contains frame_id and height, the second the members from `fields` to `point_step`. In the message,
    the width stands between the two parts.
    """
    if dtype.fields is None or not dtype.names:
        raise CodecError(f"rows must be a structured array with at least one column, got {dtype}")
    frame = bytearray(_ENCAPSULATION + bytes(_STAMP.size))
    _append_text(frame, frame_id, "frame_id")
    _append_u4(frame, 1)
    start = len(frame) + _U4.size  # the width is in between
    layout = bytearray(start)
    _append_u4(layout, len(dtype.names))
    for name in dtype.names:
        column, offset = dtype.fields[name][:2]
        datatype, count = _datatype(name, column)
        _append_text(layout, name, "name of a column")
        _append_u4(layout, offset)
        layout.append(datatype)
        _append_u4(layout, count)
    layout.append(0)  # is_bigendian
    _append_u4(layout, dtype.itemsize)
    return bytes(frame[_HEADER.size :]), bytes(layout[start:])


def _datatype(name: str, column: np.dtype[np.generic]) -> tuple[int, int]:
    """Return the members `datatype` and `count` of the `sensor_msgs/PointField` that describes a column.

    Raises:
        CodecError: there is no such PointField for the column's type; the message contains `name`.
    """
    if column == _TEXT_DTYPE:
        return _UINT8, _TEXT_DTYPE.itemsize
    if column not in _DATATYPE_OF:
        allowed = ", ".join([*map(str, _DATATYPE_OF), TEXT])
        raise CodecError(f"column {name!r} cannot be encoded: its type is {column}; convert it to one of {allowed}")
    return _DATATYPE_OF[column], 1


def _append_u4(stream: bytearray, value: int) -> None:
    stream += bytes((_ORIGIN - len(stream)) % 4)
    stream += _U4.pack(value)


def _append_text(stream: bytearray, text: str, what: str) -> None:
    try:
        raw = text.encode("utf-8")
    except UnicodeEncodeError as error:
        raise CodecError(f"{what} must be text that UTF-8 can encode, got {text!r}") from error
    if b"\0" in raw:
        raise CodecError(f"{what} must not hold a NUL, got {text!r}")
    _append_u4(stream, len(raw) + 1)
    stream += raw + b"\0"
