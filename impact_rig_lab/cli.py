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
"""`impact-rig lab`: the live laboratory, or a recorded run, on one page in the browser."""

from __future__ import annotations

import argparse
import contextlib
import errno
import os
import re
import select
import signal
import sys
import webbrowser
from pathlib import Path
from typing import Any  # a source of either kind

from impact_rig.cli.options import NAMESPACE, Commands, add_recorded_rig, subcommand
from impact_rig.errors import ImpactRigError
from impact_rig.system import files
from impact_rig.system.extras import load

SAMPLE = "lab_sample"
FOUND = "?"
POLL_MS = 1000
"""Interval between two checks for signals: a signal at the very start of a wait does not interrupt it."""


def add_command(commands: Commands) -> None:
    """Register `lab`."""
    parser = subcommand(
        commands, "lab", "impact_rig_lab.cli:run", "see the rig move and turn its knobs, live, in a browser",
        [
            ("lab", "starts a rig and opens its page"),
            ("lab --sample", "plays back a short run; needs no ROS 2"),
            ("lab --branches runs/dynamics_over_frequency", "draws continued motions next to the measurements"),
            ("lab runs/demo/gap_2mm runs/demo/gap_10mm", "two recorded runs side by side"),
        ],
    )  # fmt: skip
    parser.set_defaults(until_told=True, needs_ros=lambda arguments: not (arguments.runs or arguments.sample))
    parser.add_argument("runs", nargs="*", type=Path, metavar="RUN", help="play back this run; two: side by side")
    parser.add_argument(
        "--attach", nargs="?", const=FOUND, metavar="NAMESPACE", help="show a rig that runs already, e.g. /rig"
    )
    parser.add_argument("--namespace", default=NAMESPACE, help="namespace of the rig (default: %(default)s)")
    parser.add_argument("--sample", action="store_true", help="play back a short run, recorded for this on first use")
    parser.add_argument("--port", type=int, default=8765, help="port of the page; 0: any free one (default: 8765)")
    parser.add_argument("--host", default="127.0.0.1", help="address to serve; other machines may then open the page")
    add_recorded_rig(parser)
    parser.add_argument("--no-browser", action="store_true", help="print the address only")
    parser.add_argument("--scan-rate", type=int, default=10_000, metavar="HZ", help="scans per second (default: 10000)")
    parser.add_argument(
        "--mode",
        choices=("realtime", "free_running"),
        default="realtime",
        help="time mode of the rig (default: realtime)",
    )
    parser.add_argument(
        "--branches", type=Path, metavar="DIR", nargs="+", default=(),
        help="folder with motions over frequency of `dynamics continue`, drawn where they exist",
    )  # fmt: skip
    parser.add_argument("--no-record", action="store_true", help="record only on request from the page")
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs"),
        metavar="DIR",
        help="directory in which recordings are made (default: runs)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Serve the page until Ctrl-C, or until the reader of the program's output has ended."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if len(arguments.runs) > 2:
        raise ImpactRigError("at most two runs can be shown side by side")
    if (arguments.runs or arguments.sample) and arguments.attach:
        raise ImpactRigError("a run to play back and --attach cannot be combined: choose one")
    load("impact_rig_lab.server", "lab", "lab")
    from impact_rig_lab.server import Server, check_port, kept_token  # noqa: PLC0415  # an extra
    from impact_rig_lab.theory import continued  # noqa: PLC0415

    check_port(arguments.port)
    branches = [continued(directory) for directory in arguments.branches]
    from impact_rig.cli.terminal import Console  # noqa: PLC0415  # rich: not for the help

    console = Console()
    runs = arguments.runs[0].resolve().parent if arguments.runs else arguments.output
    with contextlib.ExitStack() as stack:
        source: Any = None
        stack.callback(lambda: _say_where(source))  # runs last, when the recorder has finished
        source = _source(arguments, stack)
        source.theory.branches = branches
        server = stack.enter_context(Server(source, arguments.host, arguments.port, kept_token(), runs))
        stack.enter_context(source)
        console.print("impact_rig lab: open this address in a browser; Ctrl-C ends it", soft_wrap=True)
        print(server.address, flush=True)  # noqa: T201
        if not arguments.no_browser:
            with contextlib.suppress(webbrowser.Error):
                webbrowser.open(server.address)
        reader = select.poll()
        reader.register(sys.stdout.fileno(), 0)  # reports only that the reader has ended
        while not reader.poll(POLL_MS):
            pass
    return 128 + signal.SIGPIPE


