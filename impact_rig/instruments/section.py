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
"""Section `instruments` of the configuration: the board, the faults, and one subsection per instrument.

Tolerances are limits: the rig draws its calibration errors once per seed, uniformly within them, and the analysis knows
only the limits. The columns of daq/scan follow from the instruments that are present, in the order of their positions.
"""

from __future__ import annotations

import operator
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, Protocol  # attrs attributes of any type

import attrs
import numpy as np
from numpy.typing import NDArray

from impact_rig.blocks import Column, row_type
from impact_rig.config.fields import switch
from impact_rig.config.sections import Daq, Drive, Shaker, Structure
from impact_rig.errors import ConfigError
from impact_rig.instruments.fault import FaultPlan
from impact_rig.instruments.instrument import Instrument
from impact_rig.instruments.registry import INSTRUMENTS
from impact_rig.instruments.sensor import ADC_RANGES_V, Adc
from impact_rig.topics import SCAN as SCAN_TOPIC


def _with_instruments(_section: type, own: list[attrs.Attribute[Any]]) -> list[attrs.Attribute[Any]]:
    """Return the attributes of the class `Instruments`: its own, and one for each registered instrument.

    The attributes of the instruments follow the first attribute of `own`. attrs calls this function when it creates the
    class.
    """
    fields = {name: attrs.field(factory=kind, type=kind) for name, kind in INSTRUMENTS.items()}
    return [own[0], *attrs.fields(attrs.make_class("_", fields, kw_only=True)), *own[1:]]


@attrs.frozen(kw_only=True, field_transformer=_with_instruments)
class Instruments:
    """Section `instruments` of a configuration: settings of the converter, the faults and each instrument.

    Each registered instrument has a field with the name of its channel.
    """

    ideal: bool = switch(False, "Ideal instruments: no noise, calibration error, lag, skew, quantisation or range.")
    adc: Adc = attrs.field(factory=Adc)
    faults: FaultPlan = attrs.field(factory=FaultPlan)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Return the settings of the instrument `name`; only for type checkers, which do not know the names."""

    def __attrs_post_init__(self) -> None:
        for instrument in self.all():
            chosen = instrument.adc_range_v
            if chosen not in ADC_RANGES_V:
                ranges = ", ".join(f"{volt:g}" for volt in ADC_RANGES_V)
                raise ConfigError(f"{instrument.name}.adc_range_v must be one of {ranges} V, got {chosen:g} V")
        fitted = {"", *(instrument.name for instrument in self.fitted())}
        for fault in self.faults.faults(scan_rate_hz=1):
            if fault.channel not in fitted:
                fitting = sorted(one.name for one in self.fitted() if fault.kind in one.faults)
                raise ConfigError(
                    f"faults.planned: {fault.kind} needs a channel that is present, but {fault.channel} is not; "
                    f"use {', '.join(fitting) or 'another kind of fault'}"
                )

    def all(self) -> tuple[Instrument, ...]:
        """Return the settings of every instrument, present or not, in scan order."""
        found: tuple[Instrument, ...] = operator.attrgetter(*INSTRUMENTS)(self)
        return found

    def fitted(self) -> tuple[Instrument, ...]:
        """Return the settings of the instruments that are present, and so scanned, in scan order."""
        return tuple(filter(operator.attrgetter("fitted"), self.all()))


def columns(fitted: Iterable[Instrument | type[Instrument]]) -> tuple[Column, ...]:
    """Return the columns of a scan of these instruments: time, one column for each instrument, status.

    Bit j of the status (1 << j) belongs to instrument number j of these, counted from 0. It is set if that instrument
    was at an end of its range.
    """
    time, status = SCAN_TOPIC.fields
    return (time, *(instrument.column() for instrument in fitted), status)


def row_type_of(instruments: Instruments) -> np.dtype[np.void]:
    """Return the NumPy type of one scan with the instruments that are present."""
    return row_type(columns(instruments.fitted()))


COLUMNS = columns(INSTRUMENTS.values())  # with all instruments
SCAN = row_type_of(Instruments())  # the rows of the default configuration
CHANNELS = tuple(instrument.name for instrument in Instruments().fitted())
"""Names of the channels in the default scan; channel j is converted j conversion intervals after the start of the scan.
"""


def channels_of(rows: NDArray[np.void]) -> tuple[str, ...]:
    """Return the names of the channels in some scans: the columns except time and status."""
    return tuple(name for name in rows.dtype.names or () if name not in _COMMON)


_COMMON = frozenset(column.name for column in SCAN_TOPIC.fields)


class InstrumentSetup(Protocol):
    """Interface of a configuration from which instruments are made: daq, instruments, drive, shaker, structure."""

    @property
    def daq(self) -> Daq:
        """Section `daq` of the configuration, for the scan clock and the seed of noise and calibration errors."""

    @property
    def instruments(self) -> Instruments:
        """Section `instruments` of the configuration: the instruments themselves, converter and faults."""

    @property
    def drive(self) -> Drive:
        """Section `drive`; the end frequency of a chirp limits the length of the pieces into which a motion is cut."""

    @property
    def shaker(self) -> Shaker:
        """Section `shaker`; its highest frequency limits the length of a motion's pieces, and calibration sines."""

    @property
    def structure(self) -> Structure:
        """Section `structure` of the configuration, for the mass whose velocity jumps at an instantaneous impact."""
