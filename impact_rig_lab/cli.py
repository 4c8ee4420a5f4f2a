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
from collections.abc import Callable
from pathlib import Path
from typing import Any  # a source of either kind

from impact_rig.cli.options import NAMESPACE, Commands, add_recorded_rig, subcommand
from impact_rig.config.sections import Barriers, Daq
from impact_rig.errors import ImpactRigError
from impact_rig.system import files
from impact_rig.system.extras import load

OF_A_STARTED_RIG = ("namespace", "scan_rate", "mode", "no_record", "output")
"""Options that have no effect if the page shows a running rig or recorded runs."""
SAMPLE = "lab_sample"  # name of the directory of the short run for --sample
FOUND = "?"  # value of --attach without a namespace: search for a rig
POLL_MS = 1000
"""Longest wait [ms] before pending signals such as Ctrl-C are handled.

A signal at the very start of a wait does not interrupt it.
"""


def add_command(commands: Commands) -> None:
    """Add the subcommand `lab` with its options and examples to the parser of `impact-rig`."""
    parser = subcommand(
        commands,
        "lab",
        "impact_rig_lab.cli:run",
        "see the rig move and turn its knobs, live, in a browser",
        [
            ("lab", "starts a rig and opens its page"),
            ("lab --sample", "plays back a short run; needs no ROS 2"),
            ("lab --branches runs/dynamics_over_frequency", "draws branches of periodic motions with the measurements"),
            ("lab runs/demo/gap_2mm runs/demo/gap_10mm", "two recorded runs side by side"),
        ],
    )
    parser.set_defaults(ends_by_signal=True, needs_ros=lambda arguments: not (arguments.runs or arguments.sample))
    parser.add_argument(
        "runs",
        nargs="*",
        type=Path,
        metavar="RUN",
        help="recorded run to play back, without ROS 2, instead of starting a rig; at most two, side by side",
    )
    parser.add_argument(
        "--attach",
        nargs="?",
        const=FOUND,
        metavar="NAMESPACE",
        help="show the running rig in NAMESPACE, such as /rig, instead of starting one; the rig keeps running when the "
        "lab ends. Without NAMESPACE: the rig that is found; the page waits for one, and lets you choose from several",
    )
    parser.add_argument(
        "--namespace",
        default=NAMESPACE,
        help="ROS namespace of the rig that is started; not with --attach, --sample or RUN (default: %(default)s)",
    )
    parser.add_argument(
        "--sample",
        action="store_true",
        help="play back a short sample run, without ROS 2; the first call simulates the run and stores it",
    )
    parser.add_argument("--port", type=int, default=8765, help="TCP port of the page; 0: any free one (default: 8765)")
    parser.add_argument(
        "--host",
        default="127.0.0.1",
        help="address on which the page is served (default: %(default)s). Unless it is a loopback address, other "
        "machines can open the page by the printed URL, which contains a secret token. In the URL replace 0.0.0.0 by "
        "an address of this machine",
    )
    add_recorded_rig(
        parser,
        "namespace of the recorded rig to show, only with RUN or --sample; required if a RUN has several (default: the "
        "only one)",
    )
    parser.add_argument("--no-browser", action="store_true", help="print the address of the page without opening it")
    parser.add_argument(
        "--scan-rate",
        type=int,
        default=Daq().rate_hz,
        metavar="HZ",
        help="scans per second of the rig that is started; not with --attach, --sample or RUN (default: %(default)s)",
    )
    parser.add_argument(
        "--mode",
        choices=("realtime", "free_running"),
        default="realtime",
        help="pace of the rig that is started: real time, or as fast as possible; not with --attach, --sample or RUN "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--branches",
        type=Path,
        metavar="DIR",
        nargs="+",
        default=(),
        help="output folders of `impact-rig dynamics continue` over frequency; the page draws their branches with the "
        "curve of DT while the rig has the settings for which they were computed",
    )
    parser.add_argument(
        "--no-record",
        action="store_true",
        help="record only on request from the page; not with --attach, --sample or RUN (default: from the start)",
    )
    parser.add_argument(
        "--output",
        type=Path,
        default=Path("runs"),
        metavar="DIR",
        help="directory in which each recording gets a folder of its own; not with --attach, --sample or RUN (default: "
        "%(default)s)",
    )
    parser.set_defaults(of_a_started_rig={name: parser.get_default(name) for name in OF_A_STARTED_RIG})


