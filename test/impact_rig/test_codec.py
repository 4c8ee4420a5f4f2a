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
"""Tables survive the wire: against rclpy's own serialisation, for any table, and whatever hostile bytes arrive."""

from __future__ import annotations

import re
import struct

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from impact_rig import blocks, topics
from impact_rig.blocks import TEXT, Table
from impact_rig.codec import MAX_COLUMNS, checked, decode, encode, header_stamp_ns, plain
from impact_rig.errors import CodecError
from impact_rig.instruments.section import SCAN

TABLE_DTYPES = {
    name: value for name, value in vars(blocks).items() if isinstance(value, np.dtype) and value.names is not None
}
COLUMN_TYPES = ("i1", "u1", "<i2", "<u2", "<i4", "<u4", "<f4", "<f8", TEXT)
LAST_STAMP = 2**31 * 10**9 - 1

stamps = st.integers(-(2**31) * 10**9, LAST_STAMP)
words = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="\0"), min_size=1, max_size=40)
dtypes = st.lists(st.tuples(words, st.sampled_from(COLUMN_TYPES)), min_size=1, max_size=12, unique_by=lambda c: c[0])


@st.composite
def tables(draw, max_rows=6):
    dtype = np.dtype(draw(dtypes))
    rows = draw(st.integers(0, max_rows))
    size = rows * dtype.itemsize
    data = draw(st.binary(min_size=size, max_size=size))  # any bits: NaN and infinities included
    frame = draw(st.one_of(st.just(""), words))
    return Table(draw(stamps), np.ndarray((rows,), dtype, data), frame)


def scan_table(rows=3):
    array = np.zeros(rows, SCAN)
    array["time"] = np.arange(rows) / 10_000
    array["laser"] = np.nan
    array["status"] = 2
    return Table(1_700_000_000_123_456_789, array)


def assert_same(left, right):
    assert left.stamp_ns == right.stamp_ns
    assert left.frame_id == right.frame_id
    assert left.rows.dtype == right.rows.dtype
    assert left.rows.tobytes() == right.rows.tobytes()


@pytest.mark.heavy
@given(tables())
def test_any_table_is_decoded_as_encoded(table):
    assert_same(decode(encode(table)), table)


@pytest.mark.parametrize("name", TABLE_DTYPES)
@pytest.mark.parametrize("rows", [0, 1, 7])
def test_every_table_of_the_interface_is_decoded_as_encoded(name, rows):
    table = Table(0, np.zeros(rows, TABLE_DTYPES[name]))
    assert_same(decode(encode(table)), table)


def test_decoded_rows_are_a_read_only_view():
    """Copying 20 kB per block would cost time, and a reader that changed it would change the recording."""
    data = bytearray(encode(scan_table()))
    rows = decode(data).rows
    data[-10] ^= 0xFF  # inside the last row
    assert rows.tobytes() != scan_table().rows.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        rows["time"] = 0


def test_messages_of_equal_length_and_different_type_are_distinguished():
    """The type of one message must not decide how the next one of the same length is read."""
    one, other = np.dtype([("ab", "<f4"), ("cd", "<u4")]), np.dtype([("cd", "<u4"), ("ab", "<f4")])
    wide, narrow = np.dtype([("ab", "<f8"), ("cd", "<f8")]), np.dtype([("ab", "<f4"), ("cd", "<f4")])
    alike = [
        [Table(1, np.zeros(2, one), "daq"), Table(2, np.zeros(2, other), "daq"), Table(3, np.zeros(2, one), "rig")],
        [Table(4, np.ones(1, wide), "daq"), Table(5, np.ones(2, narrow), "daq")],
    ]
    for tables_ in alike:
        assert len({len(encode(table)) for table in tables_}) == 1
        for table in (*tables_, *reversed(tables_)):
            assert_same(decode(encode(table)), table)


def test_an_inconsistent_message_is_rejected_after_a_valid_one_of_its_length():
    good = encode(scan_table())
    decode(good)
    row_step = len(good) - 1 - scan_table().rows.nbytes - 8
    lie = good[:row_step] + struct.pack("<I", 1) + good[row_step + 4 :]
    with pytest.raises(CodecError, match=r"got 1$"):
        decode(lie)


