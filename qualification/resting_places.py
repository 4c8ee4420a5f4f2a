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
"""Spheres at rest that strike again: `python -m qualification.resting_places`, 544 places of a map, 16 to 40 mm.

Between walls that the structure does not reach, the sphere may be at rest, or drift to one of them for minutes. At each
place a map measures, and so does the tracker, which sees only instruments; the motion itself then continues for a
minute. A reading is wrong if it is called settled, has no impact, and is followed by an impact. The exit code is 1 if
there is such a reading.
"""

from __future__ import annotations

import argparse
import sys

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from impact_rig.analysis.settings import TrackerSettings
from impact_rig.analysis.tracker import Tracker
from impact_rig.blocks import APPLIED, Table
from impact_rig.instruments.chain import Chain
from impact_rig.physics import FunctionGenerator, Motion, Simulation
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig.states import Regime
from impact_rig_studies.campaign.paper import CURRENT_A
from impact_rig_studies.maps.measure import FAILED, MapRig, Settings

Array = NDArray[np.float64]
GAPS_MM = np.linspace(16.0, 40.0, 17)
FREQUENCIES_HZ = np.linspace(8.0, 11.1, 32)
TICKS_PER_S, RATE_HZ = 100, 10_000
WATCHED_S = 300.0
AFTER_S = 60.0
FAST = 0.01
"""Least approach speed of an impact that the accelerometer shows [m/s]."""


def configuration(gap_mm: float) -> RigConfig:
    """Return the default rig with a gap."""
    return from_flat(RigConfig(), {"barriers.gap_m": gap_mm * 1e-3, "daq.rate_hz": RATE_HZ})


def map_errs(config: RigConfig, frequency_hz: float) -> tuple[bool, bool]:
    """Return whether a map classifies the sphere as at rest here, and whether it strikes nevertheless."""
    rig = MapRig(config, Settings())
    found = rig.measure(frequency_hz, CURRENT_A)
    if found.regime in (Regime.INTERMITTENT, FAILED) or found.impacts_per_cycle > 0.0:
        return False, False
    after = rig._run(frequency_hz, CURRENT_A, round(AFTER_S * frequency_hz))  # the same motion continues
    return True, len(after.speed) > 0


def driven(config: RigConfig, frequency_hz: float, *spans_s: float) -> list[Motion]:
    """Return the motion from rest in consecutive spans."""
    drive = FunctionGenerator(config.drive, config.shaker, np.random.default_rng(1))
    drive.set_frequency(frequency_hz)
    drive.set_amplitude(CURRENT_A)
    simulation = Simulation(config)
    return [simulation.advance(drive.segments(round(span_s * TICKS_PER_S))) for span_s in spans_s]


def strikes(motions: list[Motion]) -> tuple[Array, Array]:
    """Return instants [s] and approach speeds [m/s] of the impacts."""
    impacts = np.concatenate([motion.impacts for motion in motions])
    return impacts["tick"] / TICKS_PER_S + impacts["offset"], impacts["approach_speed"]


def ends_of_rest(config: RigConfig, frequency_hz: float, motion: Motion, settings: TrackerSettings) -> list[float]:
    """Return the ends of the tracker's settled rows without impacts in a motion [s]."""
    chain, tracker = Chain(config), Tracker(settings)
    tracker.configure(Table(0, chain.info()))
    command = np.zeros(1, APPLIED)
    command["frequency"], command["current"] = frequency_hz, CURRENT_A
    tracker.on_applied(Table(0, command))
    tracker.label(config.barriers.gap_m, 0)
    chain.acquire(motion, motion.first_tick, len(motion.segments))
    return [
        table.stamp_ns / NS_PER_S
        for table in tracker.feed(Table(0, chain.read(chain.ready))).measurements
        if table.rows["settled"][0] == 1.0 and table.rows["impacts_per_cycle"][0] == 0.0
    ]


def tracker_errs(config: RigConfig, frequency_hz: float) -> tuple[int, int]:
    """Return the number of settled rows without impacts, and after how many of them the sphere strikes."""
    settings, motions = TrackerSettings(), driven(config, frequency_hz, WATCHED_S, AFTER_S)
    struck, speed = strikes(motions)
    heard = struck[(struck < WATCHED_S) & (speed > FAST)]
    if np.diff(heard, prepend=0.0, append=WATCHED_S).max() < settings.wait_limit_s:
        return 0, 0  # never long enough for a row without impacts
    ends = ends_of_rest(config, frequency_hz, motions[0], settings)
    return len(ends), sum(bool(np.any((struck > end) & (struck <= end + AFTER_S))) for end in ends)


def main() -> int:
    """Print the wrong places and the sums; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--some", type=int, metavar="N", help="number of places to draw by the seed (default: all)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the places (default: 1)")
    options = parser.parse_args()
    console = Console()
    sums = np.zeros(4, int)
    places = [(float(gap_mm), float(frequency_hz)) for gap_mm in GAPS_MM for frequency_hz in FREQUENCIES_HZ]
    if options.some:
        random = np.random.default_rng(options.seed)
        places = [places[number] for number in random.choice(len(places), options.some, replace=False)]
    for gap_mm, frequency_hz in places:
        config = configuration(gap_mm)
        found = *map_errs(config, frequency_hz), *tracker_errs(config, frequency_hz)
        sums += np.array(found, int)
        if found[1] or found[3]:
            console.print(f"{gap_mm:g} mm, {frequency_hz:.4g} Hz: map {found[1]}, rows {found[3]} of {found[2]}")
    console.print(
        f"{len(places)} places; the map calls {sums[0]} at rest, {sums[1]} wrongly; "
        f"{sums[2]} settled rows without impact, {sums[3]} wrongly"
    )
    return 1 if sums[1] or sums[3] else 0


if __name__ == "__main__":
    sys.exit(main())
