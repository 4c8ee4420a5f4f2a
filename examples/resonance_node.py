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
"""Example (b), the controller: finds the resonance by phase and holds it, closed over the topics.

Below resonance the structure follows the base, above it moves against it, at resonance it lags a quarter of a cycle:
the real part of X_b / X_1 is 1 - (f / f_n)^2, which passes through zero there. The controller moves the frequency by
half of the difference that this ratio states, waits until the rig has applied its command and settled (1.5 s), and
measures again.
"""

import numpy as np
import rclpy
from lockin import LockIn
from pointcloud import columns, stamp_ns
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Float64

KEPT = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)  # also messages from before this node started
GAIN = 0.5
LOWEST_HZ, HIGHEST_HZ = 6.0, 12.0


class ResonanceNode(Node):
    """Commands `shaker/frequency`, between 6 and 12 Hz; publishes its phase error [rad], 0 at resonance."""

    def __init__(self):
        super().__init__("resonance")
        self.lockin = None
        self.rate_hz = 0.0
        self.delay = []
        self.frequency_hz = None
        self.begin_ns = None  # when the command under way acts; None: not known yet
        self.commands = self.create_publisher(Float64, "shaker/frequency", 10)
        self.errors = self.create_publisher(Float64, "phase_error", 10)
        self.create_subscription(PointCloud2, "daq/info", self.on_info, KEPT)
        self.create_subscription(PointCloud2, "shaker/applied", self.on_applied, KEPT)
        self.create_subscription(PointCloud2, "daq/scan", self.on_scan, 100)

    def on_info(self, message):
        """Learn how late each channel is: the sensor's lag, and its turn in the multiplexer."""
        rows = columns(message)
        self.rate_hz = float(rows["rate"][0])
        self.delay = [(row["lag"], row["skew"]) for name in (b"laser", b"base") for row in rows[rows["name"] == name]]

    def on_applied(self, message):
        row = columns(message)[-1]
        if row["frequency"] == self.frequency_hz or self.frequency_hz is None:
            self.frequency_hz = float(row["frequency"])
            self.begin_ns = stamp_ns(message)
            self.lockin = None

    def on_scan(self, message):
        if self.begin_ns is None or stamp_ns(message) < self.begin_ns or not self.delay:
            return
        if self.lockin is None:
            self.lockin = LockIn(self.frequency_hz, self.rate_hz, cycles=6, settle_s=1.5)
        for ratio in self.lockin.feed(stamp_ns(message), columns(message))[:1]:
            self.control(ratio * self.correction())

    def correction(self):
        omega = 2 * np.pi * self.frequency_hz
        laser, base = (np.exp(-1j * omega * skew) / (1 + 1j * omega * lag) for lag, skew in self.delay)
        return base / laser

    def control(self, ratio):
        self.errors.publish(Float64(data=float(np.angle(1j * ratio))))
        detuning = min((1 / ratio).real, 0.5)
        wanted = self.frequency_hz / np.sqrt(1 - GAIN * detuning)
        self.frequency_hz = float(np.clip(wanted, LOWEST_HZ, HIGHEST_HZ))
        self.begin_ns = None
        self.commands.publish(Float64(data=self.frequency_hz))


def main():
    rclpy.init()
    try:
        rclpy.spin(ResonanceNode())
    except (KeyboardInterrupt, ExternalShutdownException):
        pass


if __name__ == "__main__":
    main()
