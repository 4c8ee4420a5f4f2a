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
"""Launch file of the rig, its analysis and its recorder under one namespace, optionally with TF and RViz.

Examples of its use::

    ros2 launch impact_rig rig.launch.py
    ros2 launch impact_rig rig.launch.py mode:=free_running config:=/path/to/mine.yaml record:=false
    ros2 launch impact_rig rig.launch.py overrides:='{barriers.gap_m: 0.004, daq.seed: 7}' autostart:=false
    ros2 launch impact_rig rig.launch.py namespace:=rig2 clock:=/clock
    ros2 launch impact_rig rig.launch.py enclave:=/rig
    ros2 launch impact_rig rig.launch.py mode:=lockstep peers:=analysis,recorder,my_controller
    ros2 launch impact_rig rig.launch.py lab:=true
    ros2 launch impact_rig rig.launch.py rviz:=true
    ros2 launch impact_rig rig.launch.py --show-args
"""

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from impact_rig import graph
from impact_rig.config.tree import flatten
from impact_rig.errors import ConfigError
from impact_rig.rig.config import RigConfig, from_flat, load_config
from impact_rig.rig.description import ROOT, robot_description
from impact_rig.system import budget
from impact_rig.system.endings import PARENT_VARIABLE
from impact_rig.system.files import share_dir

LONGEST_OVERRIDES = 100_000


PARAMETERS = {
    "mode": "time.mode",
    "factor": "time.factor",
    "start_wait": "time.start_wait_s",
    "autostart": "output.autostart",
    "frame_prefix": "output.frame_prefix",
    "peers": "time.peers",
}
"""Parameter of the rig that an argument sets."""
ROBOT_STATE_PUBLISHER = "robot_state_publisher"
NODES = (*(node.name for node in graph.NODES if node.name != "stepped_sine"), "lab", "rviz", ROBOT_STATE_PUBLISHER)


def text(context: LaunchContext, name: str) -> str:
    """Return the value of a launch argument as text."""
    return LaunchConfiguration(name).perform(context)


def number(context: LaunchContext, name: str) -> float:
    """Return the value of a launch argument that is a number.

    Raises:
        ConfigError: it is not a number; the message names the argument.
    """
    try:
        return float(text(context, name))
    except ValueError:
        raise ConfigError(f"launch argument {name}:={text(context, name)} must be a number, such as 0.5") from None


def is_true(context: LaunchContext, name: str) -> bool:
    """Return whether the value of a launch argument, `true` or `false`, is `true`."""
    return text(context, name) == "true"


def names_in(context: LaunchContext, name: str) -> list[str]:
    """Return the names in a launch argument, separated by commas and possibly blanks."""
    return [part.strip() for part in text(context, name).split(",") if part.strip()]


def parameters_of_rig(context: LaunchContext, file: RigConfig) -> dict[str, Any]:
    """Return the parameters of the rig, by full name, which replace values of its configuration file.

    They come from `overrides`, then from arguments of their own. If neither these nor the file name peers, the peers
    are the analysis and the recorder.
    """
    given = overrides(context)
    for name, read in (("mode", text), ("factor", number), ("start_wait", number), ("autostart", is_true)):
        if text(context, name):
            given[PARAMETERS[name]] = read(context, name)
    if text(context, "frame_prefix") != "auto":
        given["output.frame_prefix"] = text(context, "frame_prefix") or "/"
    peers = names_in(context, "peers")
    if peers:
        given["time.peers"] = peers
    elif not file.time.peers and "time.peers" not in given:
        # scan 0 waits for these two; unless in real time, every block does, so that none is lost
        given["time.peers"] = ["analysis", "recorder"]
    return given


def overrides(context: LaunchContext) -> dict[str, Any]:
    """Return the parameters in the argument `overrides`, by full name.

    Raises:
        ConfigError: the argument is not a YAML mapping.
    """
    try:
        found: dict[str, Any] = flatten(budget.load_yaml(text(context, "overrides"), LONGEST_OVERRIDES) or {})
    except (budget.PlainYamlError, ConfigError) as error:
        raise ConfigError(
            f"launch argument overrides must be a YAML mapping, such as {{barriers.gap_m: 0.004}}: {error}"
        ) from None
    return found


def configuration_file(context: LaunchContext) -> tuple[str, RigConfig]:
    """Return the path of the configuration file, and the configuration in it.

    Raises:
        ConfigError: the file cannot be read, or has an invalid value; the message names argument and file.
    """
    path = text(context, "config")
    try:
        return path, load_config(path)
    except ConfigError as error:
        raise ConfigError(f"launch argument config: {error}") from None


