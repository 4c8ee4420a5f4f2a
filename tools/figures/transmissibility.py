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
"""Definition of DT: two motions, their ratio, and the ratio over frequency."""

from __future__ import annotations

import numpy as np

from impact_rig.physics.linear_response import transmissibility
from impact_rig.rig.config import RigConfig
from impact_rig_studies.campaign.paper import FREQUENCY_HZ
from tools.figures import simulated
from tools.figures.style import BASE, INK, MUTED, STRUCTURE, direct_label, finished, new_figure, style

HEIGHT = 360.0
CYCLES, PER_CYCLE = 3, 100


def draw() -> str:
    """Return the drawing."""
    time = np.arange(CYCLES * PER_CYCLE + 1) / (PER_CYCLE * FREQUENCY_HZ)
    base, structure = simulated.steady(0.0, cycles=CYCLES).at(("x_b", "x_1"), time)
    ratio = abs(complex(transmissibility(RigConfig(), FREQUENCY_HZ)))
    with style():
        figure = new_figure(HEIGHT)
        axes = figure.subplot_mosaic([["structure", "ratio"], ["base", "ratio"]], width_ratios=[1.0, 1.0])
        upper, lower, right = axes["structure"], axes["base"], axes["ratio"]
        upper.plot(1e3 * time, 1e3 * structure, color=STRUCTURE)
        upper.set(ylabel="x$_1$ (mm)", title=f"superior base: ± {1e3 * np.max(structure):.2f} mm", ylim=(-7.5, 7.5))
        lower.plot(1e3 * time, 1e6 * base, color=BASE)
        lower.set(ylabel="x$_b$ (µm)", title=f"inferior base: ± {1e6 * np.max(base):.0f} µm", ylim=(-70, 70))
        lower.set_xlabel("time (ms)")
        upper.sharex(lower)
        frequency = np.geomspace(4.0, 25.0, 401)
        right.loglog(frequency, [abs(complex(transmissibility(RigConfig(), float(f)))) for f in frequency], color=INK)
        right.axhline(1.0, color=MUTED, linewidth=1.0, linestyle=":")
        right.plot([FREQUENCY_HZ], [ratio], "o", color=STRUCTURE)
        direct_label(right, FREQUENCY_HZ * 1.03, ratio, f"DT = {ratio:.0f}", STRUCTURE, fontweight="bold")
        right.annotate("slow:\nboth move\nalike,\nDT = 1", (4.2, 2.0), color=MUTED, va="bottom")
        right.annotate("fast:\nthe structure\nstays behind,\nDT < 1", (24.0, 1.3), color=MUTED, va="bottom", ha="right")
        right.set_xticks([5, 10, 20], ["5", "10", "20"])
        right.set_xticks([], minor=True)
        right.set_yticks([0.1, 1, 10, 100], ["0.1", "1", "10", "100"])
        right.set(xlabel="frequency (Hz)", title="DT = |X$_1$| / |X$_b$|", xlim=(4.0, 25.0), ylim=(0.1, 300.0))
        words = (
            "Left: at 9.1 Hz the superior base swings 5.8 millimetres while the inferior base moves 53 micrometres. "
            "Right: the ratio of the two over frequency is 1 far below the resonance, 110 at 9.1 Hz, below 1 far above."
        )
        return finished(figure, words)
