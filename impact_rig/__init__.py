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

Build a rig, drive it, and print its displacement transmissibility DT:

    import impact_rig

    rig = impact_rig.LocalRig({"barriers.gap_m": 0.006}, analysis={"gap_m": 0.006})
    rig.command(frequency_hz=9.1, current_a=0.52)
    rig.run(seconds=20)
    print(rig.rows("transmissibility/table")["transmissibility"][-1])

`impact_rig.simulate(20.0)` does the same in one line. The public names are:

    simulate and drive   simulate, Record, LocalRig, RosRig, Client, Rig, Fault
    configure            RigConfig, load_config
    measure              Tracker, TrackerSettings, transmissibility
    read recordings      open_run, Run, info, verify, export
    exchange tables      Table, encode, decode
    errors               ImpactRigError, ConfigError, CommandError, CodecError,
                         RecordingError, SimulationError, GoneError

Each name is loaded when it is first used, so that importing this package
loads neither rclpy nor numpy. `help(impact_rig.simulate)` describes a name,
and the page "Python API" of the documentation shows all of them.
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
