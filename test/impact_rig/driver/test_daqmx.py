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
"""Scripts for the real `nidaqmx` package of NI, run against the rig."""

from __future__ import annotations

import contextlib
import datetime as dt
import re
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("nidaqmx", reason="the extra nidaqmx is not installed")

import grpc
import nidaqmx
from nidaqmx._stubs import nidaqmx_pb2
from nidaqmx.constants import (
    AccelUnits,
    AcquisitionType,
    FillMode,
    ProductCategory,
    RegenerationMode,
    TaskMode,
    WaveformAttributeMode,
)
from nidaqmx.error_codes import DAQmxErrors
from nidaqmx.stream_readers import AnalogMultiChannelReader
from nitypes.waveform import AnalogWaveform

from impact_rig.cli import main
from impact_rig.driver import LocalRig
from impact_rig.driver.daqmx_board import MOST_TASKS, Board, DaqmxError, DaqmxTask
from impact_rig.driver.daqmx_server import MOST_EVENTS, MOST_MESSAGE_BYTES, serving
from impact_rig.errors import CommandError, ConfigError, SimulationError
from impact_rig.rig.config import RigConfig, from_flat

IDEAL = {"instruments.ideal": True, "sphere.present": False}
RATE_HZ = 2000
WAVE = 0.3 * np.sin(2.0 * np.pi * 9.0 * np.arange(RATE_HZ) / RATE_HZ)
PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "daqmx.md"
MakeTask = Callable[[], Any]


@pytest.fixture
def address() -> Iterator[str]:
    """Host and port of a board with ideal instruments."""
    with serving(Board(from_flat(RigConfig(), IDEAL)), "127.0.0.1:0") as (_, port):
        yield f"127.0.0.1:{port}"


@pytest.fixture
def task(address: str) -> Iterator[MakeTask]:
    """Return a function that makes tasks; all tasks are closed after the test."""
    with grpc.insecure_channel(address) as channel:
        made: list[Any] = []

        def make() -> Any:
            made.append(nidaqmx.Task(grpc_options=nidaqmx.GrpcSessionOptions(channel, "")))
            return made[-1]

        yield make
        for one in made:
            one.close()


def inputs(task: Any, channels: str = "Dev1/ai3", samples: int = RATE_HZ, *, finite: bool = False) -> Any:
    task.ai_channels.add_ai_voltage_chan(channels)
    mode = AcquisitionType.FINITE if finite else AcquisitionType.CONTINUOUS
    task.timing.cfg_samp_clk_timing(RATE_HZ, sample_mode=mode, samps_per_chan=samples)
    return task


def output(task: Any, samples: int = RATE_HZ, *, finite: bool = False, repeat: bool = True) -> Any:
    task.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    mode = AcquisitionType.FINITE if finite else AcquisitionType.CONTINUOUS
    task.timing.cfg_samp_clk_timing(RATE_HZ, sample_mode=mode, samps_per_chan=samples)
    if not repeat:
        task.out_stream.regen_mode = RegenerationMode.DONT_ALLOW_REGENERATION
    return task


@contextlib.contextmanager
def rejected(expected: DAQmxErrors) -> Iterator[None]:
    with pytest.raises(nidaqmx.errors.DaqError) as raised:
        yield
    assert raised.value.error_type is expected


@pytest.mark.heavy
def test_a_finite_input_reads_all_channels(task: MakeTask) -> None:
    found = np.array(inputs(task(), "Dev1/ai0:3", 500, finite=True).read(-1))
    assert found.shape == (4, 500)
    assert np.isfinite(found).all()


def read_all(ai: Any, most: int) -> int:
    """Read without a number of samples, which the package itself never does, and return how many were read."""
    values = np.zeros((1, most))
    return int(ai._interpreter.read_analog_f64(ai._handle, -1, 10.0, FillMode.GROUP_BY_CHANNEL.value, values)[1])


@pytest.mark.heavy
def test_a_finite_input_can_be_read_in_parts(task: MakeTask) -> None:
    ai = inputs(task(), samples=500, finite=True)
    assert len(ai.read(200)) == 200
    assert [read_all(ai, 100), read_all(ai, 1000)] == [100, 200]
    with rejected(DAQmxErrors.SAMPLES_WILL_NEVER_BE_AVAILABLE):
        ai.read(1)


