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
"""Limits of memory and content for imported files, so that a damaged or malicious file cannot fill the memory.

The environment variable IMPACT_RIG_BUDGET multiplies all limits.
"""

from __future__ import annotations

from impact_rig.system import budget

FILE_BYTES = 512 * budget.MIB  # size of one file
VALUES = 120_000_000  # in all signals of a file together: 20 minutes of five channels at 20 kS/s
COLUMNS = 4096  # of one file; Rattlesnake, the widest source known, has some hundred channels
WORKING_BYTES = 160 * budget.MIB
WORKING_PER_BYTE = 12
"""Memory that reading a file may use in addition [bytes]: a constant part, and a part per byte of the file."""
EXPANDED_BYTES, EXPANDED_PER_BYTE = 64 * budget.MIB, 4
"""Allowed size of a file's numbers after decompression [bytes]: a constant part, and a part per byte of the file."""


def check_column_count(count: int) -> None:
    """Reject a file with too many columns, signals or other parts.

    Raises:
        BudgetError: `count` is above `COLUMNS`, multiplied by IMPACT_RIG_BUDGET.
    """
    budget.allow("columns in a file", count, COLUMNS)


def check_value_count(count: float, file_bytes: int) -> None:
    """Reject a file that claims more numbers than a file of this size can really contain.

    Raises:
        BudgetError: `count` is above `VALUES`, multiplied by IMPACT_RIG_BUDGET, or `count` numbers of 8 bytes exceed
            the limit of `check_expanded_bytes`.
    """
    budget.allow("values in a file", count, VALUES)
    check_expanded_bytes(8.0 * count, file_bytes)


def check_expanded_bytes(size: float, file_bytes: int) -> None:
    """Reject a file whose content after decompression is far larger than the file.

    Args:
        size: bytes of content after decompression, found without decompressing, such as from the file's headers.
        file_bytes: bytes of the file.

    Raises:
        BudgetError: `size` is above `EXPANDED_BYTES` plus `EXPANDED_PER_BYTE` for each byte of the file, multiplied by
            IMPACT_RIG_BUDGET.
    """
    limit = EXPANDED_BYTES + EXPANDED_PER_BYTE * file_bytes
    budget.allow(f"bytes of content in a file of {file_bytes} bytes", size, limit)
