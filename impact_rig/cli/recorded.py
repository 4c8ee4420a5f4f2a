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
"""Commands on recorded runs: `impact-rig info`, `verify`, `recover` and `replay`."""

from __future__ import annotations

import argparse
import math
import os
from pathlib import Path

import attrs
from rich.progress import BarColumn, Progress, TimeRemainingColumn

from impact_rig.cli.terminal import Commands, Console, Steps, TextTable, Words, add_json, add_run, subcommand, tell_json
from impact_rig.errors import ImpactRigError
from impact_rig.recording import Run, open_run
from impact_rig.runs import RecoverReport, RunInfo, info, recover
from impact_rig.simtime import NS_PER_S


def add_info(commands: Commands) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "info", _info, "contents of a run, and whether it is complete",
        [
            ("info runs/demo/gap_6mm", "verdict, duration, topics"),
            ("info runs/demo/gap_6mm --json", "the same for a script"),
        ],
        "Exit code 0: every checksum fits and nothing is known to be missing; 1: otherwise.",
    )  # fmt: skip
    add_json(parser)
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")


def _info(arguments: argparse.Namespace) -> int:
    found = info(arguments.path)
    if arguments.json:
        tell_json(_info_content(found))
        return 0 if found.intact else 1
    console = Console()
    proven = found.intact and found.accounted and found.recovered is None
    style = "green" if proven else "yellow" if found.intact else "red"
    console.print(f"{found.path}: {found.verdict}", style=style)
    size = sum(size for _, size in found.files)
    rig = "no scans" if found.rig_s is None else f"{found.rig_s:.3f} s of rig time"
    console.print(f"{rig}, log times span {found.log_s:.3f} s, files: {len(found.files)}, {size / 1e6:.2f} MB")
    if len(found.rigs) > 1:
        console.print(f"rigs: {', '.join(found.rigs)}")
    if found.recovered is not None:
        console.print(f"recovered from {found.recovered.source}")
    for key, value in {**found.provenance, **found.origin}.items():
        console.print(f"{key}: {value}")
    table = TextTable(left=("topic", "type"), right=("messages", "per s", "kB"))
    for topic in found.topics:
        rate = "" if topic.rate_hz is None else f"{topic.rate_hz:.1f}"
        table.add_row(
            topic.name, topic.type_name.rpartition("/")[2], str(topic.count), rate, f"{topic.bytes / 1e3:.1f}"
        )
    console.print(table)
    if found.attachments:
        console.print("attached: " + ", ".join(f"{name} ({size} bytes)" for name, size in found.attachments.items()))
    return 0 if found.intact else 1


def _info_content(found: RunInfo) -> dict[str, object]:
    return {
        "path": str(found.path),
        "intact": found.intact,
        "verdict": found.verdict,
        "duration_s": found.duration_s,
        "rig_s": found.rig_s,
        "log_s": found.log_s,
        "rigs": list(found.rigs),
        "checksums": attrs.asdict(found.checksums),
        "files": dict(found.files),
        "provenance": dict(found.provenance),
        "origin": dict(found.origin),
        "recovered_from": None if found.recovered is None else found.recovered.source,
        "lost_messages": dict(found.lost),
        "lost_blocks": None if found.scans is None else found.scans.lost_blocks,
        "topics": [
            {"name": one.name, "type": one.type_name, "messages": one.count, "rate_hz": one.rate_hz, "bytes": one.bytes}
            for one in found.topics
        ],
        "attachments": dict(found.attachments),
    }


def add_verify(commands: Commands) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "verify", _verify, "re-simulate a run from its journal and compare all that the rig published",
        [("verify runs/demo/gap_6mm", "`identical` or the first difference, then a line per topic")],
        "Exit code 0: identical; 1: different, or not verifiable.",
    )  # fmt: skip
    add_run(parser)
    add_json(parser)


def _verify(arguments: argparse.Namespace) -> int:
    with open_run(arguments.path, arguments.rig) as run:
        from impact_rig.runs.verification import verify  # noqa: PLC0415

        found = verify(run)
    if arguments.json:
        content = {"identical": found.identical, "scans": found.scans, "reason": found.reason}
        tell_json(
            {**content, "topics": [attrs.asdict(one) for one in found.topics], "not_checked": list(found.not_checked)}
        )
    else:
        console = Console()
        console.print(f"{arguments.path}: {found}", style="green" if found.identical else "red")
        for one in found.topics:
            console.print(str(one), style="red" if one.difference else None)
        console.print(f"not checked: {'; '.join(found.not_checked)}")
    return 0 if found.identical else 1


INCOMPLETE = 3  # exit code if the new run lacks parts of the old one
LISTED = 20  # largest number of places that are listed


def add_recover(commands: Commands) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "recover", _recover, "save every intact chunk of a damaged or unfinished run",
        [("recover runs/killed runs/saved", "writes the intact data to a new run, and lists what is missing")],
        f"Exit code 0: all data found is intact; {INCOMPLETE}: something is missing; 1: nothing was saved.",
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="RUN", help="run directory or .mcap file")
    add_json(parser)
    parser.add_argument("out", type=Path, metavar="OUT", help="new run directory")
    parser.add_argument(
        "--accept-unchecked",
        action="store_true",
        help="also save chunks without a checksum, as written by rosbag2, which may be damaged",
    )


