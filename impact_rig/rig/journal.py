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
"""The journal: every input that changes what the rig will do, with the first scan it acts on.

One journal, from its `start` or `reset` on, is all a re-simulation needs: it opens with the configuration (rows
`initial`, what differs from the default `RigConfig`) and numbers its rows, so a missing one is seen. What a change of a
value touches, and from when on, stands here too.
"""

from __future__ import annotations

import enum
import itertools
import struct
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

import attrs
import numpy as np

from impact_rig import codec, topics
from impact_rig.blocks import JOURNAL, TEXT_BYTES, Table
from impact_rig.errors import CodecError, CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.section import InstrumentSetup
from impact_rig.rig.config import RigConfig, differences, to_flat
from impact_rig.simtime import NS_PER_S, stamp_ns

Value = bool | int | float | str | tuple[str, ...]

SEPARATOR = "\n"  # between the items of a list
PUBLISHING_SECTIONS = ("time.", "step.", "pluck.", "output.")
"""Sections that change when and what is published, but not one sample: they are not in the journal."""
SAMPLE_DECIDING = frozenset({"output.command_timeout_s"})  # exceptions in `PUBLISHING_SECTIONS`: they decide samples


class InputKind(enum.Enum):
    """What kind of input a row is, and what its columns say."""

    doc: str

    def __new__(cls, value: str, doc: str = "") -> InputKind:  # looked up by value alone
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
    TRIP = (
        "trip",
        (
            "The interlock: key = over_travel, over_current or underrun, value = what was measured, of an underrun the "
            "sample that was missing; a result, no input."
        ),
    )
    TIMEOUT = "timeout", "No command for output.command_timeout_s; a result, no input."
    STREAM = (
        "stream",
        (
            "Of shaker/waveform, value = number of a sample; key = begin (samples are in force from it on), end (they "
            "no longer are; text = underrun, ended or stopped), crc32 (so many from it on came into force; text = how "
            "many, and their CRC-32); a result."
        ),
    )


RESULTS = (InputKind.TRIP, InputKind.TIMEOUT, InputKind.STREAM)  # rows a re-simulation produces by itself


@attrs.frozen
class JournalRow:
    """One row of `blocks.JOURNAL`, with its time as a stamp."""

    stamp_ns: int
    sample: int
    sequence: int
    kind: InputKind
    key: str
    value: float
    text: bytes

    @classmethod
    def of(cls, table: Table, row: np.void) -> JournalRow:
        """Return a row of a checked table.

        Raises:
            ConfigError: its kind is unknown.
        """
        kind = bytes(row["kind"]).decode()
        try:
            known = InputKind(kind)
        except ValueError:
            raise ConfigError(f"journal row of unknown kind {kind!r}") from None
        stamp = table.stamp_ns + round(float(row["time"]) * NS_PER_S)
        key, text = bytes(row["key"]).decode(), bytes(row["text"])
        return cls(stamp, int(row["sample"]), int(row["sequence"]), known, key, float(row["value"]), text)

    def same(self, other: JournalRow) -> bool:
        """Return whether two rows are the same bit for bit."""
        ours, theirs = (attrs.evolve(one, value=0.0) for one in (self, other))
        return ours == theirs and struct.pack("<d", self.value) == struct.pack("<d", other.value)


class Journal:
    """Numbers the rows and hands them over as tables."""

    def __init__(self, rate_hz: int, start_ns: int) -> None:
        self._rate_hz = rate_hz
        self._start_ns = start_ns
        self._sequence = 0
        self._pending: list[JournalRow] = []

    def restart(self, start_ns: int) -> None:
        """Begin a new journal; rows of the old one that were not taken yet stay in front."""
        self._start_ns, self._sequence = start_ns, 0

    def add(self, sample: int, kind: InputKind, key: str = "", value: float = 0.0, text: bytes = b"") -> None:
        """Append one row."""
        stamp = stamp_ns(sample, self._rate_hz, self._start_ns)
        self._pending.append(JournalRow(stamp, sample, self._sequence, kind, key, value, text))
        self._sequence += 1

    def add_values(self, sample: int, kind: InputKind, values: Iterable[tuple[str, Value]]) -> None:
        """Append the configuration values of one change; a text needs one row per 32 bytes, `value` counts them."""
        for name, value in values:
            if isinstance(value, (bool, int, float)):
                self.add(sample, kind, short_key(name), float(value))
                kind = InputKind.MORE if kind is InputKind.PARAMETER else kind
                continue
            raw = (SEPARATOR.join(value) if isinstance(value, tuple) else value).encode()
            for part in range(0, max(len(raw), 1), TEXT_BYTES):
                self.add(sample, kind, short_key(name), part / TEXT_BYTES, raw[part : part + TEXT_BYTES])
                kind = InputKind.MORE if kind is InputKind.PARAMETER else kind

    def take(self) -> list[Table]:
        """Return the new rows, one table per run of equal stamps, and forget them."""
        pending, self._pending = self._pending, []
        tables: list[Table] = []
        for stamp, run in itertools.groupby(pending, lambda entry: entry.stamp_ns):
            rows = [(0.0, e.sample, e.sequence, e.kind.value, e.key, e.value, e.text) for e in run]
            tables.append(Table(stamp, np.array(rows, JOURNAL)))
        return tables


