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
    """Return one rig, its arguments kept to itself."""
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
    """Return the arguments and the two rigs."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("first", default_value="rig1", description="Namespace of the first rig."),
            DeclareLaunchArgument("second", default_value="rig2", description="Namespace of the second rig."),
            DeclareLaunchArgument(
                "first_overrides", default_value="{}", description="Parameters of the first rig, as YAML."
            ),
            DeclareLaunchArgument(
                "second_overrides",
                default_value="{daq.seed: 2}",
                description="Parameters of the second rig, as YAML; another seed is another set of instruments.",
            ),
            DeclareLaunchArgument("mode", default_value="", description="As in rig.launch.py, for both."),
            DeclareLaunchArgument("factor", default_value="", description="As in rig.launch.py, for both."),
            DeclareLaunchArgument("record", default_value="true", description="As in rig.launch.py, for both."),
            DeclareLaunchArgument(
                "record_directory",
                default_value="runs",
                description="Directory in which run directories are created, with a folder for each rig.",
            ),
            DeclareLaunchArgument("log_level", default_value="info", description="As in rig.launch.py, for both."),
            DeclareLaunchArgument("discovery", default_value="LOCALHOST", description="As in rig.launch.py."),
            rig("first"),
            rig("second"),
        ]
    )
