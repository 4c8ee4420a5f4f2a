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
"""Imported runs: the transmissibility of a known motion, for any measured channels, in every output of such a run."""

from __future__ import annotations

import contextlib
import json
import tracemalloc
import warnings
from pathlib import Path

import attrs
import numpy as np
import pytest

from impact_rig.cli.main import main
from impact_rig.errors import ImpactRigError
from impact_rig.recording import open_run
from impact_rig.runs import export, reanalysis
from impact_rig.system.budget import BudgetError
from impact_rig_studies.importing import readers
from impact_rig_studies.importing.assignment import guess, with_channel
from impact_rig_studies.importing.conversion import ImportedRun, convert
from impact_rig_studies.importing.signals import Abscissa, AbscissaKind, ImportedSignals, Signal, even_times
from impact_rig_studies.importing.store import write

pytestmark = pytest.mark.heavy

HZ, BASE_M, DT, PHASE = 9.1, 1e-4, 10.0, np.radians(-40.0)
OMEGA = 2 * np.pi * HZ
PER_SI = {"m": 1.0, "mm": 1e3, "µm": 1e6, "m/s": 1.0, "mm/s": 1e3, "m/s^2": 1.0, "g": 1 / 9.80665, "mm/s2": 1e3}
ORDER = {"m": 0, "mm": 0, "µm": 0, "m/s": 1, "mm/s": 1, "m/s^2": 2, "g": 2, "mm/s2": 2}


def motion(unit: str, channel: str, times: np.ndarray, hz: float = HZ) -> np.ndarray:
    """Return a motion as measured by a sensor with a unit: x_b = 0.1 mm peak, x_1 ten times as much and 40° behind."""
    phasor = BASE_M if channel == "base" else BASE_M * DT * np.exp(1j * PHASE)
    size = PER_SI[unit] * (2j * np.pi * hz) ** ORDER[unit]
    noise = np.random.default_rng(len(channel)).standard_normal(len(times))
    signal = (phasor * size * np.exp(2j * np.pi * hz * times)).imag
    return signal + 2e-4 * np.abs(phasor * size) * noise


def source(units: dict[str, str], rate_hz: float = 125.0, seconds: float = 12.0, hz: float = HZ) -> ImportedSignals:
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    signals = {
        channel: Signal(motion(unit, channel, times, hz), unit, even_times(rate_hz)) for channel, unit in units.items()
    }
    return ImportedSignals(Path("own.csv"), "text table", signals)


def imported(found: ImportedSignals) -> ImportedRun:
    return convert(found, guess(found))


def last_row(run: Path) -> np.void:
    with open_run(run) as found:
        return reanalysis.rows(reanalysis.measurements(reanalysis.analyze(found)))[-1]


@pytest.mark.parametrize("base", ["mm", "mm/s", "g"])
@pytest.mark.parametrize("laser", ["µm", "m/s", "mm/s2"])
def test_any_two_kinds_of_motion_yield_the_transmissibility_of_displacements(
    tmp_path: Path, base: str, laser: str
) -> None:
    """The ratio is formed at the drive frequency, with the power of it by which the quantities differ."""
    row = last_row(write(imported(source({"base": base, "laser": laser})), tmp_path / "run"))
    assert row["status"] == b"ok"
    assert abs(row["transmissibility"] - DT) < 3 * row["transmissibility_uncertainty"] < 0.02
    assert abs(row["phase"] - PHASE) < 3 * row["phase_uncertainty"] < 0.02
    assert row["base_amplitude"] == pytest.approx(BASE_M, rel=1e-3)
    assert row["laser_amplitude"] == pytest.approx(BASE_M * DT, rel=1e-3)


@pytest.mark.parametrize("wrong", [[1499], [0], [3, 700], [301, 302, 303]])
def test_a_base_with_missing_readings_has_a_drive_frequency(tmp_path: Path, wrong: list[int]) -> None:
    found = source({"base": "mm", "laser": "mm"})
    found.signals["base"].values[wrong] = np.nan
    run = imported(found)
    assert run.drive[0][1] == pytest.approx(HZ, rel=1e-4)
    row = last_row(write(run, tmp_path / "run"))
    assert row["status"] == b"ok"
    assert abs(row["transmissibility"] - DT) < 3 * row["transmissibility_uncertainty"] < 0.02


