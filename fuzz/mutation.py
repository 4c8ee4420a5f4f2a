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
"""Bytes and texts that are nearly valid, the inputs that get furthest into a parser."""

from __future__ import annotations

import struct
from collections.abc import Sequence

from hypothesis import strategies as st

HOSTILE_NUMBERS = (0, 1, 2, 3, 7, 8, 0x7F, 0x80, 0xFF, 2**15, 2**16 - 1, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1)
HOSTILE_WORDS = (
    "", "0", "-1", "1e999", "-.inf", ".nan", "nan", "true", "null", "~", "[]", "{}", "[1, 2]", "'", '"', "\0", "é",
    "!!python/object/apply:os.system ['false']", "!!binary aGk=", "&a [*a]", "*a", "<<: *a", "0x10", "1_000", "1:2:3",
    "2024-01-01", "9" * 400, "1e-320", "- - -", "? a", "|", ">", "%YAML 9.9", "---", "...", "\t", "a: b: c",
)  # fmt: skip


@st.composite
def mutated(draw: st.DrawFn, seeds: Sequence[bytes], most: int = 6) -> bytes:
    """Draw a seed after a few changes: a number replaced, bytes flipped, cut, doubled, dropped or spliced in."""
    data = bytearray(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.integers(1, most))):
        at = draw(st.integers(0, max(len(data) - 1, 0)))
        match draw(st.integers(0, 7)):
            case 0:
                number = draw(st.sampled_from(HOSTILE_NUMBERS))
                packed = struct.pack("<Q", number)[: draw(st.sampled_from((1, 2, 4, 8)))]
                data[at : at + len(packed)] = packed
            case 1:
                data[at : at + 1] = bytes([data[at] ^ (1 << draw(st.integers(0, 7)))]) if data else b"\0"
            case 2:
                del data[at:]
            case 3:
                del data[at : at + draw(st.integers(1, 16))]
            case 4:
                data[at:at] = data[at : at + draw(st.integers(1, 64))]
            case 5:
                data[at:at] = draw(st.binary(max_size=16))
            case 6:
                other = draw(st.sampled_from(seeds))
                start = draw(st.integers(0, max(len(other) - 1, 0)))
                data[at:] = other[start:]
            case _:
                data[at : at + 4] = draw(st.binary(min_size=4, max_size=4))
    return bytes(data)


@st.composite
def mutated_lines(draw: st.DrawFn, text: str, most: int = 4) -> str:
    """Draw a file of `key: value` lines after a few changes of complete lines."""
    lines = text.splitlines()
    for _ in range(draw(st.integers(1, most))):
        at = draw(st.integers(0, len(lines) - 1))
        key, colon, _ = lines[at].partition(":")
        match draw(st.integers(0, 5)):
            case 0:
                lines[at] = f"{key}{colon} {draw(st.sampled_from(HOSTILE_WORDS))}"
            case 1:
                lines[at] = f"{key}{colon} {draw(st.floats())!r}"
            case 2:
                lines.insert(at, lines[draw(st.integers(0, len(lines) - 1))])
            case 3:
                lines[at] = draw(st.text(max_size=20)) + lines[at]
            case 4:
                del lines[at]
                lines = lines or [""]
            case _:
                lines[at] = lines[at].strip()
    return "\n".join(lines)
