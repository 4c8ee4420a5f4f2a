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
"""A model driven by the measured drive moves like the measured rig; the comparison shows differing constants."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from kits.recorded_rig import record, scanned

from impact_rig.analysis.calibration import Calibration
from impact_rig.analysis.scans import CHANNELS, CURRENT, LASER
from impact_rig.cli.main import main
from impact_rig.errors import ConfigError, RecordingError
from impact_rig.recording import open_run
from impact_rig.rig.config import RigConfig, dump, from_flat
from impact_rig.testing import LocalRig
from impact_rig_studies.comparison import compare, undone
from impact_rig_studies.importing.conversion import convert
from impact_rig_studies.importing.mapping import Channel, Mapping
from impact_rig_studies.importing.signals import Abscissa, AbscissaKind, ImportedSignals, Signal
from impact_rig_studies.importing.store import write

pytestmark = pytest.mark.heavy

RATE_HZ = 2000
LARGEST_OFF = 3.0
"""Standard uncertainties, by chance once in 370."""


def measured_rig(seconds: float, **values: object) -> LocalRig:
    rig = LocalRig({"daq.rate_hz": RATE_HZ, "daq.block_scans": 200, **values})
    rig.command(frequency_hz=9.1, current_a=0.52)
    rig.run(seconds)
    return rig


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Recorded runs with and without the sphere."""
    folder = tmp_path_factory.mktemp("recorded")
    return {
        "sphere": measured_rig(14, **{"barriers.gap_m": 0.004}).save(folder / "sphere"),
        "linear": measured_rig(20, **{"sphere.present": False}).save(folder / "linear"),
    }


def test_a_run_over_a_restart_is_rejected(tmp_path: Path) -> None:
    """Its stamps occur twice, so scans and labels cannot be assigned to each other by time."""
    first, second = (scanned(measured_rig(seconds, **{"sphere.present": False})) for seconds in (0.1, 14))
    record(tmp_path / "run", [*first, *second])
    with (
        open_run(tmp_path / "run") as run,
        pytest.raises(RecordingError, match="the stamps of its scans go back, as after a restart"),
    ):
        compare(run, fits=False)


@pytest.mark.parametrize("driven_by", ["current", "base"])
@pytest.mark.parametrize("name", ["sphere", "linear"])
def test_the_model_with_the_constants_of_the_rig_reproduces_its_motion(
    recorded: dict[str, Path], name: str, driven_by: str
) -> None:
    """Time traces agree within the gain errors of the sensors, DT and phase within their uncertainty."""
    with open_run(recorded[name]) as run:
        found = compare(run, driven_by=driven_by, fits=False)
    (place,) = found.places
    assert place.model is not None
    assert abs(place.off("transmissibility")) < LARGEST_OFF
    assert abs(place.off("phase")) < LARGEST_OFF
    assert np.std(found.residual) < 0.01 * np.std(found.excerpt.rows["laser"])


def test_wrong_constants_are_detected_and_better_ones_found(recorded: dict[str, Path]) -> None:
    """A model whose resonance is 0.5 % higher differs by many u; the fit finds the resonance of the rig."""
    known = from_flat(RigConfig(), {"structure.natural_frequency_hz": 9.15, "sphere.present": False})
    with open_run(recorded["linear"]) as run:
        found = compare(run, known)
    (place,) = found.places
    assert abs(place.off("transmissibility")) > 10
    assert found.constants is not None
    f_n = RigConfig().structure.natural_frequency_hz
    assert abs(found.constants.value("f_n") - f_n) < LARGEST_OFF * found.constants.u("f_n") < 0.001 * f_n


def differentiated(values: np.ndarray, order: int) -> np.ndarray:
    """Return a derivative of a periodic record, without the part above 100 Hz."""
    frequency = np.fft.rfftfreq(len(values), 1.0 / RATE_HZ)
    factor = (2j * np.pi * frequency) ** order * (frequency < 100.0) if order else np.ones(len(frequency))
    return np.fft.irfft(np.fft.rfft(values) * factor, len(values))


