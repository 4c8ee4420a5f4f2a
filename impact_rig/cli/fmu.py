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
"""Command `impact-rig fmu`: the rig as a co-simulation unit (FMU) of the Functional Mock-up Interface."""

from __future__ import annotations

import argparse

from impact_rig.cli.terminal import Console
from impact_rig.embedded.fmu import write_fmu
from impact_rig.kernels.build import FOLDER
from impact_rig.rig.config import RigConfig, load_config


def run_fmu(arguments: argparse.Namespace) -> int:
    """Run `impact-rig fmu`: write the configured rig as an FMU file, print the file's path and return exit code 0."""
    config = load_config(arguments.config) if arguments.config else RigConfig()
    write_fmu(config, arguments.path, arguments.fmi, arguments.kernels or FOLDER)
    Console().print(f"wrote the rig as a co-simulation unit for FMI {arguments.fmi}: {arguments.path}")
    return 0
