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
"""The hardware in Rattlesnake's own processes: output, acquisition, streaming to netCDF4, and closed-loop control.

RATTLESNAKE names the folder of a clone of github.com/sandialabs/rattlesnake-vibration-controller.
"""

import contextlib
import multiprocessing
import os
import pathlib
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

FOLDER = os.environ.get("RATTLESNAKE", "")
if not pathlib.Path(FOLDER, "components").is_dir():
    pytest.skip("RATTLESNAKE names no clone of Rattlesnake", allow_module_level=True)
sys.path.insert(0, FOLDER)
os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import netCDF4
import rattlesnake_law
from components.abstract_sysid_environment import SystemIdCommands
from components.acquisition import acquisition_process
from components.output import output_process
from components.random_vibration_sys_id_environment import (
    RandomVibrationCommands,
    RandomVibrationMetadata,
    random_vibration_process,
)
from components.streaming import streaming_process
from components.utilities import Channel, DataAcquisitionParameters, GlobalCommands, QueueContainer, VerboseMessageQueue
from rattlesnake_hardware import replace_state_space

from impact_rig.client.processes import Processes, isolated_domain
from impact_rig.recording import open_run
from impact_rig_studies.excitation.random import RandomPlan

NAME, AMPLITUDE_A, SECONDS = "Random", 0.2, 6
UNITS = {"laser": "m", "base": "m", "current": "A"}
CHANNELS = tuple(UNITS)
BASE, CURRENT = CHANNELS.index("base"), CHANNELS.index("current")
STATE_SPACE = 5
END_S = 30.0
FRAMES, LEAST_WITHIN, TOLERANCE_DB = 40, 0.99, 3.0
LAWS = {
    "of the example": (rattlesnake_law.__file__, "control_law"),
    "of Rattlesnake": (str(pathlib.Path(FOLDER, "control_laws", "control_laws.py")), "match_trace_pseudoinverse"),
}


def channel(name):
    fields = dict.fromkeys((
        "node_number", "node_direction", "comment", "serial_number", "triax_dof", "sensitivity", "unit", "make",
        "model", "expiration", "physical_device", "physical_channel", "channel_type", "minimum_value", "maximum_value",
        "coupling", "excitation_source", "excitation", "feedback_device", "feedback_channel", "warning_level",
        "abort_level",
    ), "")  # fmt: skip
    drives = {"feedback_device": "rig", "feedback_channel": "0"} if name == "current" else {}
    return Channel(**{**fields, "physical_channel": name, "comment": name, "unit": UNITS[name], **drives})


def read_log(log):
    while log.get() is not None:
        pass


def forward(queues):
    """Do with an environment's instructions what Rattlesnake's window does, until it is to quit."""
    message = None
    while message is not GlobalCommands.QUIT:
        message, data = queues.controller_communication_queue.get("test")
        if message in {GlobalCommands.RUN_HARDWARE, GlobalCommands.STOP_HARDWARE}:
            queues.acquisition_command_queue.put("test", (message, data))
        if message in {GlobalCommands.RUN_HARDWARE, GlobalCommands.STOP_HARDWARE, GlobalCommands.START_ENVIRONMENT}:
            queues.output_command_queue.put("test", (message, data))


