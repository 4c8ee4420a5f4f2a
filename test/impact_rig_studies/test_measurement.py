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
"""Measurements of other rigs: every format returns what was measured, and mistakes in a file are reported."""

from __future__ import annotations

import functools
import os
import re
import signal
import warnings
import wave
from collections.abc import Callable
from pathlib import Path

import attrs
import numpy as np
import pytest
from numpy.typing import NDArray

from impact_rig import topics
from impact_rig.cli.main import main
from impact_rig.errors import ImpactRigError, RecordingError
from impact_rig.recording import open_run
from impact_rig.runs import export, reanalysis, verification
from impact_rig.runs.excerpts import calibration_rows
from impact_rig.testing import LocalRig
from impact_rig_studies.campaign.run import open_finished
from impact_rig_studies.identification.measurements import recorded_decay
from impact_rig_studies.importing import readers
from impact_rig_studies.importing.assignment import guess
from impact_rig_studies.importing.conversion import convert
from impact_rig_studies.importing.mapping import Channel, Mapping, as_yaml, refined
from impact_rig_studies.importing.signals import ImportedSignals
from impact_rig_studies.importing.store import write
from impact_rig_studies.measured import make_campaign

pytestmark = pytest.mark.heavy

RATE_HZ, SECONDS, GAP_M = 2000, 12, 0.006
READINGS_HZ = 500  # of sines, which need fewer scans than impacts
MILLIMETRE = 1e-3


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run with the sphere, driven from its first instant: 12 s at 2 kS/s."""
    rig = LocalRig({"daq.rate_hz": RATE_HZ, "daq.block_scans": 200, "barriers.gap_m": GAP_M})
    rig.command(frequency_hz=9.1, current_a=0.52)
    rig.step(SECONDS * RATE_HZ // 200)
    return rig.save(tmp_path_factory.mktemp("recorded") / "run")


def scans(run: Path) -> NDArray[np.void]:
    with open_run(run) as found:
        return np.concatenate([table.rows for table in found.tables(topics.SCAN)])


def analysed(run: Path) -> tuple[NDArray[np.void], list[bytes]]:
    """Return the measurements and impacts that the analysis finds in a run."""
    with open_run(run) as found:
        findings = list(reanalysis.analyze(found))
    impacts = [table.stamp_ns.to_bytes(8, "big") + table.rows.tobytes() for one in findings for table in one.impacts]
    return reanalysis.rows(reanalysis.measurements(iter(findings))), impacts


def write_wav(path: Path, rows: NDArray[np.void]) -> None:
    full = np.stack([rows["laser"] / 0.01, rows["base"] / 0.0125, rows["current"] / 25.0], axis=1)
    with wave.open(str(path), "wb") as file:
        file.setparams((3, 2, RATE_HZ, 0, "NONE", ""))
        file.writeframes(np.round(full * 2**15).clip(-(2**15), 2**15 - 1).astype("<i2").tobytes())


def write_matlab(path: Path, rows: NDArray[np.void]) -> None:
    io = pytest.importorskip("scipy.io")
    io.savemat(path, {**{name: rows[name] for name in ("accelerometer", "laser", "base", "current")}, "fs": RATE_HZ})


def write_rattlesnake(path: Path, rows: NDArray[np.void]) -> None:
    h5netcdf = pytest.importorskip("h5netcdf")
    h5py = pytest.importorskip("h5py")
    names = ("accelerometer", "laser", "base", "current")
    with h5netcdf.File(path, "w") as file:
        file.attrs["sample_rate"] = RATE_HZ
        file.dimensions = {"response_channels": 4, "time_samples": len(rows)}
        data = file.create_variable("time_data", ("response_channels", "time_samples"), "f8")
        data[...] = np.stack([rows[name] for name in names])
        group = file.create_group("channels")
        for key, words in (("comment", names), ("unit", ("m/s^2", "m", "m", "A"))):
            column = group.create_variable(key, ("response_channels",), h5py.string_dtype())
            column[...] = np.array(words, object)


EXACT = ("csv", "npz", "parquet", "uff", "mat", "nc")


@pytest.mark.parametrize("kind", EXACT)
def test_an_exported_and_imported_run_is_measured_identically_bit_for_bit(
    recorded: Path, tmp_path: Path, kind: str
) -> None:
    """Scans, measurements and impacts are equal, with the commands and the calibration of the run."""
    source = tmp_path / f"scans.{kind}"
    with open_run(recorded) as run:
        if kind in ("mat", "nc"):
            (write_matlab if kind == "mat" else write_rattlesnake)(source, scans(recorded))
        else:
            export(run, topics.SCAN.name, source)
        drive = readers.read(export(run, topics.APPLIED.name, tmp_path / "drive.csv"))
        sheet = readers.read(export(run, topics.INFO.name, tmp_path / "sheet.csv"))
    found = readers.read(source)
    target = write(convert(found, guess(found), drive, sheet), tmp_path / "run")
    ours, theirs = scans(target), scans(recorded)
    assert all(ours[name].tobytes() == theirs[name].tobytes() for name in ("accelerometer", "laser", "base", "current"))
    rows, impacts = analysed(target)
    expected, struck = analysed(recorded)
    assert expected["settled"].any()
    assert struck
    assert rows.tobytes() == expected.tobytes()
    assert impacts == struck
    with open_run(target) as run:
        with open_run(recorded) as original:  # what identify takes besides the measurements
            assert calibration_rows(run).tobytes() == calibration_rows(original).tobytes()
        kept = reanalysis.rows(list(run.tables(topics.TRANSMISSIBILITY_TABLE)))
        assert kept.tobytes() == rows.tobytes(), "what the import kept is what the analysis finds"
        assert str(verification.verify(run)).endswith("an imported measurement: there is nothing to re-simulate")
        live = reanalysis.compare(run, [], [])
        assert (live.same, live.identical) == (None, False), (
            "a bug once: identical to live results, of which there are none"
        )
        assert "imported" in str(live)


def test_an_imported_free_decay_is_identified_identically(tmp_path: Path) -> None:
    """An imported decay has no journal: it begins at the largest distance of the structure, not at the pluck."""
    rig = LocalRig({"daq.rate_hz": RATE_HZ, "daq.block_scans": 200, "sphere.present": False})
    rig.run(seconds=0.2)
    rig.core.pluck(0.004)
    rig.run(seconds=10.0)
    original = rig.save(tmp_path / "plucked")
    with open_run(original) as run:
        expected = recorded_decay(run)
        source = readers.read(export(run, topics.SCAN.name, tmp_path / "scans.npz"))
        sheet = readers.read(export(run, topics.INFO.name, tmp_path / "sheet.csv"))
    with open_run(write(convert(source, guess(source), sheet=sheet), tmp_path / "run")) as run:
        found = recorded_decay(run)
    for name in ("natural_frequency_hz", "damping_ratio"):
        assert abs(getattr(found, name) - getattr(expected, name)) < getattr(expected, f"u_{name}")


def test_a_wav_file_yields_the_transmissibility_within_its_resolution(recorded: Path, tmp_path: Path) -> None:
    """16 bits full scale: steps of 0.3 and 0.4 µm; with three channels there are no statements about impacts."""
    write_wav(tmp_path / "sound.wav", scans(recorded))
    source = readers.read(tmp_path / "sound.wav")
    mapping = Mapping(
        channels={
            "laser": Channel(column="channel_0", unit="mm", scale=10.0, calibration={"lag": 7e-4, "lag_order": 1}),
            "base": Channel(column="channel_1", unit="mm", scale=12.5, calibration={"lag": 2.25e-4, "lag_order": 2}),
            "current": Channel(column="channel_2", unit="A", scale=25.0),
        },
        frequency=9.1,
    )
    found = convert(source, mapping)
    target = write(found, tmp_path / "run")
    assert found.info["name"].tolist() == [b"laser", b"base", b"current"]
    row, expected = analysed(target)[0][-1], analysed(recorded)[0][-1]
    assert row["transmissibility"] == pytest.approx(expected["transmissibility"], rel=4e-3)
    assert np.isnan(row["impacts_per_cycle"])
    assert expected["impacts_per_cycle"] > 1.0


def table(tmp_path: Path, text: str, name: str = "own.csv") -> ImportedSignals:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return readers.read(tmp_path / name)


def lines(change: Callable[[int], str], head: str = "t,x1 [mm],xb [mm]", count: int = 40) -> str:
    return "\n".join([head, *(change(k) for k in range(count))]) + "\n"


def semicolons(k: int) -> str:
    return f"{k / 100:g};{k}.0;{2 * k}.5".replace(".", ",")


@pytest.mark.parametrize(
    ("text", "name", "laser_m", "gap"),
    [
        (lines(lambda k: f"{k / 100},{k},{2 * k}"), "gap_4mm_9.1Hz.csv", 1e-3, 0.004),
        (lines(semicolons, "time;laser (µm);base (µm)"), "no_sphere.csv", 1e-6, 0.0),
        # numbers in quotes, and a first row without decimals
        (lines(lambda k: f'"{k / 100}","{k}","{2 * k}"', '"t","x1 [mm]","xb [mm]"'), "quoted.csv", 1e-3, None),
        (lines(lambda k: f"{k / 100:g};{k};{2 * k}".replace(".", ","), "t;x1 (mm);xb (mm)"), "own.csv", 1e-3, None),
        (lines(lambda k: f"{10 * k}\t{k}\t{k}", "t\tresponse\ttable\n[ms]\t[cm]\t[cm]"), "own.txt", 1e-2, None),
    ],
)  # fmt: skip
def test_headings_units_and_file_names_are_understood(
    tmp_path: Path, text: str, name: str, laser_m: float, gap: float | None
) -> None:
    source = table(tmp_path, text, name)
    found = convert(source, guess(source))
    assert found.rate_hz == 100
    assert found.rows["laser"][1] == pytest.approx(laser_m)
    assert found.mapping.gap == gap
    assert found.mapping.frequency == (9.1 if "9.1Hz" in name else None)


def test_a_mapping_supplies_what_headings_omit(tmp_path: Path) -> None:
    """Voltages with a sensitivity, sign and offset, frequency and gap from columns, and a given uniform rate."""
    head = "ai0,ai1,f,g"
    source = table(tmp_path, lines(lambda k: f"{k},{k},{9 if k < 20 else 10},{0 if k < 30 else 0.004}", head))
    text = """
