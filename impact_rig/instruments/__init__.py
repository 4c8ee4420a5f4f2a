# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The rig's instruments: sensors, conditioning, the multiplexed converter, calibration and faults; no ROS."""

from typing import TYPE_CHECKING

from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.instruments.chain import Chain
    from impact_rig.instruments.checks import ChannelCheck, check_known_input, check_polarity
    from impact_rig.instruments.fault import Fault
    from impact_rig.instruments.pieces import PiecewiseMotion

__getattr__ = lazily(  # compiled code is loaded where it is used, not where a configuration is read
    __name__,
    Chain="chain",
    ChannelCheck="checks",
    check_known_input="checks",
    check_polarity="checks",
    Fault="fault",
    PiecewiseMotion="pieces",
)

__all__ = ["Chain", "ChannelCheck", "Fault", "PiecewiseMotion", "check_known_input", "check_polarity"]
