# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig import`: measurements of one's own rig as runs, or as one campaign."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

import attrs

from impact_rig.cli.quantities import GAP, Quantity
from impact_rig.cli.terminal import Console, TextTable, add_json, subcommand, tell_json, tell_program
from impact_rig.config.fields import FieldInfo
from impact_rig.errors import ConfigError
from impact_rig.system import files

if TYPE_CHECKING:
    from impact_rig.runs.measurement import ImportedFile, Mapping

FREQUENCY = Quantity(FieldInfo("Frequency of the drive.", "Hz", low=0.0), names=True)
GAP_LABEL = attrs.evolve(GAP, names=True)


def add_import(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "import", _import, "make a run of a measurement of your own rig, or a campaign of several",
        [
            ("import test.csv --output runs/mine --dry-run", "shows what it takes the columns for, and writes nothing"),
            ("import test.csv --output runs/mine --channel laser=ai0 mm --gap 6mm", "column ai0 is the laser, in mm"),
            ("import sweep/*.mat --output runs/my_sweep --campaign", "a file a point: frequency and gap by file name"),
        ],
        "Reads CSV, Parquet, npz, WAV, universal files (dataset 58), Rattlesnake netCDF4 and MATLAB 5: "
        "docs/own_measurement.md.",
    )  # fmt: skip
    add_json(parser)
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="of the measurement")
    parser.add_argument("--output", type=Path, required=True, metavar="DIR", help="of the run, or of the campaign")
    parser.add_argument("--dry-run", action="store_true", help="show what would be written, and write nothing")
    parser.add_argument(
        "--mapping", type=Path, metavar="YAML", help="which signal is which channel, units, calibration"
    )
    parser.add_argument(
        "--channel", action="append", nargs="+", default=[], metavar="NAME=SIGNAL",
        help="accelerometer, laser, base or current is this signal [in this unit]: --channel laser=ai0 mm",
    )  # fmt: skip
    parser.add_argument(
        "--rate", type=float, metavar="HZ", help="scans per second, where the file does not tell or errs"
    )
    parser.add_argument(
        "--resample", type=int, metavar="HZ", help="bring scans to this rate that are not uniform in time"
    )
    parser.add_argument(
        "--frequency", type=FREQUENCY, metavar="HZ|SIGNAL",
        help="drive frequency, e.g. 9.1Hz, or the signal that has it (default: by the file name, else the base's)",
    )  # fmt: skip
    parser.add_argument(
        "--gap", type=GAP_LABEL, metavar="LENGTH|SIGNAL",
        help="gap with its unit, e.g. 6mm, none (no sphere), or the signal that has it (default: by the file name)",
    )  # fmt: skip
    parser.add_argument(
        "--drive", type=Path, metavar="FILE", help="table of what was commanded: time, frequency, current"
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="table with columns of daq/info, a row a channel"
    )
    parser.add_argument("--note", action="append", default=[], metavar="TEXT", help="remark to keep with the run")
    parser.add_argument("--campaign", action="store_true", help="one campaign, which report and identify take")
    parser.add_argument("--config", type=Path, metavar="FILE", help="with --campaign: what is known of the rig")


def _import(arguments: argparse.Namespace) -> int:
    from impact_rig.runs import foreign_files, measurement  # noqa: PLC0415  # heavy: after the signals are taken

    console = Console(quiet=arguments.json)
    drive = foreign_files.read(arguments.drive) if arguments.drive else None
    sheet = foreign_files.read(arguments.calibration) if arguments.calibration else None
    several = len(arguments.files) > 1
    if several and len({file.stem for file in arguments.files}) < len(arguments.files):
        raise ConfigError("two files have one name: each becomes the run of its name")
    directories, shown = [], []
    if arguments.campaign and not arguments.dry_run:
        with files.errors_as(f"cannot write {arguments.output}"):
            files.make_folder(arguments.output / "runs")
    for file in arguments.files:
        source = foreign_files.read(file)
        mapping = _mapping(measurement.guess(source), arguments)
        found = measurement.measurement(source, mapping, drive, sheet)
        shown.append(_content(found))
        _print(console, found)
        target = arguments.output / "runs" / file.stem if arguments.campaign else arguments.output
        directories.append(target / file.stem if several and not arguments.campaign else target)
        if not arguments.dry_run:
            measurement.write(found, directories[-1])
    if arguments.campaign and not arguments.dry_run:
        from impact_rig.studies.measured import make_campaign  # noqa: PLC0415  # as above

        done = make_campaign(directories, arguments.output, arguments.config)
        console.print(f"{len(done.points)} points, {len(done.failed())} of them without a settled measurement")
    if arguments.json:
        tell_json({"runs": [str(one) for one in directories], "files": shown, "written": not arguments.dry_run})
    elif arguments.dry_run:
        console.print("nothing was written (--dry-run)", style="yellow")
    else:
        tell_program(arguments.output.resolve())
    return 0


