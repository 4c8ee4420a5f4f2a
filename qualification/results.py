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
"""Results of a long program in a file of JSON lines, so that an interrupted program continues where it ended."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any


class Results(list[dict[str, Any]]):
    """Results of this run of a program and of earlier ones.

    Args:
        path: path of the file; its folder is created if needed.
    """

    def __init__(self, path: Path) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        super().__init__(map(json.loads, path.read_text(encoding="utf-8").splitlines()) if path.exists() else ())
        self.path = path

    def add(self, one: Mapping[str, object]) -> None:
        """Append a result to the list and to the file."""
        self.append(dict(one))
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(self[-1]) + "\n")
