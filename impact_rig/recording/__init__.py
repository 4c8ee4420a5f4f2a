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
"""Reader and writer of MCAP files, which work without ROS.

Messages are read and written as CDR bytes.
"""

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
