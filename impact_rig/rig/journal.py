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
"""Journal of a rig: all inputs that change its samples, each with the first scan on which it acts.

Each entry is one JSON object on `rig/journal`. The first entry, `start` or `reset`, holds the configuration as
differences from the default `RigConfig`. A re-simulation needs only the journal and, for a streamed drive, the samples
of the stream. Entries are numbered, so a gap is detected. This module also defines which parameters affect samples, and
when a change of a parameter takes effect.
"""

from __future__ import annotations

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any  # Any: values of JSON

import attrs

from impact_rig import codec
from impact_rig.config.tree import Value
from impact_rig.errors import CodecError, CommandError, ConfigError
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.section import InstrumentSetup
from impact_rig.names import quoted
from impact_rig.rig.config import RigConfig, differences, to_flat
from impact_rig.simtime import stamp_ns
from impact_rig.states import Word

PUBLISHING_SECTIONS = ("time.", "step.", "pluck.", "output.")
"""Prefixes of the configuration values that change what is published, and when, but no sample; not in the journal."""
SAMPLE_DECIDING = frozenset({"output.command_timeout_s"})  # affects samples, although in `PUBLISHING_SECTIONS`


class InputKind(Word):
    """Kind of a journal entry, such as a command or a fault; its attribute `doc` explains the members of the entry."""

    START = "start", "Scan 0 of a new rig; text = version of impact_rig, values = what differs from the default rig."
    RESET = "reset", "Scan 0 of the same rig after a reset; text and values as for `start`."
    COMMAND = "command", "name = frequency [Hz] or current [A; m or V by `drive.kind`], value = its new value."
    PARAMETER = "parameter", "Configuration values change; values = the new ones by full name."
    PLUCK = "pluck", "value = displacement of x_1 [m]."
    STOP = "stop", "Emergency stop."
    CLEAR_TRIP = "clear_trip", "Release of the latch."
    FAULT = "fault", "An instrument fault begins at `sample`; fault = its members."
    CLEAR_FAULT = "clear_fault", "value = number of the fault; without a value, all faults."
    TRIP = (
        "trip",
        (
            "The interlock trips: name = over_travel, over_current or underrun, value = the measured quantity or, for "
            "an underrun, the number of the missing sample; a result, not an input."
        ),
    )
    TIMEOUT = "timeout", "No command arrived for output.command_timeout_s; a result, not an input."
    STREAM = (
        "stream",
        (
            "An event of shaker/waveform, a result, not an input. value = number of a sample. name = begin (samples "
            "act from it on), end (they stop; text = underrun, ended or stopped), or crc32 (text = number of samples "
            "from it on that acted, and their CRC-32)."
        ),
    )


BEGINNINGS = (InputKind.START, InputKind.RESET)
RESULTS = (InputKind.TRIP, InputKind.TIMEOUT, InputKind.STREAM)  # entries that a re-simulation produces by itself