rate_hz: 1000
frequency: f
gap: g
channels:
  laser: {column: ai0, unit: V, sensitivity: 500 mV/mm, sign: -1, offset: 0.001, sensitivity_uncertainty: 0.01}
  accelerometer: {column: ai1, unit: mV, sensitivity: 100 mV/g}
"""
    found = convert(source, refined(guess(source), text))
    assert found.rows["laser"][3] == pytest.approx(-6e-3 + 0.001)
    assert found.rows["accelerometer"][3] == pytest.approx(3e-3 / 0.1 * 9.80665)
    assert [one[:2] for one in found.drive] == [(0, 9.0), (20_000_000, 10.0)]
    assert [label.split()[0] for label in found.labels] == ["gap_m=0.0", "gap_m=0.004"]
    assert found.info["sensitivity_uncertainty"].tolist() == [0.0, 0.01]


MM = "channels: {laser: {column: x1, unit: mm}, base: {column: xb, unit: mm}}"
STEADY = lines(lambda k: f"{k / 100},{k},{k}", "t,x1,xb")


@pytest.mark.parametrize(
    ("text", "mapping", "why"),
    [
        (lines(lambda k: f"{k / 100},{k}" + (",7" if k == 9 else "")), "{}", "line 11 has 3 cells, the first row"),
        (lines(lambda k: f"{k / 100 + (0.004 if k == 7 else 0)},{k},{k}", "t,x1,xb"), MM, "time of value 8 is 0.40"),
        (lines(lambda k: f"{k / 100 if k != 7 else 0},{k},{k}", "t,x1,xb"), MM, "times must increase"),
        (lines(lambda k: f"{k},{k}", "x1,xb"), MM, "neither times nor a rate"),
        (STEADY, MM.replace("mm", "furlongs per"), "the unit of the channel laser must be a unit of m"),
        (STEADY, MM.replace("unit: mm", "unit: V"), "a voltage needs a sensitivity"),
        (STEADY, MM.replace("unit: mm", "unit: 9**9**9**9"), "must be a unit of m"),
        (STEADY, MM.replace("x1", "x2"), "no signal 'x2' for laser: choose one of x1, xb"),
        (STEADY, "channels: {laser: {column: null}}", "channels.laser.column must be a text, got null"),
        (STEADY, "chanels: {}", "unknown key chanels: did you mean channels"),
        (STEADY, MM + "\nrate_hz: .nan", "rate_hz must be a finite number"),
        (STEADY, MM + "\nrate_hz: 0", r"--scan-rate, or rate_hz in --mapping\) must be > 0"),
        (STEADY, MM + "\nrate_hz: 1" + 400 * "0", "rate_hz must be a finite number, got '1000"),
        (STEADY, MM + "\nrate_hz: 0x" + 5000 * "f", "rate_hz must be a finite number, got 'a number too large"),
        (STEADY, "channels: 0x" + 5000 * "f", "channels must be `key: value` pairs, got 'a number too large"),
        (STEADY, "channels: {laser: {column: 0x" + 5000 * "f" + "}}", "no signal 'a number too large"),
        (STEADY, MM + "\nrate_hz: 1.0e-50\nresample_hz: 200", "its times span"),
        (STEADY, MM + "\nrate_hz: 1.0e-6\nresample_hz: 200", "values after resampling"),
        (STEADY, MM + "\nrate_hz: 0.02\nresample_hz: 2000", "values after resampling"),  # 400 MiB of 24 scans
        (STEADY, MM + "\nresample_hz: 50", "must be at least that of the file, 100 Hz"),
        ("some words\n", "{}", "none of its first 1 lines is a row of numbers"),
    ],
)  # fmt: skip
def test_an_invalid_measurement_is_rejected_with_the_reason(tmp_path: Path, text: str, mapping: str, why: str) -> None:
    def imported() -> None:
        source = table(tmp_path, text)
        convert(source, refined(guess(source), mapping))

    with pytest.raises(ImpactRigError, match=why):
        imported()


@pytest.mark.parametrize(("text", "notes"), [("notes:", ()), ("notes: [a, null, 2]", ("a", "2")), ("notes: x", ("x",))])
def test_a_note_without_a_text_is_no_remark(text: str, notes: tuple[str, ...]) -> None:
    assert refined(Mapping(channels={}), text).notes == notes


def test_scans_that_are_missing_stay_missing_and_uneven_ones_can_be_resampled(tmp_path: Path) -> None:
    source = table(tmp_path, lines(lambda k: f"{(k if k < 20 else k + 5) / 100},{k},{k}"))
    assert convert(source, guess(source)).index.tolist() == [*range(20), *range(25, 45)]
    uneven = table(tmp_path, lines(lambda k: f"{(k + 0.3 * (k % 2)) / 100},{(k + 0.3 * (k % 2)) / 100},{k}"))
    found = convert(uneven, refined(guess(uneven), "resample_hz: 200"))
    assert found.rows["laser"] == pytest.approx(MILLIMETRE * np.arange(len(found.rows)) / 200)


def test_resampling_neither_fills_gaps_nor_moves_commands(tmp_path: Path) -> None:
    """A cubic must not bridge seconds without a scan, nor move commands if the rate of the times changes."""
    times = np.concatenate([np.arange(100) / 100, 1 + np.arange(200) / 200, 4 + np.arange(100) / 200])
    rows = [f"{t:.4f},{np.sin(20 * t):.9f},{9 if t < 1 else 10 if t < 4.25 else 11}" for t in times]
    source = table(tmp_path, "\n".join(["time,laser [m],frequency", *rows]) + "\n")
    found = convert(source, refined(guess(source), "resample_hz: 400"))
    assert found.index.tolist() == [*range(799), *range(1600, 1799)]
    assert found.rows["laser"] == pytest.approx(np.sin(20 * found.index / 400), abs=2e-3)
    assert [one[:2] for one in found.drive] == [(0, 9.0), (1_000_000_000, 10.0), (4_250_000_000, 11.0)]
    broken = table(tmp_path, "\n".join(["time,laser [m]", "0,0", "0.01,nan", "0.02,1"]) + "\n")
    with pytest.raises(ImpactRigError, match=r"laser cannot be resampled: value 2 is not a finite number"):
        convert(broken, refined(guess(broken), "resample_hz: 400"))


def test_a_calibration_sheet_does_not_shift_scan_0_twice(tmp_path: Path) -> None:
    """A `since_start` in the run, whose stamp is already that of scan 0, would put scan 0 12 s earlier."""
    source = table(tmp_path, lines(lambda k: f"{2 * 10**10 + k * 10**7},{k},{k}", "stamp_ns,laser,base"))
    sheet = table(tmp_path, "stamp_ns,name,since_start\n12000000000,laser,11.5\n12000000000,base,11.5\n", "sheet.csv")
    found = convert(source, guess(source), sheet=sheet)
    assert (found.start_ns, found.index[0]) == (500_000_000, 1950)
    assert found.info["since_start"].tolist() == [0.0, 0.0]


def test_commands_and_labels_of_a_file_that_spans_weeks_keep_their_instants(tmp_path: Path) -> None:
    """The number of a scan times 10**9 may exceed 64 bits; commands must not go back by years."""
    head, late_s = "t,laser,base,frequency,gap", 40 * 86_400
    rows = [*(np.arange(100) / 5000), *(late_s + np.arange(100) / 5000)]
    source = table(tmp_path, lines(lambda k: f"{rows[k]:.4f},{k},{k},{9 + k // 100},{k // 100 / 1e3}", head, 200))
    found = convert(source, guess(source))
    assert [one[0] for one in found.drive] == [0, late_s * 10**9]
    assert f"{late_s * 10**9}" in found.labels[1]


def test_a_value_unknown_over_many_scans_is_reported_once(tmp_path: Path) -> None:
    """NaN differs from NaN; this must not cause a remark and a command for every scan."""
    values = ["nan", "nan", "9", "9", "nan", "nan"]
    source = table(
        tmp_path, lines(lambda k: f"{k / 100},{k},{k},{values[k]},{values[k]}", "t,laser,base,frequency,gap", 6)
    )
    found = convert(source, guess(source))
    assert [one[0] for one in found.drive] == [0, 20_000_000, 40_000_000]
    assert len(found.labels) == 3


def test_a_file_in_place_of_the_run_is_reported(tmp_path: Path) -> None:
    """The message must name the file, instead of a NotADirectoryError."""
    source = table(tmp_path, STEADY)
    with pytest.raises(ImpactRigError, match="is a file, not a directory"):
        write(convert(source, refined(guess(source), MM)), tmp_path / "own.csv")


def test_a_mapping_is_read_back_as_written() -> None:
    """Numbers such as 1e-06 must not become texts, or the mapping that a run keeps is rejected."""
    laser = Channel(
        column='"1e-6"', unit="mm", scale=2e-7, calibration={"noise": 1e-6, "range_high": 1e16, "lag": 1.5e-7}
    )
    mapping = Mapping(channels={"laser": laser}, gap=1e-5, amplitude=-1e-5, frequency="µ 1e-06", notes=("say \\ 2e-7",))
    assert refined(Mapping(channels={}), as_yaml(mapping)) == mapping


def test_a_universal_file_has_one_abscissa(tmp_path: Path) -> None:
    """A signal as long as the first, at another rate, must not be put on the times of the first."""
    pyuff = pytest.importorskip("pyuff")
    sets = [
        {"type": 58, "binary": 1, "func_type": 1, "data": np.arange(50.0), "x": np.arange(50) / rate_hz,
         "abscissa_spacing": 1, "id1": name, "id2": "", "rsp_node": 1, "rsp_dir": 1, "ref_node": 1, "ref_dir": 1,
         "rsp_ent_name": name[:10], "ref_ent_name": "base", "orddenom_spec_data_type": 0}
        for name, rate_hz in (("laser", 1000), ("base", 1000), ("current", 500))
    ]  # fmt: skip
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ResourceWarning)  # pyuff leaves files to the garbage collection
        pyuff.UFF(str(tmp_path / "own.uff")).write_sets(sets, "add")
    found = readers.read(tmp_path / "own.uff")
    assert [one.rate_hz for one in found.signals.values()] == pytest.approx([1000, 1000, 500])
    assert list(guess(found).channels) == ["laser", "base"]
    with pytest.raises(ImpactRigError, match=r"current .* has other times than laser"):
        convert(found, refined(guess(found), "channels: {current: {column: current}}"))


def test_a_table_of_commands_counts_its_times_from_the_same_instant_as_the_scans(tmp_path: Path) -> None:
    """If each file counted from its own first row, a first command after 2 s would act on the first scan."""
    head, commands = "time,laser,base", "time,frequency,current\n2,9,0.5\n6,10,0.5\n"
    for begins_s, instants_s in ((0, [2.0, 6.0]), (1, [1.0, 5.0])):
        source = table(tmp_path, lines(lambda k, begins_s=begins_s: f"{begins_s + k / 10},{k},{k}", head, 100))
        found = convert(source, guess(source), table(tmp_path, commands, "drive.csv"))
        assert [one[0] / 1e9 for one in found.drive] == instants_s
    with pytest.raises(ImpactRigError, match=r"drive.csv: time 2 of 2 is not a finite number"):
        convert(source, guess(source), table(tmp_path, commands.replace("6,", "nan,"), "drive.csv"))


def test_commands_and_labels_of_a_file_are_converted_to_si_units(tmp_path: Path) -> None:
    """A current of 500 mA must not become one of 500 A."""
    head = "time [s],laser [mm],base [mm],speed [rpm],gap [mm]"
    source = table(tmp_path, lines(lambda k: f"{k / 10},{k},{k},{540 + k // 50},6", head, 100))
    mapping = refined(guess(source), "{frequency: speed, gap: gap}")
    commands = "time,frequency [kHz],current [mA peak]\n2,0.009,500\n6,0.010,500\n"
    found = convert(source, mapping, table(tmp_path, commands, "drive.csv"))
    assert [one[1:] for one in found.drive] == [(pytest.approx(9.0), pytest.approx(0.5)), (10.0, pytest.approx(0.5))]
    assert [one[1] for one in convert(source, mapping).drive] == pytest.approx([9.0, 541 / 60])
    assert any("0.006" in label for label in found.labels)
    with pytest.raises(
        ImpactRigError, match=r"drive.csv: 'current' must have a unit that can be converted to A, or no unit, got 'V'"
    ):
        convert(source, mapping, table(tmp_path, commands.replace("mA peak", "V"), "drive.csv"))


def test_an_export_cut_within_a_block_begins_with_its_first_row(tmp_path: Path) -> None:
    """The first stamp is that of the block, not of the first row: commands would be shifted by up to a block."""

    def row(k: int) -> str:
        return f"{10**9 + k // 10 * 10**8},{k % 10 / 100},{k},{k}"

    source = table(tmp_path, lines(lambda k: row(k + 5), "stamp_ns,time,laser,base"))
    found = convert(source, guess(source))
    assert found.start_ns == 1_050_000_000
    assert found.index.tolist() == list(range(40))


@pytest.mark.parametrize(
    ("head", "names", "units"),
    [
        ("time;value;value\ns;V;mV", ["value", "value_2"], ["V", "mV"]),
        ("time;value;value_2;value\ns;V;A;mV", ["value", "value_2", "value_3"], ["V", "A", "mV"]),
        ("time;value_3;value;value\ns;V;A;mV", ["value_3", "value", "value_3_2"], ["V", "A", "mV"]),
        ("time [s];ai0 [V];ai0 [A]", ["ai0", "ai0 [A]"], ["V", "A"]),
        ("time;laser;laser (raw)", ["laser", "laser (raw)"], ["", "raw"]),
    ],
)
def test_columns_with_equal_names_are_distinguished_and_keep_their_units(
    tmp_path: Path, head: str, names: list[str], units: list[str]
) -> None:
    """The first must not have the unit of the last; if names differ only in brackets, both are kept."""
    source = table(tmp_path, lines(lambda k: ";".join(f"{k + j}" for j in range(len(names) + 1)), head))
    assert list(source.signals) == names
    assert [one.unit for one in source.signals.values()] == units
    assert [one.values[0] for one in source.signals.values()] == [*range(1, len(names) + 1)]


def test_a_file_that_crashes_its_library_is_an_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The reader ends its process, as a memory fault would."""

    def crash(path: Path, content: bytes) -> ImportedSignals:
        os.kill(os.getpid(), signal.SIGSEGV)
        raise AssertionError

    monkeypatch.setitem(readers.FORMATS, ".npz", readers.Format("a file", crash))
    (tmp_path / "own.npz").write_bytes(b"PK")
    with pytest.raises(ImpactRigError, match=r"the process that reads it as a file crashed \(Segmentation fault\)"):
        readers.read(tmp_path / "own.npz")


