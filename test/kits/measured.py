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
"""Choice of the programs started by tests that are measured for coverage: only those that ask for it.

Most programs pass the same lines as the tests' own process. Only those that alone reach some lines are measured:
kernels as plain Python, and the start of nodes and workers. `tools/lines_passed` measures.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

FOLDER = str(Path(__file__).parents[2] / "tools" / "lines_passed")
_HELD: dict[str, str] = {}


def hold_back() -> None:
    """Remove from this process's environment what would measure the coverage of its child processes."""
    if (data := os.environ.pop("IMPACT_RIG_LINES", None)) is not None:
        _HELD["IMPACT_RIG_LINES"] = data
        paths = [path for path in os.environ.pop("PYTHONPATH", "").split(os.pathsep) if path not in ("", FOLDER)]
        if paths:
            os.environ["PYTHONPATH"] = os.pathsep.join(paths)


def measured(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment (that of this process) whose child processes are measured, if this process is."""
    if not _HELD:
        return dict(environment)
    path = os.pathsep.join(filter(None, [FOLDER, environment.get("PYTHONPATH")]))
    return {**environment, **_HELD, "PYTHONPATH": path}
