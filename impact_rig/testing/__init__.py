"""For tests and programs that use the rig: an isolated ROS domain, node processes, a client that waits on conditions.

    with isolated_domain() as domain_id, Processes(domain_id, logs) as processes:
        processes.start("rig", {"time.mode": "stepped", "barriers.gap_m": 0.006})
        with Client(domain_id, processes=processes) as client:
            client.wait_active("rig")
            scans = client.collect("daq/scan")
            client.command(frequency_hz=9.1, current_a=0.52)
            client.step(blocks=100)

`isolated_domain` and `Processes` work without rclpy; `Client` is imported when it is first asked for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rig.testing.domain import isolated_domain
from impact_rig.testing.processes import NodeProcess, ProcessDiedError, Processes

if TYPE_CHECKING:
    from impact_rig.testing.client import Client, ServiceFailedError, WaitTimeoutError
    from impact_rig.testing.collector import Collector

__all__ = [
    "Client",
    "Collector",
    "NodeProcess",
    "ProcessDiedError",
    "Processes",
    "ServiceFailedError",
    "WaitTimeoutError",
    "isolated_domain",
]


def __getattr__(name: str) -> object:
    """Import what needs rclpy only when it is used."""
    if name in ("Client", "ServiceFailedError", "WaitTimeoutError"):
        from impact_rig.testing import client  # noqa: PLC0415  # see the docstring

        return getattr(client, name)
    if name == "Collector":
        from impact_rig.testing.collector import Collector  # noqa: PLC0415  # see the docstring

        return Collector
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
