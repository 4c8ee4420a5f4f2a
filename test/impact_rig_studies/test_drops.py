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
"""`impact-rig analyze RUN --drop`: the drops in the remarks of a run."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from kits.recorded_rig import SLOW_RIG, note, record, scanned

from impact_rig.cli import main
from impact_rig.physics.contact import from_config
from impact_rig.rig.config import RigConfig
from impact_rig.testing import LocalRig
from impact_rig_studies.decay import DropHeights, parse_drop

pytestmark = pytest.mark.ros  # runs carry the schemas of the messages


def test_drops_noted_in_a_run_yield_the_restitution_of_the_law(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A sphere that falls from h0 rebounds to e² h0, where e is that of the configured law."""
    e = from_config(RigConfig().contact).realised_restitution()
    rng = np.random.default_rng(1)
    heights = [(0.2 + 0.01 * k, e**2 * (0.2 + 0.01 * k) + 2e-4 * rng.standard_normal()) for k in range(8)]
    noted = [DropHeights(before, round(after, 5)) for before, after in heights]
    rig = LocalRig(SLOW_RIG)
    rig.run(seconds=1.0)
    remarks = ["the sphere is new", *(drop.text() for drop in noted)]
    path = record(tmp_path / "drops", [*scanned(rig), *(note(text, 10 * k) for k, text in enumerate(remarks))])
    assert main(["analyze", str(path), "--drop", "0.2mm", "--figures", str(tmp_path), "--format", "png"]) == 0
    printed = capsys.readouterr().out
    value, u2 = map(float, re.search(r"e = ([0-9.]+) ± ([0-9.]+) \(2u\) from 8 drops", printed).groups())  # type: ignore[union-attr]  # it is there
    assert 0.0 < u2 < 0.01
    assert value == pytest.approx(e, abs=1.5 * u2)
    assert (tmp_path / "drop.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("remarks", "u", "words"),
    [
        (
            ["nothing fell"],
            "1mm",
            "states the heights of a drop and its rebound in metres, like 'drop h0_m=0.2 h1_m=0.0245'",
        ),
        ([], "1mm", "no remark on the topic `notes` states the heights"),
        (
            ["drop h0_m=0.2 h1_m=0.3"],
            "1mm",
            "the drops noted in it (1) give no coefficient of restitution: no rebound may be higher",
        ),
    ],
)
def test_an_invalid_drop_test_is_rejected(
    tmp_path: Path, remarks: list[str], u: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = LocalRig(SLOW_RIG)
    rig.run(seconds=0.5)
    path = record(tmp_path / "none", [*scanned(rig), *(note(text, k) for k, text in enumerate(remarks))])
    assert main(["analyze", str(path), f"--drop={u}"]) == 1
    assert words in capsys.readouterr().err.replace("\n", " ")


def test_a_drop_without_an_uncertainty_of_its_heights_has_none(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rig = LocalRig(SLOW_RIG)
    rig.run(seconds=0.5)
    path = record(tmp_path / "one", [*scanned(rig), note("drop h0_m=0.2 h1_m=0.0245", 0)])
    assert main(["analyze", str(path), "--drop", "0mm", "--figures", str(tmp_path), "--format", "png"]) == 1
    assert "1 drops give no uncertainty of the coefficient of restitution e" in " ".join(
        capsys.readouterr().out.split()
    )
    assert main(["analyze", str(path), "--drop", "0.5mm"]) == 0


@pytest.mark.parametrize(
    "remark", ["drop", "drop h0_m=1", "drop h0_m=e h1_m=-", "xdrop h0_m=1 h1_m=1", "drop h0_m=1 h1_m=1 x"]
)
def test_other_remarks_are_not_taken_for_drops(remark: str) -> None:
    assert parse_drop(remark) is None
    assert parse_drop(f"  {DropHeights(0.1, 1e-3).text()} ") == DropHeights(0.1, 1e-3)
