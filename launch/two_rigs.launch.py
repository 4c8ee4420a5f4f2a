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
"""Launch file of two independent rigs, each with its own namespace and clock.

Examples of its use::

    ros2 launch impact_rig two_rigs.launch.py
    ros2 launch impact_rig two_rigs.launch.py first:=left second:=right mode:=free_running
    ros2 launch impact_rig two_rigs.launch.py second_overrides:='{barriers.gap_m: 0.01}' record:=false
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.substitutions import FindPackageShare

FORWARDED = ("mode", "factor", "record", "log_level", "discovery")
"""Arguments of rig.launch.py that are passed to both rigs."""


def rig(which: str) -> GroupAction:
    """Return the actions that start the rig `which` (first or second), with its arguments kept to itself."""
    arguments = {name: LaunchConfiguration(name) for name in FORWARDED}
    return GroupAction(
        [
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(
                    PathJoinSubstitution([FindPackageShare("impact_rig"), "launch", "rig.launch.py"])
                ),
                launch_arguments={
                    **arguments,
                    "namespace": LaunchConfiguration(which),
                    "overrides": LaunchConfiguration(f"{which}_overrides"),
                    "record_directory": PathJoinSubstitution(
                        [LaunchConfiguration("record_directory"), LaunchConfiguration(which)]
                    ),
                    "clock": "clock",
                }.items(),
            )
        ],
        scoped=True,
    )


def generate_launch_description() -> LaunchDescription:
    """Return the launch description: arguments with their help, and the two rigs."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("first", default_value="rig1", description="Namespace of the first rig."),
            DeclareLaunchArgument("second", default_value="rig2", description="Namespace of the second rig."),
            DeclareLaunchArgument(
                "first_overrides",
                default_value="{}",
                description="Parameters of the first rig, as YAML: '{barriers.gap_m: 0.004}'.",
            ),
            DeclareLaunchArgument(
                "second_overrides",
                default_value="{daq.seed: 2}",
                description="Parameters of the second rig, as YAML; another seed is another set of instruments.",
            ),
            DeclareLaunchArgument(
                "mode",
                default_value="",
                description="Pace of both rigs: realtime, free_running or lockstep; empty: as in config/nominal.yaml.",
            ),
            DeclareLaunchArgument(
                "factor",
                default_value="",
                description="Speed of both rigs in mode realtime as a multiple of real time; empty: 1.",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="true",
                description="Whether both recorders record from the start; false: from calls of ~/start on.",
            ),
            DeclareLaunchArgument(
                "record_directory",
                default_value="runs",
                description="Directory in which each rig gets a folder, named like its namespace, for its run "
                "directories.",
            ),
            DeclareLaunchArgument(
                "log_level", default_value="info", description="Least severity of the log messages that are shown."
            ),
            DeclareLaunchArgument(
                "discovery",
                default_value="LOCALHOST",
                description="Range in which nodes find each other: LOCALHOST, SUBNET or SYSTEM_DEFAULT.",
            ),
            rig("first"),
            rig("second"),
        ]
    )
