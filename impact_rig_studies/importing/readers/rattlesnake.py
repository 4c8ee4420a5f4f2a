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
"""Reader of the netCDF4 files that Rattlesnake streams.

A file contains the stream `time_data`, further streams `time_data_N` and the table `channels`. Each start of a stream
creates a new variable (Rattlesnake, `components/streaming.py`).
"""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import numpy as np

from impact_rig.errors import RecordingError
from impact_rig_studies.importing.limits import check_column_count
from impact_rig_studies.importing.readers.hdf5 import Hdf5Tree, attribute
from impact_rig_studies.importing.signals import ImportedSignals, Signal, UniqueNames, even_times

STREAM = re.compile(r"time_data(?:_(\d{1,6}))?")


def read(path: Path, content: bytes, library: ModuleType) -> ImportedSignals:
    """Read all channels of all streams of a Rattlesnake file as signals; `library` is h5py.

    The name of a signal is the comment of its channel, or else its node with the direction, or else `channel_` with its
    number from 0. The name begins with the name of the stream, except for the longest stream.

    Raises:
        RecordingError: the file is not a Rattlesnake file, its rate is not finite and above 0, or data are kept outside
            the file.
        BudgetError: the streams have more values than a file of this size may contain, or too many channels.
    """
    if content[:3] == b"CDF":
        raise RecordingError(
            f"{path} is netCDF of the classic format (netCDF 3): only netCDF4 files of Rattlesnake can be read; "
            "export the measurement in another format"
        )
    tree = Hdf5Tree(library, len(content))
    with tree.open(content) as file:
        members = dict(tree.members(file))
        streams = {name: one for name, one in members.items() if STREAM.fullmatch(name) and hasattr(one, "shape")}
        rate = attribute(file, "sample_rate")
        if not streams or rate is None:
            missing = "attribute sample_rate" if streams else "variable time_data"
            raise RecordingError(
                f"{path} is not a file that Rattlesnake streamed: it has no {missing}; export the measurement in "
                "another format"
            )
        rate_hz = float(rate)
        if not (np.isfinite(rate_hz) and rate_hz > 0.0):
            raise RecordingError(
                f"{path}: its attribute sample_rate must be finite and > 0 Hz, got {rate_hz:g}; correct it in the file"
            )
        table = dict(tree.members(members["channels"])) if "channels" in members else {}
        longest = max(streams, key=lambda name: streams[name].shape[-1] if streams[name].shape else 0)
        signals: dict[str, Signal] = {}
        names = UniqueNames()
        for name in sorted(streams, key=lambda name: (name != longest, name)):
            values = tree.array(name, streams[name])
            if values is None:
                continue
            rows = np.atleast_2d(values.astype(np.float64))
            check_column_count(len(rows))
            words = {
                key: texts if len(texts) == len(rows) else [""] * len(rows)
                for key in ("comment", "node_number", "node_direction", "unit")
                for texts in [tree.texts(key, table[key]) if key in table else []]
            }
            for number, row in enumerate(rows):
                node = f"{words['node_number'][number]}{words['node_direction'][number]}".strip()
                plain = words["comment"][number].strip() or node or f"channel_{number}"
                own = plain if name == longest else f"{name} {plain}"
                signals[names.unique(own)] = Signal(
                    row, words["unit"][number].strip(), even_times(rate_hz), origin=f"{name}, channel {number + 1}"
                )
    remarks: tuple[str, ...] = ()
    if len(streams) > 1:
        lengths_s = {one.origin.partition(",")[0]: len(one.values) / rate_hz for one in signals.values()}
        lengths = ", ".join(f"{name} {length_s:g} s" for name, length_s in lengths_s.items())
        remarks = (f"{len(streams)} streams ({lengths}): names without a prefix are of the longest, {longest}",)
    return ImportedSignals(path, "Rattlesnake netCDF4", signals, left_out=tree.left_out, remarks=remarks)
