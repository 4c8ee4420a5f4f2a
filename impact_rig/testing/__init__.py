"""For tests and programs that use the rig. `docs/testing.md` shows how to test a pipeline with it.

For tests of a pipeline, through the pytest plugin's fixtures of the same names or by themselves:

- `VirtualRig`: a rig in the test's process, without ROS; the pipeline is a function of blocks.
- `RosRig`: a rig on a ROS domain of its own, in lockstep with the nodes under test.
- `Fault`: a fault of the instruments at exact samples.
- `Golden`: comparison with a run, or with numbers, that were right once.

For everything else:

    with isolated_domain() as domain_id, Processes(domain_id, logs) as processes:
        processes.start("rig", {"time.mode": "stepped", "barriers.gap_m": 0.006})
        with Client(domain_id, processes=processes) as client:
            client.wait_active("rig")
            scans = client.collect("daq/scan")
            client.command(frequency_hz=9.1, current_a=0.52)
            client.step(blocks=100)

Importing this imports neither rclpy nor compiled code: both are loaded when something that needs them is asked for.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

from impact_rig.testing.domain import isolated_domain
from impact_rig.testing.processes import NodeProcess, ProcessDiedError, Processes

if TYPE_CHECKING:
    from impact_rig.testing.client import Client, ServiceFailedError
    from impact_rig.testing.collector import Collector
    from impact_rig.testing.faults import Fault
    from impact_rig.testing.golden import Golden, first_difference
    from impact_rig.testing.ros_rig import RosRig
    from impact_rig.testing.stepped_rig import NotReachedError, SteppedRig
    from impact_rig.testing.virtual_rig import VirtualRig
    from impact_rig.testing.waiting import WaitTimeoutError

__all__ = [
    "Client",
    "Collector",
    "Fault",
    "Golden",
    "NodeProcess",
    "NotReachedError",
    "ProcessDiedError",
    "Processes",
    "RosRig",
    "ServiceFailedError",
    "SteppedRig",
    "VirtualRig",
    "WaitTimeoutError",
    "first_difference",
    "isolated_domain",
]

_LATER = {
    "Client": "client",
    "Collector": "collector",
    "Fault": "faults",
    "Golden": "golden",
    "NotReachedError": "stepped_rig",
    "RosRig": "ros_rig",
    "ServiceFailedError": "client",
    "SteppedRig": "stepped_rig",
    "VirtualRig": "virtual_rig",
    "WaitTimeoutError": "waiting",
    "first_difference": "golden",
}
"""What is imported only when it is used -> its module."""


def __getattr__(name: str) -> object:
    """Import what was asked for."""
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"impact_rig.testing.{_LATER[name]}"), name)
