# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
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
    """Publishes `dt` for every window without a gap and without a clipped sample."""

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
