"""What a change of a configuration value touches, and from when on."""

from __future__ import annotations

from impact_rig.rig.journal import NOT_SAMPLED, SAMPLED

MECHANICS = ("structure.", "shaker.", "sphere.", "barriers.", "contact.")
INSTRUMENTS = ("instruments.", "daq.")
PLANNED = "instruments.faults.planned"
AT_RESET = ("drive.", "daq.seed")
"""What is drawn or commanded at the beginning only."""


def takes_effect(name: str) -> str:
    """Return from when on a new value of a parameter acts on a running rig, in words."""
    if name == PLANNED:
        return "next command instant, for the lines that are new or gone"
    if name.startswith(AT_RESET):
        return "next reset"
    if name.startswith(NOT_SAMPLED) and name not in SAMPLED:
        return "at once"
    if name.startswith(("sphere.", "barriers.", "contact.")):
        return "next command instant; the sphere rests at `sphere.start` again"
    return "next command instant"
