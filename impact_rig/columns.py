# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""What the columns of a table are: name, type, unit and meaning, written once.

The types of the tables (`impact_rig.blocks`) and their description (`docs/interface.md`) are both made from this.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

import attrs
import numpy as np

TEXT = "S32"
TEXT_BYTES = 32
"""Text in a table: UTF-8 in 32 bytes."""
NUMBER = "f8"
"""Also of indices: exact to 2**53, and `sensor_msgs/PointField` has no 64-bit integers."""


LONGEST_S = 2.0**32
"""No two stamps are further apart [s]."""
LARGEST_INDEX = 2.0**53
"""To which whole numbers are exact in a table."""


@attrs.frozen
class Column:
    """One column of a table, and what may stand in it: `codec.checked` refuses everything else.

    Attributes:
        name: how it is addressed.
        unit: SI unit, `-` for none, or words where it depends on the row.
        doc: what it says, including the values that are not measurements.
        kind: numpy type code.
        default: what a table of an earlier version, which lacks the column, is read as; None: it must be there.
        least: least value; a column with a bound holds no NaN.
        most: largest value.
        whole: whether values are whole numbers.
        is_part: whether a text may be part of a longer one, so that it need not be UTF-8 by itself.
    """

    name: str
    unit: str
    doc: str
    kind: str = NUMBER
    default: float | str | None = attrs.field(default=None, kw_only=True)
    least: float = attrs.field(default=-math.inf, kw_only=True)
    most: float = attrs.field(default=math.inf, kw_only=True)
    whole: bool = attrs.field(default=False, kw_only=True)
    is_part: bool = attrs.field(default=False, kw_only=True)

    @property
    def is_bounded(self) -> bool:
        """Whether some numbers are refused."""
        return self.whole or self.least > -math.inf or self.most < math.inf

    def allowed(self) -> str:
        """Return in words which numbers may stand here."""
        number = "a whole number" if self.whole else "a number"
        if self.least > -math.inf and self.most < math.inf:
            return f"{number} from {self.least:.10g} to {self.most:.17g}"
        return number + (f" from {self.least:.10g} on" if self.least > -math.inf else f" up to {self.most:.10g}")


def time(doc: str) -> Column:
    """Return the column `time` of a table: seconds since its stamp."""
    return Column("time", "s", doc, least=-LONGEST_S, most=LONGEST_S)


def index(name: str, doc: str) -> Column:
    """Return a column that counts from 0."""
    return Column(name, "-", doc, least=0.0, most=LARGEST_INDEX, whole=True)


def row_type(columns: Iterable[Column]) -> np.dtype[np.void]:
    """Return the numpy type of rows with these columns, packed."""
    return np.dtype([(column.name, column.kind) for column in columns])
