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
"""Programs of the nodes: `python -m impact_rig.nodes rig --ros-args ...`, and the console scripts such as `rig_node`.

Heavy modules (rclpy, compiled code) are imported last. Signals and the end of the parent process are therefore handled
even while these modules load.
"""

from __future__ import annotations

import argparse
import functools
import itertools
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence

from impact_rig.system.endings import PARENT_VARIABLE, PATIENCE_S, Ending, end_with

USAGE = """\
usage: {program} [-h] [--ros-args [--params-file FILE] [-p NAME:=VALUE] [-r __ns:=/NAMESPACE] ...]

{about}

options:
  -h, --help             show this help and exit

arguments of ROS, after --ros-args:
  --params-file FILE     ROS 2 parameter file with start-up values, as `ros2 param dump /{node}` writes it
  -p NAME:=VALUE         start-up value of one parameter; it overrides the file
  -r __ns:=/NAMESPACE    namespace of the node, its topics and its services (default: none)

examples:
  {program} --ros-args -p {example}
  {program} --ros-args -r __ns:=/rig --params-file my.yaml

Exit code: 0 after Ctrl-C or SIGTERM; any other if the program failed, with the reason in its last line.

{more}
"""
Use = tuple[str, str, str]
"""Usage text of a node's program: what it does, an example of its arguments, and where to read more."""
NODES: dict[str, Use] = {
    "rig": (
        "Simulated vibration test rig: publishes the readings of its instruments, and obeys commands to its shaker.",
        "barriers.gap_m:=0.004",
        (
            "Parameters with units and ranges: config/nominal.yaml. `impact-rig check FILE` validates such a file.\n"
            "With invalid values the node logs why and stays unconfigured: correct them, and start it again."
        ),
    ),
    "analysis": (
        "Analysis: computes displacement transmissibility and impacts from the scans of a rig (topic daq/scan).",
        "gap_m:=0.004",
        "Topics and parameters: docs/reference/interface.md.",
    ),
    "recorder": (
        (
            "Recorder: writes the topics of a rig into a run (a directory with an MCAP file). It records from its\n"
            "start or, with record:=false, between calls of its services ~/start and ~/stop."
        ),
        "name:=first_light",
        "Topics, services and parameters: docs/reference/interface.md.",
    ),
    "plot": (
        "Plot node: publishes envelopes, spectra, drive and transmissibility of a rig as small messages for plotters.",
        "autostart:=false",
        "Topics: docs/reference/interface.md.",
    ),
}


def show_help(node: str, use: Use, arguments: Sequence[str]) -> bool:
    """Print the usage of a node's program if the arguments before `--ros-args` contain `-h` or `--help`.

    Returns:
        Whether the usage was printed; the caller then ends the program.
    """
    ours = list(itertools.takewhile(lambda word: word != "--ros-args", arguments))
    if not {"-h", "--help"}.intersection(ours):
        return False
    about, example, more = use
    print(USAGE.format(program=f"{node}_node", node=node, about=about, example=example, more=more), end="")  # noqa: T201
    return True


def run(node: str, use: Use, module: str) -> None:
    """Run a node as a program; `use` is its help text, `module` the module whose `PROGRAM` creates the node.

    The program ends with a message and exit code 1 if ROS 2 is not installed.
    """

    def main(ending: Ending) -> None:
        from impact_rig.errors import ImpactRigError  # noqa: PLC0415
        from impact_rig.system.extras import load_ros  # noqa: PLC0415

        try:
            process, own = (load_ros(one, f"{node}_node") for one in ("impact_rig.nodes.process", module))
        except ImpactRigError as error:
            sys.exit(str(error))
        process.main(own.PROGRAM, ending)

    begin(node, use, main)


def _run(node: str) -> None:
    run(node, NODES[node], f"impact_rig.nodes.{node}_node")


rig, analysis, recorder, plot = (functools.partial(_run, node) for node in NODES)


def begin(node: str, use: Use, main: Callable[[Ending], None]) -> None:
    """Run the program of a node: show its help if requested, otherwise call `main`.

    On SIGINT or SIGTERM, the program cleans up and ends with exit code 0. A program that a launch file of this project
    or `impact_rig.client.Processes` has started also ends when its parent process is gone.
    """
    if show_help(node, use, sys.argv[1:]):
        return
    # a node that ends on request has succeeded: launch treats any exit code other than 0 as a crash
    ending = Ending(f"{node}_node", code=lambda _number: 0)
    parent = int(os.environ.get(PARENT_VARIABLE, "0"))
    if parent:
        end_with(parent, lambda: _end(ending))
    main(ending)


def _end(ending: Ending) -> None:
    """End this process because its parent is gone: by SIGTERM, and after `PATIENCE_S` seconds by force, with code 1."""
    ending.reason = ", as the process that started it is gone"
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(PATIENCE_S)
    os._exit(1)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="python -m impact_rig.nodes", description=__doc__)
    parser.add_argument("node", choices=NODES, help="node to run; further arguments are passed to it")
    _run(parser.parse_args([sys.argv.pop(1)] if sys.argv[1:] else []).node)
