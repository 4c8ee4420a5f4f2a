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
"""gRPC server that offers a rig through NI's interface of NI-DAQmx.

It serves the calls that buffered analog input and output need, with the messages of the `nidaqmx` package. A call that
this module does not define returns UNIMPLEMENTED. A property that it does not define returns NI's error code -200197
("not supported").
"""

from __future__ import annotations

import contextlib
import datetime as dt
import functools
import os
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from typing import Any  # messages of protobuf, whose classes have no static types

import numpy as np
from numpy.typing import NDArray

from impact_rig.driver.daqmx_board import INPUTS, Board, BoardChannel, Code, DaqmxError, DaqmxTask, State
from impact_rig.errors import ImpactRigError
from impact_rig.simtime import NS_PER_S, stamp_ns
from impact_rig.system import extras

MOST_MESSAGE_BYTES = 16_000_000
MOST_EVENTS, MOST_CALLS = 16, 48
VERSION = {"MAJOR": 23, "MINOR": 8, "UPDATE": 0}  # version of the NI-DAQmx driver whose interface this is
FINITE, CONTINUOUS = 10178, 10123
ALLOW_REGENERATION, DONT_ALLOW_REGENERATION = 10097, 10158
ANALOG_INPUT, ANALOG_OUTPUT = 10100, 10102
VOLTAGE, ACCELERATION = 10322, 10356
SAMPLE_CLOCK, ON_DEMAND = 10388, 10390
DIGITAL_EDGE, NO_TRIGGER = 10150, 10230
VOLTS = 10348
X_SERIES = 15858  # multiplexed boards of 16 bits, such as this one
TIMING, PROPERTIES = 1, 2  # bits of what a waveform has besides its samples
NEW_SESSION, ATTACH = 1, 2
BY_CHANNEL = 0
ACQUIRED, TRANSFERRED = 1, 2
TRANSFERRED_KEYS = {"Read": "ni-samps-per-chan-read", "Write": "ni-samps-per-chan-written"}
"""Metadata key of the number of samples that a call has transferred, by the first word of the call's name.

A call that fails must send this number, too; it is then 0.
"""
ABORT, START, STOP = 6, 0, 1
PROPERTY_TYPES = {"Bool": bool, "Double": float, "Int32": int, "String": str, "UInt32": int, "UInt64": int}
"""Python type of the values of a property call, by the part of the call's name after `Attribute`."""
VOLTS_PER_SENSITIVITY = {12509: 1e-3, 12510: 1.0}  # mV/g, V/g
ACCELERATIONS = {10186: (1.0, "g"), 12470: (9.80665, "m/s^2"), 12471: (9.80665 / 0.0254, "in/s^2")}

_load = functools.partial(extras.load, purpose="impact-rig daqmx", extra="nidaqmx")


def _served(method: Callable[..., dict[str, Any] | None], name: str = "") -> Callable[..., Any]:
    """Return a gRPC handler for a method that returns the fields of the response.

    The handler sends an `ImpactRigError` of the method to the client as an error of NI-DAQmx.

    Args:
        method: the method; the board is locked while it runs.
        name: name of the call (default: that of the method).
    """
    name = name or method.__name__

    @functools.wraps(method)
    def serve(self: Service, request: Any, context: Any) -> Any:
        try:
            with self.board.changed:
                return getattr(self._pb, f"{name}Response")(**(method(self, request, context) or {}))
        except ImpactRigError as error:
            code = error.code if isinstance(error, DaqmxError) else Code.DEV_CANNOT_BE_ACCESSED
            transferred = [(key, "0") for verb, key in TRANSFERRED_KEYS.items() if name.startswith(verb)]
            _abort(context, code, str(error), transferred)

    return serve


