"""The ROS 2 nodes: they publish what the rig, the analysis and the recorder compute, and decide nothing themselves.

Only here and in `impact_rig.testing` is rclpy imported.
"""
