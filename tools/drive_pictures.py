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
"""Figures of docs/how-to/drive.md, from rigs driven through their stream: `python -m tools.drive_pictures`.

They take some ten minutes of rig time, and a minute of one core.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path

from impact_rig.driver import Hardware, LocalRig
from impact_rig_studies.excitation.files import load
from impact_rig_studies.excitation.random import RandomPlan, control
from impact_rig_studies.excitation.response import measure
from impact_rig_studies.excitation.shock import Pulse, shock
from impact_rig_studies.excitation.signals import Excitation
from impact_rig_studies.report.excitation import tell

ROOT = Path(__file__).parents[1]
PLANS = ROOT / "config" / "excitation"


def results() -> Iterator[tuple[object, str]]:
    """Yield the results of each test, and the unit of its response."""
    plan = load(PLANS / "random_superior.yaml", RandomPlan)
    *_, found = control(hardware(2_000, **{"barriers.gap_m": 0.006}), plan)
    yield found, plan.response.unit
    linear = {"sphere.present": False}
    *_, followed = shock(hardware(10_000, **linear), load(PLANS / "shock.yaml", Pulse))
    yield followed, "m"
    *_, response = measure(hardware(2_000, **linear), Excitation(), "base")
    yield response, "m/A"


def hardware(rate_hz: int, **changes: object) -> Hardware:
    """Return a rig in this process, sampled and driven at a rate."""
    rates = {"drive.waveform": "stream", "drive.stream_rate_hz": rate_hz, "daq.rate_hz": rate_hz}
    return Hardware(LocalRig({**rates, **changes}))


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__).parse_args()
    for reached, unit in results():
        drawn = tell(reached, unit).draw()[0]
        (ROOT / "docs" / "images" / f"drive_{drawn.name}.png").write_bytes(drawn.content("png"))
