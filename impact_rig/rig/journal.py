# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The journal: every input that changes what the rig will do, with the first scan it acts on.

One journal, from its `start` or `reset` on, is all a re-simulation needs: it opens with the configuration (rows
`initial`, what differs from the default `RigConfig`) and numbers its rows, so a missing one is seen.
"""

from __future__ import annotations

import enum
import itertools
from collections.abc import Iterable, Mapping

import attrs
import numpy as np

from impact_rig.blocks import JOURNAL, Table
from impact_rig.columns import TEXT_BYTES
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.simtime import NS_PER_S, stamp_ns

Value = bool | int | float | str | tuple[str, ...]

SEPARATOR = "\n"  # between the items of a list
_LONGEST_S = 2.0**32  # two stamps cannot be further apart
_MOST = 2.0**53  # to which whole numbers are exact in a table
NOT_SAMPLED = ("time.", "step.", "pluck.", "output.")
"""Sections that change when and what is published, but not one sample: they are not in the journal."""
SAMPLED = frozenset({"output.command_timeout_s"})
"""Exceptions from `NOT_SAMPLED`."""


class Kind(enum.Enum):
    """What kind of input a row is, and what its columns say."""

    doc: str

    def __new__(cls, value: str, doc: str = "") -> Kind:  # looked up by value alone
        """Make a member: its value is the word in the table."""
        member = object.__new__(cls)
        member._value_ = value
        member.doc = doc
        return member

    START = "start", "Scan 0 of a new rig; text = version of impact_rig."
    RESET = "reset", "Scan 0 of the same rig as new; text = version."
    INITIAL = "initial", "One configuration value at the start that is not the default."
    COMMAND = "command", "key = frequency or current."
    PARAMETER = "parameter", "One configuration value changes; rows `more` after it belong to the same change."
    MORE = "more", "One more configuration value, or one more part of a text, of the change before."
    PLUCK = "pluck", "value = displacement of x_1 [m]."
    STOP = "stop", "The emergency stop."
    CLEAR_TRIP = "clear_trip", "The latch is released."
    FAULT = "fault", "An instrument fault on demand: key = kind/channel, text = duration/seed/rate."
    CLEAR_FAULT = "clear_fault", "value = id of the fault, -1 all of them."
    TRIP = "trip", "The interlock: key = over_travel or over_current, value = what was measured; a result, no input."
    TIMEOUT = "timeout", "No command for output.command_timeout_s; a result, no input."


RESULTS = (Kind.TRIP, Kind.TIMEOUT)
"""Rows a re-simulation produces by itself."""


@attrs.frozen
class Entry:
    """One row of `blocks.JOURNAL`, with its time as a stamp."""

    stamp_ns: int
    sample: int
    sequence: int
    kind: Kind
    key: str
    value: float
    text: bytes


class Journal:
    """Numbers the rows and hands them over as tables.

    Args:
        rate_hz: scan rate.
        start_ns: stamp of scan 0.
    """

    def __init__(self, rate_hz: int, start_ns: int) -> None:
        self._rate_hz = rate_hz
        self._start_ns = start_ns
        self._sequence = 0
        self._pending: list[Entry] = []

    def restart(self, start_ns: int) -> None:
        """Begin a new journal; rows of the old one that were not taken yet stay in front."""
        self._start_ns, self._sequence = start_ns, 0

    def add(self, sample: int, kind: Kind, key: str = "", value: float = 0.0, text: bytes = b"") -> None:
        """Append one row."""
        stamp = stamp_ns(sample, self._rate_hz, self._start_ns)
        self._pending.append(Entry(stamp, sample, self._sequence, kind, key, value, text))
        self._sequence += 1

    def add_values(self, sample: int, kind: Kind, values: Iterable[tuple[str, Value]]) -> None:
        """Append the configuration values of one change; a text needs one row per 32 bytes, `value` counts them."""
        for name, value in values:
            if isinstance(value, (bool, int, float)):
                self.add(sample, kind, short_key(name), float(value))
                kind = Kind.MORE if kind is Kind.PARAMETER else kind
                continue
            raw = (SEPARATOR.join(value) if isinstance(value, tuple) else value).encode()
            for part in range(0, max(len(raw), 1), TEXT_BYTES):
                self.add(sample, kind, short_key(name), part / TEXT_BYTES, raw[part : part + TEXT_BYTES])
                kind = Kind.MORE if kind is Kind.PARAMETER else kind

    def take(self) -> list[Table]:
        """Return the new rows, one table per run of equal stamps, and forget them."""
        pending, self._pending = self._pending, []
        return [_table(stamp, list(run)) for stamp, run in itertools.groupby(pending, lambda entry: entry.stamp_ns)]


def read(tables: Iterable[Table]) -> list[Entry]:
    """Return the rows of the last journal in these tables: from its `start` or `reset` on, in order.

    Raises:
        ConfigError: there is no beginning, rows are missing, or a kind is unknown; the message says why.
    """
    entries: list[Entry] = []
    for table in tables:
        for row in table.rows:
            if not (abs(row["time"]) <= _LONGEST_S and all(0 <= row[name] <= _MOST for name in ("sample", "sequence"))):
                raise ConfigError(
                    f"journal row {len(entries)} is damaged: time must be within {_LONGEST_S:g} s, sample and sequence "
                    f"0 to 2**53, got {row['time']!r}, {row['sample']!r}, {row['sequence']!r}"
                )
            stamp = table.stamp_ns + round(float(row["time"]) * NS_PER_S)
            key, kind = bytes(row["key"]).decode(errors="replace"), bytes(row["kind"]).decode(errors="replace")
            try:
                known = Kind(kind)
            except ValueError:
                raise ConfigError(f"journal row of unknown kind {kind!r}") from None
            sequence = int(row["sequence"])
            if known in (Kind.START, Kind.RESET):
                entries.clear()
            if sequence != len(entries):
                raise ConfigError(f"the journal is not whole: row {len(entries)} is missing (found {sequence})")
            entries.append(
                Entry(stamp, int(row["sample"]), sequence, known, key, float(row["value"]), bytes(row["text"]))
            )
    if not entries:
        raise ConfigError("the journal is empty")
    return entries


def values_of(entries: Iterable[Entry]) -> dict[str, Value]:
    """Return the configuration values in rows made by `Journal.add_values`.

    Raises:
        ConfigError: a key is no configuration value.
    """
    numbers: dict[str, float] = {}
    texts: dict[str, bytes] = {}
    for entry in entries:
        name, default = _full_name(entry.key)
        if isinstance(default, (str, tuple)):
            texts[name] = (texts.get(name, b"") if entry.value else b"") + entry.text
        else:
            numbers[name] = entry.value
    found: dict[str, Value] = {}
    for name, number in numbers.items():
        found[name] = _of_its_type(number, _DEFAULTS[name])
    for name, raw in texts.items():
        try:
            text = raw.decode()
        except UnicodeDecodeError as error:
            raise ConfigError(f"journal row of {name} is not UTF-8: {raw[:40]!r}") from error
        found[name] = tuple(text.split(SEPARATOR)) if isinstance(_DEFAULTS[name], tuple) else text
    return found


def _of_its_type(number: float, default: Value) -> Value:
    """Return a number as the type of its default; a fraction where it is none is left for the validator to refuse."""
    if isinstance(default, bool):
        return bool(number) if number in (0.0, 1.0) else number
    return int(number) if isinstance(default, int) and number.is_integer() else number


def sampled(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return those configuration values that decide samples."""
    return {name: value for name, value in values.items() if name in SAMPLED or not name.startswith(NOT_SAMPLED)}


def not_default(configuration: RigConfig) -> dict[str, Value]:
    """Return the values of `configuration` that decide samples and differ from the default rig."""
    return {name: value for name, value in sampled(to_flat(configuration)).items() if value != _DEFAULTS[name]}


def short_key(name: str) -> str:
    """Return what stands for a configuration value in a row: the last 32 bytes of its name, which are unique."""
    return name[-TEXT_BYTES:]


_DEFAULTS = to_flat(RigConfig())
_NAMES = {short_key(name): name for name in _DEFAULTS}


def _full_name(key: str) -> tuple[str, Value]:
    if key not in _NAMES:
        raise ConfigError(f"journal row of unknown configuration value {key!r}")
    return _NAMES[key], _DEFAULTS[_NAMES[key]]


def _table(stamp: int, entries: list[Entry]) -> Table:
    rows = [(0.0, e.sample, e.sequence, e.kind.value, e.key, e.value, e.text) for e in entries]
    return Table(stamp, np.array(rows, JOURNAL))
