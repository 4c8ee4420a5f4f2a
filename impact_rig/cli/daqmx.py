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
"""Command `impact-rig daqmx`: server that offers the rig as a DAQ board to scripts with NI's `nidaqmx` package."""

from __future__ import annotations

import argparse
import contextlib
import os

from impact_rig import driver
from impact_rig.cli.terminal import Console
from impact_rig.errors import ImpactRigError
from impact_rig.rig.config import RigConfig, load_config


def run_daqmx(arguments: argparse.Namespace) -> int:
    """Run `impact-rig daqmx`: serve the rig to scripts until a signal ends the program, with exit code 0.

    Raises:
        ImpactRigError: an option is invalid or contradicts another option. The running rig is missing or has unsuitable
            settings. The server cannot listen on the address.
    """
    from impact_rig.driver import daqmx_board, daqmx_server  # noqa: PLC0415  # load compiled code

    if not 0 <= arguments.port <= 65535:
        raise ImpactRigError(f"--port must be from 0 to 65535, got {arguments.port}")
    if arguments.config and arguments.namespace:
        raise ImpactRigError("--config describes a rig to simulate: use it without --namespace")
    config = load_config(arguments.config) if arguments.config else RigConfig()
    rig = None
    if arguments.namespace:
        os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        rig = driver.RosRig({"drive.waveform": "stream", "time.mode": "realtime"}, namespace=arguments.namespace)
    board = daqmx_board.Board(config, rig, tuple(arguments.device))
    address = f"{arguments.host}:{arguments.port}"
    with contextlib.closing(board), daqmx_server.serving(board, address) as (server, port):
        Console().print(f"nidaqmx server: {arguments.host}:{port}; Ctrl-C ends it", soft_wrap=True)
        server.wait_for_termination()
    return 0
