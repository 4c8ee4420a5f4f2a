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
"""Reader of recorded journals, including those of an earlier version of this package, which wrote journals as tables.

A row of such a table names a configuration value by the last 32 bytes of its name, and a text takes one row per 32
bytes. Values that this version does not know are left out. Recordings with such a table can be shown and analysed, but
not simulated again.
"""

from __future__ import annotations

import base64
import itertools
import struct
from collections import defaultdict
from collections.abc import Iterator, Sequence

import attrs
import numpy as np

from impact_rig import codec, topics
from impact_rig.blocks import TEXT, TEXT_BYTES, Column, Table, index, time
from impact_rig.config.tree import Value
from impact_rig.errors import CodecError, CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.recording import Run
from impact_rig.recording.reader import Message
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.rig.journal import BEGINNINGS, InputKind, JournalEntry, decode
from impact_rig.simtime import NS_PER_S

COLUMNS = (
    time("Since the stamp."),
    index("sample", "Index of the first scan it acts on."),
    index("sequence", "Number of the row."),
    Column("kind", "-", "Kind of input.", TEXT),
    Column("key", "-", "What it concerns.", TEXT),
    Column("value", "as the key", "New value; of a text: number of this row's part."),
    Column("text", "-", "Part of a text.", TEXT, is_part=True),
)
TOPIC = topics.former_table(topics.JOURNAL.name, COLUMNS)
_DEFAULTS = to_flat(RigConfig())
_NAMES = {name[-TEXT_BYTES:]: name for name in _DEFAULTS}
_CONTINUE = (b"initial", b"more")
_PACKED = struct.Struct("<QQd")


def of_run(run: Run) -> Iterator[JournalEntry]:
    """Yield the entries of the journal of a run, in the order of recording.

    Raises:
        RecordingError: no journal was recorded.
        ConfigError: a message is not a valid journal.
    """
    for message in run.messages([topics.JOURNAL.name], recorded_order=True):
        try:
            found = entries(message)
        except ConfigError as error:
            raise ConfigError(f"{run.path}: {error}") from error
        yield from found


def entries(message: Message) -> list[JournalEntry]:
    """Return the journal entries in a recorded message of `rig/journal`.

    A message has one entry, as a line of JSON. A message of an earlier version is a table with several entries.

    Raises:
        ConfigError: the message is not a valid journal.
    """
    if message.type_name != topics.TABLE:
        return [decode(message.data)]
    try:
        return list(_of_table(codec.decode(message.data, TOPIC)))
    except CodecError as error:
        raise ConfigError(
            "the journal of inputs (`rig/journal`) is a table of an earlier version, and was damaged or changed "
            f"({error}): use an unchanged copy of the run"
        ) from error


def _of_table(table: Table) -> Iterator[JournalEntry]:
    rows = table.rows
    numbers = itertools.accumulate(row["kind"] not in _CONTINUE for row in rows)
    for _, numbered in itertools.groupby(zip(numbers, rows, strict=True), lambda one: one[0]):
        group = [row for _, row in numbered]
        yield _entry(table.stamp_ns, group)


def _entry(stamp_ns: int, rows: Sequence[np.void]) -> JournalEntry:
    first = rows[0]
    word = bytes(first["kind"]).decode()
    try:  # rows that continue a change in another table have no start here
        kind = InputKind.PARAMETER if first["kind"] in _CONTINUE else InputKind(word)
    except ValueError:
        raise ConfigError(
            f"the journal of inputs (`rig/journal`) is a table, and one of its rows has the kind {word!r}, which this "
            "version does not know; read the run with the version of impact_rig that recorded it"
        ) from None
    sample, stamp = int(first["sample"]), stamp_ns + round(float(first["time"]) * NS_PER_S)
    name, value, text = bytes(first["key"]).decode(), float(first["value"]), bytes(first["text"]).decode()
    begins = kind in BEGINNINGS
    values = _values(rows[1:] if begins else rows) if begins or kind is InputKind.PARAMETER else {}
    entry = JournalEntry(int(first["sequence"]), kind, sample, stamp, text=text if begins else "", values=values)
    if begins or kind is InputKind.PARAMETER:
        return entry
    if kind is InputKind.FAULT:
        return attrs.evolve(entry, fault=_fault(name, value, text, sample))
    is_all = kind is InputKind.CLEAR_FAULT and value < 0
    return attrs.evolve(entry, name=name, value=None if is_all else value, text=text)


def _values(rows: Sequence[np.void]) -> dict[str, Value]:
    numbers: dict[str, float] = {}
    texts: defaultdict[str, bytes] = defaultdict(bytes)
    for row in rows:
        name = _NAMES.get(bytes(row["key"]).decode(), "")
        if isinstance(_DEFAULTS.get(name), (str, tuple)):
            texts[name] = (texts[name] if row["value"] else b"") + bytes(row["text"])
        elif name:
            numbers[name] = float(row["value"])
    found: dict[str, Value] = {}
    for name, number in numbers.items():
        default = _DEFAULTS[name]
        found[name] = bool(number) if isinstance(default, bool) else int(number) if isinstance(default, int) else number
    for name, raw in texts.items():
        words = raw.decode(errors="replace")
        found[name] = tuple(words.split("\n")) if isinstance(_DEFAULTS[name], tuple) else words
    return found


def _fault(key: str, value: float, text: str, sample: int) -> Fault:
    try:
        kind, channel = key.split("/")
        if text.startswith("~"):
            samples, seed, rate = _PACKED.unpack(base64.b85decode(text[1:]))
        else:
            samples, seed, rate = (one(word) for one, word in zip((int, int, float), text.split("/"), strict=True))
        return Fault(
            kind=kind, channel=channel, start_sample=sample, samples=samples, value=value, seed=seed, rate_hz=rate
        )
    except (ValueError, struct.error, CommandError) as error:
        raise ConfigError(
            "the journal of inputs (`rig/journal`) is a table of an earlier version, and was damaged or changed (its "
            f"row with key {key!r} and text {text!r} describes no valid instrument fault): use an unchanged copy of "
            "the run"
        ) from error
