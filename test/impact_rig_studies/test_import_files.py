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
"""Complete files as written by programs of the field: imported and analysed, each gives the motion put into it.

The base moves by 0.1 mm at 9.1 Hz, and the structure by ten times as much, 40 degrees later.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from impact_rig.cli.main import main
from impact_rig.recording import open_run
from impact_rig.runs import reanalysis
from impact_rig_studies.importing.steps import step_of

pytestmark = pytest.mark.heavy

HZ, DT, PHASE = 9.1, 10.0, np.radians(-40.0)
NAMED = ["--channel", "base=channel_0 mm", "--channel", "laser=channel_1 mm"]


def motion(rate_hz: float = 125.0, seconds: float = 12.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return times [s], and motions of base and structure [mm] with a little noise."""
    time_s = np.arange(round(seconds * rate_hz)) / rate_hz
    noise = 2e-5 * np.random.default_rng(4).standard_normal((2, len(time_s)))
    base = 0.1 * np.sin(2 * np.pi * HZ * time_s) + noise[0]
    return time_s, base, np.sin(2 * np.pi * HZ * time_s + PHASE) + noise[1]


def table(path: Path, heading: str, digits: str = ".6f", separator: str = ",", last: str = "") -> Path:
    rows = (separator.join((f"{t:.3f}", f"{a:{digits}}", f"{b:{digits}}")) for t, a, b in zip(*motion(), strict=True))
    path.write_bytes(("\n".join([heading, *rows]) + last + "\n").encode("cp1252"))
    return path


def tab_decimal_comma(folder: Path) -> Path:
    path = table(folder / "own.txt", "time [s]\tbase [mm]\tlaser [mm]", separator="\t")
    path.write_text(path.read_text().replace(".", ","))
    return path


def labview(folder: Path) -> Path:
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\t\nSeparator\tTab\t\nDecimal_Separator\t.\t\nX_Columns\tOne\t\n"
        "***End_of_Header***\t\n\t\nChannels\t2\t\t\nY_Unit_Label\tmm\tmm\t\nDelta_X\t0.008\t0.008\t\n"
        "***End_of_Header***\t\t\t\nX_Value\tbase\tlaser\tComment"
    )
    return table(folder / "own.txt", head, separator="\t")


def milliseconds(folder: Path) -> Path:
    time_s, base, laser = motion(1000.0, 6.0)
    rows = (f"{1e3 * t:.0f},{a:.6f},{b:.6f}" for t, a, b in zip(time_s, base, laser, strict=True))
    (folder / "own.csv").write_text("\n".join(["Time (msec),base [mm],laser [mm]", *rows]))
    return folder / "own.csv"


def stamped_without_headings(folder: Path) -> Path:
    time_s, base, laser = motion()
    stamps = np.datetime64("2024-05-13T23:59:58", "ms") + np.round(1e3 * time_s).astype("timedelta64[ms]")
    (folder / "own.csv").write_text(
        "\n".join(f"{t},{a:.6f},{b:.6f}" for t, a, b in zip(stamps, base, laser, strict=True))
    )
    return folder / "own.csv"


def even_abscissa_of_six_digits(folder: Path) -> Path:
    """A universal file, as text: `even`, its increment 1/983 Hz printed in six digits."""
    _, base, laser = motion(983.0, 7.0)
    lines = []
    for name, values in (("base", base), ("laser", laser)):
        lines += [
            "    -1", "    58", name, "NONE", "NONE", "NONE", "NONE",
            f"    1         1    1         0 {name:10}         1   1 NONE               0   0",
            f"         2{len(values):10}         1  0.00000E+00  1.01729E-03  0.00000E+00",
            "        17    0    0    0 NONE                 s                   ",
            "         8    0    0    0 NONE                 mm                  ",
            "         0    0    0    0 NONE                 NONE                ",
            "         0    0    0    0 NONE                 NONE                ",
        ]  # fmt: skip
        lines += ["".join(f"{one:13.5E}" for one in values[k : k + 6]) for k in range(0, len(values), 6)]
        lines.append("    -1")
    (folder / "own.uff").write_text("\n".join(lines) + "\n")
    return folder / "own.uff"