def _recover(arguments: argparse.Namespace) -> int:
    report = recover(arguments.path, arguments.out, accept_unchecked=arguments.accept_unchecked)
    if arguments.json:
        tell_json(_recover_content(report))
        return 0 if report.complete else INCOMPLETE
    console = Console()
    style = "green" if report.complete else "yellow"
    console.print(f"{report.directory}: {_recover_verdict(report)}", style=style)
    _print_files(console, report)
    for damage in report.damages[:LISTED]:
        console.print(f"{damage.file}, byte {damage.offset}, {damage.length} bytes: {damage.reason}")
    if report.damage_count > LISTED:
        console.print(f"and {report.damage_count - LISTED} more places")
    return 0 if report.complete else INCOMPLETE


def _recover_verdict(report: RecoverReport) -> str:
    if not report.complete:
        missing = "an unknown number of" if report.missing_messages is None else str(report.missing_messages)
        return (
            f"{report.messages} messages given back; {missing} messages, {report.lost_bytes} bytes in "
            f"{report.damage_count} places are missing"
        )
    if report.expected_messages is None:
        return f"all {report.messages} messages that were found are given back; no index says how many there were"
    return f"all {report.messages} messages are given back"


def _print_files(console: Console, report: RecoverReport) -> None:
    numbers = ("messages\nback", "seconds\nback", "messages\nmissing", "seconds\nmissing", "bytes\nmissing")
    table = TextTable(left=("file",), right=("bytes", *numbers))
    for file in report.files:
        table.add_row(
            file.name, str(file.size), str(file.messages), f"{file.given_s:.3f}",
            "unknown" if file.missing_messages is None else str(file.missing_messages),
            "unknown" if file.missing_s is None else f"{file.missing_s:.3f}", str(file.lost_bytes),
        )  # fmt: skip
    console.print(table)


def _recover_content(report: RecoverReport) -> dict[str, object]:
    return {
        "directory": str(report.directory),
        "complete": report.complete,
        "verdict": _recover_verdict(report),
        "messages": report.messages,
        "missing_messages": report.missing_messages,
        "lost_bytes": report.lost_bytes,
        "files": [
            {
                "name": one.name, "bytes": one.size, "messages": one.messages, "given_s": one.given_s,
                "missing_messages": one.missing_messages, "missing_s": one.missing_s, "lost_bytes": one.lost_bytes,
            }
            for one in report.files
        ],
        "damages": [
            {"file": str(one.file), "offset": one.offset, "length": one.length, "reason": one.reason}
            for one in report.damages
        ],
        "damage_count": report.damage_count,
    }  # fmt: skip


FASTEST = "max"
LONGEST_DELAY_S = 3600.0


def add_replay(commands: Commands) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "replay", _replay, "publish a run on its topics again, with /clock",
        [
            ("replay runs/demo/gap_6mm", "in real time"),
            ("replay runs/demo/gap_6mm --rate max --peers analysis", "as fast as the analysis follows"),
        ],
    )  # fmt: skip
    add_run(parser)
    parser.add_argument(
        "--rate", type=_rate, default=1.0, metavar="X", help="multiple of real time, or max (default: 1)"
    )
    parser.add_argument("--peers", nargs="+", default=[], metavar="NODE", help="nodes that must not lose a block")
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="topics to publish (default: all)")
    parser.add_argument("--loop", action="store_true", help="restart at the end, until Ctrl-C")
    parser.add_argument("--paused", action="store_true", help="start paused, until the service /player/pause is called")
    parser.add_argument(
        "--delay", type=_delay, default=1.0, metavar="S", help="wait for the discovery of subscribers [s] (default: 1)"
    )


def _replay(arguments: argparse.Namespace) -> int:
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with open_run(arguments.path, arguments.rig) as opened:
        return _play(opened, arguments)


def _play(opened: Run, arguments: argparse.Namespace) -> int:
    try:
        from impact_rig.nodes.player import Player, on_graph  # noqa: PLC0415  # the other subcommands do without ROS
    except ImportError as error:
        raise ImpactRigError(f"replay needs ROS 2: {error}") from error
    console = Console(stderr=True)
    word, times = Words("{task.fields[state]:<8}"), Words("{task.completed:.1f} of {task.total:.1f} s")
    bar = Progress(word, BarColumn(24), times, TimeRemainingColumn(), console=console, disable=not console.is_terminal)
    with on_graph("player") as (node, spin), bar as progress:
        factor = None if math.isinf(arguments.rate) else arguments.rate
        player = Player(
            opened, node, spin, factor=factor, peers=arguments.peers, chosen=arguments.topics, paused=arguments.paused
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


def _delay(text: str) -> float:
    return _number(text, 0.0, LONGEST_DELAY_S, "a number of seconds")


def _rate(text: str) -> float:
    return math.inf if text == FASTEST else _number(text, 0.001, 1000.0, f"{FASTEST} or a number")


def _number(text: str, least: float, most: float, what: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"must be {what} from {least:g} to {most:g}, got {text!r}")
    return value