@pytest.mark.heavy
def test_an_output_is_repeated_and_triggers_an_input(task: MakeTask) -> None:
    ai, ao = inputs(task()), output(task())
    ai.triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/ao/StartTrigger")
    assert ao.write(WAVE) == RATE_HZ
    ai.start()
    assert not ai.is_task_done()
    assert not any(ai.in_stream.avail_samp_per_chan for _ in range(100))  # rig time passes meanwhile
    ao.start()
    found = np.array([ai.read(500) for _ in range(6)])
    assert np.abs(found.ravel() - np.resize(WAVE, 3000)).max() < 1e-9
    assert ao.timing.samp_clk_rate == RATE_HZ


@pytest.mark.heavy
@pytest.mark.parametrize("count", [5, 20, 30, RATE_HZ])
def test_a_finite_input_with_a_trigger_within_a_block_is_complete(task: MakeTask, count: int) -> None:
    ai, ao = inputs(task(), samples=count, finite=True), output(task())
    ai.triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/ao/StartTrigger")
    ai.start()
    ao.write(WAVE, auto_start=True)
    ai.wait_until_done(20.0)
    time.sleep(0.05)  # for further blocks
    np.testing.assert_allclose(ai.read(count), WAVE[:count], atol=1e-9)


@pytest.mark.heavy
def test_a_repeated_output_is_overwritten_from_its_beginning(task: MakeTask) -> None:
    ai, ao = inputs(task()), output(task(), 400)
    ai.triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/ao/StartTrigger")
    ao.write(WAVE[:400])
    ai.start()
    ao.start()
    ao.write(np.full(100, 0.1))
    ao.write(np.full(100, 0.2))
    expected = np.concatenate([np.full(100, 0.1), np.full(100, 0.2), WAVE[200:400]])
    assert any(np.abs(np.array(ai.read(400)) - expected).max() < 1e-9 for _ in range(20))


@pytest.mark.heavy
def test_an_output_can_be_written_while_an_input_is_read(task: MakeTask) -> None:
    ai, ao = inputs(task()), output(task(), 1000, repeat=False)
    ao.triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/ai/StartTrigger")
    ao.write(WAVE[:1000])
    ao.start()
    ai.start()
    samples = np.concatenate([np.full(500, value) for value in (0.1, -0.1, 0.2, 0.0)])
    parts = []
    for part in np.split(samples, 4):
        parts.append(ai.read(500))
        ao.write(part)
    parts.append(ai.read(1000))
    assert np.abs(np.concatenate(parts) - np.concatenate([WAVE[:1000], samples])[:3000]).max() < 1e-9


@pytest.mark.heavy
def test_a_finite_output_ends_after_its_samples(task: MakeTask) -> None:
    ao = output(task(), 400, finite=True)
    done = threading.Event()
    ao.register_done_event(lambda *_: done.set() or 0)
    ao.write(WAVE[:400])
    ao.start()
    ao.wait_until_done(timeout=20.0)
    assert ao.is_task_done()
    assert done.wait(20.0)
    ao.stop()


@pytest.mark.heavy
def test_events_report_samples_that_a_reader_then_reads(task: MakeTask) -> None:
    ai = inputs(task(), "Dev1/ai1, Dev1/ai2")
    parts: list[np.ndarray] = []
    enough = threading.Event()
    reader = AnalogMultiChannelReader(ai.in_stream)

    def on_samples(_task: object, _kind: object, count: int, _data: object) -> int:
        values = np.empty((2, count))
        assert reader.read_many_sample(values, count) == count
        parts.append(values)
        if len(parts) == 5:
            enough.set()
        return 0

    ai.register_every_n_samples_acquired_into_buffer_event(200, on_samples)
    ai.start()
    assert enough.wait(20.0)
    ai.stop()


