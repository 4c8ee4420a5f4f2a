# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig replay`: publish a recorded run onto the graph, where `ros2 bag play` is missing or not exact enough."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

from rich.progress import BarColumn, Progress, TimeRemainingColumn

from impact_rig.cli.terminal import Console, Steps, Words, subcommand
from impact_rig.errors import ImpactRigError
from impact_rig.recording import Run, open_run
from impact_rig.simtime import NS_PER_S

FASTEST = "max"


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "replay", "publish a run onto the graph again, with /clock",
        [
            ("replay runs/demo/gap_6mm", "in real time"),
            ("replay runs/demo/gap_6mm --rate max --peers analysis", "as fast as the analysis follows"),
        ],
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    parser.add_argument(
        "--rate", type=_rate, default=1.0, metavar="X", help="times real time, or max: as the peers follow (default: 1)"
    )
    parser.add_argument("--peers", nargs="+", default=[], metavar="NODE", help="nodes that must not lose a block")
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these")
    parser.add_argument("--loop", action="store_true", help="begin again at the end, until Ctrl-C")
    parser.add_argument("--paused", action="store_true", help="begin paused; the service /player/pause lets it go on")
    parser.add_argument(
        "--delay", type=float, default=1.0, metavar="S", help="wait this long for subscribers to be found (default: 1)"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Replay and return the exit code."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with open_run(arguments.path) as opened:
        return _play(opened, arguments)


def _play(opened: Run, arguments: argparse.Namespace) -> int:
    try:
        from impact_rig.nodes.player import Player, on_graph  # noqa: PLC0415  # the other subcommands do without ROS
    except ImportError as error:
        raise ImpactRigError(f"replay needs ROS 2: {error}") from error
    console = Console(stderr=True)
    with on_graph("player") as (node, spin), _shown(console) as progress:
        player = Player(
            opened,
            node,
            spin,
            factor=None if math.isinf(arguments.rate) else arguments.rate,
            peers=arguments.peers,
            chosen=arguments.topics,
            paused=arguments.paused,
        )
        spin(arguments.delay)
        total = (player.end_ns - player.start_ns) / NS_PER_S
        lines = Steps("second", round(total))
        task = progress.add_task("", total=total, state="waiting")
        while True:
            for now_ns in player.play():
                state, done = "paused" if player.paused else "playing", (now_ns - player.start_ns) / NS_PER_S
                progress.update(task, completed=done, state=state)
                if not console.is_terminal:
                    lines.show(math.floor(done), state)
            progress.update(task, completed=total, state="done")
            if not arguments.loop:
                player.finish()
                return 0


def _shown(console: Console) -> Progress:
    """Return the bar, which only a terminal shows."""
    columns = (
        Words("{task.fields[state]:<8}"),
        BarColumn(24),
        Words("{task.completed:.1f} of {task.total:.1f} s"),
        TimeRemainingColumn(),
    )
    return Progress(*columns, console=console, disable=not console.is_terminal)


def _rate(text: str) -> float:
    """Return a factor; infinity for `max`."""
    if text == FASTEST:
        return math.inf
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0.001 <= value <= 1000:
        raise argparse.ArgumentTypeError(f"must be {FASTEST} or a number from 0.001 to 1000, got {text!r}")
    return value
