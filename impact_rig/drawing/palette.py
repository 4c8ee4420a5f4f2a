# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Colours of all drawings: drawn in the light ones; on a page each is a variable that follows the theme.

The series are those of Okabe & Ito, told apart by people with any colour vision, darkened where white needs it.
"""

from __future__ import annotations

from collections.abc import Mapping

INK, MUTED, GRID, PAPER_RED = "#1b1f24", "#66707c", "#d5dae1", "#c1121f"
SERIES = ("#0072b2", "#00845f", "#c75000", "#b0558f", "#8a6a00", "#3b8fc2", "#5b4fa2", "#7a7a2a")
PERIODIC, MODULATED, CHAOTIC, QUIET = "#cfe6f5", "#f6e3b4", "#f3c6bd", "#eceff2"

MEASURED, PREDICTED, TRUTH = SERIES[0], SERIES[4], SERIES[2]
"""By meaning, where a drawing is of one case: what instruments saw, what theory says, what really happened."""

NAMES: Mapping[str, str] = {
    INK: "ink",
    MUTED: "muted",
    GRID: "grid",
    PAPER_RED: "paper",
    **{colour: f"s{number}" for number, colour in enumerate(SERIES)},
    PERIODIC: "periodic",
    MODULATED: "modulated",
    CHAOTIC: "chaotic",
    QUIET: "quiet",
}
"""Light colour to the name of its variable."""

DARK: Mapping[str, str] = {
    "ink": "#e6e9ed",
    "muted": "#9aa4b0",
    "grid": "#39414b",
    "paper": "#ff6b6b",
    "s0": "#56b4e9",
    "s1": "#35c99a",
    "s2": "#ff9347",
    "s3": "#e59bc8",
    "s4": "#e0c04a",
    "s5": "#8fd0f5",
    "s6": "#b0a5f0",
    "s7": "#c9c96a",
    "periodic": "#1f4560",
    "modulated": "#5c4a14",
    "chaotic": "#63302a",
    "quiet": "#2a3038",
}


def variables(dark: bool) -> str:
    """Return the declarations of all colours for one theme."""
    return " ".join(f"--{name}: {DARK[name] if dark else light};" for light, name in NAMES.items())


def themed(svg: str) -> str:
    """Return a drawing whose colours are variables of the page."""
    for light, name in NAMES.items():
        svg = svg.replace(light, f"var(--{name})")
    return svg
