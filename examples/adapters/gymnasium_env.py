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
"""The rig as an environment of Gymnasium: find the current and frequency at which the structure moves least.

gymnasium.make("gymnasium_env:ImpactRig-v0")
"""

import gymnasium
import numpy as np
from gymnasium import spaces

from impact_rig.driver import LocalRig

STEP_S, EPISODE_STEPS = 0.2, 200
LOW, HIGH = np.array([8.5, 0.1], np.float32), np.array([9.7, 0.6], np.float32)  # Hz, A
CHANNELS, SCALES = ("laser", "base", "current"), np.array([5e-3, 2e-4, 0.5])


class ImpactRigEnv(gymnasium.Env):
    """Environment whose actions are frequency and current of the drive, and which observes three motions.

    An action of -1 to 1 covers 8.5 to 9.7 Hz and 0.1 to 0.6 A. An observation is the rms of laser, base and current
    over the last 0.2 s, divided by `SCALES`. A trip ends the episode.
    """

    action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
    observation_space = spaces.Box(0.0, 1e3, (3,), np.float32)

    def __init__(self, gap_m=0.006, render_mode=None):
        self.render_mode, self.rig = render_mode, None
        self.settings = {"barriers.gap_m": gap_m, "daq.rate_hz": 2000, "daq.block_scans": 100}

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.close()
        self.rig = LocalRig({**self.settings, "daq.seed": int(self.np_random.integers(2**31))})
        return self._observe(), {}

    def step(self, action):
        frequency, current = LOW + 0.5 * (np.clip(action, -1.0, 1.0) + 1.0) * (HIGH - LOW)
        self.rig.command(float(frequency), float(current))
        found = self._observe()
        tripped = bool(self.rig.stopped)
        reward = -float(found[0]) - 10.0 * tripped  # a small motion of the structure, without a trip
        return found, reward, tripped, False, {"time_s": self.rig.time_s}

    def close(self):
        if self.rig is not None:
            self.rig.close()

    def _observe(self):
        self.rig.clear()  # bounds the memory
        self.rig.run(STEP_S)
        rows = self.rig.rows()
        return np.array([rows[name].std() for name in CHANNELS] / SCALES, np.float32)


gymnasium.register("ImpactRig-v0", entry_point=ImpactRigEnv, max_episode_steps=EPISODE_STEPS)