def test_waveforms_have_their_time_channel_and_unit(task: MakeTask) -> None:
    ai = inputs(task(), "Dev1/ai2:3")
    ai.ai_channels.add_ai_accel_chan(
        "Dev1/ai0", name_to_assign_to_channel="a", units=AccelUnits.METERS_PER_SECOND_SQUARED
    )
    before = dt.datetime.now(dt.UTC)
    ai.start()
    first, second = ai.read_waveform(100), ai.read_waveform(50)
    assert [one.channel_name for one in first] == ["Dev1/ai2", "Dev1/ai3", "a"]
    assert [one.units for one in first] == ["Volts", "Volts", "m/s^2"]
    assert [one.sample_count for one in (*first, *second)] == [100] * 3 + [50] * 3
    assert first[0].timing.sample_interval.total_seconds() == 1.0 / RATE_HZ
    begin = first[0].timing.start_time
    assert abs((begin - before).total_seconds()) < 1.0
    assert (second[0].timing.start_time - begin).total_seconds() == pytest.approx(100 / RATE_HZ, abs=2e-6)
    ai.in_stream.waveform_attribute_mode = WaveformAttributeMode.EXTENDED_PROPERTIES
    assert not ai.read_waveform(10)[0].timing.has_timestamp


@pytest.mark.heavy
def test_a_waveform_is_played(task: MakeTask) -> None:
    ai, ao = inputs(task(), finite=True), output(task())
    ai.triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/ao/StartTrigger")
    ai.start()
    assert ao.write(AnalogWaveform.from_array_1d(WAVE, np.float64), auto_start=True) == RATE_HZ
    read = ai.read_waveform(RATE_HZ)
    assert np.corrcoef(read.scaled_data, WAVE)[0, 1] > 0.999
    with rejected(DAQmxErrors.INVALID_ATTRIBUTE_VALUE):
        ao._interpreter.write_analog_waveforms(
            ao._handle, [AnalogWaveform.from_array_1d(WAVE, np.float64)] * 2, False, 1.0
        )


def test_the_range_of_a_channel_can_be_changed_and_read(task: MakeTask) -> None:
    ai = task()
    first = ai.ai_channels.add_ai_voltage_chan("Dev1/ai0", min_val=-0.1, max_val=0.1)
    rest = ai.ai_channels.add_ai_voltage_chan("Dev1/ai1:3", min_val=-10.0, max_val=10.0)
    first.ai_max = 5.0
    rest.ai_min = -2.0
    assert [(one.ai_min, one.ai_max) for one in (first, rest)] == [(-0.1, 5.0), (-2.0, 10.0)]
    assert ai.ai_channels["Dev1/ai3"].ai_min == -2.0
    with rejected(DAQmxErrors.INVALID_ATTRIBUTE_VALUE):
        first.ai_min = 5.0
    ao = task()
    channel = ao.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    channel.ao_max = 1.0
    with rejected(DAQmxErrors.INVALID_AO_DATA_WRITE):
        ao.write(1.5)


def test_a_script_finds_the_terminals_of_the_board(task: MakeTask) -> None:
    """NI's examples look for the first device that is no module of a chassis."""
    ai = inputs(task())
    assert ai.devices[0].product_category not in {ProductCategory.C_SERIES_MODULE, ProductCategory.SCXI_MODULE}


def test_single_values_are_written_and_read_on_demand(task: MakeTask) -> None:
    ao, ai, both, values = task(), task(), inputs(task(), "Dev1/ai3, Dev1/ai1"), np.zeros(20)
    ao.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    ao.write(0.25)
    ai.ai_channels.add_ai_voltage_chan("Dev1/ai3")
    while abs(ai.read() - 0.25) > 1e-9:  # the amplifier is on its way there
        pass
    both._interpreter.read_analog_f64(both._handle, 10, 10.0, FillMode.GROUP_BY_SCAN_NUMBER.value, values)
    assert values[::2] == pytest.approx(0.25, abs=1e-9)
    assert abs(values[1::2] - 0.25).min() > 0.01
    ao.stop()


@pytest.mark.heavy
def test_acceleration_is_scaled_by_the_sensitivity_that_the_script_states(task: MakeTask) -> None:
    ao, volts, accel = task(), task(), task()
    ao.ao_channels.add_ao_voltage_chan("Dev1/ao0")
    ao.write(0.25)
    volts.ai_channels.add_ai_voltage_chan("Dev1/ai3")
    while abs(volts.read() - 0.25) > 1e-9:  # the amplifier is on its way there
        pass
    accel.ai_channels.add_ai_accel_chan("Dev1/ai3", units=AccelUnits.METERS_PER_SECOND_SQUARED, sensitivity=100.0)
    assert accel.read() == pytest.approx(9.80665 * 0.25 / 0.1, rel=1e-6)  # 100 mV/g