@pytest.mark.parametrize(("unit", "si", "size"), [("g", "m/s^2", BASE_M * OMEGA**2), ("mm", "m", BASE_M)])
def test_the_amplitude_of_the_drive_has_its_unit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], unit: str, si: str, size: float
) -> None:
    times = np.arange(1500) / 125
    table = np.stack([times, motion(unit, "base", times), motion("mm", "laser", times)], axis=1)
    head = f"time [s],base [{unit}],laser [mm]"
    np.savetxt(tmp_path / "own.csv", table, "%.8g", ",", header=head, comments="")
    assert main(["import", str(tmp_path / "own.csv"), "--output", str(tmp_path / "run")]) == 0
    shown = " ".join(capsys.readouterr().out.split()).partition(" Hz, amplitude ")[2].split()
    assert shown[1:4] == [si, "of", "base"]
    assert float(shown[0]) == pytest.approx(size, rel=2e-3)


def test_a_signal_of_text_is_named_with_the_reason(tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text("time [s],base,laser [mm]\n" + "\n".join(f"{k},0x{k:X}F,0.5" for k in range(50)))
    found = readers.read(tmp_path / "own.csv")
    mapping = attrs.evolve(guess(found), channels=with_channel({}, "base=base mm", found.signals))
    with pytest.raises(ImpactRigError, match=r"no signal 'base' for base: the import leaves it out \(texts\)"):
        convert(found, mapping)


@pytest.mark.parametrize("hz", [9.1, 15.6])
@pytest.mark.parametrize("late_s", [0.0, 0.003])
def test_interpolation_between_few_scans_per_cycle_keeps_the_amplitude(
    tmp_path: Path, hz: float, late_s: float
) -> None:
    """At 8 scans a cycle a cubic makes the laser 6e-4 too small, many times the stated uncertainty."""
    rate_hz = 125.0
    times = np.arange(1500) / rate_hz
    signals = {
        "base": Signal(motion("mm", "base", times, hz), "mm", even_times(rate_hz)),
        "laser": Signal(motion("mm", "laser", times + late_s, hz), "mm", even_times(rate_hz, late_s)),
    }
    found = ImportedSignals(Path("own.csv"), "text table", signals)
    run = convert(found, attrs.evolve(guess(found), resample_hz=250))
    row = last_row(write(run, tmp_path / "run"))
    assert row["base_amplitude"] == pytest.approx(BASE_M, rel=5e-5)
    assert row["transmissibility"] == pytest.approx(DT, rel=5e-5)
    assert row["phase"] == pytest.approx(PHASE, abs=5e-5)


def test_sensitivities_can_be_given_by_option(tmp_path: Path) -> None:
    found = source({"base": "g", "laser": "mm"})
    volts = {"ai 0": 0.1 * found.signals["base"].values, "ai 1": 0.5 * found.signals["laser"].values}
    found = ImportedSignals(
        Path("own.tdms"), "TDMS", {name: Signal(values, "V", even_times(125.0)) for name, values in volts.items()}
    )
    channels = with_channel({}, "base=ai 0 V, 100 mV/g", found.signals)
    channels = with_channel(channels, "laser=ai 1, 500 mV/mm", found.signals)
    mapping = guess(found)
    run = write(convert(found, type(mapping)(channels=channels)), tmp_path / "run")
    assert last_row(run)["transmissibility"] == pytest.approx(DT, rel=1e-3)


@pytest.mark.parametrize("noise", [1e-3, 1e-2, 0.1])
@pytest.mark.parametrize(("rate_hz", "seconds"), [(206.4516, 30.0), (2000.0, 20.0), (25_600.0, 8.0)])
@pytest.mark.parametrize("unit", ["g", "m/s^2", "mm/s", "mm"])
def test_noise_at_low_frequencies_is_not_taken_for_the_drive(
    unit: str, rate_hz: float, seconds: float, noise: float
) -> None:
    """As displacement, white noise of an accelerometer is largest at the lowest line, which is not the drive."""
    found = source({"base": unit, "laser": unit}, rate_hz, seconds)
    signals = {}
    for name, one in found.signals.items():
        white = np.random.default_rng(3).standard_normal(len(one.values))
        signals[name] = Signal(one.values + noise * np.ptp(one.values) * white, one.unit, one.abscissa)
    ((_, frequency_hz, _),) = imported(ImportedSignals(Path("own.csv"), "text table", signals)).drive
    assert frequency_hz == pytest.approx(HZ, rel=1e-3)


@pytest.mark.parametrize(("rate_hz", "seconds", "hz"), [(1e6, 1.0, HZ), (51_200.0, 20.0, 3e3), (102_401.0, 4.0, 0.9)])
def test_finding_the_frequency_of_a_fast_record_needs_little_memory(rate_hz: float, seconds: float, hz: float) -> None:
    """A fit of a million scans would need 150 MB; 20 s are enough."""
    found = source({"base": "m"}, rate_hz, seconds, hz)
    tracemalloc.start()
    ((_, frequency_hz, _),) = imported(found).drive
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert frequency_hz == pytest.approx(hz, rel=1e-4)
    assert most < 60e6 + 40.0 * len(found.signals["base"].values)


@pytest.mark.parametrize("rate_hz", [23, 145, 1000])
def test_resampling_needs_little_memory(rate_hz: int) -> None:
    """24 scans and two lines of a mapping must not need 250 MB."""
    found = source({"base": "m", "laser": "m"}, float(rate_hz), 24 / rate_hz)
    mapping = attrs.evolve(guess(found), resample_hz=1_000_000)
    convert(found, attrs.evolve(mapping, resample_hz=2 * rate_hz))  # imports are not counted
    tracemalloc.start()
    with pytest.raises(BudgetError, match="values after resampling") if rate_hz < 50 else contextlib.nullcontext():
        convert(found, mapping)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 40e6


@pytest.mark.parametrize("rate_hz", [51200 / 31 / 8, 51200 / 7 / 32, 99.7, 1000 / 3, 125.0])
def test_rates_that_are_not_whole_need_no_resampling(tmp_path: Path, rate_hz: float) -> None:
    times = np.round(np.arange(round(12 * rate_hz)) / rate_hz, 6)
    given = Abscissa(AbscissaKind.TIME, "s", values=times)
    signals = {name: Signal(motion("m", name, times), "m", given) for name in ("base", "laser")}
    found = imported(ImportedSignals(Path("own.csv"), "text table", signals))
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-7)
    assert found.index.tolist() == list(range(len(times)))
    run = write(found, tmp_path / "run")
    row = last_row(run)
    assert abs(row["transmissibility"] - DT) < 3 * row["transmissibility_uncertainty"] < 0.02
    assert main(["info", str(run)]) == 0