@attrs.frozen
class JournalEntry:
    """Entry of a journal: one input that changed the rig, or a result that a re-simulation must reproduce.

    The members `name` to `fault` depend on the kind, and `kind.doc` says what they mean. Members that a kind does not
    use are empty; an empty `value` or `fault` is None.

    Attributes:
        sequence: number of the entry, from 0 at `start` or `reset`.
        kind: kind of the entry.
        sample: index of the first scan that it acts on, from 0 at `start` or `reset`.
        stamp_ns: stamp of that scan [ns].
        name: what a command changes, the reason of a trip, or the event of a stream.
        value: number that belongs to `name`, or the displacement of a pluck, or the number of a fault.
        text: version of impact_rig, or details of a stream's event.
        values: configuration values by full name.
        fault: instrument fault.
    """

    sequence: int
    kind: InputKind
    sample: int
    stamp_ns: int
    name: str = ""
    value: float | None = None
    text: str = ""
    values: Mapping[str, Value] = attrs.field(factory=dict)
    fault: Fault | None = None

    @property
    def number(self) -> float:
        """Attribute `value` as a number; only for kinds that always have a value, such as a command or a pluck."""
        assert self.value is not None
        return self.value

    def line(self) -> str:
        """Return the entry as one line of JSON, without empty members."""
        content: dict[str, Any] = {
            "sequence": self.sequence,
            "kind": self.kind.value,
            "sample": self.sample,
            "stamp_ns": self.stamp_ns,
        }
        content |= {key: found for key in ("name", "value", "text") if (found := getattr(self, key)) not in ("", None)}
        if self.values:
            content["values"] = dict(self.values)
        if self.fault is not None:
            content["fault"] = {name: number for name, number in attrs.asdict(self.fault).items() if name in _OF_FAULT}
        return json.dumps(content)

    @classmethod
    def from_line(cls, line: str) -> JournalEntry:
        """Parse one line of JSON as an entry.

        Raises:
            ConfigError: the line is not a journal entry of this version.
        """
        try:
            return cls._parsed(line)
        except ConfigError as error:
            raise ConfigError(f"{_INVALID} {line[:60]!r}: {error}; {_CAUSES}") from error

    @classmethod
    def _parsed(cls, line: str) -> JournalEntry:
        try:
            content = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise ConfigError("it is not valid JSON") from error
        if not isinstance(content, dict):
            raise ConfigError("it is not a JSON object")
        unknown = content.keys() - _MEMBERS.keys()
        if unknown:
            raise ConfigError(f"it has the unknown member {min(unknown)!r}, known are {', '.join(_MEMBERS)}")
        for member, kinds in _MEMBERS.items():
            is_required = member in ("sequence", "kind", "sample", "stamp_ns")
            if (member in content or is_required) and type(content.get(member)) not in kinds:
                got = f"got {quoted(content[member])}" if member in content else "it is missing"
                raise ConfigError(f"its member {member} must be {_JSON_NAMES[kinds[0]]}, {got}")
        try:
            kind = InputKind(content["kind"])
        except ValueError:
            known = ", ".join(InputKind)
            raise ConfigError(f"it has the unknown kind {content['kind']!r}, known are {known}") from None
        values = {name: _typed(name, value) for name, value in content.pop("values", {}).items()}
        fault = _fault(content.pop("fault"), content["sample"]) if "fault" in content else None
        if "value" in content:
            content["value"] = _float("value", content["value"])
        if kind in _NEED_VALUE and "value" not in content:
            raise ConfigError(f"an entry of kind {kind.value} needs a value")
        for member, high, shown in _RANGES:
            if not 0 <= content[member] <= high:
                raise ConfigError(f"its member {member} must be from 0 to {shown}, got {quoted(content[member])}")
        if (fault is not None) != (kind is InputKind.FAULT):
            rule = "needs a fault" if fault is None else "must have no fault"
            raise ConfigError(f"an entry of kind {kind.value} {rule}")
        return cls(**content | {"kind": kind, "values": values, "fault": fault})


_MEMBERS: dict[str, tuple[type, ...]] = {
    "sequence": (int,), "kind": (str,), "sample": (int,), "stamp_ns": (int,), "name": (str,), "value": (float, int),
    "text": (str,), "values": (dict,), "fault": (dict,),
}  # fmt: skip
_OF_FAULT = {field.name for field in attrs.fields(Fault)} - {"start_sample"}  # it starts at the entry's sample
_NEED_VALUE = (InputKind.COMMAND, InputKind.PLUCK, InputKind.TRIP, InputKind.STREAM)
_LARGEST = 2**53
_RANGES = (("sequence", _LARGEST, "2^53"), ("sample", _LARGEST, "2^53"), ("stamp_ns", 2**63 - 1, "2^63 - 1"))
_JSON_NAMES: dict[type, str] = {
    bool: "true or false", int: "an integer", float: "a number", str: "a text", tuple: "a list of texts",
    dict: "an object",
}  # fmt: skip
_INVALID = "invalid entry of the journal of inputs (`rig/journal`)"
_CAUSES = (
    "only rigs write such entries, so this one was damaged or changed, or is of another version of impact_rig: read it "
    "with that version, or record the run again"
)
_COMPLETE = "record the run again (in Python: pass all entries since the start or reset)"


def _float(name: str, value: float) -> float:
    try:
        return float(value)
    except OverflowError:
        raise ConfigError(f"{name} is an integer too large for a double (1.8e308)") from None


def _typed(name: str, value: Any) -> Value:
    """Convert a JSON value to the type of the configuration value called `name`.

    Raises:
        ConfigError: no configuration value has this name, or the JSON value has another type. An integer is accepted
            for a float.
    """
    if name not in _DEFAULTS:
        raise ConfigError(f"it has the unknown configuration value {name!r}")
    default = _DEFAULTS[name]
    if isinstance(default, tuple) and isinstance(value, list) and all(isinstance(one, str) for one in value):
        return tuple(value)
    if isinstance(default, float) and type(value) is int:
        return _float(name, value)
    if type(value) is not type(default):
        raise ConfigError(f"{name} must be {_JSON_NAMES[type(default)]}, got {quoted(value)}")
    return value


def _fault(content: Mapping[str, Any], sample: int) -> Fault:
    for name, value in content.items():
        if name not in _OF_FAULT:
            known = ", ".join(sorted(_OF_FAULT))
            raise ConfigError(f"its fault has the unknown member {name!r}, known are {known}")
        allowed = (str,) if name in ("kind", "channel") else (int,) if name in ("samples", "seed") else (int, float)
        if type(value) not in allowed:
            raise ConfigError(f"{name} of its fault must be {_JSON_NAMES[allowed[-1]]}, got {quoted(value)}")
    try:
        return Fault(**{"kind": ""} | dict(content), start_sample=sample)
    except (CommandError, OverflowError) as error:
        raise ConfigError(f"it has an invalid instrument fault: {error}") from error


