# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The transitions of a lifecycle node by name."""

from __future__ import annotations

from lifecycle_msgs.msg import Transition

_IDS = {
    "configure": Transition.TRANSITION_CONFIGURE,
    "cleanup": Transition.TRANSITION_CLEANUP,
    "activate": Transition.TRANSITION_ACTIVATE,
    "deactivate": Transition.TRANSITION_DEACTIVATE,
    "shutdown_unconfigured": Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    "shutdown_inactive": Transition.TRANSITION_INACTIVE_SHUTDOWN,
    "shutdown_active": Transition.TRANSITION_ACTIVE_SHUTDOWN,
}


def transition(name: str) -> Transition:
    """Return the transition of this name."""
    return Transition(id=_IDS[name])
