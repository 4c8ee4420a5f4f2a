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
"""Snapshot of a rig for rig.c: all numbers that rig.c needs, computed from the configuration, as bytes."""

from __future__ import annotations

import json
from typing import Any

import attrs
import numpy as np

from impact_rig import __version__, kernels
from impact_rig.config.fields import info
from impact_rig.config.sections import Barriers
from impact_rig.errors import ConfigError
from impact_rig.instruments.chain import _LONGEST_CONTACT_PIECE_S, Chain
from impact_rig.physics.model import build
from impact_rig.physics.sampling import places
from impact_rig.physics.simulation import _PLACES as STARTS
from impact_rig.rig.config import RigConfig
from impact_rig.rig.core import new_generator
from impact_rig.rig.interlock import amplitude_limit
from impact_rig.simtime import COMMAND_GRID_S

CHANNELS = 8
SETUP = np.dtype(
    [
        ("version", "S32"),
        *((name, "i8") for name in ("channels", "modes", "clock_period", "clock_tick", "most_per_tick", "ramp_ticks")),
        *(
            (name, "f8")
            for name in (
                "tick_s", "longest_s", "joined_s", "frequency_hz", "lowest_hz", "highest_hz", "highest_amplitude",
                "start", "mass_kg", "shortest_gap_m", "longest_gap_m",
            )
        ),
        ("quantity", "i8", (CHANNELS,)),
        ("name", "S32", (CHANNELS,)),
        ("at_point", "S160"),
        ("at_stages", "S160"),
    ]
)  # fmt: skip
"""Layout of the first part of a snapshot: the struct `setup` of rig.c."""


def snapshot(config: RigConfig) -> bytes:
    """Return the bytes from which rig.c starts a rig of this configuration, at rest.

    The bytes have the layout of the structs in rig.c, and are valid only for the same version of the package.

    Raises:
        ConfigError: rig.c does not support this rig (a chirp, a random drive, an initial amplitude, ideal instruments,
            planned faults, or a contact law of another package), or this process does not use the compiled kernels.
    """
    _check(config)
    model, chain, drive = build(config), Chain(config), new_generator(config)
    at_point, at_stages = (_name_of(pointer) for pointer in model.law)
    setup = np.zeros(1, SETUP)
    row = setup[0]
    gap = info(attrs.fields(Barriers).gap_m)
    row["version"], row["at_point"], row["at_stages"] = __version__, at_point, at_stages
    row["channels"], row["modes"] = len(chain._channels), len(chain._modes)
    row["clock_period"], row["clock_tick"] = chain._clock.lengths
    row["most_per_tick"], row["ramp_ticks"] = chain._most_per_tick, drive._ramp_ticks
    row["tick_s"] = COMMAND_GRID_S * (1.0 + 1e-6 * config.daq.clock_error_ppm)
    row["longest_s"], row["joined_s"] = chain._longest_piece_s, _LONGEST_CONTACT_PIECE_S
    row["frequency_hz"] = config.drive.frequency_hz
    row["lowest_hz"], row["highest_hz"] = config.shaker.frequency_min_hz, config.shaker.frequency_max_hz
    row["highest_amplitude"] = amplitude_limit(config.drive, config.shaker)[2]
    row["start"] = STARTS[config.sphere.start]
    row["mass_kg"] = config.structure.mass_kg
    row["shortest_gap_m"], row["longest_gap_m"] = gap.low, gap.high
    row["quantity"][: len(chain._quantities)] = places(chain._quantities)
    row["name"][: len(chain._names)] = chain._names
    parts: list[Any] = [setup, model.parameters, model.systems, model.table, chain._channels, chain._modes]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def _check(config: RigConfig) -> None:
    """Reject a configuration with features that rig.c does not support.

    Raises:
        ConfigError: the message names the configuration value and the allowed ones.
    """
    for found, key, allowed in (
        (config.drive.waveform, "drive.waveform", ("sine", "stream")),
        (config.drive.amplitude, "drive.amplitude", (0.0,)),
        (config.instruments.ideal, "instruments.ideal", (False,)),
        (list(config.instruments.faults.planned), "instruments.faults.planned", ([],)),
    ):
        if found not in allowed:
            names = " or ".join(map(json.dumps, allowed))
            raise ConfigError(f"{key} must be {names} for a rig without Python (FMU, browser), got {json.dumps(found)}")


def _name_of(pointer: Any) -> str:
    """Return the name under which the compiled kernels export a force function of a contact law.

    `pointer` holds the address of the function. Only the laws of this package are in the kernels.

    Raises:
        ConfigError: this process does not use the compiled kernels, or they do not contain the law.
    """
    if kernels.MODE != "library":
        raise ConfigError(
            f"a rig without Python needs the compiled kernels: {kernels.BUILD}, and unset {kernels.VARIABLE}"
        )
    for name in kernels.exported:
        if kernels.address(name) == pointer.address:
            return name
    raise ConfigError(
        "contact.law is not a law of this package: a rig without Python (FMU, browser) needs one, whose force the "
        "compiled kernels contain"
    )