def _say_where(source: Any) -> None:
    """Print the path of the last recording."""
    directory = getattr(source, "directory", None)
    if directory is not None:
        with contextlib.suppress(OSError):
            print(f"recorded: {directory}", flush=True)  # noqa: T201


def _source(arguments: argparse.Namespace, stack: contextlib.ExitStack) -> Any:
    if arguments.runs or arguments.sample:
        from impact_rig_lab.playback import PlaybackSource  # noqa: PLC0415

        if not arguments.runs:
            from impact_rig.driver.sample_run import make_sample  # noqa: PLC0415

            arguments.runs = [make_sample(files.state_dir("") / SAMPLE)]
        return PlaybackSource(arguments.runs, arguments.rig)
    from impact_rig.client.processes import Processes, domain_of_environment  # noqa: PLC0415
    from impact_rig_lab.live import LiveSource  # noqa: PLC0415

    domain = domain_of_environment()
    if arguments.attach:
        return LiveSource(domain, None if arguments.attach == FOUND else arguments.attach)
    from impact_rig.rig.config import RigConfig, from_flat  # noqa: PLC0415
    from impact_rig_lab.gateway import OwnedProcesses  # noqa: PLC0415

    namespace = f"/{arguments.namespace.strip('/')}"
    if not re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", namespace):
        raise ImpactRigError(f"a namespace must be letters, digits and _ between slashes, got {arguments.namespace!r}")
    parameters = node_parameters(arguments)
    from_flat(RigConfig(), parameters["rig"])  # report values that the rig rejects here, where the user sees it
    if not arguments.no_record:
        _check_writable(arguments.output)
    _take_place(domain, namespace, stack)
    logs = files.state_dir("lab_logs") / files.place(domain, namespace)
    processes = stack.enter_context(Processes(domain, logs, namespace=namespace))
    return LiveSource(domain, namespace, OwnedProcesses(processes, parameters))


def _check_writable(directory: Path) -> None:
    """Reject a directory that the recorder could not write to later."""
    with files.translate_errors(f"nothing can be recorded into {directory}; choose --output DIR or --no-record"):
        files.make_folder(directory)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _take_place(domain: int, namespace: str, stack: contextlib.ExitStack) -> None:
    """Reserve a namespace for the rig of this lab."""
    name = files.place(domain, namespace)
    advice = f"open its page with --attach {namespace}, or choose another --namespace"
    try:
        held = files.hold(files.PLACES, f"{name}.lab")
    except OSError:
        return  # locks cannot be used here, so other labs are unknown
    if held is None and files.is_held_by_others(files.PLACES, f"{name}.lab"):
        return
    if held is None:
        raise ImpactRigError(
            f"the lab of process {files.holder(files.PLACES, f'{name}.lab')} has {namespace}: {advice}"
        )
    stack.callback(os.close, held)
    rig = files.hold(files.PLACES, name)
    if rig is None and files.is_held_by_others(files.PLACES, name):
        return
    if rig is None:
        raise ImpactRigError(f"the rig of process {files.holder(files.PLACES, name)} is in {namespace}: {advice}")
    os.close(rig)  # released, so that the rig that is started now can take it


def node_parameters(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return the parameters of the nodes that the lab starts."""
    return {
        "rig": {
            "time.mode": arguments.mode,
            "time.peers": ["analysis", "recorder"],
            "daq.rate_hz": arguments.scan_rate,
            "daq.block_scans": max(1, arguments.scan_rate // 100),
        },
        "analysis": {"gap_m": 0.006},
        "plot": {},
        "recorder": {"directory": str(arguments.output.resolve()), "record": not arguments.no_record},
    }