def test_rows_with_padding_and_columns_in_any_order_are_read():
    """PointCloud2 allows padding of points and any order of fields; PCL uses both."""
    dtype = np.dtype({"names": ["b", "a"], "formats": ["<f8", "u1"], "offsets": [8, 0], "itemsize": 24})
    rows = np.zeros(2, dtype)
    rows["a"], rows["b"] = [1, 2], [0.5, -0.5]
    assert_same(decode(encode(Table(5, rows))), Table(5, rows))


def test_slices_that_are_not_contiguous_are_encoded_as_their_rows():
    table = scan_table(6)
    sliced = Table(table.stamp_ns, table.rows[::2])
    assert_same(decode(encode(sliced)), sliced)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (Table(0, np.zeros(1, [("n", "<i8")])), "column 'n' cannot be encoded: its type is int64; .* one of int8"),
        (Table(0, np.zeros(1, [("n", ">f8")])), "'n' cannot be encoded: its type is >f8"),
        (Table(0, np.zeros(1, [("n", "S31")])), "'n' cannot be encoded"),
        (Table(0, np.zeros(1, [("n", "<f8", 3)])), "'n' cannot be encoded"),
        (Table(0, np.zeros(1, [("n\0", "<f8")])), "must not hold a NUL"),
        (Table(0, np.zeros(1, [("\ud800", "<f8")])), "name of a column must be text that UTF-8 can encode"),
        (Table(0, np.zeros(1, "f8")), "must be a structured array"),
        (Table(0, np.zeros((2, 2), SCAN)), "one-dimensional"),
        (
            Table(LAST_STAMP + 1, np.zeros(1, SCAN)),
            "stamp_ns must be >= -2147483648000000000 and < 2147483648000000000 ns, got 2147483648000000000 ns",
        ),
        (Table(0, np.zeros(1, SCAN), "a\0b"), "frame_id must not hold a NUL"),
    ],
)
def test_a_table_that_does_not_fit_a_message_is_rejected(table, message):
    with pytest.raises(CodecError, match=message):
        encode(table)


@given(stamps)
@example(-1)
@example(LAST_STAMP)
def test_the_stamp_is_read_without_decoding(stamp):
    assert header_stamp_ns(encode(Table(stamp, np.zeros(0, SCAN)))[:12]) == stamp


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "at least 12 bytes, got 0"),
        (b"\0\1\0\0" + bytes(7), "at least 12 bytes, got 11"),
        (b"\0\0\0\0" + bytes(8), r"got 00 00 \(big-endian CDR\)"),
        (b"\0\7\0\0" + bytes(8), "encapsulation must be 00 01 .* got 00 07"),
        (b"\0\1\0\0" + struct.pack("<iI", 0, 10**9), "nanoseconds of the stamp must be < 1000000000"),
    ],
)
def test_an_invalid_stamp_is_rejected(data, message):
    with pytest.raises(CodecError, match=message):
        header_stamp_ns(data)
    with pytest.raises(CodecError, match=message):
        decode(data)


# --- hostile bytes ---------------------------------------------------------------------------------------------------


class Message:
    """PointCloud2 written field by field, so that each can be wrong: an independent counterpart of the codec."""

    def __init__(self, **wrong):
        self.values = {
            "frame": b"daq\0",
            "height": 1,
            "width": 2,
            "fields": [(b"a\0", 0, 8, 1), (b"b\0", 8, 2, 1)],
            "big_endian": 0,
            "point_step": 9,
            "row_step": 18,
            "data": bytes(18),
        } | wrong

    def __bytes__(self):
        v, out = self.values, bytearray(b"\0\1\0\0" + bytes(8))

        def u4(value):
            out.extend(bytes(-len(out) % 4) + struct.pack("<I", value))

        def text(raw):
            u4(len(raw))
            out.extend(raw)

        text(v["frame"])
        u4(v["height"])
        u4(v["width"])
        u4(v.get("field_count", len(v["fields"])))
        for name, offset, datatype, count in v["fields"]:
            text(name)
            u4(offset)
            out.append(datatype)
            u4(count)
        out.append(v["big_endian"])
        u4(v["point_step"])
        u4(v["row_step"])
        u4(v.get("data_length", len(v["data"])))
        return bytes(out + v["data"] + b"\0" + v.get("trailing", b""))


MANY = (2**32 - 1) // 9  # rows of the largest table whose length fits its field


def test_a_message_of_an_independent_writer_is_read():
    table = decode(bytes(Message()))
    assert table.rows.dtype == np.dtype([("a", "<f8"), ("b", "u1")])
    assert len(table.rows) == 2