def encode(entry: JournalEntry) -> bytes:
    """Encode an entry as a message of `rig/journal`."""
    return codec.encode_text(entry.line())


def decode(data: codec.Buffer) -> JournalEntry:
    """Decode a message of `rig/journal`.

    Raises:
        ConfigError: the message is not a journal entry of this version.
    """
    try:
        return JournalEntry.from_line(codec.text(data))
    except CodecError as error:
        raise ConfigError(f"{_INVALID}: it is not a text message: {error}; {_CAUSES}") from error


class Journal:
    """Writer of a rig's journal, which numbers and queues the entries."""

    def __init__(self, rate_hz: int, start_ns: int) -> None:
        self._rate_hz = rate_hz
        self._start_ns = start_ns
        self._sequence = 0
        self._pending: list[JournalEntry] = []

    def restart(self, start_ns: int) -> None:
        """Number the next entries from 0 again; from now on, scan 0 has the stamp `start_ns` [ns].

        Older entries that `take` has not returned yet stay in the queue.
        """
        self._start_ns, self._sequence = start_ns, 0

    def add(self, sample: int, kind: InputKind, **members: Any) -> None:
        """Append an entry that first acts on the scan `sample`; `members` are further attributes of `JournalEntry`."""
        stamp = stamp_ns(sample, self._rate_hz, self._start_ns)
        self._pending.append(JournalEntry(self._sequence, kind, sample, stamp, **members))
        self._sequence += 1

    def take(self) -> list[JournalEntry]:
        """Return the entries added since the last call, and drop them from the queue."""
        pending, self._pending = self._pending, []
        return pending


class JournalView:
    """State of a rig according to its journal, updated entry by entry.

    The journal may be incomplete. If its beginning is missing, the state contains only what the received entries say.
    Configuration values that affect no sample are in no journal, so they always have their defaults here.

    Attributes:
        configuration: every configuration value by full name; the default if no entry has changed it. The planned
            faults stay those of the last start or reset: the journal has their later changes as faults.
        drive: the last commanded `frequency` [Hz] and `current` [A; m or V by `drive.kind`]. A key is missing if there
            was no such command since the start or reset.
        latched: the last entry that latched the shaker, kind `trip` or `stop`; None if it is not latched.
        plucked: whether the base is locked after a pluck, until the next reset.
        start_ns: stamp of scan 0 [ns]; None if no start or reset was received.
    """

    def __init__(self) -> None:
        self.start_ns: int | None = None
        self.configuration: dict[str, Value] = dict(_DEFAULTS)
        self.drive: dict[str, float] = {}
        self.latched: JournalEntry | None = None
        self.plucked = False

    def follow(self, entry: JournalEntry) -> None:
        """Update the attributes of this object by the next entry of the rig's journal."""
        if entry.kind in BEGINNINGS:
            self.start_ns, self.latched, self.plucked = entry.stamp_ns, None, False
            self.configuration, self.drive = dict(_DEFAULTS), {}
        elif entry.kind in (InputKind.TRIP, InputKind.STOP):
            self.latched = entry
        elif entry.kind is InputKind.CLEAR_TRIP:
            self.latched = None
        elif entry.kind is InputKind.PLUCK:
            self.plucked = True
        elif entry.kind is InputKind.COMMAND:
            self.drive[entry.name] = entry.number
        self.configuration.update(entry.values)


def last_journal(entries: Iterable[JournalEntry]) -> list[JournalEntry]:
    """Return the entries from the last `start` or `reset` on, in order.

    Raises:
        ConfigError: there are no entries, the first entry is no `start` or `reset`, or the numbers of the entries have
            a gap, also before the last `start` or `reset`. The message has the number of the first missing entry.
            Entries missing at the end of a journal are not detected.
    """
    found: list[JournalEntry] = []
    for entry in entries:
        if entry.kind in BEGINNINGS:
            found.clear()
        if entry.sequence != len(found):
            raise ConfigError(
                f"the journal of inputs (`rig/journal`) is incomplete: entry {len(found)}, counted from 0, is missing "
                f"(found {entry.sequence} instead); {_COMPLETE}"
            )
        if not found and entry.kind not in BEGINNINGS:
            raise ConfigError(
                f"the journal of inputs (`rig/journal`) must begin with a start or reset, got {entry.kind.value}; "
                f"{_COMPLETE}"
            )
        found.append(entry)
    if not found:
        raise ConfigError(
            f"the journal of inputs (`rig/journal`) has no entry, but must begin with a start or reset; {_COMPLETE}"
        )
    return found