def test_a_scan_missing_among_exact_times_stays_missing() -> None:
    times = np.delete(np.arange(1200) / 100, 500)
    signals = {"base": Signal(np.sin(times), "m", Abscissa(AbscissaKind.TIME, "s", values=times))}
    found = imported(ImportedSignals(Path("own.csv"), "text table", signals))
    assert (found.rate_hz, found.index[499], found.index[500]) == (100, 499, 501)


@pytest.mark.parametrize("seconds", [1.5, 3.0])
def test_a_short_record_yields_a_row_with_the_reason(
    tmp_path: Path, seconds: float, capsys: pytest.CaptureFixture[str]
) -> None:
    run = write(imported(source({"base": "m", "laser": "m"}, 1000.0, seconds)), tmp_path / "run")
    row = last_row(run)
    assert row["status"] == b"not_settled"
    assert abs(row["transmissibility"] - DT) < 3 * row["transmissibility_uncertainty"] < 0.02
    assert main(["analyze", str(run)]) == 0
    assert f"of {int(seconds * HZ)} cycles at 9.1 Hz, not settled" in " ".join(capsys.readouterr().out.split())


def test_a_record_of_three_cycles_is_too_short(tmp_path: Path) -> None:
    run = write(imported(source({"base": "m", "laser": "m"}, 1000.0, 0.35)), tmp_path / "run")
    assert last_row(run)["status"] == b"too_few_cycles"


