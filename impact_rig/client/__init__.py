# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Client programs of a rig on ROS: node processes, a client of the rig's topics and services, and isolated domains.

    with isolated_domain() as domain_id, Processes(domain_id, logs) as processes:
        processes.start("rig", {"time.mode": "lockstep", "barriers.gap_m": 0.006})
        with Client(domain_id, processes=processes) as client:
            client.wait_active("rig")
            scans = client.collect("daq/scan")
            client.command(frequency_hz=9.1, current_a=0.52)
            client.step(blocks=100)

Importing this package does not import rclpy; rclpy is loaded with the first name that needs it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from impact_rig.client.processes import NodeProcess, ProcessDiedError, Processes, isolated_domain
from impact_rig.system import lazily

if TYPE_CHECKING:
    from impact_rig.client.client import Client, Collector, RigGoneError, ServiceFailedError, WaitTimeoutError

__all__ = [
    "Client", "Collector", "NodeProcess", "ProcessDiedError", "Processes", "RigGoneError", "ServiceFailedError",
    "WaitTimeoutError", "isolated_domain",
]  # fmt: skip

__getattr__ = lazily(
    __name__,
    needs_ros="client",
    Client="client",
    Collector="client",
    RigGoneError="client",
    ServiceFailedError="client",
    WaitTimeoutError="client",
)
