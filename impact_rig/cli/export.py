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
"""Command `impact-rig export`: a table of a run, a campaign, a map or a study of dynamics, written to a file."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from importlib import metadata
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from impact_rig.cli.terminal import Console
from impact_rig.errors import ConfigError
from impact_rig.recording import open_run
from impact_rig.runs import export
from impact_rig.runs.exports import write_columns

Columns = dict[str, NDArray[np.generic]]
Exporter = Callable[[Path], Mapping[str, Callable[[str], Columns]] | None]
"""Function that takes a directory and returns its tables by name, or None for another kind of directory. A table is a
function that returns the columns for a file with a given suffix.
"""
GROUP = "impact_rig.exporters"
"""Entry points through which packages contribute exporters of their own directories, each an `Exporter`."""


def run_export(arguments: argparse.Namespace) -> int:
    """Run `impact-rig export`: write the requested table to a file, print the file's path and return exit code 0.

    Raises:
        ConfigError: the campaign, map or study has no table of that name.
        RecordingError: the file cannot be written, or the run cannot be read or has no such table.
    """
    path, target = arguments.path, arguments.target
    exporters: Iterator[Exporter] = (one.load() for one in metadata.entry_points(group=GROUP))
    tables = next((found for exporter in exporters if (found := exporter(path)) is not None), None)
    if tables is not None:
        table = tables.get(arguments.topic)
        if table is None:
            listed = f"the tables {', '.join(tables)}" if tables else "no tables yet: export again when it has results"
            raise ConfigError(f"{path} has no table {arguments.topic!r}; it has {listed}")
        columns = table(target.suffix)
        written = write_columns(lambda: iter([columns]), target)
    else:
        with open_run(path, arguments.rig) as run:
            written = export(run, arguments.topic, target)
    Console().print(str(written))
    return 0
