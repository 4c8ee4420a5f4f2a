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
"""Regimes of a map against the sign of an exponent: `python -m qualification.regimes FOLDER [--places N]`.

Each place has its own gap, frequency, current and coefficient of restitution. A map classifies its motion as periodic,
modulated or chaotic; then the largest exponent is measured over another 2,000 cycles. It must be positive for chaotic
motions, negative for periodic ones, and not positive for modulated ones. At most 5 % of the places may disagree by more
than 2u, and none by more than 4u. Results are kept in FOLDER, so a run can be resumed.

An exponent describes a motion only if that lasts. If a chaotic motion turns out to be a transient, because a map finds
a periodic one after the 2,000 cycles, both are measured after it. These places are counted.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np

from impact_rig.errors import SimulationError
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.states import Regime
from impact_rig_studies.dynamics.stroboscope import Place, Stroboscope
from impact_rig_studies.maps import exponent
from impact_rig_studies.maps.measure import MapRig, Reading, Settings
from impact_rig_studies.maps.plan import FREQUENCY
from qualification.results import Results

CYCLES, WINDOWS, MOST, FAR = 100, 20, 0.05, 4.0


def judged(seed: int, number: int) -> dict[str, object]:
    """Return the regime of a place, and its exponent [1/s]."""
    rng = np.random.default_rng([seed, number])
    config = from_flat(
        RigConfig(),
        {"barriers.gap_m": float(rng.uniform(0.002, 0.035)), "contact.restitution": float(rng.uniform(0.2, 0.8))},
    )
    place = Place(config, float(rng.uniform(8.6, 9.6)), float(rng.uniform(0.2, 0.8)))
    rig, reading = settled(place, 0)
    later = settled(place, CYCLES * WINDOWS) if reading.regime == Regime.CHAOTIC else (rig, reading)
    if transient := later[1].regime == Regime.PERIODIC != reading.regime:
        rig, reading = later
    value = u = float("nan")
    if reading.impacts_per_cycle > 0.0:
        strobe = Stroboscope(place, FREQUENCY, 1.0)
        try:
            z = strobe.seen(rig, place.frequency_hz, reading)
            strobe.cycles = 1
            found = exponent.largest(lambda at, n: strobe(at, place.frequency_hz, n), z, CYCLES, WINDOWS)
            value, u = place.frequency_hz * found.value, place.frequency_hz * found.uncertainty
        except SimulationError:
            pass
    return {
        "number": number, "gap_m": config.barriers.gap_m, "frequency_hz": place.frequency_hz,
        "current_a": place.amplitude, "restitution": config.contact.restitution, "regime": reading.regime,
        "period": reading.period, "exponent_per_s": value, "u_per_s": u, "transient": float(transient),
    }  # fmt: skip


def settled(place: Place, after: int) -> tuple[MapRig, Reading]:
    """Return the rig at a place and the reading of a map, or that of a map some drive cycles after such a reading."""
    rig = MapRig(place.config, Settings())
    reading = rig.measure(place.frequency_hz, place.amplitude)
    if after:
        rig.run_cycles(place.frequency_hz, place.amplitude, after)
        reading = rig.measure(place.frequency_hz, place.amplitude)
    return rig, reading


def off(one: dict[str, float | str]) -> float:
    """Return by how many standard uncertainties an exponent contradicts the regime."""
    value, u = float(one["exponent_per_s"]), max(float(one["u_per_s"]), 1e-6)
    if one["regime"] == "chaotic":
        return max(-value / u, 0.0)
    return max(value / u, 0.0) if one["regime"] in ("periodic", "modulated") else 0.0


def main() -> int:
    """Evaluate the places that are missing; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder that keeps the results")
    parser.add_argument("--places", type=int, default=200, help="number of places (default: 200)")
    parser.add_argument("--seed", type=int, default=2, help="seed of the places (default: 2)")
    arguments = parser.parse_args()
    done = Results(arguments.folder / f"regimes_{arguments.seed}.jsonl")
    for number in range(len(done), arguments.places):
        done.add(judged(arguments.seed, number))
    known = [one for one in done if np.isfinite(one["exponent_per_s"])]
    apart = np.array([off(one) for one in known])
    print(  # noqa: T201  # the result
        f"{len(done)} places, {len(known)} with an exponent; {np.count_nonzero(apart > 2.0)} contradicted by more than "
        f"2u, {np.count_nonzero(apart > FAR)} by more than {FAR:g}u; {sum(one['transient'] for one in done):g} chaotic "
        f"motions were transients: {[one for one, z in zip(known, apart, strict=True) if z > 2.0]}"
    )
    return 0 if np.mean(apart > 2.0) <= MOST and not np.any(apart > FAR) else 1


if __name__ == "__main__":
    sys.exit(main())
