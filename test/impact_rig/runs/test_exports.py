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
"""Exported tables contain the recorded bits."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from kits.recorded_rig import record as record_messages
from kits.recording import APPLIED_TOPIC, SCAN_TOPIC, START_NS, fill, scan_block

from impact_rig import codec
from impact_rig.blocks import TRANSMISSIBILITY, Table
from impact_rig.cli.main import main
from impact_rig.driver import LocalRig
from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.recording import open_run
from impact_rig.rig import Rig
from impact_rig.rig.config import RigConfig
from impact_rig.runs import export
from impact_rig.runs.exports import write_columns
from impact_rig.runs.recorded_journal import TOPIC

TEXTS_NAME = "/rig/texts"
THIRD_VERSION = Path(__file__).parents[2] / "data" / "third_version"


@pytest.fixture
def run(record):
    with record() as writer:
        fill(writer, 30)
        writer.add_topic(type(SCAN_TOPIC)(name=TEXTS_NAME, type_name=SCAN_TOPIC.type_name, schema=SCAN_TOPIC.schema))
        rows = np.zeros(2, TOPIC.columns)
        rows["key"] = [b"barriers.gap_m", "µ".encode()]
        rows["value"] = [0.1 + 0.2, np.nan]
        writer.write(TEXTS_NAME, codec.encode(Table(START_NS, rows)), START_NS - 1)
    with open_run(writer.directory) as opened:
        yield opened


LEADING = ["time", "timestamp", "earlier"]


def expected():
    """Return the times since the first scan [ns], and the other columns by name."""
    rows = np.concatenate([codec.decode(scan_block(number)).rows for number in range(30)])
    since_ns = np.repeat(np.arange(30) * 10_000_000, 100) + np.round(rows["time"] * 1e9).astype(np.int64)
    return since_ns, {name: rows[name] for name in rows.dtype.names if name != "time"}


def test_npz_files_contain_the_exact_columns(run, tmp_path):
    since_ns, columns = expected()
    with np.load(export(run, "daq/scan", tmp_path / "scan.npz")) as found:
        assert found.files == [*LEADING, *columns]
        np.testing.assert_array_equal(found["timestamp"], (START_NS + since_ns).astype("datetime64[ns]"))
        np.testing.assert_allclose(found["time"], 1e-9 * since_ns, rtol=1e-12)
        for name, column in columns.items():
            assert found[name].tobytes() == column.tobytes()
            assert found[name].dtype == column.dtype


def test_csv_reads_back_to_the_same_bits(run, tmp_path):
    since_ns, columns = expected()
    with export(run, "/rig/daq/scan", tmp_path / "scan.csv").open(newline="") as file:
        header, *lines = csv.reader(file)
    assert header == [*LEADING, *columns]
    dates = np.array([line[1] for line in lines], "datetime64[ns]")
    np.testing.assert_array_equal(dates, (START_NS + since_ns).astype("datetime64[ns]"))
    for number, column in enumerate(columns.values(), start=3):
        read = np.array([float(line[number]) for line in lines]).astype(column.dtype)
        assert read.tobytes() == column.tobytes()


def test_time_continues_across_blocks_and_is_the_same_in_all_topics(run, tmp_path):
    """Time must not restart in each block; a stamp of 19 digits would be rounded by a spreadsheet."""
    with np.load(export(run, "daq/scan", tmp_path / "scan.npz")) as found:
        assert (np.diff(found["time"]) > 0.0).all()
        assert found["time"][[0, -1]].tolist() == [0.0, pytest.approx(0.2999, abs=1e-12)]
    with np.load(export(run, "texts", tmp_path / "journal.npz")) as found:
        assert found["time"].tolist() == [0.0, 0.0]  # stamped START_NS, as the first scan


def test_text_columns_are_exported_as_text(run, tmp_path):
    with export(run, "texts", tmp_path / "journal.csv").open(newline="", encoding="utf-8") as file:
        first, second = csv.DictReader(file)
    assert (first["key"], second["key"]) == ("barriers.gap_m", "µ")
    assert float(first["value"]) == 0.1 + 0.2
    assert second["value"] == "nan"
    with np.load(export(run, "texts", tmp_path / "journal.npz")) as found:
        assert found["key"].tolist() == ["barriers.gap_m", "µ"]


@pytest.mark.parametrize("is_table", [False, True], ids=["this version", "third version"])
def test_a_journal_is_exported_with_one_row_per_entry(tmp_path, is_table):
    """A recording of the third version contains the journal as a table."""
    rig = Rig(RigConfig())
    rig.configure({"barriers.gap_m": 0.1 + 0.2})
    found = [("rig/journal", entry) for entry in rig.take_journal()]
    source = THIRD_VERSION if is_table else record_messages(tmp_path / "run", found)
    with open_run(source) as run, export(run, "rig/journal", tmp_path / "journal.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["sequence"]) for row in rows][:1] == [0]
    assert rows[0]["kind"] == "start"
    if not is_table:
        assert json.loads(rows[1]["values"]) == {"barriers.gap_m": 0.1 + 0.2}


@pytest.mark.parametrize("former", ["curve", "held", "locked"])
def test_sweeps_of_earlier_versions_are_exported(former, tmp_path):
    """Each kind of sweep has its own topic there; in this version, `sweep/table` contains all of them."""
    rows = np.zeros(2, TRANSMISSIBILITY)
    rows["frequency"] = [9.0, 9.1]
    name = f"transmissibility/{former}"
    source = record_messages(tmp_path / "run", [("daq/info", Rig(RigConfig()).info()), (name, Table(0, rows))])
    assert main(["info", str(source)]) == 0
    with open_run(source) as run, export(run, name, tmp_path / "sweep.csv").open(newline="") as file:
        assert [float(row["frequency"]) for row in csv.DictReader(file)] == [9.0, 9.1]


def test_rows_published_before_the_recording_began_are_marked(run, tmp_path):
    """Thirteen of the sixteen rows belong to cases before this run."""
    for topic, earlier in (("daq/scan", 0), ("texts", 1)):
        with np.load(export(run, topic, tmp_path / f"{earlier}.npz")) as found:
            assert (found["earlier"] == earlier).all()


def test_a_publish_time_that_repeats_the_log_time_marks_no_row(tmp_path):
    """Log times of a rig in one process count from 1970; this must not make a message `earlier`."""
    with LocalRig(record=tmp_path / "run") as rig:
        rig.step()
    with open_run(tmp_path / "run") as run, np.load(export(run, "daq/scan", tmp_path / "scan.npz")) as found:
        assert not found["earlier"].any()


def test_parquet_files_contain_the_exact_columns(run, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    since_ns, columns = expected()
    table = parquet.read_table(export(run, "daq/scan", tmp_path / "scan.parquet"))
    assert table.column_names == [*LEADING, *columns]
    np.testing.assert_array_equal(table["timestamp"].to_numpy(), (START_NS + since_ns).astype("datetime64[ns]"))
    for name, column in columns.items():
        assert table[name].to_numpy().tobytes() == column.tobytes()
    journal = parquet.read_table(export(run, "texts", tmp_path / "journal.parquet"))
    assert journal["key"].to_pylist() == ["barriers.gap_m", "µ"]


@pytest.mark.parametrize(("library", "suffix", "name"), [("pyarrow", "parquet", "Parquet"), ("pyuff", "uff", "UFF")])
def test_a_missing_library_is_named_with_the_extra_that_installs_it(run, tmp_path, monkeypatch, library, suffix, name):
    monkeypatch.setitem(sys.modules, library, None)  # not to be imported
    with pytest.raises(
        ImpactRigError, match=rf"{name} needs {library}, which is not installed: pip install 'impact_rig\[exchange\]'"
    ):
        export(run, "daq/scan", tmp_path / f"scan.{suffix}")
    assert list(tmp_path.glob(f"*.{suffix}")) == []


def test_universal_files_contain_the_columns(run, tmp_path):
    pyuff = pytest.importorskip("pyuff")
    since_ns, columns = expected()
    sets = pyuff.UFF(str(export(run, "daq/scan", tmp_path / "scan.uff"))).read_sets()
    assert [(one["type"], one["id1"], one["func_type"]) for one in sets] == [(58, name, 1) for name in columns]
    for one, column in zip(sets, columns.values(), strict=True):
        np.testing.assert_allclose(one["x"], 1e-9 * since_ns, rtol=1e-9, atol=1e-12)
        np.testing.assert_array_equal(one["data"], column.astype(float))


def test_a_curve_is_a_frequency_response_function_per_gap(tmp_path):
    pyuff = pytest.importorskip("pyuff")
    columns = {
        "frequency": np.array([9.0, 8.0, 9.0, 8.5, 8.7]),
        "transmissibility": np.array([50.0, 4.0, 100.0, np.nan, 20.0]),
        "phase": np.array([-1.0, -0.1, -1.5, np.nan, -0.2]),
        "gap": np.array([0.006, 0.006, 0.0, 0.0, 0.0]),
        "regime": np.array(["periodic"] * 5),
    }
    target = write_columns(lambda: iter([columns]), tmp_path / "curve.uff")
    without, gap = pyuff.UFF(str(target)).read_sets()
    assert (without["id1"], gap["id1"]) == ("X_1/X_b, no sphere", "X_1/X_b, gap 6 mm")
    assert gap["func_type"] == 4
    assert gap["x"].tolist() == [8.0, 9.0]
    np.testing.assert_array_equal(gap["data"], np.array([4.0, 50.0]) * np.exp(1j * np.array([-0.1, -1.0])))
    assert without["x"].tolist() == [8.7, 9.0]


def test_rows_without_numbers_are_left_out_of_a_universal_file(tmp_path):
    """A measurement that was refused must not be in the file with a DT of 0."""
    pyuff = pytest.importorskip("pyuff")
    columns = {
        "time": np.arange(4.0), "dt": np.array([3.0, np.nan, 5.0, 6.0]),
        "never": np.full(4, np.nan),
    }  # fmt: skip
    found = pyuff.UFF(str(write_columns(lambda: iter([columns]), tmp_path / "dt.uff"))).read_sets()
    one = found[0] if isinstance(found, list) else found
    assert (one["id1"], one["x"].tolist(), one["data"].tolist()) == ("dt", [0.0, 2.0, 3.0], [3.0, 5.0, 6.0])


@pytest.mark.heavy
@pytest.mark.parametrize(
    ("rate_hz", "begin_s", "even"), [(5000, 0, 1), (5000, 3, 1), (3000, 0, 0), (5000, 12345.6788, 0)]
)
def test_times_in_a_universal_file_are_correct_to_the_last(tmp_path, rate_hz, begin_s, even):
    """With a step of 1/3000 s in six digits, the last time of a minute would be wrong by 0.2 scans."""
    pyuff = pytest.importorskip("pyuff")
    times = begin_s + np.arange(60 * rate_hz) / rate_hz
    columns = {"time": times, "x": np.ones(len(times))}
    found = pyuff.UFF(str(write_columns(lambda: iter([columns]), tmp_path / "x.uff"))).read_sets()
    one = found[0] if isinstance(found, list) else found
    assert one["abscissa_spacing"] == even
    np.testing.assert_allclose(one["x"], times, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("columns", [{"regime": np.array(["periodic"])}, {"time": np.zeros(0), "x": np.zeros(0)}])
def test_a_table_without_functions_is_not_exported_as_a_universal_file(tmp_path, columns):
    """Neither a table without numbers nor one without rows, as a topic with empty tables gives it, has a function."""
    pytest.importorskip("pyuff")
    with pytest.raises(RecordingError, match="of at least two points"):
        write_columns(lambda: iter([columns]), tmp_path / "none.uff")


def test_large_tables_are_written_in_batches(run, tmp_path, monkeypatch):
    monkeypatch.setattr("impact_rig.recording.columns.BATCH_BYTES", 10_000)
    since_ns, _ = expected()
    with np.load(export(run, "daq/scan", tmp_path / "scan.npz")) as found:
        np.testing.assert_allclose(found["time"], 1e-9 * since_ns, rtol=1e-12)
    lines = export(run, "daq/scan", tmp_path / "scan.csv").read_text().splitlines()
    assert len(lines) == len(since_ns) + 1


def test_error_messages_name_the_valid_choices(run, tmp_path, record):
    with pytest.raises(RecordingError, match=r"must end in one of \.csv, \.npz, \.parquet, \.uff"):
        export(run, "daq/scan", tmp_path / "scan.xlsx")
    with pytest.raises(RecordingError, match="carries std_msgs/msg/String, not tables"):
        export(run, "notes", tmp_path / "notes.csv")
    (tmp_path / "mine.csv").write_text("mine")
    with pytest.raises(RecordingError, match="exists already and is not overwritten"):
        export(run, "daq/scan", tmp_path / "mine.csv")
    assert (tmp_path / "mine.csv").read_text() == "mine"
    with pytest.raises(RecordingError, match="cannot be written: No such file or directory"):
        export(run, "daq/scan", tmp_path / "nowhere" / "scan.csv")


def test_a_topic_without_messages_or_with_changing_columns_is_rejected(record, tmp_path):
    with record("other") as writer:
        writer.add_topic(SCAN_TOPIC)
        writer.add_topic(APPLIED_TOPIC)
        writer.write(SCAN_TOPIC.name, scan_block(0), 0)
        writer.write(SCAN_TOPIC.name, codec.encode(Table(START_NS + 1, np.zeros(1, TOPIC.columns))), 0)
    with open_run(writer.directory) as run:
        with pytest.raises(RecordingError, match="changes its columns at"):
            export(run, "daq/scan", tmp_path / "scan.csv")
        with pytest.raises(RecordingError, match="has no message"):
            export(run, "shaker/applied", tmp_path / "applied.csv")
    assert list(tmp_path.glob("*.csv")) == []
    assert list(tmp_path.glob(".*partial")) == []


def test_a_table_becomes_a_data_frame_with_the_columns_of_the_export(run, tmp_path):
    pandas = pytest.importorskip("pandas")
    frame = run.to_dataframe("daq/scan")
    with np.load(export(run, "daq/scan", tmp_path / "scan.npz")) as found:
        assert list(frame.columns) == found.files
        for name in found.files:
            np.testing.assert_array_equal(frame[name].to_numpy(), found[name])
    assert frame["timestamp"].dtype == np.dtype("datetime64[ns]")
    assert frame.set_index("time")["laser"].loc[0.1:0.2].notna().all()
    assert pandas.api.types.is_string_dtype(run.to_dataframe("texts")["key"])


@pytest.mark.heavy
def test_a_table_becomes_a_dataset_over_time_with_units(tmp_path):
    pytest.importorskip("xarray")
    with LocalRig(record=tmp_path / "run") as rig:
        rig.step()
    with open_run(tmp_path / "run") as run:
        scans, info = run.to_xarray("daq/scan"), run.to_xarray("daq/info")
    assert scans.sizes == {"time": 100}
    assert {name: scans[name].attrs["units"] for name in ("laser", "accelerometer", "time")} == {
        "laser": "m", "accelerometer": "m/s^2", "time": "s",
    }  # fmt: skip
    assert float(scans.laser.sel(time=0.005, method="nearest")) == float(scans.laser[50])
    assert scans.attrs["topic"] == "/rig/daq/scan"
    assert info["sensitivity"].attrs["units"] == "V/unit"


@pytest.mark.parametrize(("call", "library"), [("to_dataframe", "pandas"), ("to_xarray", "xarray")])
def test_a_missing_library_of_tables_is_named_with_the_extra_that_installs_it(run, monkeypatch, call, library):
    monkeypatch.setitem(sys.modules, library, None)  # not to be imported
    with pytest.raises(ImpactRigError, match=rf"{call}\(\) needs {library}.*pip install 'impact_rig\[tables\]'"):
        getattr(run, call)("daq/scan")
