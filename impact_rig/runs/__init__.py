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
"""Operations on recorded runs: summary, verification, reanalysis, re-simulation, recovery, export and drawing."""

from impact_rig.recording.losses import Contiguity, Gap, check_contiguity, scan_rate_hz
from impact_rig.runs.exports import export
from impact_rig.runs.info import RunInfo, TopicInfo, info
from impact_rig.runs.recovery import Damage, FileReport, Recovered, RecoverReport, recover

__all__ = [
    "Contiguity", "Damage", "FileReport", "Gap", "RecoverReport", "Recovered", "RunInfo", "TopicInfo",
    "check_contiguity", "export", "info", "recover", "scan_rate_hz",
]  # fmt: skip
