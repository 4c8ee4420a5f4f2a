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
"""Rig that appears to programs of NI-DAQmx as a multifunction board with buffered tasks.

The inputs `ai0` to `ai3` give the voltages of accelerometer, laser, base sensor and current monitor. The output `ao0`
drives the shaker through an amplifier of 1 A/V. A thread of `Board` passes output samples to the rig. It also advances
rig time at the speed of wall time, unless the rig runs by itself.
"""

from __future__ import annotations

import enum
import math
import re
import threading
import time
from collections.abc import Callable

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.driver.driver import RigDriver
from impact_rig.driver.hardware import Acquisition, AnalogOutput, UnderrunError
from impact_rig.driver.local_rig import LocalRig
from impact_rig.errors import CommandError, ConfigError, GoneError, ImpactRigError
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.topics import INFO

INPUTS = ("accelerometer", "laser", "base", "current")
OUTPUT_RANGE_V = 10.0
MOST_TASKS = 64
MOST_SAMPLES = 10_000_000  # largest size of a buffer, and of one finite task
BUFFER_S = 0.1  # rig time for which output samples are written in advance
BEHIND_S = 0.5  # a board that was delayed by more than this does not catch up
BLOCKS_PER_S = 100
RATE_KEYS = {"ai": "daq.rate_hz", "ao": "drive.stream_rate_hz"}


class Code(enum.IntEnum):
    """Error codes of NI-DAQmx that this board reports, by their names in the `nidaqmx` package."""

    TRIGGER_TERMINAL = -89120
    RESOURCE_RESERVED = -50103
    DEV_CANNOT_BE_ACCESSED = -201003
    CANNOT_WRITE_WHEN_AUTO_START_FALSE_AND_TASK_NOT_RUNNING = -200846
    INVALID_AO_DATA_WRITE = -200561
    WAIT_UNTIL_DONE_DOES_NOT_INDICATE_DONE = -200560
    CHAN_ALREADY_IN_TASK = -200489
    CAN_NOT_PERFORM_OP_WHILE_TASK_RUNNING = -200479
    CAN_NOT_PERFORM_OP_WHEN_NO_CHANS_IN_TASK = -200478
    CANNOT_PERFORM_OP_WHEN_TASK_NOT_RUNNING = -200475
    CANNOT_READ_WHEN_AUTO_START_FALSE_AND_TASK_NOT_RUNNING_OR_COMMITTED = -200473
    OUTPUT_BUFFER_EMPTY = -200462
    READ_NO_INPUT_CHANS_IN_TASK = -200460
    WRITE_NO_OUTPUT_CHANS_IN_TASK = -200459
    ATTRIBUTE_NOT_SUPPORTED_IN_TASK_CONTEXT = -200452
    SAMPLES_CAN_NOT_YET_BE_WRITTEN = -200292
    GEN_STOPPED_TO_PREVENT_REGEN_OF_OLD_SAMPLES = -200290
    SAMPLES_NOT_YET_AVAILABLE = -200284
    SAMPLES_NO_LONGER_AVAILABLE = -200279
    SAMPLES_WILL_NEVER_BE_AVAILABLE = -200278
    INVALID_DEVICE_ID = -200220
    ATTR_NOT_SUPPORTED = -200197
    PHYSICAL_CHAN_DOES_NOT_EXIST = -200170
    DUPLICATE_TASK = -200089
    INVALID_TASK = -200088
    INVALID_ATTRIBUTE_VALUE = -200077


class DaqmxError(ImpactRigError):
    """Error of a call of NI-DAQmx: the client gets its message and NI's number of the error.

    Attributes:
        code: NI's number of the error.
    """

    def __init__(self, code: Code, message: str) -> None:
        super().__init__(message)
        self.code = code


class State(enum.Enum):
    """State of a task, with its description for messages.

    A task is `DONE` after its last sample or after an error.
    """

    IDLE = "not started"
    ARMED = "waits for its start trigger"
    RUNNING = "running"
    DONE = "all samples are acquired or generated"


@attrs.frozen
class BoardChannel:
    """Channel of a DAQmx task: an input or output of the board, with the range and the unit of its values.

    Attributes:
        name: name of the channel within the task.
        physical: name of the channel on the board without the device, e.g. `ai0`.
        device: name of the device, e.g. `Dev1`.
        low: smallest value of the range [unit of the channel]; values of an input are not limited to the range.
        high: largest value of the range [unit of the channel].
        per_volt: value in the unit of the channel that corresponds to one volt at the board.
        unit: unit of the values: `Volts`, or that of an acceleration.

    Raises:
        DaqmxError: `low` is not less than `high`.
    """

    name: str
    physical: str
    device: str
    low: float
    high: float
    per_volt: float
    unit: str

    def __attrs_post_init__(self) -> None:
        if not self.low < self.high:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE,
                f"the smallest value of channel {self.name} must be less than its largest, got {self.low:g} and "
                f"{self.high:g}",
            )

    @property
    def is_accelerometer(self) -> bool:
        """Return whether the values of the channel are accelerations (otherwise volts)."""
        return self.unit != "Volts"