@attrs.frozen(eq=False)
class JournalInput:
    """One input, whatever number of rows it has."""

    stamp_ns: int  # of the first scan it acts on
    sample: int  # index of that scan
    sequence: int  # number of its first row
    kind: InputKind  # what it is; never `more`
    key: str  # what it is about
    value: float  # new value of a command, displacement of a pluck [m], number of a fault to clear, what tripped
    text: str  # of a fault; version at `start` and `reset`
    configuration: Mapping[str, Value]  # values by full name; of `parameter` and `initial`, empty otherwise


def changes(entries: Sequence[JournalRow]) -> Iterator[JournalInput]:
    """Yield the inputs that rows say: the one interpretation of a journal.

    Rows `more` belong to the parameter before them; the rows `initial` of one start are one input.

    Raises:
        ConfigError: a key is no configuration value, or a text no UTF-8.
    """
    numbers = itertools.accumulate(_begins(entries[n - 1] if n else None, entry) for n, entry in enumerate(entries))
    for _, numbered in itertools.groupby(zip(numbers, entries, strict=True), lambda one: one[0]):
        group = [entry for _, entry in numbered]
        first = group[0]
        text = first.text.decode(errors="replace")
        found = values_of(group) if first.kind in (InputKind.PARAMETER, InputKind.MORE, InputKind.INITIAL) else {}
        kind = (
            InputKind.PARAMETER if first.kind is InputKind.MORE else first.kind
        )  # its beginning came in another table
        yield JournalInput(first.stamp_ns, first.sample, first.sequence, kind, first.key, first.value, text, found)


def _begins(before: JournalRow | None, entry: JournalRow) -> bool:
    """Return whether a row is the first of an input."""
    if entry.kind is InputKind.INITIAL:
        return before is None or before.kind is not InputKind.INITIAL
    return entry.kind is not InputKind.MORE


class JournalView:
    """What a journal says so far, table by table: what happened, and what the rig is by that.

    It needs no whole journal: of one that is heard from its middle on it says what it can.

    Attributes:
        configuration: every value by full name; of what no row has said, the default.
        drive: what was commanded last, `frequency` [Hz] and `current` [A; m or V by `drive.kind`].
        latched: the row that latched the shaker, kind `trip` or `stop`; None: it is free.
        plucked: whether the base is locked after a pluck, until the next reset.
        start_ns: stamp of scan 0; None: no start has been heard.
    """

    def __init__(self) -> None:
        self.start_ns: int | None = None
        self.configuration: dict[str, Value] = dict(_DEFAULTS)
        self.drive: dict[str, float] = {}
        self.latched: JournalInput | None = None
        self.plucked = False

    def take(self, table: Table) -> list[JournalInput]:
        """Take the rows of a table and return the inputs they say, in order.

        Raises:
            ConfigError: the table is no journal's, or of a version with other kinds or values; nothing of it is taken.
        """
        found = list(changes([*_entries(table)]))
        for change in found:
            self.follow(change)
        return found

    def follow(self, change: JournalInput) -> None:
        """Take one input."""
        if change.kind in (InputKind.START, InputKind.RESET):
            self.start_ns, self.latched, self.plucked = change.stamp_ns, None, False
            self.configuration, self.drive = dict(_DEFAULTS), {}
        elif change.kind in (InputKind.TRIP, InputKind.STOP):
            self.latched = change
        elif change.kind is InputKind.CLEAR_TRIP:
            self.latched = None
        elif change.kind is InputKind.PLUCK:
            self.plucked = True
        elif change.kind is InputKind.COMMAND:
            self.drive[change.key] = change.value
        self.configuration.update(change.configuration)


def read(tables: Iterable[Table]) -> list[JournalRow]:
    """Return the rows of the last journal in these tables: from its `start` or `reset` on, in order.

    Raises:
        ConfigError: there is no beginning, rows are missing, a kind is unknown, or a table is no journal's.
    """
    entries: list[JournalRow] = []
    for table in tables:
        for entry in _entries(table):
            if entry.kind in (InputKind.START, InputKind.RESET):
                entries.clear()
            if entry.sequence != len(entries):
                raise ConfigError(f"the journal is not whole: row {len(entries)} is missing (found {entry.sequence})")
            entries.append(entry)
    if not entries:
        raise ConfigError("the journal is empty")
    return entries


def _entries(table: Table) -> Iterator[JournalRow]:
    """Yield the rows of a table."""
    try:
        rows = codec.checked(table, topics.JOURNAL).rows
    except CodecError as error:
        raise ConfigError(str(error)) from error
    for row in rows:
        yield JournalRow.of(table, row)