def _abort(context: Any, code: Code, message: str, transferred: Sequence[tuple[str, str]] = ()) -> None:
    """End a gRPC call with an error code and message of NI-DAQmx, in the form that the `nidaqmx` package expects.

    `transferred` is further metadata (key, value) that the package expects for a failed read or write.
    """
    context.set_trailing_metadata((("ni-error", str(int(code))), *transferred))
    context.abort(_load("grpc").StatusCode.UNKNOWN, message)


class Service:
    """Service `nidaqmx_grpc.NiDAQmx`; each method serves the call of the same name.

    `servicer` adds the calls that get or set a property. All others answer UNIMPLEMENTED.

    Args:
        board: the rig as a board.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._pb = _load("nidaqmx._stubs.nidaqmx_pb2")
        self._session = _load("session_pb2").Session
        self._events = 0

    # Tasks

    @_served
    def CreateTask(self, request: Any, context: Any) -> dict[str, Any]:
        """Create a task, or return the existing task of this name.

        The request's `initialization_behavior` can require a new or an existing task; by default, both are allowed.
        """
        name, behavior = request.session_name, request.initialization_behavior
        is_new = behavior == NEW_SESSION or (behavior != ATTACH and name not in self.board.tasks)
        task = self.board.create(name) if is_new else self.board.find(name)
        return {"task": self._session(name=task.name), "new_session_initialized": is_new}

    @_served
    def ClearTask(self, request: Any, context: Any) -> None:
        """Stop a task and remove it from the board."""
        self.board.clear(self._task(request))

    @_served
    def StartTask(self, request: Any, context: Any) -> None:
        """Start a task, or make it wait for its start trigger; no effect on a task that is running or waits already."""
        self.board.start(self._task(request))

    @_served
    def StopTask(self, request: Any, context: Any) -> None:
        """Stop a task; if an error had ended it before, the call fails with that error."""
        task = self._task(request)
        error = task.error
        self.board.stop(task)
        if error is not None:
            raise error

    @_served
    def TaskControl(self, request: Any, context: Any) -> None:
        """Perform the requested `action` on a task: start, stop or abort; other actions have no effect."""
        task, action = self._task(request), _value(request, "action")
        if action == START:
            self.board.start(task)
        elif action in {STOP, ABORT}:
            self.board.stop(task)

    @_served
    def IsTaskDone(self, request: Any, context: Any) -> dict[str, Any]:
        """Return whether a task is neither running nor waiting for its trigger; fail if an error ended the task."""
        return {"is_task_done": self.board.is_done(self._task(request))}

    @_served
    def WaitUntilTaskDone(self, request: Any, context: Any) -> None:
        """Wait until all samples of a task are acquired or generated.

        Fail after `time_to_wait` seconds of wall time (negative: no limit), or at once if the task was not started.
        """
        self.board.wait_until_done(self._task(request), request.time_to_wait, context.is_active)

    @_served
    def ResetDevice(self, request: Any, context: Any) -> None:
        """Stop all tasks of the board; the tasks and their settings remain.

        The call fails if the device name in the request is not one of the board's names.
        """
        self.board.physical_channels(f"{request.device_name}/ai0", "ai")
        for task in self.board.tasks.values():
            self.board.stop(task)

    # Channels, clock, trigger, buffers

    @_served
    def CreateAIVoltageChan(self, request: Any, context: Any) -> None:
        """Add input channels to a task; their values are in volts."""
        self._must_be(request, "units", {VOLTS})
        self._add(request, "ai")

    @_served
    def CreateAIAccelChan(self, request: Any, context: Any) -> None:
        """Add input channels to a task; their values are accelerations: volts divided by the given sensitivity."""
        units = self._must_be(request, "units", set(ACCELERATIONS))
        kind = self._must_be(request, "sensitivity_units", set(VOLTS_PER_SENSITIVITY))
        if not request.sensitivity > 0.0:
            raise DaqmxError(Code.INVALID_ATTRIBUTE_VALUE, f"sensitivity must be > 0, got {request.sensitivity:g}")
        per_g, unit = ACCELERATIONS[units]
        self._add(request, "ai", per_g / (request.sensitivity * VOLTS_PER_SENSITIVITY[kind]), unit)

    @_served
    def CreateAOVoltageChan(self, request: Any, context: Any) -> None:
        """Add the output channel `ao0` to a task; its values are in volts."""
        self._must_be(request, "units", {VOLTS})
        self._add(request, "ao")

    @_served
    def CfgSampClkTiming(self, request: Any, context: Any) -> None:
        """Set the sample clock of a task: rate, number of samples, and whether it is finite or continuous."""
        finite = self._must_be(request, "sample_mode", {FINITE, CONTINUOUS}) == FINITE
        if request.source.rpartition("/")[2] not in {"", "OnboardClock"}:
            raise DaqmxError(Code.TRIGGER_TERMINAL, f"no clock source {request.source!r}: use OnboardClock")
        self.board.configure_clock(self._task(request), request.rate, request.samps_per_chan, finite=finite)

    @_served
    def CfgDigEdgeStartTrig(self, request: Any, context: Any) -> None:
        """Make a task wait, after its start, for the next start of a task of the other kind (input or output)."""
        self.board.configure_trigger(self._task(request), request.trigger_source)

    @_served
    def DisableStartTrig(self, request: Any, context: Any) -> None:
        """Remove the start trigger of a task, so that its start takes effect at once."""
        self.board.configure_trigger(self._task(request), "")

    @_served
    def CfgInputBuffer(self, request: Any, context: Any) -> None:
        """Set the size of an input task's buffer [samples per channel]."""
        self._set(request, self._pb.BUFFER_ATTRIBUTE_INPUT_BUF_SIZE, request.num_samps_per_chan)

    @_served
    def CfgOutputBuffer(self, request: Any, context: Any) -> None:
        """Set the size of an output task's buffer [samples per channel]."""
        self._set(request, self._pb.BUFFER_ATTRIBUTE_OUTPUT_BUF_SIZE, request.num_samps_per_chan)

    # Data

    @_served
    def ReadAnalogF64(self, request: Any, context: Any) -> dict[str, Any]:
        """Read the next samples of all channels of a task, as one array ordered by channel or by scan."""
        task, count = self._task(request), request.num_samps_per_chan
        most = min(request.array_size_in_samps, MOST_MESSAGE_BYTES // 9) // max(1, len(task.channels))
        values = self.board.read(task, count, most, request.timeout, context.is_active)
        by_channel = _value(request, "fill_mode") == BY_CHANNEL
        flat = (values if by_channel else values.T).ravel()
        return {"read_array": flat, "samps_per_chan_read": values.shape[1]}

    @_served
    def ReadAnalogWaveforms(self, request: Any, context: Any) -> dict[str, Any]:
        """Read the next samples of all channels of a task as waveforms, with time, channel and unit if requested.

        A task without a sample clock has no time.
        """
        task = self._task(request)
        most = MOST_MESSAGE_BYTES // 9 // max(1, len(task.channels))
        values = self.board.read(task, request.num_samps_per_chan, most, request.timeout, context.is_active)
        mode, count = _value(request, "waveform_attribute_mode"), values.shape[1]
        timing = None
        if mode & TIMING and task.rate_hz:
            begin_ns = task.begin_ns + stamp_ns(task.passed - count, task.rate_hz)
            timing = _load("nitypes.waveform").Timing.create_with_regular_interval(
                _load("hightime").timedelta(seconds=1.0 / task.rate_hz),
                dt.datetime.fromtimestamp(begin_ns / NS_PER_S, dt.UTC),
            )
        return {
            "waveforms": [
                self._waveform(channel, row, timing, is_named=bool(mode & PROPERTIES))
                for channel, row in zip(task.channels, values, strict=True)
            ],
            "samps_per_chan_read": count,
        }

    @staticmethod
    def _waveform(channel: BoardChannel, samples: NDArray[np.float64], timing: Any, *, is_named: bool) -> Any:
        waveform = _load("nitypes.waveform").AnalogWaveform.from_array_1d(samples, np.float64, timing=timing)
        if is_named:
            waveform.channel_name, waveform.units = channel.name, channel.unit
        return _load("ni.protobuf.types.waveform_conversion").float64_analog_waveform_to_protobuf(waveform)

    @_served
    def ReadAnalogScalarF64(self, request: Any, context: Any) -> dict[str, Any]:
        """Read the next scan of a task, and return the sample of its first channel."""
        return {"value": self.board.read(self._task(request), 1, 1, request.timeout, context.is_active)[0, 0]}

    @_served
    def WriteAnalogF64(self, request: Any, context: Any) -> dict[str, Any]:
        """Write samples [V] of an output task, given as an array for its one channel."""
        return self._write(request, context, request.write_array, request.num_samps_per_chan)

    @_served
    def WriteAnalogWaveforms(self, request: Any, context: Any) -> dict[str, Any]:
        """Write samples [V] of an output task, given as one waveform."""
        if len(request.waveforms) != 1:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE,
                f"write 1 waveform, as the board has 1 output, got {len(request.waveforms)}",
            )
        samples = request.waveforms[0].y_data
        return self._write(request, context, samples, len(samples))

    def _write(self, request: Any, context: Any, samples: Sequence[float], count: int) -> dict[str, Any]:
        values = np.array(samples, np.float64)
        if len(values) == 0 or len(values) != count:
            wrong = f"the request has {len(values)} values and states {count} per channel: both must be equal and > 0"
            raise DaqmxError(Code.INVALID_ATTRIBUTE_VALUE, wrong)
        written = self.board.write(
            self._task(request), values, request.timeout, context.is_active, auto_start=request.auto_start
        )
        return {"samps_per_chan_written": written}

    @_served
    def WriteAnalogScalarF64(self, request: Any, context: Any) -> None:
        """Write one sample [V] of an output task."""
        value = np.array([request.value])
        self.board.write(self._task(request), value, request.timeout, context.is_active, auto_start=request.auto_start)

    # Events

    def RegisterEveryNSamplesEvent(self, request: Any, context: Any) -> Iterator[Any]:
        """Yield a response for every `n_samples` samples acquired by an input, or passed to the rig by an output.

        The count begins again with each start of the task. The responses end when the task is cleared or the client
        leaves.
        """

        def check(task: DaqmxTask) -> None:
            self._must_be(request, "every_n_samples_event_type", {ACQUIRED if task.kind == "ai" else TRANSFERRED})
            if request.n_samples < 1:
                raise DaqmxError(Code.INVALID_ATTRIBUTE_VALUE, f"n_samples must be at least 1, got {request.n_samples}")

        def pending(task: DaqmxTask, reported: int) -> int:
            return max(0, task.progress // int(request.n_samples) - reported)

        response = self._pb.RegisterEveryNSamplesEventResponse(
            every_n_samples_event_type_raw=_value(request, "every_n_samples_event_type"), n_samples=request.n_samples
        )
        return self._follow(request, context, check, pending, lambda _: response)

    def RegisterDoneEvent(self, request: Any, context: Any) -> Iterator[Any]:
        """Yield a response each time that a task completes its samples or fails.

        The response has the status 0 or the error code. The responses end when the task is cleared or the client
        leaves.
        """

        def pending(task: DaqmxTask, reported: int) -> int:
            return int(task.state is State.DONE and not reported)

        def response(task: DaqmxTask) -> Any:
            return self._pb.RegisterDoneEventResponse(status=task.error.code if task.error else 0)

        return self._follow(request, context, lambda _: None, pending, response)

    def _follow(
        self,
        request: Any,
        context: Any,
        check: Callable[[DaqmxTask], None],
        pending: Callable[[DaqmxTask, int], int],
        response: Callable[[DaqmxTask], Any],
    ) -> Iterator[Any]:
        """Yield responses about a task until it is cleared or the client leaves.

        Args:
            request: request of the client, which names the task.
            context: gRPC context of the call.
            check: raises a DaqmxError if the request is invalid for the task.
            pending: returns how many responses are due now; its arguments are the task and the number of responses sent
                since the task's last start.
            response: returns a response.
        """
        board = self.board
        try:
            with board.changed:
                task = self._task(request)
                check(task)
                self._count_event()
        except DaqmxError as error:
            _abort(context, error.code, str(error))
            return
        try:
            context.send_initial_metadata(())
            run, reported = task.run, 0
            while context.is_active() and board.tasks.get(task.name) is task:
                with board.changed:
                    if task.run != run:
                        run, reported = task.run, 0
                    count = pending(task, reported)
                    if not count:
                        board.changed.wait(0.1)
                for _ in range(count):
                    yield response(task)
                reported += count
        finally:
            with board.changed:
                self._events -= 1

    def _count_event(self) -> None:
        if self._events >= MOST_EVENTS:
            raise DaqmxError(
                Code.RESOURCE_RESERVED,
                f"{MOST_EVENTS} events are registered, and more are not allowed: unregister some, or clear their tasks",
            )
        self._events += 1

    # Properties

    def get_property(self, name: str, request: Any) -> Any:
        """Return the value of a property of the system, a device, a channel or a task.

        Args:
            name: name of the call without `Get`; it gives the kind of object and the type of the value.
            request: request of the client, with the number of the property.

        Raises:
            DaqmxError: the device, task or channel is unknown, or this board does not have the property.
        """
        attribute = request.attribute_raw or request.attribute
        if name.startswith("SystemInfo"):
            found = self._system_properties()
        elif name.startswith("Device"):
            self.board.physical_channels(f"{request.device_name}/ai0", "ai")
            found = self._device_properties(request.device_name)
        elif name.startswith("Chan"):
            found = self._channel_properties(self._task(request), request.channel)
        else:
            found = self._task_properties(self._task(request))
        kind = PROPERTY_TYPES.get(name.partition("Attribute")[2])
        if kind is None or not isinstance(found.get(attribute), kind):
            known = _name(request, "attribute", attribute)
            raise DaqmxError(Code.ATTR_NOT_SUPPORTED, f"property {known} is not supported by this board: omit it")
        return found[attribute]

    def _system_properties(self) -> dict[int, Any]:
        pb = self._pb
        return {
            pb.SYSTEM_ATTRIBUTE_NIDAQ_MAJOR_VERSION: VERSION["MAJOR"],
            pb.SYSTEM_ATTRIBUTE_NIDAQ_MINOR_VERSION: VERSION["MINOR"],
            pb.SYSTEM_ATTRIBUTE_NIDAQ_UPDATE_VERSION: VERSION["UPDATE"],
            pb.SYSTEM_ATTRIBUTE_DEV_NAMES: ", ".join(self.board.devices),
            pb.SYSTEM_ATTRIBUTE_TASKS: "",
            pb.SYSTEM_ATTRIBUTE_GLOBAL_CHANS: "",
            pb.SYSTEM_ATTRIBUTE_SCALES: "",
        }

    def _device_properties(self, device: str) -> dict[int, Any]:
        pb = self._pb
        return {
            pb.DEVICE_ATTRIBUTE_PRODUCT_TYPE: "impact_rig",
            pb.DEVICE_ATTRIBUTE_PRODUCT_CATEGORY: X_SERIES,
            pb.DEVICE_ATTRIBUTE_IS_SIMULATED: True,
            pb.DEVICE_ATTRIBUTE_SERIAL_NUM: 0,
            pb.DEVICE_ATTRIBUTE_AI_PHYSICAL_CHANS: ", ".join(f"{device}/ai{number}" for number in range(len(INPUTS))),
            pb.DEVICE_ATTRIBUTE_AO_PHYSICAL_CHANS: f"{device}/ao0",
        }

    def _channel_properties(self, task: DaqmxTask, name: str) -> dict[int, Any]:
        pb = self._pb
        channel = self.board.channels(task, name)[0]
        measured = ACCELERATION if channel.is_accelerometer else VOLTAGE
        return {
            pb.CHANNEL_ATTRIBUTE_CHAN_TYPE: ANALOG_INPUT if task.kind == "ai" else ANALOG_OUTPUT,
            pb.CHANNEL_ATTRIBUTE_AI_MEAS_TYPE: measured,
            pb.CHANNEL_ATTRIBUTE_AO_OUTPUT_TYPE: VOLTAGE,
            pb.CHANNEL_ATTRIBUTE_PHYSICAL_CHAN_NAME: f"{channel.device}/{channel.physical}",
            pb.CHANNEL_ATTRIBUTE_AI_MIN: channel.low,
            pb.CHANNEL_ATTRIBUTE_AI_MAX: channel.high,
            pb.CHANNEL_ATTRIBUTE_AO_MIN: channel.low,
            pb.CHANNEL_ATTRIBUTE_AO_MAX: channel.high,
        }

    def _task_properties(self, task: DaqmxTask) -> dict[int, Any]:
        pb = self._pb
        channels = ", ".join(channel.name for channel in task.channels)
        devices = list(dict.fromkeys(channel.device for channel in task.channels))
        finite = task.samples is not None
        return {
            pb.TASK_ATTRIBUTE_NAME: task.name, pb.TASK_ATTRIBUTE_CHANNELS: channels,
            pb.TASK_ATTRIBUTE_NUM_CHANS: len(task.channels), pb.TASK_ATTRIBUTE_COMPLETE: not task.is_active,
            pb.TASK_ATTRIBUTE_DEVICES: ", ".join(devices), pb.TASK_ATTRIBUTE_NUM_DEVICES: len(devices),
            pb.READ_ATTRIBUTE_CHANNELS_TO_READ: channels, pb.READ_ATTRIBUTE_NUM_CHANS: len(task.channels),
            pb.READ_ATTRIBUTE_AVAIL_SAMP_PER_CHAN: task.available, pb.READ_ATTRIBUTE_AUTO_START: task.auto_starts,
            pb.READ_ATTRIBUTE_CURR_READ_POS: task.passed, pb.READ_ATTRIBUTE_READ_ALL_AVAIL_SAMP: False,
            pb.READ_ATTRIBUTE_TOTAL_SAMP_PER_CHAN_ACQUIRED: task.progress,
            pb.WRITE_ATTRIBUTE_NUM_CHANS: len(task.channels), pb.WRITE_ATTRIBUTE_CURR_WRITE_POS: task.written,
            pb.WRITE_ATTRIBUTE_TOTAL_SAMP_PER_CHAN_GENERATED: task.passed,
            pb.WRITE_ATTRIBUTE_SPACE_AVAIL: max(0, max(task.buffer_size, task.clock_samples) - len(task.data)),
            pb.WRITE_ATTRIBUTE_REGEN_MODE: ALLOW_REGENERATION if task.regenerates else DONT_ALLOW_REGENERATION,
            pb.BUFFER_ATTRIBUTE_INPUT_BUF_SIZE: task.buffer_size,
            pb.BUFFER_ATTRIBUTE_OUTPUT_BUF_SIZE: task.buffer_size,
            pb.TIMING_ATTRIBUTE_SAMP_CLK_RATE: float(task.rate_hz),
            pb.TIMING_ATTRIBUTE_SAMP_QUANT_SAMP_MODE: FINITE if finite else CONTINUOUS,
            pb.TIMING_ATTRIBUTE_SAMP_QUANT_SAMP_PER_CHAN: task.clock_samples,
            pb.TIMING_ATTRIBUTE_SAMP_TIMING_TYPE: SAMPLE_CLOCK if task.rate_hz else ON_DEMAND,
            pb.TRIGGER_ATTRIBUTE_START_TRIG_TYPE: DIGITAL_EDGE if task.trigger else NO_TRIGGER,
            pb.TRIGGER_ATTRIBUTE_START_TRIG_TERM: f"/{self.board.devices[0]}/{task.kind}/StartTrigger",
        }  # fmt: skip

    def set_property(self, request: Any) -> None:
        """Set a property of a task.

        Raises:
            DaqmxError: the task or channel is unknown, the property or its value is not supported for this task, or the
                property cannot change while the task runs.
        """
        self._set(request, request.attribute_raw or request.attribute, _value(request, "value"))

    def _set(self, request: Any, attribute: int, value: Any) -> None:
        pb, task = self._pb, self._task(request)
        lows = {pb.CHANNEL_ATTRIBUTE_AI_MIN: "ai", pb.CHANNEL_ATTRIBUTE_AO_MIN: "ao"}
        highs = {pb.CHANNEL_ATTRIBUTE_AI_MAX: "ai", pb.CHANNEL_ATTRIBUTE_AO_MAX: "ao"}
        buffers = {pb.BUFFER_ATTRIBUTE_INPUT_BUF_SIZE: "ai", pb.BUFFER_ATTRIBUTE_OUTPUT_BUF_SIZE: "ao"}
        kind = (buffers | lows | highs).get(attribute, task.kind)
        if task.kind not in {"", kind}:
            name = _name(request, "attribute", attribute)
            raise DaqmxError(
                Code.ATTRIBUTE_NOT_SUPPORTED_IN_TASK_CONTEXT,
                f"property {name} needs a task with {'inputs' if kind == 'ai' else 'an output'}",
            )
        if attribute == pb.WRITE_ATTRIBUTE_REGEN_MODE:
            task.must_be_idle()
            mode = self._must_be(request, "value", {ALLOW_REGENERATION, DONT_ALLOW_REGENERATION})
            task.regenerates = mode == ALLOW_REGENERATION
        elif attribute == pb.READ_ATTRIBUTE_AUTO_START:
            task.auto_starts = bool(value)
        elif attribute in buffers:
            self.board.configure_buffer(task, value)
        elif attribute == pb.TIMING_ATTRIBUTE_SAMP_CLK_RATE:
            self.board.configure_clock(task, value, task.clock_samples, finite=task.samples is not None)
        elif attribute in lows:
            self.board.configure_range(task, request.channel, low=value)
        elif attribute in highs:
            self.board.configure_range(task, request.channel, high=value)
        else:
            known = _name(request, "attribute", attribute)
            raise DaqmxError(Code.ATTR_NOT_SUPPORTED, f"property {known} cannot be set on this board: omit it")

    @_served
    def GetErrorString(self, request: Any, context: Any) -> dict[str, Any]:
        """Return the name of an error code as text; empty if this board does not use the code."""
        name = Code(request.error_code).name if request.error_code in set(Code) else ""
        return {"error_string": name.replace("_", " ").capitalize()}

    # Helpers

    def _task(self, request: Any) -> DaqmxTask:
        return self.board.find(request.task.name)

    def _add(self, request: Any, kind: str, per_volt: float = 1.0, unit: str = "Volts") -> None:
        if request.custom_scale_name:
            raise DaqmxError(
                Code.INVALID_ATTRIBUTE_VALUE,
                f"custom scales are not supported by this board, got {request.custom_scale_name!r}: leave it empty",
            )
        self.board.add_channels(
            self._task(request),
            kind,
            request.physical_channel,
            request.name_to_assign_to_channel,
            (request.min_val, request.max_val),
            per_volt,
            unit,
        )

    @staticmethod
    def _must_be(request: Any, field: str, allowed: set[int]) -> int:
        value = _value(request, field)
        if value not in allowed:
            known = ", ".join(_name(request, field, number) for number in sorted(allowed))
            value = _name(request, field, value)
            raise DaqmxError(Code.INVALID_ATTRIBUTE_VALUE, f"{field} must be one of {known} on this board, got {value}")
        return int(value)


def _value(request: Any, field: str) -> Any:
    """Return a field of a request that clients give either as an enumerator or as a number (`field_raw`)."""
    raw = f"{field}_raw"
    if raw in request.DESCRIPTOR.fields_by_name and not request.HasField(field):
        return getattr(request, raw)
    return getattr(request, field)


def _name(request: Any, field: str, number: int) -> str:
    """Return name and number of an enumerator of NI's interface, for an error message; the number alone if unnamed."""
    described = request.DESCRIPTOR.fields_by_name.get(field)  # None for a request that implies the property
    names = described.enum_type if described else None  # None for a plain number
    found = names.values_by_number.get(number) if names else None
    return f"{found.name} ({number})" if found else str(number)


def _properties(servicer: type) -> dict[str, Callable[..., Any]]:
    """Return, by name, the gRPC handlers of all calls in NI's interface that get or set a property."""
    return {
        name: _property_method(name)
        for name in dir(servicer)
        if name.startswith(("Get", "Set")) and "Attribute" in name
    }


def _property_method(name: str) -> Callable[..., Any]:
    def method(self: Service, request: Any, _context: Any) -> dict[str, Any] | None:
        if name.startswith("Set"):
            self.set_property(request)
            return None
        fields = getattr(self._pb, f"{name}Response").DESCRIPTOR.fields_by_name
        field = "value_raw" if "value_raw" in fields else "value"
        return {field: self.get_property(name.removeprefix("Get"), request)}

    return _served(method, name)


def servicer(board: Board) -> Any:
    """Return an object that serves each call of NI's service for a board, as gRPC needs it."""
    stubs = _load("nidaqmx._stubs.nidaqmx_pb2_grpc")
    return type("Servicer", (Service, stubs.NiDAQmxServicer), _properties(stubs.NiDAQmxServicer))(board)


def _reason(address: str) -> str:
    """Return the reason why a server cannot listen on an address `HOST:PORT`, for an error message.

    If the operating system reports no reason, the text says that gRPC does not accept the address.
    """
    host, _, port = address.rpartition(":")
    try:
        family, kind, _, _, where = socket.getaddrinfo(host.strip("[]"), port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind) as probe:
            probe.bind(where)
    except OSError as error:
        return f"{error.strerror}; choose another address or port"
    return "gRPC does not accept this address; use HOST:PORT with a name or IP address of this machine"


@contextlib.contextmanager
def serving(board: Board, address: str) -> Iterator[tuple[Any, int]]:
    """Serve a board until the end of the `with` statement, and yield the server and its port.

    At the end, the board and its rig are closed.

    Args:
        board: the rig as a board.
        address: host and port to listen on, `HOST:PORT`; for port 0, the system chooses a free one.

    Raises:
        ImpactRigError: the extra `nidaqmx` is not installed, or the address cannot be used; the board is not closed.
    """
    os.environ.setdefault("GRPC_VERBOSITY", "NONE")  # an address that cannot be used has the message below
    grpc = _load("grpc")
    stubs = _load("nidaqmx._stubs.nidaqmx_pb2_grpc")
    with futures.ThreadPoolExecutor(MOST_CALLS) as pool:
        server = grpc.server(
            pool,
            maximum_concurrent_rpcs=MOST_CALLS,
            options=[
                ("grpc.max_receive_message_length", MOST_MESSAGE_BYTES),
                ("grpc.max_send_message_length", MOST_MESSAGE_BYTES),
                ("grpc.so_reuseport", 0),
            ],
        )
        stubs.add_NiDAQmxServicer_to_server(servicer(board), server)
        try:
            port = server.add_insecure_port(address)
        except RuntimeError as error:
            raise ImpactRigError(f"cannot listen on {address}: {_reason(address)}") from error
        server.start()
        try:
            yield server, port
        finally:
            board.close()  # this also ends the calls that wait
            server.stop(0).wait()