@pytest.mark.parametrize(("laser", "base"), [("m", "m"), ("m/s^2", "m"), ("m/s", "m/s^2")])
def test_a_record_from_mid_motion_is_compared_and_one_with_a_gap_in_parts(
    tmp_path: Path, laser: str, base: str
) -> None:
    """The imported record has 10 s from the middle of a motion, without current; half a second is missing.

    Accelerations must not be compared as if they were displacements.
    """
    rig = measured_rig(24, **{"sphere.present": False})
    rows = rig.rows()[14 * RATE_HZ :]  # 91 cycles
    time_s = np.arange(len(rows)) / RATE_HZ
    there = (time_s < 0.3) | (time_s > 0.8)
    times = Abscissa(AbscissaKind.TIME, "s", values=time_s[there])
    signals = {
        name: Signal(differentiated(rows[name], ("m", "m/s", "m/s^2").index(unit))[there], unit, times)
        for name, unit in (("laser", laser), ("base", base))
    }
    source = ImportedSignals(tmp_path / "own.csv", "text table", signals)
    info = rig.tables("daq/info")[0].rows
    channels = {
        name: Channel(
            column=name,
            calibration={
                key: float(info[info["name"] == name.encode()][0][key]) for key in ("lag", "skew", "lag_order")
            }
            | {"sensitivity_uncertainty": 0.005},
        )
        for name in ("laser", "base")
    }
    path = write(convert(source, Mapping(channels=channels, frequency=9.1, gap=0.0)), tmp_path / "run")
    with open_run(path) as run:
        found = compare(run, RigConfig())
        with pytest.raises(ConfigError, match="current was not measured"):
            compare(run, RigConfig(), "current")
    assert found.driven_by == "base"
    assert found.constants is None
    (place,) = found.places
    assert abs(place.off("transmissibility")) < LARGEST_OFF
    assert abs(place.off("phase")) < LARGEST_OFF
    assert np.std(found.residual) < 0.02 * np.std(found.excerpt.rows["laser"])
    assert np.std(found.excerpt.rows["laser"]) == pytest.approx(np.std(rows["laser"]), rel=0.01)


def test_a_run_without_a_settled_measurement_is_rejected(tmp_path: Path) -> None:
    with (
        open_run(measured_rig(0.5).save(tmp_path / "run")) as run,
        pytest.raises(RecordingError, match="no measurement of DT settled"),
    ):
        compare(run)


@pytest.mark.parametrize("channel", [LASER, CURRENT])
def test_lag_and_skew_of_a_sensor_are_corrected(channel: int) -> None:
    """The measured sine of a sensor becomes the true one, up to its ends."""
    calibration = Calibration.from_info(LocalRig({"daq.rate_hz": RATE_HZ, "daq.block_scans": 200}).core.info().rows)
    time_s = np.arange(3 * RATE_HZ) / RATE_HZ
    true = np.exp(2j * np.pi * 9.1 * time_s)
    read = (true * calibration.response(channel, 9.1)).real
    assert np.abs(read - true.real).max() > 1e-4, CHANNELS[channel]
    assert np.abs(undone(read, calibration, channel, 9.1) - true.real)[RATE_HZ:-RATE_HZ].max() < 1e-4
    assert np.abs(undone(read, calibration, channel, 9.1) - true.real).max() < 0.05


def test_the_command_prints_and_draws_the_comparison(
    recorded: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = tmp_path / "model.yaml"
    model.write_text(dump(from_flat(RigConfig(), {"sphere.present": False})))
    words = ["compare", str(recorded["linear"]), "--config", str(model)]
    assert main([*words, "--json", "--figures", str(tmp_path / "drawn")]) == 0
    printed = json.loads(capsys.readouterr().out)
    (place,) = printed["places"]
    assert abs(place["transmissibility_off_u"]) < LARGEST_OFF
    assert printed["traces"]["residual_rms_m"] < 0.01 * printed["traces"]["structure_rms_m"]
    assert printed["constants"]["f_n"]["determined"]
    assert {one.suffix for one in (tmp_path / "drawn").iterdir()} == {".png", ".svg", ".pdf", ".csv"}
    assert main([*words, "--no-fit"]) == 0
    text = capsys.readouterr().out
    assert "driven by the measured current" in text
    assert "differs" not in text
    assert "constants" not in text


SPHERE, CURRENT_LACKS = "DT without the sphere", "a measured current"


@pytest.mark.parametrize(
    ("gap", "channels", "missing"),
    [
        ("6mm", ("laser", "base", "current"), [SPHERE]),
        ("none", ("laser", "base"), [CURRENT_LACKS]),
        ("6mm", ("laser", "base"), [SPHERE, CURRENT_LACKS]),
        ("none", ("laser", "base", "current"), []),
    ],
)
def test_the_command_names_only_the_constants_that_are_missing(
    recorded: dict[str, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    gap: str, channels: tuple[str, ...], missing: list[str],
) -> None:  # fmt: skip
    """The command must not ask for a measured current if the run contains one."""
    with open_run(recorded["linear"]) as run:
        rows = np.concatenate([table.rows for table in run.tables("daq/scan")])
    np.savez(tmp_path / "own.npz", **{name: rows[name] for name in channels})
    options = ["--gap", gap, "--frequency", "9.1", "--scan-rate", str(RATE_HZ), "--output", str(tmp_path / "run")]
    assert main(["import", str(tmp_path / "own.npz"), *options]) == 0
    capsys.readouterr()
    assert main(["compare", str(tmp_path / "run"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed["missing_for_constants"] == missing
    assert ("constants" in printed) == (not missing)
    assert main(["compare", str(tmp_path / "run"), *(["--no-fit"] if not missing else [])]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert ("constants:" in said) == bool(missing)
    if missing:
        assert said.endswith(f"constants: none can be determined, because this run lacks {' and '.join(missing)}")
