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
"""Speed of the instruments at 50 kS/s with all channels, and the time of each stage.

The default rig runs at 9.1 Hz with impacts, in one thread. Times are CPU times, so that other work on the machine does
not count. Sampling the motion is part of the instruments; advancing the mechanics is not, and is listed separately.
Calls of one second measure the speed of an offline run, calls of one tick that of a live rig.
"""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable

import numpy as np

from benchmarks.scipy_chain import SciPyChain
from impact_rig.arithmetic.random import Random
from impact_rig.instruments import Chain, chain
from impact_rig.physics import FunctionGenerator, Motion, Simulation
from impact_rig.rig.config import RigConfig, from_flat

RATE_HZ = 50_000
BLOCK_SCANS = 500
SETTLE_S = 3
STAGES = (
    ("sample the motion", Motion, "polynomials"),
    ("cut it into pieces", chain, "cut"),
    ("dynamics, output stages", chain, "respond"),
    ("converter", chain, "digitise"),
    ("rows of scans", chain, "take_rows"),
    ("blocks", Chain, "read"),
)


class Bench:
    """A rig's mechanics and instruments, advanced second by second."""

    def __init__(self) -> None:
        config = from_flat(RigConfig(), {"daq.rate_hz": RATE_HZ})
        self.chain = Chain(config)
        self._generator = FunctionGenerator(config.drive, config.shaker, Random(1))
        self._generator.set_amplitude(0.52)
        self._simulation = Simulation(config)
        self._ticks = 0

    def second(self, ticks_per_call: int = 100) -> tuple[float, float, int]:
        """Return seconds spent on the instruments and on the mechanics for one second of rig time, and its impacts."""
        instruments = mechanics = 0.0
        impacts = 0
        for _ in range(0, 100, ticks_per_call):
            began = time.thread_time()
            motion = self._simulation.advance(self._generator.segments(ticks_per_call))
            advanced = time.thread_time()
            self.chain.acquire(motion, self._ticks, ticks_per_call)
            while self.chain.ready >= BLOCK_SCANS:
                self.chain.read(BLOCK_SCANS)
            instruments += time.thread_time() - advanced
            mechanics += advanced - began
            self._ticks += ticks_per_call
            impacts += len(motion.impacts)
        return instruments, mechanics, impacts


def run(seconds: int = 40) -> dict[str, float]:
    """Measure everything over some seconds of rig time each; the median second counts."""
    bench = Bench()
    for _ in range(SETTLE_S):
        bench.second()
    peer = SciPyChain()
    whole, ticks, peers, peers_ticks = [], [], [], []
    for _ in range(seconds):  # alternating, so that other loads on the machine affect all of them
        whole.append(bench.second())
        peers.append(peer.second())
        ticks.append(bench.second(1))
        peers_ticks.append(peer.second(100))
    instruments, mechanics = (float(np.median([second[part] for second in whole])) for part in (0, 1))
    live = float(np.median([second[0] for second in ticks]))
    shares, total = stages(bench, seconds)
    _print(shares, total, instruments, mechanics, live, float(np.mean([second[2] for second in whole])))
    return {
        "instruments_x_realtime_50kSps": 1.0 / instruments,
        "instruments_with_mechanics_x_realtime_50kSps": 1.0 / (instruments + mechanics),
        "instruments_10ms_calls_x_realtime_50kSps": 1.0 / live,
        "scipy_chain_x_realtime_50kSps": 1.0 / float(np.median(peers)),
        "instruments_over_scipy_chain": float(np.median(peers)) / instruments,
        "instruments_10ms_calls_over_scipy_chain": float(np.median(peers)) / live,
        "scipy_chain_10ms_calls_x_realtime_50kSps": 1.0 / float(np.median(peers_ticks)),
    }


def stages(bench: Bench, seconds: int) -> tuple[dict[str, float], float]:
    """Return the time of each stage per second of rig time, and the total time including the gaps between them [s]."""
    spent: dict[str, float] = defaultdict(float)
    whole = 0.0
    originals = [getattr(owner, name) for _, owner, name in STAGES]
    try:
        for (label, owner, name), original in zip(STAGES, originals, strict=True):
            setattr(owner, name, _timed(original, label, spent))
        for _ in range(seconds):
            whole += bench.second()[0]
    finally:
        for (_, owner, name), original in zip(STAGES, originals, strict=True):
            setattr(owner, name, original)
    return {label: spent[label] / seconds for label, _, _ in STAGES}, whole / seconds


def _timed(function: Callable[..., object], label: str, spent: dict[str, float]) -> Callable[..., object]:
    def call(*args: object, **kwargs: object) -> object:
        began = time.thread_time()
        try:
            return function(*args, **kwargs)
        finally:
            spent[label] += time.thread_time() - began

    return call


def _print(
    shares: dict[str, float], total: float, instruments: float, mechanics: float, live: float, impacts: float
) -> None:
    from rich.console import Console  # noqa: PLC0415 - only where a table is printed
    from rich.table import Table  # noqa: PLC0415

    table = Table(title=f"Instruments, 4 channels at {RATE_HZ // 1000} kS/s, {impacts:.0f} impacts per second")
    table.add_column("stage")
    table.add_column("ms per second", justify="right")
    table.add_column("share", justify="right")
    rows = {**shares, "between them": total - sum(shares.values())}
    for stage, share in rows.items():
        table.add_row(stage, f"{share * 1e3:.2f}", f"{share / total:.0%}")
    table.add_section()
    table.add_row("instruments", f"{instruments * 1e3:.2f}", f"{1 / instruments:.0f} x real time")
    table.add_row("mechanics beside them", f"{mechanics * 1e3:.2f}", f"{1 / mechanics:.0f} x real time")
    table.add_row("instruments, 10 ms per call", f"{live * 1e3:.2f}", f"{1 / live:.0f} x real time")
    Console().print(table)
