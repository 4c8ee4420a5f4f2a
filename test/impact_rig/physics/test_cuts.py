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
"""Nothing depends on how a run is cut into advances, nor on what is sampled in between: bit for bit."""

from __future__ import annotations

import numpy as np
import pytest
from kits.mechanics import TWO_PI, rig, sine

from impact_rig.physics import SEGMENT, Simulation
from impact_rig.rig.config import RigConfig

SEGMENTS = 700


def drive() -> np.ndarray:
    """Seven seconds of 10 ms ticks: ramp up, a change of frequency in mid-run, a change of level."""
    rows = sine(9.1, 0.6, 0.01, SEGMENTS)
    rows["omega"][300:] = TWO_PI * 9.3
    rows["amplitude"][:10], rows["growth"][:10] = 0.06 * np.arange(10), 6.0
    rows["amplitude"][500:] = 0.4
    return rows


CONFIGS = {
    "flores 6 mm": rig(),
    "flores 1 mm, resting": rig(barriers={"gap_m": 1e-3}),
    "kelvin_voigt": rig(contact={"law": "kelvin_voigt"}, barriers={"gap_m": 2e-3}),
    "restitution, attached": rig(contact={"law": "restitution"}, barriers={"gap_m": 1e-3}),
    "friction": rig(sphere={"guide_friction": 0.05}, barriers={"gap_m": 2e-3}),
    "voltage": rig(drive={"kind": "voltage"}),
}


def run(config: RigConfig, per_call: int, rate_hz: float = 0.0) -> tuple[bytes, np.ndarray]:
    """Impacts' bytes and samples at the segments' middles; with a rate, everything is sampled at it along the way."""
    simulation, segments, impacts, middles = Simulation(config), drive(), [], []
    for first in range(0, SEGMENTS, per_call):
        motion = simulation.advance(segments[first : first + per_call])
        number = np.arange(motion.first_tick, motion.last_tick + 1)
        if rate_hz:
            per_segment = round(0.01 * rate_hz)
            motion.sample(np.repeat(number, per_segment), np.tile(np.arange(per_segment) / rate_hz, len(number)))
        impacts.append(motion.impacts)
        middles.append(motion.sample(number, np.full(len(number), 0.005)))
    return np.concatenate(impacts).tobytes(), np.concatenate(middles)


@pytest.mark.heavy
@pytest.mark.parametrize("name", CONFIGS)
def test_impacts_and_samples_do_not_depend_on_the_division_into_segments(name):
    impacts, samples = run(CONFIGS[name], SEGMENTS)
    assert len(impacts) > 0, "no impacts: the test tests nothing"
    for per_call in (1, 7, 100):
        again, samples_again = run(CONFIGS[name], per_call)
        assert again == impacts, f"impacts differ when advanced by {per_call} segments"
        assert samples_again.tobytes() == samples.tobytes(), f"samples differ when advanced by {per_call} segments"


@pytest.mark.heavy
@pytest.mark.parametrize("rate_hz", [1e3, 10e3, 50e3])
def test_impacts_do_not_depend_on_the_sampling_rate(rate_hz):
    name = "flores 1 mm, resting"
    assert run(CONFIGS[name], 10, rate_hz)[0] == run(CONFIGS[name], SEGMENTS)[0]


@pytest.mark.heavy
@pytest.mark.parametrize("name", CONFIGS)
def test_a_sample_does_not_depend_on_the_other_samples(name):
    motion = Simulation(CONFIGS[name]).advance(drive()[:120])
    generator = np.random.default_rng(1)
    segment = np.sort(generator.integers(0, 120, 3000))
    offset = generator.uniform(0.0, 0.01, 3000)
    all_knots = motion.breakpoints()
    segment, offset = np.append(segment, all_knots[0]), np.append(offset, np.minimum(all_knots[1] + 1e-7, 0.00999))
    together = motion.sample(segment, offset)
    backwards = motion.sample(segment[::-1].copy(), offset[::-1].copy())[::-1]
    assert backwards.tobytes() == together.tobytes()
    alone = np.concatenate([motion.sample(segment[i : i + 1], offset[i : i + 1]) for i in range(0, len(segment), 17)])
    assert alone.tobytes() == together[::17].tobytes()
    for quantity in together.dtype.names:
        got = motion.quantity(quantity, segment, offset)
        assert got.tobytes() == np.ascontiguousarray(together[quantity]).tobytes(), quantity


def test_a_replay_is_bit_identical_after_reset():
    simulation, segments = Simulation(rig()), drive()
    first = simulation.advance(segments).impacts.tobytes()
    simulation.reset()
    assert simulation.advance(segments).impacts.tobytes() == first


def test_an_empty_list_of_segments_yields_no_motion():
    simulation = Simulation(rig())
    motion = simulation.advance(np.zeros(0, SEGMENT))
    assert len(motion.impacts) == 0
    assert simulation.tick == 0
    assert len(motion.sample(np.zeros(0, int), np.zeros(0))) == 0
