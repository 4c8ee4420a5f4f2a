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
"""Virtual test rig of an impact damper, for ROS 2 and Python.

A shaker moves a base. An elastic structure on that base carries a loose steel
sphere between two barriers, and the impacts of the sphere damp the vibration.
You command the shaker, read simulated instruments, and measure the displacement
transmissibility DT: the amplitude of the structure divided by that of its base.

    >>> import impact_rig
    >>> rig = impact_rig.LocalRig({"barriers.gap_m": 0.006}, analysis={"gap_m": 0.006})
    >>> first_scan = rig.command(frequency_hz=9.1, current_a=0.52)
    >>> rig.run(seconds=20)
    >>> print(f"DT {rig.rows('transmissibility/table')['transmissibility'][-1]:.2f}")
    DT 63.57

`print(impact_rig.simulate(20.0))` does the same in one line.

Simulate and drive a rig:

    simulate          simulate a run in one call, and measure DT
    Record            readings and results of such a run
    LocalRig          rig in this process, step by step
    RosRig            rig over ROS topics, with the calls of `LocalRig`
    Rig               rig without analysis and recording, at a lower level
    Fault             fault of an instrument

Configure a rig:

    load_config       read a configuration from a YAML file
    RigConfig         configuration of a rig

Measure the transmissibility:

    Tracker           measurement of DT from a stream of scans
    TrackerSettings   settings of that measurement
    transmissibility  transmissibility without the sphere, in closed form

Read recordings:

    open_run          open a recorded run
    Run               recorded run: its messages, tables and metadata
    info              summarise a run, and check its integrity
    verify            simulate a run again, and compare it bit for bit
    export            write a topic to CSV, NPZ, Parquet or UFF

Exchange tables and talk to nodes:

    Table             rows of a topic, with a time stamp
    encode, decode    convert a table to a ROS message, and back
    Client            ROS node that acts as the user of a rig

Errors:

    ImpactRigError    base class of the others
    ConfigError       invalid configuration value, key or file
    CommandError      rejected command
    CodecError        malformed message
    RecordingError    run that cannot be written or read
    GoneError         process that has ended
    SimulationError   simulation that cannot continue

Each name is loaded at its first use, so `import impact_rig` loads neither rclpy
nor numpy. `help(impact_rig.simulate)` describes a name. docs/reference/api.md
shows all of them, and docs/index.md leads to tutorials, how-to guides and the
physics. In a shell, `impact-rig --help` lists the commands.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.analysis.settings import TrackerSettings
    from impact_rig.analysis.tracker import Tracker
    from impact_rig.blocks import Table
    from impact_rig.client import Client
    from impact_rig.codec import decode, encode
    from impact_rig.driver import LocalRig, RosRig
    from impact_rig.errors import (
        CodecError,
        CommandError,
        ConfigError,
        GoneError,
        ImpactRigError,
        RecordingError,
        SimulationError,
    )
    from impact_rig.instruments.fault import Fault
    from impact_rig.physics.linear_response import transmissibility
    from impact_rig.recording.reader import Run, open_run
    from impact_rig.rig.config import RigConfig, load_config
    from impact_rig.rig.core import Rig
    from impact_rig.runs.exports import export
    from impact_rig.runs.info import info
    from impact_rig.runs.verification import verify
    from impact_rig.simulation import Record, simulate

_HOMES = {
    "simulation": ("Record", "simulate"),
    "rig.config": ("RigConfig", "load_config"),
    "rig.core": ("Rig",),
    "driver": ("LocalRig", "RosRig"),
    "client": ("Client",),
    "instruments.fault": ("Fault",),
    "analysis.tracker": ("Tracker",),
    "analysis.settings": ("TrackerSettings",),
    "physics.linear_response": ("transmissibility",),
    "recording.reader": ("Run", "open_run"),
    "runs.info": ("info",),
    "runs.verification": ("verify",),
    "runs.exports": ("export",),
    "blocks": ("Table",),
    "codec": ("decode", "encode"),
    "errors": (
        "CodecError", "CommandError", "ConfigError", "GoneError", "ImpactRigError", "RecordingError", "SimulationError",
    ),
}  # fmt: skip

__all__ = [
    "Client", "CodecError", "CommandError", "ConfigError", "Fault", "GoneError", "ImpactRigError", "LocalRig", "Record",
    "RecordingError", "Rig", "RigConfig", "RosRig", "Run", "SimulationError", "Table", "Tracker", "TrackerSettings",
    "decode", "encode", "export", "info", "load_config", "open_run", "simulate", "transmissibility", "verify",
]  # fmt: skip
__version__ = "0.1.0"

__getattr__ = lazily(__name__, **{name: f"impact_rig.{home}" for home, names in _HOMES.items() for name in names})
