# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The columns of daq/scan: a channel for every instrument that is fitted, in the order of their places."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from impact_rig.columns import Column, row_type
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.instruments.section import Instruments
from impact_rig.topics import SCAN as FRAME


def columns(fitted: Iterable[Instrument | type[Instrument]]) -> tuple[Column, ...]:
    """Return the columns of a scan of these instruments; the status bit of channel j is 1 << j."""
    time, status = FRAME.fields
    return (time, *(instrument.column() for instrument in fitted), status)


def row_type_of(instruments: Instruments) -> np.dtype[np.void]:
    """Return the type of the rows that a configuration scans."""
    return row_type(columns(instruments.fitted()))


COLUMNS = columns(INSTRUMENTS.values())
"""With every instrument there is."""
SCAN = row_type_of(Instruments())
"""The rows of the default configuration."""
CHANNELS = tuple(instrument.name for instrument in Instruments().fitted())
"""Its channels; channel j is converted j conversion intervals after the scan clock."""


def channels_of(rows: NDArray[np.void]) -> tuple[str, ...]:
    """Return the channels of some scans: their columns without those of the frame."""
    return tuple(name for name in rows.dtype.names or () if name not in _FRAME)


_FRAME = frozenset(column.name for column in FRAME.fields)