@pytest.mark.parametrize("trailing", [b"", b"\xde", b"\xde\xad", b"\xde\xad\xbe"])
def test_padding_after_the_message_is_ignored(trailing):
    assert len(decode(bytes(Message(trailing=trailing))).rows) == 2


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"frame": b"daq"}, "frame_id must end with a NUL byte and contain no other"),
        ({"frame": b"d\0q\0"}, "frame_id must end with a NUL byte and contain no other"),
        ({"frame": b"\xff\0"}, "frame_id must be UTF-8"),
        ({"height": 2}, "height of the PointCloud2 must be 1, got 2"),
        ({"width": 2**32 - 1}, "row_step must be width [*] point_step = 4294967295 [*] 9"),
        ({"fields": []}, f"a message to decode must have 1 to {MAX_COLUMNS} fields, got 0"),
        ({"field_count": 2**32 - 1}, "a message to decode must have 1 to"),
        ({"fields": [(b"a\0", 0, 8, 1)] * 2}, "unique and not empty, got 'a' twice: the sender of the message must"),
        ({"fields": [(b"\0", 0, 8, 1)]}, "unique and not empty, got ''"),
        ({"fields": [(b"a\0", 0, 9, 1)]}, "datatype of field 'a' must be 1 to 8 [(]INT8 to FLOAT64[)], got 9"),
        ({"fields": [(b"a\0", 0, 8, 0)]}, "count of field 'a' must be 1"),
        ({"fields": [(b"a\0", 0, 2, 2**32 - 1)]}, "count of field 'a' must be 1, got 4294967295; only a text"),
        ({"fields": [(b"a\0", 0, 8, 1), (b"b\0", 7, 2, 1)]}, "'b' at offset 7 overlaps field 'a'"),
        ({"fields": [(b"a\0", 2**32 - 1, 8, 1)]}, "point_step must be >= 4294967303"),
        ({"point_step": 8}, "point_step must be >= 9"),
        ({"point_step": 2**32 - 1, "width": 0, "row_step": 0, "data": b""}, "and < 2[*][*]31"),
        ({"big_endian": 1}, "data must be little-endian"),
        ({"row_step": 17}, "row_step must be .*, got 17$"),
        ({"data_length": 2**32 - 1}, "length of data must be .*, got 4294967295$"),
        ({"width": MANY, "row_step": 9 * MANY, "data_length": 9 * MANY}, f"data needs {9 * MANY} bytes"),
        ({"trailing": bytes(4)}, "4 bytes follow the end of the message, at most 3 are allowed"),
    ],
)
def test_an_inconsistent_message_is_rejected_with_the_reason(wrong, message):
    with pytest.raises(CodecError, match=message):
        decode(bytes(Message(**wrong)))


def test_a_huge_point_without_rows_allocates_nothing():
    assert len(decode(bytes(Message(point_step=2**31 - 1, width=0, row_step=0, data=b""))).rows) == 0


@pytest.mark.parametrize("name", ["IMPACTS", "FAULTS"])
def test_every_truncated_message_is_rejected(name):
    data = encode(Table(1, np.zeros(2, TABLE_DTYPES[name])))
    for length in range(len(data)):
        with pytest.raises(CodecError):
            decode(data[:length])


@pytest.mark.heavy
@pytest.mark.parametrize("name", ["IMPACTS", "FAULTS"])
def test_a_flipped_bit_never_crashes_the_decoder(name):
    """A flipped bit in the data or a name gives another table; any other flip is rejected."""
    data = bytearray(encode(Table(1, np.zeros(2, TABLE_DTYPES[name]))))
    for position in range(len(data)):
        for bit in range(8):
            data[position] ^= 1 << bit
            _decode_or_refuse(bytes(data))
            data[position] ^= 1 << bit


@settings(max_examples=500)
@given(tables(), st.data())
@pytest.mark.repeats
def test_changed_bytes_never_crash_the_decoder(table, data):
    raw = bytearray(encode(table))
    for _ in range(data.draw(st.integers(1, 8))):
        position = data.draw(st.integers(0, len(raw) - 1))
        raw[position] = data.draw(st.integers(0, 255))
    _decode_or_refuse(bytes(raw[: data.draw(st.integers(0, len(raw)))]))