@pytest.mark.parametrize(
    ("units", "rate_hz", "seconds", "hz"),
    [
        ({"accelerometer": "g"}, 125.0, 12.0, HZ),
        ({"laser": "mm"}, 10.0, 150.0, 0.2),
        ({"base": "g"}, 1.0, 400.0, 0.05),
        ({"base": "m", "laser": "g"}, 1.0, 400.0, 0.05),
        ({"base": "m", "laser": "g"}, 125.0, 12.0, HZ),
    ],
)
def test_every_command_accepts_any_channels_and_any_rate(
    tmp_path: Path, units: dict[str, str], rate_hz: float, seconds: float, hz: float, capsys: pytest.CaptureFixture[str]
) -> None:
    """A warning of matplotlib is an error in this test."""
    given = source(
        {"laser" if name == "accelerometer" else name: unit for name, unit in units.items()}, rate_hz, seconds, hz
    )
    signals = dict(zip(units, given.signals.values(), strict=True))
    run = write(imported(ImportedSignals(Path("own.csv"), "text table", signals)), tmp_path / "run")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert main(["analyze", str(run), "--figures", str(tmp_path / "figures"), "--format", "png"]) == 0
        assert main(["info", str(run)]) == 0
        capsys.readouterr()
        assert main(["analyze", str(run), "--sine", "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["frequency_hz"] == pytest.approx(hz, rel=1e-4)
    assert (printed["transmissibility"] is None) == (len(units) < 2)
    assert {one["channel"] for one in printed["channels"]} == set(units)
    with open_run(run) as found:
        assert export(found, "daq/scan", tmp_path / "scan.csv").stat().st_size > 1000


def test_a_figure_without_impacts_is_filled_by_its_traces(tmp_path: Path) -> None:
    """Marks without any impacts must not leave half of the page empty."""
    import matplotlib.image

    run = write(imported(source({"base": "m", "laser": "m"})), tmp_path / "run")
    assert main(["analyze", str(run), "--figures", str(tmp_path / "figures"), "--format", "png"]) == 0
    picture = matplotlib.image.imread(tmp_path / "figures" / "time_traces.png")[..., :3]
    empty = (picture > 0.99).all(axis=(1, 2))
    longest = max(map(len, "".join("x" if row else " " for row in empty).split()), default=0)
    assert longest < 60 * len(empty) / 675


def test_a_frequency_response_without_a_base_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = write(imported(source({"laser": "m"})), tmp_path / "run")
    assert main(["analyze", str(run), "--frf"]) == 1
    assert "has no channel base" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "frequency_hz", "gap_m"),
    [
        ("messung_9,1Hz_gap_0,5mm", 9.1, 5e-4), ("gap_6mm_9.1Hz", 9.1, 6e-3), ("no_sphere_9p1Hz", 9.1, 0.0),
        ("run_1Hz", None, None), ("2024_05_01", None, None), ("ohne_kugel 9,1 Hz", 9.1, 0.0),
    ],
)  # fmt: skip
def test_guesses_from_the_file_name_are_compared_with_the_data(
    name: str, frequency_hz: float | None, gap_m: float | None
) -> None:
    """A file name that states 1 Hz for a motion of 9.1 Hz is not used."""
    given = source({"base": "m", "laser": "m"})
    found = imported(ImportedSignals(Path(f"{name}.csv"), given.format, given.signals))
    assert found.drive[0][1] == pytest.approx(frequency_hz or HZ, rel=1e-5)
    assert found.mapping.gap == gap_m
    said = " ".join(found.doubts)
    assert ("which is used" in said) == (name == "run_1Hz")
    assert ("gap" in said) == (gap_m is not None)


def test_a_sampling_rate_in_a_file_name_is_not_the_drive_frequency() -> None:
    """Data sets such as `ds1a_1000Hz.mat` state the rate without a word. Impacts leave no clear sine to compare it."""
    given = source({"base": "m", "laser": "m"}, 1000.0)
    for one in given.signals.values():
        one.values[::300] += 100.0 * BASE_M
    found = imported(ImportedSignals(Path("ds1a_1000Hz.csv"), given.format, given.signals))
    assert found.drive[0][1] < 500.0
    assert "cannot be a drive frequency at 1000 scans per second" in " ".join(found.doubts)


