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
"""Impact damping: one cycle of the sphere between the barriers, and the energy lost at each impact."""

from __future__ import annotations

import numpy as np

from impact_rig_studies.campaign.paper import FREQUENCY_HZ
from tools.figures import simulated
from tools.figures.style import GRID, INK, MUTED, SPHERE, STRUCTURE, direct_label, finished, new_figure, style

HEIGHT = 400.0
GAP_M, CYCLES, PER_CYCLE = 6e-3, 2, 160


def draw() -> str:
    """Return the drawing."""
    steady = simulated.steady(GAP_M, cycles=CYCLES)
    time = np.arange(CYCLES * PER_CYCLE + 1) / (PER_CYCLE * FREQUENCY_HZ)
    structure, sphere = 1e3 * steady.at(("x_1", "x_2"), time)
    hits = steady.impact_times()
    shown = (hits >= 0.0) & (hits <= time[-1])
    at, lost = hits[shown], 1e6 * np.cumsum(steady.motion.impacts["energy_lost"][shown])
    half = 0.5e3 * GAP_M
    with style():
        figure = new_figure(HEIGHT)
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1.0])
        upper.fill_between(1e3 * time, structure - half, structure + half, color=GRID, alpha=0.5, linewidth=0)
        for side in (-half, half):
            upper.plot(1e3 * time, structure + side, color=STRUCTURE)
        upper.plot(1e3 * time, sphere, color=SPHERE)
        struck = np.interp(at, time, sphere)
        upper.plot(1e3 * at, struck, "o", color=SPHERE, markersize=7)
        direct_label(upper, 58.0, -8.4, "barriers, moving with x$_1$", STRUCTURE)
        direct_label(upper, 64.0, -1.6, "sphere", SPHERE)
        upper.set(ylabel="place (mm)", title="gap 6 mm, 9.1 Hz: four impacts in each cycle", ylim=(-10.5, 10.5))
        lower.step(
            np.concatenate(([0.0], 1e3 * at, [1e3 * time[-1]])),
            np.concatenate(([0.0], lost, lost[-1:])),
            where="post",
            color=INK,
        )
        lower.set(xlabel="time (ms)", ylabel="lost (µJ)", title="energy lost in impacts", xlim=(0.0, 1e3 * time[-1]))
        lower.margins(y=0.1)
        lower.yaxis.label.set_color(MUTED)
        words = (
            "Above: over two cycles the two barriers move as a wave, and the sphere flies from one to the other; dots "
            "are impacts. Below: the energy lost in impacts grows by a step with each of them."
        )
        return finished(figure, words)
