"""Runs as MCAP files: written, read, checked, recovered and exported. CDR bytes in, CDR bytes out; no ROS needed."""

from impact_rig.recording.contiguity import Contiguity, Gap, check_contiguity, scan_rate_hz
from impact_rig.recording.exports import export
from impact_rig.recording.losses import Account
from impact_rig.recording.provenance import CONFIGURATION, Attachment, Provenance, arithmetic_of
from impact_rig.recording.reader import Message, RecordedTopic, Run, open_run
from impact_rig.recording.recovery import recover
from impact_rig.recording.recovery_record import Recovered
from impact_rig.recording.recovery_report import FileReport, RecoverReport
from impact_rig.recording.run_info import RunInfo, TopicInfo, info
from impact_rig.recording.salvage import Damage
from impact_rig.recording.schema import schema_text
from impact_rig.recording.topics import Qos, Topic
from impact_rig.recording.writer import RunWriter

__all__ = [
    "CONFIGURATION",
    "Account",
    "Attachment",
    "Contiguity",
    "Damage",
    "FileReport",
    "Gap",
    "Message",
    "Provenance",
    "Qos",
    "RecordedTopic",
    "RecoverReport",
    "Recovered",
    "Run",
    "RunInfo",
    "RunWriter",
    "Topic",
    "TopicInfo",
    "arithmetic_of",
    "check_contiguity",
    "export",
    "info",
    "open_run",
    "recover",
    "scan_rate_hz",
    "schema_text",
]
