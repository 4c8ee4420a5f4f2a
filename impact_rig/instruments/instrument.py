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
"""Base class of instruments: a section of the configuration with a channel, a sensor, faults and a message."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import attrs

from impact_rig.blocks import Column
from impact_rig.instruments.sensor import Sensor
from impact_rig.topics import Topic

FAULT_KINDS = {
    "dropout": "the cable is open: 0 V at the converter",
    "stuck": "the converter repeats its last code",
    "offset_step": "`value` [unit of the channel] is added",
    "gain_error": "the signal grows by the fraction `value`",
    "spike_train": "`rate_hz` spikes per second of ± `value` [unit], at random",
    "saturation": "the signal is limited to ± `value` [unit] and flagged",
    "added_noise": "white noise of `value` rms [unit] is added",
    "lost_block": "blocks are numbered, but their scans are withheld; truth and monitors are still published",
    "clock_drift": "the scan clock is slow by `value` ppm, on top of daq.clock_error_ppm",
}
BOARD_KINDS = frozenset({"lost_block", "clock_drift"})  # faults of the whole board: their channel is empty
CHANNEL_KINDS = frozenset(FAULT_KINDS) - BOARD_KINDS


@attrs.frozen(kw_only=True)
class Instrument:
    """Base class of an instrument on one channel of the board.

    The fields of a subclass form the section `instruments.<name>` of the configuration; define them with
    `impact_rig.config.fields`. An instrument with a field `present` is scanned only if that field is true; define it
    with `read_only=True`, because a running rig cannot change its channels.

    Attributes:
        name: name of the channel, of its column in daq/scan and of its section.
        place: position in the scan among all instruments, present or not, counted from 0. It also seeds the channel's
            noise and calibration errors.
        senses: quantity of the motion that it senses, one of `physics.sampling.QUANTITIES`.
        unit: unit of that quantity and of the readings.
        doc: description of its column in daq/scan.
        faults: kinds of faults that its channel can have.
        monitor: topic of its message at monitor rate, None if it has none.
    """

    name: ClassVar[str]
    place: ClassVar[int]
    senses: ClassVar[str]
    unit: ClassVar[str]
    doc: ClassVar[str]
    faults: ClassVar[frozenset[str]] = CHANNEL_KINDS
    monitor: ClassVar[Topic | None] = None

    @property
    def adc_range_v(self) -> float:
        """Input range of the converter for this channel: ± this voltage [V].

        Every subclass defines a field of this name.
        """
        raise NotImplementedError

    @property
    def fitted(self) -> bool:
        """Value of the field `present`: whether the board scans this instrument; true if it has no such field."""
        return bool(getattr(self, "present", True))

    def sensor(self) -> Sensor:
        """Return the model of the channel's sensor: transfer function, range and noise.

        Every subclass defines this method.
        """
        raise NotImplementedError

    def message(self, reading: float, clipped: bool, noise: float) -> Mapping[str, object]:
        """Return the fields of the monitor message for one reading: value by field, e.g. `linear_acceleration.x`.

        A subclass with a `monitor` defines this method. A field that is left out keeps its default in the message. Only
        values of the type float may differ between readings. All other values are taken once, for the reading 0.

        Args:
            reading: low-passed reading at a monitor instant, in the channel's unit.
            clipped: whether the sensor or the converter was at an end of its range in a scan between the previous and
                the next monitor instant.
            noise: rms of the noise in the channel's unit, as in daq/info.
        """
        raise NotImplementedError

    @classmethod
    def column(cls) -> Column:
        """Return the description of this instrument's column in the scans, daq/scan: name, unit and text."""
        return Column(cls.name, cls.unit, cls.doc)
