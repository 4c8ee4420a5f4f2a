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
"""`impact-rig fmu`: the rig as a co-simulation unit of the Functional Mock-up Interface."""

from __future__ import annotations

import argparse
from pathlib import Path

from impact_rig.cli.terminal import Commands, Console, subcommand
from impact_rig.embedded.fmu import VERSIONS, write_fmu
from impact_rig.kernels.build import FOLDER
from impact_rig.rig.config import RigConfig, load_config


def add_command(commands: Commands) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "fmu", _run, "write the rig as a co-simulation unit (FMI 3.0 or 2.0)",
        [
            ("fmu rig.fmu", "the paper's rig, for FMI 3.0"),
            ("fmu --config my_rig.yaml --fmi 2.0 my_rig.fmu", "another rig, for tools that know FMI 2.0"),
        ],
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="OUT.fmu", help="file to write")
    parser.add_argument("--config", type=Path, metavar="FILE", help="configuration (default: the paper's rig)")
    parser.add_argument("--fmi", choices=VERSIONS, default=VERSIONS[0], help="version of FMI (default: %(default)s)")
    parser.add_argument(
        "--kernels", type=Path, metavar="DIR", default=FOLDER,
        help="folder of compiled kernels, for another machine (default: those of this package)",
    )  # fmt: skip


def _run(arguments: argparse.Namespace) -> int:
    config = load_config(arguments.config) if arguments.config else RigConfig()
    write_fmu(config, arguments.path, arguments.fmi, arguments.kernels)
    Console().print(f"FMI {arguments.fmi} co-simulation unit: {arguments.path}")
    return 0