@pytest.mark.heavy
@settings(max_examples=500)
@given(st.binary(max_size=300))
def test_random_bytes_never_crash_the_decoder(raw):
    _decode_or_refuse(raw)
    _decode_or_refuse(b"\0\1\0\0" + raw)


def _decode_or_refuse(raw):
    try:
        table = decode(raw)
    except CodecError:
        return
    assert table.rows.nbytes <= len(raw)
    assert decode(encode(table)).rows.tobytes() == table.rows.tobytes()


# --- the real thing --------------------------------------------------------------------------------------------------


@pytest.mark.ros
@given(tables())
def test_encode_and_decode_are_compatible_with_rclpy(table):
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import PointCloud2

    message = deserialize_message(encode(table), PointCloud2)
    assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == table.stamp_ns
    assert message.header.frame_id == table.frame_id
    assert (message.height, message.width) == (1, len(table.rows))
    assert [field.name for field in message.fields] == list(table.rows.dtype.names)
    assert [field.offset for field in message.fields] == [table.rows.dtype.fields[n][1] for n in table.rows.dtype.names]
    assert message.data.tobytes() == table.rows.tobytes()
    assert not message.is_bigendian
    assert not message.is_dense
    assert_same(decode(serialize_message(message)), table)


@pytest.mark.ros
def test_the_types_of_the_columns_are_those_of_point_field():
    from rclpy.serialization import deserialize_message
    from sensor_msgs.msg import PointCloud2, PointField

    names = {"i1": "INT8", "u1": "UINT8", "i2": "INT16", "u2": "UINT16", "i4": "INT32", "u4": "UINT32"}
    names |= {"f4": "FLOAT32", "f8": "FLOAT64"}
    dtype = np.dtype([(name, fmt) for fmt, name in names.items()] + [("text", TEXT)])
    fields = deserialize_message(encode(Table(0, np.zeros(1, dtype))), PointCloud2).fields
    assert [field.datatype for field in fields[:-1]] == [getattr(PointField, name) for name in names.values()]
    assert (fields[-1].datatype, fields[-1].count) == (PointField.UINT8, 32)


@pytest.mark.ros
def test_the_stamp_of_any_message_with_a_header_is_found():
    from geometry_msgs.msg import Vector3Stamped
    from rclpy.serialization import serialize_message
    from sensor_msgs.msg import Imu, JointState, Range

    for kind in (Vector3Stamped, Imu, JointState, Range):
        message = kind()
        message.header.stamp.sec, message.header.stamp.nanosec = 12, 345
        message.header.frame_id = "somewhere"
        assert header_stamp_ns(serialize_message(message)) == 12_000_000_345


@pytest.mark.parametrize("count", [-1, 0, 13, 10**30])
def test_a_number_of_members_that_does_not_fit_the_message_is_rejected(count):
    """A definition in a file may state any number of members: none or very many must not raise Python's own errors."""
    message = b"\0\1\0\0" + bytes(12)
    assert plain(message, [("x", "uint8", 12)]) == {"x": (0,) * 12}
    with pytest.raises(CodecError, match=r"\bx (needs|must|of the message)"):
        plain(message, [("x", "uint8", count)])


@pytest.mark.parametrize(
    ("kind", "count", "got"),
    [
        ("wstring", 1, "wstring"),
        ("string", 3, "an array of 3 of type string"),
        ("string", -1, "a sequence of type string"),
        ("float64", -1, "a sequence of type float64"),
    ],
)
def test_a_member_of_a_type_that_cannot_be_read_is_rejected_by_name(kind, count, got):
    with pytest.raises(CodecError, match=rf"cannot read member a\.b of the message: .* single string, got {got}$"):
        plain(b"\0\1\0\0" + bytes(60), [("a.b", kind, count)])


def changed(table, name=None, value=None, drop=(), kinds=None):
    """Return the table with a changed value, without some columns, or with columns of other types."""
    kinds = {column: table.rows.dtype[column] for column in table.rows.dtype.names} | (kinds or {})
    rows = np.zeros(len(table.rows), [(column, kind) for column, kind in kinds.items() if column not in drop])
    for column in rows.dtype.names:
        if column in table.rows.dtype.names and (rows.dtype[column].kind == "S") == (
            table.rows[column].dtype.kind == "S"
        ):
            rows[column] = table.rows[column]
    if name is not None:
        rows[name][-1] = value
    return Table(table.stamp_ns, rows)