def test_a_run_is_drawn_with_the_channels_that_it_has(tmp_path: Path) -> None:
    """The measurement has only an accelerometer; a warning of matplotlib about an empty spectrum is an error here."""
    np.savez(tmp_path / "own.npz", a=np.sin(0.3 * np.arange(4000)), rate=1000.0)
    words = ["--channel", "accelerometer=a", "m/s^2", "--frequency", "9", "--output", str(tmp_path / "run")]
    assert main(["import", str(tmp_path / "own.npz"), *words]) == 0
    words = ["analyze", str(tmp_path / "run"), "--figures", str(tmp_path / "figures"), "--format", "png"]
    assert main(words) == 0
    assert {one.stem for one in (tmp_path / "figures").iterdir()} == {"time_traces", "spectrum"}


def test_a_stated_rate_takes_precedence_over_rounded_times(tmp_path: Path) -> None:
    """Times of single precision, added up, are wrong by a sixth of a period after 4,096 values."""
    times = np.arange(4096) / 1280 * (1 - 4e-5)
    np.savez(tmp_path / "own.npz", time=times, laser=times, rate=1280.0)
    source = readers.read(tmp_path / "own.npz")
    assert convert(source, guess(source)).index.tolist() == list(range(4096))


def test_the_command_previews_the_import_before_it_writes_a_campaign(
    recorded: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with open_run(recorded) as run:
        file = export(run, topics.SCAN.name, tmp_path / "gap_6mm_9.1Hz.csv")
    words = ["import", str(file), "--output", str(tmp_path / "out")]
    assert main([*words, "--dry-run"]) == 0
    assert not (tmp_path / "out").exists()
    said = " ".join(capsys.readouterr().out.split())
    assert "nothing was written" in said
    assert "no unit is given for laser: m is assumed" in said
    advised = re.findall(r'--channel (\w+)="([^"]+)" states another', said)
    assert {name for name, _ in advised} == {"accelerometer", "laser", "base", "current"}
    assert main([*words, "--dry-run", "--channel", *(f"{name}={signal}" for name, signal in advised)]) == 0
    assert "no unit is given" not in capsys.readouterr().out
    assert main([*words, "--campaign"]) == 0
    points = (tmp_path / "out" / "points.csv").read_text(encoding="utf-8").splitlines()
    assert len(points) == 2
    assert points[1].startswith("measured,0.006,9.1,")
    assert main(["report", str(tmp_path / "out")]) == 0
    assert main([*words]) == 1, "nothing is overwritten"


def test_an_uncertainty_below_a_thousandth_is_not_shown_as_zero(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """For a DT far above resonance, or of a base in a wrong unit, 0.064 ± 0.000 would mean that it is exact."""
    times, rng = np.arange(40000) / 2000, np.random.default_rng(1)
    laser, base = (a * np.sin(2 * np.pi * 9.1 * times) + 1e-3 * rng.standard_normal(len(times)) for a in (1.0, 15.0))
    np.savez(tmp_path / "own.npz", time=times, laser=laser, base=base)
    assert main(["import", str(tmp_path / "own.npz"), "--output", str(tmp_path / "run"), "--frequency", "9.1"]) == 0
    capsys.readouterr()
    assert main(["analyze", str(tmp_path / "run")]) == 0
    value, u = re.findall(r"DT ([0-9.]+) ± ([0-9.]+) \(2u\)", capsys.readouterr().out)[0]
    assert float(u) > 0.0
    assert abs(float(value) - 1 / 15) <= 1.5 * float(u)  # what is shown is 2u


@pytest.mark.parametrize("more", [[], ["--campaign"]])
def test_two_files_of_one_name_are_rejected_before_any_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    """No file of a rejected campaign is written, so none blocks a later attempt."""
    turn = 2.0 * np.pi * 9.0 * np.arange(2_000) / RATE_HZ
    files = [tmp_path / folder / "own.npz" for folder in ("a", "b")]
    for file in files:
        file.parent.mkdir()
        np.savez(file, base=1e-3 * np.sin(turn), laser=1e-2 * np.sin(turn))
    words = ["import", *map(str, files), "--output", str(tmp_path / "out"), "--scan-rate", str(RATE_HZ), *more]
    assert main(words) == 1
    assert "are named 'own' without folder and suffix" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_dry_run_reports_why_a_column_is_unused_and_that_the_gap_is_unknown(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A second column of times and a missing gap have a line as well."""
    head = "timestamp,time,earlier,base [g],laser 1 [mm],top [mm],coil [mm],note,frequency [Hz]"
    rows = (f"2026-01-01T00:00:{0.01 * k:06.3f},{0.01 * k:.2f},0,{k},{k},{2 * k},{k},up,9" for k in range(400))
    (tmp_path / "own.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    words = ["import", str(tmp_path / "own.csv"), "--output", str(tmp_path / "run"), "--dry-run"]
    assert main([*words, "--channel", "laser=laser 1"]) == 0
    printed = capsys.readouterr().out
    for line in (
        "not used: earlier, its name matches no channel",
        "not used: top, the channel laser uses the signal laser 1",
        "not used: coil, its unit mm is not possible for the channel current",
        "left out of the import: note, texts",
        "left out of the import: time, the times are those of timestamp",
        "gap: unknown (--gap 6mm, or --gap none without the sphere)",
    ):
        assert line in printed
    assert re.findall(r"^ (\w+) .* not used *$", printed, re.MULTILINE) == ["earlier", "top", "coil"]
    assert re.search(r"^ frequency +Hz +frequency", printed, re.MULTILINE), "it is used"
    assert "not used: frequency" not in printed
    assert main([*words, "--channel", "laser=laser 1", "--gap", "6mm"]) == 0
    printed = capsys.readouterr().out
    assert "label from 0 s on: gap 6 mm" in printed
    assert "unknown" not in printed
    assert main([*words, "--channel", "laser=laser 1", "--gap", "coil"]) == 0
    assert re.search(r"^ coil +mm +gap *$", capsys.readouterr().out, re.MULTILINE)


@functools.cache
def readings(
    amplitude: float, step: float, rate_hz: float = READINGS_HZ, gap: str = "", frequency_hz: float = 9.1
) -> str:
    """Return a table of 12 s of readings in mm, in steps, under a sine; the times have six digits."""
    times = np.arange(round(SECONDS * rate_hz)) / rate_hz
    turn = 2.0 * np.pi * frequency_hz * times
    laser, base = (step * np.round(a * np.sin(turn + phase) / step) for a, phase in ((amplitude, -1.5), (0.1, 0.0)))
    rows = (f"{t:.6f},{x!r},{y!r}{gap}" for t, x, y in zip(times, laser.tolist(), base.tolist(), strict=True))
    return "\n".join(["time,laser [mm],base [mm]" + (",gap" if gap else ""), *rows]) + "\n"


def test_properties_found_in_the_data_of_a_sweep_may_differ_between_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Steps, rates and gaps that differ only in the last digits must not count as another calibration."""
    step = 3.8146972656249999e-4  # of 16 bits
    for name, text in {
        "one": readings(2.03, step, gap=",0.006"),
        "two": readings(1.07, step * (1.0 + 1e-13), READINGS_HZ * (1.0 + 3e-5), gap=",0.004"),
        "three": readings(0.51, 4.0 * step, gap=",0.003"),
        "four": readings(0.5, 1e-17, gap=",0"),  # no step
        "same": readings(1.07, step, gap=",0.006000000000000001"),
    }.items():
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
    files = [str(tmp_path / f"{name}.csv") for name in ("one", "two", "three", "four")]
    words = ["--campaign", "--frequency", "9.1", "--output", str(tmp_path / "out")]
    assert main(["import", *files, str(tmp_path / "same.csv"), *words]) == 1
    assert "same: gap 6 mm at 9.1 Hz is measured in one, too" in capsys.readouterr().err
    assert main(["import", *files, *words]) == 0
    infos = []
    for name in ("one", "two", "three", "four"):
        with open_run(tmp_path / "out" / "runs" / name) as run:
            infos.append(calibration_rows(run))
    assert len({one["resolution"].tobytes() for one in infos}) == 4, "else this tests nothing"
    assert len({one["rate"].tobytes() for one in infos}) > 1, "likewise"
    done = open_finished(tmp_path / "out")
    assert {(point.gap_m, round(point.dt)) for point in done.points} == {(0.006, 20), (0.004, 11), (0.003, 5), (0.0, 5)}
    assert done.info["resolution"].tolist() == pytest.approx([4e-3 * step] * 2, rel=1e-9), "the coarsest"


@pytest.mark.parametrize(
    ("column", "one", "two", "said"),
    [
        ("sensitivity_uncertainty", 0.01, 0.02, "sensitivity_uncertainty of laser is 0.02, but 0.01 in one"),
        ("resolution", 0.001, 0.0010000000000000002, "resolution of laser is 0.0010000000000000002, but 0.001 in one"),
        ("lag", 0.0, 7e-4, "lag of laser is 0.0007, but 0.0 in one"),
        ("unit", "mm", "m/s", "unit of laser is m/s, but m in one"),
        ("rate", 2000, 5000, "rate of laser is 5000.0, but 2000.0 in one"),
        ("channel", "base", "current", "the list of channels is laser, current, but laser, base in one"),
    ],
)
def test_stated_properties_of_the_sensors_of_a_sweep_must_agree(
    tmp_path: Path, column: str, one: object, two: object, said: str
) -> None:
    runs = []
    for name, value in (("one", one), ("two", two)):
        (tmp_path / f"{name}.csv").write_text(readings(1.0, 1e-3), encoding="utf-8")
        source = readers.read(tmp_path / f"{name}.csv")
        other = f"{value}: {{column: base, unit: A}}" if value == "current" else "base: {column: base}"
        laser = f"laser: {{column: laser, {column}: {value}}}" if column not in ("rate", "channel") else ""
        laser = laser or "laser: {column: laser}"
        text = f"frequency: 9.1\ngap: 0.006\nchannels: {{{laser}, {other}}}"
        mapping = refined(attrs.evolve(guess(source), channels={}), text)
        if column == "rate":
            mapping = attrs.evolve(mapping, rate_hz=float(str(value)))
        runs.append(write(convert(source, mapping), tmp_path / "out" / name))
    with pytest.raises(ImpactRigError, match=re.escape(f"two: {said}")):
        make_campaign(runs, tmp_path / "out")


@pytest.mark.parametrize(
    ("more", "options", "second", "said"),
    [
        ([], [], "x,y [mm]", "do not tell which is which channel"),
        (["--campaign"], ["--gap", "6mm"], "x,y [mm]", "do not tell which is which channel"),
        (["--campaign"], [], "laser [mm],base [mm]", "one: its gap is unknown: state it (--gap"),
        (["--campaign"], ["--gap", "6mm"], "laser [m/s],base [mm]", "two: unit of laser is m/s, but m in one"),
        (["--campaign"], ["--gap", "6mm", "--channel", "laser="], "laser [mm],base [mm]", "no file contains"),
        (["--campaign"], ["--gap", "6mm", "--config", "none.yaml"], "laser [mm],base [mm]", "cannot read"),
        ([], ["--gap", "6mm", "--config", "none.yaml"], "laser [mm],base [mm]", "an effect only with --campaign"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("there", [False, True])
def test_a_failed_import_leaves_no_file_that_blocks_the_next(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], options: list[str], second: str, said: str,
    *, there: bool,
) -> None:  # fmt: skip
    """If the second file is rejected, the first must not be written: it would block the corrected command."""
    (tmp_path / "one.csv").write_text(readings(1.0, 1e-3), encoding="utf-8")
    text = readings(1.0, 1e-3, frequency_hz=9.3)
    (tmp_path / "two.csv").write_text(text.replace("laser [mm],base [mm]", second), encoding="utf-8")
    out = tmp_path / "out"
    if there:
        out.mkdir()
    words = ["import", str(tmp_path / "one.csv"), str(tmp_path / "two.csv"), "--output", str(out), *more]
    before = sorted(tmp_path.rglob("*"))
    assert main([*words, *options]) == 1
    assert said in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before
    (tmp_path / "two.csv").write_text(text, encoding="utf-8")
    assert main([*words, "--gap", "6mm"]) == 0
    assert {path.name for path in out.iterdir()} >= ({"runs", "points.csv"} if more else {"one", "two"})
    assert not list(tmp_path.rglob("*.partial"))
    kept = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    assert main([*words, "--gap", "6mm"]) == 1
    assert "is not empty: nothing is overwritten" in capsys.readouterr().err
    assert {path: path.stat().st_mtime_ns for path in out.rglob("*")} == kept


@pytest.mark.parametrize(
    ("first", "second"), [("gap_6mm_9.1Hz_run1", "gap_6mm_9.1Hz_run5"), ("gap_6mm_9.0Hz", "gap_6mm_9.1Hz")]
)
def test_two_files_of_the_same_sweep_point_are_rejected(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], first: str, second: str
) -> None:
    """Otherwise, the last would silently replace the others, even if the name of one contradicts its data."""
    for name, amplitude in ((first, 1.0), (second, 2.0), ("gap_3mm_9.1Hz", 1.5), ("gap_6mm_9.3Hz", 0.5)):
        frequency_hz = 9.3 if "9.3" in name else 9.1
        text = readings(amplitude, 1e-3, frequency_hz=frequency_hz)
        (tmp_path / f"{name}.csv").write_text(text, encoding="utf-8")
    names = [first, "gap_3mm_9.1Hz", "gap_6mm_9.3Hz", second]
    words = ["import", *(str(tmp_path / f"{name}.csv") for name in names), "--campaign"]
    assert main([*words, "--output", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert f"{second}: gap 6 mm at 9.1 Hz is measured in {first}, too" in said
    assert not (tmp_path / "out").exists()
    words.remove(str(tmp_path / f"{first}.csv"))
    assert main([*words, "--output", str(tmp_path / "out")]) == 0
    done = open_finished(tmp_path / "out")
    found = {(point.gap_m, point.frequency_hz): round(point.dt) for point in done.points if point.settled}
    assert found == {(0.006, 9.1): 20, (0.003, 9.1): 15, (0.006, 9.3): 5}


def test_nothing_is_simulated_for_an_imported_campaign(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The report would show it as measured in the laboratory, with the calibration of its instruments."""
    for name, frequency_hz in (("gap_3mm", 9.1), ("gap_6mm", 9.3)):
        (tmp_path / f"{name}.csv").write_text(readings(1.0, 1e-3, frequency_hz=frequency_hz), encoding="utf-8")
    out = tmp_path / "out"
    files = [str(tmp_path / f"{name}.csv") for name in ("gap_3mm", "gap_6mm")]
    assert main(["import", *files, "--campaign", "--output", str(out)]) == 0
    kept = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert main(["campaign", str(out / "campaign.yaml"), "--output", str(out)]) == 1
    assert "out holds an imported campaign, to which no simulated points can be added" in capsys.readouterr().err
    with pytest.raises(RecordingError, match="holds a campaign already; nothing is overwritten"):
        make_campaign([out / "gap_3mm"], out)
    assert main(["identify", str(out), "--decrement"]) == 1
    assert "is an imported campaign, which has no free decay" in capsys.readouterr().err
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == kept


def test_a_campaign_names_each_point_without_a_settled_measurement(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """If it were left out without a message, the campaign of the others would look complete."""
    text, (head, *rows) = readings(1.0, 1e-3), readings(2.0, 1e-3, frequency_hz=9.3).splitlines()
    (tmp_path / "one.csv").write_text(text, encoding="utf-8")
    (tmp_path / "short.csv").write_text("\n".join([head, *rows[: 3 * READINGS_HZ], ""]), encoding="utf-8")
    (tmp_path / "shorter.csv").write_text("\n".join([head, *rows[: 35 * READINGS_HZ // 100], ""]), encoding="utf-8")
    files = [str(tmp_path / f"{name}.csv") for name in ("one", "short", "shorter")]
    words = ["--campaign", "--gap", "6mm", "--output", str(tmp_path / "out")]
    assert main(["import", *files[1:], *words]) == 1
    error = capsys.readouterr().err
    assert "no file contains a settled measurement: short, gap 6 mm at 9.3 Hz: not_settled; shorter, gap 6 mm" in error
    assert main(["import", *files, *words]) == 0
    printed = capsys.readouterr().out
    assert re.findall("left out of the campaign: (.*)", printed) == [
        "short, gap 6 mm at 9.3 Hz: not_settled", "shorter, gap 6 mm at 9.3 Hz: too_few_cycles",
    ]  # fmt: skip
    assert [point.frequency_hz for point in open_finished(tmp_path / "out").points] == [9.1]


def test_data_that_an_import_omits_are_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    turn = 2.0 * np.pi * 9.0 * np.arange(20_000) / RATE_HZ
    base, laser = 1e-3 * np.sin(turn), 1e-2 * np.sin(turn)
    np.savez(tmp_path / "own.npz", base=base, laser=laser, fft=np.exp(1j * turn), cube=np.zeros((2, 3, 4)), dt=-1.0)
    words = ["import", str(tmp_path / "own.npz"), "--output", str(tmp_path / "run"), "--scan-rate", str(RATE_HZ)]
    assert main([*words, "--dry-run"]) == 0
    printed = capsys.readouterr().out
    for line in (
        "left out of the import: fft, complex numbers",
        "left out of the import: cube, an array of more than two dimensions",
        "left out of the import: dt, no valid rate or period: -1",
    ):
        assert line in printed


@pytest.mark.parametrize(("seconds", "laser", "reason"), [(0.3, 1e-3, "too_few_cycles"), (30.0, 0.0, "constant")])
def test_sines_without_a_dt_are_reported_and_fail_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], seconds: float, laser: float, reason: str
) -> None:
    turn = 2.0 * np.pi * 9.1 * np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    np.savez(tmp_path / "own.npz", base=1e-4 * np.sin(turn), laser=laser * np.sin(turn))
    words = ["--output", str(tmp_path / "run"), "--scan-rate", str(RATE_HZ), "--frequency", "9.1"]
    assert main(["import", str(tmp_path / "own.npz"), *words]) == 0
    capsys.readouterr()
    assert main(["analyze", str(tmp_path / "run"), "--sine"]) == 1
    printed = capsys.readouterr().out
    assert f"no DT from these scans, status {reason}" in printed
    assert not re.search(r"\bnan\b", printed)


def test_a_mapping_that_cannot_be_read_is_named_without_an_error_number(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "one.csv"
    file.write_text("time,x\n0,1\n0.1,2\n0.2,1\n")
    for mapping, why in ((tmp_path, "Is a directory"), (tmp_path / "none.yaml", "No such file or directory")):
        words = ["import", str(file), "--mapping", str(mapping), "--output", str(tmp_path / "run")]
        assert main(words) == 1
        assert capsys.readouterr().err.strip().endswith(f"cannot read the mapping: {why} ({mapping})")
