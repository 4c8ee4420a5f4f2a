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
"""Fuzz targets for foreign measurements: a small file of each format, damaged, and mappings of channels."""

from __future__ import annotations

import io
import tempfile
import wave
from collections.abc import Callable
from pathlib import Path

import h5netcdf
import h5py
import nptdms
import numpy as np
import pyarrow as pa
import pyarrow.parquet
from hypothesis import strategies as st
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from fuzz.mutation import mutated, mutated_lines
from fuzz.target import Target
from impact_rig.errors import ConfigError
from impact_rig.runs.exports import write_columns
from impact_rig_studies.importing.assignment import guess, with_channel
from impact_rig_studies.importing.conversion import convert
from impact_rig_studies.importing.mapping import refined
from impact_rig_studies.importing.readers import read
from impact_rig_studies.importing.signals import Abscissa, AbscissaKind, ImportedSignals, Signal
from impact_rig_studies.importing.units import Sensitivity, doubt, quantity, unit_factor

MODULES = tuple(
    f"impact_rig_studies/importing/{name}.py" for name in ("readers/delimited", "columns", "uniform", "conversion")
)
SCANS = 24
unit_factor("furlong", "m")  # reads pint's units once; otherwise each forked reader that needs them reads them again
COLUMNS = {name: np.arange(SCANS) / (100.0 * (k + 1)) for k, name in enumerate(("time", "laser", "base", "current"))}
MAPPING = """\
rate_hz: 100
resample_hz: 200
frequency: 9.1
gap_mm: 6
notes: [a, b]
channels:
  laser:
    column: laser
    unit: mm
    sign: -1
    noise: 1.0e-6
  base: {column: base, unit: V, sensitivity: 500 mV/mm}
"""


def _csv() -> bytes:
    lines = [",".join(f"{name} [mm]" if name == "laser" else name for name in COLUMNS)]
    return "\n".join([*lines, *(",".join(map(str, row)) for row in zip(*COLUMNS.values(), strict=True))]).encode()


def _npz() -> bytes:
    file = io.BytesIO()
    np.savez(file, **COLUMNS)
    return file.getvalue()


def _parquet() -> bytes:
    file = io.BytesIO()
    pa.parquet.write_table(pa.table(COLUMNS), file)
    return file.getvalue()


def _wav() -> bytes:
    file = io.BytesIO()
    with wave.open(file, "wb") as sound:
        sound.setparams((2, 2, 1000, 0, "NONE", ""))
        sound.writeframes(np.arange(2 * SCANS, dtype="<i2").tobytes())
    return file.getvalue()


def _matlab() -> bytes:
    file = io.BytesIO()
    savemat(file, {**COLUMNS, "fs": 100.0})
    return file.getvalue()


def _netcdf() -> bytes:
    file = io.BytesIO()
    with h5netcdf.File(file, "w") as content:
        content.attrs["sample_rate"] = 100.0
        content.dimensions = {"response_channels": 3, "time_samples": SCANS}
        data = content.create_variable("time_data", ("response_channels", "time_samples"), "f8")
        data[...] = np.stack([COLUMNS[name] for name in ("laser", "base", "current")])
        names = content.create_group("channels").create_variable("comment", ("response_channels",), h5py.string_dtype())
        names[...] = np.array(["laser", "base", "current"], object)
    return file.getvalue()


def _uff() -> bytes:
    """Write the file as `impact-rig export` does: its own columns, one dataset each."""
    with tempfile.TemporaryDirectory() as folder:
        return write_columns(lambda: iter([COLUMNS]), Path(folder) / "all.uff").read_bytes()


def _tdms() -> bytes:
    file = io.BytesIO()
    with nptdms.TdmsWriter(file) as writer:
        about = {"wf_increment": 0.01, "wf_start_offset": 0.0, "unit_string": "mm"}
        names = ("laser", "base", "current")
        writer.write_segment([nptdms.ChannelObject("g", name, COLUMNS[name], properties=about) for name in names])
    return file.getvalue()


def _lvm() -> bytes:
    head = (
        "LabVIEW Measurement\nSeparator\tTab\nDecimal_Separator\t,\nX_Columns\tOne\n***End_of_Header***\n\n"
        "Channels\t2\nY_Unit_Label\tmm\tmm\nX_Dimension\tTime\tTime\nX0\t0,0\t0,0\nDelta_X\t0,01\t0,01\n"
        "***End_of_Header***\nX_Value\tlaser\tbase\tComment\n"
    )
    rows = zip(COLUMNS["time"], COLUMNS["laser"], COLUMNS["base"], strict=True)
    return (head + "\n".join("\t".join(f"{one:.4f}".replace(".", ",") for one in row) for row in rows)).encode()


