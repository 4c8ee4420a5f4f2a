# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What is done with recorded runs: summed up, checked, analysed again, simulated again, recovered, exported, drawn."""

from impact_rig.recording.losses import Contiguity, Gap, check_contiguity, scan_rate_hz
from impact_rig.runs.exports import export
from impact_rig.runs.info import RunInfo, TopicInfo, info
from impact_rig.runs.recovery import Damage, FileReport, Recovered, RecoverReport, recover

__all__ = [
    "Contiguity", "Damage", "FileReport", "Gap", "RecoverReport", "Recovered", "RunInfo", "TopicInfo",
    "check_contiguity", "export", "info", "recover", "scan_rate_hz",
]  # fmt: skip
