# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig export`: a table topic of a run, the points of a campaign or a map as a file."""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.campaign.run import CAMPAIGN_FILE, CSV_FILE, open_finished
from impact_rig.cli import command
from impact_rig.cli.terminal import Console
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.maps import run as maps
from impact_rig.recording import open_run
from impact_rig.runs import export
from impact_rig.runs.exports import write_columns

FORMATS = ("csv", "npz", "parquet", "uff")


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = command.add(
        commands, "export", "write a table topic, a campaign or a map as .csv, .npz, .parquet or .uff",
        [
            ("export runs/demo/gap_6mm transmissibility/table dt.csv", "what was measured"),
            ("export runs/demo/gap_6mm daq/scan scans.npz", "every scan, for NumPy"),
            ("export runs/campaign_paper points curves.uff", "curves as a universal file (dataset 58)"),
        ],
    )  # fmt: skip
    parser.add_argument("path", type=Path, metavar="RUN", help="a run, or the directory of a campaign or a map")
    parser.add_argument("topic", help="e.g. transmissibility/table; points: of a campaign or a map")
    parser.add_argument("target", type=Path, metavar="FILE", help="its suffix chooses the format")
    parser.add_argument("--format", choices=FORMATS, help="instead of a suffix, which is then appended")
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    path, target = arguments.path, arguments.target
    if arguments.format and target.suffix != f".{arguments.format}":
        target = target.with_name(f"{target.name}.{arguments.format}")
    if (path / maps.MAP_FILE).exists():
        _need_points(arguments.topic)
        done = maps.open_map(path)
        if not (path / maps.CSV_FILE).exists():
            maps.write_results(done, {})
        written = write_columns(lambda: iter([_columns(path / maps.CSV_FILE)]), target)
    elif (path / CAMPAIGN_FILE).exists():
        _need_points(arguments.topic)
        open_finished(path)
        written = write_columns(lambda: iter([_columns(path / CSV_FILE)]), target)
    else:
        with open_run(path) as run:
            written = export(run, arguments.topic, target)
    Console().print(str(written))
    return 0


def _need_points(topic: str) -> None:
    if topic != "points":
        raise ConfigError(f"of a campaign or a map there are points, got {topic!r}")


def _columns(path: Path) -> dict[str, NDArray[np.generic]]:
    """Return the columns of a table of points; one of numbers has NaN where nothing was measured."""
    try:
        with path.open(encoding="utf-8", newline="") as file:
            names, *rows = csv.reader(file)
    except (OSError, ValueError) as error:
        raise RecordingError(f"cannot read {path}: {error}") from error
    found: dict[str, NDArray[np.generic]] = {}
    for name, texts in zip(names, zip(*rows, strict=True), strict=True):
        try:
            found[name] = np.array([float(text) if text else np.nan for text in texts])
        except ValueError:
            found[name] = np.array(texts)
    return found
