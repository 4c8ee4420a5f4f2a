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
"""`RigDriver`: the interface by which a program drives a rig, in this process or over ROS topics.

Rig time (the simulated time) advances only in `step`, by whole blocks of scans, 10 ms each by default. A rig that runs
by itself advances with its own clock, and `step` waits for its blocks instead. Inputs take effect at exact scans. What
the rig publishes is read as tables.
"""

from __future__ import annotations

import abc
import math
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self, TypeVar  # Any: value of a parameter

import numpy as np
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.blocks import WAVEFORM, Table
from impact_rig.errors import CommandError, ConfigError, ImpactRigError, did_you_mean
from impact_rig.instruments.fault import Fault
from impact_rig.instruments.section import SCAN
from impact_rig.rig.config import RigConfig, from_flat, to_flat
from impact_rig.rig.interlock import amplitude_limit
from impact_rig.rig.journal import JournalEntry
from impact_rig.simtime import TICKS_PER_S, first_scan_at, stamp_ns

SCANS = topics.SCAN.name
ESSENTIAL = (topics.INFO.name, topics.APPLIED.name, topics.JOURNAL.name)
"""Topics whose tables `clear` keeps, because each of their tables applies until the next one."""
TOPICS = (SCANS, *ESSENTIAL, topics.IMPACTS_TRUTH.name, topics.FAULTS.name)
"""Topics whose tables every driver keeps; the argument `also` of a rig adds others."""
STEP_TIMEOUT_S = 240.0  # without the library of kernels, the first step compiles the physics
_DEFAULTS = to_flat(RigConfig())
_ROWS = {**{topic.name: topic.columns for topic in topics.COMMON if topic.columns is not None}, SCANS: SCAN}
_T = TypeVar("_T")
_HIDDEN = ("time.", "instruments.faults")  # not useful in a report; listed as text


class NotReachedError(ImpactRigError, AssertionError):
    """Timeout of `RigDriver.wait_until`, in rig time; an `AssertionError` for tests, and not a `TimeoutError`."""


class NoSamplesError(ImpactRigError, TimeoutError):
    """Lack of drive samples: the stream that drives a rig has none for the next block, so the rig cannot advance."""


class StreamLevel(NamedTuple):
    """State of the buffer in a rig that holds the samples of its drive (`drive.waveform: stream`).

    Attributes:
        sample: number of the next sample to play, counted from scan 0 at the rate of the stream.
        buffered: number of samples in the buffer from `sample` on, up to the first gap.
        capacity: number of samples that the buffer can hold.
        late: number of samples dropped because they arrived too late, since the start or the last reset of the rig.
        missing: number of samples that had not arrived when the rig needed them, since the start or the last reset.
    """

    sample: int
    buffered: int
    capacity: int
    late: int
    missing: int

    def __str__(self) -> str:
        """Return the state of the buffer as text, for error messages."""
        return (
            f"sample {self.sample} is next, {self.buffered} of at most {self.capacity} are buffered, "
            f"{self.late} were late, {self.missing} were missing"
        )


class Turns:
    """Fair reentrant lock: a thread that releases it cannot get it again before one of the waiting threads."""

    def __init__(self) -> None:
        self._next, self._lock = threading.Lock(), threading.Lock()
        self._owner: int | None = None
        self._depth = 0

    def __enter__(self) -> None:
        if self._owner != threading.get_ident():
            with self._next:
                self._lock.acquire()
            self._owner = threading.get_ident()
        self._depth += 1

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._owner = None
            self._lock.release()


