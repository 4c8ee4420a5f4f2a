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
"""Program `ros2 run impact_rig lab_node`: it serves the page of the laboratory for a rig in the same namespace.

Modules that take long to import are imported only after the signal handlers and the watch on the parent process are set
up. The program can therefore be ended at any time.
"""

from __future__ import annotations

import sys
import time

from impact_rig.nodes.__main__ import begin
from impact_rig.system.endings import Ending

WATCH_S = 0.2
USE = (
    "Web page of the laboratory for the rig in the same namespace; prints the address of the page.",
    "port:=8765",
    "`impact-rig lab` starts a rig as well.",
)


def main() -> None:
    """Run the program: serve the page until a signal ends it.

    The end of the launch file of this project, or of the `impact_rig.client.Processes`, that started the program also
    ends it.
    """
    begin("lab", USE, lambda ending: sys.exit(ending.run(lambda: _serve(ending), interrupting=False)))


def _serve(ending: Ending) -> int:
    from impact_rig.errors import ImpactRigError  # noqa: PLC0415
    from impact_rig.system.extras import load, load_ros  # noqa: PLC0415

    try:
        load_ros("impact_rig.client.client", "lab_node")
        load("impact_rig_lab.server", "lab_node", "lab")
        from impact_rig_lab.live import LiveSource  # noqa: PLC0415
        from impact_rig_lab.server import Server, kept_token  # noqa: PLC0415

        domain_id, namespace, host, port = _settings()
        source = LiveSource(domain_id, namespace)
        with Server(source, host, port, kept_token()) as server, source:
            print(f"lab: {server.address}", flush=True)  # noqa: T201  # the address is the purpose of this program
            while not ending.received:
                time.sleep(WATCH_S)
    except ImpactRigError as error:
        print(f"lab_node: {error}", file=sys.stderr)  # noqa: T201
        return 1
    return 0


def _settings() -> tuple[int, str, str, int]:
    """Return ROS domain, namespace, and the parameters `host` and `port` of the page, from the ROS arguments."""
    from rclpy.context import Context  # noqa: PLC0415
    from rclpy.node import Node  # noqa: PLC0415

    from impact_rig_lab.server import LOOPBACK, PORT  # noqa: PLC0415

    context = Context()
    context.init(args=sys.argv)
    node = Node("lab", context=context, enable_rosout=False, start_parameter_services=False)
    try:
        host = node.declare_parameter("host", LOOPBACK).value
        port = node.declare_parameter("port", PORT).value
        return context.get_domain_id(), node.get_namespace(), str(host), int(port)
    finally:
        node.destroy_node()
        context.try_shutdown()


if __name__ == "__main__":
    main()
