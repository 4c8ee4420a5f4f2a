# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The node `stepped_sine` as a program: `python -m impact_rig_studies --ros-args ...`, and its console script.

Light on purpose: signals and the end of the parent are taken care of before anything heavy is imported.
"""

from __future__ import annotations

import functools

from impact_rig.nodes.__main__ import run

USE = (
    "The stepped sine: sets one frequency after the other, waits for the analysis, and publishes the curve.",
    "begin:=true",
    "Topics, services and parameters: docs/interface.md.",
)

stepped_sine = functools.partial(run, "stepped_sine", USE, "impact_rig_studies.stepped_sine_node")

if __name__ == "__main__":
    stepped_sine()
