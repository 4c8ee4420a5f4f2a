# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`impact-rig export`: a table topic of a run, the points of a campaign or a map as a file."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.campaign.results import Point, table
from impact_rig.campaign.run import CAMPAIGN_FILE, open_finished
from impact_rig.cli.terminal import Console, subcommand
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.maps import run as maps
from impact_rig.recording import open_run
from impact_rig.runs import export
from impact_rig.runs.exports import write_columns

FORMATS = ("csv", "npz", "parquet", "uff")


def add_command(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the subcommand."""
    parser = subcommand(
        commands, "export", _run, "write a table topic, a campaign or a map as .csv, .npz, .parquet or .uff",
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


def _run(arguments: argparse.Namespace) -> int:
    path, target = arguments.path, arguments.target
    if arguments.format and target.suffix != f".{arguments.format}":
        target = target.with_name(f"{target.name}.{arguments.format}")
    is_map = maps.store(path).file.exists()
    if (is_map or (path / CAMPAIGN_FILE).exists()) and arguments.topic != "points":
        raise ConfigError(f"of a campaign or a map there are points, got {arguments.topic!r}")
    if is_map:
        written = write_columns(lambda: iter([_columns(*maps.table(maps.open_map(path)))]), target)
    elif (path / CAMPAIGN_FILE).exists():
        points = open_finished(path).points
        columns = _columns(*table(points))
        if target.suffix == ".uff":
            columns = _response(points)
        written = write_columns(lambda: iter([columns]), target)
    else:
        with open_run(path) as run:
            written = export(run, arguments.topic, target)
    Console().print(str(written))
    return 0


def _columns(names: Sequence[str], rows: Sequence[Sequence[object]]) -> dict[str, NDArray[np.generic]]:
    """Return a table by columns: numbers, or texts where a column has any."""
    if not rows:
        raise RecordingError("nothing was measured yet: there is no point to export")
    found: dict[str, NDArray[np.generic]] = {}
    for name, cells in zip(names, zip(*rows, strict=True), strict=True):
        texts = any(isinstance(cell, str) for cell in cells)
        found[name] = np.array([str(cell) for cell in cells] if texts else cells)
    return found


def _response(points: Sequence[Point]) -> dict[str, NDArray[np.generic]]:
    """Return settled points as a universal file has them: X_1/X_b over the frequency, a function per curve."""
    settled = [point for point in points if point.settled]
    if not settled:
        raise RecordingError("no point of this campaign is settled: there is no curve to export")
    one_current = len({point.current_a for point in points}) == 1
    return {
        "frequency": np.array([point.frequency_hz for point in settled]),
        "transmissibility": np.array([point.dt for point in settled]),
        "phase": np.array([point.phase_rad for point in settled]),
        "curve": np.array([
            ", ".join([
                point.study, point.label, point.direction, *([] if one_current else [f"{point.current_a:g} A"]),
                *(f"{name.rpartition('.')[2]} {value}" for name, value in point.axes.items()),
            ])
            for point in settled
        ]),
    }  # fmt: skip
