# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import pytest
from kits.campaign import TINY

from impact_rig_studies.campaign.job import Job, Outcome, execute
from impact_rig_studies.campaign.plan import Campaign, load_campaign
from impact_rig_studies.campaign.run import unique_jobs


@pytest.fixture(scope="session")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    """A campaign of two points, a sweep up and down, and two runs that fail."""
    path = tmp_path_factory.mktemp("tiny") / "tiny.yaml"
    path.write_text(TINY)
    return load_campaign(path)


@pytest.fixture(scope="session")
def measured(tiny: Campaign) -> dict[str, tuple[Job, Outcome]]:
    """Every job of the tiny campaign, run one after the other in this process, by key."""
    return {job.key: (job, execute(job)) for job in unique_jobs(tiny.planned())}
