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
"""Sample run: a recording of 20 s for users without one of their own."""

from __future__ import annotations

import shutil
from pathlib import Path

from impact_rig.driver.driver import TOPICS
from impact_rig.driver.local_rig import ANALYSED, LocalRig
from impact_rig.recording import open_run
from impact_rig.simtime import NS_PER_S

SAMPLE_S = 20
SAMPLE_TOPICS = (*TOPICS, *ANALYSED)
GAP_M = 6e-3


def make_sample(directory: Path) -> Path:
    """Record the sample run into `directory`, unless a complete run is there, and return `directory`.

    A run is complete if it has all topics of `SAMPLE_TOPICS`. An existing directory without a complete run is deleted
    with all its contents.
    """
    if directory.is_dir():
        try:
            with open_run(directory) as found:
                complete = {f"/rig/{name}" for name in SAMPLE_TOPICS} <= set(found.topics)
        except OSError:
            complete = False
        if complete:
            return directory
        shutil.rmtree(directory)  # incomplete, or from another version
    half = directory.with_name(f"{directory.name}.part")
    shutil.rmtree(half, ignore_errors=True)
    with LocalRig(analysis={"gap_m": GAP_M}, record=half) as rig:
        while rig.now_ns < SAMPLE_S * NS_PER_S:
            if rig.now_ns == NS_PER_S:
                rig.command(frequency_hz=9.1, current_a=0.52)
            rig.step()
            rig.clear()
    half.rename(directory)
    return directory
