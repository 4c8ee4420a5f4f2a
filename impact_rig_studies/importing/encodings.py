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
"""Detection of the character encoding of text files, and their lines."""

from __future__ import annotations

import re

MARKS = (
    (b"\xef\xbb\xbf", "utf-8"),
    (b"\xff\xfe\0\0", "utf-32-le"),
    (b"\0\0\xfe\xff", "utf-32-be"),
    (b"\xff\xfe", "utf-16-le"),
    (b"\xfe\xff", "utf-16-be"),
)
WESTERN = "cp1252"  # code page of most programs that still write one; its five unused bytes count as Latin-1
_LINE_END = re.compile(r"\r\n|\r|\n")
SAMPLE = 4096


def decode(content: bytes) -> tuple[str, str]:
    """Return the text of a file and the name of its encoding.

    A byte order mark decides. Without a mark, the encoding is UTF-16 if many of the first bytes are zero. Otherwise it
    is the first of UTF-8, cp1252 and Latin-1 in which all bytes are valid. Any bytes are accepted: where needed,
    invalid bytes become U+FFFD.
    """
    for mark, name in MARKS:
        if content.startswith(mark):
            return content[len(mark) :].decode(name, "replace"), name
    head = content[:SAMPLE]
    zeros = head[0::2].count(0), head[1::2].count(0)
    if max(zeros) > 0.3 * len(head) / 2:  # the digits of UTF-16 have a zero byte each
        name = "utf-16-le" if zeros[1] > zeros[0] else "utf-16-be"
        return content.decode(name, "replace"), name
    try:
        return content.decode("utf-8"), "utf-8"
    except UnicodeDecodeError:
        pass
    try:
        return content.decode(WESTERN), WESTERN
    except UnicodeDecodeError:
        return content.decode("latin-1"), "latin-1"


def split_lines(text: str) -> list[str]:
    """Return the lines of a text without their ends.

    A line ends with a line feed, a carriage return, or a carriage return followed by a line feed. Unlike in
    `str.splitlines`, no other character ends a line. If the last line is empty, it is dropped.
    """
    lines = text.split("\n") if "\r" not in text else _LINE_END.split(text)
    return lines[:-1] if lines and not lines[-1] else lines
