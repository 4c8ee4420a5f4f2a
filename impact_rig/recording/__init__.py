# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""MCAP files of a run: written and read. CDR bytes in, CDR bytes out; no ROS needed."""

from impact_rig.recording.description import (
    CONFIGURATION,
    Attachment,
    OfferedQos,
    Provenance,
    TopicDescription,
    arithmetic_of,
    is_measured,
    schema_text,
)
from impact_rig.recording.losses import Account
from impact_rig.recording.reader import Message, RecordedTopic, Run, open_run
from impact_rig.recording.writer import RunWriter

__all__ = [
    "CONFIGURATION", "Account", "Attachment", "Message", "OfferedQos", "Provenance", "RecordedTopic", "Run",
    "RunWriter", "TopicDescription", "arithmetic_of", "is_measured", "open_run", "schema_text",
]  # fmt: skip
