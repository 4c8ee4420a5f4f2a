# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Start the rig, its analysis and its recorder under one namespace; on request its bodies in TF and RViz.

Examples:
    ros2 launch impact_rig rig.launch.py
    ros2 launch impact_rig rig.launch.py mode:=freewheel config:=/path/to/mine.yaml record:=false
    ros2 launch impact_rig rig.launch.py overrides:='{barriers.gap_m: 0.004, daq.seed: 7}' autostart:=false
    ros2 launch impact_rig rig.launch.py namespace:=rig2 clock:=/clock
    ros2 launch impact_rig rig.launch.py mode:=stepped peers:=analysis,recorder,my_controller
    ros2 launch impact_rig rig.launch.py lab:=true
    ros2 launch impact_rig rig.launch.py rviz:=true
    ros2 launch impact_rig rig.launch.py --show-args
"""

import os
import tempfile
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from impact_rig.config.tree import flatten
from impact_rig.rig.config import RigConfig, from_flat, load
from impact_rig.rig.description import ROOT, robot_description
from impact_rig.system import budget
from impact_rig.system.endings import PARENT_VARIABLE
from impact_rig.system.files import share_dir

LONGEST_OVERRIDES = 100_000


def parameters_of_rig(context: LaunchContext, file: RigConfig) -> dict[str, Any]:
    """Return what the arguments put on top of the file: only what was given."""

    def word(name: str) -> str:
        return LaunchConfiguration(name).perform(context)

    given: dict[str, Any] = flatten(budget.load_yaml(word("overrides"), LONGEST_OVERRIDES) or {})
    if word("mode"):
        given["time.mode"] = word("mode")
    if word("factor"):
        given["time.factor"] = float(word("factor"))
    if word("start_wait"):
        given["time.start_wait_s"] = float(word("start_wait"))
    if word("autostart"):
        given["output.autostart"] = word("autostart") == "true"
    given["output.frame_prefix"] = frame_prefix(context)
    peers = names_in(word("peers"))
    if peers:
        given["time.peers"] = peers
    elif not file.time.peers and "time.peers" not in given:
        # scan 0 waits for these two, and not in real time every block, so that none is lost
        given["time.peers"] = ["analysis", "recorder"]
    return given


def names_in(text: str) -> list[str]:
    """Return names with commas between, and perhaps blanks."""
    return [name.strip() for name in text.split(",") if name.strip()]


def frame_prefix(context: LaunchContext) -> str:
    """Return what stands before the frames: the namespace, unless something else is asked for."""
    given = LaunchConfiguration("frame_prefix").perform(context)
    namespace = LaunchConfiguration("namespace").perform(context).strip("/")
    return given if given != "auto" else f"{namespace}/" if namespace else ""


def rviz_file(prefix: str) -> str:
    """Return the path of the RViz configuration with the frames as they are called in this namespace."""
    text = (share_dir() / "rviz" / "impact_rig.rviz").read_text(encoding="utf-8")
    text = text.replace("FIXED_FRAME", f"{prefix}{ROOT}").replace("FRAME_PREFIX", prefix.rstrip("/") or '""')
    path = Path(tempfile.mkdtemp(prefix="impact_rig_")) / "impact_rig.rviz"
    path.write_text(text, encoding="utf-8")
    return str(path)


def start_nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes; a file or an argument that cannot be is refused before anything starts."""
    path = LaunchConfiguration("config").perform(context)
    file = load(path)
    given = parameters_of_rig(context, file)
    config = from_flat(file, given)
    follow_rig_time = {"use_sim_time": config.time.is_simulated}
    autostart = {"autostart": config.output.autostart}
    required = names_in(LaunchConfiguration("required").perform(context))
    seen = {name: LaunchConfiguration(name).perform(context) == "true" for name in ("lab", "rviz", "state_publisher")}
    common: dict[str, Any] = {
        "namespace": LaunchConfiguration("namespace"),
        "output": "screen",
        "ros_arguments": ["--log-level", LaunchConfiguration("log_level")],
    }
    # rig time of two rigs is two times: each namespace has its own clock
    clock = ("/clock", LaunchConfiguration("clock"))
    ours: dict[str, Any] = {
        **common,
        "package": "impact_rig",
        "remappings": [clock],
        "sigterm_timeout": "15",  # seconds after Ctrl-C in which a run's file is finished
    }

    def ends(name: str) -> dict[str, Any]:
        return {"on_exit": Shutdown(reason=f"{name} has ended")} if name in required else {}

    nodes = [
        Node(executable="rig_node", name="rig", parameters=[{"config_file": path, **given}], **ends("rig"), **ours),
        Node(
            executable="analysis_node",
            name="analysis",
            parameters=[follow_rig_time, autostart],
            **ends("analysis"),
            **ours,
        ),
        Node(
            executable="recorder_node",
            name="recorder",
            parameters=[
                follow_rig_time,
                autostart,
                {
                    "directory": ParameterValue(LaunchConfiguration("record_directory"), value_type=str),
                    "record": ParameterValue(LaunchConfiguration("record"), value_type=bool),
                },
            ],
            **ends("recorder"),
            **ours,
        ),
    ]
    if seen["lab"]:
        nodes.append(Node(executable="lab_node", name="lab", **ours))
    prefix = config.output.frame_prefix
    if seen["rviz"] or seen["state_publisher"]:
        nodes.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                name="robot_state_publisher",
                parameters=[
                    follow_rig_time,
                    {
                        "robot_description": ParameterValue(robot_description(config), value_type=str),
                        "frame_prefix": prefix,
                        "publish_frequency": 200.0,
                    },
                ],
                remappings=[
                    clock,
                    ("joint_states", "truth/joint_states"),
                    # the rig's own follows its gap, and nobody else may say what it looks like
                    ("robot_description", "robot_state_publisher/robot_description"),
                ],
                **common,
            )
        )
    if seen["rviz"]:
        nodes.append(
            Node(
                package="rviz2",
                executable="rviz2",
                name="rviz",
                arguments=["-d", rviz_file(prefix)],
                parameters=[follow_rig_time],
                remappings=[clock],
                **common,
            )
        )
    return nodes


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the environment and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="rig", description="Namespace of all nodes and topics."),
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare("impact_rig"), "config", "nominal.yaml"]),
                description="Configuration file of the rig; the arguments below go on top of it.",
            ),
            DeclareLaunchArgument(
                "overrides",
                default_value="{}",
                description="Parameters of the rig on top of the file, as YAML: '{barriers.gap_m: 0.004}'.",
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
                "autostart",
                default_value="",
                choices=["", "true", "false"],
                description="Configure and activate all nodes at once; false: their lifecycle services do. Empty: as "
                "in the file.",
            ),
            DeclareLaunchArgument(
                "required",
                default_value="rig,analysis,recorder",
                description="Nodes whose end ends the others, with commas between.",
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
                "state_publisher",
                default_value="false",
                choices=["true", "false"],
                description="Publish the rig's bodies to TF with robot_state_publisher.",
            ),
            DeclareLaunchArgument(
                "rviz",
                default_value="false",
                choices=["true", "false"],
                description="Show the rig in RViz, with robot_state_publisher.",
            ),
            DeclareLaunchArgument(
                "frame_prefix",
                default_value="auto",
                description="Put before all frames; auto: the namespace and a slash.",
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
