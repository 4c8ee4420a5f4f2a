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
"""Program of the ROS node `stepped_sine`: `python -m impact_rig_studies --ros-args ...`, or the console script.

Imports are light: signal handlers and the watch on the parent process are set up before anything heavy is imported.
"""

from __future__ import annotations

import functools

from impact_rig.nodes.__main__ import run

USE = (
    "Stepped sine: sets one drive frequency after the other, waits for its measurement, and publishes the curve.",
    "begin:=true",
    "Topics, services and parameters: docs/reference/interface.md.",
)

stepped_sine = functools.partial(run, "stepped_sine", USE, "impact_rig_studies.stepped_sine_node")

if __name__ == "__main__":
    stepped_sine()
