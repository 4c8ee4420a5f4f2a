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
"""Example (a), the pipeline: subscriber -> filter -> displacement transmissibility, as a node of its own.

python dt_node.py --ros-args -p frequency_hz:=9.1
"""

import rclpy
from lockin import LockIn
from pointcloud import columns, stamp_ns
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64


class DtNode(Node):
    """Publishes `dt`, a transmissibility, for each window of 9 cycles without a gap and without a clipped sample."""

    def __init__(self):
        super().__init__("dt")
        self.frequency_hz = self.declare_parameter("frequency_hz", 9.1).value
        self.lockin = None
        self.publisher = self.create_publisher(Float64, "dt", 10)
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 10)

    def on_scan(self, message):
        rows = columns(message)
        if self.lockin is None:
            self.lockin = LockIn(self.frequency_hz, 1.0 / (rows["time"][1] - rows["time"][0]))
        for ratio in self.lockin.feed(stamp_ns(message), rows):
            self.publisher.publish(Float64(data=abs(ratio)))


def main():
    rclpy.init()
    try:
        rclpy.spin(DtNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
