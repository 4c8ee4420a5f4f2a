"""The rig's instruments: sensors, conditioning, the multiplexed converter, calibration and faults; no ROS."""

import impact_rig.system.compiled  # noqa: F401  # first: finds what was compiled from these sources
from impact_rig.instruments.chain import Chain
from impact_rig.instruments.checks import ChannelCheck, check_known_input, check_polarity
from impact_rig.instruments.faults import Fault
from impact_rig.instruments.motion import Motion

__all__ = ["Chain", "ChannelCheck", "Fault", "Motion", "check_known_input", "check_polarity"]
