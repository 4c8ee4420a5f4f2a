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

import attrs

from impact_rig.cli.parsers import INCOMPLETE
from impact_rig.cli.terminal import Console, Counted, TextTable, tell_json
from impact_rig.recording import Run, open_run
from impact_rig.runs import RecoverReport, RunInfo, info, recover
from impact_rig.simtime import NS_PER_S


def run_info(arguments: argparse.Namespace) -> int:
    """Run `impact-rig info`: print the contents of a run, and whether it is complete.

    Return exit code 1 if the run is damaged or known to be incomplete, else 0.

    Raises:
        RecordingError: the run cannot be read.
    """
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
        console.print(f"recovered from the damaged run {found.recovered.source}")
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


def run_verify(arguments: argparse.Namespace) -> int:
    """Run `impact-rig verify`: simulate a run again from its journal, and print whether every bit is the same.

    Return exit code 0 if every recorded topic of the rig is identical. Return 1 if a bit differs, the recording was
    changed, or the run is not verifiable, for the printed reason.

    Raises:
        RecordingError: the run cannot be read, has no scans, or has several rigs of which none was chosen.
    """
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


LISTED = 20  # largest number of damaged places that are listed


def run_recover(arguments: argparse.Namespace) -> int:
    """Run `impact-rig recover`: save the intact parts of a run as a new run, and print what is missing.

    Return exit code 3 (`INCOMPLETE`) if something of the run is known to be damaged or missing, else 0.

    Raises:
        RecordingError: no message can be recovered, the new directory has a recording already, or a file cannot be read
            or written.
    """
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
        console.print(f"and {report.damage_count - LISTED} more damaged places")
    return 0 if report.complete else INCOMPLETE


def _recover_verdict(report: RecoverReport) -> str:
    if not report.complete:
        missing = "an unknown number of" if report.missing_messages is None else str(report.missing_messages)
        return (
            f"{report.messages} messages saved; {missing} messages are missing, {report.lost_bytes} bytes in "
            f"{report.damage_count} places"
        )
    if report.expected_messages is None:
        return (
            f"all {report.messages} messages that were found are saved; whether there were more is unknown, because "
            "the run has no index"
        )
    return f"all {report.messages} messages are saved"


def _print_files(console: Console, report: RecoverReport) -> None:
    numbers = ("messages\nsaved", "seconds\nsaved", "messages\nmissing", "seconds\nmissing", "bytes\nmissing")
    table = TextTable(left=("file",), right=("bytes", *numbers))
    for file in report.files:
        table.add_row(
            file.name,
            str(file.size),
            str(file.messages),
            f"{file.given_s:.3f}",
            "unknown" if file.missing_messages is None else str(file.missing_messages),
            "unknown" if file.missing_s is None else f"{file.missing_s:.3f}",
            str(file.lost_bytes),
        )
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
                "name": one.name,
                "bytes": one.size,
                "messages": one.messages,
                "given_s": one.given_s,
                "missing_messages": one.missing_messages,
                "missing_s": one.missing_s,
                "lost_bytes": one.lost_bytes,
            }
            for one in report.files
        ],
        "damages": [attrs.asdict(one) for one in report.damages],
        "damage_count": report.damage_count,
    }


def run_replay(arguments: argparse.Namespace) -> int:
    """Run `impact-rig replay`: publish the messages of a run until its end, or with `--loop` until a signal.

    Return exit code 0 at the end of the run. A signal raises KeyboardInterrupt, also with `--loop`.
    """
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with open_run(arguments.path, arguments.rig) as opened:
        return _play(opened, arguments)


def _play(opened: Run, arguments: argparse.Namespace) -> int:
    from impact_rig.nodes.player import Player, on_graph  # noqa: PLC0415  # the other subcommands do without ROS

    with on_graph("player") as (node, spin):
        factor = None if math.isinf(arguments.rate) else arguments.rate
        player = Player(
            opened, node, spin, factor=factor, peers=arguments.peers, chosen=arguments.topics, paused=arguments.paused
        )
        player.spin_for(arguments.delay)
        total = round((player.end_ns - player.start_ns) / NS_PER_S)
        with Counted(Console(stderr=True), "seconds", total) as shown:
            shown.end = "interrupted"
            while True:
                for now_ns in player.play():
                    done = (now_ns - player.start_ns) // NS_PER_S
                    shown.show(done, "paused" if player.paused else "playing")
                shown.show(total, "done")
                if not arguments.loop:
                    shown.end = "done"
                    player.finish()
                    return 0
