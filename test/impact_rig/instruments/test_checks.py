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
"""The check with a known input passes every sound rig, and finds faulty channels."""

import math

import pytest
from kits.instruments import configured

from impact_rig.cli import main
from impact_rig.errors import CommandError
from impact_rig.instruments import Fault, check_known_input, check_polarity
from impact_rig.instruments.section import CHANNELS
from impact_rig.rig.config import RigConfig, dump, from_flat


@pytest.mark.parametrize("seed", range(1, 7))
@pytest.mark.parametrize("rate_hz", [1_000, 12_345])
def test_rigs_without_faults_pass_the_check(seed, rate_hz):
    checks = check_known_input(configured(rate_hz, seed=seed))
    assert [check.channel for check in checks] == list(CHANNELS)
    for check in checks:
        assert check.ok, check
        assert check.polarity == 1


def test_ideal_instruments_pass_the_check_exactly():
    for check in check_known_input(from_flat(configured(1_000), {"instruments.ideal": True})):
        assert check.ok
        assert check.measured == pytest.approx(check.expected, rel=1e-9)


@pytest.mark.parametrize(
    "fault",
    [
        Fault(kind="dropout", channel="laser"),
        Fault(kind="stuck", channel="laser"),
        Fault(kind="gain_error", channel="laser", value=0.02),
        Fault(kind="added_noise", channel="laser", value=5e-5),
        Fault(kind="saturation", channel="laser", value=4e-3),
    ],
    ids=lambda fault: fault.kind,
)
def test_the_check_finds_faults_on_their_channel(fault):
    for check in check_known_input(configured(1_000), [fault]):
        assert check.ok == (check.channel != "laser"), check


@pytest.mark.parametrize("fraction", [0.0, -0.5, math.nan, math.inf])
def test_a_sine_without_a_positive_amplitude_is_rejected(fraction):
    with pytest.raises(CommandError, match=f"fraction of a known-input check must be finite and > 0, got {fraction}"):
        check_known_input(RigConfig(), fraction=fraction)


def test_the_polarity_check_finds_swapped_wires_and_dead_channels():
    config = configured(1_000, base__inverted=True, current__inverted=True)
    dead = Fault(kind="dropout", channel="laser")
    assert check_polarity(config, [dead]) == {"accelerometer": 1, "laser": 0, "base": -1, "current": -1}
    assert not check_known_input(config)[2].ok


def test_planned_faults_do_not_disturb_the_check():
    planned = from_flat(configured(1_000), {"instruments.faults.planned": ["dropout channel=laser"]})
    assert all(check.ok for check in check_known_input(planned))


def test_the_command_line_checks_the_instruments_of_a_file(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    sound, swapped = tmp_path / "sound.yaml", tmp_path / "swapped.yaml"
    sound.write_text(dump(RigConfig()))
    swapped.write_text(dump(configured(10_000, base__inverted=True)))
    assert main(["check", str(sound), "--instruments"]) == 0
    printed = capsys.readouterr().out
    assert printed.count(" ok ") == len(CHANNELS)
    assert all(len(line) <= 80 for line in printed.splitlines()[1:]), "readable at 80 columns"
    assert main(["check", str(swapped), "--instruments"]) == 1
    assert "reversed" in capsys.readouterr().out