class RigDriver(abc.ABC):
    """Interface of a rig that a program operates; `LocalRig` and `RosRig` implement it.

    Args:
        name: name of the rig in reports and error messages.
        config: configuration of the rig.

    Attributes:
        sample: number of the first scan of the next block.
        closed: whether `close` was called.
        lead_s: rig time [s] that a sample needs to arrive: send it at least this long before the rig plays it; 0 for a
            rig that waits for its samples.
        runs_by_itself: whether rig time advances without `step`; `step` then waits for it.
        scenario: text of a program that repeats the actions on this rig; it is saved with the run of a failed test.
        turns: lock that a thread holds while it calls a rig that it shares with other threads.
        fed: event that is set when a thread has sent samples, ended the stream or advanced the rig; it wakes a thread
            that waits for samples.
    """

    lead_s = 0.0
    runs_by_itself = False

    def __init__(self, name: str, config: RigConfig) -> None:
        self.name = name
        self.config = config
        self.sample = 0
        self.closed = False
        self.scenario = ""
        self._start_ns = 0  # stamp of scan 0
        self._kept_from = 0  # first scan that is kept
        self._lost_before = 0  # scans lost before that
        self._listeners: list[Callable[[Table], object]] = []
        self.turns, self.fed = Turns(), threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # Methods of a subclass

    @abc.abstractmethod
    def step(self, blocks: int = 1, timeout_s: float = STEP_TIMEOUT_S) -> None:
        """Advance by whole blocks of scans; in lockstep, return when the nodes under test have processed all of them.

        A rig that runs by itself is not advanced: the call returns when that many further blocks have arrived.

        Args:
            blocks: number of blocks.
            timeout_s: limit of wall time [s].

        Raises:
            TimeoutError: the blocks did not arrive in time, or the stream that drives the rig has no samples for them.
        """

    @abc.abstractmethod
    def tables(self, topic: str = SCANS) -> list[Table]:
        """Return the tables of a topic that were published and are still kept, oldest first.

        Raises:
            ConfigError: the rig keeps no tables of this topic; the argument `also` of the rig adds topics.
        """

    @abc.abstractmethod
    def journal(self) -> list[JournalEntry]:
        """Return the kept journal entries, oldest first.

        An entry is an input that changed the rig's state. Neither a reset nor `clear` drops entries.
        """

    @abc.abstractmethod
    def save(self, directory: str | Path) -> Path:
        """Write an MCAP run of this rig into a new directory, and return that directory.

        A `LocalRig` writes what it keeps; a `RosRig` copies what its recorder has written and is unusable afterwards.

        Raises:
            RecordingError: the run cannot be written.
        """

    @abc.abstractmethod
    def configure(self, changes: Mapping[str, Any]) -> RigConfig:
        """Change configuration values from the first scan not measured yet; return the new configuration.

        Values of `drive` and the seed apply only from the next reset. A change of the mechanics puts the sphere back to
        `sphere.start`.

        Args:
            changes: new values, `section.key` -> value.

        Raises:
            ConfigError: the values were rejected; nothing is changed.
        """

    @abc.abstractmethod
    def inject(self, fault: Fault) -> int:
        """Add an instrument fault, which starts at its `start_sample`, and return its number.

        Numbers count from 1; planned faults have the first numbers.

        Raises:
            ImpactRigError: the kind or channel is unknown, or the scan `start_sample` has been measured already.
        """

    @abc.abstractmethod
    def feed(self, first: int, samples: NDArray[np.float64]) -> None:
        """Send samples of the stream that drives the rig.

        Args:
            first: number of the first of these samples, counted from scan 0 at the rate of the stream.
            samples: samples [A, m or V by `drive.kind`], shape (n,); an empty array ends the stream there. Samples that
                arrive too late are dropped, and counted as `late` in `stream_level`.

        Raises:
            CommandError: the rig rejects the samples (a `RosRig` does so later, without an error), or its shaker is
                stopped.
        """

    @abc.abstractmethod
    def stream_level(self) -> StreamLevel:
        """Return the last known state of the buffer that holds the samples of the drive.

        Raises:
            CommandError: the drive is not a stream.
        """

    @property
    @abc.abstractmethod
    def stopped(self) -> str:
        """Reason why the shaker is stopped by a trip or an emergency stop; empty if it is not stopped.

        It stays stopped, and the rig cannot be reset, until the service `rig/clear_trip` (of a `LocalRig`:
        `core.clear_trip`).
        """

    @abc.abstractmethod
    def _command(self, frequency_hz: float | None, current_a: float | None) -> int:
        """Command the drive now, and return the number of the first scan that the command acts on."""

    @abc.abstractmethod
    def _forget(self) -> None:
        """Drop all tables that are kept, except those of the topics of `ESSENTIAL`."""

    @property
    def waiting(self) -> str:
        """Reason why the analysis delays its next measurement, for example that the sphere may still strike.

        It is empty if nothing delays it, or if the rig has no analysis or does not know.
        """
        return ""

    def poll(self) -> None:  # noqa: B027  # a rig that moves only in `step` has nothing to process
        """Process the messages that have arrived from a `RosRig`, without waiting; no effect on a `LocalRig`.

        It does not check whether the rig and its nodes still run.
        """

    @property
    def step_delivers(self) -> bool:
        """Return whether all blocks of a step that are not withheld have arrived when `step` returns."""
        return True

    def watch(self) -> Callable[[], None]:
        """Return a function that raises a GoneError once the rig is gone or replaced, which a `LocalRig` never is."""
        return lambda: None

    def connect(self, listener: Callable[[Table], object]) -> None:
        """Call a function with every block of scans from now on, in order, until `disconnect` or `close`.

        The calls are made while the rig advances; an exception of the function ends the call that advances it. Blocks
        that an instrument fault withholds are left out.

        Args:
            listener: function that gets each table of `daq/scan`.
        """
        self._listeners.append(listener)

    def disconnect(self, listener: Callable[[Table], object]) -> None:
        """Stop calling a function that `connect` has added.

        Args:
            listener: the function.

        Raises:
            ValueError: the function was not connected.
        """
        self._listeners.remove(listener)

    def close(self) -> None:
        """End the rig and its recording, nodes and connections; a rig that another program started goes on."""
        self.closed = True
        self._listeners.clear()

    # Time

    @property
    def rate_hz(self) -> int:
        """Scans per second."""
        return self.config.daq.rate_hz

    @property
    def block_scans(self) -> int:
        """Scans per block."""
        return self.config.daq.block_scans

    @property
    def stream_rate_hz(self) -> int:
        """Samples per second of the stream that drives the rig; a new `drive.stream_rate_hz` counts from a reset on."""
        return self.config.drive.stream_rate_hz

    @property
    def now_ns(self) -> int:
        """Time of the next block's first scan [ns]: 0 at the start and after each reset.

        The stamp of that scan is this time plus the stamp of scan 0.
        """
        return stamp_ns(self.sample, self.rate_hz)

    @property
    def frontier_sample(self) -> int:
        """Number of the first scan, not measured yet, on which a command can act: commands act every 10 ms."""
        return first_scan_on_grid(self.sample, self.rate_hz)

    @property
    def time_s(self) -> float:
        """Rig time at which the next block begins, since the start or the last reset [s]."""
        return self.sample / self.rate_hz

    def run(self, seconds: float) -> None:
        """Advance by a duration of rig time.

        Args:
            seconds: duration [s], rounded up to whole blocks (by default 10 ms each).

        Raises:
            TimeoutError: as for `step`.
        """
        self.step(math.ceil(seconds * self.rate_hz / self.block_scans - 1e-9))

    def run_to_sample(self, sample: int) -> None:
        """Advance until the next block begins with a given scan.

        Args:
            sample: number of the scan, from 0 at the start or reset.

        Raises:
            ConfigError: no block begins with this scan, or the rig is already past it.
            TimeoutError: as for `step`.
        """
        blocks, rest = divmod(sample - self.sample, self.block_scans)
        if rest or blocks < 0:
            way = f"from which it advances by multiples of {self.block_scans} samples (whole blocks)"
            raise ConfigError(
                f"cannot run to sample {sample}: {self.name} is at sample {self.sample}, "
                f"{'already past it; choose a later one' if blocks < 0 else way}"
            )
        if blocks:
            self.step(blocks)

    def wait_until(
        self, condition: Callable[[], object], what: str, limit_s: float = 30.0, every_s: float = 0.05
    ) -> float:
        """Advance the rig until a condition is true.

        Args:
            condition: function without arguments, called before the first step and after each.
            what: what is awaited, for the error message.
            limit_s: longest wait [s of rig time].
            every_s: rig time between two calls [s], rounded up to whole blocks.

        Returns:
            Rig time at which the condition was true [s].

        Raises:
            impact_rig.driver.NotReachedError: the condition did not become true in time; an `ImpactRigError`.
            TimeoutError: as for `step`.
        """
        begin, blocks = self.time_s, max(1, math.ceil(every_s * self.rate_hz / self.block_scans - 1e-9))
        while not condition():
            left = math.ceil((begin + limit_s - self.time_s) * self.rate_hz / self.block_scans - 1e-6)
            if left <= 0:
                started = "; ".join(str(fault) for fault in self.faults if fault.start_sample < self.sample)
                raise NotReachedError(
                    f"timeout after {limit_s:g} s of rig time: waiting for {what} ({self.name} is at "
                    f"{self.time_s:g} s, {f'faults so far: {started}' if started else 'no faults so far'})"
                )
            self.step(min(blocks, left))
        return self.time_s

    # Inputs

    def command(
        self, frequency_hz: float | None = None, current_a: float | None = None, *, at_sample: int | None = None
    ) -> int:
        """Command the drive: frequency of a sine, and amplitude of any drive except a stream.

        A new frequency acts at once; the amplitude moves linearly to its new value within `shaker.ramp_s`.

        Args:
            frequency_hz: new frequency [Hz], within the shaker's range (by default 5 to 200); None leaves it unchanged.
            current_a: new amplitude, peak (rms for a random drive), in A, m or V by `drive.kind`, from 0 to the
                shaker's limit (by default 21.2 A); None leaves it unchanged.
            at_sample: scan to run to first; it must begin a block and lie on the 10 ms grid of commands. None means
                now.

        Returns:
            Number of the first scan that the command acts on.

        Raises:
            CommandError: both values are None, one is out of range, the drive does not accept it, the shaker is
                stopped, or no command can act on this scan. The error is also raised if a rig that runs by itself had
                passed `at_sample` when the command arrived; the command then acts nevertheless, from a later scan on.
            ConfigError: the rig has already passed `at_sample`.
            TimeoutError: as for `step`, on the way to `at_sample`.
        """
        if frequency_hz is None and current_a is None:
            raise CommandError("a command needs a frequency, a current, or both")
        if at_sample is None:
            return self._command(frequency_hz, current_a)
        if first_scan_on_grid(at_sample, self.rate_hz) != at_sample or at_sample % self.block_scans:
            raise CommandError(
                f"no command can act on sample {at_sample}: at {self.rate_hz} Hz commands act every "
                f"{self.rate_hz / TICKS_PER_S:g} samples, and only at the first sample of a block of "
                f"{self.block_scans}; without at_sample, the command acts as soon as it can"
            )
        self.run_to_sample(at_sample)
        acts_on = self._command(frequency_hz, current_a)
        if acts_on != at_sample:
            raise CommandError(
                f"the command was applied, but acts on sample {acts_on} instead of {at_sample}: when it arrived, "
                f"{self.name} was already past that sample; use a rig in lockstep, or omit at_sample"
            )
        return acts_on

    # Reference values and losses

    @staticmethod
    def _kept_of(topic: str, kept: Mapping[str, _T]) -> _T:
        """Return the entry of a topic with tables in `kept`, a mapping from the topics that the rig keeps.

        Raises:
            ConfigError: the rig keeps no messages of this topic, or the topic carries no tables.
        """
        if topic not in kept:
            known = [one.name for one in topics.COMMON]
            remedy = "name it in the argument `also` of the rig to keep it, too"
            if topic not in known:
                remedy = "it is no topic of a rig" + did_you_mean(topic, known, ", did you mean {!r}?")
            raise ConfigError(f"topic {topic!r} is not kept, only {', '.join(sorted(kept))}; {remedy}")
        if topic not in _ROWS:
            raise ConfigError(
                f"topic {topic!r} carries no tables: `journal` returns the journal, `save` writes the other messages"
            )
        return kept[topic]

    def rows(self, topic: str = SCANS) -> NDArray[np.void]:
        """Return the rows of all tables of a topic that are kept, one after the other.

        Args:
            topic: name of the topic; by default `daq/scan`, with one row per scan.

        Returns:
            Structured array, shape (n,), with the columns of docs/reference/interface.md in SI units. `time` counts
            from the stamp of each row's own table.

        Raises:
            ConfigError: the rig keeps no tables of this topic; the argument `also` of the rig adds topics.
        """
        parts = [table.rows for table in self.tables(topic)]
        return np.concatenate(parts) if parts else np.empty(0, _ROWS[topic])

    def clear(self) -> None:
        """Drop the tables published so far, to free memory.

        The journal, the applied commands and the calibration are kept, because they apply to all later scans.
        """
        lost = self.lost_scans
        self._forget()
        self._lost_before, self._kept_from = lost, self.sample

    def expected_transmissibility(self, frequency_hz: float) -> complex:
        """Return the transmissibility X_1 / X_b of a rig without its sphere in closed form.

        X_1 and X_b are the displacements of superior and inferior base.

        Args:
            frequency_hz: frequency [Hz].

        Returns:
            Complex ratio; its magnitude is DT (displacement transmissibility), its argument the phase [rad].

        Raises:
            ConfigError: the sphere is present.
        """
        from impact_rig.physics.linear_response import transmissibility  # noqa: PLC0415  # loads compiled code

        if self.config.sphere.present:
            raise ConfigError(
                "the transmissibility has a closed form only without the sphere: start the rig with "
                "sphere.present: false"
            )
        return complex(transmissibility(self.config, frequency_hz))

    @property
    def lost_scans(self) -> int:
        """Number of scans lost since the start or the last reset: not published or, over ROS, not received.

        The usual reason is a fault that loses blocks.
        """
        return self._lost_before + sum(end - first for first, end in self.lost_samples())

    def lost_samples(self) -> list[tuple[int, int]]:
        """Return the ranges of scans lost since the last `clear` or reset: not published, or not received over ROS.

        Scans are numbered from 0 at the start of the rig or its last reset. Ranges before the oldest scan that the rig
        still keeps are left out; `lost_scans` counts their scans, too.

        Returns:
            Pairs (number of the first scan of a range, number of the scan after its last), in order; empty without a
            loss.
        """
        lost, expected = [], self._kept_from
        for table in self.tables():
            first = self.first_scan(table)
            if first < 0:  # before the last reset
                continue
            if first > expected:
                lost.append((expected, first))
            expected = first + len(table.rows)
        return lost if expected >= self.sample else [*lost, (expected, self.sample)]

    def newest(self, topic: str, count: int) -> NDArray[np.void]:
        """Return the newest rows of the tables of a topic.

        Args:
            topic: name of the topic, such as `daq/scan`.
            count: number of rows.

        Returns:
            Rows, shape (count,), oldest first; fewer if the rig keeps fewer (a `RosRig` waits for them).

        Raises:
            ConfigError: the rig keeps no tables of this topic; the argument `also` of the rig adds topics.
        """
        rows = self.rows(topic)
        return rows[max(0, len(rows) - count) :]

    @property
    def faults(self) -> list[Fault]:
        """Instrument faults that the configuration plans, and those injected later (of a `LocalRig`, the last 100).

        Faults are listed even if they have ended or a reset has removed them.
        """
        return list(self.config.instruments.faults.faults(self.rate_hz))

    # Reports

    def report(self) -> str:
        """Return a report about this rig, of several lines, for a failed test.

        It lists the settings that differ from the defaults (except `time`), the faults, the first ranges of lost scans,
        and the last changes of the drive.
        """
        values = to_flat(self.config)
        changed = [key for key, value in values.items() if value != _DEFAULTS[key] and not key.startswith(_HIDDEN)]
        lines = [f"{self.name}: {self.time_s:g} s of rig time, {self.sample} scans at {self.rate_hz} Hz"]
        lines += [f"    {key} = {values[key]}" for key in changed]
        lines += [f"    fault: {fault}" for fault in self.faults]
        lines += [f"    scans {first} to {end - 1} were not published" for first, end in self.lost_samples()[:5]]
        applied = {int(row["sample"]): row for row in self.rows(topics.APPLIED.name)}
        _name, unit, _limit, _why = amplitude_limit(self.config.drive, self.config.shaker)
        for sample, row in list(applied.items())[-10:]:
            lines.append(f"    drive from scan {sample} on: {row['frequency']:g} Hz, {row['current']:g} {unit}")
        return "\n".join(lines)

    def first_scan(self, table: Table) -> int:
        """Return the number of the first scan of a block, from 0 at the start or reset; negative if it is older.

        Args:
            table: a table of `daq/scan`, whose stamp gives the number.
        """
        return first_scan_at(table.stamp_ns, self.rate_hz, self._start_ns)

    def _samples(self, first: int, values: NDArray[np.float64]) -> Table:
        """Return the table of `shaker/waveform` with the samples `values`; the first of them has the number `first`."""
        rows = np.zeros(len(values), WAVEFORM)
        rows["value"] = values
        return Table(stamp_ns(first, self.stream_rate_hz, self._start_ns), rows)