def two_streams(folder: Path) -> Path:
    """Rattlesnake names each further stream `time_data_N`; the longest is the measurement."""
    h5netcdf = pytest.importorskip("h5netcdf")
    h5py = pytest.importorskip("h5py")
    _, base, laser = motion(128.0)
    with h5netcdf.File(folder / "own.nc4", "w") as content:
        content.attrs["sample_rate"] = 128.0
        content.dimensions = {"response_channels": 2, "time_samples": 128, "time_samples_1": len(base)}
        for name, count in (("time_data", 128), ("time_data_1", len(base))):
            axis = "time_samples" if name == "time_data" else "time_samples_1"
            data = content.create_variable(name, ("response_channels", axis), "f8")
            data[...] = np.stack([base[:count], laser[:count]])
        about = content.create_group("channels")
        for name, texts in (("comment", ["base", "laser"]), ("unit", ["mm", "mm"])):
            column = about.create_variable(name, ("response_channels",), h5py.string_dtype())
            column[...] = np.array(texts, object)
    return folder / "own.nc4"


def wav(folder: Path, bits: int) -> Path:
    """The samples are truncated towards zero, as by a cast, and the file is a third shorter than its header states."""
    _, base, laser = motion()
    scaled = np.trunc(0.5 * np.stack([base, laser], axis=1) * (2.0 ** (bits - 1) - 2.0 ** max(0, bits - 54)))
    data = scaled.astype(f"<i{bits // 8}").tobytes()
    block = bits // 4
    form = struct.pack("<HHIIHH", 1, 2, 125, 125 * block, block, bits)
    body = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", len(data) * 3 // 2) + data
    (folder / "own.wav").write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    return folder / "own.wav"


def rate_that_is_not_whole(folder: Path) -> Path:
    time_s, base, laser = motion(51200 / 31 / 8)
    rows = (f"{t:.6f},{a:.6f},{b:.6f}" for t, a, b in zip(time_s, base, laser, strict=True))
    (folder / "own.csv").write_text("\n".join(["time [s],base [mm],laser [mm]", *rows]))
    return folder / "own.csv"


def matlab_integers(folder: Path) -> Path:
    """Counts of a converter in a struct, rounded down instead of to nearest."""
    io = pytest.importorskip("scipy.io")
    time_s, base, laser = motion()
    counts = {name: np.floor(2000 * x).astype(np.int16) for name, x in (("base", base), ("laser", laser))}
    io.savemat(folder / "own.mat", {"data": {"time": time_s, **counts}})
    return folder / "own.mat"


def scaled_counts_of_tdms(folder: Path) -> Path:
    nptdms = pytest.importorskip("nptdms")
    _, base, laser = motion()
    about = {"wf_increment": 0.008, "unit_string": "mm"}
    with nptdms.TdmsWriter(str(folder / "own.tdms")) as writer:
        values = {name: 3.05e-4 * np.trunc(x / 3.05e-4) for name, x in (("base", base), ("laser", laser))}
        writer.write_segment([nptdms.ChannelObject("g", name, x, properties=about) for name, x in values.items()])
    return folder / "own.tdms"


