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
"""Stability as predicted and as found in the model: `python -m qualification.prediction_stability FOLDER [--places N]`.

Each place has its own mass ratio of sphere to structure up to 0.03, current, frequency, gap and contact law. The
predicted motion is the start of Newton's method on the model's stroboscopic map. The model's motion is stable if its
multipliers are within the unit circle and an integration over 500 cycles from a small error stays on it. The model must
not leave a motion that is predicted as stable, and 90 % of the model's stable motions must be predicted as stable;
otherwise the exit code is 1. Results are kept in FOLDER, so a run can be resumed.
"""

from __future__ import annotations

import argparse
import math
import sys
from pathlib import Path

import numpy as np

from impact_rig.analysis.calibration import Real
from impact_rig.errors import ConfigError
from impact_rig.physics.contact import LAWS
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig_studies import prediction
from impact_rig_studies.dynamics import orbits
from impact_rig_studies.dynamics.stroboscope import Place, Stroboscope, size
from impact_rig_studies.maps.plan import GAP
from qualification.results import Results

MOST_MASS_RATIO, SHARE, CYCLES, ERROR = 0.03, 0.9, 500, 1e-4


def drawn(seed: int, number: int) -> tuple[Place, int]:
    """Return a place on a predicted branch, and the index of its motion."""
    rng = np.random.default_rng([seed, number])
    while True:
        ratio = math.exp(rng.uniform(math.log(0.004), math.log(MOST_MASS_RATIO)))
        law = str(rng.choice([name for name in LAWS if name != "custom"]))
        current, frequency = float(rng.uniform(0.2, 0.9)), float(rng.uniform(8.8, 9.4))
        config = from_flat(
            RigConfig(),
            {"structure.mass_kg": prediction.LinearRig.of(RigConfig()).sphere_kg / ratio, "contact.law": law},
        )
        try:
            branch = prediction.branch(config, frequency, current_a=current)
        except ConfigError:  # a law without losses
            continue
        gap = float(prediction.widest_gap_m(branch) * rng.uniform(0.25, 1.0))
        place = Place(from_flat(config, {"barriers.gap_m": gap}), frequency, current)
        found = prediction.at(place.config, frequency, gap, current_a=current)
        if len(found):
            return place, int(rng.integers(len(found)))


def start(place: Place, which: int) -> tuple[Real, float]:
    """Return the state of a predicted motion midway between two impacts, and the phase of the drive there."""
    found = prediction.at(place.config, place.frequency_hz, place.config.barriers.gap_m, current_a=place.amplitude)
    theta = found.theta[which : which + 1]
    rig = prediction.LinearRig.of(place.config)
    answer = rig._answer(theta, np.array([place.frequency_hz]), prediction.HeldDrive(current_a=place.amplitude))
    omega, half = 2.0 * math.pi * place.frequency_hz, 0.5 * place.config.barriers.gap_m
    base = -1j * complex(answer.base[0])  # the drive is a sine
    superior = base * complex(answer.ratio[0])
    angle = float(found.impact_phase_rad[which] - np.angle(superior)) + 0.5 * math.pi
    turned = np.exp(1j * angle)
    x_b, v_b, x_1, v_1 = (
        float((one * turned).real) for one in (base, 1j * omega * base, superior, 1j * omega * superior)
    )
    speed = 2.0 * omega * half * float(theta[0]) / math.pi
    return np.array([x_1, v_1, x_b, v_b, 0.0, -x_1, -speed - v_1]), (angle / (2.0 * math.pi)) % 1.0


def continued(place: Place, which: int) -> tuple[Stroboscope, orbits.Orbit | None]:
    """Return the model's orbit near a predicted motion, and its map."""
    state, turn = start(place, which)
    strobe = Stroboscope(place, GAP, 1e-3)
    free = [0, 1, 2, 3, 5, 6]
    strobe.turn, strobe.scale = turn, size(place, state)[free]
    return strobe, orbits.orbit(strobe, state[free] / strobe.scale, place.config.barriers.gap_m * 1e3)


def judged(seed: int, number: int) -> dict[str, object]:
    """Return the predicted stability of a place, and that of the model."""
    place, which = drawn(seed, number)
    gap = place.config.barriers.gap_m
    found = prediction.at(place.config, place.frequency_hz, gap, current_a=place.amplitude)
    stable, dt, largest = False, math.nan, math.nan
    strobe, one = continued(place, which)
    if one is not None:
        properties = strobe.properties(one.z, one.p)
        dt, largest = properties.dt, float(abs(one.multipliers[0]))
        stays = strobe(one.z * (1.0 + ERROR), one.p, CYCLES)
        stable = one.stable and properties.impacts_per_cycle == 2.0 and bool(np.abs(stays - one.z).max() < ERROR)
    return {
        "number": number, "mass_ratio": prediction.LinearRig.of(place.config).manifold.mass_ratio, "gap_m": gap,
        "law": place.config.contact.law, "current_a": place.amplitude, "frequency_hz": place.frequency_hz,
        "predicted": str(found.kind[which]), "predicted_dt": float(found.dt[which]), "dt": dt, "stable": stable,
        "found": one is not None, "largest": largest,
    }  # fmt: skip


def main() -> int:
    """Evaluate the places that are missing; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder that keeps the results")
    parser.add_argument("--places", type=int, default=60, help="number of places (default: 60)")
    parser.add_argument("--seed", type=int, default=60, help="seed of the places (default: 60)")
    arguments = parser.parse_args()
    done = Results(arguments.folder / f"stability_{arguments.seed}.jsonl")
    for number in range(arguments.places):
        if number not in {one["number"] for one in done}:
            done.add(judged(arguments.seed, number))
    called = [one for one in done if one["predicted"] == prediction.STABLE]
    left = [one for one in called if not one["stable"]]
    lasting = [one for one in done if one["stable"]]
    recognised = sum(one["predicted"] == prediction.STABLE for one in lasting)
    print(f"{len(done)} places, {len(called)} called stable, {len(left)} of them left: {left}")  # noqa: T201  # the result
    print(f"{recognised} of {len(lasting)} stable motions are called so")  # noqa: T201  # as above
    return 0 if not left and recognised >= SHARE * len(lasting) else 1


if __name__ == "__main__":
    sys.exit(main())
