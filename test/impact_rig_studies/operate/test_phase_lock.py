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
"""Search, track and dwell on a resonance with a known response, on the rig, and over topics; and the backbone sweep."""

from __future__ import annotations

import cmath
import math

import attrs
import numpy as np
import pytest

from impact_rig.analysis.scans import SCAN
from impact_rig.blocks import Table
from impact_rig.driver import LocalRig
from impact_rig.errors import ConfigError
from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig, from_flat
from impact_rig.simtime import NS_PER_S
from impact_rig_studies.operate.phase_lock import (
    AmplitudeSweep,
    LockedSine,
    LockLoop,
    PhaseLock,
    Sample,
    Stage,
    follow,
    mean,
    measure_backbone,
    run_phase_lock,
    with_short_blocks,
)
from impact_rig_studies.operate.plans import LockPlan, Reference
from impact_rig_studies.operate.stepped_sine import SweepState

PLAN = LockPlan(start_hz=8.1, current_a=0.2, dwell_s=10.0)
TRUE_HZ = 9.105 / math.sqrt(1.0 - 4.0 * 0.0044974**2)
"""Frequency at which the superior base is a quarter cycle behind the base: ω² (k_1 m_1 − c_1²) = k_1²."""


class Resonance:
    """A loop without delay: T = (1 + 2iζr)/(1 − r² + 2iζr), base of 1 µm per 0.1 A; `trips_s` ends it."""

    def __init__(self, zeta=0.0045, trips_s=math.inf):
        self.zeta, self.trips_s, self.now, self.setpoint, self.hz = zeta, trips_s, 0, None, 9.105
        self.still = False

    @property
    def now_ns(self):
        return self.now

    def set(self, setpoint):
        self.setpoint = setpoint

    def sample(self, seconds):
        self.now += round(seconds * NS_PER_S)
        if self.now > self.trips_s * NS_PER_S:
            return "the fuse blew"
        f, i = self.setpoint.frequency_hz, self.setpoint.current_a
        r = f / self.hz
        t = (1 + 2j * self.zeta * r) / (1 - r * r + 2j * self.zeta * r)
        base = 0.0 if self.still else 1e-5 * i * cmath.exp(0.3j)
        return Sample(self.now, f, base, base * t, i * cmath.exp(0.3j))


@pytest.mark.parametrize("reference", list(Reference))
@pytest.mark.parametrize("start_hz", [8.1, 10.1])
@pytest.mark.parametrize("zeta", [0.002, 0.0045, 0.02])
def test_a_resonance_is_found_and_held(reference, start_hz, zeta):
    plan = attrs.evolve(PLAN, start_hz=start_hz, reference=reference)
    lock = run_phase_lock(plan, Resonance(zeta))
    assert lock.state is SweepState.FINISHED, lock.reason
    assert lock.frequency_hz == pytest.approx(9.105 / math.sqrt(1.0 - 4.0 * zeta**2), abs=0.003)
    assert math.degrees(lock.rows["phase"][-1]) == pytest.approx(-90.0, abs=0.5)
    assert lock.locked_ns is not None
    assert lock.locked_ns <= 60 * NS_PER_S
    assert lock.rows["time"][-1] * NS_PER_S - lock.locked_ns >= 10 * NS_PER_S


@pytest.mark.parametrize(("start_hz", "side", "low_hz", "high_hz"), [(9.9, 1.0, 5.0, 10.0), (8.1, -1.0, 8.0, 20.0)])
def test_a_transient_at_an_end_of_the_range_is_not_taken_for_a_resonance(start_hz, side, low_hz, high_hz):
    """The frequency does not change between two samples: a slope of 0 must not keep the lock at the end forever."""

    class Ringing(Resonance):
        def sample(self, seconds):
            found = super().sample(seconds)
            turned = cmath.exp(1j * math.radians(-90.0 + 30.0 * side))  # as if it were beyond the end
            return found._replace(superior=found.base * turned) if self.now < 6 * NS_PER_S else found

    plan = attrs.evolve(PLAN, start_hz=start_hz, low_hz=low_hz, high_hz=high_hz, reference=Reference.CURRENT)
    lock = run_phase_lock(plan, Ringing())
    assert lock.state is SweepState.FINISHED, lock.reason
    assert lock.frequency_hz == pytest.approx(TRUE_HZ, abs=0.003)