def test_doubtful_units_are_shown_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times = np.arange(1500) / 125
    lines = ["time,base,structure", "s,G,gs"]
    lines += [
        f"{t:.3f},{a:.5f},{b:.5f}"
        for t, a, b in zip(times, *(motion("g", one, times) for one in ("base", "laser")), strict=True)
    ]
    (tmp_path / "own.csv").write_text("\n".join(lines), encoding="utf-8")
    assert main(["import", str(tmp_path / "own.csv"), "--output", str(tmp_path / "run"), "--dry-run"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "'G' of base was read as standard gravity" in said
    assert "'gs' of structure was read as standard gravity" in said
    assert not (tmp_path / "run").exists()


def test_a_table_of_commands_with_columns_of_different_lengths_is_rejected() -> None:
    found = source({"base": "mm", "laser": "mm"})
    times = Abscissa(AbscissaKind.TIME, "s", values=np.array([0.0, 5.0, 10.0]))
    columns = {
        "frequency": Signal(np.array([9.0, 9.1, 9.2]), "Hz", times),
        "current": Signal(np.array([0.5, 0.5]), "A"),
    }
    drive = ImportedSignals(Path("drive.npz"), "NumPy", columns)
    with pytest.raises(
        ImpactRigError, match="`frequency` and `current` must have the same number of values, got 3 and 2"
    ):
        convert(found, guess(found), drive)


def test_two_accelerometers_are_imported_with_two_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    nptdms = pytest.importorskip("nptdms")
    times = np.arange(1500) / 125
    with nptdms.TdmsWriter(str(tmp_path / "two.tdms")) as writer:
        about = {"wf_increment": 1 / 125, "unit_string": "V"}
        writer.write_segment(
            [
                nptdms.ChannelObject("run", name, 0.1 * motion("g", one, times), properties=about)
                for name, one in (("ai0", "base"), ("ai1", "laser"))
            ]
        )
    words = ["import", str(tmp_path / "two.tdms"), "--output", str(tmp_path / "run")]
    assert main(words) == 1
    assert "--channel laser=" in capsys.readouterr().err
    assert main([*words, "--channel", "base=ai0 V, 100 mV/g", "--channel", "laser=ai1 V, 100 mV/g"]) == 0
    assert main(["analyze", str(tmp_path / "run")]) == 0
    assert "DT 10.00" in capsys.readouterr().out or last_row(tmp_path / "run")["transmissibility"] == pytest.approx(
        DT, rel=1e-3
    )


def test_a_missing_channel_is_reported_instead_of_the_next_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    times = np.arange(1500) / 125.0
    rows = [f"{t:.3f},{one:.6f}" for t, one in zip(times, motion("mm", "laser", times), strict=True)]
    (tmp_path / "own.csv").write_text("\n".join(["time [s],laser [mm]", *rows]))
    assert main(["import", str(tmp_path / "own.csv"), "--output", str(tmp_path / "run")]) == 0
    said = capsys.readouterr().out
    assert "no DT: base is not assigned (--channel base=SIGNAL)" in said
    assert "impact-rig analyze" not in said


def test_each_missing_channel_is_named_before_anything_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [f"{k / 100},{np.sin(k)}" for k in range(50)]
    (tmp_path / "own.csv").write_text("\n".join(["time [s],current [A]", *rows]))
    assert main(["import", str(tmp_path / "own.csv"), "--output", str(tmp_path / "run"), "--dry-run"]) == 0
    said = capsys.readouterr().out
    assert all(f"no DT: {name} is not assigned (--channel {name}=SIGNAL)" in said for name in ("base", "laser"))


def test_a_run_stores_the_assumptions_and_the_omitted_columns(tmp_path: Path) -> None:
    (tmp_path / "own.csv").write_text(
        "time,base,laser\n" + "".join(f"{k / 125},{k % 14},{k % 14}\n" for k in range(200)) + "end\n", encoding="utf-8"
    )
    run = write(imported(readers.read(tmp_path / "own.csv")), tmp_path / "run")
    with open_run(run) as found:
        source = json.loads(found.attachments()["source.json"])
    assert list(source["left_out"]) == ["line 202 and after"]
    assert any("m is assumed" in one for one in source["assumptions"])
