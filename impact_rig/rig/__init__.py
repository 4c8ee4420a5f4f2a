"""The rig without ROS: physics and instruments on one time base, with deterministic commands and a journal."""

from impact_rig.rig.block import Block
from impact_rig.rig.changes import takes_effect
from impact_rig.rig.core import Rig
from impact_rig.rig.journal import Journal, Kind
from impact_rig.rig.resimulate import resimulate

__all__ = ["Block", "Journal", "Kind", "Rig", "resimulate", "takes_effect"]
