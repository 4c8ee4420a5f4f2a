"""Start the rig, its analysis and its recorder under one namespace.

Examples:
    ros2 launch impact_rig rig.launch.py
    ros2 launch impact_rig rig.launch.py mode:=freewheel config:=/path/to/mine.yaml record:=false
    ros2 launch impact_rig rig.launch.py namespace:=rig2 clock:=/clock
    ros2 launch impact_rig rig.launch.py mode:=stepped peers:=analysis,recorder,my_controller
    ros2 launch impact_rig rig.launch.py lab:=true
    ros2 launch impact_rig rig.launch.py rviz:=true gap_mm:=10
    ros2 launch impact_rig rig.launch.py params:=/path/to/overrides.yaml autostart:=false
    ros2 launch impact_rig rig.launch.py --show-args
"""

import os

from launch import LaunchContext, LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    OpaqueFunction,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from impact_rig.rig.config import from_flat, load
from impact_rig.system.endings import PARENT_VARIABLE


def start_nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; a file or an argument that cannot be is refused before anything starts."""
    path = LaunchConfiguration("config").perform(context)
    mode = LaunchConfiguration("mode").perform(context)
    factor = LaunchConfiguration("factor").perform(context)
    start_wait = LaunchConfiguration("start_wait").perform(context)
    peers = [name for name in LaunchConfiguration("peers").perform(context).split(",") if name]
    given = {}  # only what was given goes on top of the file
    if mode:
        given["time.mode"] = mode
    if factor:
        given["time.factor"] = float(factor)
    if start_wait:
        given["time.start_wait_s"] = float(start_wait)
    if peers:
        given["time.peers"] = peers
    file = load(path)
    if not (peers or file.time.peers):
        # scan 0 waits for these two, and not in real time every block, so that none is lost
        given["time.peers"] = ["analysis", "recorder"]
    time = from_flat(file, given).time
    follow_rig_time = {"use_sim_time": time.is_simulated}
    common = {
        "package": "impact_rig",
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
        # rig time of two rigs is two times: each namespace has its own clock
        "remappings": [("/clock", LaunchConfiguration("clock"))],
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
        "sigterm_timeout": "15",  # seconds after Ctrl-C in which a run's file is finished
    }
    lab = LaunchConfiguration("lab").perform(context) == "true"
    return [
        *([Node(executable="lab_node", name="lab", **common)] if lab else []),
        Node(
            executable="rig_node",
            name="rig",
            parameters=[{"config_file": path, **given}],
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


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the environment and the three nodes."""
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
                default_value="",
                choices=["", "realtime", "freewheel", "stepped"],
                description="Paced by the clock, as fast as the peers follow, or by ~/step; empty: as in the file.",
            ),
            DeclareLaunchArgument(
                "factor", default_value="", description="Speed of realtime, times real time; empty: as in the file."
            ),
            DeclareLaunchArgument(
                "peers",
                default_value="",
                description="Nodes that the rig waits for, with commas between: before scan 0, and for every block "
                "when not in realtime; empty: as in the file, or else analysis,recorder.",
            ),
            DeclareLaunchArgument(
                "start_wait",
                default_value="",
                description="How long scan 0 waits for them in realtime, in seconds; empty: as in the file.",
            ),
            DeclareLaunchArgument(
                "clock",
                default_value="clock",
                description="Topic of rig time; relative: one per namespace, /clock: the one that everybody follows.",
            ),
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
                "lab",
                default_value="false",
                choices=["true", "false"],
                description="Serve the page of the live laboratory; its address is printed.",
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
            # launch ends its nodes after Ctrl-C only, not when it is told or killed otherwise: they end with it
            SetEnvironmentVariable(PARENT_VARIABLE, str(os.getpid())),
            OpaqueFunction(function=start_nodes),
        ]
    )
