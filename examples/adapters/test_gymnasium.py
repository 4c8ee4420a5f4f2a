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
"""The environment against the real Gymnasium: its checker, vector environments, memory."""

import functools
import tracemalloc

import numpy as np
import pytest

pytest.importorskip("gymnasium", reason="make adapters installs it")

import gymnasium
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv
from gymnasium_env import SCALES, STEP_S, ImpactRigEnv

from impact_rig.driver import LocalRig


def test_the_environment_passes_the_checks_of_gymnasium(recwarn):
    check_env(gymnasium.make("ImpactRig-v0").unwrapped)
    assert not [str(one.message) for one in recwarn if "gymnasium" in str(one.filename)]


@pytest.mark.parametrize("kind", [SyncVectorEnv, AsyncVectorEnv])
def test_parallel_environments_return_the_same_observations_as_a_single_one(kind):
    make = functools.partial(gymnasium.make, "gymnasium_env:ImpactRig-v0")
    envs, alone = kind([make, make]), make()
    (first, _), (second, _) = envs.reset(seed=[3, 4]), alone.reset(seed=4)
    assert np.array_equal(first[1], second)
    for action in np.linspace(-1.0, 1.0, 5):
        found, reward, *_ = envs.step(np.full((2, 2), action, np.float32))
        expected, alone_reward, *_ = alone.step(np.full(2, action, np.float32))
        assert np.array_equal(found[1], expected)
        assert reward[1] == alone_reward
    envs.close()
    alone.close()


def test_an_observation_is_the_true_motion_of_the_rig():
    env = ImpactRigEnv()
    env.reset(seed=1)
    settings = {**env.settings, "daq.seed": env.rig.config.daq.seed, "output.truth_scan": True}
    with LocalRig(settings, also=["truth/scan"]) as rig:
        rig.run(STEP_S)
        rig.command(9.1, 0.35)
        for _ in range(50):
            found, *_ = env.step(np.zeros(2, np.float32))  # the middle of both ranges
        rig.run(50 * STEP_S)
        last = rig.rows("truth/scan")[-round(STEP_S * rig.rate_hz) :]
    assert found * SCALES == pytest.approx([last[name].std() for name in ("x_1", "x_b", "current")], rel=0.02)
    env.close()


def test_memory_does_not_grow_with_the_number_of_episodes():
    env = ImpactRigEnv()

    def episode():
        env.reset(seed=1)
        for _ in range(100):
            env.step(np.zeros(2, np.float32))
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    episode()
    before = episode()
    assert max(episode() for _ in range(3)) < before + 200_000
    tracemalloc.stop()
    env.close()