@contextlib.contextmanager
def rattlesnake(rate_hz, folder, monkeypatch, *environment):
    """Start a rig in real time and Rattlesnake's processes; yield its queues and its parameters.

    Args:
        environment: function of the environment's process; none if the test itself is the environment.
    """
    replace_state_space()
    make = multiprocessing.get_context("fork")
    log, sync, single, gui = (make.Queue() for _ in range(4))
    commands = {name: VerboseMessageQueue(log, name) for name in ("controller", "acquisition", "output", "streaming")}
    command, data_in, data_out = VerboseMessageQueue(log, NAME), make.Queue(), make.Queue()
    queues = QueueContainer(
        commands["controller"], commands["acquisition"], commands["output"], commands["streaming"], log, sync, single,
        gui, {NAME: command}, {NAME: data_in}, {NAME: data_out},
    )  # fmt: skip
    block = rate_hz // 4
    parameters = DataAcquisitionParameters(
        [channel(name) for name in CHANNELS], rate_hz, block, block, STATE_SPACE, "/rig", [NAME],
        np.ones((len(CHANNELS), 1), bool), 1, 1,
    )  # fmt: skip
    settings = {
        "sphere.present": False, "daq.rate_hz": rate_hz, "daq.block_scans": rate_hz // 50,
        "drive.waveform": "stream", "drive.stream_rate_hz": rate_hz,
    }  # fmt: skip
    active = make.Value("i", 0), make.Value("i", 0)
    with isolated_domain() as domain_id, Processes(domain_id, folder / "logs", "/rig") as nodes:
        nodes.start("rig", settings)
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        started = [
            make.Process(name="log", target=read_log, args=(log,)),
            make.Process(name="streaming", target=streaming_process, args=(queues,)),
            make.Process(name="acquisition", target=acquisition_process, args=(queues, [(None, NAME)], active[0])),
            make.Process(name="output", target=output_process, args=(queues, [(None, NAME)], active[1])),
            *(
                make.Process(
                    target=one, args=(NAME, command, gui, commands["controller"], log, data_in, data_out, *active)
                )
                for one in environment
            ),
        ]
        for process in started:
            process.start()
        try:
            indices = {NAME: np.arange(len(CHANNELS))}
            for name in ("acquisition", "output"):
                commands[name].put("test", (GlobalCommands.INITIALIZE_DATA_ACQUISITION, (parameters, indices)))
            while not commands["acquisition"].empty():
                assert started[2].is_alive(), "initialised before the output starts"
            yield queues, parameters
            deadline = time.monotonic() + END_S
            while any(flag.value for flag in active):
                assert time.monotonic() < deadline, "the hardware does not stop"
                time.sleep(0.1)  # its flags give no notice; its environments poll them, too
            for process in started[1:]:
                assert process.is_alive(), process.name
        finally:
            for queue in (command, *commands.values()):
                if queue is not commands["streaming"]:
                    queue.put("test", (GlobalCommands.QUIT, None))
            for process in started[:0:-1]:  # the streaming process last: the others end when it has read what they sent
                if process.name == "streaming":
                    commands["streaming"].put("test", (GlobalCommands.QUIT, None))
                process.join(END_S)
                process.kill()
            log.put(None)
    codes = {process.name: process.exitcode for process in started[1:]}
    assert set(codes.values()) == {0}, codes


def received(data_in):
    """Return what the acquisition sends to its environment, up to the last."""
    found, is_last = [], False
    while not is_last:
        data, is_last = data_in.get(timeout=30.0)
        found.append(data)
    return found


@pytest.mark.parametrize("rate_hz", [2_000, 10_000])
def test_the_processes_of_rattlesnake_drive_the_rig_and_stream_their_readings(rate_hz, tmp_path, monkeypatch):
    with rattlesnake(rate_hz, tmp_path, monkeypatch) as (queues, parameters):
        put = queues.streaming_command_queue.put
        put("test", (GlobalCommands.INITIALIZE_STREAMING, (str(tmp_path / "run.nc4"), parameters, {})))
        queues.acquisition_command_queue.put("test", (GlobalCommands.START_STREAMING, None))
        hardware = queues.output_command_queue, queues.acquisition_command_queue
        for commands in hardware:
            commands.put("test", (GlobalCommands.RUN_HARDWARE, None))
        queues.output_command_queue.put("test", (GlobalCommands.START_ENVIRONMENT, NAME))
        drive = AMPLITUDE_A * np.random.default_rng(1).standard_normal((1, SECONDS * rate_hz))
        parts = np.split(drive, SECONDS * 4, axis=1)
        for part in parts:
            queues.environment_data_out_queues[NAME].put((part, part is parts[-1]))
        found = received(queues.environment_data_in_queues[NAME])
        for commands in hardware:
            commands.put("test", (GlobalCommands.STOP_HARDWARE, None))
    read = np.concatenate(found, axis=1)[CURRENT]
    at = np.correlate(read, drive[0, :rate_hz], "valid").argmax()
    assert np.corrcoef(read[at : at + rate_hz], drive[0, :rate_hz])[0, 1] > 0.9  # the monitor has a bandwidth
    with netCDF4.Dataset(tmp_path / "run.nc4") as stored:
        assert stored.variables["time_data"].shape[0] == len(CHANNELS)
        assert stored.variables["time_data"].shape[1] >= len(read)
        streamed = stored.variables["time_data"][:].data
    names = [f"{name}={name}" for name in CHANNELS]
    run = tmp_path / "run"
    command = [os.environ["IMPACT_RIG"], "import", str(tmp_path / "run.nc4"), "--output", str(run), "--gap", "none"]
    subprocess.run([*command, "--channel", *names], check=True)
    with open_run(run) as imported:
        rows = np.concatenate([table.rows for table in imported.tables("daq/scan")])
    for name, values in zip(CHANNELS, streamed, strict=True):
        np.testing.assert_array_equal(rows[name], values)


