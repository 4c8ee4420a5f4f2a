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
"""Parts of parsers that several commands share: registration of a command, and common options."""

from __future__ import annotations

import argparse
import functools
import pkgutil
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TypeAlias

from impact_rig.cli.quantities import GAP
from impact_rig.names import FIGURE_FORMATS, RIG_OPTION

Commands: TypeAlias = "argparse._SubParsersAction[argparse.ArgumentParser]"
"""Commands of the program, or subcommands of one, to which a parser is added."""
WIDTH = 78  # width of help pages, for a terminal of 80 columns
NAMESPACE = "/rig"  # of a running rig
PROCESS, ROS, RUNNING = "process", "ros", "running"
WAYS = {
    PROCESS: "this program, the default",
    ROS: "ROS nodes that this program starts",
    RUNNING: "a rig that already runs and refuses --config, --gap and --sphere-start",
}
"""Places where a rig can run, each with its meaning."""


def call(function: str, *arguments: object) -> int:
    """Call the function of a command, given as `module:function`, and return its exit code.

    The module is imported first.
    """
    code: int = pkgutil.resolve_name(function)(*arguments)
    return code


def subcommand(
    commands: Commands, name: str, run: str | None, sentence: str, examples: Sequence[tuple[str, str]], more: str = ""
) -> argparse.ArgumentParser:
    """Register a subcommand and return its parser, to which the caller adds options.

    Args:
        commands: commands to which it is added, as passed to the function that registers it.
        name: name of the subcommand.
        run: function that runs it and returns the exit code, as `module:function`; None if it has subcommands.
        sentence: what the subcommand does, without a full stop, for the list of commands and the head of its help page.
        examples: command lines without the program's name, each with its purpose, for the end of the help page.
        more: further information, printed below the examples, such as exit codes.
    """
    lines = [f"  impact-rig {words}\n      {what}" for words, what in examples]
    head = "example:" if len(lines) == 1 else "examples:"
    epilog = "\n".join([head, *lines, *(["", textwrap.fill(more, WIDTH)] if more else [])])
    parser = commands.add_parser(
        name,
        help=sentence,
        description=textwrap.fill(f"{sentence[:1].upper()}{sentence[1:]}.", WIDTH),
        epilog=epilog,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    if run is not None:
        parser.set_defaults(run=functools.partial(call, run))
    return parser


def add_json(parser: argparse.ArgumentParser, what: str = "print the results as JSON instead of text") -> None:
    """Add the option `--json`, with which a command prints its results as JSON; `what` is its help text."""
    parser.add_argument("--json", action="store_true", help=what)


def add_output(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the option `--output`, the directory of the results; `what` is its help text."""
    parser.add_argument("--output", type=Path, metavar="DIR", help=what)


def add_figures(parser: argparse.ArgumentParser, what: str) -> None:
    """Add the options `--figures`, the directory of figures, and `--format`, the formats of the figures.

    Without `--figures`, the parsed directory is None. The parsed formats are in the attribute `formats`; the default is
    all formats. `what` is the help text of `--figures`.
    """
    parser.add_argument("--figures", type=Path, metavar="DIR", help=what)
    parser.add_argument(
        "--format",
        dest="formats",
        nargs="+",
        choices=FIGURE_FORMATS,
        default=FIGURE_FORMATS,
        metavar="FORMAT",
        help=f"formats of the figures: {', '.join(FIGURE_FORMATS)} (default: all)",
    )


def add_run(parser: argparse.ArgumentParser, what: str = "run directory or .mcap file") -> None:
    """Add the argument RUN, a recorded run, and the option `--rig`, which selects one rig of the run.

    `what` is the help text of RUN.
    """
    parser.add_argument("path", type=Path, metavar="RUN", help=what)
    add_recorded_rig(parser)


def add_recorded_rig(
    parser: argparse.ArgumentParser,
    what: str = "namespace of the rig to read from the recording; required if it has several (default: the only one)",
) -> None:
    """Add the option `--rig`: the namespace of one rig in a recording with several rigs; `what` is its help text."""
    parser.add_argument(RIG_OPTION, dest="rig", metavar="NAMESPACE", help=what)


def add_config(parser: argparse.ArgumentParser, what: str = "rig configuration (default: the paper's rig)") -> None:
    """Add the option `--config`, a configuration file; `what` is its help text."""
    parser.add_argument("--config", type=Path, metavar="FILE", help=what)


def add_rig(parser: argparse.ArgumentParser, ways: Sequence[str] = tuple(WAYS), needs: str = "") -> None:
    """Add the options that select where a rig runs, and that describe a rig to start.

    Args:
        parser: parser of a command. If its user chooses another way than `PROCESS`, the program checks for ROS 2 before
            it runs the command.
        ways: places where the rig can run, of `WAYS`.
        needs: text appended to the help of `--through`, such as requirements on a running rig; begins with `. `.
    """
    places = ", ".join(f"{way} ({WAYS[way]})" for way in ways)
    parser.add_argument("--through", choices=ways, default=PROCESS, help=f"place where the rig runs: {places}{needs}")
    parser.set_defaults(needs_ros=lambda arguments: arguments.through != PROCESS)
    if RUNNING in ways:
        parser.add_argument(
            "--namespace", help=f"namespace of the running rig; only with --through running (default: {NAMESPACE})"
        )
    refused = "; not for a running rig" if RUNNING in ways else ""
    add_config(parser, f"rig configuration (default: the paper's rig{refused})")
    parser.add_argument(
        "--gap",
        type=GAP,
        metavar="LENGTH",
        help="sum of the gaps on both sides of the sphere, with its unit, e.g. 6mm; none: no sphere (default: as "
        "configured"
        f"{refused})",
    )
    parser.add_argument(
        "--sphere-start",
        choices=("left", "centre", "right"),
        help="start position of the sphere: left or right barrier, or centre between them (default: as configured"
        f"{refused})",
    )


def running_namespace(arguments: argparse.Namespace) -> str:
    """Return the namespace of the running rig that the options of `add_rig` select.

    The result is empty if the command starts a rig.

    Raises:
        ConfigError: `--namespace` was given, but the command starts a rig.
    """
    from impact_rig.errors import ConfigError  # noqa: PLC0415  # not for the help

    if arguments.through == RUNNING:
        return arguments.namespace or NAMESPACE
    if arguments.namespace is not None:
        raise ConfigError("--namespace selects a running rig: use it only together with --through running")
    return ""