def test_a_read_without_enough_samples_times_out(task: MakeTask) -> None:
    with rejected(DAQmxErrors.SAMPLES_NOT_YET_AVAILABLE):
        inputs(task()).read(RATE_HZ, timeout=0.05)


def fall_behind(ai: Any) -> None:
    while True:
        ai.in_stream.avail_samp_per_chan  # noqa: B018  # takes longer than a sample
        ai.read(1)


def test_a_slow_reader_gets_the_error_of_overwritten_samples(task: MakeTask) -> None:
    ai = inputs(task())
    ai.in_stream.input_buf_size = 100
    ai.start()
    with rejected(DAQmxErrors.SAMPLES_NO_LONGER_AVAILABLE):
        fall_behind(ai)


@pytest.mark.heavy
@pytest.mark.parametrize("ask", ["write", "is_task_done", "wait_until_done", "stop"])
def test_an_output_without_samples_gets_the_error_of_an_underrun(task: MakeTask, ask: str) -> None:
    ao = output(task(), 400, repeat=False)
    done = threading.Event()
    ao.register_done_event(lambda *_: done.set() or 0)
    ao.write(WAVE[:400])
    ao.start()
    assert done.wait(20.0)
    with rejected(DAQmxErrors.GEN_STOPPED_TO_PREVENT_REGEN_OF_OLD_SAMPLES):
        ao.write(WAVE[:400]) if ask == "write" else getattr(ao, ask)()


@pytest.mark.parametrize(
    ("channel", "expected"),
    [
        ("Dev1/ai4", DAQmxErrors.PHYSICAL_CHAN_DOES_NOT_EXIST),
        ("Dev1/ai2:9", DAQmxErrors.PHYSICAL_CHAN_DOES_NOT_EXIST),
        ("Dev1/ao0", DAQmxErrors.PHYSICAL_CHAN_DOES_NOT_EXIST),
        ("Dev2/ai0", DAQmxErrors.INVALID_DEVICE_ID),
    ],
)
def test_an_invalid_channel_is_rejected(task: MakeTask, channel: str, expected: DAQmxErrors) -> None:
    with rejected(expected):
        task().ai_channels.add_ai_voltage_chan(channel)


def test_a_list_with_a_rejected_channel_adds_none_of_it(task: MakeTask) -> None:
    ai = task()
    with rejected(DAQmxErrors.CHAN_ALREADY_IN_TASK):
        ai.ai_channels.add_ai_voltage_chan("Dev1/ai0, Dev1/ai1, Dev1/ai0")
    assert ai.number_of_channels == 0
    ai.ai_channels.add_ai_voltage_chan("Dev1/ai0:1")
    assert ai.channel_names == ["Dev1/ai0", "Dev1/ai1"]


def test_a_list_of_a_tasks_channels_may_descend(task: MakeTask) -> None:
    ai = task()
    ai.ai_channels.add_ai_voltage_chan("Dev1/ai0:3", min_val=-10.0, max_val=10.0)
    nidaqmx.task.channels.AIChannel(ai._handle, "Dev1/ai2:1", ai._interpreter).ai_max = 5.0
    assert [ai.ai_channels[f"Dev1/ai{number}"].ai_max for number in range(4)] == [10.0, 5.0, 5.0, 10.0]


def test_two_channels_of_a_task_cannot_have_one_name(task: MakeTask) -> None:
    ai = task()
    ai.ai_channels.add_ai_voltage_chan("Dev1/ai0", "Dev1/ai2")
    for name in ("Dev1/ai2", ""):  # without a name, that on the board
        with rejected(DAQmxErrors.CHAN_ALREADY_IN_TASK):
            ai.ai_channels.add_ai_voltage_chan("Dev1/ai2", name)
    assert ai.channel_names == ["Dev1/ai2"]


