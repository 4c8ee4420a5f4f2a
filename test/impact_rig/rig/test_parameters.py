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
"""Parameters at run time: all or none of them, at the command instant."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from kits.rig import TICK, config, resimulated, same, samples

from impact_rig.errors import CommandError, ConfigError
from impact_rig.instruments.section import CHANNELS
from impact_rig.rig import Block, Rig, takes_effect
from impact_rig.rig.config import RigConfig, to_flat
from impact_rig.rig.journal import LIMITS

_NAMES = st.sampled_from([*to_flat(RigConfig()), "barriers.gap", "", "x" * 400])


_VALUES = st.one_of(st.floats(), st.integers(), st.booleans(), st.text(max_size=8), st.none(), st.tuples(st.text()))

WORDS = {"always": True, "never": False, "butterworth": True, "none": False}
"""Old words for switches, and the booleans that replace them."""


@given(st.dictionaries(_NAMES, _VALUES, min_size=1, max_size=3))
@example({"structure.mass_kg": 1.8e14, "shaker.damping_n_s_m": 1.8e14})  # the sphere touches without end
@settings(max_examples=500)
@pytest.mark.repeats
def test_any_change_of_parameters_is_accepted_or_rejected_as_a_unit(hammered: Rig, changes: dict[str, object]) -> None:
    before = hammered.config
    try:
        after = hammered.configure(changes)
    except (ConfigError, CommandError):
        assert hammered.config is before
        return
    scans = samples(hammered.advance(hammered.frontier_ns + TICK))
    assert all(np.isfinite(scans[name]).all() for name in CHANNELS), changes
    values = to_flat(after)
    for name, value in changes.items():
        if not isinstance(values[name], tuple):  # an empty text in a list of names means nothing
            taken = WORDS.get(values[name], values[name]) if isinstance(value, bool) else values[name]
            expected = type(taken)(value) if isinstance(taken, float | str) else value  # a text may look like a number
            assert taken == expected
    # restore: a valid but slow rig, with a shaker at MHz, would slow down all later examples
    default = to_flat(config())
    hammered.configure({name: default[name] for name in changes if name in default})
    hammered.take_journal()


def test_two_opposite_changes_at_one_instant_both_take_effect() -> None:
    """The second change reverts the first, so no value differs in the end, but the sphere was put to its start."""
    rig = Rig(config(drive__amplitude=0.52, barriers__gap_m=0.006))
    blocks = rig.advance(300 * TICK)
    rig.configure({"barriers.gap_m": 0.004, "contact.law": "hunt_crossley"})
    rig.configure({"barriers.gap_m": 0.006, "contact.law": "flores"})
    blocks += rig.advance(400 * TICK)
    resimulated(blocks, rig.take_journal())


def test_a_change_of_the_gap_puts_the_sphere_to_its_start() -> None:
    rig = Rig(config(output__monitor_rate_hz=200.0))
    before = rig.advance(50 * TICK)
    rig.configure({"barriers.gap_m": 0.008})
    after = rig.advance(51 * TICK)[0].monitor_states[0]
    assert after["x_2"] - after["x_1"] == pytest.approx(-0.004, abs=1e-15)
    last = before[-1].monitor_states[-1]
    gone_on = last["x_1"] + last["v_1"] * 5e-3
    assert after["x_1"] == pytest.approx(gone_on, abs=2e-4), "the structure keeps its motion"


def test_changes_of_limits_and_ramp_do_not_affect_the_motion(reference: list[Block]) -> None:
    """They must neither put the sphere back to its start nor restart the energy account."""
    rig = Rig(config())
    blocks = rig.advance(40 * TICK)
    work = rig.simulation.energy().work
    rig.configure({name: getattr(rig.config.shaker, name[7:]) * 1.01 for name in LIMITS})
    assert rig.simulation.energy().work == work > 0.0
    blocks += rig.advance(60 * TICK)
    assert same(samples(blocks), samples(reference))
    resimulated(blocks, rig.take_journal())


@pytest.mark.parametrize(
    "name", [*sorted(LIMITS), "structure.damping_ratio", "shaker.base_mass_kg", "contact.restitution"]
)
def test_the_documented_changes_put_the_sphere_to_its_start(name: str) -> None:
    rig = Rig(config())
    rig.advance(40 * TICK)
    flying = rig.simulation.state()
    rig.configure({name: 0.9 * to_flat(rig.config)[name]})
    assert (rig.simulation.state()[5:].tolist() != flying[5:].tolist()) == ("rests at" in takes_effect(name))


def test_a_rejected_change_has_no_effect() -> None:
    rig = Rig(config())
    rig.take_journal()
    with pytest.raises(ConfigError, match=r"barriers.gap_m must be >= 1e-06"):
        rig.configure({"barriers.gap_m": -0.002, "contact.law": "hertz"})
    assert rig.config == config()
    assert rig.take_journal() == []
    with pytest.raises(ConfigError, match="fixed at start"):
        rig.configure({"daq.block_scans": 7})


def test_publishing_options_change_no_sample_and_are_not_journaled(reference: list[Block]) -> None:
    rig = Rig(config())
    blocks = rig.advance(20 * TICK)
    rig.take_journal()
    rig.configure({"output.truth_scan": True, "output.monitor_rate_hz": 50.0, "time.ack_window": 3})
    assert rig.take_journal() == []
    more = rig.advance(60 * TICK)
    assert same(samples(blocks + more), samples(reference))
    assert more[5].truth is not None
    assert len(more[5].truth.rows) == 100
    assert sum(len(block.monitor_states) for block in more[-20:]) == 10


def test_a_new_seed_takes_effect_at_the_next_reset() -> None:
    rig, other = Rig(config()), Rig(config(daq__seed=5))
    rig.configure({"daq.seed": 5})
    rig.reset()
    assert same(samples(rig.advance(rig.start_ns + 5 * TICK)), samples(other.advance(5 * TICK)))


@pytest.mark.parametrize(
    ("chosen", "then", "hertz"),
    [
        ({"contact__law": "restitution"}, {"structure.mass_kg": 1.0}, 9.0),
        ({"sphere__present": False}, {"shaker.frequency_max_hz": 1000.0}, 1000.0),
    ],
    ids=["mass", "fastest drive"],
)
def test_instruments_use_the_current_mechanics(chosen: dict, then: dict[str, object], hertz: float) -> None:
    """Instruments must use the new mass that an impact kicks, and pieces short enough for the fastest new drive.

    Otherwise, readings after the change would be eight times too high, or off by half of their value.
    """
    read = []
    for first, later in (({}, then), (then, {})):
        named = {name.replace(".", "__"): value for name, value in first.items()}
        rig = Rig(config(**chosen, **named))
        rig.configure(later)
        rig.accept(frequency_hz=hertz, amplitude=0.52)
        read.append(samples(rig.advance(100 * TICK)))
    assert same(*read)


def test_a_drive_faster_than_a_new_limit_is_read_correctly() -> None:
    """The limit applies to the next command; the instruments must use the amplitude that is active."""
    read = []
    for then in ({}, {"shaker.frequency_max_hz": 200.0, "instruments.laser.lag_s": 1e-3}):
        rig = Rig(config(sphere__present=False, shaker__frequency_max_hz=1000.0))
        rig.accept(frequency_hz=1000.0, amplitude=0.52)
        rig.configure(then)
        read.append(samples(rig.advance(20 * TICK))["current"])
    assert same(*read)


def test_a_chirp_beyond_the_highest_command_is_read_correctly() -> None:
    """Pieces must be short enough for a chirp to 1 kHz, not only for commands; otherwise, 0.5 A reads 0.62 A."""
    read = []
    for highest_hz in (200.0, 1000.0):
        chirp = {"drive__waveform": "chirp", "drive__frequency_hz": 150.0, "drive__chirp_end_hz": 1000.0}
        rig = Rig(config(sphere__present=False, drive__chirp_s=0.2, shaker__frequency_max_hz=highest_hz, **chirp))
        read.append(samples(rig.advance(20 * TICK)))
    assert same(*read)
