# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""Text from outside (files, their names, the network) on its way to people: what would command a terminal is shown."""

from __future__ import annotations


def visible(text: str, *, lines: bool = False) -> str:
    r"""Return `text` with characters that cannot be seen as their escapes: ESC as `\x1b`, a line end as `\n`.

    Args:
        text: from anywhere.
        lines: leave line ends as they are.
    """
    return "".join(c if c.isprintable() or (lines and c == "\n") else c.encode("unicode_escape").decode() for c in text)
