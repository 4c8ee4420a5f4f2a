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
"""The hardware in Rattlesnake's own processes: output, acquisition and streaming to netCDF4.

RATTLESNAKE names the folder of a clone of github.com/sandialabs/rattlesnake-vibration-controller.
"""

import multiprocessing
import os
import pathlib
import subprocess
import sys

import numpy as np
import pytest

FOLDER = os.environ.get("RATTLESNAKE", "")
if not pathlib.Path(FOLDER, "components").is_dir():
    pytest.skip("RATTLESNAKE names no clone of Rattlesnake", allow_module_level=True)
sys.path.insert(0, FOLDER)
os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")

import netCDF4
from components.acquisition import acquisition_process
from components.output import output_process
from components.streaming import streaming_process
from components.utilities import (
    Channel,
    DataAcquisitionParameters,
    GlobalCommands,
    QueueContainer,
    VerboseMessageQueue,
)
from rattlesnake_hardware import replace_state_space
from rattlesnake_law import control_law

from impact_rig.client.processes import Processes, isolated_domain
from impact_rig.recording import open_run

NAME, AMPLITUDE_A, SECONDS = "Random", 0.2, 6
UNITS = {"laser": "m", "base": "m", "current": "A"}
CHANNELS = tuple(UNITS)
STATE_SPACE = 5


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


def received(data_in):
    """Return what the acquisition sends to its environment, up to the last."""
    found, is_last = [], False
    while not is_last:
        data, is_last = data_in.get(timeout=30.0)
        found.append(data)
    return found


@pytest.mark.parametrize("rate_hz", [2_000, 10_000])
def test_its_processes_drive_the_rig_and_stream_what_they_read(rate_hz, tmp_path, monkeypatch):
    replace_state_space()
    make = multiprocessing.get_context("fork")
    log, sync, single, gui = (make.Queue() for _ in range(4))
    commands = {name: VerboseMessageQueue(log, name) for name in ("controller", "acquisition", "output", "streaming")}
    data_in, data_out = make.Queue(), make.Queue()
    queues = QueueContainer(
        commands["controller"], commands["acquisition"], commands["output"], commands["streaming"], log, sync, single,
        gui, {NAME: VerboseMessageQueue(log, NAME)}, {NAME: data_in}, {NAME: data_out},
    )  # fmt: skip
    channels = [channel(name) for name in CHANNELS]
    block = rate_hz // 4
    parameters = DataAcquisitionParameters(
        channels, rate_hz, block, block, STATE_SPACE, "/rig", [NAME], np.ones((len(CHANNELS), 1), bool), 1, 1
    )
    settings = {
        "sphere.present": False, "daq.rate_hz": rate_hz, "daq.block_scans": rate_hz // 50,
        "drive.waveform": "stream", "drive.stream_rate_hz": rate_hz,
    }  # fmt: skip
    environments = [(None, NAME)]
    with isolated_domain() as domain_id, Processes(domain_id, tmp_path / "logs", "/rig") as nodes:
        nodes.start("rig", settings)
        monkeypatch.setenv("ROS_DOMAIN_ID", str(domain_id))
        started = [
            make.Process(target=read_log, args=(log,), daemon=True),
            make.Process(target=acquisition_process, args=(queues, environments, make.Value("i", 0)), daemon=True),
            make.Process(target=output_process, args=(queues, environments, make.Value("i", 0)), daemon=True),
            make.Process(target=streaming_process, args=(queues,), daemon=True),
        ]
        for process in started:
            process.start()
        indices = {NAME: np.arange(len(CHANNELS))}
        for name in ("acquisition", "output"):
            commands[name].put("test", (GlobalCommands.INITIALIZE_DATA_ACQUISITION, (parameters, indices)))
        commands["streaming"].put(
            "test", (GlobalCommands.INITIALIZE_STREAMING, (str(tmp_path / "run.nc4"), parameters, {}))
        )
        commands["acquisition"].put("test", (GlobalCommands.START_STREAMING, None))
        while not commands["acquisition"].empty():
            assert started[1].is_alive(), "initialised before the output starts"
        for name in ("output", "acquisition"):
            commands[name].put("test", (GlobalCommands.RUN_HARDWARE, None))
        commands["output"].put("test", (GlobalCommands.START_ENVIRONMENT, NAME))
        drive = AMPLITUDE_A * np.random.default_rng(1).standard_normal((1, SECONDS * rate_hz))
        parts = np.split(drive, SECONDS * 4, axis=1)
        for part in parts:
            data_out.put((part, part is parts[-1]))
        found = received(data_in)
        for name in ("output", "acquisition"):
            commands[name].put("test", (GlobalCommands.STOP_HARDWARE, None))
        for name in ("output", "acquisition", "streaming"):
            commands[name].put("test", (GlobalCommands.QUIT, None))
        log.put(None)
        for process in started:
            process.join(30.0)
            assert process.exitcode == 0
    read = np.concatenate(found, axis=1)[CHANNELS.index("current")]
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


def test_the_law_reaches_a_density_of_the_base():
    """All lines of a linear rig's response are within 3 dB after three corrections."""
    transfer = np.random.default_rng(2).standard_normal((400, 1, 1)) * (1.0 + 1.0j)
    wanted = np.full((400, 1, 1), 1e-6, complex)
    estimate, output, response = 2.0 * transfer, None, None
    for _ in range(4):
        output = control_law(wanted, None, None, estimate, None, response, output)
        response = transfer @ output @ transfer.conj().transpose(0, 2, 1)
    assert np.abs(10.0 * np.log10(np.abs(response / wanted))).max() < 3.0