@pytest.mark.parametrize(("sample_s", "command_s"), [(0.5, 0.6), (0.1, 0.03)])
def test_the_lock_works_with_delayed_commands(sample_s, command_s):
    """Commands need time: if samples counted as consecutive, the phase would be held and nothing would lock."""

    class Late(Resonance):
        def sample(self, seconds):
            self.now += round(command_s * NS_PER_S)
            return super().sample(seconds)

    lock = run_phase_lock(attrs.evolve(PLAN, sample_s=sample_s), Late())
    assert lock.state is SweepState.FINISHED, lock.reason
    assert lock.frequency_hz == pytest.approx(TRUE_HZ, abs=0.003)


def test_the_lock_follows_a_moving_resonance():
    bench = Resonance()
    lock = PhaseLock(attrs.evolve(PLAN, dwell_s=1e6))
    bench.set(lock.start(0))
    follow(lock, bench, lambda one: one.locked)
    bench.hz = 9.3
    follow(lock, bench, lambda one: not one.locked)
    assert lock.stage is Stage.TRACKING
    follow(lock, bench, lambda one: one.locked)
    assert lock.frequency_hz == pytest.approx(9.3, abs=0.003)


@pytest.mark.parametrize(
    ("bench", "changes", "words"),
    [
        (Resonance(trips_s=3.0), {}, "the fuse blew"),
        (Resonance(), {"superior_limit_m": 1e-6}, "the superior base swings"),
        (Resonance(), {"high_hz": 8.5}, "no lock within 60 s of rig time, searching from 8.1 Hz"),
    ],
)
def test_an_aborted_lock_reports_the_reason_and_sets_the_current_to_zero(bench, changes, words):
    lock = run_phase_lock(attrs.evolve(PLAN, **changes), bench)
    assert lock.state is SweepState.ABORTED
    assert words in lock.reason
    assert bench.setpoint.current_a == 0.0


def test_a_base_at_rest_is_not_used_as_a_reference():
    bench = Resonance()
    bench.still = True
    assert "no phase can be measured" in run_phase_lock(PLAN, bench).reason


def test_a_superior_base_at_rest_has_no_phase_that_could_be_tracked():
    bench = Resonance()
    lock = PhaseLock(PLAN)
    bench.set(lock.start(0))
    follow(lock, bench, lambda one: one.locked)
    setpoint = lock.on_sample(bench.sample(PLAN.sample_s)._replace(superior=0j))
    assert "no phase can be measured: " in lock.reason
    assert setpoint.current_a == 0.0


def test_a_lock_whose_first_sample_has_no_phase_still_has_figures():
    rig = Rig(RigConfig())
    lock = LockedSine(PLAN, rig.info().rows, 2.0)
    lock.start(0)
    lock.on_applied(PLAN.start_hz, PLAN.current_a, 0)
    lock.on_scans(Table(0, np.zeros(20 * rig.config.daq.rate_hz, SCAN)))
    assert lock.state is SweepState.ABORTED
    assert math.isnan(lock.figures()["phase_deg"])


def test_a_lost_lock_ends_after_a_timeout():
    bench = Resonance()
    lock = PhaseLock(attrs.evolve(PLAN, dwell_s=1e6, high_hz=9.2))
    bench.set(lock.start(0))
    follow(lock, bench, lambda one: one.locked)
    bench.hz = 9.6
    follow(lock, bench, lambda _: False)
    assert (
        "for 20 s of rig time (lose_limit_s) the mean phase of a second was not within -90 ± 2 degrees" in lock.reason
    )


def test_a_start_frequency_outside_the_bounds_is_rejected():
    with pytest.raises(ConfigError, match=r"start_hz \(--start\) must be > 5"):
        attrs.evolve(PLAN, start_hz=30.0)


