# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""impact_rig: the test rig of an impact damper as virtual hardware for ROS 2.

`impact_rig.simulate` is the first look, without ROS. Importing this package imports neither rclpy nor numpy; see
`docs/` for the interface and the physics.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from impact_rig.simulation import Record, simulate

__all__ = ["Record", "simulate"]
__version__ = "0.1.0"


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from impact_rig import simulation  # noqa: PLC0415  # numpy and the rig: only when asked for

    return getattr(simulation, name)