def _decimal_comma() -> bytes:
    rows = zip(COLUMNS["time"], COLUMNS["laser"], COLUMNS["base"], strict=True)
    lines = ["# Rate: 100 Hz", "Datum;laser;base", ";µm;mm"]
    lines += [f"13.05.2024 10:00:{t:06.3f};{a:.3f};{b:.3f}".replace(".", ",").replace(",", ".", 2) for t, a, b in rows]
    return "\n".join(lines).encode("cp1252")


def _bag(suffix: str) -> bytes:
    """Write two topics of `Float64` with one message at each instant."""
    store = get_typestore(Stores.ROS1_NOETIC if suffix == ".bag" else Stores.ROS2_JAZZY)
    kind = "std_msgs/msg/Float64"
    encode = store.serialize_ros1 if suffix == ".bag" else store.serialize_cdr
    storage = rosbag2.StoragePlugin.SQLITE3 if suffix == ".db3" else rosbag2.StoragePlugin.MCAP
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"own{suffix}"
        writer = rosbag1.Writer(path) if suffix == ".bag" else rosbag2.Writer(path, version=9, storage_plugin=storage)
        with writer:
            topics = {
                name: writer.add_connection(f"/{name}", kind, typestore=store)  # type: ignore[arg-type]  # of its own
                for name in ("laser", "base")
            }
            for scan in range(SCANS):
                for name, topic in topics.items():
                    data = encode(store.types[kind](COLUMNS[name][scan]), kind)
                    writer.write(topic, 10**9 + round(1e9 * COLUMNS["time"][scan]), data)  # type: ignore[arg-type]
        return path.read_bytes() if path.is_file() else next(path.glob(f"*{suffix}")).read_bytes()


def _reads(suffix: str) -> Callable[[bytes], None]:
    """Make a check that reads a file; signals of a WAV file have no descriptive names."""
    said = "channels: {laser: {column: channel_0, unit: mm}, base: {column: channel_1, unit: mm}}"

    def check(content: bytes) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"own{suffix}"
            path.write_bytes(content)
            source = read(path)
        found = convert(source, refined(guess(source), said if suffix == ".wav" else "{}"))
        assert len(found.rows) == len(found.index)
        assert found.rate_hz >= 1
        assert (np.diff(found.index) > 0).all()

    return check


def mapping(text: str) -> None:
    """Apply a mapping to a sound file."""
    times = Abscissa(AbscissaKind.TIME, "s", values=COLUMNS["time"])
    signals = {name: Signal(values, abscissa=times) for name, values in COLUMNS.items() if name != "time"}
    source = ImportedSignals(Path("own.csv"), "text table", signals)
    found = convert(source, refined(guess(source), text))
    assert len(found.rows)
    assert np.isfinite(found.drive[0][1])


def words(text: str) -> None:
    """Parse a text as a unit, a sensitivity and a channel."""
    for wanted in ("m", "m/s^2"):
        factor = unit_factor(text, wanted)
        assert factor is None or (np.isfinite(factor) and factor != 0.0)
    found = Sensitivity.parse(text)
    assert found is None or (np.isfinite(found.volts) and found.volts != 0.0)
    doubt(text)
    with_channel({}, f"laser={text}", {"ai0": Signal(COLUMNS["laser"])})
    if quantity(text) is None and found is None:
        raise ConfigError("neither unit nor sensitivity")


WORDS = st.lists(
    st.sampled_from(
        ["m", "mm", "s", "g", "G", "V", "mV", "/", "*", "^", "(", ")", "2", "-", " ", "500", ".", ",", "°", "²", "µ"]
    )
    | st.characters(),
    max_size=12,
).map("".join)

_SEEDS = {
    ".csv": _csv(), ".npz": _npz(), ".parquet": _parquet(), ".wav": _wav(), ".mat": _matlab(), ".nc": _netcdf(),
    ".uff": _uff(), ".tdms": _tdms(), ".lvm": _lvm(), ".txt": _decimal_comma(),
    **{suffix: _bag(suffix) for suffix in (".mcap", ".db3", ".bag")},
}  # fmt: skip
TARGETS = (
    *(
        Target(f"import{suffix.replace('.', '_')}", mutated([seed]) | st.binary(max_size=200), _reads(suffix), MODULES)
        for suffix, seed in _SEEDS.items()
    ),
    Target(
        "import_mapping",
        mutated_lines(MAPPING),
        mapping,
        ("impact_rig_studies/importing/mapping.py", "impact_rig_studies/importing/conversion.py"),
    ),
    Target(
        "import_units",
        WORDS,
        words,
        ("impact_rig_studies/importing/units.py", "impact_rig_studies/importing/assignment.py"),
    ),
)
