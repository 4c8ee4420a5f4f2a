# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The first look: what the five lines of docs/index.md draw."""

from __future__ import annotations

from impact_rig.simulation import simulate
from tools.figures.style import finished


def draw() -> str:
    """Return the drawing as SVG."""
    driven = {"drive.frequency_hz": 9.1, "drive.amplitude": 0.52, "barriers.gap_m": 0.006}
    words = "Half a second of base, structure and acceleration, with the impacts that the analysis found."
    return finished(simulate(20.0, driven).plot(), words)