@attrs.define(eq=False)
class DaqmxTask:
    """Task of NI-DAQmx (input or output channels with one clock): its settings and its progress since the start.

    Attributes:
        name: name of the task.
        kind: "ai" (input) or "ao" (output); empty without channels.
        channels: channels of the task.
        rate_hz: samples per second of its clock; 0 means no clock: samples are read or written on demand.
        samples: number of samples per channel of a finite task; None means a continuous task.
        clock_samples: number of samples per channel as given to `configure_clock`, also for a continuous task.
        buffer_samples: size of its buffer as set by the client; None means the size that NI-DAQmx would choose.
        trigger: kind of task whose start triggers this task; empty without a trigger.
        regenerates: whether an output repeats its buffer.
        auto_starts: whether a read starts the task if it was not started.
        state: state of the task.
        run: number of times that the task was started.
        begin_ns: wall time of its first sample [ns since 1970].
        passed: number of samples per channel since the start that an input has returned, or an output has passed to the
            rig.
        written: number of samples of an output: those in its buffer at the start, and those written since.
        error: error that ended the task; None if there was none.
        rig: rig of its last start; None before.
        acquisition: acquisition from the rig, from the start of an input task until `Board.stop`; otherwise None.
        output: analog output of the rig, from the start of an output task until its end; otherwise None.
        data: samples of an output that are not passed to the rig yet, or are repeated [V].
    """

    name: str
    kind: str = ""
    channels: list[BoardChannel] = attrs.field(factory=list)
    rate_hz: int = 0
    samples: int | None = None
    clock_samples: int = 1000
    buffer_samples: int | None = None
    trigger: str = ""
    regenerates: bool = True
    auto_starts: bool = True
    state: State = State.IDLE
    run: int = 0
    begin_ns: int = 0
    passed: int = 0
    written: int = 0
    error: DaqmxError | None = None
    rig: RigDriver | None = None
    acquisition: Acquisition | None = None
    output: AnalogOutput | None = None
    data: NDArray[np.float64] = attrs.field(factory=lambda: np.empty(0))

    @property
    def is_active(self) -> bool:
        """Return whether the task is running or waits for its trigger."""
        return self.state in {State.ARMED, State.RUNNING}

    def must_be_idle(self) -> None:
        """Check that the task is neither running nor waiting for its trigger, so that its settings can change.

        Raises:
            DaqmxError: the task is running or waits for its trigger.
        """
        if self.is_active:
            raise DaqmxError(Code.CAN_NOT_PERFORM_OP_WHILE_TASK_RUNNING, "the task is running: stop it first")

    def must_have_channels(self) -> None:
        """Check that the task has channels.

        Raises:
            DaqmxError: it has none.
        """
        if not self.channels:
            raise DaqmxError(Code.CAN_NOT_PERFORM_OP_WHEN_NO_CHANS_IN_TASK, "the task has no channels: add some first")

    def raise_error(self) -> None:
        """Raise the error that ended the task, if there is one; `Board.start` and `Board.stop` clear it."""
        if self.error is not None:
            raise self.error

    @property
    def available(self) -> int:
        """Number of samples per channel that an input task can return now without waiting; 0 for an output."""
        if self.acquisition is None:
            return 0
        found = self.acquisition.available
        return found if self.samples is None else min(found, self.samples - self.passed)

    @property
    def progress(self) -> int:
        """Number of samples per channel since the start: acquired by an input, or passed to the rig by an output.

        Samples of an input that were overwritten before they were read do not count.
        """
        return self.passed + self.available

    @property
    def buffer_size(self) -> int:
        """Size of the task's buffer [samples per channel], as set by the client or as NI-DAQmx would choose it.

        The chosen buffer of an output has the size of `data`. That of a finite input has room for all its samples. That
        of a continuous input depends on the rate, and has room for at least `clock_samples`.
        """
        if self.buffer_samples is not None:
            return self.buffer_samples
        if self.kind == "ao":
            return len(self.data)
        if self.samples is not None:
            return self.samples
        usual = 1_000 if self.rate_hz <= 100 else 10_000 if self.rate_hz <= 10_000 else 100_000
        return max(usual, self.clock_samples)