def deciding_samples(values: Mapping[str, Value]) -> dict[str, Value]:
    """Return those of the configuration values that affect samples and belong in a journal, by full name."""
    return {
        name: value
        for name, value in values.items()
        if name in SAMPLE_DECIDING or not name.startswith(PUBLISHING_SECTIONS)
    }


def not_default(configuration: RigConfig) -> dict[str, Value]:
    """Return the values of `configuration`, by full name, that affect samples and differ from the default rig's."""
    return deciding_samples(differences(configuration))


_DEFAULTS = to_flat(RigConfig())

MECHANICAL_SECTIONS = ("structure.", "shaker.", "sphere.", "barriers.", "contact.")
LIMITS = frozenset({
    "shaker.travel_limit_m", "shaker.current_limit_a_rms", "shaker.frequency_min_hz", "shaker.frequency_max_hz",
    "shaker.ramp_s", "shaker.stop_ramp_s",
})  # fmt: skip
"""Values in `MECHANICAL_SECTIONS` that are in no equation of motion: a change of them leaves the motion unchanged."""
INSTRUMENT_SECTIONS = ("instruments.", "daq.")
PLANNED = "instruments.faults.planned"
AT_RESET = ("drive.", "daq.seed")  # values used at the beginning only


def is_mechanics(name: str) -> bool:
    """Return whether the parameter `name` is part of the equations of motion.

    Changing such a parameter puts the sphere back to `sphere.start`.
    """
    return name.startswith(MECHANICAL_SECTIONS) and name not in LIMITS


def takes_effect(name: str) -> str:
    """Return a text that says when a new value of the parameter `name` takes effect on a running rig.

    Whether the parameter can be changed at all is not checked.
    """
    if name == PLANNED:
        return "next command instant, for added or removed lines"
    if name.startswith(AT_RESET):
        return "next reset"
    if name.startswith(PUBLISHING_SECTIONS) and name not in SAMPLE_DECIDING:
        return "at once"
    if is_mechanics(name):
        return "next command instant; the sphere rests at `sphere.start` again"
    return "next command instant"


def until_reset(present: InstrumentSetup, config: RigConfig) -> RigConfig:
    """Return `config` with the seed and the planned faults of the present instruments (`present`).

    Running instruments use the seed and the planned faults only at a reset, and refuse to change them.
    """
    return attrs.evolve(
        config,
        daq=attrs.evolve(config.daq, seed=present.daq.seed),
        instruments=attrs.evolve(config.instruments, faults=present.instruments.faults),
    )


@attrs.frozen
class FaultChange:
    """Change of the planned faults: the removed lines (`gone`), and the added lines with their faults (`new`)."""

    gone: tuple[str, ...]
    new: tuple[tuple[str, Fault], ...]


class PlannedFaults:
    """Record of the faults that the lines of `instruments.faults.planned` have started, by line.

    Args:
        lines: planned faults at the start or reset, which the instruments have numbered from 1 in this order.
        rate_hz: scans per second.
    """

    def __init__(self, lines: Iterable[str], rate_hz: int) -> None:
        self._rate_hz = rate_hz
        self._numbers: defaultdict[str, list[int]] = defaultdict(list)
        for number, line in enumerate(_written(lines), start=1):
            self._numbers[line].append(number)

    def replan(self, lines: Iterable[str], sample: int) -> FaultChange:
        """Return the change from the present lines of planned faults to new lines, without applying it.

        Args:
            lines: all lines after the change. The fault of a line that stays goes on.
            sample: number of the first scan on which added lines can act. Their `start_s` count from this scan.

        Raises:
            ConfigError: an added line is not a valid fault, or starts too late to be represented.
        """
        before = Counter({line: len(numbers) for line, numbers in self._numbers.items()})
        after = Counter(_written(lines))
        new = tuple((line, self._fault(line, sample)) for line in (after - before).elements())
        return FaultChange(tuple((before - after).elements()), new)

    def apply(self, change: FaultChange, clear: Callable[[int], None], inject: Callable[[Fault], int]) -> None:
        """Clear the faults of removed lines, then inject the faults of added lines.

        Args:
            change: result of `replan`, with no other change applied since.
            clear: function that ends the fault with a given number, which may have ended already.
            inject: function that starts a fault and returns its number.
        """
        for line in change.gone:
            clear(self._numbers[line].pop())
        for line, fault in change.new:
            self._numbers[line].append(inject(fault))

    def _fault(self, line: str, sample: int) -> Fault:
        fault = Fault.from_line(line, self._rate_hz)
        try:
            return attrs.evolve(fault, start_sample=sample + fault.start_sample)
        except CommandError as error:
            raise ConfigError(str(error)) from error


def _written(lines: Iterable[str]) -> Iterator[str]:
    """Yield the lines that are not blank; `FaultPlan.faults` skips blank lines as well."""
    return (line for line in lines if line.split())