def values_of(entries: Iterable[JournalRow]) -> dict[str, Value]:
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


def deciding_samples(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return those configuration values that decide samples."""
    return {
        name: value
        for name, value in values.items()
        if name in SAMPLE_DECIDING or not name.startswith(PUBLISHING_SECTIONS)
    }


def not_default(configuration: RigConfig) -> dict[str, Value]:
    """Return the values of `configuration` that decide samples and differ from the default rig."""
    return deciding_samples(differences(configuration))


def short_key(name: str) -> str:
    """Return what stands for a configuration value in a row: the last 32 bytes of its name, which are unique."""
    return name[-TEXT_BYTES:]


_DEFAULTS = to_flat(RigConfig())
_NAMES = {short_key(name): name for name in _DEFAULTS}


def _full_name(key: str) -> tuple[str, Value]:
    if key not in _NAMES:
        raise ConfigError(f"journal row of unknown configuration value {key!r}")
    return _NAMES[key], _DEFAULTS[_NAMES[key]]


MECHANICAL_SECTIONS = ("structure.", "shaker.", "sphere.", "barriers.", "contact.")
LIMITS = frozenset({
    "shaker.travel_limit_m", "shaker.current_limit_a_rms", "shaker.frequency_min_hz", "shaker.frequency_max_hz",
    "shaker.ramp_s", "shaker.stop_ramp_s",
})  # fmt: skip
"""Values in the mechanics' sections that stand in no equation of motion: a change of them leaves the state as it is."""
INSTRUMENT_SECTIONS = ("instruments.", "daq.")
PLANNED = "instruments.faults.planned"
AT_RESET = ("drive.", "daq.seed")  # what is drawn or commanded at the beginning only


def is_mechanics(name: str) -> bool:
    """Return whether the equations of motion have a parameter: a change of it puts the sphere back to its start."""
    return name.startswith(MECHANICAL_SECTIONS) and name not in LIMITS


def takes_effect(name: str) -> str:
    """Return from when on a new value of a parameter acts on a running rig, in words."""
    if name == PLANNED:
        return "next command instant, for the lines that are new or gone"
    if name.startswith(AT_RESET):
        return "next reset"
    if name.startswith(PUBLISHING_SECTIONS) and name not in SAMPLE_DECIDING:
        return "at once"
    if is_mechanics(name):
        return "next command instant; the sphere rests at `sphere.start` again"
    return "next command instant"


def until_reset(present: InstrumentSetup, config: RigConfig) -> RigConfig:
    """Return `config` with the seed and the planned faults of `present`: the instruments draw both at a reset."""
    return attrs.evolve(
        config,
        daq=attrs.evolve(config.daq, seed=present.daq.seed),
        instruments=attrs.evolve(config.instruments, faults=present.instruments.faults),
    )


@attrs.frozen
class Replan:
    """What one change of the list does: the lines that go, and the lines that come with the faults they make."""

    gone: tuple[str, ...]
    new: tuple[tuple[str, Fault], ...]


class PlanInForce:
    """Which line made which faults.

    Args:
        lines: `instruments.faults.planned` at the beginning; the fault board has numbered their faults from 1.
        rate_hz: scan rate.
    """

    def __init__(self, lines: Iterable[str], rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._numbers: defaultdict[str, list[int]] = defaultdict(list)
        for number, line in enumerate(_written(lines), start=1):
            self._numbers[line].append(number)

    def replan(self, lines: Iterable[str], sample: int) -> Replan:
        """Return what turns the present lines into these; nothing changes before `put_into_force`.

        Args:
            lines: as they shall be.
            sample: the first scan they act on; the `start_s` of new lines count from there.

        Raises:
            ConfigError: an added line describes no fault, or one that starts too late to be written down.
        """
        before = Counter({line: len(numbers) for line, numbers in self._numbers.items()})
        after = Counter(_written(lines))
        new = tuple((line, self._fault(line, sample)) for line in (after - before).elements())
        return Replan(tuple((before - after).elements()), new)

    def put_into_force(self, replan: Replan, clear: Callable[[int], None], inject: Callable[[Fault], int]) -> None:
        """Clear the faults of the lines that go, then inject those of the lines that come.

        Args:
            replan: as `replan` returned it, with no other change in between.
            clear: ends the fault of a number, which may have ended already.
            inject: starts a fault and returns its number.
        """
        for line in replan.gone:
            clear(self._numbers[line].pop())
        for line, fault in replan.new:
            self._numbers[line].append(inject(fault))

    def _fault(self, line: str, sample: int) -> Fault:
        fault = Fault.from_line(line, self._rate_hz)
        try:
            return attrs.evolve(fault, start_sample=sample + fault.start_sample)
        except CommandError as error:
            raise ConfigError(str(error)) from error


def _written(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines that say something, as `FaultPlan.faults` reads them."""
    return (line for line in lines if line.split())
