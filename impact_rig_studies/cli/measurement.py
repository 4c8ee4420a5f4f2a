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
"""Command `impact-rig import`: conversion of measurements of other rigs to runs, or to one campaign."""

from __future__ import annotations

import argparse
import contextlib
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING

import attrs
import numpy as np

from impact_rig.cli.terminal import Console, TextTable, tell_json, tell_program
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.rig.gaps import case_of
from impact_rig.system import files

if TYPE_CHECKING:
    from impact_rig_studies.importing.conversion import ImportedRun
    from impact_rig_studies.importing.mapping import Mapping
    from impact_rig_studies.importing.signals import ImportedSignals


def run_import(arguments: argparse.Namespace) -> int:
    """Import measured files as runs, or as one campaign, and return the exit code, 0.

    The use of each file's signals is printed. If a file is rejected, its error is raised, and no run of any file is
    written.
    """
    from impact_rig_studies.importing import store  # noqa: PLC0415  # heavy: after the signals are taken
    from impact_rig_studies.importing.assignment import guess  # noqa: PLC0415  # as above
    from impact_rig_studies.importing.conversion import convert  # noqa: PLC0415  # as above
    from impact_rig_studies.importing.readers import read  # noqa: PLC0415  # as above

    if arguments.config is not None and not arguments.campaign:
        raise ConfigError("--config has an effect only with --campaign: add --campaign, or omit --config")
    console = Console(quiet=arguments.json)
    drive = read(arguments.commands) if arguments.commands else None
    sheet = read(arguments.calibration) if arguments.calibration else None
    several = len(arguments.files) > 1
    (name, count), *_ = Counter(file.stem for file in arguments.files).most_common(1)
    if count > 1:
        raise ConfigError(
            f"{count} files are named {name!r} without folder and suffix, and a run is named after its file: "
            "rename them"
        )
    output: Path = arguments.output
    below = "runs" if arguments.campaign else ""
    parts = [Path(below, file.stem) if several or arguments.campaign else Path() for file in arguments.files]
    directories = [output / part for part in parts]
    shown, left_out = [], list[str]()
    with contextlib.ExitStack() as ending:
        if not arguments.dry_run:
            for directory in [output] if arguments.campaign else directories:
                if directory.is_dir() and any(directory.iterdir()):
                    raise RecordingError(f"{directory} is not empty: nothing is overwritten, choose another --output")
            ending.enter_context(files.translate_errors(f"cannot write {output}"))
            folder = ending.enter_context(files.staged(output))
        for file, part in zip(arguments.files, parts, strict=True):
            source = read(file)
            try:
                found = convert(source, _mapping(guess(source), source, arguments), drive, sheet)
            except ConfigError:
                if arguments.dry_run:
                    _print_source(console, source)
                raise
            shown.append(store.origin_of(found))
            _print(console, found)
            if not arguments.dry_run:
                store.write(found, folder / part)
        if arguments.campaign and not arguments.dry_run:
            from impact_rig_studies.measured import make_campaign  # noqa: PLC0415  # as above

            done, left_out = make_campaign([folder / part for part in parts], folder, arguments.config)
            for point in left_out:
                console.print(f"left out of the campaign: {point}", style="yellow")
            console.print(f"campaign of {len(done.points)} points")
    if arguments.json:
        tell_json(
            {
                "runs": [str(one) for one in directories],
                "files": shown,
                "left_out": left_out,
                "written": not arguments.dry_run,
            }
        )
    elif arguments.dry_run:
        console.print("nothing was written (--dry-run)", style="yellow")
    else:
        if not arguments.campaign and not _missing(found):
            console.print(f"for DT with its uncertainty: impact-rig analyze {directories[-1]}")
        tell_program(arguments.output.resolve())
    return 0


def _mapping(guessed: Mapping, source: ImportedSignals, arguments: argparse.Namespace) -> Mapping:
    """Return the mapping of a file's signals to channels.

    The guessed mapping is changed by the YAML file of `--mapping`, and then by the options. `--channel` replaces
    signal, unit and sensitivity of its channel. Without a signal, `--channel` removes the channel.
    """
    from impact_rig_studies.importing.assignment import with_channel  # noqa: PLC0415  # as above
    from impact_rig_studies.importing.mapping import MAPPING_CHARACTERS, UNITS, refined  # noqa: PLC0415  # as above

    mapping = guessed
    if arguments.mapping:
        try:
            text = files.read_bytes(arguments.mapping, MAPPING_CHARACTERS).decode()
        except OSError as error:
            raise ConfigError(
                f"cannot read the mapping: {files.reason_unreadable(error, arguments.mapping)}"
            ) from error
        except UnicodeDecodeError as error:
            raise ConfigError(f"the mapping must be UTF-8 text, {error} ({arguments.mapping})") from error
        try:
            mapping = refined(mapping, text)
        except ConfigError as error:
            raise ConfigError(f"{error} ({arguments.mapping})") from error
    channels = dict(mapping.channels)
    for words in arguments.channel:
        for text in re.split(rf" (?=(?:{'|'.join(UNITS)})=)", " ".join(words)):
            channels = with_channel(channels, text, source.signals)
    changes: dict[str, object] = {"channels": channels, "notes": (*mapping.notes, *arguments.note)}
    given = {
        "rate_hz": arguments.scan_rate,
        "resample_hz": arguments.resample,
        "frequency": arguments.frequency,
        "gap": arguments.gap,
    }
    given = {name: value for name, value in given.items() if value is not None}
    changes["guessed"] = mapping.guessed - set(given)
    return attrs.evolve(mapping, **changes, **given)  # type: ignore[arg-type]  # as the fields are


