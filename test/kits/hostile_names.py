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
"""Names that would act as commands if they were not treated as data, and a campaign whose studies have such names."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from impact_rig.blocks import TRANSMISSIBILITY
from impact_rig_studies.campaign import run
from impact_rig_studies.campaign.job import Outcome
from impact_rig_studies.campaign.plan import load_campaign

HOSTILE_NAMES = (
    '"><img src=x onerror=alert(1)>', "</style></svg><script>alert(1)</script>", "'};alert(1)//", "{{ 7*7 }}",
    r"a\q", r"\g<1>", "$x^$", "$x_1_2$", r"\$$", "$", "_$\\frac$", "=HYPERLINK(1)", "+1+1", "@SUM(A1)", "-2+3",
    "a;=1+1", "CON",
    "x/../../../escaped", "/tmp/escaped", "..", ".", ".hidden", "-rf", "a\nb", "tab\there", "\x1b]0;title\x07\x1b[31m",
    "\x00", "\u202eright to left", "学習", "x" * 5000, " ", "url(#a)", 'a style="color: red"', 'id="f"',
)  # fmt: skip
FREQUENCIES_HZ = (9.0, 9.1, 10.5)


def hostile_campaign(directory: Path, title: str = HOSTILE_NAMES[0], studies: Iterable[str] = HOSTILE_NAMES) -> Path:
    """Make the directory of a campaign whose title and studies have hostile names, with unmeasured points."""
    names = [name for name in studies if "\0" not in name and len(name) < 1000]  # keys that YAML takes
    study = {"frequencies_hz": list(FREQUENCIES_HZ), "gaps_m": ["none", 0.006], "seeds": [7]}
    text = json.dumps({
        "title": title,
        "studies": {
            "own": {"frequencies_hz": list(FREQUENCIES_HZ), "gaps_m": ["none", 0.006]},
            **{name: {**study, "seeds": [7 + i]} for i, name in enumerate(names)},
        },
    })  # fmt: skip
    directory.mkdir()
    (directory / run.CAMPAIGN_FILE).write_text(text)
    campaign = load_campaign(directory / run.CAMPAIGN_FILE)
    store = run.prepare(campaign, directory, "process")
    for job in run.unique_jobs(campaign.planned()):
        row = np.zeros(1, TRANSMISSIBILITY)
        row["frequency"], row["gap"], row["transmissibility"] = job.frequencies_hz[0], job.gap_m, 5.0
        row["transmissibility_uncertainty"], row["phase"], row["settled"] = 0.01, -1.5, 1.0
        row["regime"], row["status"], row["method"] = b"periodic", b"ok", b"gum"
        row["impacts_per_cycle"] = 2.0 if job.gap_m else 0.0
        row["laser_amplitude"], row["base_amplitude"], row["current_amplitude"] = 1e-3, 2e-4, job.current_a
        store.put(job, Outcome(rows=row))
    run.write_results(run.finished(campaign, directory), 1.0)
    return directory