def test_buffers_and_ranges_of_the_other_kind_of_task_are_rejected(task: MakeTask) -> None:
    ai, ao = inputs(task()), output(task())
    ao_of_ai = nidaqmx.task.channels.AOChannel(ai._handle, "Dev1/ai3", ai._interpreter)
    ai_of_ao = nidaqmx.task.channels.AIChannel(ao._handle, "Dev1/ao0", ao._interpreter)
    before = ai.in_stream.input_buf_size, ao.out_stream.output_buf_size
    for one, names in (
        (ai.out_stream, ["output_buf_size"]),
        (ao.in_stream, ["input_buf_size"]),
        (ao_of_ai, ["ao_min", "ao_max"]),
        (ai_of_ao, ["ai_min", "ai_max"]),
    ):
        for name in names:
            with rejected(DAQmxErrors.ATTRIBUTE_NOT_SUPPORTED_IN_TASK_CONTEXT):
                setattr(one, name, 300)
    for call, one in (("CfgInputBuffer", ao), ("CfgOutputBuffer", ai)):
        request = getattr(nidaqmx_pb2, f"{call}Request")(task=one._handle, num_samps_per_chan=300)
        with rejected(DAQmxErrors.ATTRIBUTE_NOT_SUPPORTED_IN_TASK_CONTEXT):
            one._interpreter._invoke(getattr(one._interpreter._client, call), request)
    assert (ai.in_stream.input_buf_size, ao.out_stream.output_buf_size) == before


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", [1e9, 250_001.0, 99.0, 0.0, -5.0, float("nan"), float("inf")])
def test_an_invalid_rate_is_rejected(task: MakeTask, rate_hz: float) -> None:
    ai = inputs(task())
    with rejected(DAQmxErrors.INVALID_ATTRIBUTE_VALUE):
        ai.timing.cfg_samp_clk_timing(rate_hz)


def test_a_read_from_a_task_that_was_not_started_is_rejected(task: MakeTask) -> None:
    ai = inputs(task())
    ai.in_stream.auto_start = False
    with rejected(DAQmxErrors.CANNOT_READ_WHEN_AUTO_START_FALSE_AND_TASK_NOT_RUNNING_OR_COMMITTED):
        ai.read(10)
    with pytest.raises(nidaqmx.errors.DaqReadError):
        read_all(ai, 10)
    with rejected(DAQmxErrors.CANNOT_PERFORM_OP_WHEN_TASK_NOT_RUNNING):
        ai.wait_until_done()
    with rejected(DAQmxErrors.OUTPUT_BUFFER_EMPTY):
        output(task()).start()


def too_many(ai: Any) -> None:
    ai._interpreter.read_analog_f64(ai._handle, 20, 1.0, FillMode.GROUP_BY_CHANNEL.value, np.zeros((1, 10)))


def play_at(ao: Any, rate_hz: int) -> None:
    output(ao).timing.samp_clk_rate = rate_hz
    ao.write(WAVE, auto_start=True)


@pytest.mark.parametrize(
    ("misuse", "expected"),
    [
        (lambda ai, _: output(ai), DAQmxErrors.CAN_NOT_PERFORM_OP_WHILE_TASK_RUNNING),
        (lambda _, make: output(inputs(make())), DAQmxErrors.INVALID_TASK),
        (lambda _, make: inputs(make(), "Dev1/ai0, Dev1/ai0"), DAQmxErrors.CHAN_ALREADY_IN_TASK),
        (lambda _, make: output(make()).write([0.0, 10.1]), DAQmxErrors.INVALID_AO_DATA_WRITE),
        (lambda _, make: make().start(), DAQmxErrors.CAN_NOT_PERFORM_OP_WHEN_NO_CHANS_IN_TASK),
        (lambda ai, _: too_many(ai), DAQmxErrors.INVALID_ATTRIBUTE_VALUE),
        (lambda _, make: inputs(make()).start(), -50103),  # the resource is reserved
        (lambda _, make: play_at(make(), 1000), DAQmxErrors.INVALID_ATTRIBUTE_VALUE),
    ],
)  # fmt: skip
def test_misuse_of_a_running_input_is_rejected(
    task: MakeTask, misuse: Callable[[Any, MakeTask], object], expected: DAQmxErrors | int
) -> None:
    ai = inputs(task())
    ai.start()
    with pytest.raises(nidaqmx.errors.DaqError) as raised:
        misuse(ai, task)
    assert raised.value.error_code == int(expected)
    assert len(ai.read(10)) == 10


