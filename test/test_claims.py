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
"""Tests of `CLAIMS.md`: it has every number of the first pages, and the numbers that it computes are unchanged."""

from __future__ import annotations

import functools
import itertools
import json
import re
import runpy
from pathlib import Path

import pytest
from markdown_it import MarkdownIt

import impact_rig
from impact_rig.cli.interface import DOCUMENT
from impact_rig.config.fields import Origin
from impact_rig.graph import NODES
from impact_rig.physics import linear_response
from impact_rig.physics.linear import sphere_mass_kg
from impact_rig.physics.model import CONTACT_RTOL
from impact_rig.rig.config import RigConfig
from impact_rig.simulation import DRIVE_A
from impact_rig_studies.campaign.paper import CURRENT_A, FREQUENCY_HZ, REDUCTION_PERCENT

ROOT = Path(__file__).parents[1]
WORDS = {5: "five", 6: "six"}
NAMES = re.compile(r"ROS 2|x86-64|Apache-2\.0|Error 130|\(2u\)|± 2u|Run 9\.1 Hz|Click 10")
"""Names with a digit that state nothing."""


def claims() -> list[tuple[str, str, str]]:
    """Return page, claim and evidence of every row."""
    found, page = [], ""
    for line in (ROOT / "CLAIMS.md").read_text(encoding="utf-8").splitlines():
        if line.startswith("## "):
            page = line.removeprefix("## ")
        elif line.startswith("| ") and not line.startswith("| claim"):
            claim, evidence = line.strip("| ").split(" | ")
            found.append((page, claim, evidence))
    return found


CLAIMS = claims()


def prose(text: str) -> str:
    """Return the text of paragraphs, lists and tables without headings and code blocks, one line."""
    words = []
    tokens = MarkdownIt("commonmark").enable("table").parse(text)
    for before, token in itertools.pairwise(tokens):
        if token.type == "inline" and before.type != "heading_open":
            words += [_text(child.type, child.content) for child in token.children or ()] + [" "]
    return " ".join("".join(words).split())


def _text(kind: str, content: str) -> str:
    return (
        f"`{content}`" if kind == "code_inline" else content if kind == "text" else " " if kind == "softbreak" else ""
    )


# --- Results of the code: each function returns text that must be in its claim ----------------------------------------
@functools.cache
def simulated(gap_m: float) -> impact_rig.Record:
    """Return the result of the example on the first page; a gap of 0 means no sphere."""
    return impact_rig.simulate(30.0, {"barriers.gap_m": gap_m} if gap_m else {"sphere.present": False})


def transmissibility(gap_m: float) -> tuple[float, float]:
    """Return DT and u of the example on the first page; a gap of 0 means no sphere."""
    return simulated(gap_m).transmissibility


def reduction(gap_m: float) -> float:
    return 100.0 * (1.0 - transmissibility(gap_m)[0] / transmissibility(0.0)[0])


def reductions() -> str:
    ours = [reduction(gap_m) for gap_m in REDUCTION_PERCENT]
    grams = 1e3 * sphere_mass_kg(RigConfig().sphere)
    gaps = [1e3 * gap_m for gap_m in REDUCTION_PERCENT]
    reduced = f"At {FREQUENCY_HZ:g} Hz, a sphere of {grams:.2f} g reduces DT by {min(ours):.0f} to {max(ours):.0f} %"
    return f"{reduced} at the paper's gaps between the barriers, {min(gaps):g} to {max(gaps):g} mm"


def reductions_in_words() -> str:
    ours = [reduction(gap_m) for gap_m in REDUCTION_PERCENT]
    assert min(ours) == pytest.approx(100 / 3, abs=3.0)
    assert max(ours) == pytest.approx(50.0, abs=3.0)
    assert 0.95 < 1e3 * sphere_mass_kg(RigConfig().sphere) < 1.1
    return "One gram of steel reduces it by a third to a half"


def of_the_paper() -> str:
    numbers = REDUCTION_PERCENT.values()
    return f"{min(numbers):g} to {max(numbers):g} %|{WORDS[len(numbers)]}"


def chosen_constants() -> str:
    text = (ROOT / "config" / "nominal.yaml").read_text(encoding="utf-8")
    return WORDS[len(re.findall(rf"; {Origin.IDENTIFIED.value}: ", text)) + 1]  # and the current


