# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the columns of a table are: name, type, unit and meaning, written once.

The types of the tables (`impact_rig.blocks`) and their description (`docs/interface.md`) are both made from this.
"""

from __future__ import annotations

from collections.abc import Iterable

import attrs
import numpy as np

TEXT = "S32"
TEXT_BYTES = 32
"""Text in a table: UTF-8 in 32 bytes."""
NUMBER = "f8"
"""Also of indices: exact to 2**53, and `sensor_msgs/PointField` has no 64-bit integers."""


@attrs.frozen
class Column:
    """One column of a table.

    Attributes:
        name: how it is addressed.
        unit: SI unit, `-` for none, or words where it depends on the row.
        doc: what it says, including the values that are not measurements.
        kind: numpy type code.
    """

    name: str
    unit: str
    doc: str
    kind: str = NUMBER


def row_type(columns: Iterable[Column]) -> np.dtype[np.void]:
    """Return the numpy type of rows with these columns, packed."""
    return np.dtype([(column.name, column.kind) for column in columns])