COLUMNS = ["--channel", "base=column_1 mm", "--channel", "laser=column_2 mm"]
FILES: dict[str, tuple[Callable[[Path], Path], list[str]]] = {
    "tabs and decimal comma": (tab_decimal_comma, []),
    "LabVIEW": (labview, []),
    "even abscissa of six digits": (even_abscissa_of_six_digits, []),
    "Time (msec)": (milliseconds, []),
    "two streams": (two_streams, []),
    "64-bit WAV": (lambda folder: wav(folder, 64), NAMED),
    "16-bit WAV": (lambda folder: wav(folder, 16), NAMED),
    "struct of integers": (matlab_integers, ["--channel", "base=base mm", "--channel", "laser=laser mm"]),
    "scaled integers": (scaled_counts_of_tdms, []),
    "stamps without headings": (stamped_without_headings, COLUMNS),
    "three decimals": (lambda folder: table(folder / "own.csv", "time [s],base [mm],laser [mm]", ".3f"), []),
    "three digits": (lambda folder: table(folder / "own.csv", "time [s],base [mm],laser [mm]", ".3g"), []),
    "a line below": (
        lambda folder: table(folder / "own.csv", "time [s],base [mm],laser [mm]", last="\nRate 125, overflows 0"), [],
    ),
    "sharp s in a heading": (
        lambda folder: table(folder / "own.csv", "Zeit;Weg Fußpunkt;Laser\ns;mm;mm", separator=";"), [],
    ),
    "row of units in code page 1252": (
        lambda folder: table(folder / "own.csv", "Zeit;Tisch µ;Struktur\ns;mm;mm", separator=";"), [],
    ),
    "rate that is not whole": (rate_that_is_not_whole, []),
}  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_files_of_common_programs_yield_their_transmissibility(tmp_path: Path, name: str) -> None:
    """The results are within 3u, which chance exceeds once in 370 cases; u is small enough to reject wrong ones."""
    write, options = FILES[name]
    assert main(["import", str(write(tmp_path)), "--output", str(tmp_path / "run"), *options]) == 0
    with open_run(tmp_path / "run") as run:
        row = reanalysis.rows(reanalysis.measurements(reanalysis.analyze(run)))[-1]
    assert row["status"] in (b"ok", b"not_settled")
    assert abs(row["transmissibility"] - DT) < 3 * row["transmissibility_uncertainty"] < 0.015 * DT
    assert row["phase"] == pytest.approx(PHASE, abs=2e-3)


@pytest.mark.parametrize("amplitude", [1.0, 0.1, 5.3e-5])
@pytest.mark.parametrize("share", [3e-5, 1e-3, 0.02, 0.3])
@pytest.mark.parametrize("offset", [0.0, 0.1234])
def test_converter_steps_are_found_in_numbers_of_any_precision(amplitude: float, share: float, offset: float) -> None:
    """There are 24 steps, each in double precision, single precision and with nine digits."""
    step, offset = 1.01 * share * amplitude, offset * amplitude
    values = step * np.trunc(amplitude * motion()[2] / step) + offset
    assert step_of(values) == pytest.approx(step, rel=1e-6)
    assert step_of(values.astype(np.float32).astype(np.float64)) == pytest.approx(step, rel=5e-3)
    assert step_of(np.array([float(f"{one:.9g}") for one in values])) == pytest.approx(step, rel=5e-3)


@pytest.mark.parametrize("hz", [1.0, 5.0, 9.1, 12.5, 125 / 6, 125 / 4, 125 / 3, 62.5])
def test_a_sine_in_full_precision_has_no_step(hz: float) -> None:
    assert step_of(np.sin(2 * np.pi * hz * motion()[0] + 0.0)) < 1e-6
    assert step_of(np.sin(2 * np.pi * hz * motion()[0] + np.pi / 6)) < 1e-6


def test_an_imported_run_and_its_report_state_their_source(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = table(tmp_path / "own.csv", "time [s],base [mm],laser", last="\nend")
    assert main(["import", str(path), "--output", str(tmp_path / "run")]) == 0
    capsys.readouterr()
    assert main(["info", str(tmp_path / "run")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert main(["report", str(tmp_path / "run")]) == 0
    page = (tmp_path / "run" / "report.html").read_text()
    for words in ("base [mm]", "no unit is given for laser", "line 1502 and after", "time response over time"):
        assert words in said
        assert words in page
