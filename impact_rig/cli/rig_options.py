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
"""Evaluation of the options of a command that drives a rig: rig configuration, where the rig runs, run directory."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from impact_rig.cli.options import PROCESS, RUNNING, running_namespace
from impact_rig.client.processes import domain_of_environment
from impact_rig.errors import ConfigError, ImpactRigError
from impact_rig.rig.config import RigConfig, from_flat, load_config
from impact_rig.rig.gaps import NO_SPHERE, gap_values
from impact_rig.system.files import free_path

if TYPE_CHECKING:
    from impact_rig.driver import RigDriver


def rig_of(arguments: argparse.Namespace) -> tuple[RigConfig, float]:
    """Return the configuration of the rig that the options of `add_rig` describe, and its gap [m] (0 without a sphere).

    With `--through running`, the result is the default configuration, which does not describe the running rig.

    Raises:
        ConfigError: the file or an option is invalid, or an option would change a running rig.
    """
    refuse_for_running(arguments, "config", "gap", "sphere_start")
    config = load_config(arguments.config) if arguments.config else RigConfig()
    changes: dict[str, object] = {} if arguments.gap is None else dict(gap_values(arguments.gap))
    if arguments.sphere_start:
        changes["sphere.start"] = arguments.sphere_start
    config = from_flat(config, changes)
    return config, config.barriers.gap_m if config.sphere.present else NO_SPHERE


def refuse_for_running(arguments: argparse.Namespace, *names: str) -> None:
    """Raise an error if an option that describes a rig to start is given for a running rig.

    Args:
        arguments: parsed arguments, including those of `add_rig`.
        names: names of these options in `arguments`, such as `sphere_start` for `--sphere-start`.

    Raises:
        ConfigError: one of the options was given with `--through running`.
    """
    for name in names if arguments.through == RUNNING else ():
        if getattr(arguments, name) is not None:
            raise ConfigError(
                f"--{name.replace('_', '-')} applies only to a rig that this command starts; a running rig keeps its "
                "configuration: omit this option, or omit --through running to start a rig"
            )


def open_rig(
    arguments: argparse.Namespace,
    config: RigConfig,
    record: Path,
    required: Mapping[str, Any],
    analysis: Mapping[str, Any] | None = None,
) -> RigDriver:
    """Return a driver of the rig that `--through` selects, which records into a directory.

    Args:
        arguments: parsed arguments, including those of `add_rig`.
        config: configuration of a rig to start. In ROS nodes, the rig runs as fast as recorder, analysis and this
            program follow.
        record: directory of the run.
        required: configuration values that a running rig must have; with other values it is rejected.
        analysis: parameters of an analysis to start together with the rig; None means no analysis. Not used for a
            running rig.

    Raises:
        ConfigError: a running rig has other values than `required`, or an option or value is invalid.
        GoneError, TimeoutError: a node ended before it was ready, or was not ready in time.
    """
    namespace = running_namespace(arguments)
    if arguments.through == PROCESS:
        from impact_rig.driver.local_rig import LocalRig  # noqa: PLC0415  # heavy: after the signals are taken

        return LocalRig(config, analysis=analysis, record=record)
    from impact_rig.driver.ros_rig import RosRig  # noqa: PLC0415  # needs rclpy

    if namespace:
        where = f"{namespace}, ROS domain {domain_of_environment()}"
        print(f"waiting for a rig in {where} ...", file=sys.stderr, flush=True)  # noqa: T201  # a command line tool talks
        return RosRig(required, record=record, namespace=namespace)
    return RosRig(config, analysis=analysis, record=record, mode="free_running")


def run_directory(wanted: Path | None, what: str) -> Path:
    """Return the directory of a new run: `wanted`, or a new path in `runs/` named after `what` and the time.

    The directory is not created.

    Raises:
        ImpactRigError: the path exists and is a file, or a directory that is not empty.
    """
    directory = (wanted or free_path(Path("runs") / time.strftime(f"{what}_%Y%m%d_%H%M%S"))).resolve()
    if directory.exists() and not directory.is_dir():
        raise ImpactRigError(f"{directory} is a file, not a directory: choose another --output")
    if directory.exists() and any(directory.iterdir()):
        raise ImpactRigError(f"{directory} is not empty: nothing is overwritten, choose another --output")
    return directory
