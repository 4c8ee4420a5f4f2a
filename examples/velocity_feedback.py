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
"""A controller as a node: each block of scans is answered with a block of current that damps the superior base.

python velocity_feedback.py --ros-args -r __ns:=/rig
"""

import numpy as np
import rclpy
from pointcloud import columns, stamp_ns
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, PointField

GAIN_A_S_M, AHEAD_NS = 5.0, 40_000_000


class VelocityFeedback(Node):
    """Answers each block of scans with a sine of 0.1 A, minus a current in proportion to the velocity in the block.

    The first sample of an answer is played 40 ms after the first scan of its block.
    """

    def __init__(self):
        super().__init__("velocity_feedback")
        self.sent = 0
        self.output = self.create_publisher(PointCloud2, "shaker/waveform", 100)
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 100)

    def on_scan(self, message):
        if self.output.get_subscription_count() < self.count_subscribers("shaker/waveform"):
            return  # the recorder, perhaps: it would miss the first samples
        rows, start_ns = columns(message), stamp_ns(message) + AHEAD_NS
        velocity = np.polyfit(rows["time"], rows["laser"], 1)[0]
        t = (start_ns % 10**12) * 1e-9 + rows["time"]  # samples and scans have one rate here
        self.play(start_ns, 0.1 * np.sin(2 * np.pi * 9.1 * t) - GAIN_A_S_M * velocity)

    def play(self, start_ns, values):
        """Publish samples from an instant of rig time on."""
        message = PointCloud2(height=1, width=len(values), point_step=8, row_step=8 * len(values), is_dense=True)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(start_ns, 10**9)
        message.fields = [PointField(name="value", offset=0, datatype=PointField.FLOAT64, count=1)]
        message.data = values.astype("<f8").tobytes()
        self.output.publish(message)
        self.sent += len(values)


def main():
    rclpy.init()
    try:
        rclpy.spin(VelocityFeedback())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