def _mapping(guessed: Mapping, arguments: argparse.Namespace) -> Mapping:
    """Return the mapping guessed, with what the YAML and then the options say."""
    from impact_rig.runs.measurement import MAPPING_CHARACTERS, Channel, refined  # noqa: PLC0415  # as above

    mapping = guessed
    if arguments.mapping:
        try:
            text = files.read_bytes(arguments.mapping, MAPPING_CHARACTERS).decode()
        except (OSError, UnicodeDecodeError) as error:
            raise ConfigError(f"{arguments.mapping} cannot be read: {error}") from error
        mapping = refined(mapping, text)
    channels = dict(mapping.channels)
    for words in arguments.channel:
        name, equals, column = words[0].partition("=")
        if not equals or name not in ("accelerometer", "laser", "base", "current"):
            raise ConfigError(f"--channel must be like laser=ai0 or laser=ai0 mm, got {' '.join(words)!r}")
        if column:
            known = channels.get(name, Channel(column=column))
            channels[name] = attrs.evolve(known, column=column, unit=" ".join(words[1:]) or known.unit)
        else:
            channels.pop(name, None)
    changes: dict[str, object] = {"channels": channels, "notes": (*mapping.notes, *arguments.note)}
    told = {"rate_hz": arguments.rate, "resample_hz": arguments.resample}
    changes |= {name: value for name, value in told.items() if value is not None}
    if arguments.frequency is not None:
        changes["frequency"] = arguments.frequency
    if arguments.gap is not None:
        changes["gap"] = arguments.gap
    return attrs.evolve(mapping, **changes)  # type: ignore[arg-type]  # as the fields are


def _content(found: ImportedFile) -> dict[str, object]:
    return {
        "file": str(found.source.path), "format": found.source.kind, "rate_hz": found.rate_hz,
        "scans": len(found.rows), "channels": {name: one.column for name, one in found.mapping.channels.items()},
        "drive": [{"stamp_ns": t, "frequency_hz": f, "amplitude": a} for t, f, a in found.drive],
        "notes": list(found.labels), "left_out": dict(found.source.left_out),
    }  # fmt: skip


def _print(console: Console, found: ImportedFile) -> None:
    """Print what the signals of a file are taken for."""
    used = {one.column: name for name, one in found.mapping.channels.items()}
    title = f"{found.source.path}: {found.source.kind}"
    table = TextTable(title, left=("signal", "unit", "channel"), right=("least", "largest"), last=("",))
    for name, one in found.source.signals.items():
        channel = used.get(name)
        if channel is None:
            table.add_row(name, one.unit, "", "", "", "not used", style="bright_black")
            continue
        unit = found.mapping.channels[channel].unit
        row = found.info[found.info["name"] == channel.encode()][0]
        values = found.rows[channel]
        si = row["unit"].decode()
        table.add_row(name, unit or si, channel, f"{values.min():.4g}", f"{values.max():.4g}", si)
    console.print(table)
    for name, why in found.source.left_out.items():
        console.print(f"left out: {name}, {why}")
    untold = [name for name, channel in used.items() if not found.mapping.channels[channel].unit]
    if untold:
        console.print(f"no unit is told for {', '.join(untold)}: SI was taken; --channel laser=NAME mm says another")
    lost = int(found.index[-1] - found.index[0]) + 1 - len(found.index)
    gap = f", {lost} missing between them" if lost else ""
    console.print(f"{len(found.rows)} scans at {found.rate_hz} Hz, {len(found.rows) / found.rate_hz:.6g} s{gap}")
    for instant, frequency, amplitude in found.drive[:10]:
        since = (instant - found.start_ns) / 1e9
        console.print(f"from {since:.6g} s: {frequency:.6g} Hz, amplitude {amplitude:.4g}")
    if len(found.drive) > 10:  # as above
        console.print(f"... {len(found.drive)} settings of the drive in all")
    for label in found.labels:
        console.print(f"remark: {label}")
