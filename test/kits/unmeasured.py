# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""The environment of programs that coverage need not follow: it takes half of their time, and they are slow as it is.

For whole runs of what other tests pass through line by line: examples, the guide, the notebook, compiled code.
"""

from __future__ import annotations

import os
from collections.abc import Mapping


def unmeasured(environment: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Return an environment (this process's) without what makes a child of it measure its coverage."""
    return {key: value for key, value in environment.items() if not key.startswith("COVERAGE_")}