def test_an_amplitude_sweep_reports_jumps():
    class Jumping(Resonance):
        def set(self, setpoint):
            super().set(setpoint)
            self.zeta = 0.0045 if setpoint.current_a < 0.3 else 0.01

    points, why = measure_backbone(AmplitudeSweep(currents_a=(0.1, 0.2, 0.4), lock=PLAN), Jumping())
    assert why == ""
    assert [(one.direction, one.current_a) for one in points] == [
        ("up", 0.1), ("up", 0.2), ("up", 0.4), ("down", 0.2), ("down", 0.1),
    ]  # fmt: skip
    assert [one.jumped for one in points] == [False, False, True, True, False]
    assert all(one.locked for one in points)
    assert points[0].dt == pytest.approx(1 / 0.009, rel=1e-3)


def local(config: RigConfig) -> LockLoop:
    return LockLoop(LocalRig(with_short_blocks(config)))


def linear() -> RigConfig:
    return from_flat(RigConfig(), {"sphere.present": False, "daq.rate_hz": 2000})


@pytest.fixture(scope="module")
def locked() -> PhaseLock:
    return run_phase_lock(PLAN, local(linear()))


def test_the_lock_on_the_linear_rig_is_at_the_true_quarter_cycle(locked):
    assert locked.state is SweepState.FINISHED, locked.reason
    assert locked.locked_ns is not None
    assert locked.locked_ns <= 60 * NS_PER_S
    late = locked.rows[-10:]
    assert np.mean(late["frequency"]) == pytest.approx(TRUE_HZ, abs=0.003)
    assert np.degrees(np.mean(late["phase"])) == pytest.approx(-90.0, abs=0.5)


def test_a_locked_stretch_states_its_uncertainty(locked):
    """Frequency and DT of the linear rig are known in closed form."""
    dwelt = locked.rows[locked.rows["locked"] == 1.0][4:]
    found = mean(dwelt, locked.u_gain)
    assert 0.0 < found.u_frequency_hz < 0.003
    assert abs(found.frequency_hz - TRUE_HZ) < 3.0 * found.u_frequency_hz
    true_dt = abs(complex(transmissibility(linear(), found.frequency_hz)))
    assert 0.001 < found.u_dt / found.dt < 0.01, "two sensitivities of 0.12 to 0.22 % and the scatter"
    assert abs(found.dt - true_dt) < 3.0 * found.u_dt
    assert np.isnan(mean(dwelt[:3], locked.u_gain).u_dt), "three samples are not enough"


def test_a_lock_is_reproducible_bit_for_bit(locked):
    again = run_phase_lock(PLAN, local(linear()))
    assert again.rows.tobytes() == locked.rows.tobytes()


@pytest.mark.heavy
def test_the_lock_recovers_after_a_change_of_the_gap():
    rig = local(from_flat(RigConfig(), {"barriers.gap_m": 6e-3, "daq.rate_hz": 2000}))
    lock = PhaseLock(LockPlan(start_hz=9.0, current_a=0.52, dwell_s=1e6))
    rig.set(lock.start(0))
    follow(lock, rig, lambda one: one.locked)
    rig.rig.configure({"barriers.gap_m": 10e-3})
    lock.unlock(rig.now_ns)
    changed = rig.now_ns
    follow(lock, rig, lambda _: rig.now_ns >= changed + 12 * NS_PER_S)
    assert lock.state is SweepState.RUNNING, lock.reason
    assert lock.locked
    late = lock.rows[lock.rows["time"] >= changed / NS_PER_S + 10.0]
    assert np.degrees(late["phase"]).mean() == pytest.approx(-90.0, abs=2.0)


def test_a_trip_ends_the_lock():
    rig = local(from_flat(linear(), {"shaker.travel_limit_m": 1e-5}))
    lock = run_phase_lock(PLAN, rig)
    assert lock.reason.startswith("the rig tripped")


@pytest.mark.ros
@pytest.mark.pipeline
@pytest.mark.timeout(200)
def test_a_lock_over_topics_yields_the_same_bits(locked):
    pytest.importorskip("rclpy", reason="no ROS 2 here")
    from impact_rig.driver import RosRig

    with RosRig(with_short_blocks(linear())) as behind:
        rig, lock = LockLoop(behind), PhaseLock(PLAN)
        rig.set(lock.start(rig.now_ns))
        follow(lock, rig, lambda one: len(one.rows) >= 8)
    assert lock.rows.tobytes() == locked.rows[:8].tobytes()