def supported_pythons() -> str:
    listed = re.findall(
        r'python: \["(3\.\d+)".*"(3\.\d+)"\]', (ROOT / ".github/workflows/ci.yaml").read_text(encoding="utf-8")
    )
    return f"Python {listed[0][0]} to {listed[0][1]}"


def size_of(*parts: str) -> str:
    sizes = runpy.run_path(str(ROOT / "requirements" / "install.py"))["ON_DISK_MB"]
    return f"up to {sum(sizes[part] for part in parts)} MB"


def size_of_the_environment() -> str:
    return size_of("run", "wheels")


def size_of_the_tools_of_the_documentation() -> str:
    return size_of("docs")


def nodes() -> str:
    document = json.loads(DOCUMENT.read_text(encoding="utf-8"))
    standard = re.compile(r"(std|sensor|geometry|diagnostic|rosgraph)_msgs/msg/")
    assert all(standard.match(topic["type"]) for topic in document["topics"].values())
    return f"{WORDS[len(NODES)].capitalize()} lifecycle nodes use standard messages only"


def contact_tolerance() -> str:
    return f"an error of {CONTACT_RTOL:.0e} per step".replace("e-0", "e-")


def short_run() -> str:
    assert str(impact_rig.simulate(10.0)).startswith("no DT")
    assert not str(impact_rig.simulate(20.0)).startswith("no DT")
    return "A run of 10 s gives no DT"


def drive_of_the_paper() -> str:
    assert DRIVE_A == CURRENT_A
    return f"{FREQUENCY_HZ:g} Hz with a coil current of {CURRENT_A:g} A"


def at_6_mm() -> str:
    return f"{transmissibility(0.006)[0]:.1f} times"


def uncertainty_at_6_mm() -> str:
    return f"± {2.0 * transmissibility(0.006)[1]:.2f}"


def difference_from_the_closed_form() -> str:
    dt, u = transmissibility(0.0)
    difference = abs(dt / abs(complex(linear_response.transmissibility(RigConfig(), FREQUENCY_HZ))) - 1.0)
    stated = 2.0 * u / dt
    assert difference < stated
    of_the_measured = f"{100.0 * stated:.1f} % (2u)"
    return f"{100.0 * difference:.1f} %, which is less than the uncertainty of the measured DT: {of_the_measured}"


def at_10_mm() -> str:
    return f"near {transmissibility(0.010)[0]:.0f}"


def reduction_at_10_mm() -> str:
    return f"by {reduction(0.010):.0f} %"


def amplitudes_at_10_mm() -> str:
    with_sphere, without = simulated(0.010).measurements[-1], simulated(0.0).measurements[-1]
    base, structure = (with_sphere[name] / without[name] for name in ("base_amplitude", "laser_amplitude"))
    return f"the base moves {100.0 * (base - 1.0):.0f} % more, and the structure {100.0 * (1.0 - structure):.0f} % less"


# ----------------------------------------------------------------------------------------------------------------------
COMPUTED = [(claim, evidence.strip("`")) for _, claim, evidence in CLAIMS if evidence.strip("`").isidentifier()]


@pytest.mark.heavy
@pytest.mark.parametrize(("claim", "name"), COMPUTED)
def test_each_claim_agrees_with_the_code(claim: str, name: str) -> None:
    assert any(text in claim for text in globals()[name]().split("|")) or globals()[name]().lower() in claim.lower()


@pytest.mark.parametrize("page", sorted({page for page, _, _ in CLAIMS}))
def test_every_number_of_a_page_is_a_claim_and_every_claim_is_on_its_page(page: str) -> None:
    text = prose((ROOT / page).read_text(encoding="utf-8"))
    for _, claim, _ in (row for row in CLAIMS if row[0] == page):
        assert claim in text, f"{page} does not say: {claim}"
        text = text.replace(claim, "·")
    left = re.sub(r"`[^`]*`", "", NAMES.sub("", text))
    assert re.findall(r".{0,40}\d[\d.,]*.{0,30}", left) == [], f"numbers of {page} that CLAIMS.md does not have"


@pytest.mark.parametrize("evidence", sorted({evidence for _, _, evidence in CLAIMS}))
def test_the_evidence_of_every_claim_exists(evidence: str) -> None:
    for one in re.findall(r"`([^`]+)`", evidence):
        path, _, name = one.partition("::")
        if "/" in path.split(" ")[0]:
            assert f"def {name}(" in (ROOT / path).read_text(encoding="utf-8") or not name
        else:
            assert callable(globals().get(one)) or one.split(" ")[0] in {"make", "python"}, one