def one_of(topic):
    """Return a table of a topic, with only allowed values."""
    rows = np.zeros(2, SCAN if topic is topics.SCAN else topic.columns)
    if topic is topics.INFO:
        rows["rate"] = 1e4
    return Table(0, rows)


@pytest.mark.parametrize("topic", [topic for topic in topics.COMMON if topic.columns is not None], ids=lambda t: t.name)
def test_each_missing_or_mistyped_column_is_named_or_filled(topic):
    table = one_of(topic)
    assert checked(table, topic) is table
    for column in topic.fields:
        without = changed(table, drop=(column.name,))
        if column.default is None:
            with pytest.raises(CodecError, match=f"{topic.name}: column '{column.name}' is missing"):
                checked(without, topic)
        else:
            filled = checked(without, topic).rows
            assert filled.dtype.names[: len(topic.fields)] == tuple(one.name for one in topic.fields)
            assert set(filled[column.name].astype(str)) == {str(np.array([column.default], column.kind).astype(str)[0])}
        other = "f8" if column.kind == TEXT else TEXT
        with pytest.raises(CodecError, match=f"{topic.name}: column '{column.name}' must be of type"):
            checked(changed(table, kinds={column.name: other}), topic)


@pytest.mark.parametrize(
    ("topic", "name", "value", "said"),
    [
        (topics.SCAN, "time", np.nan, "daq/scan: time must be a number from -4294967296 to 4294967296, got nan in"),
        (topics.INFO, "rate", 0.0, "daq/info: rate must be a number from 1 to 1000000, got 0.0 in row 1"),
        (topics.INFO, "rate", np.inf, "rate must be a number from 1 to 1000000, got inf in row 1"),
        (topics.INFO, "rate", 1e12, "rate must be a number from 1 to 1000000, got 1000000000000.0 in row 1"),
        (topics.INFO, "since_start", 1e300, "since_start must be"),
        (topics.INFO, "name", b"\xff", r"daq/info: name must be UTF-8, got b'\xff' in row 1"),
        (topics.APPLIED, "sample", 0.5, "sample must be a whole number from 0 to 9007199254740992, got 0.5"),
        (topics.APPLIED, "sample", -1.0, "shaker/applied: sample must be"),
        (topics.TRANSMISSIBILITY_TABLE, "waited", np.nan, "transmissibility/table: waited must be"),
        (topics.TRANSMISSIBILITY_TABLE, "waited", 1e308, "got 1e+308 in row 1"),
    ],
)  # fmt: skip
def test_an_invalid_value_of_a_topic_is_rejected_by_name(topic, name, value, said):
    with pytest.raises(CodecError, match=re.escape(said)):
        checked(changed(one_of(topic), name, value), topic)


def test_narrower_numbers_and_extra_columns_are_accepted():
    narrow = changed(one_of(topics.APPLIED), "frequency", 9.5, kinds={"frequency": "<f4", "later": "<i2"})
    rows = decode(encode(narrow), topics.APPLIED).rows
    assert rows.dtype.names == (*topics.APPLIED.columns.names, "later")
    assert (rows["frequency"].dtype, rows["frequency"][1]) == (np.dtype("f8"), 9.5)


def test_a_scan_needs_the_requested_channels_as_numbers():
    scan = scan_table()
    with pytest.raises(CodecError, match="daq/scan: column 'accelerometer' is missing"):
        checked(changed(scan, drop=("accelerometer",)), topics.SCAN, ("accelerometer", "laser"))
    assert checked(changed(scan, drop=("accelerometer",)), topics.SCAN, ("laser",)).rows["laser"].shape == (3,)
    with pytest.raises(CodecError, match=r"^column 'laser' is missing$"):
        decode(encode(changed(scan, drop=("laser",))), needs=("laser",))
    with pytest.raises(CodecError, match="daq/scan: column 'laser' must be of type float64, got text"):
        checked(changed(scan, kinds={"laser": TEXT}), topics.SCAN)


def test_rows_that_are_not_contiguous_are_checked_like_others():
    rows = np.zeros(7, topics.APPLIED.columns)
    rows["sample"][4], rows["sample"][5] = 0.5, -1.0
    with pytest.raises(CodecError, match=r"sample must be a whole number .* got 0.5 in row 2, counted from 0"):
        checked(Table(0, rows[::2]), topics.APPLIED)
    table = Table(0, rows[::3])
    assert checked(table, topics.APPLIED) is table
