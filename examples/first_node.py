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
"""A first node: drive the rig at 9.1 Hz and 0.52 A, and log what the analysis measures.

python first_node.py --ros-args -r __ns:=/rig
"""

import rclpy
from pointcloud import columns
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64

FREQUENCY_HZ, CURRENT_A = 9.1, 0.52


class FirstNode(Node):
    """Sends commands until the rig confirms them, and keeps every transmissibility it receives."""

    def __init__(self):
        super().__init__("first")
        self.received = []
        self.frequency = self.create_publisher(Float64, "shaker/frequency", 10)
        self.current = self.create_publisher(Float64, "shaker/current", 10)
        self.create_subscription(PointCloud2, "shaker/applied", self.on_applied, 10)
        self.create_subscription(Float64, "transmissibility", self.on_transmissibility, 10)
        self.timer = self.create_timer(0.5, self.drive)

    def drive(self):
        """Send both commands, again every 0.5 s: one sent before the rig has discovered this node is lost."""
        self.frequency.publish(Float64(data=FREQUENCY_HZ))
        self.current.publish(Float64(data=CURRENT_A))

    def on_applied(self, message):
        last = columns(message)[-1]
        if last["frequency"] == FREQUENCY_HZ and last["current"] == CURRENT_A:
            self.timer.cancel()

    def on_transmissibility(self, message):
        self.received.append(message.data)
        self.get_logger().info(f"DT = {message.data:.2f}")


def main():
    rclpy.init()
    try:
        rclpy.spin(FirstNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
