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
"""Print digests of short, eventful runs of the instruments, and of a few cycles: compiled, or as plain Python."""

from __future__ import annotations

import hashlib

import numpy as np
from kits.instruments import IMPACT, AnalyticMotion, configured
from kits.mechanics import rig, sine

from impact_rig.arithmetic.random import Random
from impact_rig.config import Drive, Shaker
from impact_rig.instruments import Chain, Fault
from impact_rig.physics import Simulation
from impact_rig.physics.function_generator import FunctionGenerator

TICKS = 4


def cubic(scale: float):
    """A motion of whole operations only: the digest must not depend on the test's own sine."""
    return lambda t: scale * ((t - 0.011) * (t - 0.023)) * (t - 0.037)


def scans(*, ideal: bool = False, rate_hz: int = 10_000) -> np.ndarray:
    blow = np.array([(1, 0.0043, 1, 0.01, 0.0), (2, 0.0061, -1, 0.02, 0.0)], IMPACT)
    motion = AnalyticMotion(
        breakpoints=(0.0143, 0.02502, 0.02505, 0.0261),
        impacts=blow,
        a_1=cubic(1e5),
        x_1=cubic(10.0),
        x_b=cubic(3.0),
        current=cubic(1e4),
    )
    chain = Chain(configured(rate_hz, ideal=ideal, adc__anti_alias="butterworth"))
    for number, kind in enumerate(("added_noise", "spike_train")):
        chain.inject(
            Fault(kind=kind, channel="laser", start_sample=20 + 50 * number, samples=40, value=1e-4, rate_hz=3e3)
        )
    chain.calibrate("base", 30.0, 1e-3, 2)
    chain.acquire(motion, 0, TICKS)
    return chain.read(chain.ready)


def drive() -> np.ndarray:
    noisy = Drive(waveform="random", amplitude=0.5)
    return FunctionGenerator(noisy, Shaker(), Random(1)).segments(300)


def cycles(**changes: dict) -> np.ndarray:
    """Three cycles, the first of which ramps."""
    with np.errstate(all="ignore"):  # plain Python warns of each infinity
        simulation, segments = Simulation(rig(**changes)), sine(9.1, 0.3, 1.0 / 9.1, 3)
        segments["growth"][0] = 0.1 * 9.1
        simulation.place(x_1=-1e-3, d_rate=0.1)
        return simulation.advance(segments).cycles()


def digests() -> list[str]:
    held = {"sphere": {"guide_friction": 0.3}, "contact": {"law": "restitution"}}
    made = [scans(), scans(rate_hz=1_000), scans(ideal=True), drive(), cycles(), cycles(**held)]
    made += [cycles(drive={"kind": "prescribed"}, sphere={"present": False})]
    return [hashlib.sha256(rows.tobytes()).hexdigest() for rows in made]


if __name__ == "__main__":
    print("\n".join(digests()))  # noqa: T201