def run(arguments: argparse.Namespace) -> int:
    """Run `impact-rig lab`: start or open what the page shows, and serve the page until Ctrl-C.

    Ctrl-C raises an exception. The function returns only if the reader of the standard output has ended. The result is
    then the exit code of SIGPIPE.

    Raises:
        ImpactRigError: options contradict each other or are invalid, a run or a folder of `--branches` cannot be read,
            a package is missing, the namespace is in use, recordings cannot be written, or the server cannot be
            started. A node that cannot be started is no error here; the page shows it.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if len(arguments.runs) > 2:
        raise ImpactRigError(f"at most two runs can be shown side by side, got {len(arguments.runs)}")
    _check_combination(arguments)
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
        records = not (arguments.runs or arguments.sample or arguments.attach or arguments.no_record)
        earlier = _recordings(arguments.output)
        # runs last, when the recorder has finished
        stack.callback(
            lambda: _say_where(source, lambda: _recordings(arguments.output) - earlier if records else set())
        )
        source = _source(arguments, stack)
        source.theory.branches = branches
        server = stack.enter_context(Server(source, arguments.host, arguments.port, kept_token(), runs))
        stack.enter_context(source)
        console.print("impact_rig lab: open this address in a browser; Ctrl-C ends the lab", soft_wrap=True)
        print(server.address, flush=True)  # noqa: T201
        if not arguments.no_browser:
            with contextlib.suppress(webbrowser.Error):
                webbrowser.open(server.address)
        reader = select.poll()
        reader.register(sys.stdout.fileno(), 0)  # reports only that the reader has ended
        while not reader.poll(POLL_MS):
            pass
    return 128 + signal.SIGPIPE


def _check_combination(arguments: argparse.Namespace) -> None:
    """Check that at most one of RUN, `--sample` and `--attach` is given, and no option without effect.

    Raises:
        ImpactRigError: several of them are given, or an option that has no effect differs from its default.
    """
    given = {"RUN": arguments.runs, "--sample": arguments.sample, "--attach": arguments.attach}
    sources = [name for name, value in given.items() if value]
    if len(sources) > 1:
        raise ImpactRigError(f"{' and '.join(sources)} cannot be combined: choose one")
    for name, default in arguments.of_a_started_rig.items() if sources else ():
        if getattr(arguments, name) != default:
            option = f"--{name.replace('_', '-')}"
            raise ImpactRigError(
                f"{option} applies only to a rig that this command starts: omit it, or omit {sources[0]}"
            )
    if arguments.rig and not (arguments.runs or arguments.sample):
        raise ImpactRigError("--rig applies only to recorded runs: omit it, or name a RUN")


def _recordings(directory: Path) -> set[Path]:
    return {path.parent.resolve() for path in directory.glob("*/*.mcap")}


def _say_where(source: Any, new: Callable[[], set[Path]]) -> None:
    """Print the directory of the last recording of a live source, if there is one.

    Args:
        source: source of the page; None if the program has failed before it had a source.
        new: function that returns the recordings made since the start. The newest of them is printed if the source does
            not know its recording.
    """
    directory = getattr(source, "directory", None) or max(new(), default=None)
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
        raise ImpactRigError(
            "--namespace must be one or more names of letters, digits and _, separated by slashes, none beginning with "
            f"a digit, such as /rig; got {arguments.namespace!r}"
        )
    parameters = node_parameters(arguments)
    from_flat(RigConfig(), parameters["rig"])  # report values that the rig rejects here, where the user sees it
    if not arguments.no_record:
        _check_writable(arguments.output)
    _take_place(domain, namespace, stack)
    logs = files.state_dir("lab_logs") / files.place(domain, namespace)
    processes = stack.enter_context(Processes(domain, logs, namespace=namespace))
    return LiveSource(domain, namespace, OwnedProcesses(processes, parameters))


def _check_writable(directory: Path) -> None:
    """Create the directory `--output` if needed, and check that the recorder can write to it.

    Raises:
        ImpactRigError: the directory cannot be created or written to.
    """
    remedy = "choose another one with --output DIR, or record nothing with --no-record"
    with files.translate_errors(f"cannot record into the directory {directory} ({remedy})"):
        files.make_folder(directory)
        if not os.access(directory, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))


def _take_place(domain: int, namespace: str, stack: contextlib.ExitStack) -> None:
    """Reserve a ROS namespace for this lab, and check that no rig uses the namespace yet.

    Without usable file locks on this machine, nothing is reserved or checked.

    Args:
        domain: ROS domain.
        namespace: the namespace, such as `/rig`.
        stack: exit stack that releases the reservation at the end of the program.

    Raises:
        ImpactRigError: another lab or rig of this user on this machine uses the namespace; the message names its
            process.
    """
    name = files.place(domain, namespace)
    advice = f"show its rig with --attach {namespace}, or choose another --namespace"
    try:
        held = files.hold(files.PLACES, f"{name}.lab")
    except OSError:
        return  # locks cannot be used here, so other labs are unknown
    if held is None and files.is_held_by_others(files.PLACES, f"{name}.lab"):
        return
    if held is None:
        raise ImpactRigError(
            f"another lab, {_process(f'{name}.lab')}, already runs in the namespace {namespace}: stop it, {advice}"
        )
    stack.callback(os.close, held)
    rig = files.hold(files.PLACES, name)
    if rig is None and files.is_held_by_others(files.PLACES, name):
        return
    if rig is None:
        raise ImpactRigError(
            f"another rig, {_process(name)}, already runs in the namespace {namespace}: stop it, {advice}"
        )
    os.close(rig)  # released, so that the rig that is started now can take it


def _process(lock: str) -> str:
    number = files.holder(files.PLACES, lock)
    return f"process {number or 'unknown'}"  # it is unknown in another container


def node_parameters(arguments: argparse.Namespace) -> dict[str, dict[str, Any]]:
    """Return the ROS parameters with which the lab starts its nodes, by node and name of the parameter."""
    return {
        "rig": {
            "time.mode": arguments.mode,
            "time.peers": ["analysis", "recorder"],
            "daq.rate_hz": arguments.scan_rate,
            "daq.block_scans": max(1, arguments.scan_rate // 100),
        },
        "analysis": {"gap_m": Barriers().gap_m},
        "plot": {},
        "recorder": {"directory": str(arguments.output.resolve()), "record": not arguments.no_record},
    }
