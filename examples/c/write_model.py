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
"""Write what ten_seconds.c reads: a rig, its state at rest, ten seconds of drive. `write_model.py FILE`."""

from __future__ import annotations

import sys
from pathlib import Path

from impact_rig.arithmetic.random import Random
from impact_rig.kernels import records
from impact_rig.physics import FunctionGenerator
from impact_rig.physics.model import build
from impact_rig.physics.state import STATE
from impact_rig.rig.config import RigConfig

config = RigConfig()
model, states = build(config), records(2, STATE)
states[0]["d"] = -config.barriers.gap_m / 2.0  # the sphere rests at the left wall
drive = FunctionGenerator(config.drive, config.shaker, Random(0))
drive.set_frequency(9.1)
drive.set_amplitude(0.52)
numbers = [model.parameters, model.systems, model.table, states, drive.segments(1000)]
Path(sys.argv[1]).write_bytes(b"".join(part.tobytes() for part in numbers))
