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
from __future__ import annotations

import pytest
from kits.campaign import TINY

from impact_rig_studies.campaign.job import Job, Outcome, execute
from impact_rig_studies.campaign.plan import Campaign, load_campaign
from impact_rig_studies.campaign.run import unique_jobs


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """Campaign of two points, a sweep up and down, and two runs that fail."""
    path = tmp_path_factory.mktemp("tiny") / "tiny.yaml"
    path.write_text(TINY)
    return load_campaign(path)


@pytest.fixture(scope="session")
def measured(tiny: Campaign) -> dict[str, tuple[Job, Outcome]]:
    """Outcome of every job of the tiny campaign, run one after the other in this process, by key."""
    return {job.key: (job, execute(job)) for job in unique_jobs(tiny.planned())}