def first_scan_on_grid(sample: int, rate_hz: int) -> int:
    """Return the number of the first scan, from `sample` on, at which a command can act.

    Commands act once in 10 ms of rig time: at the first scan that is not before a multiple of 10 ms.
    """
    tick = -(-sample * TICKS_PER_S // rate_hz)
    return -(-tick * rate_hz // TICKS_PER_S)


def check_topics(also: Iterable[str]) -> None:
    """Check that all topics in the argument `also` of a rig are known.

    Raises:
        ConfigError: a topic is unknown.
    """
    known = [topic.name for topic in topics.COMMON]
    if unknown := next((topic for topic in also if topic not in known), ""):
        raise ConfigError(
            f"unknown topic {unknown!r} in the argument `also`"
            + did_you_mean(unknown, known, ", did you mean {!r}?", f": the topics are {', '.join(sorted(known))}")
        )


def configured(config: RigConfig | Mapping[str, Any] | None, faults: Iterable[Fault]) -> RigConfig:
    """Return the configuration of a rig, with `faults` added to its planned faults (`instruments.faults.planned`).

    `config` is a configuration, or a mapping `section.key` -> value of values that differ from the defaults. None means
    the defaults.

    Raises:
        ConfigError: a key is unknown, or a value or fault is invalid.
    """
    if not isinstance(config, RigConfig):
        config = from_flat(RigConfig(), config or {})
    lines = [fault.line(config.daq.rate_hz) for fault in faults]
    planned = [*config.instruments.faults.planned, *lines]
    return from_flat(config, {"instruments.faults.planned": planned}) if lines else config