class Board:
    """Board that offers one rig to clients of NI-DAQmx, with the tasks that the clients have created.

    Hold `changed` while you call a method, except `close`.

    Args:
        config: configuration of the rig to simulate; the drive is changed to a stream, and tasks set the rates.
        rig: running rig to use instead; its rates cannot be changed.
        devices: names under which clients find the board.

    Attributes:
        changed: condition that guards the tasks and the rig; it is notified after each block of scans, and
            when a task is cleared or fails.
        tasks: tasks by name.
    """

    def __init__(self, config: RigConfig, rig: RigDriver | None = None, devices: tuple[str, ...] = ("Dev1",)) -> None:
        self.changed = threading.Condition()
        self.tasks: dict[str, DaqmxTask] = {}
        self.devices = devices
        self._config = from_flat(config, {"drive.waveform": "stream", "drive.stream_wait": False})
        self._rig = self._fixed = rig
        self._check_running: Callable[[], None] = (lambda: None) if rig is None else rig.watch()
        self._epoch = 0.0
        self._ended = False
        self._named = 0
        self._thread = threading.Thread(target=self._pump, name="daqmx board", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop and remove all tasks, and close the rig; a running rig of another program goes on."""
        if self._ended:
            return
        with self.changed:
            self._ended = True
            for task in list(self.tasks.values()):
                self.clear(task)
        self._thread.join()
        if self._rig is not None:
            self._rig.close()

    # Tasks

    def create(self, name: str) -> DaqmxTask:
        """Create a task without channels; an empty name is replaced by a unique one.

        Raises:
            DaqmxError: a task of this name exists, or there are too many tasks.
        """
        if name in self.tasks:
            raise DaqmxError(
                Code.DUPLICATE_TASK, f"a task named {name!r} exists already: clear it, or choose another name"
            )
        if len(self.tasks) >= MOST_TASKS:
            raise DaqmxError(
                Code.RESOURCE_RESERVED, f"{MOST_TASKS} tasks exist, and more are not allowed: clear some of them"
            )
        while not name or name in self.tasks:
            name = f"_unnamedTask<{self._named:X}>"
            self._named += 1
        self.tasks[name] = DaqmxTask(name)
        return self.tasks[name]

    def find(self, name: str) -> DaqmxTask:
        """Return a task by its name.

        Raises:
            DaqmxError: there is no such task.
        """
        if name not in self.tasks:
            raise DaqmxError(Code.INVALID_TASK, f"there is no task named {name!r}: create it first")
        return self.tasks[name]

    def clear(self, task: DaqmxTask) -> None:
        """Stop a task and remove it from the board."""
        self.stop(task)
        self.tasks.pop(task.name, None)
        self.changed.notify_all()

    def physical_channels(self, text: str, kind: str) -> list[tuple[str, str]]:
        """Return (device, channel) of each channel in a list such as `Dev1/ai0:3, Dev1/ai5`.

        Args:
            text: channels of the board, separated by commas; `:` marks a range.
            kind: "ai" or "ao".

        Raises:
            DaqmxError: a device or channel is unknown, or the list is empty.
        """
        found = []
        for item in filter(None, (part.strip() for part in text.split(","))):
            device, _, channel = item.lstrip("/").rpartition("/")
            if device.lower() not in {known.lower() for known in self.devices}:
                raise DaqmxError(Code.INVALID_DEVICE_ID, f"unknown device {device!r}: use {', '.join(self.devices)}")
            match = re.fullmatch(rf"{kind}(\d{{1,3}})(?::(?:{kind})?(\d{{1,3}}))?", channel, re.IGNORECASE | re.ASCII)
            first, last = (int(match[1]), int(match[2] or match[1])) if match else (-1, -1)
            count = len(INPUTS) if kind == "ai" else 1
            if not (0 <= first < count and 0 <= last < count):
                known = f"ai0 to ai{len(INPUTS) - 1}" if kind == "ai" else "ao0"
                raise DaqmxError(Code.PHYSICAL_CHAN_DOES_NOT_EXIST, f"no channel {channel!r} on {device}: use {known}")
            found += [(device, f"{kind}{number}") for number in _numbers(first, last)]
        if not found:
            raise DaqmxError(
                Code.PHYSICAL_CHAN_DOES_NOT_EXIST,
                f"no physical channel is given: name at least one, e.g. {self.devices[0]}/{kind}0",
            )
        return found

    def add_channels(
        self,
        task: DaqmxTask,
        kind: str,
        physical: str,
        name: str,
        limits: tuple[float, float],
        per_volt: float,
        unit: str,
    ) -> None:
        """Add channels of the board to a task.

        Args:
            task: the task.
            kind: "ai" or "ao".
            physical: channels of the board, as for `physical_channels`.
            name: name of the new channel in the task. For several channels, 0, 1, … is appended to it. Empty means the
                name on the board, such as `Dev1/ai0`.
            limits: smallest and largest value of the range [unit].
            per_volt: value that corresponds to one volt [unit].
            unit: unit of the values.

        Raises:
            DaqmxError: the task is running, or `limits` are not ascending. Also if a channel is unknown, is in the task
                already, is of the other kind, or would have a name that the task has already.
        """
        task.must_be_idle()
        if task.kind not in {"", kind}:
            raise DaqmxError(
                Code.INVALID_TASK,
                f"task {task.name!r} has {'inputs' if task.kind == 'ai' else 'an output'}, and a task cannot have both "
                f"kinds: create a second task for the {'inputs' if kind == 'ai' else 'output'}",
            )
        found, added = self.physical_channels(physical, kind), list[BoardChannel]()
        for number, (device, channel) in enumerate(found):
            if any(one.physical == channel for one in (*task.channels, *added)):
                raise DaqmxError(
                    Code.CHAN_ALREADY_IN_TASK, f"{device}/{channel} is in the task already: add it once only"
                )
            named = f"{name}{number if len(found) > 1 else ''}" if name else f"{device}/{channel}"
            if any(one.name == named for one in (*task.channels, *added)):
                raise DaqmxError(
                    Code.CHAN_ALREADY_IN_TASK, f"the task has a channel named {named!r} already: choose another name"
                )
            added.append(BoardChannel(named, channel, device, *limits, per_volt, unit))
        task.channels += added
        task.kind = kind

    def channels(self, task: DaqmxTask, text: str) -> list[BoardChannel]:
        """Return the channels of a task whose names are in a list such as `Dev1/ai1:3, laser`.

        The names are those within the task; `:` marks a range of numbers. An empty list selects all channels.

        Raises:
            DaqmxError: the task has no such channel, or no channels.
        """
        known, found = {channel.name: channel for channel in task.channels}, []
        for part in filter(None, (part.strip() for part in text.split(","))):
            match = re.fullmatch(r"(.*?)(\d{1,3}):(?:.*?)(\d{1,3})", part, re.ASCII)
            numbers = _numbers(int(match[2]), int(match[3])) if match else ()
            found += [f"{match[1]}{number}" for number in numbers] if match else [part]
        missing = [name for name in found if name not in known]
        if missing or not known:
            what = f"channel {', '.join(missing)}" if missing else "channels"
            present = f"its channels are {', '.join(known)}" if known else "add channels first"
            raise DaqmxError(Code.PHYSICAL_CHAN_DOES_NOT_EXIST, f"task {task.name!r} has no {what}: {present}")
        return [known[name] for name in found] or task.channels

    def configure_range(
        self, task: DaqmxTask, names: str, *, low: float | None = None, high: float | None = None
    ) -> None:
        """Set the smallest or the largest value of the range of a task's channels; None leaves a limit unchanged.

        Args:
            task: the task.
            names: channels of the task, as for `channels`.
            low: smallest value [unit of the channel].
            high: largest value [unit of the channel].

        Raises:
            DaqmxError: the task is running or has no such channel, or `low` would not be less than `high`.
        """
        task.must_be_idle()
        changed = {
            channel.name: attrs.evolve(
                channel, low=channel.low if low is None else low, high=channel.high if high is None else high
            )
            for channel in self.channels(task, names)
        }
        task.channels[:] = [changed.get(channel.name, channel) for channel in task.channels]

    def configure_clock(self, task: DaqmxTask, rate_hz: float, samples: int, *, finite: bool) -> None:
        """Set the sample clock of a task: its rate, and how many samples it acquires or generates.

        Args:
            task: the task.
            rate_hz: samples per second, at least 1, rounded to a whole number.
            samples: number of samples per channel of a finite task; otherwise a hint for the size of the buffer.
            finite: whether the task ends after this number of samples.

        Raises:
            DaqmxError: the task is running or has no channels, or the rate or the number of samples is invalid.
        """
        task.must_be_idle()
        task.must_have_channels()
        if not (math.isfinite(rate_hz) and rate_hz >= 1.0):
            raise DaqmxError(Code.INVALID_ATTRIBUTE_VALUE, f"SampClk.Rate must be at least 1 Hz, got {rate_hz:g}")
        if finite and not 1 < samples <= MOST_SAMPLES:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE, f"SampQuant.SampPerChan must be from 2 to {MOST_SAMPLES}, got {samples}"
            )
        rate = round(rate_hz)
        self._config_for({RATE_KEYS[task.kind]: rate})
        task.rate_hz, task.samples, task.clock_samples = rate, samples if finite else None, samples

    def configure_buffer(self, task: DaqmxTask, samples: int) -> None:
        """Set the size of a task's buffer [samples per channel].

        Raises:
            DaqmxError: the task is running, or the size is not from 1 to `MOST_SAMPLES`.
        """
        task.must_be_idle()
        if not 1 <= samples <= MOST_SAMPLES:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE,
                f"the size of a buffer must be from 1 to {MOST_SAMPLES} samples per channel, got {samples}",
            )
        task.buffer_samples = samples

    def configure_trigger(self, task: DaqmxTask, source: str) -> None:
        """Set or remove the start trigger of a task: the next start of a task of the other kind (input or output).

        A task with a trigger waits for it after its own start.

        Args:
            task: task that waits for the trigger.
            source: start terminal of the other kind of task: `/Dev1/ai/StartTrigger` or `/Dev1/ao/StartTrigger`. An
                empty text removes the trigger.

        Raises:
            DaqmxError: the task is running, or the terminal is unknown or that of the task's own kind.
        """
        task.must_be_idle()
        match = re.fullmatch(r"/?[^/]+/(ai|ao)/StartTrigger", source, re.IGNORECASE)
        if source and (match is None or match[1].lower() == task.kind):
            terminals = [f"/{self.devices[0]}/{kind}/StartTrigger" for kind in RATE_KEYS if kind != task.kind]
            raise DaqmxError(Code.TRIGGER_TERMINAL, f"{source!r} cannot start this task: use {' or '.join(terminals)}")
        task.trigger = match[1].lower() if match else ""

    def start(self, task: DaqmxTask) -> None:
        """Start a task, and with it the tasks that wait for this start as their trigger.

        If the task itself has a start trigger, it only begins to wait for that trigger. The call has no effect on a
        task that is running or waiting already.

        Raises:
            DaqmxError: the task has no channels, an output task has no samples, another task is using the inputs or the
                output, or the rig cannot run at the task's rate.
            CommandError: the drive of a running rig is not a stream.
            ConfigError: for an output, the blocks of a running rig are too long or `drive.stream_buffer_s` too short.
        """
        if task.is_active:
            return
        task.must_have_channels()
        if task.kind == "ao" and not len(task.data):
            raise DaqmxError(
                Code.OUTPUT_BUFFER_EMPTY, "the output buffer is empty: write samples before you start the task"
            )
        other = next((one for one in self.tasks.values() if one.is_active and one.kind == task.kind), None)
        if other is not None:
            what = "inputs are" if task.kind == "ai" else "output is"
            raise DaqmxError(Code.RESOURCE_RESERVED, f"the {what} in use by task {other.name!r}: stop it first")
        rig = self._prepare(task)
        if task.kind == "ai":
            buffered = max(task.buffer_size, rig.block_scans)
            if task.samples is not None and buffered >= task.samples:
                buffered += rig.block_scans  # a trigger can start it within a block, and whole blocks arrive
            task.acquisition = Acquisition(rig, buffer_s=buffered / rig.rate_hz)
        else:
            task.output = AnalogOutput(rig, buffer_s=BUFFER_S, raise_underrun=not task.regenerates)
        task.rig, task.run, task.passed, task.error, task.state = rig, task.run + 1, 0, None, State.ARMED
        if not task.trigger:
            armed = [one for one in self.tasks.values() if one.state is State.ARMED and one.trigger == task.kind]
            self._trigger(rig, [task, *armed])

    def stop(self, task: DaqmxTask) -> None:
        """Stop a task, drop its acquired samples and clear its error.

        An output still plays what the rig has already received, at most 0.1 s (`BUFFER_S`). Then the drive ramps to
        zero. The rest of its buffer is dropped, unless the output repeats its buffer.
        """
        self._end(task, State.IDLE)
        task.acquisition, task.error, task.passed = None, None, 0
        if task.kind == "ao" and not task.regenerates:
            task.data = np.empty(0)

    def is_done(self, task: DaqmxTask) -> bool:
        """Return whether a task is neither running nor waiting for its trigger; also true before its first start.

        Raises:
            DaqmxError: an error ended the task.
        """
        task.raise_error()
        return not task.is_active

    # Data

    def read(
        self, task: DaqmxTask, count: int, most: int, timeout_s: float, goes_on: Callable[[], bool]
    ) -> NDArray[np.float64]:
        """Return the next samples of an input task, waiting for them.

        Args:
            task: the task. It is started if it was not, unless its `auto_starts` is false. A task without a clock is
                stopped again after the read.
            count: samples per channel. A negative count means all remaining samples of a finite task, or all that a
                continuous task has acquired and not yet returned, but no more than `most`.
            most: largest number of samples per channel that the client accepts.
            timeout_s: longest wait [s]; a negative value means no limit.
            goes_on: returns whether the client still waits for the answer; if not, the wait ends with a DaqmxError.

        Returns:
            Values in the units of the channels, shape (channels, n); n is `count` unless `count` is negative.

        Raises:
            DaqmxError: the task has no inputs, cannot be started or has failed, or `count` is above `most`. Also if the
                samples do not arrive in time, were overwritten, or exceed what is left of a finite task.
        """
        if task.kind != "ai":
            raise DaqmxError(
                Code.READ_NO_INPUT_CHANS_IN_TASK, "the task has no input channels: read a task with inputs"
            )
        if count > most:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE, f"one call can read at most {most} samples per channel, not {count}"
            )
        if task.acquisition is None:
            if not task.auto_starts:
                raise DaqmxError(
                    Code.CANNOT_READ_WHEN_AUTO_START_FALSE_AND_TASK_NOT_RUNNING_OR_COMMITTED,
                    "the task is not running and does not start automatically: start it before reading",
                )
            self.start(task)
        rest = task.available if task.samples is None else task.samples - task.passed
        wanted = count if count >= 0 else min(rest, most)

        def has_arrived() -> bool:
            enough = task.available >= wanted
            self._check_read(task, wanted)
            return enough

        self._wait(
            has_arrived,
            timeout_s,
            goes_on,
            Code.SAMPLES_NOT_YET_AVAILABLE,
            lambda: (
                f"timeout after {timeout_s:g} s: {task.available} of {wanted} samples arrived (task: "
                f"{task.state.value}); allow more time, or read fewer samples"
            ),
        )
        assert task.acquisition is not None
        values = self._values(task, task.acquisition.read(wanted))
        task.passed += wanted
        if task.rate_hz == 0:
            self.stop(task)
        return values

    def write(
        self,
        task: DaqmxTask,
        values: NDArray[np.float64],
        timeout_s: float,
        goes_on: Callable[[], bool],
        *,
        auto_start: bool,
    ) -> int:
        """Write samples of an output task, and return their number; a call writes all of them or raises.

        Before the start, samples are appended to the buffer, which drops its oldest samples if it is full. While the
        task runs, new samples follow those that are still to be played. If the output repeats its buffer, new samples
        overwrite the buffer in a circle instead. After a task has ended by itself, new samples replace its buffer.

        Args:
            task: the task.
            values: samples [V], shape (n,). Without a sample clock, the output takes the last sample and keeps it.
            timeout_s: longest wait for space in the buffer [s]; a negative value means no limit.
            goes_on: returns whether the client still waits for the answer; if not, the wait ends with a DaqmxError.
            auto_start: whether to start the task if it is not running.

        Raises:
            DaqmxError: the task has no output, cannot be started or has failed, a sample is out of range, the buffer
                had no space in time, or `auto_start` is false for a task without a clock that is not running.
            CommandError: the task is to be started, and the drive of a running rig is not a stream.
            ConfigError: the task is to be started, and the blocks of a running rig are too long for an output, or
                `drive.stream_buffer_s` is too short.
        """
        if task.kind != "ao":
            raise DaqmxError(
                Code.WRITE_NO_OUTPUT_CHANS_IN_TASK,
                "the task has no output channel: write to a task with the output ao0",
            )
        task.raise_error()
        low, high = max(task.channels[0].low, -OUTPUT_RANGE_V), min(task.channels[0].high, OUTPUT_RANGE_V)
        beyond = values[~((values >= low) & (values <= high))]
        if len(beyond):
            raise DaqmxError(
                Code.INVALID_AO_DATA_WRITE, f"samples must be from {low:g} to {high:g} V, got {beyond[0]:g} V"
            )
        if len(values) > MOST_SAMPLES:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE, f"one call can write at most {MOST_SAMPLES} samples, not {len(values)}"
            )
        on_demand = task.rate_hz == 0
        if on_demand:
            if not (auto_start or task.is_active):
                raise DaqmxError(
                    Code.CANNOT_WRITE_WHEN_AUTO_START_FALSE_AND_TASK_NOT_RUNNING,
                    "the task is not running and does not start automatically: start it or write with auto_start",
                )
            task.data, task.regenerates = values[-1:].copy(), True
        elif not task.is_active:
            kept = task.data if task.state is State.IDLE else task.data[:0]
            task.data = np.concatenate([kept, values])[-(task.buffer_samples or MOST_SAMPLES) :]
            task.state, task.written = State.IDLE, len(task.data) - len(values)  # the circle begins at the oldest
        elif task.regenerates:
            at = (task.written + np.arange(len(values))) % len(task.data)
            task.data[at] = values
        else:
            self._append(task, values, timeout_s, goes_on)
        task.written += len(values)
        if auto_start or on_demand:
            self.start(task)
        return len(values)

    def _append(
        self, task: DaqmxTask, values: NDArray[np.float64], timeout_s: float, goes_on: Callable[[], bool]
    ) -> None:
        size = max(task.buffer_samples or 0, task.clock_samples, len(values))

        def has_room() -> bool:
            task.raise_error()
            return len(task.data) + len(values) <= size

        self._wait(
            has_room,
            timeout_s,
            goes_on,
            Code.SAMPLES_CAN_NOT_YET_BE_WRITTEN,
            lambda: (
                f"timeout after {timeout_s:g} s: no room for {len(values)} samples, {len(task.data)} of at most {size} "
                "are queued; allow more time, or write fewer samples"
            ),
        )
        task.data = np.concatenate([task.data, values])

    def wait_until_done(self, task: DaqmxTask, timeout_s: float, goes_on: Callable[[], bool]) -> None:
        """Wait until all samples of a task are acquired or generated.

        Args:
            task: the task.
            timeout_s: longest wait [s]; a negative value means no limit.
            goes_on: returns whether the client still waits for the answer; if not, the wait ends with a DaqmxError.

        Raises:
            DaqmxError: the task did not end in time, was not started, or ended with an error.
        """
        if task.state is State.IDLE:
            raise DaqmxError(Code.CANNOT_PERFORM_OP_WHEN_TASK_NOT_RUNNING, "the task is not running: start it first")
        self._wait(
            lambda: self.is_done(task),
            timeout_s,
            goes_on,
            Code.WAIT_UNTIL_DONE_DOES_NOT_INDICATE_DONE,
            lambda: (
                f"timeout after {timeout_s:g} s: the task is not done (task: {task.state.value}); allow more time, or "
                "stop the task"
            ),
        )

    def _wait(
        self,
        is_over: Callable[[], bool],
        timeout_s: float,
        goes_on: Callable[[], bool],
        code: Code,
        message: Callable[[], str],
    ) -> None:
        """Wait until `is_over()` is true, and let other threads use the board meanwhile.

        Raises:
            DaqmxError: `timeout_s` has passed (negative: no limit) or `goes_on()` is false. The error has the given
                code and message.
        """
        deadline = math.inf if timeout_s < 0.0 else time.monotonic() + timeout_s
        while not is_over():
            left = deadline - time.monotonic()
            if left <= 0.0 or not goes_on():
                raise DaqmxError(code, message())
            self.changed.wait(min(left, 0.1))

    # Work of the thread

    def _pump(self) -> None:
        """Advance rig time with wall time, and supply running tasks, until the board is closed; run by its thread.

        An error of the rig ends all running tasks, whose next calls report it.
        """
        while not self._ended:
            with self.changed:
                try:
                    if self._rig is not None:
                        self._advance(self._rig)
                except (ImpactRigError, TimeoutError) as error:  # of the rig, so that no task can continue
                    for task in self.tasks.values():
                        if task.is_active:  # also one that waits for the start of another one
                            self._fail(task, Code.DEV_CANNOT_BE_ACCESSED, str(error))
                    if self._fixed is None:  # the next start makes a new rig; a failed one could not go on
                        self._rig = None
                    self.changed.notify_all()
            time.sleep(0.5 / BLOCKS_PER_S)

    def _advance(self, rig: RigDriver) -> None:
        """Advance the rig up to the present wall time, and supply running tasks after each block.

        A rig that runs by itself is not advanced; what has arrived from it is processed.
        """
        if rig.runs_by_itself:
            rig.poll()
            try:
                self._check_running()
            except GoneError as error:  # tasks count samples from the start of that rig
                raise GoneError(
                    "the running rig has ended or was restarted: start a rig, then impact-rig daqmx again"
                ) from error
            self._after_block(rig)
            return
        behind_s = time.monotonic() - self._epoch - rig.time_s
        if behind_s > BEHIND_S:
            self._epoch, behind_s = self._epoch + behind_s, 0.0
        for _ in range(int(behind_s * rig.rate_hz / rig.block_scans)):
            rig.step()
            self._after_block(rig)  # after each block, so that a busy machine causes no underrun

    def _after_block(self, rig: RigDriver) -> None:
        rig.clear()
        for task in list(self.tasks.values()):
            if task.state is State.RUNNING:
                self._continue(task, rig)
        self.changed.notify_all()

    def _continue(self, task: DaqmxTask, rig: RigDriver) -> None:
        """Do what a running task needs after a block of scans: end a complete input, or pass samples to the rig."""
        if task.kind == "ai":
            if task.samples is not None and task.progress >= task.samples:
                self._end(task, State.DONE)
            return
        try:
            self._feed(task, rig)
        except UnderrunError as error:
            self._fail(task, Code.GEN_STOPPED_TO_PREVENT_REGEN_OF_OLD_SAMPLES, str(error))
        except CommandError as error:
            self._fail(task, Code.DEV_CANNOT_BE_ACCESSED, str(error))

    def _feed(self, task: DaqmxTask, rig: RigDriver) -> None:
        output = task.output
        assert output is not None
        left = output.space if task.samples is None else min(output.space, task.samples - task.passed)
        if task.regenerates:
            values = task.data[(task.passed + np.arange(left)) % len(task.data)]
        else:
            values, task.data = task.data[:left], task.data[left:]
        if len(values):
            output.write(values)
            task.passed += len(values)
        is_over = task.samples is not None and task.passed >= task.samples
        if output.buffered == 0 and is_over:
            self._end(task, State.DONE)
        elif output.buffered == 0 and not task.regenerates and output.next_sample is not None:
            lost = rig.stream_level().sample - output.next_sample
            why = f"the output ran out of samples after {task.passed} of them: write earlier, or allow regeneration"
            raise UnderrunError(why, lost)

    def _fail(self, task: DaqmxTask, code: Code, message: str) -> None:
        task.error = DaqmxError(code, message)
        self._end(task, State.DONE)

    def _end(self, task: DaqmxTask, state: State) -> None:
        if task.acquisition is not None:
            task.acquisition.stop()
        if task.output is not None:
            task.output.stop()
            task.output = None
        task.state = state

    def _trigger(self, rig: RigDriver, tasks: list[DaqmxTask]) -> None:
        """Start tasks at the same instant.

        Inputs begin with the scan at the output's first sample. Without an output, they begin with the next block of
        scans.
        """
        scan = None
        for task in tasks:
            if task.output is not None:
                scan = -(-task.output.start() * rig.rate_hz // rig.stream_rate_hz)
        for task in tasks:
            if task.acquisition is not None:
                task.acquisition.start(scan)
            task.begin_ns, task.state = time.time_ns(), State.RUNNING
            self._continue(task, rig)

    def _prepare(self, task: DaqmxTask) -> RigDriver:
        """Return a rig with the rates that `task` and the other tasks need; create a new rig if the rates differ.

        A new rig starts at rig time 0 and at rest. A running rig of another program is never replaced.

        Raises:
            DaqmxError: the rig cannot run at these rates, or an active task needs the present rates.
        """
        rates = {}
        for kind, key in RATE_KEYS.items():
            clocked = [one for one in self.tasks.values() if one.kind == kind and one.rate_hz]
            if clocked:
                rates[key] = min(clocked, key=lambda one: (one is not task, not one.is_active)).rate_hz
        config = self._config_for(rates)
        if self._fixed is not None:  # its configuration can have a new rate that counts only from a reset on
            return self._fixed
        wanted = (config.daq.rate_hz, config.drive.stream_rate_hz)
        if self._rig is not None and wanted == (self._rig.rate_hz, self._rig.stream_rate_hz):
            return self._rig
        if self._rig is not None and any(one.is_active for one in self.tasks.values()):
            what, present, new = ("input", self._rig.rate_hz, wanted[0])
            if present == new:
                what, present, new = ("output", self._rig.stream_rate_hz, wanted[1])
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE,
                f"SampClk.Rate: a running task keeps the {what} at {present} Hz, so it cannot run at {new} Hz: stop "
                "that task first",
            )
        self._config = config
        self._rig, self._epoch = LocalRig(config), time.monotonic()
        return self._rig

    def _config_for(self, rates: dict[str, int]) -> RigConfig:
        """Return the configuration of a rig with the given rates, in blocks of 10 ms.

        For a running rig of another program, return that rig's configuration.

        Args:
            rates: rates [Hz] by configuration key; rates that are not given stay the same.

        Raises:
            DaqmxError: the rig cannot run at these rates, or a running rig has other rates.
        """
        if self._fixed is not None:
            known = {"daq.rate_hz": self._fixed.rate_hz, "drive.stream_rate_hz": self._fixed.stream_rate_hz}
            for key, rate in rates.items():
                if rate != known[key]:
                    raise DaqmxError(
                        Code.INVALID_ATTRIBUTE_VALUE,
                        f"SampClk.Rate: the running rig has {known[key]} Hz, which a task cannot change to {rate} Hz: "
                        f"use {known[key]} Hz, or start the rig with {key}: {rate}",
                    )
            return self._fixed.config
        rate_hz = rates.get("daq.rate_hz", self._config.daq.rate_hz)
        try:
            return from_flat(self._config, {**rates, "daq.block_scans": max(1, round(rate_hz / BLOCKS_PER_S))})
        except ConfigError as error:
            raise DaqmxError(Code.INVALID_ATTRIBUTE_VALUE, f"SampClk.Rate: {error}") from None

    def _values(self, task: DaqmxTask, rows: NDArray[np.void]) -> NDArray[np.float64]:
        """Return the values of a task's channels, shape (channels, n), from scans.

        The readings are converted back to the voltages of the sensors, then to the units that the task requests.
        """
        assert task.rig is not None
        info = {row["name"].decode(): row for row in task.rig.tables(INFO.name)[-1].rows}
        found = []
        for channel in task.channels:
            name = INPUTS[int(channel.physical[2:])]
            volts = rows[name] * info[name]["sensitivity"] + info[name]["offset"]
            found.append(volts * channel.per_volt)
        return np.array(found, np.float64)

    def _check_read(self, task: DaqmxTask, wanted: int) -> None:
        task.raise_error()
        if task.acquisition is not None and task.acquisition.lost:
            raise DaqmxError(
                Code.SAMPLES_NO_LONGER_AVAILABLE,
                f"{task.acquisition.lost} samples were lost: overwritten before they were read, or withheld by a "
                "fault of the rig; read more often or with a larger buffer, or remove the fault",
            )
        if task.samples is not None and wanted > task.samples - task.passed:
            raise DaqmxError(
                Code.SAMPLES_WILL_NEVER_BE_AVAILABLE,
                f"{wanted} samples requested, but only {task.samples - task.passed} of the {task.samples} of this "
                "finite task are left: request at most these",
            )


def _numbers(first: int, last: int) -> range:
    """Return the numbers of a channel range such as `2:0`, with both ends; a range may descend."""
    step = 1 if last >= first else -1
    return range(first, last + step, step)