def test_a_task_is_controlled_and_a_reset_stops_it(task: MakeTask, address: str) -> None:
    ai = inputs(task())
    ai.start()
    with grpc.insecure_channel(address) as channel:
        options = nidaqmx.GrpcSessionOptions(channel, "")
        with rejected(DAQmxErrors.INVALID_DEVICE_ID):
            nidaqmx.system.Device("Dev2", grpc_options=options).reset_device()
        assert not ai.is_task_done()
        ai.control(TaskMode.TASK_STOP)
        assert ai.is_task_done()
        ai.control(TaskMode.TASK_START)
        assert not ai.is_task_done()
        nidaqmx.system.Device("Dev1", grpc_options=options).reset_device()
    assert ai.is_task_done()


def test_unsupported_calls_are_rejected_as_unsupported(task: MakeTask) -> None:
    with pytest.raises(nidaqmx.errors.RpcError, match="not supported by the NI gRPC Device Server"):
        task().di_channels.add_di_chan("Dev1/port0/line0")
    ai = inputs(task())
    with rejected(DAQmxErrors.ATTR_NOT_SUPPORTED):
        ai.timing.samp_clk_dig_fltr_enable  # noqa: B018  # asks the server
    with rejected(DAQmxErrors.ATTR_NOT_SUPPORTED):
        ai._interpreter.get_task_attribute_uint32(ai._handle, nidaqmx_pb2.TASK_ATTRIBUTE_NAME)  # which is a text


@pytest.mark.ros
def test_a_task_with_another_rate_than_the_running_rig_is_rejected() -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.driver import RosRig

    rates = {"daq.rate_hz": RATE_HZ, "daq.block_scans": 20, "drive.stream_rate_hz": RATE_HZ}
    rig = RosRig({**IDEAL, **rates, "drive.waveform": "stream"}, mode="realtime", hosted=True)
    with (
        serving(Board(RigConfig(), rig), "127.0.0.1:0") as (_, port),
        grpc.insecure_channel(f"127.0.0.1:{port}") as channel,
        nidaqmx.Task(grpc_options=nidaqmx.GrpcSessionOptions(channel, "")) as ai,
        nidaqmx.Task(grpc_options=nidaqmx.GrpcSessionOptions(channel, "")) as ao,
    ):
        inputs(ai).triggers.start_trigger.cfg_dig_edge_start_trig("/Dev1/ao/StartTrigger")
        with pytest.raises(nidaqmx.errors.DaqError, match="the running rig has 2000 Hz, which a task cannot change"):
            ai.timing.cfg_samp_clk_timing(1000)
        output(ao).write(WAVE)
        ai.start()
        ao.start()
        assert any(np.ptp(ai.read(500)) > 0.5 for _ in range(10))
    assert rig.closed


