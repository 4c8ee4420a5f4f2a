# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig without ROS: physics and instruments on one time base, with deterministic commands and a journal."""

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.rig.core import Block, Rig
    from impact_rig.rig.journal import InputKind, Journal, takes_effect
    from impact_rig.rig.resimulation import resimulate

__getattr__ = lazily(  # `rig.config` does without compiled code
    __name__, Block="core", takes_effect="journal", Rig="core", Journal="journal", InputKind="journal",
    resimulate="resimulation",
)  # fmt: skip

__all__ = ["Block", "InputKind", "Journal", "Rig", "resimulate", "takes_effect"]
