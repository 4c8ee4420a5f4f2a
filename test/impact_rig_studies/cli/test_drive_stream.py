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
"""`play`, `frf` and the control loops write a run that can be verified, with what was reached, however they end."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

from impact_rig.analysis.scans import CHANNELS
from impact_rig.cli.main import main
from impact_rig.instruments.section import INSTRUMENTS
from impact_rig.recording import open_run
from impact_rig.runs.verification import verify
from impact_rig_studies.cli.parsers import SI

pytestmark = pytest.mark.heavy

PROGRAM = [sys.executable, "-c", "from impact_rig.cli import main; raise SystemExit(main())"]


def results_of(directory, name):
    with open_run(directory) as run:
        assert verify(run).identical
    page = (directory / f"{name}.html").read_text()
    assert "<svg" in page
    return json.loads((directory / f"{name}.json").read_text()), page


def run(*words):
    return main([str(word) for word in words])


def test_the_options_have_the_channels_and_units_of_the_instruments():
    """A parser must not import the channels, which need NumPy."""
    units = {name: INSTRUMENTS[name].column().unit for name in CHANNELS}
    assert {name: unit.strip("()").replace("²", "^2") for name, unit in SI.items()} == units
    assert tuple(SI) == CHANNELS


def test_the_current_follows_the_played_file(tmp_path, capsys):
    wave = 0.4 * np.sin(2.0 * np.pi * 9.1 * np.arange(3_000) / 1_000) * np.hanning(3_000)
    np.savez(tmp_path / "wave.npz", drive=wave, fs=1_000.0)
    given = ("drive", "play", tmp_path / "wave.npz", "--scan-rate", 2_000, "--clip", 0.3, "--json")
    assert run(*given, "--output", tmp_path / "run") == 0
    found, page = results_of(tmp_path / "run", "play")
    assert json.loads(capsys.readouterr().out)["seconds"] == found["seconds"] == pytest.approx(3.0)
    assert found["current_error"] < 0.05
    assert found["peak_asked"] == pytest.approx(0.3)
    assert found["clipped_samples"] > 100
    assert "samples clipped" in page
    # the run's own current, played again, is the current of the run
    assert run("drive", "play", tmp_path / "run", "--scan-rate", 2_000, "--output", tmp_path / "again") == 0
    assert results_of(tmp_path / "again", "play")[0]["peak_asked"] == pytest.approx(0.3, abs=0.02)
    assert run(*given, "--output", tmp_path / "run") == 1
    assert "nothing is overwritten" in capsys.readouterr().err


def test_names_that_are_not_valid_text_are_escaped_on_the_page(tmp_path):
    """If the names were written as they are, the page could not be written after the run."""
    file, directory = tmp_path / os.fsdecode(b"d\xff.csv"), tmp_path / os.fsdecode(b"run\xff")
    file.write_text("time,current\n0,0\n0.05,0.1\n0.1,0\n")
    assert run("drive", "play", file, "--output", directory) == 0
    page = (directory / "play.html").read_text()
    assert "Played: d\\udcff.csv" in page
    assert "run\\udcff; impact-rig verify" in page


def test_a_frequency_response_is_reported_with_its_coherence(tmp_path):
    words = ("drive", "frf", "--gap", "none", "--scan-rate", 2_000)
    words += ("--kind", "chirp", "--frames", 3, "--frame-s", 4, "--high-hz", 30)
    assert run(*words, "--output", tmp_path / "run") == 0
    found, page = results_of(tmp_path / "run", "frf")
    assert found["coherence_median"] > 0.99
    assert found["lines_coherent"] > 0.9 * found["lines"]
    assert len(found["table"]["real"]) == found["lines"]
    lines = found["table"]["frequency_hz"]
    assert (min(lines), max(lines)) == (4.0, 30.0), "what the edges of the band let through is no answer to the drive"
    assert "best linear approximation" in page


def test_random_control_by_a_plan_reports_the_level_reached_before_an_abort(tmp_path):
    plan = tmp_path / "plan.yaml"
    plan.write_text("{frame_s: 1, loops: 2, frames: 4, averages: 4}")
    words = ("drive", "random", plan, "--gap", "none", "--scan-rate", 2_000)
    assert run(*words, "--output", tmp_path / "run") == 0
    found, page = results_of(tmp_path / "run", "random")
    assert len(found["rms_error_db"]) == 3
    assert found["clipped_samples"] >= 0
    assert "distortion" in page
    assert run(*words, "--abort", "base=0.4mm", "--output", tmp_path / "cut") == 1
    found, page = results_of(tmp_path / "cut", "random")
    assert "aborted: base" in found["ended_early"]
    assert "Ended early: aborted" in page


def test_a_history_and_a_shock_are_reported_trial_by_trial(tmp_path):
    hill = 2e-4 * np.hanning(800) * np.sin(2.0 * np.pi * 12.0 * np.arange(800) / 1_000)
    np.savez(tmp_path / "hill.npz", base=hill, fs=1_000.0)
    plan = tmp_path / "plan.yaml"
    plan.write_text("{identify_s: 8, rest_s: 1, iterations: 2, high_hz: 60}")
    words = ("drive", "replicate", tmp_path / "hill.npz", "--plan", plan, "--gap", "none", "--scan-rate", 1_000)
    assert run(*words, "--output", tmp_path / "run") == 0
    found, page = results_of(tmp_path / "run", "replicate")
    assert found["error"] == pytest.approx(min(found["errors"]))
    assert found["error"] < 0.05
    assert "measured response function" in page


def test_an_interrupt_leaves_a_valid_run_and_a_page(tmp_path):
    """A real process gets SIGINT in the middle of loops that it cannot finish meanwhile."""
    (tmp_path / "long.yaml").write_text("{loops: 500, frame_s: 1, frames: 4}")
    process = subprocess.Popen(
        [*PROGRAM, "drive", "random", str(tmp_path / "long.yaml"), "--gap", "none", "--scan-rate", "2000",
         "--output", str(tmp_path / "run")],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if "loop 2" in line:
            break
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=120)
    assert process.returncode == 128 + signal.SIGINT
    found, page = results_of(tmp_path / "run", "random")
    assert found["ended_early"] == "interrupted"
    assert len(found["rms_error_db"]) >= 2
    assert "Ended early: interrupted" in page


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--scan-rate", "0"), "drive.stream_rate_hz"),
        (("--config", "volts.yaml"), "drive.kind must be current"),
        (("--through", "running", "--gap", "6mm"), "--gap applies only to a rig that this command starts"),
        (("--through", "running", "--sphere-start", "left"), "--sphere-start applies only to a rig"),
    ],
)
def test_invalid_arguments_are_rejected_by_name(tmp_path, capsys, words, says):
    (tmp_path / "volts.yaml").write_text("{drive: {kind: voltage}}")
    words = [tmp_path / word if str(word).endswith(".yaml") else word for word in words]
    assert run("drive", "shock", *words, "--output", tmp_path / "run") == 1
    assert says in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ("drive", "frf", "--frames", 3, "--frame-s", 1, "--rms", 1e-9),
            "none of 57 excited lines has a coherence above 0.9",
        ),
        (("drive", "play", "one.csv"), "current error cannot be computed"),
        (("drive", "play", "one.csv", "--scale", 0), "zero throughout, with --scale and --seconds applied"),
        (("drive", "replicate", "zeros.csv"), "zeros.csv: the signal is zero throughout"),
    ],
)
def test_insufficient_data_yield_a_message_instead_of_a_number(tmp_path, capsys, words, says):
    (tmp_path / "one.csv").write_text("time,current\n0,0.1\n0.0001,0.1\n")
    (tmp_path / "zeros.csv").write_text("time,base\n0,0\n0.5,0\n1,0\n")
    words = [tmp_path / word if str(word).endswith(".csv") else word for word in words]
    assert run(*words, "--output", tmp_path / "run") == 1
    printed = capsys.readouterr()
    assert says in " ".join((printed.out + printed.err).split())
    assert not re.search(r"\b(nan|inf)\b|[0-9]{12}", printed.out.replace(str(tmp_path), ""))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("drive", "play", "drive.csv", "--scan-rate", "0"), "whole number of Hz above 0, got 0"),
        (
            ("drive", "play", "drive.csv", "--seconds", "1e-5"),
            "--seconds 1e-05 is less than a sample",
        ),  # an empty reason, once
        (("drive", "frf", "--frames", "1000000000"), "samples of 1000000000 frames"),
        (("drive", "frf", "--frame-s", "1e9"), "samples of 20 frames"),
        (("drive", "frf", "--drive-seed", "-1"), "seed must be"),
        (("drive", "frf", "--high-hz", "3"), "low_hz must be < high_hz = 3 Hz, got 4 Hz"),
        (
            ("drive", "replicate", "drive.csv", "--signal", "current", "--plan", "band.yaml"),
            "low_hz must be < high_hz = 30 Hz, got 100 Hz",
        ),
        (
            ("drive", "replicate", "drive.csv", "--signal", "current", "--plan", "narrow.yaml"),
            "low_hz must be < high_hz = 30 Hz, got 40 Hz",
        ),
        (
            ("drive", "replicate", "drive.csv", "--signal", "current", "--plan", "fast.yaml"),
            "low_hz must be < 1000 Hz, half of the sample rate, got 1100 Hz",
        ),
        (
            ("drive", "replicate", "drive.csv", "--signal", "current", "--plan", "slow.yaml"),
            "Hz for this length of the signal, got 0.001 Hz",
        ),
    ],
)
def test_an_unplayable_signal_is_rejected_before_the_rig_runs(tmp_path, capsys, words, says):
    (tmp_path / "drive.csv").write_text("time,current\n0,0\n0.001,0.1\n0.002,0\n")
    (tmp_path / "band.yaml").write_text("low_hz: 100\nhigh_hz: 30")
    (tmp_path / "fast.yaml").write_text("low_hz: 1100\nhigh_hz: 1200")
    (tmp_path / "slow.yaml").write_text("low_hz: 0\nhigh_hz: 0.001")
    (tmp_path / "narrow.yaml").write_text("low_hz: 40\nhigh_hz: 30")
    words = [tmp_path / word if word.endswith((".csv", ".yaml")) else word for word in words]
    assert run(*words, "--output", tmp_path / "run") == 1
    assert says in capsys.readouterr().err.replace("'", "")
    for word in ("nan", "inf", "0", "-1"):
        for option in ("--clip", "--seconds"):
            with pytest.raises(SystemExit):
                run("drive", "play", tmp_path / "drive.csv", option, word)
            assert f"argument {option}: must be" in capsys.readouterr().err
