# Copyright 2026 The impact_rig developers
# Licensed under the Apache License, Version 2.0 (the "License"); you may not use this file except in compliance with
# the License. You may obtain a copy of the License at http://www.apache.org/licenses/LICENSE-2.0 Unless required by
# applicable law or agreed to in writing, software distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied. See the License for the specific language
# governing permissions and limitations under the License.
"""Text from outside (files, their names, the network) on its way to people: what would command a terminal is shown."""

from __future__ import annotations


def visible(text: str, *, lines: bool = False) -> str:
    r"""Return `text` with characters that cannot be seen as their escapes: ESC as `\x1b`, a line end as `\n`.

    Args:
        text: from anywhere.
        lines: leave line ends as they are.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else c.encode("unicode_escape").decode() for c in text)
