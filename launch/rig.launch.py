"""Start the rig, its analysis and its recorder under one namespace.

Examples:
    ros2 launch impact_rig rig.launch.py
    ros2 launch impact_rig rig.launch.py mode:=freewheel config:=/path/to/mine.yaml record:=false
    ros2 launch impact_rig rig.launch.py --show-args
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution, PythonExpression
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the environment and the three nodes."""
    mode, factor = LaunchConfiguration("mode"), LaunchConfiguration("factor")
    common = {
        "package": "impact_rig",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
        "sigterm_timeout": "15",  # seconds after Ctrl-C in which a run's file is finished
    }
    # the rig makes the time that the others follow, unless that is the time everybody has
    rig_makes_time = PythonExpression(["'", mode, "' != 'realtime' or float('", factor, "') != 1.0"])
    follow_rig_time = {"use_sim_time": ParameterValue(rig_makes_time, value_type=bool)}
    # not in real time, the rig waits for these two, so that no block is lost; [''] is ROS for an empty list
    peers = PythonExpression(["['analysis', 'recorder'] if '", mode, "' != 'realtime' else ['']"])

    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="rig", description="Namespace of all nodes and topics."),
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare("impact_rig"), "config", "nominal.yaml"]),
                description="Configuration file of the rig; the arguments below go on top of it.",
            ),
            DeclareLaunchArgument(
                "mode",
                default_value="realtime",
                choices=["realtime", "freewheel", "stepped"],
                description="Paced by the clock, as fast as analysis and recorder follow, or by the service ~/step.",
            ),
            DeclareLaunchArgument("factor", default_value="1.0", description="Speed of realtime, times real time."),
            DeclareLaunchArgument(
                "record",
                default_value="true",
                choices=["true", "false"],
                description="Record from the start; otherwise when the recorder's service ~/start is called.",
            ),
            DeclareLaunchArgument(
                "record_directory", default_value="runs", description="Where run directories are made."
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="Least severity of messages that are shown.",
            ),
            DeclareLaunchArgument(
                "discovery",
                default_value="LOCALHOST",
                choices=["LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"],
                description="Who can see the rig: this machine, its network, or as the environment says.",
            ),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery")),
            Node(
                executable="rig_node",
                name="rig",
                parameters=[
                    {
                        "config_file": ParameterValue(LaunchConfiguration("config"), value_type=str),
                        "time.mode": mode,
                        "time.factor": ParameterValue(factor, value_type=float),
                        "time.peers": ParameterValue(peers, value_type=list[str]),
                    }
                ],
                on_exit=Shutdown(reason="the rig has ended"),
                **common,
            ),
            Node(executable="analysis_node", name="analysis", parameters=[follow_rig_time], **common),
            Node(
                executable="recorder_node",
                name="recorder",
                parameters=[
                    follow_rig_time,
                    {
                        "directory": ParameterValue(LaunchConfiguration("record_directory"), value_type=str),
                        "record": ParameterValue(LaunchConfiguration("record"), value_type=bool),
                    },
                ],
                **common,
            ),
        ]
    )