def configured(context: LaunchContext, file: RigConfig, given: dict[str, Any]) -> RigConfig:
    """Return the configuration of the rig: that of the file with the parameters `given`.

    Raises:
        ConfigError: a value is invalid; the message names the launch argument to change.
    """
    try:
        return from_flat(file, given)
    except ConfigError as error:
        given_names = [name for name in PARAMETERS if text(context, name) not in ("", "auto")]
        wrong = [name for name in given_names if PARAMETERS[name] in str(error)]
        name = wrong[0] if wrong else "overrides"
        raise ConfigError(f"launch argument {name}:={text(context, name)}: {error}") from None


def namespace_of(context: LaunchContext) -> str:
    """Return the full namespace of the nodes: the argument, relative to any group with PushRosNamespace."""
    return graph.resolve(text(context, "namespace"), context.launch_configurations.get("ros_namespace", ""))


def required_nodes(context: LaunchContext) -> list[str]:
    """Return the nodes whose end also ends the others.

    Raises:
        ConfigError: a name in the argument `required` is not that of a node.
    """
    names = names_in(context, "required")
    unknown = sorted(set(names) - set(NODES))
    if unknown:
        raise ConfigError(f"launch argument required: no node {', '.join(unknown)}; nodes are {', '.join(NODES)}")
    return names


def end_with(name: str) -> Callable[[Any, LaunchContext], Shutdown | None]:
    """Make a handler that ends all nodes after the end of one, unless they are ending already."""
    return lambda _event, context: None if context.is_shutdown else Shutdown(reason=f"{name} has ended")


def rviz_file(prefix: str) -> str:
    """Write an RViz configuration with this prefix of the frame names into a new temporary folder; return its path."""
    text = (share_dir() / "rviz" / "impact_rig.rviz").read_text(encoding="utf-8")
    text = text.replace("FIXED_FRAME", f"{prefix}{ROOT}").replace("FRAME_PREFIX", prefix.rstrip("/") or '""')
    path = Path(tempfile.mkdtemp(prefix="impact_rig_")) / "impact_rig.rviz"
    path.write_text(text, encoding="utf-8")
    return str(path)


def start_nodes(context: LaunchContext) -> list[Node]:
    """Return the nodes to start.

    Raises:
        ConfigError: the configuration file or an argument is invalid; then nothing starts.
    """
    path, file = configuration_file(context)
    given = parameters_of_rig(context, file)
    config = configured(context, file, given)
    follow_rig_time = {"use_sim_time": config.time.is_simulated}
    autostart = {"autostart": config.output.autostart}
    required = required_nodes(context)
    seen = {name: is_true(context, name) for name in ("plot", "lab", "rviz", "state_publisher")}
    clock = graph.clock_remapping(text(context, "clock"))
    prefix = graph.frame_prefix(namespace_of(context), config.output.frame_prefix)
    enclave = text(context, "enclave")

    def node(name: str, remappings: tuple[tuple[str, str], ...] = (), **more: Any) -> Node:
        ros_arguments = ["--log-level", LaunchConfiguration("log_level")]
        if enclave:
            ros_arguments += ["--enclave", graph.resolve(name, enclave)]
        return Node(
            name=name,
            namespace=LaunchConfiguration("namespace"),
            output="screen",
            ros_arguments=ros_arguments,
            remappings=[clock, *remappings],
            **({"on_exit": end_with(name)} if name in required else {}),
            **more,
        )

    def ours(name: str, **more: Any) -> Node:
        # after Ctrl-C the recorder finishes the file of its run
        return node(name, package="impact_rig", executable=f"{name}_node", sigterm_timeout="15", **more)

    recording = {
        "directory": ParameterValue(LaunchConfiguration("record_directory"), value_type=str),
        "record": ParameterValue(LaunchConfiguration("record"), value_type=bool),
    }
    nodes = [
        ours("rig", parameters=[{"config_file": path, **given}]),
        ours("analysis", parameters=[follow_rig_time, autostart]),
        ours("recorder", parameters=[follow_rig_time, autostart, recording]),
    ]
    if seen["plot"]:
        nodes.append(ours("plot", parameters=[follow_rig_time, autostart]))
    if seen["lab"]:
        nodes.append(ours("lab"))
    if seen["rviz"] or seen["state_publisher"]:
        description = ParameterValue(robot_description(config), value_type=str)
        bodies = {"robot_description": description, "frame_prefix": prefix, "publish_frequency": 200.0}
        nodes.append(
            node(
                ROBOT_STATE_PUBLISHER,
                graph.STATE_PUBLISHER_REMAPPINGS,
                package=ROBOT_STATE_PUBLISHER,
                executable=ROBOT_STATE_PUBLISHER,
                parameters=[follow_rig_time, bodies],
            )
        )
    if seen["rviz"]:
        arguments = ["-d", rviz_file(prefix)]
        nodes.append(
            node("rviz", package="rviz2", executable="rviz2", arguments=arguments, parameters=[follow_rig_time])
        )
    return nodes