def random_vibration(rate_hz, spectrum, law):
    """Return the settings of a random vibration test of the base's displacement, for an acceleration spectrum."""
    lines = np.fft.rfftfreq(rate_hz, 1.0 / rate_hz)  # frames of 1 s
    wanted = np.zeros((len(lines), 1, 1), complex)
    wanted[1:, 0, 0] = spectrum.at(lines[1:]) / (2.0 * np.pi * lines[1:]) ** 4
    script, function = law
    no_limit = np.full((2, len(lines), 1), np.nan)
    settings = RandomVibrationMetadata(
        number_of_channels=len(CHANNELS), sample_rate=rate_hz, samples_per_frame=rate_hz, test_level_ramp_time=1.0,
        cola_window="Hann", cola_overlap=0.5, cola_window_exponent=0.5, update_tf_during_control=False,
        frames_in_cpsd=FRAMES, cpsd_window="Hann", cpsd_overlap=0.5, allow_automatic_aborts=False,
        control_python_script=script, control_python_function=function, control_python_function_type=0,
        control_python_function_parameters="", control_channel_indices=[BASE], output_channel_indices=[CURRENT],
        specification_frequency_lines=lines, specification_cpsd_matrix=wanted, specification_warning_matrix=no_limit,
        specification_abort_matrix=no_limit, response_transformation_matrix=None, output_transformation_matrix=None,
    )  # fmt: skip
    identification = {
        "frame_size": rate_hz, "averaging_type": "Linear", "noise_averages": 5, "averages": 20,
        "exponential_averaging_coefficient": 0.01, "estimator": "H1", "level": 1.0, "level_ramp_time": 1.0,
        "signal_type": "Random", "window": "Hann", "overlap": 0.5, "burst_on": 0.5, "pretrigger": 0.05,
        "burst_ramp_fraction": 0.05,
    }  # fmt: skip
    for name, value in identification.items():
        setattr(settings, f"sysid_{name}", value)
    return settings


def wait_for(updates, name, count=1):
    """Return the count-th update of a name that Rattlesnake's window would show."""
    while count:
        source, found = updates.get(timeout=60.0)
        assert source != "error", found
        count -= source == NAME and found[0] == name
    return found[1]


@pytest.mark.parametrize("rate_hz", [2_000, 10_000])
@pytest.mark.parametrize("law", LAWS)
def test_the_random_vibration_environment_controls_the_acceleration_of_the_base(
    law, rate_hz, tmp_path, monkeypatch, capsys
):
    """A random vibration test of a shaker without the sphere: acceleration of the base, 5 to 200 Hz in lines of 1 Hz.

    3 dB are the usual tolerance of such a test, for the mean of 40 half-overlapping frames. The law has 40 frames to
    correct the drive; the next 40 count.
    """
    settings = random_vibration(rate_hz, RandomPlan().spectrum, LAWS[law])
    with rattlesnake(rate_hz, tmp_path, monkeypatch, random_vibration_process) as (queues, parameters):
        command, updates = queues.environment_command_queues[NAME], queues.gui_update_queue
        forwarding = threading.Thread(target=forward, args=(queues,))
        forwarding.start()
        command.put("test", (GlobalCommands.INITIALIZE_DATA_ACQUISITION, parameters))
        command.put("test", (GlobalCommands.INITIALIZE_ENVIRONMENT_PARAMETERS, settings))
        command.put("test", (SystemIdCommands.START_SYSTEM_ID, (settings, None)))
        wait_for(updates, "enable_system_id")
        queues.controller_communication_queue.put("test", (GlobalCommands.RUN_HARDWARE, None))
        command.put("test", (RandomVibrationCommands.START_CONTROL, 1.0))
        wait_for(updates, "time_frame", 2 * FRAMES)
        frames, _, _, _, _, response, *_ = wait_for(updates, "control_update")
        command.put("test", (RandomVibrationCommands.STOP_CONTROL, None))
        queues.controller_communication_queue.put("test", (GlobalCommands.STOP_HARDWARE, None))
        wait_for(updates, "enable_control")
    forwarding.join()
    assert frames == FRAMES
    wanted = settings.specification_cpsd_matrix[:, 0, 0].real
    errors_db = np.abs(10.0 * np.log10(response[wanted > 0.0, 0, 0].real / wanted[wanted > 0.0]))
    within = np.mean(errors_db <= TOLERANCE_DB)
    with capsys.disabled():
        print(
            f"\nlaw {law} at {rate_hz} S/s: {100 * within:.2f} % of {len(errors_db)} lines within {TOLERANCE_DB:g} dB, "
            f"{100 * np.mean(errors_db <= 1.0):.1f} % within 1 dB, largest error {errors_db.max():.2f} dB"
        )
    assert within >= LEAST_WITHIN


def test_the_control_law_reaches_the_specified_density_of_the_base():
    """All lines of a linear rig's response are within 3 dB after three corrections."""
    transfer = np.random.default_rng(2).standard_normal((400, 1, 1)) * (1.0 + 1.0j)
    wanted = np.full((400, 1, 1), 1e-6, complex)
    estimate, output, response = 2.0 * transfer, None, None
    for _ in range(4):
        output = rattlesnake_law.control_law(wanted, None, None, estimate, None, response, output)
        response = transfer @ output @ transfer.conj().transpose(0, 2, 1)
    assert np.abs(10.0 * np.log10(np.abs(response / wanted))).max() < 3.0