def _print_source(console: Console, source: ImportedSignals) -> None:
    """Print the signals of a file that could not be converted in a dry run.

    The channels that the signals would become are not printed.
    """
    table = TextTable(
        f"{source.path}: {source.format}", left=("signal", "unit", "kind", "given over"), right=("values",)
    )
    for name, one in source.signals.items():
        table.add_row(name, one.unit, one.kind.value, str(one.abscissa), str(len(one.values)))
    console.print(table)
    _print_left_out(console, source)


def _print_left_out(console: Console, source: ImportedSignals) -> None:
    for name, why in source.left_out.items():
        console.print(f"left out of the import: {name}, {why}")


def _missing(found: ImportedRun) -> list[str]:
    """Return the channels that DT needs and to which no signal is assigned."""
    return sorted({"laser", "base"} - found.mapping.channels.keys())


def _print(console: Console, found: ImportedRun) -> None:
    """Print how a file is imported: channel of each signal, omissions, assumptions, scans, drive, gap and remarks."""
    from impact_rig.analysis.settings import parse_label  # noqa: PLC0415  # heavy: after the signals are taken
    from impact_rig_studies.importing.assignment import reason_unused  # noqa: PLC0415  # as above

    used: dict[str, list[str]] = {}
    for name, one in found.mapping.channels.items():
        used.setdefault(one.column, []).append(name)
    signals = found.source.signals
    reasons = {name: reason_unused(name, signals, found.mapping) for name in signals if name not in used}
    title = f"{found.source.path}: {found.source.format}"
    table = TextTable(title, left=("signal", "unit", "channel"), right=("least", "largest"), last=("",))
    for name, signal in signals.items():
        if reasons.get(name):
            table.add_row(name, signal.unit, "", "", "", "not used", style="bright_black")
        elif name not in used:
            table.add_row(name, signal.unit, "frequency" if name == found.mapping.frequency else "gap")
        for channel in used.get(name, []):
            one = found.mapping.channels[channel]
            si = found.info[found.info["name"] == channel.encode()][0]["unit"].decode()
            values = found.rows[channel][np.isfinite(found.rows[channel])]
            least, largest = (f"{of(values):.4g}" if len(values) else "" for of in (np.min, np.max))
            table.add_row(name, one.sensitivity or one.unit or si, channel, least, largest, si)
    console.print(table)
    for name, why in reasons.items():
        if why:
            console.print(f"not used: {name}, {why}")
    _print_left_out(console, found.source)
    for doubt in found.doubts:
        console.print(f"assumed: {doubt}", style="yellow")
    lost = int(found.index[-1] - found.index[0]) + 1 - len(found.index)
    gap = f", {lost} missing between them" if lost else ""
    console.print(f"{len(found.rows)} scans at {found.rate_hz:.9g} Hz, {len(found.rows) / found.rate_hz:.6g} s{gap}")
    for instant, frequency, amplitude in found.drive[:10]:
        since = (instant - found.start_ns) / 1e9
        shown = f"{frequency:.6g} Hz" if frequency else "no frequency found (--frequency HZ)"
        console.print(f"drive from {since:.6g} s on: {shown}, amplitude {amplitude:.4g} {found.amplitude_unit}")
    if len(found.drive) > 10:
        console.print(f"... and {len(found.drive) - 10} further settings of the drive")
    labels = [label for label in map(parse_label, found.labels) if label]
    for label in labels:
        console.print(f"label from {(label.stamp_ns - found.start_ns) / 1e9:.6g} s on: {case_of(label.gap_m)}")
    for name in _missing(found):
        console.print(f"no DT: {name} is not assigned (--channel {name}=SIGNAL)", style="yellow")
    if not labels:
        console.print("gap: unknown (--gap 6mm, or --gap none without the sphere)", style="yellow")
    for text in found.labels:
        if not parse_label(text):
            console.print(f"remark: {text}")