def generate_launch_description() -> LaunchDescription:
    """Return the launch description: arguments with their help, environment variables, and the nodes."""
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="rig", description="Namespace of all nodes and topics."),
            DeclareLaunchArgument(
                "config",
                default_value=PathJoinSubstitution([FindPackageShare("impact_rig"), "config", "nominal.yaml"]),
                description="Configuration file of the rig (YAML); the arguments below override its values.",
            ),
            DeclareLaunchArgument(
                "overrides",
                default_value="{}",
                description="Parameters of the rig that override the configuration file, as YAML: "
                "'{barriers.gap_m: 0.004}'.",
            ),
            DeclareLaunchArgument(
                "mode",
                default_value="",
                choices=["", "realtime", "free_running", "lockstep"],
                description="Pace of rig time: realtime follows the clock, free_running goes as fast as the peers "
                "acknowledge, lockstep advances by calls of ~/step. Empty: as in the configuration file.",
            ),
            DeclareLaunchArgument(
                "factor",
                default_value="",
                description="Speed of mode realtime as a multiple of real time; empty: as in the configuration file.",
            ),
            DeclareLaunchArgument(
                "peers",
                default_value="",
                description="Nodes that the rig waits for, separated by commas: before scan 0, and in the modes "
                "free_running and lockstep for every block. Empty: as in the configuration file, or, if that names "
                "none, analysis,recorder.",
            ),
            DeclareLaunchArgument(
                "start_wait",
                default_value="",
                description="Longest wait for the peers before scan 0 in mode realtime [s]; empty: as in the "
                "configuration file.",
            ),
            DeclareLaunchArgument(
                "autostart",
                default_value="",
                choices=["", "true", "false"],
                description="Whether all nodes configure and activate themselves; false: they wait for requests to "
                "their lifecycle services. Empty: as in the configuration file.",
            ),
            DeclareLaunchArgument(
                "required",
                default_value="rig,analysis,recorder",
                description="Nodes whose end also ends all others, separated by commas; empty: none.",
            ),
            DeclareLaunchArgument(
                "clock",
                default_value="clock",
                description="Topic of rig time: relative to the namespace, so that each rig has its own, or /clock "
                "for all.",
            ),
            DeclareLaunchArgument(
                "record",
                default_value="true",
                choices=["true", "false"],
                description="Whether to record from the start; false: from the recorder's service ~/start on.",
            ),
            DeclareLaunchArgument(
                "record_directory",
                default_value="runs",
                description="Directory in which the directory of each run is created, relative to the present one.",
            ),
            DeclareLaunchArgument(
                "plot",
                default_value="true",
                choices=["true", "false"],
                description="Whether to start the plot node, which publishes the topics for plotters, plot/...",
            ),
            DeclareLaunchArgument(
                "lab",
                default_value="false",
                choices=["true", "false"],
                description="Whether to serve the page of the live laboratory; its address is printed.",
            ),
            DeclareLaunchArgument(
                "state_publisher",
                default_value="false",
                choices=["true", "false"],
                description="Whether to publish the rig's bodies to TF with robot_state_publisher.",
            ),
            DeclareLaunchArgument(
                "rviz",
                default_value="false",
                choices=["true", "false"],
                description="Whether to show the rig in RViz; this also starts robot_state_publisher.",
            ),
            DeclareLaunchArgument(
                "frame_prefix",
                default_value="auto",
                description="Prefix of all tf frames; auto: as in the configuration file, or, if that names none, the "
                "namespace and a slash. Empty: no prefix.",
            ),
            DeclareLaunchArgument(
                "enclave",
                default_value="",
                description="SROS2 enclave that contains those of the nodes: with /rig, the analysis has the enclave "
                "/rig/analysis. Empty: no enclaves.",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                choices=["debug", "info", "warn", "error", "fatal"],
                description="Least severity of the log messages that are shown.",
            ),
            DeclareLaunchArgument(
                "discovery",
                default_value="LOCALHOST",
                choices=["LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"],
                description="Range in which nodes find each other: this machine, its network, or as the middleware's "
                "own configuration says.",
            ),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery")),
            # launch ends its nodes after Ctrl-C only; if it is terminated or killed otherwise, they end with it
            SetEnvironmentVariable(PARENT_VARIABLE, str(os.getpid())),
            OpaqueFunction(function=start_nodes),
        ]
    )