@pytest.mark.heavy
def test_a_message_beyond_the_size_limit_is_rejected(task: MakeTask) -> None:
    ao = output(task())
    with pytest.raises(nidaqmx.errors.RpcError, match="larger than max"):
        ao.write(np.zeros(MOST_MESSAGE_BYTES // 8 + 1000))


@pytest.mark.heavy
def test_the_number_of_events_is_bounded(task: MakeTask) -> None:
    for _ in range(MOST_EVENTS):
        inputs(task()).register_done_event(lambda *_: 0)
    with pytest.raises(nidaqmx.errors.DaqError, match="16 events are registered, and more are not allowed: unreg"):
        inputs(task()).register_done_event(lambda *_: 0)


def test_the_number_of_tasks_is_bounded() -> None:
    board = Board(RigConfig())
    for _ in range(MOST_TASKS):
        board.create("")
    with pytest.raises(DaqmxError, match="64 tasks exist, and more are not allowed: clear some of them"):
        board.create("")
    board.close()


def test_a_running_rig_keeps_its_configuration(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["daqmx", "--config", "config/nominal.yaml", "--namespace", "/rig"]) == 1
    assert "--config describes a rig to simulate: use it without --namespace" in capsys.readouterr().err


def test_a_port_in_use_is_reported_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        program = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())"]
        command = [*program, "daqmx", "--port", address.rpartition(":")[2]]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    why = "Address already in use; choose another address or port"
    assert done.stderr == f"impact-rig daqmx: cannot listen on {address}: {why}\n"
    assert done.returncode == 1


def test_the_script_of_the_page_measures_the_dt_of_the_rig(tmp_path: Path) -> None:
    page = PAGE.read_text(encoding="utf-8")
    script = re.search(r"```python[^\n]*\n(.*?)```", page, re.DOTALL)
    printed = re.search(r"It prints DT (\S+) ± (\S+) .*, as `impact-rig record --current (\S+)` measures", page)
    assert script is not None
    assert printed is not None
    stated, limit = float(printed[1]), float(printed[2])
    with serving(Board(RigConfig()), "127.0.0.1:0") as (_, port):
        text = script[1].replace("localhost:31763", f"127.0.0.1:{port}")
        assert text != script[1]
        (tmp_path / "script.py").write_text(text)
        done = subprocess.run(
            [sys.executable, "script.py"], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
        )
    assert done.returncode == 0, done.stderr
    found = re.fullmatch(r"9\.1 Hz: DT (\d+\.\d)\n", done.stdout)
    assert found is not None, done.stdout
    with LocalRig(analysis={}) as rig:
        rig.command(frequency_hz=9.1, current_a=float(printed[3]))
        rig.run(20.0)
        measured = rig.rows("transmissibility/table")["transmissibility"][-1]
    assert measured == pytest.approx(stated, abs=limit)
    assert float(found[1]) == pytest.approx(stated, abs=limit)


def add_output(board: Board, rate_hz: int, samples: int) -> DaqmxTask:
    task = board.create("output")
    board.add_channels(task, "ao", "Dev1/ao0", "", (-10.0, 10.0), 1.0, "Volts")
    board.configure_clock(task, rate_hz, samples, finite=True)
    return task


@pytest.mark.parametrize(
    ("config", "error", "message"),
    [
        ({}, CommandError, "the drive is sine, not a stream"),
        ({"drive.waveform": "stream", "daq.block_scans": 1000}, ConfigError, "buffer_s must be from"),
    ],
)
def test_a_running_rig_without_an_output_is_rejected_at_each_start(
    config: dict[str, Any], error: type[Exception], message: str
) -> None:
    board = Board(RigConfig(), LocalRig({**IDEAL, **config}))
    with contextlib.closing(board), board.changed:
        task = add_output(board, 10_000, 100)
        for _ in range(2):
            with pytest.raises(error, match=message):
                board.write(task, WAVE[:100], 1.0, lambda: True, auto_start=True)
            assert not task.is_active


def test_a_task_uses_the_running_rig_even_if_a_new_rate_waits_for_a_reset() -> None:
    rig = LocalRig({**IDEAL, "drive.waveform": "stream", "drive.stream_wait": False})
    rig.configure({"drive.stream_rate_hz": 4000})
    board = Board(RigConfig(), rig)
    with contextlib.closing(board), board.changed:
        task = add_output(board, 10_000, 100)
        board.write(task, WAVE[:100], 1.0, lambda: True, auto_start=True)
        assert rig.stream_level().buffered == 100


@pytest.mark.parametrize("buffer", [None, 100])
def test_a_repeated_buffer_is_overwritten_from_its_beginning(buffer: int | None) -> None:
    """A buffer written again after its end begins with its first sample; a full one with its oldest."""
    board = Board(from_flat(RigConfig(), IDEAL))
    with contextlib.closing(board), board.changed:
        task = add_output(board, RATE_HZ, 400)
        if buffer is not None:
            board.configure_buffer(task, buffer)
        for values in (WAVE[:120], WAVE[:150]):
            board.write(task, values, 1.0, lambda: True, auto_start=True)
            board.write(task, np.ones(10), 1.0, lambda: True, auto_start=False)
            assert np.flatnonzero(task.data == 1.0).tolist() == list(range(10))
            board.wait_until_done(task, 10.0, lambda: True)


def _no_progress(*_: object) -> None:
    raise SimulationError("the motion makes no progress")


def test_an_error_of_the_rig_ends_a_read_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its thread must not end by it: each later read would wait for its full timeout, and would not say why."""
    rig = LocalRig({**IDEAL, "drive.waveform": "stream", "drive.stream_wait": False})
    board = Board(RigConfig(), rig)
    with contextlib.closing(board), board.changed:
        task = board.create("input")
        board.add_channels(task, "ai", "Dev1/ai1", "", (-10.0, 10.0), 1.0, "Volts")
        board.configure_clock(task, rig.rate_hz, 10 * rig.rate_hz, finite=True)
        monkeypatch.setattr(rig, "step", _no_progress)
        for _ in range(2):
            with pytest.raises(DaqmxError, match="the motion makes no progress"):
                board.read(task, rig.rate_hz, rig.rate_hz, 30.0, lambda: True)


def test_the_start_after_an_error_of_the_rig_makes_a_new_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """A rig that failed within a block cannot go on: its drive and its scans would no longer belong together."""
    board = Board(from_flat(RigConfig(), IDEAL))
    with contextlib.closing(board), board.changed:
        task = board.create("input")
        board.add_channels(task, "ai", "Dev1/ai1", "", (-10.0, 10.0), 1.0, "Volts")
        board.configure_clock(task, RATE_HZ, RATE_HZ, finite=True)
        with monkeypatch.context() as broken:
            broken.setattr(LocalRig, "step", _no_progress)
            with pytest.raises(DaqmxError, match="the motion makes no progress"):
                board.read(task, RATE_HZ, RATE_HZ, 30.0, lambda: True)
        board.stop(task)
        assert board.read(task, RATE_HZ, RATE_HZ, 30.0, lambda: True).shape == (1, RATE_HZ)


@pytest.mark.ros
def test_a_running_rig_that_ends_is_reported_to_its_tasks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.client import Client, Processes, isolated_domain
    from impact_rig.driver import RosRig

    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as processes:
        values = {"time.mode": "realtime", "drive.waveform": "stream", "drive.stream_wait": False}
        processes.start("rig", {**IDEAL, **values})
        with Client(domain_id, "/rig", processes, "operator") as operator:
            operator.wait_active("rig")
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        rig = RosRig(namespace="/rig")
        board = Board(RigConfig(), rig)
        with contextlib.closing(board), board.changed:
            tasks = [board.create("input"), add_output(board, rig.rate_hz, 100)]
            board.add_channels(tasks[0], "ai", "Dev1/ai1", "", (-10.0, 10.0), 1.0, "Volts")
            board.configure_clock(tasks[0], rig.rate_hz, 100 * rig.rate_hz, finite=True)
            assert board.read(tasks[0], 100, 100, 30.0, lambda: True).shape == (1, 100)
            processes.stop("rig")
            for _ in range(2):
                with pytest.raises(DaqmxError, match="the running rig has ended or was restarted"):
                    board.read(tasks[0], 50 * rig.rate_hz, 50 * rig.rate_hz, 60.0, lambda: True)


def test_an_error_of_the_rig_ends_waiting_tasks_and_leaves_what_was_read_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    board = Board(from_flat(RigConfig(), IDEAL))
    with contextlib.closing(board), board.changed:
        done, armed = board.create("done"), board.create("armed")
        for one in (done, armed):
            board.add_channels(one, "ai", "Dev1/ai1", "", (-10.0, 10.0), 1.0, "Volts")
            board.configure_clock(one, RATE_HZ, 100, finite=True)
        board.start(done)
        board.wait_until_done(done, 30.0, lambda: True)
        board.configure_trigger(armed, "/Dev1/ao/StartTrigger")
        board.start(armed)
        with monkeypatch.context() as broken:
            broken.setattr(LocalRig, "step", _no_progress)
            with pytest.raises(DaqmxError, match="the motion makes no progress"):
                board.wait_until_done(armed, 30.0, lambda: True)
        with pytest.raises(DaqmxError, match="the motion makes no progress"):
            board.read(armed, 100, 100, 1.0, lambda: True)
        assert board.read(done, 100, 100, 1.0, lambda: True).shape == (1, 100)
